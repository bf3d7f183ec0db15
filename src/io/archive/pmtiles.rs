//! PMTiles, version 3: tiles of a pyramid in one file, found by their place on a Hilbert curve through nested directories.
//! A tile's name is `z/x/y`, with or without an ending.

use std::num::NonZeroUsize;
use std::sync::{Mutex, MutexGuard, PoisonError};

use lru::LruCache;

use super::directory::{Span, number};
use super::trim;
use crate::io::{IoError, Limits, encoding, file};

/// What is read at first: the header, and the root directory, which ends before it.
pub(crate) const HEAD_BYTES: u64 = 16 << 10;
/// Directories below each other; the format's own writers make two.
pub(crate) const MOST_DIRECTORIES: usize = 4;
/// Directories below the root that are kept of a file.
const KEPT_DIRECTORIES: NonZeroUsize = NonZeroUsize::new(64).expect("not zero");
/// Entries that these have in all, and one of them at most: 32 MiB. The format's own writers make some thousand each.
const KEPT_ENTRIES: usize = 1 << 20;
/// One more level does not fit into an id.
const MOST_ZOOM: u32 = 31;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Packed {
    /// Not, or in a way that is not told.
    Plain,
    Gzip,
    Brotli,
    Zstd,
}

impl Packed {
    fn of(code: u64) -> Option<Self> {
        Some(match code {
            0 | 1 => Self::Plain,
            2 => Self::Gzip,
            3 => Self::Brotli,
            4 => Self::Zstd,
            _ => return None,
        })
    }

    fn undo(self, uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, IoError> {
        match self {
            Self::Plain => Ok(bytes),
            Self::Gzip => file::gunzip(uri, bytes, limits),
            Self::Zstd => encoding::unzstd(uri, &bytes, limits.max_file_bytes),
            #[cfg(feature = "http")]
            Self::Brotli => encoding::decode(uri, bytes, "br", limits),
            #[cfg(not(feature = "http"))]
            Self::Brotli => Err(IoError::unsupported(uri, "brotli (built without the feature http)")),
        }
    }
}

/// The head of a file: where its parts are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileHeader {
    /// The root directory.
    pub root: Span,
    leaves: Span,
    tiles: Span,
    directories: Packed,
    contents: Packed,
}

impl TileHeader {
    pub fn read(uri: &str, head: &[u8]) -> Result<Self, IoError> {
        let broken = |what: &str| IoError::invalid(uri, format!("PMTiles: {what}"));
        if !head.starts_with(b"PMTiles") {
            return Err(broken("its magic is missing"));
        }
        match head.get(7) {
            Some(3) => {}
            Some(other) => return Err(IoError::unsupported(uri, format!("PMTiles of version {other}"))),
            None => return Err(broken("it ends early")),
        }
        let span = |at| Some(Span { offset: number::<8>(head, at)?, size: number::<8>(head, at + 8)? });
        let packed = |at| number::<1>(head, at).and_then(Packed::of);
        // All of the header has to be there: 127 bytes.
        let parts = (number::<1>(head, 126), span(8), span(40), span(56));
        let (Some(_), Some(root), Some(leaves), Some(tiles)) = parts else { return Err(broken("it ends early")) };
        let (Some(directories), Some(contents)) = (packed(97), packed(98)) else {
            return Err(IoError::unsupported(uri, "a compression of PMTiles"));
        };
        Ok(Self { root, leaves, tiles, directories, contents })
    }

    /// Undoes the compression of a content.
    pub fn unpack(&self, uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<Vec<u8>, IoError> {
        self.contents.undo(uri, bytes, limits)
    }

    /// Takes the bytes of a directory.
    pub fn directory(&self, uri: &str, bytes: Vec<u8>, limits: &Limits) -> Result<TileDirectory, IoError> {
        let bytes = self.directories.undo(uri, bytes, limits)?;
        TileDirectory::read(uri, &bytes, limits)
    }

    /// Where a directory leads to from there.
    pub fn look_up(&self, directory: &TileDirectory, id: u64) -> Step {
        let Some(entry) = directory.find(id) else { return Step::Nothing };
        let part = if entry.run == 0 { self.leaves } else { self.tiles };
        let span = part.offset.checked_add(entry.offset).map(|offset| Span { offset, size: entry.size });
        match span.filter(|_| entry.offset.checked_add(entry.size).is_some_and(|end| end <= part.size)) {
            Some(span) if entry.run == 0 => Step::Directory(span),
            Some(span) => Step::Tile(span),
            None => Step::Outside,
        }
    }
}

/// What a directory has of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    Tile(Span),
    /// A directory that knows more.
    Directory(Span),
    Nothing,
    /// A place that the file does not have.
    Outside,
}

