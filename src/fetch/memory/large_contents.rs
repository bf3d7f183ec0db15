//! [`LargeContents`]: contents that take much memory are decoded one after another. Decode threads.
//!
//! A file of some kilobytes may unfold to gigabytes, and several decode threads may have such files at once. So decoders call
//! [`about_to_allocate`] before they allocate, or read through [`gated`]. The bytes come from those that the content's load has
//! reserved, then from those that are free in the budget (a content that is alone finds any number free), then from an allowance
//! of [`MAX_BEYOND`] bytes. A content that needs more waits for its turn. It keeps the turn until update has used or dropped
//! its page, so that large pages do not pile up either.
//!
//! There is no deadlock: the content that has its turn waits for nothing more, so that its decoder always finishes, and update
//! uses and drops pages without waiting for a load. The count is thread-local, since one thread decodes a content from its
//! bytes to its page. On other threads nothing is counted.

use std::cell::RefCell;
use std::io::{self, Read};

use super::byte_budget::Permit;
use super::content_budget::{self, ContentTooLarge};
use crate::sync::primitives::{Arc, Condvar, Mutex, MutexGuard};
use crate::trace;

/// The bytes that each decoder may allocate beyond the budget before it waits for its turn. Ordinary contents stay below it.
const MAX_BEYOND: u64 = 32 << 20;
/// [`Gated`] counts in steps of this many bytes.
const STEP_BYTES: u64 = 1 << 20;

/// Lets one content at a time take more memory than is free. Clones share the turn.
#[derive(Clone, Debug, Default)]
pub(crate) struct LargeContents(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    /// Notified when a turn ends.
    ended: Condvar,
}

#[derive(Debug, Default)]
struct State {
    /// A content has its turn.
    is_taken: bool,
    /// Nothing waits any more.
    is_closed: bool,
}

/// The turn of a content, which ends when this is dropped.
#[derive(Debug)]
struct Turn(LargeContents);

/// The memory of a content that was decoded: its bytes of the budget, and its turn if it had one.
#[derive(Debug)]
pub(crate) struct ContentMemory {
    permit: Permit,
    _turn: Option<Turn>,
}

/// The memory that the thread's decoder has taken for its content.
struct Taken {
    permit: Permit,
    large: LargeContents,
    /// Bytes beyond the budget.
    beyond: u64,
    turn: Option<Turn>,
}

thread_local! {
    static TAKEN: RefCell<Option<Taken>> = const { RefCell::new(None) };
}

impl LargeContents {
    /// Runs a decoder on this thread and counts what it allocates, from the bytes of `permit` on. The memory belongs to the
    /// content.
    pub fn decode<T>(&self, permit: Permit, decode: impl FnOnce() -> T) -> (T, ContentMemory) {
        /// Ends the count, also if the decoder panics.
        struct End;
        impl Drop for End {
            fn drop(&mut self) {
                TAKEN.set(None);
            }
        }
        TAKEN.set(Some(Taken { permit: permit.clone(), large: self.clone(), beyond: 0, turn: None }));
        let _end = End;
        let content = decode();
        (content, ContentMemory { permit, _turn: TAKEN.take().and_then(|taken| taken.turn) })
    }

