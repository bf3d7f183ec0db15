//! Buffers of events, one a thread, and the marks that fill them.

use std::cell::RefCell;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use super::{TimelineError, TimelineSummary, json};

/// Events of a thread that are kept; later ones are counted and left out.
const MOST_EVENTS: usize = 1 << 20;

/// Number of the recording under way, 0 for none. Written by who starts and ends one, read by every mark: relaxed, a
/// mark that comes too late or too early is left out by the number in its buffer.
static RECORDING: AtomicU32 = AtomicU32::new(0);

/// The recording under way. Locked to start and end it, and once by each thread.
static SHARED: Mutex<Option<Shared>> = Mutex::new(None);

thread_local! {
    static OWN: RefCell<Option<Own>> = const { RefCell::new(None) };
}

struct Shared {
    number: u32,
    start: Instant,
    buffers: Vec<Arc<Buffer>>,
}

/// A thread's part in a recording.
#[derive(Debug)]
struct Own {
    recording: u32,
    start: Instant,
    buffer: Arc<Buffer>,
}

/// Filled by its thread, taken at the end.
#[derive(Debug)]
pub(super) struct Buffer {
    /// Name of the thread.
    pub name: String,
    pub events: Mutex<Events>,
}

#[derive(Debug, Default)]
pub(super) struct Events {
    pub list: Vec<Event>,
    /// Left out for want of room.
    pub lost: u64,
}

impl Events {
    fn push(&mut self, event: Event) {
        if self.list.len() < MOST_EVENTS {
            self.list.push(event);
        } else {
            self.lost += 1;
        }
    }
}

/// Times are nanoseconds since the start.
#[derive(Debug)]
pub(super) struct Event {
    pub name: &'static str,
    pub at_ns: u64,
    pub detail: Option<Arc<str>>,
    pub kind: EventKind,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum EventKind {
    Span {
        ns: u64,
    },
    RequestBegins {
        ticket: u64,
    },
    RequestEnds {
        ticket: u64,
    },
    /// What is done for a request on a thread that does the same for others meanwhile.
    RequestSpan {
        ticket: u64,
        ns: u64,
    },
}

/// Everything that was recorded.
pub(super) struct Recorded {
    pub ns: u64,
    pub threads: Vec<(String, Events)>,
}

/// A recording under way, of all threads of the process; dropped, what it has is thrown away.
#[derive(Debug)]
pub struct Recording {
    number: u32,
}

impl Recording {
    /// Starts to record. There can be one at a time.
    pub fn start() -> Result<Self, TimelineError> {
        static NEXT: AtomicU32 = AtomicU32::new(1);
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        if shared.is_some() {
            return Err(TimelineError::AlreadyRecording);
        }
        let number = NEXT.fetch_add(1, Ordering::Relaxed).max(1);
        *shared = Some(Shared { number, start: Instant::now(), buffers: Vec::new() });
        RECORDING.store(number, Ordering::Relaxed);
        Ok(Self { number })
    }

    /// Ends the recording and writes it in Chrome's trace event format. Spans that are open are left out; requests that
    /// are under way end as `unfinished`.
    pub fn write(mut self, path: &Path) -> Result<TimelineSummary, TimelineError> {
        let recorded = self.end();
        json::write(path, &recorded).map_err(|source| TimelineError::Write { path: path.display().to_string(), source })
    }

    fn end(&mut self) -> Recorded {
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(mine) = shared.take_if(|s| s.number == self.number) else {
            return Recorded { ns: 0, threads: Vec::new() };
        };
        RECORDING.store(0, Ordering::Relaxed);
        drop(shared);
        let take = |buffer: Arc<Buffer>| {
            let events = std::mem::take(&mut *buffer.events.lock().unwrap_or_else(PoisonError::into_inner));
            (buffer.name.clone(), events)
        };
        let ns = since(mine.start, Instant::now());
        Recorded { ns, threads: mine.buffers.into_iter().map(take).collect() }
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        self.end();
    }
}

/// What a thread does until this is dropped.
#[derive(Debug)]
#[must_use = "a span ends when it is dropped"]
pub struct Span(Option<OpenSpan>);

#[derive(Debug)]
struct OpenSpan {
    recording: u32,
    name: &'static str,
    detail: Option<Arc<str>>,
    /// Of the request that it belongs to, where spans of several overlap on the thread.
    ticket: Option<u64>,
    start: Instant,
}

/// Marks what the thread does from now on, while a recording is under way. Spans of a thread lie inside each other.
#[inline]
pub fn span(name: &'static str) -> Span {
    match RECORDING.load(Ordering::Relaxed) {
        0 => Span(None),
        recording => Span(Some(OpenSpan { recording, name, detail: None, ticket: None, start: Instant::now() })),
    }
}

/// As [`span`], with what it is done to: a URI, the number of a frame. `detail` is asked while recording only.
#[inline]
pub fn span_of(name: &'static str, detail: impl FnOnce() -> Arc<str>) -> Span {
    match RECORDING.load(Ordering::Relaxed) {
        0 => Span(None),
        recording => {
            Span(Some(OpenSpan { recording, name, detail: Some(detail()), ticket: None, start: Instant::now() }))
        }
    }
}

/// Marks what is done for a request from now on, where a thread works for several at a time.
#[inline]
pub fn request_span(name: &'static str, ticket: u64) -> Span {
    match RECORDING.load(Ordering::Relaxed) {
        0 => Span(None),
        recording => {
            Span(Some(OpenSpan { recording, name, detail: None, ticket: Some(ticket), start: Instant::now() }))
        }
    }
}

impl Drop for Span {
    #[inline]
    fn drop(&mut self) {
        if let Some(open) = self.0.take() {
            record_span(open);
        }
    }
}

#[cold]
fn record_span(open: OpenSpan) {
    let ns = since(open.start, Instant::now());
    let kind = open.ticket.map_or(EventKind::Span { ns }, |ticket| EventKind::RequestSpan { ticket, ns });
    record(open.recording, |start| Event {
        name: open.name,
        at_ns: since(start, open.start),
        detail: open.detail,
        kind,
    });
}

/// A line of the timeline for what no thread of ours does: an adapter's work, whose times are known only later.
#[derive(Debug)]
pub(crate) struct Track {
    name: String,
    own: Option<Own>,
    /// End of its last span: they lie one after the other.
    last_end_ns: u64,
}

impl Track {
    pub(crate) fn new(name: String) -> Self {
        Self { name, own: None, last_end_ns: 0 }
    }

