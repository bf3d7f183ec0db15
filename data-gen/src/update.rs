//! `--update`: takes from a finished set the blocks that a new run would make again with the same bytes, so that the run finds
//! them complete, as those of a killed run.
//!
//! A block of the finest layer is kept if no changed source lies within its reach, and if the heights beyond the reach that it was
//! made of are the same (`pyramid::dependencies`). If only vertices of coarser tiles are others, their errors are measured again. A block
//! above is kept if all records that it was made of are. Where only imagery has changed, blocks are made with the files of the tiles
//! that it does not touch. Other options or another grid keep nothing.

use std::collections::HashSet;
use std::f64::consts::TAU;
use std::io::{ErrorKind, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::color::{Imagery, TEXELS};
use crate::fingerprint::{options_text, source_text};
use crate::generate::Opened;
use crate::output::{Journal, blocks, write_whole};
use crate::pyramid::{Block, CELLS, Layer, Record, TileKey, Window};
use crate::{Color, GenArgs, GenError};

/// The name of the manifest in the journal.
const MANIFEST: &str = "sources.json";
/// The extensions of the files of tiles.
const EXTENSIONS: [&str; 5] = ["exr", "glb", "jpg", "png", "webp"];
/// The first bytes of gzip.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];
/// A tile that is compressed is not larger.
const MAX_TILE_BYTES: u64 = 1 << 30;

/// Records the options and sources that the blocks of a set were made of.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Manifest {
    /// The version, the options, and what is not a source of elevation.
    options: String,
    /// The grid, and what is taken from all sources together.
    grid: String,
    sources: Vec<Source>,
    #[serde(default)]
    imagery: Vec<Source>,
}

/// A source of elevation or imagery.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Source {
    /// The name, the size and the time of the file, and of those beside it.
    file: String,
    /// West, south, east and north in radians.
    bounds: [f64; 4],
    /// The same, exactly.
    bits: String,
}

impl Manifest {
    /// Returns the manifest of a run.
    pub fn new(args: &GenArgs, opened: &Opened<'_>) -> Result<Self, GenError> {
        let grid = opened.grid;
        // Colours depend on the heights of the whole set.
        let range_m = if args.color == Color::None { [0.0; 2] } else { grid.coarse_range_m()? };
        let source = |(path, bounds): (&PathBuf, &[f64; 4])| {
            Ok(Source {
                file: source_text(path, args)?,
                bounds: *bounds,
                bits: format!("{:x?}", bounds.map(f64::to_bits)),
            })
        };
        let images = opened.imagery.map(Imagery::bounds).unwrap_or_default();
        Ok(Self {
            options: options_text(args)?,
            grid: format!(
                "{:?} {} {} {:.3e} {:.3e} {range_m:?}",
                grid.extent, grid.levels, opened.is_fine, opened.pixel[0], opened.pixel[1]
            ),
            sources: args.dem.iter().zip(&opened.places).map(source).collect::<Result<_, GenError>>()?,
            imagery: args.imagery.iter().zip(&images).map(source).collect::<Result<_, GenError>>()?,
        })
    }

    /// Stores the manifest in the journal of a set.
    pub fn save(&self, set: &Path) -> Result<(), GenError> {
        let json = serde_json::to_vec(self).map_err(|e| GenError::Encode(e.to_string()))?;
        Journal::new(set).save_file(MANIFEST, &json)
    }

    /// Reads the manifest of a set; `None` if there is none.
    fn read(set: &Path, journal: &Journal) -> Result<Option<Self>, GenError> {
        let parse = |bytes: Vec<u8>| {
            serde_json::from_slice(&bytes).map_err(|e| GenError::invalid(set, format!("{MANIFEST} of the set: {e}")))
        };
        journal.load_file(MANIFEST)?.map(parse).transpose()
    }
}

