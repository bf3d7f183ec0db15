//! [`Barrier`]: so many threads meet.

use std::sync::PoisonError;

use super::primitives::{Condvar, Mutex, MutexGuard};

#[derive(Debug)]
struct Meeting {
    /// Threads that have come.
    waiting: usize,
    /// Meetings so far: who waits goes on when it has changed, however late it wakes.
    number: u64,
    /// Nobody waits any more.
    ended: bool,
}

/// Threads wait at it until so many have come; then all go on, and it is closed for the next meeting.
#[derive(Debug)]
pub struct Barrier {
    /// Its strength.
    threads: usize,
    /// Written by all who come.
    meeting: Mutex<Meeting>,
    changed: Condvar,
}

impl Barrier {
    /// A barrier for so many threads. One or none never wait.
    pub fn new(threads: usize) -> Self {
        let meeting = Meeting { waiting: 0, number: 0, ended: false };
        Self { threads, meeting: Mutex::new(meeting), changed: Condvar::new() }
    }

    fn meeting(&self) -> MutexGuard<'_, Meeting> {
        // Nothing panics while it is locked.
        self.meeting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Threads that meet.
    pub fn strength(&self) -> usize {
        self.threads
    }

    /// Threads that wait now.
    pub fn waiting(&self) -> usize {
        self.meeting().waiting
    }

    /// Waits for the others; false when it was let go without them.
    pub fn block(&self) -> bool {
        let mut meeting = self.meeting();
        if meeting.ended {
            return false;
        }
        meeting.waiting += 1;
        if meeting.waiting >= self.threads {
            meeting.waiting = 0;
            meeting.number += 1;
            self.changed.notify_all();
            return true;
        }
        let number = meeting.number;
        while meeting.number == number && !meeting.ended {
            meeting = self.changed.wait(meeting).unwrap_or_else(PoisonError::into_inner);
        }
        meeting.number != number
    }

    /// Ends all meetings: who waits goes on, and nobody waits here again. For stopping threads, of which some may be
    /// on their way to it.
    pub fn release(&self) {
        let mut meeting = self.meeting();
        meeting.ended = true;
        meeting.waiting = 0;
        self.changed.notify_all();
    }
}
