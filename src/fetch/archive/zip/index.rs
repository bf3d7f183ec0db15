//! The index of a 3D Tiles archive (3D Tiles Archive Format 1.3): the offset of each file's local header by the MD5 hash of its
//! path. Parses bytes, does no I/O.
//!
//! It is a quarter as large as the zip's central directory. An entry is trusted only if the header at its offset has the
//! wanted name; a file without an entry is looked up in the central directory.

use md5::{Digest as _, Md5};

#[cfg(feature = "testing")]
use super::directory::DirectoryEnd;
use super::directory::{Member, header, is_name_of, name, zip64_field};
use super::member::{STORED, content_range};
use crate::fetch::archive::span::{Span, le_uint};

const NAME: &[u8] = b"@3dtilesIndex1@";
const ENTRY_BYTES: usize = 24;
/// The maximum length of extra field and comment of the index's entry in the directory.
const MAX_EXTRA_BYTES: usize = 256;

const LOCAL_HEADER: u64 = 0x0403_4b50;
/// Flag of a local header whose sizes and checksum follow the content.
const SIZES_FOLLOW: u64 = 1 << 3;

/// A parsed index whose entries are consistent with each other.
#[derive(Debug)]
pub(in crate::fetch::archive) struct ZipIndex {
    /// Hashes of the paths, strictly ascending.
    hashes: Vec<u128>,
    /// Offsets of the local headers, in the order of `hashes`.
    offsets: Vec<u64>,
    /// Offsets of all local headers and of the directory, ascending. A file ends where the next one begins.
    ends: Vec<u64>,
}

impl ZipIndex {
    /// Returns the index's own header, if it is the last entry of the directory. `tail` is the end of the archive from
    /// offset `start`.
    pub fn find_header(tail: &[u8], start: u64, directory: Span) -> Option<Member> {
        let end = usize::try_from((directory.offset + directory.size).checked_sub(start)?).ok()?;
        let upto = tail.get(..end)?;
        let first = directory.offset.saturating_sub(start) as usize;
        (0..=MAX_EXTRA_BYTES).find_map(|extra| {
            let at = end.checked_sub(46 + NAME.len() + extra).filter(|at| *at >= first)?;
            let (member, after) = header(upto, at)?;
            (after == end && name(upto, at) == Some(NAME)).then_some(member)
        })
    }

    /// Returns the span of the index's local header and content.
    pub fn span(header: &Member, directory: Span) -> Option<Span> {
        let max_size = header.packed.saturating_add((30 + NAME.len() + MAX_EXTRA_BYTES) as u64);
        Some(Span { offset: header.offset, size: directory.offset.checked_sub(header.offset)?.min(max_size) })
    }

    /// Parses the bytes of [`Self::span`]. Returns `None` unless they are an undamaged index of all other files in the
    /// directory, whose file count is `files`.
    pub fn read(header: &Member, piece: &[u8], directory: Span, files: u64) -> Option<Self> {
        let data = content_range("", header, piece).ok()?;
        let bytes = piece.get(usize::try_from(data.start).ok()?..usize::try_from(data.end).ok()?)?;
        let is_whole = header.method == STORED && !header.is_encrypted && header.size == bytes.len() as u64;
        if !is_whole || crc32fast::hash(bytes) != header.crc || !bytes.len().is_multiple_of(ENTRY_BYTES) {
            return None;
        }
        let count = bytes.len() / ENTRY_BYTES;
        if count as u64 + 1 != files {
            return None;
        }
        let (mut hashes, mut offsets) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for entry in bytes.chunks_exact(ENTRY_BYTES) {
            hashes.push(sort_key(entry)?);
            offsets.push(le_uint::<8>(entry, 16).filter(|offset| *offset < directory.offset)?);
        }
        // Only the directory tells which of two files with one name is valid.
        if !hashes.is_sorted_by(|a, b| a < b) {
            return None;
        }
        let mut ends: Vec<u64> = offsets.iter().copied().chain([header.offset, directory.offset]).collect();
        ends.sort_unstable();
        ends.dedup();
        Some(Self { hashes, offsets, ends })
    }

    /// Returns the memory that it takes, in bytes.
    pub fn bytes(&self) -> usize {
        self.hashes.len() * size_of::<u128>() + (self.offsets.len() + self.ends.len()) * size_of::<u64>()
    }

