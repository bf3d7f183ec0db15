//! Events and the buffers of the threads that record them.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// The maximum number of events that a thread keeps. Further ones are counted and dropped.
const MAX_EVENTS: usize = 1 << 20;

/// The events of one thread, or of one [`Track`](super::track::Track).
#[derive(Debug)]
pub(super) struct Buffer {
    /// Name of the thread or track.
    name: String,
    /// Locked by its thread for each event, and once by the thread that ends the recording.
    events: Mutex<Events>,
}

impl Buffer {
    pub fn new(name: String) -> Self {
        Self { name, events: Mutex::default() }
    }

    pub fn lock(&self) -> MutexGuard<'_, Events> {
        self.events.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the name and takes the events.
    pub fn take(&self) -> (String, Events) {
        (self.name.clone(), std::mem::take(&mut *self.lock()))
    }
}

/// A bounded list of events.
#[derive(Debug, Default)]
pub(super) struct Events {
    pub list: Vec<Event>,
    /// Number of events dropped because the list was full.
    pub lost: u64,
}

impl Events {
    pub fn push(&mut self, event: Event) {
        if self.list.len() < MAX_EVENTS {
            self.list.push(event);
        } else {
            self.lost += 1;
        }
    }
}

/// The events of a recording.
pub(super) struct Recorded {
    /// Duration of the recording in nanoseconds.
    pub ns: u64,
    /// Name and events of each thread and track.
    pub threads: Vec<(String, Events)>,
}

/// A span, or the begin or end of a request.
#[derive(Debug)]
pub(super) struct Event {
    pub name: &'static str,
    /// Begin in nanoseconds since the start of the recording.
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
    /// Work for one request on a thread that works for several requests at the same time.
    RequestSpan {
        ticket: u64,
        ns: u64,
    },
}

/// Returns the nanoseconds from `start` to `at`, or 0 if `at` is earlier.
pub(super) fn since(start: Instant, at: Instant) -> u64 {
    u64::try_from(at.saturating_duration_since(start).as_nanos()).unwrap_or(u64::MAX)
}

/// Returns the milliseconds since 1970.
pub(super) fn unix_ms() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| u64::try_from(d.as_millis()).unwrap_or(0))
}
