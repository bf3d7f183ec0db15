//! The journal of a run: one file for each block that is complete, with its record. It lies in the folder that the run writes,
//! so that a run that was killed is continued from it. When the set is complete, the records of a set that `--update` can
//! change are packed into one file, a zip archive, and the folder is removed.
//!
//! Worlds have a list of complete tiles instead, which is removed with the journal when the set is complete.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use terrane::math::random::fnv1a;
use zip::ZipArchive;
use zip::result::ZipError;

use super::archive::write_archive;
use super::set_files::{MANIFEST, write_whole};
use crate::pyramid::{Record, TileKey};
use crate::{GenError, Shard};

/// The journal's folder inside the folder of the set.
pub(crate) const JOURNAL: &str = ".terrane-gen-journal";
/// The name of [`MANIFEST`] while it is written.
const UNFINISHED: &str = ".manifest.unfinished";
/// The list of complete tiles in the journal.
const TILES: &str = "tiles";
/// Packed files are not larger.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// The records of the blocks that are complete. Threads share it.
pub(crate) struct Journal {
    set: PathBuf,
    folder: PathBuf,
    /// The journal of a complete set. Locked while a file is read.
    packed: Option<Mutex<ZipArchive<BufReader<File>>>>,
}

impl Journal {
    /// Opens the journal in the folder of a set. A packed one that cannot be read counts as missing.
    pub fn new(set: &Path) -> Self {
        let packed = File::open(set.join(MANIFEST)).ok().and_then(|file| ZipArchive::new(BufReader::new(file)).ok());
        Self { set: set.to_path_buf(), folder: set.join(JOURNAL), packed: packed.map(Mutex::new) }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Returns the content of a file of the journal; `None` if it is missing.
    pub fn load_file(&self, name: &str) -> Result<Option<Vec<u8>>, GenError> {
        let path = self.file(name);
        match std::fs::read(&path) {
            Ok(bytes) => return Ok(Some(bytes)),
            Err(e) if [ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&e.kind()) => {}
            Err(reason) => return Err(GenError::File { path, reason }),
        }
        let Some(packed) = &self.packed else { return Ok(None) };
        let mut packed = packed.lock().unwrap_or_else(PoisonError::into_inner);
        let failed = |reason: String| GenError::invalid(self.set.join(MANIFEST), format!("{name}: {reason}"));
        let file = match packed.by_name(name) {
            Ok(file) => file,
            Err(ZipError::FileNotFound) => return Ok(None),
            Err(error) => return Err(failed(error.to_string())),
        };
        let mut bytes = Vec::new();
        file.take(MAX_FILE_BYTES).read_to_end(&mut bytes).map_err(|e| failed(e.to_string()))?;
        Ok(Some(bytes))
    }

    /// Returns the record of a block; `None` if the block is not complete, or if its file is damaged.
    pub fn load(&self, root: TileKey) -> Result<Option<Record>, GenError> {
        Ok(self.load_file(&name(root))?.and_then(|bytes| Record::from_bytes(&bytes)))
    }

    /// Stores the record of a block. Its tiles have been written.
    pub fn save(&self, root: TileKey, record: &Record) -> Result<(), GenError> {
        self.save_file(&name(root), &record.to_bytes())
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

    /// Returns true if a run has begun a journal.
    pub fn exists(&self) -> bool {
        self.folder.is_dir() || self.packed.is_some()
    }

    /// Packs the journal of a complete set into one file and removes its folder.
    pub fn pack(&self) -> Result<(), GenError> {
        if !self.folder.is_dir() {
            return Ok(());
        }
        // A run that was killed has packed it, and perhaps removed a part of the folder.
        let names: Vec<String> = match &self.packed {
            Some(packed) => {
                let packed = packed.lock().unwrap_or_else(PoisonError::into_inner);
                packed.file_names().flatten().map(|name| name.into_owned()).collect()
            }
            None => Vec::new(),
        };
        for name in names.iter().filter(|name| !name.starts_with('@') && !self.file(name).is_file()) {
            if let Some(bytes) = self.load_file(name)? {
                self.save_file(name, &bytes)?;
            }
        }
        let unfinished = self.set.join(UNFINISHED);
        write_archive(&self.folder, &unfinished)?;
        let packed = self.set.join(MANIFEST);
        std::fs::rename(&unfinished, &packed).map_err(GenError::file(&packed))?;
        self.remove()
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

    /// Returns the tiles of a complete set.
    pub fn kept_tiles(&self) -> Result<HashMap<TileKey, CompleteTile>, GenError> {
        let bytes = self.load_file(TILES)?.unwrap_or_default();
        Ok(String::from_utf8_lossy(&bytes).split('\n').filter_map(parse_line).collect())
    }

    /// Replaces the lists of complete tiles by one whose bytes do not depend on the order in which tiles were made, for a later
    /// update.
    pub fn sort_tiles(&self) -> Result<(), GenError> {
        let complete = self.tiles(None)?.complete;
        let mut tiles: Vec<(TileKey, CompleteTile)> = complete.into_iter().collect();
        tiles.sort_unstable_by_key(|(key, _)| *key);
        let text: String = tiles.iter().map(|(key, tile)| line(*key, tile)).collect();
        self.save_file(TILES, text.as_bytes())?;
        for entry in std::fs::read_dir(&self.folder).map_err(GenError::file(&self.folder))? {
            let path = entry.map_err(GenError::file(&self.folder))?.path();
            if path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(&format!("{TILES}-"))) {
                std::fs::remove_file(&path).map_err(GenError::file(&path))?;
            }
        }
        Ok(())
    }

    /// Opens the list of complete tiles. Those of shards that were merged, whose names have their numbers, are in it.
    pub fn tiles<T: ListedTile>(&self, shard: Option<Shard>) -> Result<TileList<T>, GenError> {
        let own = shard.map_or_else(|| TILES.to_owned(), |shard| format!("{TILES}-{shard}").replace('/', "-of-"));
        let path = self.file(&own);
        self.make_folder(&path)?;
        let mut complete = HashMap::new();
        for entry in std::fs::read_dir(&self.folder).map_err(GenError::file(&self.folder))? {
            let path = entry.map_err(GenError::file(&self.folder))?.path();
            if !path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(TILES)) {
                continue;
            }
            let bytes = std::fs::read(&path).map_err(GenError::file(&path))?;
            complete.extend(String::from_utf8_lossy(&bytes).split('\n').filter_map(parse_line));
        }
        let mut file = File::options().append(true).create(true).open(&path).map_err(GenError::file(&path))?;
        // The last line of a killed run may be incomplete.
        file.write_all(b"\n").map_err(GenError::file(&path))?;
        Ok(TileList { complete, file, path })
    }
}

/// Returns the name of the file of a block's record.
fn name(root: TileKey) -> String {
    format!("{}/{}/{}", root.level, root.x, root.y)
}

/// A tile whose files are complete.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CompleteTile {
    /// The size of its files in bytes.
    pub bytes: u64,
    /// The lowest and the highest height in metres, those of finer tiles included where clients cull by them.
    pub range_m: [f32; 2],
    /// The lowest and the highest vertex with data in metres.
    pub data_m: [f32; 2],
    /// The lowest and the highest vertex in metres, those without data included.
    pub own_m: [f32; 2],
    /// Vertices without data.
    pub voids: u64,
    /// The sources that the tile depends on.
    pub inputs: Inputs,
}