    /// Lets all threads go on that wait, for their end.
    pub fn close(&self) {
        self.lock().is_closed = true;
        self.0.ended.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    fn take_turn(&self) -> Turn {
        let _span = trace::span("wait to decode a large content");
        let mut state = self.lock();
        while state.is_taken && !state.is_closed {
            state = self.0.ended.wait(state).unwrap_or_else(std::sync::PoisonError::into_inner);
        }
        state.is_taken = true;
        Turn(self.clone())
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        self.0.lock().is_taken = false;
        self.0.0.ended.notify_one();
    }
}

impl ContentMemory {
    /// Holds exactly this many bytes of the budget from now on, as [`Permit::set_bytes`].
    pub fn set_bytes(&self, bytes: u64) {
        self.permit.set_bytes(bytes);
    }
}

impl Taken {
    fn add(&mut self, bytes: u64) {
        if self.turn.is_some() {
            return;
        }
        match self.permit.claim(bytes) {
            Ok(claim) => claim.keep(bytes),
            Err(_) => self.beyond = self.beyond.saturating_add(bytes),
        }
        if self.beyond > MAX_BEYOND {
            self.turn = Some(self.large.take_turn());
        }
    }
}

/// Counts bytes that a decoder is about to allocate. Blocks while the content is beyond its share and another one has the turn.
///
/// # Errors
/// [`ContentTooLarge`] if that is more than one content may take. The decoder must not allocate then.
pub(crate) fn about_to_allocate(bytes: u64) -> Result<(), ContentTooLarge> {
    content_budget::ask(bytes)?;
    TAKEN.with_borrow_mut(|taken| {
        if let Some(taken) = taken {
            taken.add(bytes);
        }
    });
    Ok(())
}

/// Returns a reader whose bytes are counted as they are read; for decompressors.
pub(crate) fn gated<R: Read>(reader: R) -> impl Read {
    Gated { reader, left: 0 }
}

struct Gated<R> {
    reader: R,
    /// Bytes that are counted already, and not read yet.
    left: u64,
}

impl<R: Read> Read for Gated<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let read = self.reader.read(bytes)? as u64;
        if read > self.left {
            about_to_allocate(read.max(STEP_BYTES))?;
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
            about_to_allocate(bytes).unwrap();
            budget.total().bytes
        };
        let (all, memory) = large.decode(permit, || [used(15), used(15), used(30), used(20)]);
        assert_eq!(all, [60, 70, 100, 100]);
        assert_eq!(used(10), 100, "nothing is counted behind the decoder");
        memory.set_bytes(7);
        assert_eq!(budget.total().bytes, 47);
        drop(memory);
        assert_eq!(budget.total().bytes, 40);
    }

    #[test]
    fn large_contents_are_decoded_and_used_one_at_a_time() {
        let (budget, _held) = full();
        let large = LargeContents::default();
        let (say, said) = mpsc::channel();
        let decoder = |name: &'static str| {
            let (large, permit, say) = (large.clone(), budget.hold(0), say.clone());
            thread::spawn(move || {
                let decode = || {
                    about_to_allocate(MAX_BEYOND).unwrap();
                    say.send((name, "small")).unwrap();
                    about_to_allocate(1).unwrap();
                    say.send((name, "large")).unwrap();
                    // A content that has its turn never waits again.
                    about_to_allocate(1 << 30).unwrap();
                };
                large.decode(permit, decode).1
            })
        };
        let first = decoder("first").join().unwrap();
        let second = decoder("second");
        let before: Vec<_> = (0..3).map(|_| said.recv().unwrap()).collect();
        assert_eq!(before, [("first", "small"), ("first", "large"), ("second", "small")]);
        assert!(said.try_recv().is_err(), "the first is decoded, and still there");
        drop(first);
        assert_eq!(said.recv().unwrap(), ("second", "large"));
        // The end of the threads does not wait for what update holds.
        let _second = second.join().unwrap();
        large.close();
        decoder("third").join().unwrap();
    }

    #[test]
    fn turn_ends_with_a_decoder_that_panics() {
        let (budget, _held) = full();
        let large = LargeContents::default();
        for _ in 0..2 {
            let permit = budget.hold(0);
            let decode = std::panic::AssertUnwindSafe(|| {
                large.decode(permit, || {
                    about_to_allocate(MAX_BEYOND + 1).unwrap();
                    std::panic::resume_unwind(Box::new("stops"));
                })
            });
            assert!(std::panic::catch_unwind(decode).is_err());
        }
    }

    #[test]
    fn decompressed_bytes_are_counted_in_steps() {
        let (budget, large) = (ByteBudget::new(u64::MAX), LargeContents::default());
        let mut read = Vec::new();
        let unfold = || gated(io::repeat(7).take(5 * STEP_BYTES / 2)).read_to_end(&mut read);
        let (_, _memory) = large.decode(budget.hold(0), unfold);
        assert_eq!(read.len() as u64, 5 * STEP_BYTES / 2);
        let used = budget.total().bytes;
        assert!((5 * STEP_BYTES / 2..=4 * STEP_BYTES).contains(&used), "{used}");
    }
}
