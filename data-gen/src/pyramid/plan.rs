//! The division of a quadtree into blocks: subtrees of a few levels, small enough for memory.
//!
//! The finest levels form the first layer of blocks, the next coarser ones the second, and so on up to the root. Blocks of a
//! layer are made before those of the next, which are made of what they recorded.

use super::grid::ALIGNED;
use super::tile::{CELLS, TileKey};
use crate::Extent;

/// Levels of a block. A block of the finest layer has 1024 x 1024 cells.
const BLOCK_LEVELS: u32 = 5;
/// Sets with at most this many levels are one block.
const ONE_BLOCK_LEVELS: u32 = 6;

/// Bytes of the records that a block loads at a time, and of the averages that the grid keeps.
const RECORDS_BYTES: u64 = 48 << 20;

/// Levels that form blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Layer {
    /// The level of the blocks' roots.
    pub root: u32,
    /// The finest level of the blocks.
    pub finest: u32,
}

impl Layer {
    /// Returns the number of levels.
    pub fn levels(&self) -> u32 {
        self.finest - self.root + 1
    }

    /// Returns the number of tiles of a block whose every tile has data.
    pub fn tiles_per_block(&self) -> u64 {
        (0..self.levels()).map(|level| 1u64 << (2 * level)).sum()
    }
}

/// The layers of a quadtree, the finest first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Plan {
    pub layers: Vec<Layer>,
}

impl Plan {
    pub fn new(levels: u32) -> Self {
        Self::with_block_levels(levels, if levels <= ONE_BLOCK_LEVELS { levels } else { BLOCK_LEVELS })
    }

    /// Returns the plan of an aligned grid: its coarsest level is the finest one on which a rectangle touches at most two tiles
    /// along each side, but leaves whole blocks below it.
    pub fn aligned(levels: u32, bounds: &Extent) -> Self {
        let tiles = |level: u32| {
            let side = (ALIGNED.east - ALIGNED.west) / f64::from(1u32 << level);
            let along =
                |low: f64, high: f64, first: f64| ((high - first) / side).floor() - ((low - first) / side).floor();
            along(bounds.west, bounds.east, ALIGNED.west).max(along(bounds.south, bounds.north, ALIGNED.south))
        };
        let first = (0..=levels.saturating_sub(BLOCK_LEVELS)).rev().find(|level| tiles(*level) < 2.0).unwrap_or(0);
        let mut plan = Self::with_block_levels(levels, BLOCK_LEVELS);
        plan.layers.retain(|layer| layer.finest >= first);
        if let Some(layer) = plan.layers.last_mut() {
            layer.root = layer.root.max(first);
        }
        plan
    }

    /// Returns the root of the block that a tile is in; `None` for a tile above all blocks.
    pub fn block_of(&self, key: TileKey) -> Option<TileKey> {
        let layer = self.layers.iter().find(|layer| (layer.root..=layer.finest).contains(&key.level))?;
        let up = key.level - layer.root;
        Some(TileKey { level: layer.root, x: key.x >> up, y: key.y >> up })
    }

    /// Returns the coarsest level.
    pub fn first_level(&self) -> u32 {
        self.layers.last().map_or(0, |layer| layer.root)
    }

    /// Returns the bytes that making a block takes at most, beside the blocks of the sources. `paints` is true if tiles have
    /// colours.
    pub fn work_bytes(&self, paints: bool) -> u64 {
        let of_layer = |(k, layer): (usize, &Layer)| {
            let cells = (CELLS as u64) << (layer.levels() - 1);
            let side = cells + (if paints { 34 } else { 4 } << (layer.levels() - 1)) + 2;
            // All lattices of a block have a third more samples than the finest one. There are samples with data, with voids
            // filled in two ways, and one more copy while they are filled.
            let heights = 4 * 4 * side * side * 4 / 3;
            let texels = if k == 0 { side } else { 4 * cells + (6 << (layer.levels() - 1)) + 1 };
            let colors = if paints { 2 * 4 * texels * texels * 4 / 3 } else { 0 };
            heights + colors + 2 * cells * cells * 4 / 3 + RECORDS_BYTES
        };
        self.layers.iter().enumerate().map(of_layer).max().unwrap_or(0)
    }

    /// Returns the finest layer.
    pub fn finest(&self) -> Layer {
        // There is at least one level.
        self.layers.first().copied().unwrap_or(Layer { root: 0, finest: 0 })
    }

    pub fn with_block_levels(levels: u32, block_levels: u32) -> Self {
        let mut layers = Vec::new();
        let mut finest = levels;
        while finest > 0 {
            let root = finest.saturating_sub(block_levels);
            layers.push(Layer { root, finest: finest - 1 });
            finest = root;
        }
        Self { layers }
    }
}

/// Returns the tiles of a level in Morton order for which `has_data` is true, also of all tiles above them. Tiles below one
/// without data are not asked for.
pub(crate) fn tiles_with_data(level: u32, has_data: &(dyn Fn(TileKey) -> bool + Sync)) -> Vec<TileKey> {
    let mut found = Vec::new();
    collect(TileKey::ROOT, level, has_data, &mut found);
    found
}

fn collect(key: TileKey, level: u32, has_data: &(dyn Fn(TileKey) -> bool + Sync), found: &mut Vec<TileKey>) {
    if !has_data(key) {
        return;
    }
    if key.level == level {
        found.push(key);
        return;
    }
    key.children().into_iter().for_each(|child| collect(child, level, has_data, found));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn layers_cover_each_level_once() {
        for levels in 1..=24 {
            let plan = Plan::new(levels);
            let mut next = levels;
            for layer in &plan.layers {
                assert_eq!(layer.finest + 1, next);
                next = layer.root;
            }
            assert_eq!(next, 0, "{levels}");
            assert_eq!(plan.layers.len() == 1, levels <= 6);
        }
    }

    #[test]
    fn tiles_are_in_morton_order() {
        let east = |key: TileKey| key.level == 0 || key.x >= 1 << (key.level - 1);
        let found: Vec<_> = tiles_with_data(2, &east).into_iter().map(|key| [key.x, key.y]).collect();
        assert_eq!(found, [[2, 0], [3, 0], [2, 1], [3, 1], [2, 2], [3, 2], [2, 3], [3, 3]]);
    }
}
