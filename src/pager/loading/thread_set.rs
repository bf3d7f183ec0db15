//! Named threads that are joined on drop.

use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use thread_priority::{ThreadPriority, ThreadPriorityValue};

use crate::pager::config::PagerError;

/// How often a join with a time limit looks whether the threads have ended.
const JOIN_INTERVAL: Duration = Duration::from_millis(1);

/// Threads of a pager. Dropping the set joins them; the owner must end their work before, by closing what they wait for.
#[derive(Default)]
pub(super) struct ThreadSet {
    handles: Vec<JoinHandle<()>>,
}

impl ThreadSet {
    /// Starts a thread that runs at a lower priority than the threads of the frame.
    ///
    /// # Errors
    /// [`PagerError::Thread`] if the system starts no more threads.
    pub fn spawn(&mut self, name: String, run: impl FnOnce() + Send + 'static) -> Result<(), PagerError> {
        let builder = std::thread::Builder::new().name(name.clone());
        let run = || {
            lower_priority();
            run();
        };
        let handle = builder.spawn(run).map_err(|source| PagerError::Thread { name, source })?;
        self.handles.push(handle);
        Ok(())
    }
}

impl ThreadSet {
    /// Joins the threads that end within a time, and leaves the others to themselves.
    pub fn join_within(&mut self, timeout: Duration) {
        let begun = Instant::now();
        while begun.elapsed() < timeout && !self.handles.iter().all(JoinHandle::is_finished) {
            std::thread::sleep(JOIN_INTERVAL);
        }
        for handle in self.handles.drain(..) {
            match handle.is_finished() {
                true => join(handle),
                false => log::warn!("{} hangs on a file and is left alone", name_of(&handle)),
            }
        }
    }
}

impl Drop for ThreadSet {
    fn drop(&mut self) {
        self.handles.drain(..).for_each(join);
    }
}

fn join(handle: JoinHandle<()>) {
    let name = name_of(&handle);
    if handle.join().is_err() {
        log::error!("{name} panicked");
    }
}

fn name_of(handle: &JoinHandle<()>) -> String {
    handle.thread().name().unwrap_or("a pager thread").to_owned()
}

/// Lowers the priority of the calling thread: there is a decode thread for each core, and a frame that wakes one of its
/// threads must not wait for them.
fn lower_priority() {
    // Nice 9 on Linux: a tenth of the weight of a thread that draws.
    let below_normal = ThreadPriorityValue::try_from(25u8).map(ThreadPriority::Crossplatform);
    let lowered = below_normal.map(thread_priority::set_current_thread_priority);
    if !matches!(lowered, Ok(Ok(()))) {
        log::debug!("could not lower the priority of thread {:?}: {lowered:?}", std::thread::current().name());
    }
}
