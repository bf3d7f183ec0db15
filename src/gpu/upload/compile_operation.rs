//! [`CompileOperation`] and [`Compiled`]: the order to upload drawables, and its result. Plain values.

use std::time::Duration;

use crate::scene::{ContentKey, DrawSlot, Drawable};

/// Drawables to upload together, usually those of one page.
#[derive(Debug)]
pub struct CompileOperation {
    /// A number of the caller's choice, which is returned in [`Compiled`].
    pub ticket: u64,
    /// The drawables; dropped once they are uploaded.
    pub drawables: Vec<Drawable>,
}

/// The result of a [`CompileOperation`].
#[derive(Debug)]
pub struct Compiled {
    /// The operation's ticket.
    pub ticket: u64,
    /// One slot per drawable, in order; [`DrawSlot::NONE`] for drawables that failed. Empty if the operation was cancelled.
    pub slots: Vec<DrawSlot>,
    /// Bytes of GPU memory that were newly taken, without content that is shared by its key.
    pub bytes: u64,
    /// Shared content, with the size of its slot in bytes, whether or not this operation uploaded it.
    pub shared: Vec<(ContentKey, u64)>,
    /// The errors of the drawables that failed.
    pub errors: Vec<String>,
    /// Bytes of GPU memory that no page owns: free slots of the pools' blocks, blocks that are being replaced by larger ones,
    /// and textures of the application's state sets.
    pub unused_bytes: u64,
}

impl Compiled {
    /// Returns the result of an operation before its first drawable, with capacity for a number of slots.
    pub(super) fn empty(ticket: u64, drawables: usize) -> Self {
        let (shared, errors) = (Vec::new(), Vec::new());
        Self { ticket, slots: Vec::with_capacity(drawables), bytes: 0, shared, errors, unused_bytes: 0 }
    }

    /// Counts a slot of a drawable: as shared if it has a content key, and otherwise if it is new.
    pub(super) fn count(&mut self, content: Option<&ContentKey>, bytes: u64, is_new: bool) {
        match content {
            Some(key) => self.shared.push((*key, bytes)),
            None => self.bytes += if is_new { bytes } else { 0 },
        }
    }
}

/// The work of one call of `run_compiles`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CompileStats {
    /// Bytes uploaded.
    pub bytes: u64,
    /// Slices uploaded.
    pub slices: u32,
    /// Operations finished.
    pub finished: u32,
    /// Operations that are waiting or in progress.
    pub pending: usize,
    /// Duration of the call.
    pub time: Duration,
}
