//! Named threads that are joined on drop.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use core_affinity::CoreId;
use thread_priority::{ThreadPriority, ThreadPriorityValue};

use crate::pager::config::PagerError;

/// The core of a set that runs on any core.
const ANY_CORE: usize = usize::MAX;
/// How often a join with a time limit looks whether the threads have ended.
const JOIN_INTERVAL: Duration = Duration::from_millis(1);

/// Threads of a pager. Dropping the set joins them; the owner must end their work before, by closing what they wait for.
pub(in crate::pager) struct ThreadSet {
    handles: Vec<JoinHandle<()>>,
    /// The core that the threads should run on. Written by the owner, read by the threads before each job.
    core: Arc<AtomicUsize>,
}

impl Default for ThreadSet {
    fn default() -> Self {
        Self { handles: Vec::new(), core: Arc::new(AtomicUsize::new(ANY_CORE)) }
    }
}

/// The core of the set that a thread belongs to, and the core to which the thread is pinned.
struct Followed {
    core: Arc<AtomicUsize>,
    pinned: usize,
}

thread_local! {
    static FOLLOWED: RefCell<Option<Followed>> = const { RefCell::new(None) };
}

/// Pins the calling thread of a set to the core that was set since the last call. Called before each job.
pub(super) fn follow_core() {
    FOLLOWED.with_borrow_mut(|followed| {
        let Some(Followed { core, pinned }) = followed else { return };
        let wanted = core.load(Ordering::Relaxed);
        if wanted != *pinned {
            *pinned = wanted;
            if !core_affinity::set_for_current(CoreId { id: wanted }) {
                log::warn!("cannot pin thread {:?} to core {wanted}", std::thread::current().name());
            }
        }
    });
}

impl ThreadSet {
    /// Starts a thread that runs at a lower priority than the threads of the frame.
    ///
    /// # Errors
    /// [`PagerError::Thread`] if the system starts no more threads.
    pub fn spawn(&mut self, name: String, run: impl FnOnce() + Send + 'static) -> Result<(), PagerError> {
        let builder = std::thread::Builder::new().name(name.clone());
        let core = self.core.clone();
        let run = || {
            lower_priority();
            FOLLOWED.set(Some(Followed { core, pinned: ANY_CORE }));
            run();
        };
        let handle = builder.spawn(run).map_err(|source| PagerError::Thread { name, source })?;
        self.handles.push(handle);
        Ok(())
    }

    /// Pins the threads to a core, each before its next job.
    pub fn set_core(&self, core: usize) {
        self.core.store(core, Ordering::Relaxed);
    }

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
