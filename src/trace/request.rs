//! Requests: jobs that move from thread to thread and have their own line.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use super::buffers::{Event, EventKind, since};
use super::recording::{current, record};
use super::subscriber;

/// Returns the first ticket of a new source of requests. A source numbers its requests from there, so that the tickets of two
/// sources never collide.
pub fn ticket_source() -> u64 {
    static NEXT: AtomicU32 = AtomicU32::new(1);
    u64::from(NEXT.fetch_add(1, Ordering::Relaxed)) << 40
}

/// Records that a request begins.
#[inline]
pub fn request_begins(ticket: u64, uri: &Arc<str>) {
    if let Some(recording) = current() {
        record_now(recording, "request", EventKind::RequestBegins { ticket }, Some(uri.clone()));
    }
    if subscriber::is_enabled() {
        subscriber::request_begins(ticket, uri);
    }
}

/// Records that a request ends: `merged`, `failed`, `cancelled`, `stale`, `declined` or `dropped`.
#[inline]
pub fn request_ends(ticket: u64, outcome: &'static str) {
    if let Some(recording) = current() {
        record_now(recording, outcome, EventKind::RequestEnds { ticket }, None);
    }
    if subscriber::is_enabled() {
        subscriber::request_ends(ticket, outcome);
    }
}

#[cold]
fn record_now(recording: u32, name: &'static str, kind: EventKind, detail: Option<Arc<str>>) {
    let now = Instant::now();
    record(recording, |start| Event { name, at_ns: since(start, now), detail, kind });
}
