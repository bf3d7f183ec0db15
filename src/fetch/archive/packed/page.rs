//! Pages of the index of a packed set.

use crate::fetch::archive::span::{Span, le_uint};

/// The bytes of an entry: key, offset, length, checksum, geometric error, lowest and highest height.
pub(super) const ENTRY_BYTES: u64 = 40;

/// The part of an entry that a reader needs. The errors and heights of tiles are for programs that read the index alone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::fetch::archive) struct PackedEntry {
    pub span: Span,
    pub checksum: u32,
}

/// A page of the index: entries in the order of their keys.
#[derive(Debug)]
pub(in crate::fetch::archive) struct IndexPage {
    entries: Vec<(u64, PackedEntry)>,
}

impl IndexPage {
    /// Parses the bytes of a page.
    pub(super) fn read(bytes: &[u8]) -> Self {
        let (entries, _) = bytes.as_chunks::<{ ENTRY_BYTES as usize }>();
        let entry = |bytes: &[u8; ENTRY_BYTES as usize]| {
            let long = |at| le_uint::<8>(bytes, at).unwrap_or(0);
            let short = |at| le_uint::<4>(bytes, at).unwrap_or(0);
            let span = Span { offset: long(8), size: short(16) };
            (long(0), PackedEntry { span, checksum: short(20) as u32 })
        };
        Self { entries: entries.iter().map(entry).collect() }
    }

    pub(super) fn first_key(&self) -> Option<u64> {
        self.entries.first().map(|(key, _)| *key)
    }

    pub(super) fn is_sorted(&self) -> bool {
        self.entries.is_sorted_by(|a, b| a.0 < b.0)
    }

    /// Returns the number of entries.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Returns the memory that the page takes, in bytes.
    pub fn bytes(&self) -> usize {
        self.entries.len() * size_of::<(u64, PackedEntry)>()
    }

    /// Returns the entry of a key.
    pub fn find(&self, key: u64) -> Option<PackedEntry> {
        self.entries.binary_search_by_key(&key, |(key, _)| *key).ok().map(|at| self.entries[at].1)
    }
}
