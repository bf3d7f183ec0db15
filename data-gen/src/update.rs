//! `--update`: takes from a finished set the blocks that a new run would make again with the same bytes, so that the run finds
//! them complete, as those of a killed run.
//!
//! A block of the finest layer is kept if no changed source lies within its reach, and if the heights beyond the reach that it was
//! made of are the same (`pyramid::dependencies`). If only vertices of coarser tiles are others, their errors are measured again. A block
//! above is kept if all records that it was made of are.
//! Other options, another grid or other imagery keep nothing.

use std::collections::HashSet;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::fingerprint::{options_text, source_text};
use crate::generate::Opened;
use crate::output::{Journal, blocks, write_whole};
use crate::pyramid::{Block, CELLS, Layer, Record, TileKey, Window};
use crate::{Color, GenArgs, GenError};

/// The name of the manifest in the journal.
const MANIFEST: &str = "sources.json";
/// The extensions of the files of tiles.
const EXTENSIONS: [&str; 5] = ["exr", "glb", "jpg", "png", "webp"];

/// Records the options and sources that the blocks of a set were made of.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Manifest {
    /// The version, the options, and what is not a source of elevation.
    options: String,
    /// The grid, and what is taken from all sources together.
    grid: String,
    sources: Vec<Source>,
}

/// A source of elevation.
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
            Ok(Source { file: source_text(path)?, bounds: *bounds, bits: format!("{:x?}", bounds.map(f64::to_bits)) })
        };
        Ok(Self {
            options: options_text(args)?,
            grid: format!(
                "{:?} {} {} {:.3e} {:.3e} {range_m:?}",
                grid.extent, grid.levels, opened.is_fine, opened.pixel[0], opened.pixel[1]
            ),
            sources: args.dem.iter().zip(&opened.places).map(source).collect::<Result<_, GenError>>()?,
        })
    }

    /// Stores the manifest in the journal of a set.
    pub fn save(&self, set: &Path) -> Result<(), GenError> {
        let json = serde_json::to_vec(self).map_err(|e| GenError::Encode(e.to_string()))?;
        Journal::new(set).save_file(MANIFEST, &json)
    }

    /// Reads the manifest of a set; `None` if there is none.
    fn read(set: &Path) -> Result<Option<Self>, GenError> {
        let path = Journal::new(set).file(MANIFEST);
        match std::fs::read(&path) {
            Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|e| GenError::invalid(path, e.to_string())),
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(None),
            Err(reason) => Err(GenError::File { path, reason }),
        }
    }

    /// Returns the rectangles of sources that only one of two manifests has, or that have another place in the order.
    fn changes(&self, other: &Self) -> Vec<[f64; 4]> {
        let mut changed = Vec::new();
        let mut next = 0;
        for source in &self.sources {
            match other.sources[next..].iter().position(|other| other == source) {
                Some(skipped) => {
                    changed.extend(other.sources[next..next + skipped].iter().map(|source| source.bounds));
                    next += skipped + 1;
                }
                None => changed.push(source.bounds),
            }
        }
        changed.extend(other.sources[next..].iter().map(|source| source.bounds));
        changed
    }
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
    let Some(old) = Manifest::read(set)? else {
        return Ok(format!("{} has no journal of blocks; all {count} are made", set.display()));
    };
    let new = Manifest::new(args, opened)?;
    if old.options != new.options {
        return Ok(format!("the options or the imagery are others; all {count} blocks are made"));
    }
    if old.grid != new.grid {
        let hint = if args.run.aligned { "" } else { "; sets made with --aligned keep theirs" };
        return Ok(format!(
            "the bounds, the range of heights or the levels are others; all {count} blocks are made{hint}"
        ));
    }
    let changes = old.changes(&new);
    let mut update = Update { args, opened, set, folder, changes, same: HashSet::new() };
    let mut measured = 0;
    for (k, layer) in layers.iter().enumerate().filter(|(_, layer)| below_root(layer)) {
        let below: Option<HashSet<TileKey>> = k.checked_sub(1).map(|k| all[k].iter().copied().collect());
        let kept: Result<Vec<Kept>, GenError> =
            all[k].par_iter().map(|key| update.keep(*layer, below.as_ref(), *key)).collect();
        for (key, kept) in all[k].iter().zip(kept?) {
            match kept {
                Kept::Same => {
                    update.same.insert(*key);
                }
                Kept::Measured => measured += 1,
                Kept::No => {}
            }
        }
    }
    let kept = update.same.len() + measured;
    Ok(format!("{kept} blocks are kept, {measured} of them with new errors; {} are made", count - kept))
}

