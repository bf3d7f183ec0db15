//! [`Block`] and [`BlockCount`]: threads wait until others let them go on.

use std::sync::PoisonError;
use std::time::Duration;

use super::primitives::{Condvar, Mutex, MutexGuard};

/// Threads wait at it until it is released; then it stays open until it is reset.
#[derive(Debug, Default)]
pub struct Block {
    /// True: open. Written by whoever releases and resets, read by who waits.
    open: Mutex<bool>,
    changed: Condvar,
}

impl Block {
    /// A closed one.
    pub fn new() -> Self {
        Self::default()
    }

    fn open(&self) -> MutexGuard<'_, bool> {
        // A flag cannot be left half written by a panic.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until it is open.
    pub fn block(&self) {
        let mut open = self.open();
        while !*open {
            open = self.changed.wait(open).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Waits until it is open, at most so long; whether it was.
    pub fn block_for(&self, patience: Duration) -> bool {
        let waited = self.changed.wait_timeout_while(self.open(), patience, |open| !*open);
        *waited.unwrap_or_else(PoisonError::into_inner).0
    }

    /// Opens it: all who wait go on, and all who come.
    pub fn release(&self) {
        self.set(true);
    }

    /// Closes it.
    pub fn reset(&self) {
        self.set(false);
    }

    /// Opens or closes it.
    pub fn set(&self, is_open: bool) {
        *self.open() = is_open;
        if is_open {
            self.changed.notify_all();
        }
    }
}

#[derive(Debug)]
struct Count {
    /// What a reset starts from.
    full: usize,
    /// Completions still to come.
    left: usize,
    /// Let go since the last reset.
    released: bool,
}

/// Threads wait at it until others have completed something so many times.
#[derive(Debug)]
pub struct BlockCount {
    /// Written by who completes, releases and resets, read by who waits.
    count: Mutex<Count>,
    changed: Condvar,
}

impl BlockCount {
    /// Opens after `count` completions; at once for 0.
    pub fn new(count: usize) -> Self {
        Self { count: Mutex::new(Count { full: count, left: count, released: false }), changed: Condvar::new() }
    }

    fn count(&self) -> MutexGuard<'_, Count> {
        // Numbers cannot be left half written by a panic.
        self.count.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// One less to wait for. Beyond the last it does nothing.
    pub fn completed(&self) {
        let mut count = self.count();
        if count.left > 0 {
            count.left -= 1;
            if count.left == 0 {
                self.changed.notify_all();
            }
        }
    }

    /// Waits until nothing is left to be completed; false when it was let go without the rest.
    pub fn block(&self) -> bool {
        let mut count = self.count();
        while count.left > 0 {
            count = self.changed.wait(count).unwrap_or_else(PoisonError::into_inner);
        }
        !count.released
    }

    /// Lets go on without waiting for the rest.
    pub fn release(&self) {
        let mut count = self.count();
        (count.left, count.released) = (0, true);
        self.changed.notify_all();
    }

    /// Starts counting anew.
    pub fn reset(&self) {
        let mut count = self.count();
        (count.left, count.released) = (count.full, false);
        if count.left == 0 {
            self.changed.notify_all();
        }
    }

    /// Completions that a reset waits for, from the next reset on.
    pub fn set_block_count(&self, count: usize) {
        self.count().full = count;
    }

    /// Completions still to come.
    pub fn left(&self) -> usize {
        self.count().left
    }
}
