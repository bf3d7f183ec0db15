//! The file of a block's tiles in the folder of a run: the files of its tiles, an entry for each, and at the end the number of
//! entries and their checksum.

use std::collections::HashSet;
use std::fs::File;
use std::io::{BufWriter, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use super::entry::{ENTRY_BYTES, Entry, Kind, key_of, level_of};
use crate::GenError;
use crate::pyramid::TileKey;

/// The folder of the blocks' files inside the folder of a run.
const FOLDER: &str = ".packed";
/// The bytes behind the entries: their number and their checksum.
const TRAILER_BYTES: u64 = 16;

/// A block's file that is written. Files are added in the order of their keys.
pub(crate) struct BlockFile {
    path: PathBuf,
    unfinished: PathBuf,
    out: BufWriter<File>,
    offset: u64,
    tiles: Vec<TileKey>,
    entries: Vec<Entry>,
}

impl BlockFile {
    /// Creates the file of a block in the folder of a set. It has its name only when it is complete.
    pub fn create(set: &Path, root: TileKey) -> Result<Self, GenError> {
        let folder = set.join(FOLDER).join(format!("{}/{}", root.level, root.x));
        std::fs::create_dir_all(&folder).map_err(GenError::file(&folder))?;
        let (path, unfinished) = (folder.join(root.y.to_string()), folder.join(format!(".{}.unfinished", root.y)));
        let file = File::create(&unfinished).map_err(GenError::file(&unfinished))?;
        let out = BufWriter::with_capacity(1 << 18, file);
        Ok(Self { path, unfinished, out, offset: 0, tiles: Vec::new(), entries: Vec::new() })
    }

    /// Adds a file of a tile.
    pub fn add(&mut self, tile: TileKey, kind: Kind, bytes: &[u8]) -> Result<(), GenError> {
        let too_large = || GenError::Encode(format!("tile {tile:?} is too large for a packed set"));
        let (size, checksum) = (u32::try_from(bytes.len()).map_err(|_| too_large())?, crc32fast::hash(bytes));
        self.out.write_all(bytes).map_err(GenError::file(&self.path))?;
        self.tiles.push(tile);
        let (key, offset) = (key_of(tile, kind), self.offset);
        self.entries.push(Entry { key, offset, size, checksum, error_m: 0.0, range_m: [0.0; 2] });
        self.offset += bytes.len() as u64;
        Ok(())
    }

    /// Completes the file. `facts` returns the geometric error and the range of heights of a tile in metres.
    pub fn finish(mut self, facts: impl Fn(TileKey) -> (f64, [f32; 2])) -> Result<(), GenError> {
        let mut index = Vec::with_capacity(ENTRY_BYTES * self.entries.len());
        for (entry, tile) in self.entries.iter_mut().zip(&self.tiles) {
            (entry.error_m, entry.range_m) = facts(*tile);
            index.extend(entry.to_bytes());
        }
        let checksum = u64::from(crc32fast::hash(&index));
        let count = self.entries.len() as u64;
        let trailer = [count, checksum].map(u64::to_le_bytes).concat();
        let written = self.out.write_all(&index).and_then(|()| self.out.write_all(&trailer));
        written.and_then(|()| self.out.flush()).map_err(GenError::file(&self.path))?;
        std::fs::rename(&self.unfinished, &self.path).map_err(GenError::file(&self.path))
    }
}

/// A complete file of a block.
pub(super) struct ReadBlock {
    pub path: PathBuf,
    pub file: File,
    pub entries: Vec<Entry>,
}

impl ReadBlock {
    pub fn open(path: PathBuf) -> Result<Self, GenError> {
        let mut file = File::open(&path).map_err(GenError::file(&path))?;
        let mut at = |from_end: u64, size: u64| {
            let mut bytes = Vec::new();
            file.seek(SeekFrom::End(-(from_end.min(1 << 40) as i64)))?;
            (&file).take(size).read_to_end(&mut bytes)?;
            Ok::<_, std::io::Error>(bytes)
        };
        let trailer = at(TRAILER_BYTES, TRAILER_BYTES).map_err(GenError::file(&path))?;
        let damaged = || GenError::invalid(&path, "is damaged; remove it, and the run makes it again");
        let ([count, checksum], _) = trailer.as_chunks::<8>() else { return Err(damaged()) };
        let (count, checksum) = (u64::from_le_bytes(*count), u64::from_le_bytes(*checksum));
        let size = count.checked_mul(ENTRY_BYTES as u64).filter(|size| *size < 1 << 32).ok_or_else(damaged)?;
        let index = at(size + TRAILER_BYTES, size).map_err(GenError::file(&path))?;
        if index.len() as u64 != size || u64::from(crc32fast::hash(&index)) != checksum {
            return Err(damaged());
        }
        let entries = index.as_chunks::<ENTRY_BYTES>().0.iter().map(Entry::from_bytes).collect();
        Ok(Self { path, file, entries })
    }
}

/// Returns the blocks of a set and their files, by the levels of their roots and their places on the Morton curve.
pub(super) fn blocks_of(set: &Path) -> Result<Vec<(TileKey, PathBuf)>, GenError> {
    let folder = set.join(FOLDER);
    let mut found = Vec::new();
    for (level, path) in numbered(&folder)? {
        for (x, path) in numbered(&path)? {
            found.extend(numbered(&path)?.into_iter().map(|(y, path)| (TileKey { level, x, y }, path)));
        }
    }
    found.sort_by_key(|(root, _)| (root.level, root.morton()));
    Ok(found)
}

/// Returns what is in a folder and has a number for a name.
fn numbered(folder: &Path) -> Result<Vec<(u32, PathBuf)>, GenError> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(reason) => return Err(GenError::file(folder)(reason)),
    };
    let mut found = Vec::new();
    for entry in entries {
        let path = entry.map_err(GenError::file(folder))?.path();
        let number = path.file_name().and_then(|name| name.to_str()?.parse().ok());
        found.extend(number.map(|number| (number, path)));
    }
    Ok(found)
}

/// Returns the number of tiles of a level in the blocks' files of a set, and the bytes of their files.
pub(crate) fn tiles_and_bytes(set: &Path, level: u32) -> Result<(u64, u64), GenError> {
    let (mut tiles, mut bytes) = (HashSet::new(), 0);
    for (_, path) in blocks_of(set)? {
        for entry in ReadBlock::open(path)?.entries.iter().filter(|entry| level_of(entry.key) == level) {
            tiles.insert(entry.key >> 8);
            bytes += u64::from(entry.size) + ENTRY_BYTES as u64;
        }
    }
    Ok((tiles.len() as u64, bytes))
}
