//! Writes a recording in Chrome's trace event format, which Perfetto reads too.
//!
//! Spans are complete events (`X`), requests are asynchronous events (`b`, `e`) with their ticket as id, and names of threads are
//! metadata (`M`). Times are in microseconds.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Result, Write};
use std::path::Path;

use serde_json::{Value, json};

use super::buffers::{Event, EventKind, Recorded, unix_ms};
use super::redact::without_secrets;
use super::summary::TraceSummary;

/// The process id in the file. There is only one process.
const PROCESS: u32 = 1;

pub(super) fn write(path: &Path, recorded: &Recorded) -> Result<TraceSummary> {
    let mut out = Writer { out: BufWriter::new(File::create(path)?), is_first: true };
    out.out.write_all(b"{\"traceEvents\":[")?;
    out.event(&json!({"ph": "M", "name": "process_name", "pid": PROCESS, "args": {"name": "terrane"}}))?;
    let mut summary = TraceSummary { threads: recorded.threads.len(), ..TraceSummary::default() };
    // The events of a request may be in the buffers of several threads.
    let mut requests: BTreeMap<u64, Vec<(u64, usize, &Event)>> = BTreeMap::new();
    for (thread, (name, events)) in recorded.threads.iter().enumerate() {
        let number = thread + 1;
        let args = json!({"name": name});
        out.event(&json!({"ph": "M", "name": "thread_name", "pid": PROCESS, "tid": number, "args": args}))?;
        let args = json!({"sort_index": number});
        out.event(&json!({"ph": "M", "name": "thread_sort_index", "pid": PROCESS, "tid": number, "args": args}))?;
        summary.lost += events.lost;
        for event in &events.list {
            match event.kind {
                EventKind::Span { ns } => {
                    summary.spans += 1;
                    let mut value = json!({
                        "ph": "X", "cat": "frame", "name": event.name, "pid": PROCESS, "tid": number,
                        "ts": us(event.at_ns), "dur": us(ns),
                    });
                    if let Some(detail) = &event.detail {
                        value["args"] = json!({"of": without_secrets(detail)});
                    }
                    out.event(&value)?;
                }
                EventKind::RequestBegins { ticket }
                | EventKind::RequestEnds { ticket }
                | EventKind::RequestSpan { ticket, .. } => {
                    requests.entry(ticket).or_default().push((event.at_ns, number, event));
                }
            }
        }
    }
    for (ticket, mut events) in requests {
        events.sort_by_key(|(at_ns, ..)| *at_ns);
        let begins = |e: &Event| matches!(e.kind, EventKind::RequestBegins { .. });
        let Some((at_ns, thread, first)) = events.iter().find(|(_, _, e)| begins(e)) else {
            continue; // it began before the recording
        };
        summary.requests += 1;
        let uri = without_secrets(first.detail.as_deref().unwrap_or_default());
        let ends = |e: &Event| matches!(e.kind, EventKind::RequestEnds { .. });
        let last = events.iter().rev().find(|(_, _, e)| ends(e));
        let (end_ns, end_thread, outcome) =
            last.map_or((recorded.ns, *thread, "unfinished"), |(at, thread, e)| (*at, *thread, e.name));
        let of = |ph: &str, name: &str, ns: u64, thread: usize, args: Value| {
            json!({
                "ph": ph, "cat": "request", "name": name, "id": format!("{ticket:#x}"), "pid": PROCESS,
                "tid": thread, "ts": us(ns), "args": args,
            })
        };
        let end_ns = end_ns.max(*at_ns);
        out.event(&of("b", short(&uri), *at_ns, *thread, json!({"uri": uri})))?;
        for (from_ns, thread, event) in &events {
            let EventKind::RequestSpan { ns, .. } = event.kind else { continue };
            // An aborted span may end shortly after its request.
            let (from, to) = ((*from_ns).clamp(*at_ns, end_ns), (from_ns + ns).clamp(*at_ns, end_ns));
            out.event(&of("b", event.name, from, *thread, json!({})))?;
            out.event(&of("e", event.name, to, *thread, json!({})))?;
        }
        out.event(&of("e", short(&uri), end_ns, end_thread, json!({"outcome": outcome})))?;
    }
    let other =
        json!({"version": env!("CARGO_PKG_VERSION"), "written_unix_ms": unix_ms(), "events_lost": summary.lost});
    write!(out.out, "],\n\"displayTimeUnit\":\"ms\",\"otherData\":{other}}}\n")?;
    out.out.flush()?;
    Ok(summary)
}

/// Returns the last two parts of a path.
fn short(uri: &str) -> &str {
    uri.rmatch_indices('/').nth(1).map_or(uri, |(at, _)| &uri[at + 1..])
}

fn us(ns: u64) -> f64 {
    ns as f64 / 1e3
}

struct Writer {
    out: BufWriter<File>,
    is_first: bool,
}

impl Writer {
    fn event(&mut self, value: &Value) -> Result<()> {
        self.out.write_all(if self.is_first { b"\n" } else { b",\n" })?;
        self.is_first = false;
        serde_json::to_writer(&mut self.out, value)?;
        Ok(())
    }
}
