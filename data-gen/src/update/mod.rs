//! `--update`: takes from a finished set the blocks that a new run would make again with the same bytes, so that the run finds
//! them complete, as those of a killed run.
//!
//! A block of the finest layer is kept if no changed source lies within its reach, and if the heights beyond the reach that it
//! was made of are the same (`pyramid::dependencies`). If only vertices of coarser tiles are others, their errors are measured
//! again. A block above is kept if all records that it was made of are. Where only imagery has changed, blocks are made with
//! the files of the tiles that it does not touch. Other options or another grid keep nothing.

mod manifest;
mod old_set;
mod terrain;

use std::collections::HashSet;
use std::f64::consts::TAU;
use std::path::Path;

use rayon::prelude::*;
use terrane::math::WGS84;

pub(crate) use self::manifest::Manifest;
use self::manifest::changes;
pub(crate) use self::old_set::{LocalSet, OldSet};
pub(crate) use self::terrain::TerrainUpdate;
use crate::color::TEXELS;
use crate::opened::Opened;
use crate::output::{Journal, blocks};
use crate::pyramid::{Block, CELLS, Layer, Record, TileKey, Window};
use crate::{Color, Extent, GenArgs, GenError};

/// The extensions of the files of tiles.
const EXTENSIONS: [&str; 5] = ["exr", "glb", "jpg", "png", "webp"];
/// A lower bound of the distance from the earth's centre to its surface.
const MIN_RADIUS_M: f64 = 6.3e6;

/// Puts the blocks of a finished set that stay the same into the folder of a run. Returns a sentence for the user.
pub(crate) fn keep_blocks(
    args: &GenArgs,
    opened: &Opened<'_>,
    set: &dyn OldSet,
    folder: &Path,
) -> Result<String, GenError> {
    let layers = &opened.plan.layers;
    let below_root = |layer: &Layer| layer.root > 0 || opened.grid.is_aligned();
    let all: Vec<Vec<TileKey>> = layers
        .iter()
        .map(|layer| if below_root(layer) { blocks(opened.grid, *layer) } else { vec![TileKey::ROOT] })
        .collect();
    let count: usize = all.iter().map(Vec::len).sum();
    let journal = set.journal();
    let Some(old) = Manifest::read(set, &journal)? else {
        return Ok(format!("{} has no manifest; all {count} blocks are made", set.name()));
    };
    let new = Manifest::new(args, opened)?;
    if let Some(reason) = new.difference_from(&old) {
        let is_hinted = reason.contains("bounds") && !args.run.aligned;
        let hint = if is_hinted { "; sets made with --aligned keep theirs" } else { "" };
        return Ok(format!("{reason}; all {count} blocks are made{hint}"));
    }
    let changes = [changes(&old.sources, &new.sources), changes(&old.imagery, &new.imagery)];
    let [elevation, imagery] = changes;
    let (pixel, same) = (new.pixel_with(&old), HashSet::new());
    let mut update = Update { args, opened, set, journal, folder, changes: elevation, pixel, painted: imagery, same };
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
    set: &'a dyn OldSet,
    /// The journal of the set.
    journal: Journal,
    folder: &'a Path,
    /// Rectangles whose heights may have changed, in radians.
    changes: Vec<[f64; 4]>,
    /// The size of a pixel, east and north, in radians.
    pixel: [f64; 2],
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
        // On a small body the band is a wide angle.
        let blend_m = self.args.blend * (WGS84.semi_major_m / self.opened.grid.ellipsoid.semi_major_m);
        is_near_any(&self.changes, &near, elevation_margin(blend_m, self.pixel, &near))
    }

    /// Returns true if changed imagery lies in a tile, or within two of its texels.
    fn is_painted(&self, key: TileKey) -> bool {
        let e = key.extent(&self.opened.grid.extent);
        let [dx, dy] = [e.east - e.west, e.north - e.south].map(|side| 2.0 * side / f64::from(TEXELS));
        is_near_any(&self.painted, &e, [dx, dy])
    }

    /// Puts the files of the tiles below a root that changed imagery does not touch into the folder, so that the run does not
    /// make them again. Returns the number of tiles.
    fn take_unpainted(&self, root: TileKey, finest: u32) -> Result<usize, GenError> {
        let (mut keys, mut tiles) = (vec![root], 0);
        while let Some(key) = keys.pop() {
            if !self.is_painted(key) {
                let names = self.files(key);
                tiles += usize::from(!names.is_empty());
                names.iter().try_for_each(|(name, _)| self.set.copy_plain(name, self.folder))?;
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
            let size = self.set.size(&name)?;
            Some((name, size))
        };
        EXTENSIONS.iter().filter_map(file).collect()
    }

    /// Keeps the files of a block. Returns false if some are missing, or have other sizes in total.
    fn take(&self, layer: Layer, root: TileKey, record: &Record) -> Result<bool, GenError> {
        let mut keys = vec![root];
        let (mut names, mut tiles, mut bytes) = (Vec::new(), 0, Some(0));
        while let Some(key) = keys.pop() {
            let files = self.files(key);
            tiles += u64::from(!files.is_empty());
            for (name, size) in files {
                let is_compressed = self.args.output.gzip && name.ends_with("glb");
                let plain = if is_compressed { self.set.plain_size(&name, size)? } else { Some(size) };
                bytes = bytes.zip(plain).map(|(sum, own)| sum + own);
                names.push(name);
            }
            if key.level < layer.finest {
                keys.extend(key.children());
            }
        }
        let totals = &record.totals;
        if tiles != totals.tiles || bytes.is_some_and(|bytes| bytes != totals.bytes) {
            return Ok(false);
        }
        names.iter().try_for_each(|name| self.set.keep(name, self.folder))?;
        Journal::new(self.folder).save(root, record)?;
        Ok(true)
    }
}

/// Returns true if a source lies within a margin of a rectangle, whose longitudes may be a turn off.
fn is_near_any(sources: &[[f64; 4]], near: &Extent, margin: [f64; 2]) -> bool {
    sources.iter().any(|[west, south, east, north]| {
        // The sides of a raster may be curves.
        let (dx, dy) = (margin[0] + 0.02 * (east - west), margin[1] + 0.02 * (north - south));
        let is_near = |turn: &f64| west - dx <= near.east + turn && east + dx >= near.west + turn;
        south - dy <= near.north && north + dy >= near.south && [0.0, TAU, -TAU].iter().any(is_near)
    })
}

/// Returns how far beyond its rectangle a source of elevation changes heights, in radians: between pixels, and where its
/// neighbours blend into what lies below, in a band with a width in metres on the earth.
fn elevation_margin(blend_m: f64, pixel: [f64; 2], near: &Extent) -> [f64; 2] {
    let band = blend_m / MIN_RADIUS_M;
    let wide = near.south.abs().max(near.north.abs()).cos().max(0.01);
    [3.0 * pixel[0] + band / wide, 3.0 * pixel[1] + band]
}
