//! Directories of a PMTiles file: entries sorted by tile index. Parses bytes, does no I/O.

use super::directory_cache::MAX_CACHED_ENTRIES;
use crate::fetch::archive::span::Span;
use crate::fetch::{IoError, Limits};

/// The result of looking up a tile in a directory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::fetch::archive) enum Lookup {
    /// The span of the tile.
    Tile(Span),
    /// The span of the nested directory in which the search continues.
    Directory(Span),
    /// No entry: the file does not have the tile.
    Missing,
    /// The entry points outside of its part of the file.
    OutOfRange,
}

impl Lookup {
    /// Turns [`Self::Missing`] and [`Self::OutOfRange`] into errors.
    pub fn found(self, uri: &str) -> Result<Self, IoError> {
        match self {
            Self::Missing => Err(IoError::NotFound { uri: uri.to_owned() }),
            Self::OutOfRange => Err(IoError::invalid(uri, "PMTiles: a directory points out of the file")),
            found => Ok(found),
        }
    }
}

/// Returns the error for directories that are nested too deeply or in a cycle.
pub(in crate::fetch::archive) fn too_deep(uri: &str) -> IoError {
    IoError::invalid(uri, "PMTiles: directories nested too deeply")
}

/// Fails if a span is larger than the limit for files.
pub(in crate::fetch::archive) fn check_span_size(uri: &str, span: Span, limits: &Limits) -> Result<(), IoError> {
    if span.size > limits.max_file_bytes {
        let (got, limit) = (span.size, limits.max_file_bytes);
        return Err(IoError::TooLarge { uri: uri.to_owned(), what: "part of an archive", got, limit });
    }
    Ok(())
}

/// An entry stands for `run` consecutive tiles with the same content. A run of 0 marks a nested directory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Entry {
    id: u64,
    run: u64,
    pub offset: u64,
    pub size: u64,
}

impl Entry {
    pub fn is_directory(&self) -> bool {
        self.run == 0
    }
}

/// A parsed directory: entries by ascending tile index.
#[derive(Debug)]
pub(in crate::fetch::archive) struct TileDirectory(Vec<Entry>);

impl TileDirectory {
    /// Parses the decompressed bytes of a directory.
    pub(super) fn read(uri: &str, bytes: &[u8], limits: &Limits) -> Result<Self, IoError> {
        let broken = || IoError::invalid(uri, "PMTiles: a broken directory");
        let mut rest = bytes;
        let count = varint(&mut rest).ok_or_else(broken)?;
        let limit = limits.max_elements.min(MAX_CACHED_ENTRIES) as u64;
        if count > limit {
            return Err(IoError::TooLarge { uri: uri.to_owned(), what: "directory of an archive", got: count, limit });
        }
        // Each entry has four numbers of at least one byte each.
        if count > rest.len() as u64 / 4 {
            return Err(broken());
        }
        let mut entries = vec![Entry::default(); count as usize];
        let mut id = 0u64;
        for (i, entry) in entries.iter_mut().enumerate() {
            let step = varint(&mut rest).ok_or_else(broken)?;
            id = id.checked_add(step).filter(|_| i == 0 || step > 0).ok_or_else(broken)?;
            entry.id = id;
        }
        for entry in &mut entries {
            entry.run = varint(&mut rest).ok_or_else(broken)?;
        }
        for entry in &mut entries {
            entry.size = varint(&mut rest).filter(|size| *size > 0).ok_or_else(broken)?;
        }
        let mut after = None;
        for entry in &mut entries {
            entry.offset = match (varint(&mut rest).ok_or_else(broken)?, after) {
                (0, Some(after)) => after,
                (0, None) => return Err(broken()),
                (offset, _) => offset - 1,
            };
            after = Some(entry.offset.checked_add(entry.size).ok_or_else(broken)?);
        }
        Ok(Self(entries))
    }

    /// Returns the number of entries.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Returns the memory that it takes, in bytes.
    pub fn bytes(&self) -> usize {
        self.0.len() * size_of::<Entry>()
    }

    /// Returns the tile indices of all entries, ascending.
    #[cfg(feature = "testing")]
    pub(super) fn ids(&self) -> impl Iterator<Item = u64> {
        self.0.iter().map(|entry| entry.id)
    }

    /// Returns the entry that covers a tile index.
    pub(super) fn find(&self, id: u64) -> Option<Entry> {
        let after = self.0.partition_point(|entry| entry.id <= id);
        let entry = *self.0.get(after.checked_sub(1)?)?;
        (entry.is_directory() || id - entry.id < entry.run).then_some(entry)
    }
}

/// Reads a variable-length integer: seven bits in each byte, the lowest first.
fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut value = 0u64;
    for shift in (0..64).step_by(7) {
        let (byte, after) = rest.split_first()?;
        *rest = after;
        let bits = u64::from(byte & 0x7f);
        if bits << shift >> shift != bits {
            return None;
        }
        value |= bits << shift;
        if byte & 0x80 == 0 {
            return Some(value);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variable_length_integers() {
        for (bytes, value) in [
            (&[0u8][..], Some(0)),
            (&[0x7f], Some(127)),
            (&[0xe5, 0x8e, 0x26], Some(624_485)),
            (&[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 1], Some(u64::MAX)),
            (&[0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 2], None),
            (&[0x80; 11], None),
            (&[0x80], None),
            (&[], None),
        ] {
            assert_eq!(varint(&mut { bytes }), value, "{bytes:?}");
        }
    }

    #[test]
    fn a_directory_of_too_many_entries_is_refused() {
        let of_entries = |count: usize| {
            let mut bytes = Vec::new();
            let mut rest = count;
            while rest >= 0x80 {
                bytes.push(rest as u8 | 0x80);
                rest >>= 7;
            }
            bytes.push(rest as u8);
            bytes.resize(bytes.len() + 4 * count, 1);
            TileDirectory::read("t", &bytes, &Limits::default())
        };
        assert_eq!(of_entries(MAX_CACHED_ENTRIES).unwrap().len(), MAX_CACHED_ENTRIES);
        assert!(matches!(of_entries(MAX_CACHED_ENTRIES + 1), Err(IoError::TooLarge { .. })));
    }
}
