//! [`Recording`]: the recording of the process, and the buffers that join it.

use std::cell::RefCell;
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use super::buffers::{Buffer, Event, Recorded, since};
use super::chrome;
use super::error::TraceError;
use super::summary::TraceSummary;

/// The number of the current recording; 0 without one. Written by [`Recording`], read by every span. Relaxed: an event that
/// arrives early or late carries the number of its recording and is dropped.
static CURRENT: AtomicU32 = AtomicU32::new(0);

/// The current recording. Locked to start and end it, and once by each thread that joins it.
static SHARED: Mutex<Option<Shared>> = Mutex::new(None);

thread_local! {
    static JOINED: RefCell<Option<Joined>> = const { RefCell::new(None) };
}

struct Shared {
    number: u32,
    start: Instant,
    buffers: Vec<Arc<Buffer>>,
}

/// The membership of a thread or track in a recording.
#[derive(Debug)]
pub(super) struct Joined {
    pub recording: u32,
    pub start: Instant,
    pub buffer: Arc<Buffer>,
}

/// A recording of all threads of the process. Dropping it discards the events.
#[derive(Debug)]
pub struct Recording {
    number: u32,
}

impl Recording {
    /// Starts a recording. There can be only one at a time.
    pub fn start() -> Result<Self, TraceError> {
        static NEXT: AtomicU32 = AtomicU32::new(1);
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        if shared.is_some() {
            return Err(TraceError::AlreadyRecording);
        }
        let number = NEXT.fetch_add(1, Ordering::Relaxed).max(1);
        *shared = Some(Shared { number, start: Instant::now(), buffers: Vec::new() });
        CURRENT.store(number, Ordering::Relaxed);
        Ok(Self { number })
    }

    /// Ends the recording and writes it in Chrome's trace event format. Open spans are omitted; requests in flight end as
    /// `unfinished`.
    pub fn write(mut self, path: &Path) -> Result<TraceSummary, TraceError> {
        let recorded = self.end();
        chrome::write(path, &recorded).map_err(|source| TraceError::Write { path: path.display().to_string(), source })
    }

    fn end(&mut self) -> Recorded {
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(mine) = shared.take_if(|s| s.number == self.number) else {
            return Recorded { ns: 0, threads: Vec::new() };
        };
        CURRENT.store(0, Ordering::Relaxed);
        drop(shared);
        let ns = since(mine.start, Instant::now());
        Recorded { ns, threads: mine.buffers.iter().map(|buffer| buffer.take()).collect() }
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        self.end();
    }
}

/// Returns the number of the current recording, or `None` without one.
#[inline]
pub(super) fn current() -> Option<u32> {
    match CURRENT.load(Ordering::Relaxed) {
        0 => None,
        number => Some(number),
    }
}

/// Returns true during a recording.
#[inline]
pub(crate) fn is_recording() -> bool {
    current().is_some()
}

/// Adds an event to the buffer of this thread, unless its recording has ended. `event` receives the start of the recording.
pub(super) fn record(recording: u32, event: impl FnOnce(Instant) -> Event) {
    // Fails while the thread is ending, when its local storage is gone.
    let _ = JOINED.try_with(|joined| {
        let Ok(mut joined) = joined.try_borrow_mut() else { return };
        if joined.as_ref().is_none_or(|j| j.recording != recording) {
            *joined = join(recording, None);
        }
        let Some(joined) = joined.as_ref() else { return };
        joined.buffer.lock().push(event(joined.start));
    });
}

/// Adds a buffer to the current recording, named `name` or like this thread.
pub(super) fn join(recording: u32, name: Option<&str>) -> Option<Joined> {
    let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
    let shared = shared.as_mut().filter(|s| s.number == recording)?;
    let number = shared.buffers.len();
    let of_thread = || std::thread::current().name().map_or_else(|| format!("thread {number}"), str::to_owned);
    let name = name.map_or_else(of_thread, str::to_owned);
    let buffer = Arc::new(Buffer::new(name));
    shared.buffers.push(buffer.clone());
    Some(Joined { recording, start: shared.start, buffer })
}
