//! Runs work that may hang, such as a read from a network drive whose server is gone, without hanging with it. Such work
//! cannot be stopped: its thread continues. Any thread.

use std::cell::RefCell;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::error::IoError;

/// The number of works of one [`DiskThread`] that may hang at once. The pager's file threads have a limit of their own.
const MAX_HUNG_WORKS: usize = 3;

/// Runs work on a new thread and waits for it. Returns `None` if it takes longer than `limit`, or if the system starts no more
/// threads.
pub(crate) fn run_within<T: Send + 'static>(limit: Duration, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
    let (sender, receiver) = sync_channel(1);
    let run = move || {
        // Fails only if the caller has stopped waiting.
        let _ = sender.send(work());
    };
    spawn(run)?;
    receiver.recv_timeout(limit).ok()
}

fn spawn(run: impl FnOnce() + Send + 'static) -> Option<JoinHandle<()>> {
    std::thread::Builder::new().name("disk".to_owned()).spawn(run).ok()
}

type Work = Box<dyn FnOnce() + Send>;

/// A thread that does one work after another for a caller that waits for each, at less cost than a thread for each. A work that
/// hangs is an error after a time limit, and another thread takes the place of its own. While [`MAX_HUNG_WORKS`] of them hang,
/// further works fail at once, so that a large set on a broken disk comes to an end.
#[derive(Debug)]
pub(super) struct DiskThread {
    limit: Duration,
    /// `None` before the first work and after one that hung.
    thread: RefCell<Option<(Sender<Work>, JoinHandle<()>)>>,
    /// Threads whose work took too long; it may have ended since.
    hung: RefCell<Vec<JoinHandle<()>>>,
}

impl DiskThread {
    /// Starts no thread yet.
    pub fn new(limit: Duration) -> Self {
        Self { limit, thread: RefCell::default(), hung: RefCell::default() }
    }

    /// Does work on a file.
    ///
    /// # Errors
    /// [`IoError::Timeout`] if it takes longer than the limit, [`IoError::File`] while too many others hang. Else those of the
    /// work.
    pub fn run<T: Send + 'static>(
        &self,
        uri: &str,
        work: impl FnOnce() -> Result<T, IoError> + Send + 'static,
    ) -> Result<T, IoError> {
        let failed = |reason: String| IoError::File { uri: uri.to_owned(), reason, may_pass: true };
        let mut hung = self.hung.borrow_mut();
        hung.retain(|thread| !thread.is_finished());
        if hung.len() >= MAX_HUNG_WORKS {
            let seconds = self.limit.as_secs_f64();
            return Err(failed(format!("not read, since {MAX_HUNG_WORKS} other files take longer than {seconds} s")));
        }
        let (answer, answered) = sync_channel(1);
        let mut work: Work = Box::new(move || {
            // Fails only if the caller has stopped waiting.
            let _ = answer.send(work());
        });
        let mut current = self.thread.borrow_mut();
        // A thread ends only with its channel, unless its work panics.
        if let Some((works, _)) = &*current {
            match works.send(work) {
                Ok(()) => work = Box::new(|| ()),
                Err(unsent) => (work, *current) = (unsent.0, None),
            }
        }
        if current.is_none() {
            let (works, to_do) = channel::<Work>();
            let run = move || to_do.into_iter().for_each(|work| work());
            let thread = spawn(run).ok_or_else(|| failed("the system starts no more threads".to_owned()))?;
            // The receiver is on the thread.
            let _ = works.send(work);
            *current = Some((works, thread));
        }
        match answered.recv_timeout(self.limit) {
            Ok(done) => done,
            Err(RecvTimeoutError::Timeout) => {
                hung.extend(current.take().map(|(_, thread)| thread));
                Err(IoError::file_timeout(uri, self.limit))
            }
            Err(RecvTimeoutError::Disconnected) => {
                *current = None;
                Err(failed("its reader panicked".to_owned()))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: Duration = Duration::from_millis(20);

    #[test]
    fn hung_work_is_left_alone() {
        assert_eq!(run_within(Duration::from_secs(60), || 1), Some(1));
        let (release, hangs) = channel::<()>();
        assert_eq!(run_within(SHORT, move || hangs.recv().is_err()), None);
        drop(release);
    }

    #[test]
    fn few_works_hang_before_others_fail_at_once() {
        let quick = DiskThread::new(Duration::from_secs(60));
        let thread = || std::thread::current().id();
        let first = quick.run("a", move || Ok(thread()));
        assert_eq!(quick.run("a", move || Ok(thread())), first, "one thread does all work");
        let disk = DiskThread::new(SHORT);
        let mut releases = Vec::new();
        for _ in 0..MAX_HUNG_WORKS {
            let (release, hangs) = channel::<()>();
            let error = disk.run("b", move || Ok(hangs.recv().is_err())).unwrap_err();
            assert_eq!(error.to_string(), "b: timed out after 0.02 s (reading the file)");
            releases.push(release);
        }
        let error = disk.run("c", || Ok(1)).unwrap_err();
        assert_eq!(error.to_string(), "c: not read, since 3 other files take longer than 0.02 s");
        // The disk comes back.
        drop(releases.pop());
        while disk.hung.borrow().iter().all(|thread| !thread.is_finished()) {
            std::thread::yield_now();
        }
        assert_eq!(DiskThread { limit: Duration::from_secs(60), ..disk }.run("d", || Ok(1)), Ok(1));
    }
}