/// Returns the rectangles of sources that only one of two lists has, or that have another place in the order.
fn changes(old: &[Source], new: &[Source]) -> Vec<[f64; 4]> {
    let mut changed = Vec::new();
    let mut next = 0;
    for source in old {
        match new[next..].iter().position(|other| other == source) {
            Some(skipped) => {
                changed.extend(new[next..next + skipped].iter().map(|source| source.bounds));
                next += skipped + 1;
            }
            None => changed.push(source.bounds),
        }
    }
    changed.extend(new[next..].iter().map(|source| source.bounds));
    changed
}

/// Puts the blocks of a finished set that stay the same into the folder of a run. Returns a sentence for the user.
pub(crate) fn keep_blocks(args: &GenArgs, opened: &Opened<'_>, set: &Path, folder: &Path) -> Result<String, GenError> {
    let layers = &opened.plan.layers;
    let below_root = |layer: &Layer| layer.root > 0 || opened.grid.is_aligned();
    let all: Vec<Vec<TileKey>> = layers
        .iter()
        .map(|layer| if below_root(layer) { blocks(opened.grid, *layer) } else { vec![TileKey::ROOT] })
        .collect();
    let count: usize = all.iter().map(Vec::len).sum();
    let journal = Journal::new(set);
    let Some(old) = Manifest::read(set, &journal)? else {
        return Ok(format!("{} has no manifest; all {count} blocks are made", set.display()));
    };
    let new = Manifest::new(args, opened)?;
    if old.options != new.options {
        return Ok(format!("the options are others; all {count} blocks are made"));
    }
    if old.grid != new.grid {
        let hint = if args.run.aligned { "" } else { "; sets made with --aligned keep theirs" };
        return Ok(format!(
            "the bounds, the range of heights or the levels are others; all {count} blocks are made{hint}"
        ));
    }
    let changes = [changes(&old.sources, &new.sources), changes(&old.imagery, &new.imagery)];
    let [elevation, imagery] = changes;
    let mut update =
        Update { args, opened, set, journal, folder, changes: elevation, painted: imagery, same: HashSet::new() };
    let (mut kept, mut measured) = (0, 0);
    let mut parts = 0;
    for (k, layer) in layers.iter().enumerate().filter(|(_, layer)| below_root(layer)) {
        let below: Option<HashSet<TileKey>> = k.checked_sub(1).map(|k| all[k].iter().copied().collect());
        let found: Result<Vec<Kept>, GenError> =
            all[k].par_iter().map(|key| update.keep(*layer, below.as_ref(), *key)).collect();
        for (key, found) in all[k].iter().zip(found?) {
            match found {
                Kept::Same => {
                    kept += 1;
                    update.same.insert(*key);
                }
                Kept::Measured => {
                    kept += 1;
                    measured += 1;
                }
                Kept::Painted { tiles } => {
                    parts += tiles;
                    update.same.insert(*key);
                }
                Kept::No => {}
            }
        }
    }
    if !opened.grid.is_aligned() && update.changes.is_empty() {
        // The block of the root has no record. Its tiles only depend on sources.
        let finest = layers.last().map_or(0, |layer| layer.finest);
        parts += update.take_unpainted(TileKey::ROOT, finest)?;
    }
    let made = count - kept;
    Ok(format!(
        "{kept} blocks are kept, {measured} of them with new errors; {made} are made, of which {parts} tiles are kept"
    ))
}

/// Whether a block is kept.
enum Kept {
    /// With its record.
    Same,
    /// With its tiles, but with another record: the errors of the tiles above it are measured again.
    Measured,
    /// Its record stays, but changed imagery touches it. Some of its tiles are kept.
    Painted {
        tiles: usize,
    },
    No,
}

struct Update<'a> {
    args: &'a GenArgs,
    opened: &'a Opened<'a>,
    set: &'a Path,
    /// The journal of the set.
    journal: Journal,
    folder: &'a Path,
    /// Rectangles whose heights may have changed, in radians.
    changes: Vec<[f64; 4]>,
    /// Rectangles whose imagery may have changed, in radians.
    painted: Vec<[f64; 4]>,
    /// The blocks whose records are kept, of the layers that are done.
    same: HashSet<TileKey>,
}