/// The part of the sources that the heights of a tile depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Inputs {
    /// Sources with data at all vertices of the tile and around it.
    Data,
    /// Sources around the tile that fill its voids, and the rectangle of all sources.
    Surroundings,
    /// Heights of the whole set as well, which wide gaps continue.
    Gaps,
}

/// A tile in the list of complete ones.
pub(crate) trait ListedTile: Sized {
    /// Returns it as words in one line.
    fn text(&self) -> String;

    /// Reads the words; `None` if they are not such a tile.
    fn parse(text: &str) -> Option<Self>;
}

/// Returns a line of a list, with a checksum at the end.
fn line(key: TileKey, tile: &impl ListedTile) -> String {
    let TileKey { level, x, y } = key;
    let text = format!("{level} {x} {y} {}", tile.text());
    format!("{text} {:016x}\n", fnv1a(text.as_bytes()))
}

/// Reads a line; `None` if it is damaged.
fn parse_line<T: ListedTile>(line: &str) -> Option<(TileKey, T)> {
    let (text, sum) = line.rsplit_once(' ')?;
    if u64::from_str_radix(sum, 16).ok()? != fnv1a(text.as_bytes()) {
        return None;
    }
    let mut words = text.splitn(4, ' ');
    let mut number = || words.next()?.parse().ok();
    let key = TileKey { level: number()?, x: number()?, y: number()? };
    Some((key, T::parse(words.next()?)?))
}

