//! The memory that one content may take: asked by its decoder before each allocation that a file's numbers decide. Any thread.
//!
//! [`limited`] runs a decoder with a budget, and only [`ask`] grants or refuses bytes. The count is of all that
//! was asked for, whether or not it was freed meanwhile, so that it bounds the peak. It is thread-local, since one thread
//! decodes a content from its bytes to its page; outside of [`limited`] any number is granted.
//!
//! A refusal is final. Readers leave out images and primitives that fail, but a content that went beyond its budget fails as a
//! whole, with an error that names it, the bytes and the limit.

use std::cell::Cell;

thread_local! {
    static BUDGET: Cell<Option<Budget>> = const { Cell::new(None) };
}

/// The budget of the content that this thread decodes.
#[derive(Clone, Copy)]
struct Budget {
    limit: u64,
    /// Bytes that were asked for, those that were refused included.
    asked: u64,
}

/// A content asked for more memory than one content may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{} is {asked}, the limit is {limit}", Self::WHAT)]
pub(crate) struct ContentTooLarge {
    /// Bytes that the content asked for so far.
    pub asked: u64,
    /// The bytes that one content may take.
    pub limit: u64,
}

impl ContentTooLarge {
    /// Names the limit in errors.
    pub const WHAT: &str = "memory of one content in bytes (--max-content raises the limit)";
}

impl From<ContentTooLarge> for std::io::Error {
    fn from(error: ContentTooLarge) -> Self {
        Self::other(error)
    }
}

/// Runs a decoder that may ask for `limit` bytes. A decoder that runs within another one has the budget of that.
///
/// # Errors
/// [`ContentTooLarge`] if the decoder asked for more, whatever it made of the refusal.
pub(crate) fn limited<T>(limit: u64, decode: impl FnOnce() -> T) -> Result<T, ContentTooLarge> {
    /// Ends the budget, also if the decoder panics.
    struct End;
    impl Drop for End {
        fn drop(&mut self) {
            BUDGET.set(None);
        }
    }
    if BUDGET.get().is_some() {
        return Ok(decode());
    }
    BUDGET.set(Some(Budget { limit, asked: 0 }));
    let _end = End;
    let decoded = decode();
    match BUDGET.get() {
        Some(Budget { limit, asked }) if asked > limit => Err(ContentTooLarge { asked, limit }),
        _ => Ok(decoded),
    }
}

/// Adds bytes to those that the content of this thread asked for.
pub(super) fn ask(bytes: u64) -> Result<(), ContentTooLarge> {
    let Some(Budget { limit, asked }) = BUDGET.get() else { return Ok(()) };
    let asked = asked.saturating_add(bytes);
    BUDGET.set(Some(Budget { limit, asked }));
    if asked > limit { Err(ContentTooLarge { asked, limit }) } else { Ok(()) }
}

/// Returns the bytes that the content of this thread may still ask for: the limit of a decoder that does not say before what it
/// allocates.
pub(crate) fn content_bytes_left() -> u64 {
    BUDGET.get().map_or(u64::MAX, |budget| budget.limit.saturating_sub(budget.asked))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_beyond_its_budget_fails_although_its_reader_goes_on() {
        let read = |bytes: &[u64]| {
            limited(100, || {
                let parts: Vec<bool> = bytes.iter().map(|bytes| ask(*bytes).is_ok()).collect();
                (parts, content_bytes_left())
            })
        };
        assert_eq!(read(&[60, 40]), Ok((vec![true, true], 0)));
        assert_eq!(read(&[60]), Ok((vec![true], 40)), "each content has a budget of its own");
        assert_eq!(read(&[60, u64::MAX, 1]), Err(ContentTooLarge { asked: u64::MAX, limit: 100 }));
        assert_eq!(ask(1000), Ok(()), "no content is decoded");
    }

    #[test]
    fn content_within_another_has_the_budget_of_that() {
        let inner = || limited(u64::MAX, || ask(50)).and_then(|asked| asked);
        assert_eq!(limited(100, || inner().and_then(|()| inner())), Ok(Ok(())));
        assert_eq!(limited(99, || inner().and_then(|()| inner())), Err(ContentTooLarge { asked: 100, limit: 99 }));
    }

    #[test]
    fn budget_ends_with_a_decoder_that_panics() {
        let panics = || limited(1, || std::panic::resume_unwind(Box::new("stops")));
        assert!(std::panic::catch_unwind(panics).is_err());
        assert_eq!(ask(2), Ok(()));
    }
}
