//! [`Block`] and [`BlockCount`]: threads wait until another thread releases them.

use std::sync::PoisonError;

use super::primitives::{Condvar, Mutex, MutexGuard};

/// A gate: threads wait until it is released. It stays open until it is reset.
#[derive(Debug, Default)]
pub struct Block {
    /// True when open. Written by [`Self::set`], read by waiting threads.
    open: Mutex<bool>,
    changed: Condvar,
}

impl Block {
    /// Creates a closed block.
    pub fn new() -> Self {
        Self::default()
    }

    fn open(&self) -> MutexGuard<'_, bool> {
        // A panic cannot leave a flag half written.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until it is open.
    pub fn block(&self) {
        let mut open = self.open();
        while !*open {
            open = self.changed.wait(open).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Opens the block: all waiting threads continue, and later ones do not wait.
    pub fn release(&self) {
        self.set(true);
    }

    /// Closes the block.
    pub fn reset(&self) {
        self.set(false);
    }

    /// Opens or closes the block.
    pub fn set(&self, is_open: bool) {
        *self.open() = is_open;
        if is_open {
            self.changed.notify_all();
        }
    }
}

#[derive(Debug)]
struct Count {
    /// Number of completions that a reset sets.
    full: usize,
    /// Number of completions that are missing.
    left: usize,
    /// The block was released since the last reset.
    released: bool,
}

/// A gate that opens after a number of completions by other threads.
#[derive(Debug)]
pub struct BlockCount {
    /// Written on completion, release and reset, read by waiting threads.
    count: Mutex<Count>,
    changed: Condvar,
}

impl BlockCount {
    /// Creates a block that opens after `count` completions; it is open if that is 0.
    pub fn new(count: usize) -> Self {
        Self { count: Mutex::new(Count { full: count, left: count, released: false }), changed: Condvar::new() }
    }

    fn count(&self) -> MutexGuard<'_, Count> {
        // A panic cannot leave numbers half written.
        self.count.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Counts one completion. After the last one it does nothing.
    pub fn completed(&self) {
        let mut count = self.count();
        if count.left > 0 {
            count.left -= 1;
            if count.left == 0 {
                self.changed.notify_all();
            }
        }
    }

    /// Waits until all completions are counted. Returns false if it was released before.
    pub fn block(&self) -> bool {
        let mut count = self.count();
        while count.left > 0 {
            count = self.changed.wait(count).unwrap_or_else(PoisonError::into_inner);
        }
        !count.released
    }

    /// Releases all waiting threads without the missing completions.
    pub fn release(&self) {
        let mut count = self.count();
        (count.left, count.released) = (0, true);
        self.changed.notify_all();
    }

    /// Starts counting again.
    pub fn reset(&self) {
        let mut count = self.count();
        (count.left, count.released) = (count.full, false);
        if count.left == 0 {
            self.changed.notify_all();
        }
    }

    /// Returns the number of missing completions.
    pub fn left(&self) -> usize {
        self.count().left
    }
}
