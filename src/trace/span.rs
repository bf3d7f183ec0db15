//! [`Span`]: marks what a thread does.

use std::sync::Arc;
use std::time::Instant;

use super::buffers::{Event, EventKind, since};
use super::recording::{current, record};
use super::subscriber;

/// A span of a thread that lasts until it is dropped.
#[derive(Debug, Default)]
#[must_use = "a span ends when it is dropped"]
pub struct Span {
    _recorded: Option<RecordedSpan>,
    /// The same span for a subscriber of the crate `tracing`.
    _observed: subscriber::ObservedSpan,
}

/// A span of a [`Recording`](super::Recording).
#[derive(Debug)]
struct RecordedSpan {
    recording: u32,
    name: &'static str,
    detail: Option<Arc<str>>,
    /// The request that the span belongs to, if spans of several requests overlap on this thread.
    ticket: Option<u64>,
    start: Instant,
}

/// Starts a span of this thread. Spans of a thread must be nested.
#[inline]
pub fn span(name: &'static str) -> Span {
    if is_off() {
        return Span::default();
    }
    Span { _recorded: RecordedSpan::start(name, None, None), _observed: subscriber::enter(name, None) }
}

/// Starts a span with a detail, such as a URI or the number of a frame. `detail` is called only if the span is recorded or
/// observed.
#[inline]
pub fn span_of(name: &'static str, detail: impl FnOnce() -> Arc<str>) -> Span {
    if is_off() {
        return Span::default();
    }
    let detail = detail();
    let observed = subscriber::enter(name, Some(&detail));
    Span { _recorded: RecordedSpan::start(name, Some(detail), None), _observed: observed }
}

/// Starts a span of a request, on a thread that works for several requests at the same time. Spans of different requests may
/// overlap.
#[inline]
pub fn request_span(name: &'static str, ticket: u64) -> Span {
    if is_off() {
        return Span::default();
    }
    Span {
        _recorded: RecordedSpan::start(name, None, Some(ticket)),
        _observed: subscriber::open_in_request(name, ticket),
    }
}

/// Returns true if nothing records or observes spans.
#[inline]
fn is_off() -> bool {
    current().is_none() && !subscriber::is_enabled()
}

impl RecordedSpan {
    fn start(name: &'static str, detail: Option<Arc<str>>, ticket: Option<u64>) -> Option<Self> {
        current().map(|recording| Self { recording, name, detail, ticket, start: Instant::now() })
    }
}

impl Drop for RecordedSpan {
    fn drop(&mut self) {
        let ns = since(self.start, Instant::now());
        let kind = self.ticket.map_or(EventKind::Span { ns }, |ticket| EventKind::RequestSpan { ticket, ns });
        let detail = self.detail.take();
        record(self.recording, |start| Event { name: self.name, at_ns: since(start, self.start), detail, kind });
    }
}
