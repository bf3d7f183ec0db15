//! [`LargeContents`]: decodes contents that take much memory one at a time. Decode threads.
//!
//! A file of some kilobytes may unfold to gigabytes, and several decode threads may meet such files at once. So decoders say
//! what they are about to allocate ([`about_to_allocate`]). It is counted for the content that the thread decodes: against the
//! bytes that its load has reserved, then against those that are free in the budget. A content that finds
//! no more free may take [`MAX_BEYOND`] bytes beyond, and then waits until it is the only one that takes more.
//!
//! Who waits holds bytes of the budget, and nothing that another decoder needs: who is the only one takes memory without asking
//! the budget, so that it always comes to its end. No decoder has to pass the count on, since a content is decoded by one
//! thread. On other threads nothing is counted.

use std::cell::RefCell;
use std::io::{self, Read};

use super::byte_budget::Permit;
use crate::sync::primitives::{Arc, Condvar, Mutex};
use crate::trace;

/// The bytes that each decoder may allocate beyond the budget before it waits for its turn. The contents of real sets take
/// less.
const MAX_BEYOND: u64 = 32 << 20;
/// [`Gated`] counts in steps of this many bytes.
const STEP_BYTES: u64 = 1 << 20;

/// The turn of contents that take more memory than is free. Clones share it.
#[derive(Clone, Debug, Default)]
pub(crate) struct LargeContents(Arc<Turn>);

#[derive(Debug, Default)]
struct Turn {
    /// A content has its turn.
    is_taken: Mutex<bool>,
    /// Notified when it ends.
    ended: Condvar,
}

/// The memory that the thread's decoder has taken for its content.
struct Taken {
    permit: Permit,
    large: LargeContents,
    /// Bytes beyond the budget.
    beyond: u64,
    has_turn: bool,
}

thread_local! {
    static TAKEN: RefCell<Option<Taken>> = const { RefCell::new(None) };
}

impl LargeContents {
    /// Runs a decoder on this thread and counts what it allocates, from the bytes of `permit` on.
    pub fn decode<T>(&self, permit: &Permit, decode: impl FnOnce() -> T) -> T {
        /// Ends the count, also if the decoder panics.
        struct End;
        impl Drop for End {
            fn drop(&mut self) {
                TAKEN.set(None);
            }
        }
        TAKEN.set(Some(Taken { permit: permit.clone(), large: self.clone(), beyond: 0, has_turn: false }));
        let _end = End;
        decode()
    }

    fn take_turn(&self) {
        let _span = trace::span("wait to decode a large content");
        let mut is_taken = self.0.is_taken.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        while *is_taken {
            is_taken = self.0.ended.wait(is_taken).unwrap_or_else(std::sync::PoisonError::into_inner);
        }
        *is_taken = true;
    }

    fn end_turn(&self) {
        *self.0.is_taken.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = false;
        self.0.ended.notify_one();
    }
}

impl Taken {
    fn add(&mut self, bytes: u64) {
        if self.has_turn {
            return;
        }
        match self.permit.claim(bytes) {
            Ok(claim) => claim.keep(bytes),
            Err(_) => self.beyond = self.beyond.saturating_add(bytes),
        }
        if self.beyond > MAX_BEYOND {
            self.large.take_turn();
            self.has_turn = true;
        }
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        if self.has_turn {
            self.large.end_turn();
        }
    }
}

/// Counts bytes that a decoder is about to allocate. Blocks while they are too many and another large content is being decoded.
pub(crate) fn about_to_allocate(bytes: u64) {
    TAKEN.with_borrow_mut(|taken| {
        if let Some(taken) = taken {
            taken.add(bytes);
        }
    });
}

/// A reader that decompresses, whose bytes are counted before they are kept.
pub(crate) fn gated<R: Read>(reader: R) -> impl Read {
    Gated { reader, left: 0 }
}

struct Gated<R> {
    reader: R,
    /// Bytes that are counted and not read.
    left: u64,
}

impl<R: Read> Read for Gated<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.reader.read(bytes)? as u64;
        if read > self.left {
            about_to_allocate(read.max(STEP_BYTES));
            self.left += read.max(STEP_BYTES);
        }
        self.left -= read;
        Ok(read as usize)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::thread;

    use super::super::ByteBudget;
    use super::*;

    /// Returns a budget of a hundred bytes that are in use, and what uses them.
    fn full() -> (ByteBudget, Permit) {
        let budget = ByteBudget::new(100);
        let held = budget.hold(100);
        (budget, held)
    }

    #[test]
    fn bytes_are_those_of_the_load_and_then_of_the_budget() {
        let budget = ByteBudget::new(100);
        let (_held, permit, large) = (budget.hold(40), budget.reserve_blocking(20, false), LargeContents::default());
        let used = |bytes| {
            about_to_allocate(bytes);
            budget.total().bytes
        };
        assert_eq!(large.decode(&permit, || [used(15), used(15), used(30), used(20)]), [60, 70, 100, 100]);
        assert_eq!(used(10), 100, "nothing is counted behind the decoder");
        // The load sets what its content takes.
        permit.set_bytes(7);
        assert_eq!(budget.total().bytes, 47);
    }

    #[test]
    fn one_large_content_at_a_time_is_decoded() {
        let (budget, _held) = full();
        let large = LargeContents::default();
        let (say, said) = mpsc::channel();
        let (go, wait) = mpsc::channel::<()>();
        let decoder = |name: &'static str, wait: Option<mpsc::Receiver<()>>| {
            let (large, permit, say) = (large.clone(), budget.hold(0), say.clone());
            thread::spawn(move || {
                large.decode(&permit, || {
                    about_to_allocate(MAX_BEYOND);
                    say.send((name, "small")).unwrap();
                    about_to_allocate(1);
                    say.send((name, "large")).unwrap();
                    wait.map(|wait| wait.recv());
                    // Its own turn is no obstacle.
                    about_to_allocate(1 << 30);
                    say.send((name, "ends")).unwrap();
                });
            })
        };
        let first = decoder("first", Some(wait));
        assert_eq!([said.recv().unwrap(), said.recv().unwrap()], [("first", "small"), ("first", "large")]);
        let second = decoder("second", None);
        assert_eq!(said.recv().unwrap(), ("second", "small"));
        go.send(()).unwrap();
        let rest: Vec<_> = (0..3).map(|_| said.recv().unwrap()).collect();
        assert_eq!(rest, [("first", "ends"), ("second", "large"), ("second", "ends")]);
        first.join().unwrap();
        second.join().unwrap();
    }

    #[test]
    fn turn_ends_with_a_decoder_that_panics() {
        let (budget, _held) = full();
        let (large, permit) = (LargeContents::default(), budget.hold(0));
        for _ in 0..2 {
            let decode = std::panic::AssertUnwindSafe(|| {
                large.decode(&permit, || {
                    about_to_allocate(MAX_BEYOND + 1);
                    std::panic::resume_unwind(Box::new("stops"));
                })
            });
            assert!(std::panic::catch_unwind(decode).is_err());
        }
    }

    #[test]
    fn decompressed_bytes_are_counted_in_steps() {
        let (budget, large) = (ByteBudget::new(u64::MAX), LargeContents::default());
        let permit = budget.hold(0);
        let mut read = Vec::new();
        large.decode(&permit, || gated(io::repeat(7).take(5 * STEP_BYTES / 2)).read_to_end(&mut read)).unwrap();
        assert_eq!(read.len() as u64, 5 * STEP_BYTES / 2);
        let used = budget.total().bytes;
        assert!((5 * STEP_BYTES / 2..=4 * STEP_BYTES).contains(&used), "{used}");
    }
}