    /// Writes a span with others inside it, one after the other, while a recording is under way. What would lie before
    /// the recording, or inside what was written before, is cut off.
    pub(crate) fn spans(
        &mut self,
        name: &'static str,
        detail: impl FnOnce() -> Arc<str>,
        whole: [Instant; 2],
        inside: impl Iterator<Item = (&'static str, [Instant; 2])>,
    ) {
        let recording = RECORDING.load(Ordering::Relaxed);
        if recording == 0 {
            self.own = None;
            return;
        }
        if self.own.as_ref().is_none_or(|own| own.recording != recording) {
            self.own = join(recording, Some(&self.name));
            self.last_end_ns = 0;
        }
        let Some(own) = &self.own else { return };
        let mut from_ns = since(own.start, whole[0]).max(self.last_end_ns);
        let end_ns = since(own.start, whole[1]);
        if end_ns <= from_ns {
            return;
        }
        self.last_end_ns = end_ns;
        let mut events = own.buffer.events.lock().unwrap_or_else(PoisonError::into_inner);
        let span = |name, at_ns, ns, detail| Event { name, at_ns, detail, kind: EventKind::Span { ns } };
        events.push(span(name, from_ns, end_ns - from_ns, Some(detail())));
        for (name, [begin, end]) in inside {
            let begin_ns = since(own.start, begin).clamp(from_ns, end_ns);
            let until_ns = since(own.start, end).clamp(begin_ns, end_ns);
            events.push(span(name, begin_ns, until_ns - begin_ns, None));
            from_ns = until_ns;
        }
    }
}

/// True while a recording is under way.
#[inline]
pub(crate) fn is_recording() -> bool {
    RECORDING.load(Ordering::Relaxed) != 0
}

/// Tickets of one source of requests begin with its number: no two sources have the same.
pub fn ticket_source() -> u64 {
    static NEXT: AtomicU32 = AtomicU32::new(1);
    u64::from(NEXT.fetch_add(1, Ordering::Relaxed)) << 40
}

/// A request was taken up. It wanders over threads, and has a line of its own.
#[inline]
pub fn request_begins(ticket: u64, uri: &Arc<str>) {
    let recording = RECORDING.load(Ordering::Relaxed);
    if recording != 0 {
        request(recording, "request", EventKind::RequestBegins { ticket }, Some(uri.clone()));
    }
}

/// A request came to its end: `merged`, `failed`, `cancelled`, `stale`, `declined`, `dropped`.
#[inline]
pub fn request_ends(ticket: u64, outcome: &'static str) {
    let recording = RECORDING.load(Ordering::Relaxed);
    if recording != 0 {
        request(recording, outcome, EventKind::RequestEnds { ticket }, None);
    }
}

#[cold]
fn request(recording: u32, name: &'static str, kind: EventKind, detail: Option<Arc<str>>) {
    let now = Instant::now();
    record(recording, |start| Event { name, at_ns: since(start, now), detail, kind });
}

fn since(start: Instant, at: Instant) -> u64 {
    u64::try_from(at.saturating_duration_since(start).as_nanos()).unwrap_or(u64::MAX)
}

/// Puts an event of a recording into the thread's buffer, unless that recording has ended.
fn record(recording: u32, event: impl FnOnce(Instant) -> Event) {
    // A thread that is ending has no buffer any more.
    let _ = OWN.try_with(|own| {
        let Ok(mut own) = own.try_borrow_mut() else { return };
        if own.as_ref().is_none_or(|o| o.recording != recording) {
            *own = join(recording, None);
        }
        let Some(own) = own.as_ref() else { return };
        own.buffer.events.lock().unwrap_or_else(PoisonError::into_inner).push(event(own.start));
    });
}

/// A buffer in the recording under way, under a name or the thread's.
fn join(recording: u32, name: Option<&str>) -> Option<Own> {
    let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
    let shared = shared.as_mut().filter(|s| s.number == recording)?;
    let number = shared.buffers.len();
    let of_thread = || std::thread::current().name().map_or_else(|| format!("thread {number}"), str::to_owned);
    let name = name.map_or_else(of_thread, str::to_owned);
    let buffer = Arc::new(Buffer { name, events: Mutex::default() });
    shared.buffers.push(buffer.clone());
    Some(Own { recording, start: shared.start, buffer })
}

/// Milliseconds since 1970, for the file's own data.
pub(super) fn unix_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| u64::try_from(d.as_millis()).unwrap_or(0))
}
