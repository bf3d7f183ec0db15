//! Moves work that may block off the HTTP thread. Work on the disk of the cache, which may hang, is limited to a few threads.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Semaphore;

use crate::fetch::{IoError, run_within};

/// Larger bodies are decompressed on a blocking thread, so that the HTTP thread keeps serving its connections.
pub(in crate::fetch) const MAX_INLINE_BYTES: usize = 4 << 10;
/// Blocking threads of a runtime that work on the disk of the cache.
const MAX_DISK_THREADS: usize = 4;
/// Blocking threads of a runtime. As many as work on a disk are always left for decompression and name resolution.
pub(super) const MAX_BLOCKING_THREADS: usize = 2 * MAX_DISK_THREADS;

/// How long threads outside of the runtime wait for work on a disk; the end of the pager waits for them.
const MAX_WAIT: Duration = Duration::from_secs(1);

/// Runs work on one of the runtime's blocking threads.
pub(in crate::fetch) async fn run_blocking<T: Send + 'static>(
    uri: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, IoError> {
    let failed = |_| IoError::Network { uri: uri.to_owned(), reason: "its worker thread panicked".to_owned() };
    tokio::task::spawn_blocking(work).await.map_err(failed)
}

/// Runs work on a disk that may hang, such as a network drive whose server is gone. Such work cannot be stopped: its thread
/// hangs with it. So few threads do it, and no more work begins until the work that hangs has ended. Cheap to clone.
#[derive(Clone, Debug)]
pub(super) struct DiskWork {
    limit: Duration,
    /// Holds one permit for each thread.
    threads: Arc<Semaphore>,
    /// When each work began that is on a thread. Locked briefly.
    begun: Arc<Mutex<Vec<Instant>>>,
}

impl DiskWork {
    /// Work that takes longer than `limit` counts as hung.
    pub fn new(limit: Duration) -> Self {
        Self { limit, threads: Arc::new(Semaphore::new(MAX_DISK_THREADS)), begun: Arc::default() }
    }

    /// Returns the time limit.
    pub fn limit(&self) -> Duration {
        self.limit
    }

    /// Returns true while any work takes longer than the limit.
    pub fn is_hung(&self) -> bool {
        lock(&self.begun).iter().any(|begun| begun.elapsed() >= self.limit)
    }

    /// Runs work on a blocking thread. Returns `None` if the disk hangs; the work may still end later.
    pub async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
        if self.is_hung() {
            return None;
        }
        let done = async {
            // Fails only for a closed semaphore, and this one is never closed.
            let thread = self.threads.clone().acquire_owned().await.ok()?;
            let begun = Begun::now(&self.begun);
            let work = move || {
                let _until_done = (thread, begun);
                work()
            };
            // Work that panics has no result.
            tokio::task::spawn_blocking(work).await.ok()
        };
        tokio::time::timeout(self.limit, done).await.ok()?
    }

    /// Runs work on a new thread and waits for it up to [`MAX_WAIT`]. For callers outside of the runtime. Returns `None` if the
    /// disk hangs, or if the work continues without the caller.
    pub fn run_now<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
        if self.is_hung() {
            return None;
        }
        let begun = Begun::now(&self.begun);
        let work = move || {
            let _until_done = begun;
            work()
        };
        run_within(self.limit.min(MAX_WAIT), work)
    }
}

fn lock(begun: &Mutex<Vec<Instant>>) -> MutexGuard<'_, Vec<Instant>> {
    begun.lock().unwrap_or_else(PoisonError::into_inner)
}

/// An entry in the list of work, until it is dropped.
struct Begun {
    at: Instant,
    list: Arc<Mutex<Vec<Instant>>>,
}

impl Begun {
    fn now(list: &Arc<Mutex<Vec<Instant>>>) -> Self {
        let at = Instant::now();
        lock(list).push(at);
        Self { at, list: list.clone() }
    }
}

impl Drop for Begun {
    fn drop(&mut self) {
        let mut list = lock(&self.list);
        if let Some(index) = list.iter().position(|at| *at == self.at) {
            list.swap_remove(index);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    const LIMIT: Duration = Duration::from_millis(100);

    /// Waiters may be gone before the limit, since requests are aborted; the disk hangs all the same.
    #[test]
    fn hung_work_is_left_alone_until_it_ends() {
        let runtime = super::super::runtime("test").unwrap();
        let disk = DiskWork::new(LIMIT);
        let (release, hangs) = channel::<()>();
        runtime.block_on(async {
            assert_eq!(disk.run(|| 1).await, Some(1));
            let hung = disk.run(move || hangs.recv().is_err());
            assert!(tokio::time::timeout(LIMIT / 10, hung).await.is_err(), "aborted");
            assert_eq!(disk.run(|| 2).await, Some(2), "not yet hung");
            tokio::time::sleep(LIMIT).await;
            let start = Instant::now();
            assert!(disk.is_hung() && disk.run(|| 3).await.is_none() && start.elapsed() < LIMIT / 2);
            drop(release);
            while disk.is_hung() {
                tokio::time::sleep(LIMIT / 100).await;
            }
            assert_eq!(disk.run(|| 4).await, Some(4));
        });
    }

    #[test]
    fn hung_disk_leaves_threads_for_other_work() {
        let runtime = super::super::runtime("test").unwrap();
        let disk = DiskWork::new(LIMIT);
        let releases: Vec<_> = runtime.block_on(async {
            let mut works = tokio::task::JoinSet::new();
            let releases = (0..20).map(|_| {
                let (release, hangs) = channel::<()>();
                let disk = disk.clone();
                works.spawn(async move { disk.run(move || hangs.recv().is_err()).await });
                release
            });
            let releases = releases.collect();
            assert!(works.join_all().await.iter().all(Option::is_none));
            assert_eq!(run_blocking("http://h/a", || 1).await, Ok(1));
            releases
        });
        // Dropping the runtime would wait for threads that hang.
        drop(releases);
    }
}
