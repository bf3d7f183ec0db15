//! The index of a 3D Tiles archive (3D Tiles Archive Format 1.3): where each file's header is, by the MD5 hash of its path.
//!
//! A quarter as large as the zip's own directory. What it says is never believed alone: a header that it leads to has to
//! have the wanted name, and what it does not have is looked for in the directory.

use md5::{Digest as _, Md5};

use super::directory::{End, Member, Span, header, is_name_of, name, number, wide_field};
use super::member::{STORED, data_of};

const NAME: &[u8] = b"@3dtilesIndex1@";
const ENTRY_BYTES: usize = 24;
/// What the directory says of the index besides its name is no longer.
const MOST_EXTRA_BYTES: usize = 256;

const LOCAL_HEADER: u64 = 0x0403_4b50;
/// Sizes and checksum follow behind the content.
const SIZES_FOLLOW: u64 = 1 << 3;

/// The index, as far as it is consistent in itself.
#[derive(Debug)]
pub(crate) struct Index {
    /// Ascending, each once.
    hashes: Vec<u128>,
    /// Of the headers, beside their hashes.
    offsets: Vec<u64>,
    /// Offsets of all headers and of the directory, ascending: one file ends before the next.
    ends: Vec<u64>,
}

impl Index {
    /// The index's own place, where the last entry of the directory is for it. `tail` is the end of the archive from `start`.
    pub fn place(tail: &[u8], start: u64, directory: Span) -> Option<Member> {
        let end = usize::try_from((directory.offset + directory.size).checked_sub(start)?).ok()?;
        let upto = tail.get(..end)?;
        let first = directory.offset.saturating_sub(start) as usize;
        (0..=MOST_EXTRA_BYTES).find_map(|extra| {
            let at = end.checked_sub(46 + NAME.len() + extra).filter(|at| *at >= first)?;
            let (member, after) = header(upto, at)?;
            (after == end && name(upto, at) == Some(NAME)).then_some(member)
        })
    }

    /// What to read for it: its header and content.
    pub fn piece(place: &Member, directory: Span) -> Option<Span> {
        let most = place.packed.saturating_add((30 + NAME.len() + MOST_EXTRA_BYTES) as u64);
        Some(Span { offset: place.offset, size: directory.offset.checked_sub(place.offset)?.min(most) })
    }

    /// Takes the piece. `None` for anything but an index of as many files as the directory has besides it.
    pub fn read(place: &Member, piece: &[u8], directory: Span, files: u64) -> Option<Self> {
        let data = data_of("", place, piece).ok()?;
        let bytes = piece.get(usize::try_from(data.start).ok()?..usize::try_from(data.end).ok()?)?;
        let is_whole = place.method == STORED && !place.is_encrypted && place.size == bytes.len() as u64;
        if !is_whole || crc32fast::hash(bytes) != place.crc || !bytes.len().is_multiple_of(ENTRY_BYTES) {
            return None;
        }
        let count = bytes.len() / ENTRY_BYTES;
        if count as u64 + 1 != files {
            return None;
        }
        let (mut hashes, mut offsets) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for entry in bytes.chunks_exact(ENTRY_BYTES) {
            hashes.push(key(entry)?);
            offsets.push(number::<8>(entry, 16).filter(|offset| *offset < directory.offset)?);
        }
        // Of two files with one name the directory says which is meant.
        if !hashes.is_sorted_by(|a, b| a < b) {
            return None;
        }
        let mut ends: Vec<u64> = offsets.iter().copied().chain([place.offset, directory.offset]).collect();
        ends.sort_unstable();
        ends.dedup();
        Some(Self { hashes, offsets, ends })
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        self.hashes.len() * size_of::<u128>() + (self.offsets.len() + self.ends.len()) * size_of::<u64>()
    }

    /// It has a file of that name.
    pub fn has(&self, wanted: &str) -> bool {
        self.find(wanted).is_some()
    }