impl Step {
    /// A tile's place, or the next directory's; else an error.
    pub fn known(self, uri: &str) -> Result<Self, IoError> {
        match self {
            Self::Nothing => Err(IoError::NotFound { uri: uri.to_owned() }),
            Self::Outside => Err(IoError::invalid(uri, "PMTiles: a directory points out of the file")),
            known => Ok(known),
        }
    }
}

/// Too many directories below each other, or a circle of them.
pub(crate) fn too_deep(uri: &str) -> IoError {
    IoError::invalid(uri, "PMTiles: directories nested too deeply")
}

/// More than is accepted.
pub(crate) fn check_size(uri: &str, span: Span, limits: &Limits) -> Result<(), IoError> {
    if span.size > limits.max_file_bytes {
        let (got, limit) = (span.size, limits.max_file_bytes);
        return Err(IoError::TooLarge { uri: uri.to_owned(), what: "part of an archive", got, limit });
    }
    Ok(())
}

/// Tiles with equal contents one after the other are one entry; one of no tiles is a directory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Entry {
    id: u64,
    run: u64,
    offset: u64,
    size: u64,
}

/// A directory: entries by ascending id.
#[derive(Debug)]
pub(crate) struct TileDirectory(Vec<Entry>);

impl TileDirectory {
    fn read(uri: &str, bytes: &[u8], limits: &Limits) -> Result<Self, IoError> {
        let broken = || IoError::invalid(uri, "PMTiles: a broken directory");
        let mut rest = bytes;
        let count = varint(&mut rest).ok_or_else(broken)?;
        let limit = limits.max_elements.min(KEPT_ENTRIES) as u64;
        if count > limit {
            return Err(IoError::TooLarge { uri: uri.to_owned(), what: "directory of an archive", got: count, limit });
        }
        // Four numbers for each entry, of at least a byte.
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

    /// Its entries.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> usize {
        self.0.len() * size_of::<Entry>()
    }

    fn find(&self, id: u64) -> Option<Entry> {
        let after = self.0.partition_point(|entry| entry.id <= id);
        let entry = *self.0.get(after.checked_sub(1)?)?;
        (entry.run == 0 || id - entry.id < entry.run).then_some(entry)
    }
}

/// Directories below the root by their offsets: those that were used last.
#[derive(Debug)]
pub(crate) struct KeptDirectories<D>(
    /// Taken for moments; a directory is read outside of it.
    Mutex<LruCache<u64, D>>,
);

impl<D: Clone> KeptDirectories<D> {
    pub fn new() -> Self {
        Self(Mutex::new(LruCache::new(KEPT_DIRECTORIES)))
    }

    fn kept(&self) -> MutexGuard<'_, LruCache<u64, D>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn get(&self, offset: u64) -> Option<D> {
        self.kept().get(&offset).cloned()
    }

    #[cfg(feature = "http")]
    pub fn get_or_insert(&self, offset: u64, make: impl FnOnce() -> D) -> D {
        self.kept().get_or_insert(offset, make).clone()
    }

    pub fn put(&self, offset: u64, directory: D) {
        self.kept().put(offset, directory);
    }

    /// Lets those go that were not used for longest, until all have no more entries than are kept.
    pub fn trim(&self, entries: impl Fn(&D) -> usize) {
        trim(&mut self.kept(), KEPT_ENTRIES, entries);
    }

    /// Of all that are kept.
    pub fn sum(&self, size: impl Fn(&D) -> usize) -> usize {
        self.kept().iter().map(|(_, directory)| size(directory)).sum()
    }
}

/// A number of seven bits a byte, the lowest first.
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

