//! `--update` of terrain for globes: takes the tiles of a finished set that a new run would make with the same bytes.
//!
//! The tiling does not depend on the sources, so that a set can grow beyond its bounds. A tile whose vertices all lie on data
//! depends on the sources around it; others also on the rectangle of all sources, and those with wide gaps on heights of the
//! whole set. The header of a tile has the heights of the finer tiles inside, which are made before.

use std::collections::HashMap;
use std::f64::consts::PI;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use super::manifest::{Manifest, TerrainPlace, changes};
use super::{OldSet, elevation_margin, is_near_any};
use crate::georeference::ROUNDING;
use crate::opened::OpenedTerrain;
use crate::output::{CompleteTile, Inputs, METADATA_LEVELS};
use crate::pyramid::TileKey;
use crate::{Extent, GenArgs, GenError};

/// The tiles of a finished set, and what has changed since. Threads share it.
pub(crate) struct TerrainUpdate<'a> {
    args: &'a GenArgs,
    set: &'a dyn OldSet,
    folder: &'a Path,
    /// The tiles of the set that may be kept.
    tiles: HashMap<TileKey, CompleteTile>,
    /// Why there are none; empty if there are.
    reason: String,
    /// Rectangles whose heights may have changed, in radians.
    changes: Vec<[f64; 4]>,
    has_same_bounds: bool,
    has_same_gaps: bool,
    /// The size of a pixel, east and north, in radians.
    pixel: [f64; 2],
    /// The number of tiles that were kept. Added to by all threads.
    kept: AtomicU64,
}

impl<'a> TerrainUpdate<'a> {
    /// Reads what a set was made of. `manifest` is the one of the new run, which writes to `folder`.
    pub fn new(
        args: &'a GenArgs,
        opened: &OpenedTerrain<'_>,
        manifest: &Manifest,
        set: &'a dyn OldSet,
        folder: &'a Path,
    ) -> Result<Self, GenError> {
        let mut update = Self {
            args,
            set,
            folder,
            tiles: HashMap::new(),
            reason: String::new(),
            changes: Vec::new(),
            has_same_bounds: false,
            has_same_gaps: false,
            pixel: opened.pixel,
            kept: AtomicU64::new(0),
        };
        let journal = set.journal();
        let Some(old) = Manifest::read(set, &journal)? else {
            update.reason = format!("{} has no manifest", set.name());
            return Ok(update);
        };
        if let Some(reason) = manifest.difference_from(&old) {
            reason.clone_into(&mut update.reason);
            return Ok(update);
        }
        let (Some(before), Some(now)) = (&old.terrain, &manifest.terrain) else { return Ok(update) };
        update.has_same_bounds = before.bits == now.bits;
        let is_turned = |place: &TerrainPlace| place.bounds[2] > PI + ROUNDING;
        if !update.has_same_bounds && (is_turned(before) || is_turned(now)) {
            "the bounds are others, and reach across the date line".clone_into(&mut update.reason);
            return Ok(update);
        }
        update.pixel = manifest.pixel_with(&old);
        update.changes = changes(&old.sources, &manifest.sources);
        update.has_same_gaps = match &before.gaps {
            // A set without changes has the same heights, which are not computed again.
            Some(sum) if update.has_same_bounds && !update.changes.is_empty() => {
                opened.set.gaps_checksum(args)?.is_some_and(|now| *sum == format!("{now:016x}"))
            }
            _ => true,
        };
        update.tiles = journal.kept_tiles()?;
        Ok(update)
    }

    /// Puts a tile of the set into the folder if the run would make it with the same bytes. `near` returns the rectangle of
    /// what its heights depend on, or `None` if that lies outside of the sources' rectangle; `finer_m` are the heights of finer
    /// tiles.
    pub fn keep(
        &self,
        key: TileKey,
        near: impl FnOnce(Inputs) -> Option<Extent>,
        finer_m: [f32; 2],
    ) -> Result<Option<CompleteTile>, GenError> {
        let Some(tile) = self.tiles.get(&key).copied() else { return Ok(None) };
        let depends_on_the_set = match tile.inputs {
            Inputs::Data => false,
            Inputs::Surroundings => !self.has_same_bounds,
            Inputs::Gaps => !self.has_same_bounds || !self.has_same_gaps,
        };
        let names_tiles = self.args.output.tile_availability && key.level.is_multiple_of(METADATA_LEVELS);
        let range_m = [tile.own_m[0].min(finer_m[0]), tile.own_m[1].max(finer_m[1])];
        if depends_on_the_set || range_m != tile.range_m || (names_tiles && !self.changes.is_empty()) {
            return Ok(None);
        }
        let Some(near) = near(tile.inputs) else { return Ok(None) };
        if is_near_any(&self.changes, &near, elevation_margin(self.args.blend, self.pixel, &near)) {
            return Ok(None);
        }
        let name = name_of(key);
        let Some(size) = self.set.size(&name) else { return Ok(None) };
        if self.set.plain_size(&name, size)?.is_some_and(|size| size != tile.bytes) {
            return Ok(None);
        }
        self.set.keep(&name, self.folder)?;
        self.kept.fetch_add(1, Ordering::Relaxed);
        Ok(Some(tile))
    }

    /// Keeps a tile that a killed run of the update has kept.
    pub fn keep_again(&self, key: TileKey) -> Result<(), GenError> {
        let name = name_of(key);
        let is_there = self.folder.join(&name).is_file();
        if is_there || self.set.size(&name).is_none() { Ok(()) } else { self.set.keep(&name, self.folder) }
    }

    /// Returns a sentence for the user about a run with this number of tiles.
    pub fn note(&self, tiles: u64) -> String {
        if !self.reason.is_empty() {
            return format!("{}; all {tiles} tiles are made", self.reason);
        }
        let kept = self.kept.load(Ordering::Relaxed);
        format!("{kept} tiles are kept; {} are made", tiles.saturating_sub(kept))
    }
}

fn name_of(key: TileKey) -> String {
    format!("{}/{}/{}.terrain", key.level, key.x, key.y)
}