    /// Where a file may be: its header and content, and perhaps more.
    pub fn find(&self, wanted: &str) -> Option<Span> {
        let hash = key(&Md5::digest(wanted.as_bytes()))?;
        let at = self.hashes.partition_point(|h| *h < hash);
        let offset = *self.offsets.get(at).filter(|_| self.hashes.get(at) == Some(&hash))?;
        let end = *self.ends.get(self.ends.partition_point(|end| *end <= offset))?;
        Some(Span { offset, size: end - offset })
    }
}

/// A hash in the index's order: that of two little-endian numbers.
fn key(hash: &[u8]) -> Option<u128> {
    Some(u128::from(number::<8>(hash, 0)?) << 64 | u128::from(number::<8>(hash, 8)?))
}

/// What a file's own header says, at the beginning of a piece from `offset`; `None` where it is another file's, or does
/// not say how long the content is.
pub(crate) fn own_header(piece: &[u8], offset: u64, wanted: &str) -> Option<Member> {
    (number::<4>(piece, 0)? == LOCAL_HEADER).then_some(())?;
    let flags = number::<2>(piece, 6)?;
    let (name_bytes, extra_bytes) = (number::<2>(piece, 26)? as usize, number::<2>(piece, 28)? as usize);
    if !is_name_of(piece.get(30..30 + name_bytes)?, wanted) || flags & SIZES_FOLLOW != 0 {
        return None;
    }
    let mut member = Member {
        offset,
        packed: number::<4>(piece, 18)?,
        size: number::<4>(piece, 22)?,
        crc: number::<4>(piece, 14)? as u32,
        method: number::<2>(piece, 8)? as u16,
        is_encrypted: flags & 1 == 1,
        name_bytes,
        extra_bytes,
    };
    let mut wide = wide_field(piece.get(30 + name_bytes..30 + name_bytes + extra_bytes)?);
    for value in [&mut member.size, &mut member.packed] {
        if *value == 0xffff_ffff {
            *value = number::<8>(wide, 0)?;
            wide = wide.get(8..)?;
        }
    }
    let data = data_of("", &member, piece).ok()?;
    (data.end <= piece.len() as u64).then_some(member)
}

/// Reads all of a small archive as one whose directory is elsewhere, the index with whatever checksum it has: for tests.
/// Whether there is one.
#[doc(hidden)]
pub fn fuzz_index(bytes: &[u8]) -> bool {
    let Ok(End::Directory(directory, files)) = End::find("fuzz", bytes, 0) else { return false };
    let Some(mut own) = Index::place(bytes, 0, directory) else { return false };
    let Some(piece) = Index::piece(&own, directory).and_then(|span| span.of(bytes, 0)) else { return false };
    let content = data_of("fuzz", &own, piece).ok().and_then(|data| piece.get(data.start as usize..data.end as usize));
    own.crc = crc32fast::hash(content.unwrap_or_default());
    let Some(index) = Index::read(&own, piece, directory, files) else { return false };
    assert!(index.bytes() <= 3 * bytes.len() + 64);
    for name in ["tileset.json", "a/b.glb"] {
        let Some(span) = index.find(name) else { continue };
        assert!(span.size > 0 && span.offset + span.size <= directory.offset);
        let Some(piece) = span.of(bytes, 0) else { continue };
        if let Some(member) = own_header(piece, span.offset, name) {
            let data = data_of("fuzz", &member, piece).map(|data| data.end);
            assert!(data.is_ok_and(|end| end <= piece.len() as u64));
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_ordered_as_two_numbers() {
        let mut a = [0u8; 16];
        let mut b = [0u8; 16];
        (a[0], b[1]) = (255, 1);
        assert!(key(&a) < key(&b), "the first byte counts least");
        (a[8], b[8]) = (2, 1);
        assert!(key(&a) < key(&b), "the second half counts less");
        assert_eq!(key(&a[1..]), None);
    }
}
