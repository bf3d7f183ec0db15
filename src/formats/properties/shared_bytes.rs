//! [`SharedBytes`]: a part of a buffer that several columns share. Immutable; any thread.

use std::ops::{Deref, Range};
use std::sync::Arc;

/// Bytes of a shared buffer.
#[derive(Clone, Debug)]
pub(in crate::formats) struct SharedBytes {
    buffer: Arc<Vec<u8>>,
    range: Range<usize>,
}

impl SharedBytes {
    /// Returns a part of a buffer; `None` if it reaches beyond the end.
    pub fn part(buffer: &Arc<Vec<u8>>, range: Range<usize>) -> Option<Self> {
        buffer.get(range.clone()).is_some().then(|| Self { buffer: buffer.clone(), range })
    }

    /// Returns a part of these bytes; `None` if it reaches beyond their end.
    pub fn range(&self, offset: u64, length: u64) -> Option<Self> {
        let start = self.range.start.checked_add(usize::try_from(offset).ok()?)?;
        let end = start.checked_add(usize::try_from(length).ok()?)?;
        (end <= self.range.end).then(|| Self { buffer: self.buffer.clone(), range: start..end })
    }
}

impl From<Vec<u8>> for SharedBytes {
    fn from(bytes: Vec<u8>) -> Self {
        Self { range: 0..bytes.len(), buffer: Arc::new(bytes) }
    }
}

impl Deref for SharedBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.buffer.get(self.range.clone()).unwrap_or_default()
    }
}