/// The id of a tile by its name: those of the levels above it, and its place on the Hilbert curve.
pub(crate) fn tile_id(name: &str) -> Option<u64> {
    let mut parts = name.split('/');
    let (z, x, y) = (parts.next()?, parts.next()?, parts.next()?);
    let y = y.split('.').next()?;
    let digits = |text: &str| text.bytes().all(|b| b.is_ascii_digit()).then(|| text.parse::<u64>().ok())?;
    let (z, mut x, mut y) = (digits(z)?, digits(x)?, digits(y)?);
    let z = u32::try_from(z).ok().filter(|z| *z <= MOST_ZOOM)?;
    let side = 1u64 << z;
    if parts.next().is_some() || x >= side || y >= side {
        return None;
    }
    let above = ((1u128 << (2 * z)) - 1) / 3;
    let mut along = 0u64;
    for level in (0..z).rev() {
        let (right, down) = (x >> level & 1, y >> level & 1);
        along += ((3 * right) ^ down) << (2 * level);
        if down == 0 {
            if right == 1 {
                (x, y) = (side - 1 - x, side - 1 - y);
            }
            (x, y) = (y, x);
        }
    }
    u64::try_from(above + u128::from(along)).ok()
}

/// Takes any bytes as a file and looks for some of its tiles: for tests.
#[doc(hidden)]
pub fn fuzz_pmtiles(bytes: &[u8], limits: &Limits) {
    let Ok(header) = TileHeader::read("fuzz", bytes) else { return };
    for from in [bytes.get(127..).unwrap_or_default(), header.root.of(bytes, 0).unwrap_or_default()] {
        match header.directory("fuzz", from.to_vec(), limits) {
            Ok(directory) => {
                assert!(directory.0.is_sorted_by(|a, b| a.id < b.id));
                for id in directory.0.iter().map(|e| e.id).take(100).chain([0, 1, u64::MAX]) {
                    let _ = header.look_up(&directory, id);
                }
            }
            Err(error) => assert!(!error.reason().is_empty()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_have_their_places_on_the_curve() {
        for (name, id) in [
            ("0/0/0", Some(0)),
            ("1/0/0", Some(1)),
            ("1/0/1.png", Some(2)),
            ("1/1/1", Some(3)),
            ("1/1/0.jpg.gz", Some(4)),
            ("2/0/0", Some(5)),
            ("12/3423/1763", Some(19_078_479)),
            ("1/2/0", None),
            ("1/0", None),
            ("1/0/0/0", None),
            ("32/0/0", None),
            ("1/+1/0", None),
            ("1/-1/0", None),
            ("1//0", None),
            ("tileset.json", None),
            ("99999999999999999999/0/0", None),
        ] {
            assert_eq!(tile_id(name), id, "{name}");
        }
        // Each tile of a level once, neighbours on the curve beside each other.
        let mut places: Vec<(u64, i64, i64)> =
            (0..16).flat_map(|x| (0..16).map(move |y| (tile_id(&format!("4/{x}/{y}")).unwrap(), x, y))).collect();
        places.sort_unstable();
        assert!(places.iter().map(|p| p.0).eq(85..85 + 256));
        assert!(places.windows(2).all(|w| (w[0].1 - w[1].1).abs() + (w[0].2 - w[1].2).abs() == 1));
        assert!(tile_id("31/2147483647/2147483647").is_some());
    }

    #[test]
    fn numbers_of_seven_bits() {
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
    fn directories_are_kept_by_their_number_and_by_their_entries() {
        let kept = KeptDirectories::new();
        for offset in 0..100 {
            kept.put(offset, KEPT_ENTRIES / 10);
            kept.trim(|entries| *entries);
        }
        let there = |kept: &KeptDirectories<usize>, all: u64| (0..all).filter(|o| kept.get(*o).is_some()).count();
        assert_eq!(there(&kept, 100), 10);
        assert!(kept.get(99).is_some() && kept.get(90).is_some());
        kept.put(100, KEPT_ENTRIES);
        kept.trim(|entries| *entries);
        assert_eq!((there(&kept, 101), kept.get(100)), (1, Some(KEPT_ENTRIES)));
        for offset in 0..100 {
            kept.put(offset, 1);
            kept.trim(|entries| *entries);
        }
        assert_eq!(there(&kept, 101), KEPT_DIRECTORIES.get());
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
        assert_eq!(of_entries(KEPT_ENTRIES).unwrap().len(), KEPT_ENTRIES);
        assert!(matches!(of_entries(KEPT_ENTRIES + 1), Err(IoError::TooLarge { .. })));
    }
}
