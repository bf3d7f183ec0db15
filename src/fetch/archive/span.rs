//! [`Span`]s of an archive, and the little-endian integers in them.

/// A range of bytes of an archive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Span {
    pub offset: u64,
    pub size: u64,
}

impl Span {
    /// Returns the offset after the last byte, or `None` on overflow.
    pub fn end(&self) -> Option<u64> {
        self.offset.checked_add(self.size)
    }

    /// Returns the bytes of this span out of `bytes`, which begin at offset `start` of the archive. Returns `None` unless
    /// they contain all of it.
    pub fn slice_of(self, bytes: &[u8], start: u64) -> Option<&[u8]> {
        let from = usize::try_from(self.offset.checked_sub(start)?).ok()?;
        bytes.get(from..from.checked_add(usize::try_from(self.size).ok()?)?)
    }
}

/// Reads a little-endian integer of `N` bytes. Returns `None` beyond the end.
pub(crate) fn le_uint<const N: usize>(bytes: &[u8], at: usize) -> Option<u64> {
    let digits: [u8; N] = bytes.get(at..at.checked_add(N)?)?.try_into().ok()?;
    Some(digits.iter().rev().fold(0, |n, b| n << 8 | u64::from(*b)))
}
