//! The journal of a run: one file for each block that is complete, with its record. It lies in the folder that the run writes, so that
//! a run that was killed is continued from it. It stays in the set, so that `--update` finds what it can keep.
//!
//! Worlds have a list of complete tiles instead, which is removed with the journal when the set is complete.

use std::collections::HashMap;
use std::fs::File;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use super::tile_set::write_whole;
use crate::GenError;
use crate::pyramid::{Record, TileKey, checksum};

/// The journal's folder inside the folder of the set.
pub(crate) const JOURNAL: &str = ".terrane-gen-journal";
/// The list of complete tiles in it.
const TILES: &str = "tiles";

/// The records of the blocks that are complete. Threads share it.
pub(crate) struct Journal {
    folder: PathBuf,
}

impl Journal {
    /// Opens the journal in the folder of a set.
    pub fn new(set: &Path) -> Self {
        Self { folder: set.join(JOURNAL) }
    }

    /// Returns the path of a file beside the records.
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn path(&self, root: TileKey) -> PathBuf {
        self.folder.join(format!("{}/{}/{}", root.level, root.x, root.y))
    }

    /// Returns the record of a block; `None` if the block is not complete, or if its file is damaged.
    pub fn load(&self, root: TileKey) -> Result<Option<Record>, GenError> {
        let path = self.path(root);
        match std::fs::read(&path) {
            Ok(bytes) => Ok(Record::from_bytes(&bytes)),
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
            Err(reason) => Err(GenError::File { path, reason }),
        }
    }

    /// Stores the record of a block. Its tiles have been written.
    pub fn save(&self, root: TileKey, record: &Record) -> Result<(), GenError> {
        let path = self.path(root);
        self.make_folder(&path)?;
        write_whole(&path, &record.to_bytes()).map(|_| ())
    }

    /// Stores a file beside the records.
    pub fn save_file(&self, name: &str, bytes: &[u8]) -> Result<(), GenError> {
        let path = self.file(name);
        self.make_folder(&path)?;
        write_whole(&path, bytes).map(|_| ())
    }

    fn make_folder(&self, path: &Path) -> Result<(), GenError> {
        let Some(folder) = path.parent() else { return Ok(()) };
        std::fs::create_dir_all(folder).map_err(GenError::file(folder))
    }

    /// Returns true if any block or tile is complete.
    pub fn has_blocks(&self) -> bool {
        self.folder.is_dir()
    }

    /// Removes the journal.
    pub fn remove(&self) -> Result<(), GenError> {
        match std::fs::remove_dir_all(&self.folder) {
            Err(reason) if reason.kind() != ErrorKind::NotFound => {
                Err(GenError::File { path: self.folder.clone(), reason })
            }
            _ => Ok(()),
        }
    }

    /// Opens the list of complete tiles.
    pub fn tiles(&self) -> Result<TileList, GenError> {
        let path = self.file(TILES);
        self.make_folder(&path)?;
        let text = match std::fs::read(&path) {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(e) if e.kind() == ErrorKind::NotFound => String::new(),
            Err(reason) => return Err(GenError::File { path, reason }),
        };
        let complete = text.split('\n').filter_map(CompleteTile::parse).collect();
        let mut file = File::options().append(true).create(true).open(&path).map_err(GenError::file(&path))?;
        // The last line of a killed run may be incomplete.
        file.write_all(b"\n").map_err(GenError::file(&path))?;
        Ok(TileList { complete, file, path })
    }
}

/// A tile whose files are complete.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CompleteTile {
    /// The size of its files in bytes.
    pub bytes: u64,
    /// The lowest and the highest height in metres.
    pub range_m: [f32; 2],
}

impl CompleteTile {
    /// Returns a line of the list, with a checksum at the end.
    fn line(&self, key: TileKey) -> String {
        let [low, high] = self.range_m.map(f32::to_bits);
        let text = format!("{} {} {} {} {low:x} {high:x}", key.level, key.x, key.y, self.bytes);
        format!("{text} {:016x}\n", checksum(text.as_bytes()))
    }

    /// Reads a line; `None` if it is damaged.
    fn parse(line: &str) -> Option<(TileKey, Self)> {
        let (text, sum) = line.rsplit_once(' ')?;
        if u64::from_str_radix(sum, 16).ok()? != checksum(text.as_bytes()) {
            return None;
        }
        let words: Vec<&str> = text.split(' ').collect();
        let [level, x, y, bytes, low, high] = words[..] else { return None };
        let key = TileKey { level: level.parse().ok()?, x: x.parse().ok()?, y: y.parse().ok()? };
        let height = |bits: &str| Some(f32::from_bits(u32::from_str_radix(bits, 16).ok()?));
        Some((key, Self { bytes: bytes.parse().ok()?, range_m: [height(low)?, height(high)?] }))
    }
}

/// The tiles of a world that are complete, one in each line of a file. Threads share it.
pub(crate) struct TileList {
    complete: HashMap<TileKey, CompleteTile>,
    /// Opened for appending: a line is one write.
    file: File,
    path: PathBuf,
}

impl TileList {
    /// Returns a tile that an earlier run has completed.
    pub fn get(&self, key: TileKey) -> Option<CompleteTile> {
        self.complete.get(&key).copied()
    }

    /// Adds a tile whose files are complete.
    pub fn add(&self, key: TileKey, tile: &CompleteTile) -> Result<(), GenError> {
        (&self.file).write_all(tile.line(key).as_bytes()).map_err(GenError::file(&self.path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_tiles_are_read_back_without_damaged_lines() {
        let folder = tempfile::tempdir().unwrap();
        let journal = Journal::new(folder.path());
        let key = |x: u32| TileKey { level: 3, x, y: 7 };
        let tile = |k: u32| CompleteTile { bytes: u64::from(k), range_m: [-0.5, k as f32] };
        let list = journal.tiles().unwrap();
        (0..5).for_each(|x| list.add(key(x), &tile(x)).unwrap());
        let path = journal.file(TILES);
        let mut bytes = std::fs::read(&path).unwrap();
        // A killed run has written a part of its last line, and one line is damaged.
        bytes.truncate(bytes.len() - 9);
        bytes[4] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let list = journal.tiles().unwrap();
        list.add(key(5), &tile(5)).unwrap();
        let list = journal.tiles().unwrap();
        let found: Vec<_> = (0..6).map(|x| list.get(key(x))).collect();
        assert_eq!(found, [None, Some(tile(1)), Some(tile(2)), Some(tile(3)), None, Some(tile(5))]);
    }
}