impl Update<'_> {
    /// Keeps a block if it stays the same. `below` are the blocks of the next finer layer; `None` for the finest one.
    fn keep(&self, layer: Layer, below: Option<&HashSet<TileKey>>, key: TileKey) -> Result<Kept, GenError> {
        let (grid, journal) = (self.opened.grid, &self.journal);
        let Some(mut record) = journal.load(key)? else { return Ok(Kept::No) };
        let paints = self.args.color != Color::None;
        if let Some(below) = below {
            for used in Block::records_of(grid, layer, key, paints) {
                let is_same = match below.contains(&used) {
                    true => self.same.contains(&used),
                    false => journal.load(used)?.is_none(),
                };
                if !is_same {
                    return Ok(Kept::No);
                }
            }
        }
        if self.is_near_a_change(key, record.dependencies.reach) || !record.dependencies.has_same_gaps(grid)? {
            return Ok(Kept::No);
        }
        if self.is_painted(key) {
            let tiles = self.take_unpainted(key, layer.finest)?;
            return Ok(if record.dependencies.has_same_vertices(grid)? { Kept::Painted { tiles } } else { Kept::No });
        }
        let mut kept = Kept::Same;
        if !record.dependencies.has_same_vertices(grid)? {
            record = Block::sample(grid, layer, key, paints)?.measured_again(record);
            kept = Kept::Measured;
        }
        Ok(if self.take(layer, key, &record)? { kept } else { Kept::No })
    }

    /// Returns true if a change lies within a number of cells of the finest lattice from a tile.
    fn is_near_a_change(&self, key: TileKey, reach: i64) -> bool {
        let grid = self.opened.grid;
        let side = (CELLS as i64) << (grid.levels - 1 - key.level);
        // Heights between pixels depend on those around them.
        let reach = reach + 2;
        let first = [key.x, key.y].map(|c| i64::from(c) * side);
        let near = grid.extent_of(&Window { first: first.map(|c| c - reach), last: first.map(|c| c + side + reach) });
        self.changes.iter().any(|[west, south, east, north]| {
            // The sides of a raster may be curves.
            let [dx, dy] = [east - west, north - south].map(|side| 0.02 * side);
            let (dx, dy) = (dx + 3.0 * self.opened.pixel[0], dy + 3.0 * self.opened.pixel[1]);
            west - dx <= near.east && east + dx >= near.west && south - dy <= near.north && north + dy >= near.south
        })
    }

    /// Returns true if changed imagery lies in a tile, or within two of its texels.
    fn is_painted(&self, key: TileKey) -> bool {
        let e = key.extent(&self.opened.grid.extent);
        let [dx, dy] = [e.east - e.west, e.north - e.south].map(|side| 2.0 * side / f64::from(TEXELS));
        self.painted.iter().any(|[west, south, east, north]| {
            // The sides of an image may be curves.
            let (dx, dy) = (dx + 0.02 * (east - west), dy + 0.02 * (north - south));
            let is_near = |turn: &f64| west - dx <= e.east + turn && east + dx >= e.west + turn;
            south - dy <= e.north && north + dy >= e.south && [0.0, TAU, -TAU].iter().any(is_near)
        })
    }

    /// Puts the files of the tiles below a root that changed imagery does not touch into the folder, so that the run does not make them
    /// again. Returns the number of tiles.
    fn take_unpainted(&self, root: TileKey, finest: u32) -> Result<usize, GenError> {
        let (mut keys, mut tiles) = (vec![root], 0);
        while let Some(key) = keys.pop() {
            if !self.is_painted(key) {
                let names = self.files(key);
                tiles += usize::from(!names.is_empty());
                names.iter().try_for_each(|(name, _)| self.copy(name))?;
            }
            if key.level < finest {
                keys.extend(key.children());
            }
        }
        Ok(tiles)
    }

    /// Returns the files of a tile with their sizes.
    fn files(&self, key: TileKey) -> Vec<(String, u64)> {
        let file = |extension: &&str| {
            let name = format!("{}/{}/{}.{extension}", key.level, key.x, key.y);
            let file = self.set.join(&name).symlink_metadata().ok().filter(|file| file.is_file())?;
            Some((name, file.len()))
        };
        EXTENSIONS.iter().filter_map(file).collect()
    }

    /// Puts a file into the folder as the run would write it: it is compressed later.
    fn copy(&self, name: &str) -> Result<(), GenError> {
        let from = self.set.join(name);
        if !self.args.output.gzip || !name.ends_with("glb") {
            return self.link(name);
        }
        let bytes = std::fs::read(&from).map_err(GenError::file(&from))?;
        if !bytes.starts_with(&GZIP_MAGIC) {
            return self.link(name);
        }
        let mut content = Vec::new();
        GzDecoder::new(&*bytes).take(MAX_TILE_BYTES).read_to_end(&mut content).map_err(GenError::file(&from))?;
        let to = self.folder.join(name);
        make_folder_of(&to)?;
        write_whole(&to, &content).map(|_| ())
    }

    /// Returns the size of a file as the run would write it. A compressed file ends with it.
    fn whole_size(&self, name: &str, size: u64) -> Result<u64, GenError> {
        let path = self.set.join(name);
        if !self.args.output.gzip || !name.ends_with("glb") || size < 20 {
            return Ok(size);
        }
        let read = || {
            let mut file = std::fs::File::open(&path)?;
            let (mut magic, mut end) = ([0; 2], [0; 4]);
            file.read_exact(&mut magic)?;
            file.seek(SeekFrom::End(-4))?;
            file.read_exact(&mut end)?;
            Ok(if magic == GZIP_MAGIC { u32::from_le_bytes(end).into() } else { size })
        };
        read().map_err(GenError::file(&path))
    }

    /// Links the files of a block, or copies them. Returns false if some are missing, or have other sizes in total.
    fn take(&self, layer: Layer, root: TileKey, record: &Record) -> Result<bool, GenError> {
        let mut keys = vec![root];
        let (mut names, mut tiles, mut bytes) = (Vec::new(), 0, 0);
        while let Some(key) = keys.pop() {
            let files = self.files(key);
            tiles += u64::from(!files.is_empty());
            for (name, size) in files {
                bytes += self.whole_size(&name, size)?;
                names.push(name);
            }
            if key.level < layer.finest {
                keys.extend(key.children());
            }
        }
        if (tiles, bytes) != (record.totals.tiles, record.totals.bytes) {
            return Ok(false);
        }
        names.iter().try_for_each(|name| self.link(name))?;
        Journal::new(self.folder).save(root, record)?;
        Ok(true)
    }

    /// Links a file of the set into the folder, or copies it.
    fn link(&self, name: &str) -> Result<(), GenError> {
        let (from, to) = (self.set.join(name), self.folder.join(name));
        make_folder_of(&to)?;
        match std::fs::hard_link(&from, &to) {
            Ok(()) => Ok(()),
            // A killed run has linked it.
            Err(e) if e.kind() == ErrorKind::AlreadyExists => Ok(()),
            Err(_) => {
                let content = std::fs::read(&from).map_err(GenError::file(&from))?;
                write_whole(&to, &content).map(|_| ())
            }
        }
    }
}

fn make_folder_of(file: &Path) -> Result<(), GenError> {
    let Some(folder) = file.parent() else { return Ok(()) };
    std::fs::create_dir_all(folder).map_err(GenError::file(folder))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_that_change_or_move_in_the_order_are_changes() {
        let source =
            |name: char| Source { file: name.into(), bounds: [f64::from(name as u32); 4], bits: String::new() };
        let sources = |names: &str| names.chars().map(source).collect::<Vec<_>>();
        for (old, new, changed) in [
            ("abc", "abc", ""),
            ("abc", "ac", "b"),
            ("ac", "abc", "b"),
            ("ab", "cab", "c"),
            ("ab", "ba", "bb"),
            ("a", "", "a"),
        ] {
            let mut found: Vec<char> =
                changes(&sources(old), &sources(new)).iter().map(|b| char::from(b[0] as u8)).collect();
            found.sort_unstable();
            assert_eq!(found.into_iter().collect::<String>(), changed, "{old} {new}");
        }
    }
}