impl ListedTile for CompleteTile {
    fn text(&self) -> String {
        let [low, high] = self.range_m.map(f32::to_bits);
        let [data_low, data_high] = self.data_m.map(f32::to_bits);
        let [own_low, own_high] = self.own_m.map(f32::to_bits);
        let heights = format!("{low:x} {high:x} {data_low:x} {data_high:x} {own_low:x} {own_high:x}");
        let inputs = match self.inputs {
            Inputs::Data => "d",
            Inputs::Surroundings => "s",
            Inputs::Gaps => "g",
        };
        format!("{} {heights} {} {inputs}", self.bytes, self.voids)
    }

    fn parse(text: &str) -> Option<Self> {
        let words: Vec<&str> = text.split(' ').collect();
        let [bytes, low, high, data_low, data_high, own_low, own_high, voids, inputs] = words[..] else {
            return None;
        };
        let height = |bits: &str| Some(f32::from_bits(u32::from_str_radix(bits, 16).ok()?));
        Some(Self {
            bytes: bytes.parse().ok()?,
            range_m: [height(low)?, height(high)?],
            data_m: [height(data_low)?, height(data_high)?],
            own_m: [height(own_low)?, height(own_high)?],
            voids: voids.parse().ok()?,
            inputs: match inputs {
                "d" => Inputs::Data,
                "s" => Inputs::Surroundings,
                "g" => Inputs::Gaps,
                _ => return None,
            },
        })
    }
}

/// The tiles that are complete, one in each line of a file. Threads share it.
pub(crate) struct TileList<T = CompleteTile> {
    complete: HashMap<TileKey, T>,
    /// Opened for appending: a line is one write.
    file: File,
    path: PathBuf,
}

impl<T: ListedTile + Clone> TileList<T> {
    /// Returns a tile that an earlier run has completed.
    pub fn get(&self, key: TileKey) -> Option<T> {
        self.complete.get(&key).cloned()
    }

    /// Returns all tiles that an earlier run has completed, in no order.
    pub fn all(&self) -> impl Iterator<Item = (&TileKey, &T)> {
        self.complete.iter()
    }

    /// Adds a tile whose files are complete.
    pub fn add(&self, key: TileKey, tile: &T) -> Result<(), GenError> {
        (&self.file).write_all(line(key, tile).as_bytes()).map_err(GenError::file(&self.path))
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
        let tile = |k: u32| CompleteTile {
            bytes: u64::from(k),
            range_m: [-0.5, k as f32],
            data_m: [f32::INFINITY, f32::NEG_INFINITY],
            own_m: [0.25, 0.5],
            voids: 7,
            inputs: [Inputs::Data, Inputs::Surroundings, Inputs::Gaps][k as usize % 3],
        };
        let list = journal.tiles(None).unwrap();
        (0..5).for_each(|x| list.add(key(x), &tile(x)).unwrap());
        let path = journal.file(TILES);
        let mut bytes = std::fs::read(&path).unwrap();
        // A killed run has written a part of its last line, and one line is damaged.
        bytes.truncate(bytes.len() - 9);
        bytes[4] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        let list = journal.tiles(Some("2/3".parse().unwrap())).unwrap();
        list.add(key(5), &tile(5)).unwrap();
        assert!(folder.path().join(JOURNAL).join("tiles-2-of-3").is_file());
        let list = journal.tiles(None).unwrap();
        let found: Vec<_> = (0..6).map(|x| list.get(key(x))).collect();
        let expected = [None, Some(tile(1)), Some(tile(2)), Some(tile(3)), None, Some(tile(5))];
        assert_eq!(found, expected);
        drop(list);
        journal.sort_tiles().unwrap();
        let kept = journal.kept_tiles().unwrap();
        assert_eq!([0, 1, 2, 3, 4, 5].map(|x| kept.get(&key(x)).copied()), expected);
        assert!(!folder.path().join(JOURNAL).join("tiles-2-of-3").exists());
    }
}