/// Whether a block is kept.
enum Kept {
    /// With its record.
    Same,
    /// With its tiles, but with another record: the errors of the tiles above it are measured again.
    Measured,
    No,
}

struct Update<'a> {
    args: &'a GenArgs,
    opened: &'a Opened<'a>,
    set: &'a Path,
    folder: &'a Path,
    /// Rectangles whose heights may have changed, in radians.
    changes: Vec<[f64; 4]>,
    /// The blocks whose records are kept, of the layers that are done.
    same: HashSet<TileKey>,
}

impl Update<'_> {
    /// Keeps a block if it stays the same. `below` are the blocks of the next finer layer; `None` for the finest one.
    fn keep(&self, layer: Layer, below: Option<&HashSet<TileKey>>, key: TileKey) -> Result<Kept, GenError> {
        let (grid, journal) = (self.opened.grid, Journal::new(self.set));
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

    /// Links the files of a block, or copies them. Returns false if some are missing, or have other sizes in total.
    fn take(&self, layer: Layer, root: TileKey, record: &Record) -> Result<bool, GenError> {
        let mut keys = vec![root];
        let (mut names, mut tiles, mut bytes) = (Vec::new(), 0, 0);
        while let Some(key) = keys.pop() {
            let before = names.len();
            for extension in EXTENSIONS {
                let name = format!("{}/{}/{}.{extension}", key.level, key.x, key.y);
                if let Ok(file) = self.set.join(&name).symlink_metadata()
                    && file.is_file()
                {
                    bytes += file.len();
                    names.push(name);
                }
            }
            tiles += u64::from(names.len() > before);
            if key.level < layer.finest {
                keys.extend(key.children());
            }
        }
        if (tiles, bytes) != (record.totals.tiles, record.totals.bytes) {
            return Ok(false);
        }
        for name in names {
            let (from, to) = (self.set.join(&name), self.folder.join(&name));
            if let Some(folder) = to.parent() {
                std::fs::create_dir_all(folder).map_err(GenError::file(folder))?;
            }
            match std::fs::hard_link(&from, &to) {
                Ok(()) => {}
                // A killed run has linked it.
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
                Err(_) => {
                    let content = std::fs::read(&from).map_err(GenError::file(&from))?;
                    write_whole(&to, &content)?;
                }
            }
        }
        Journal::new(self.folder).save(root, record)?;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_that_change_or_move_in_the_order_are_changes() {
        let source =
            |name: char| Source { file: name.into(), bounds: [f64::from(name as u32); 4], bits: String::new() };
        let manifest = |names: &str| Manifest {
            options: String::new(),
            grid: String::new(),
            sources: names.chars().map(source).collect(),
        };
        for (old, new, changed) in [
            ("abc", "abc", ""),
            ("abc", "ac", "b"),
            ("ac", "abc", "b"),
            ("ab", "cab", "c"),
            ("ab", "ba", "bb"),
            ("a", "", "a"),
        ] {
            let mut found: Vec<char> =
                manifest(old).changes(&manifest(new)).iter().map(|b| char::from(b[0] as u8)).collect();
            found.sort_unstable();
            assert_eq!(found.into_iter().collect::<String>(), changed, "{old} {new}");
        }
    }
}