    /// Returns true if it contains a file of that name.
    pub fn has(&self, wanted: &str) -> bool {
        self.find(wanted).is_some()
    }

    /// Returns a span that contains a file's local header and content, and perhaps more.
    pub fn find(&self, wanted: &str) -> Option<Span> {
        let hash = sort_key(&Md5::digest(wanted.as_bytes()))?;
        let at = self.hashes.partition_point(|h| *h < hash);
        let offset = *self.offsets.get(at).filter(|_| self.hashes.get(at) == Some(&hash))?;
        let end = *self.ends.get(self.ends.partition_point(|end| *end <= offset))?;
        Some(Span { offset, size: end - offset })
    }
}

/// Converts an MD5 hash to a number in the order of the index, which compares it as two little-endian integers.
fn sort_key(hash: &[u8]) -> Option<u128> {
    Some(u128::from(le_uint::<8>(hash, 0)?) << 64 | u128::from(le_uint::<8>(hash, 8)?))
}

/// Parses the local header at the beginning of `piece`, which begins at `offset` of the archive. Returns `None` if it belongs
/// to another file or lacks the size of the content.
pub(in crate::fetch::archive) fn local_header(piece: &[u8], offset: u64, wanted: &str) -> Option<Member> {
    (le_uint::<4>(piece, 0)? == LOCAL_HEADER).then_some(())?;
    let flags = le_uint::<2>(piece, 6)?;
    let (name_bytes, extra_bytes) = (le_uint::<2>(piece, 26)? as usize, le_uint::<2>(piece, 28)? as usize);
    if !is_name_of(piece.get(30..30 + name_bytes)?, wanted) || flags & SIZES_FOLLOW != 0 {
        return None;
    }
    let mut member = Member {
        offset,
        packed: le_uint::<4>(piece, 18)?,
        size: le_uint::<4>(piece, 22)?,
        crc: le_uint::<4>(piece, 14)? as u32,
        method: le_uint::<2>(piece, 8)? as u16,
        is_encrypted: flags & 1 == 1,
        name_bytes,
        extra_bytes,
    };
    let mut wide = zip64_field(piece.get(30 + name_bytes..30 + name_bytes + extra_bytes)?);
    for value in [&mut member.size, &mut member.packed] {
        if *value == 0xffff_ffff {
            *value = le_uint::<8>(wide, 0)?;
            wide = wide.get(8..)?;
        }
    }
    let data = content_range("", &member, piece).ok()?;
    (data.end <= piece.len() as u64).then_some(member)
}

/// Parses a whole archive with a corrected checksum of its index, and checks what the index promises. Returns true if it has
/// one. Entry point of the fuzz tests.
#[cfg(feature = "testing")]
pub fn fuzz_index(bytes: &[u8]) -> bool {
    let Ok(DirectoryEnd::Directory(directory, files)) = DirectoryEnd::find("fuzz", bytes, 0) else { return false };
    let Some(mut own) = ZipIndex::find_header(bytes, 0, directory) else { return false };
    let Some(piece) = ZipIndex::span(&own, directory).and_then(|span| span.slice_of(bytes, 0)) else { return false };
    let content =
        content_range("fuzz", &own, piece).ok().and_then(|data| piece.get(data.start as usize..data.end as usize));
    own.crc = crc32fast::hash(content.unwrap_or_default());
    let Some(index) = ZipIndex::read(&own, piece, directory, files) else { return false };
    assert!(index.bytes() <= 3 * bytes.len() + 64);
    for name in ["tileset.json", "a/b.glb"] {
        let Some(span) = index.find(name) else { continue };
        assert!(span.size > 0 && span.offset + span.size <= directory.offset);
        let Some(piece) = span.slice_of(bytes, 0) else { continue };
        if let Some(member) = local_header(piece, span.offset, name) {
            let data = content_range("fuzz", &member, piece).map(|data| data.end);
            assert!(data.is_ok_and(|end| end <= piece.len() as u64));
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_ordered_as_two_little_endian_integers() {
        let mut a = [0u8; 16];
        let mut b = [0u8; 16];
        (a[0], b[1]) = (255, 1);
        assert!(sort_key(&a) < sort_key(&b), "the first byte counts least");
        (a[8], b[8]) = (2, 1);
        assert!(sort_key(&a) < sort_key(&b), "the second half counts less");
        assert_eq!(sort_key(&a[1..]), None);
    }
}
