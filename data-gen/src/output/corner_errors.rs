//! Errors at the corners of height tiles. Readers refine and morph a tile by them.
//!
//! The error at a corner is the largest of the tiles of the level around it, so that neighbours declare the same one. They may
//! be tiles of other blocks, so corners are described when all blocks are complete. Coordinates of tiles count east and north.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};

use lru::LruCache;
use serde_json::{Value, json};

use super::journal::Journal;
use crate::pyramid::{Plan, TileKey};
use crate::{Extent, GenError};

/// Errors in metres at the south-western, south-eastern, north-western and north-eastern corner.
pub(crate) type CornerErrors = [f64; 4];

/// The least ratio between the error of a height tile and that of a tile below it. It keeps the ranges apart in which the
/// vertices of a tile morph to more than two coarser levels.
pub(crate) const RATIO: f64 = 1.25;
/// The largest number of coarser levels that tiles are morphed to.
const MORPH_LEVELS: u32 = terrane::scene::MORPH_LEVELS as u32;
/// Errors are rounded up to multiples of this, for short numbers in JSON.
const STEPS_PER_M: f64 = 1000.0;
/// About how many bytes the errors at the corners of a tile take in JSON.
pub(crate) const JSON_BYTES: u64 = 52;
/// The lists of blocks in memory.
const MAX_LISTS: usize = 256;

/// The errors of the tiles of a set.
pub(crate) struct TileErrors<F> {
    /// Returns the error of a tile in metres; 0 for a tile that does not exist.
    pub error_m: F,
    /// The coarsest level that has tiles.
    pub first_level: u32,
    /// True if the set goes around the globe: its easternmost tiles touch the westernmost ones.
    pub is_round: bool,
}

impl<F: Fn(TileKey) -> Result<f64, GenError>> TileErrors<F> {
    /// Returns the errors of a tile's level at its corners.
    pub fn corners(&self, key: TileKey) -> Result<CornerErrors, GenError> {
        let side = 1i64 << key.level;
        // The errors of the tile and those around it, in rows from the south-west.
        let mut around = [0.0f64; 9];
        for (error_m, k) in around.iter_mut().zip(0..) {
            let (x, y) = (i64::from(key.x) + k % 3 - 1, i64::from(key.y) + k / 3 - 1);
            let x = if self.is_round { x.rem_euclid(side) } else { x };
            if (0..side).contains(&x) && (0..side).contains(&y) {
                *error_m = (self.error_m)(TileKey { level: key.level, x: x as u32, y: y as u32 })?;
            }
        }
        let corner = |first: usize| {
            let largest = [0, 1, 3, 4].iter().map(|k| around[first + k]).fold(0.0, f64::max);
            (largest * STEPS_PER_M).ceil() / STEPS_PER_M
        };
        Ok([0, 1, 3, 4].map(corner))
    }

    /// Returns the errors of the levels above a tile at its own corners, nearest first.
    pub fn above(&self, key: TileKey) -> Result<Vec<CornerErrors>, GenError> {
        let of_level = |up: u32| {
            let above = TileKey { level: key.level - up, x: key.x >> up, y: key.y >> up };
            let [south_west, south_east, north_west, north_east] = self.corners(above)?;
            let side = f64::from(1u32 << up);
            Ok([[0, 0], [1, 0], [0, 1], [1, 1]].map(|[east, north]| {
                let [u, v] =
                    [key.x - (above.x << up) + east, key.y - (above.y << up) + north].map(|at| f64::from(at) / side);
                let south = south_west * (1.0 - u) + south_east * u;
                let north = north_west * (1.0 - u) + north_east * u;
                south * (1.0 - v) + north * v
            }))
        };
        (1..=key.level.saturating_sub(self.first_level).min(MORPH_LEVELS)).map(of_level).collect()
    }

    /// Adds the errors at the corners to a tile with content and those below it in a tileset.
    pub fn describe(&self, tile: &mut Value) -> Result<(), GenError> {
        if let Some(key) = key_of(tile) {
            tile["extras"]["terrane"]["corner_errors_m"] = json!(self.corners(key)?);
        }
        let children = tile.get_mut("children").and_then(Value::as_array_mut);
        children.into_iter().flatten().try_for_each(|child| self.describe(child))
    }
}

/// Returns true if a set goes around the globe.
pub(crate) fn is_round(set: &Extent) -> bool {
    set.east - set.west > std::f64::consts::TAU - crate::georeference::ROUNDING
}

/// Returns the key of a tile from the name of its content; `None` without content, and for an external tileset.
fn key_of(tile: &Value) -> Option<TileKey> {
    let (name, extension) = tile.pointer("/content/uri")?.as_str()?.rsplit_once('.')?;
    let mut parts = name.rsplit('/').map(|part| part.parse().ok());
    let (y, x, level) = (parts.next()??, parts.next()??, parts.next()??);
    (extension != "json").then_some(TileKey { level, x, y })
}

/// The tiles of a block and their errors in metres, ordered by key.
type List = Arc<Vec<(TileKey, f64)>>;

/// Finds the errors of tiles in the tilesets that the records of blocks have. Threads share it.
pub(super) struct BlockErrors<'a> {
    plan: &'a Plan,
    journal: &'a Journal,
    /// The tiles of the root's block.
    root: Option<List>,
    lists: Mutex<LruCache<TileKey, List>>,
}

impl<'a> BlockErrors<'a> {
    /// `root` is the root tile of the set, whose block has no record; `None` if the coarsest tiles are roots of blocks.
    pub fn new(plan: &'a Plan, journal: &'a Journal, root: Option<&Value>) -> Self {
        let lists = LruCache::new(NonZeroUsize::new(MAX_LISTS).unwrap_or(NonZeroUsize::MIN));
        Self { plan, journal, root: root.map(list), lists: Mutex::new(lists) }
    }

    /// Returns the error of a tile in metres; 0 for a tile without data.
    pub fn error_m(&self, key: TileKey) -> Result<f64, GenError> {
        let Some(block) = self.plan.block_of(key) else { return Ok(0.0) };
        let list = self.list_of(block)?;
        Ok(list.binary_search_by_key(&key, |(key, _)| *key).map_or(0.0, |at| list[at].1))
    }

    fn list_of(&self, block: TileKey) -> Result<List, GenError> {
        if let Some(root) = self.root.as_ref().filter(|_| block == TileKey::ROOT) {
            return Ok(root.clone());
        }
        let known = self.lists.lock().unwrap_or_else(PoisonError::into_inner).get(&block).cloned();
        if let Some(known) = known {
            return Ok(known);
        }
        // Blocks without data were not made, or have an empty tileset.
        let tree = self.journal.load(block)?.and_then(|record| serde_json::from_str(&record.tree).ok());
        let list = tree.as_ref().map_or_else(List::default, list);
        self.lists.lock().unwrap_or_else(PoisonError::into_inner).put(block, list.clone());
        Ok(list)
    }
}

/// Returns the tiles of a tileset and their errors.
fn list(root: &Value) -> List {
    let (mut tiles, mut left) = (Vec::new(), vec![root]);
    while let Some(tile) = left.pop() {
        tiles.extend(key_of(tile).zip(tile["geometricError"].as_f64()));
        left.extend(tile["children"].as_array().into_iter().flatten());
    }
    tiles.sort_by_key(|(key, _)| *key);
    Arc::new(tiles)
}
