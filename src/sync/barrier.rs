//! [`Barrier`]: a number of threads wait for each other.

use std::sync::PoisonError;

use super::primitives::{Condvar, Mutex, MutexGuard};

#[derive(Debug)]
struct State {
    /// Threads that wait for the current generation.
    waiting: usize,
    /// Number of times that the barrier opened. A waiting thread continues when it has changed, however late it wakes.
    generation: u64,
    /// The barrier was released: threads no longer wait.
    released: bool,
}

/// A reusable barrier: threads wait until a given number of them has arrived. Then all continue, and the barrier is closed
/// again.
#[derive(Debug)]
pub struct Barrier {
    /// Number of threads that open the barrier.
    threads: usize,
    /// Read and written by all threads that arrive.
    state: Mutex<State>,
    changed: Condvar,
}

impl Barrier {
    /// Creates a barrier for a number of threads. With one or none no thread waits.
    pub fn new(threads: usize) -> Self {
        let state = State { waiting: 0, generation: 0, released: false };
        Self { threads, state: Mutex::new(state), changed: Condvar::new() }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // No code panics while it holds the lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the number of threads that open the barrier.
    pub fn strength(&self) -> usize {
        self.threads
    }

    /// Returns the number of threads that wait now.
    pub fn waiting(&self) -> usize {
        self.state().waiting
    }

    /// Waits for the other threads. Returns false if the barrier was released before all had arrived.
    pub fn block(&self) -> bool {
        let mut state = self.state();
        if state.released {
            return false;
        }
        state.waiting += 1;
        if state.waiting >= self.threads {
            state.waiting = 0;
            state.generation += 1;
            self.changed.notify_all();
            return true;
        }
        let generation = state.generation;
        while state.generation == generation && !state.released {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        state.generation != generation
    }

    /// Releases all waiting threads, and those that arrive later, for good. For stopping threads, some of which may not have
    /// arrived yet.
    pub fn release(&self) {
        let mut state = self.state();
        state.released = true;
        state.waiting = 0;
        self.changed.notify_all();
    }
}
