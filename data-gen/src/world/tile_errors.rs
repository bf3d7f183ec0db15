//! The errors of tiles that are computed alone: estimates that servers declare, on the threads of their connections.
//!
//! A tile is estimated by its own samples: the surface bends most in some of its rows, and there the triangles are compared with
//! the surface between them. That is a function of the position, so that tilesets agree at the corners of tiles, whichever is asked
//! for first. An error is at most that of the tile above divided by [`RATIO`], as decision 0077 needs. So a rough tile in a smooth
//! one has the error that is left to it; but all samples of the tile above are its own, too.
//!
//! [`super::errors`] estimates levels, which takes longer: meshes depend on those.

use std::sync::PoisonError;

use rayon::prelude::*;

use super::errors::{bulge_m, least_error_m, row_error_m};
use super::points::meridians;
use super::surface::RowBuffers;
use super::tiles::WorldSet;
use crate::TileKey;
use crate::output::RATIO;
use crate::pyramid::CELLS;

/// The rows of samples beside which cells are measured, and the lines in a row of cells and the positions in a cell along them.
const BENT: usize = 3;
const LINES: usize = 2;
const PLACES: usize = 2;
/// The factor for what was not measured.
const MARGIN: f64 = 2.0;
/// The factor for tiles whose cells are larger than a size in metres: whole mountains lie between their samples.
const LARGE_MARGIN: f64 = 2.6;
const LARGE_CELL_M: f64 = 1_000.0;
/// The factor of the depth to which rivers cut.
const VALLEY_MARGIN: f64 = 2.0;

impl WorldSet {
    /// Returns the error of a tile in metres: at least [`RATIO`] times that of a tile below it.
    pub(super) fn estimated_error_m(&self, key: TileKey) -> f64 {
        let mut most_m = f64::INFINITY;
        for up in (0..=key.level).rev() {
            let above = TileKey { level: key.level - up, x: key.x >> up, y: key.y >> up };
            most_m = self.own_estimate_m(above).min(most_m / RATIO).max(self.floor_m(above.level));
        }
        most_m
    }

    /// Returns a bound of the error of a tile in metres, by the tile above.
    pub(super) fn bound_m(&self, key: TileKey) -> f64 {
        let above = TileKey { level: key.level.saturating_sub(1), x: key.x >> 1, y: key.y >> 1 };
        self.estimated_error_m(above) / RATIO
    }

    /// Returns bounds of the errors of all levels in metres, root first.
    pub(super) fn level_bounds_m(&self) -> Vec<f64> {
        let root_m = self.estimated_error_m(TileKey::ROOT);
        (0..self.levels()).map(|level| root_m / RATIO.powi(level as i32)).collect()
    }

    /// Estimates tiles on the threads of the rayon pool, so that they are known when one thread needs them.
    pub(super) fn estimate(&self, keys: &[TileKey]) {
        keys.par_iter().for_each(|key| {
            self.estimated_error_m(*key);
        });
    }

    /// Returns the least error of a level: images need it ([`least_error_m`]), and those of finer levels.
    fn floor_m(&self, level: u32) -> f64 {
        (level..self.levels()).rev().fold(0.0, |finer_m, level| least_error_m(self, level).max(RATIO * finer_m))
    }

    /// Returns the estimate of a tile by itself in metres.
    fn own_estimate_m(&self, key: TileKey) -> f64 {
        let kept = || self.estimates.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(error_m) = kept().get(&key) {
            return *error_m;
        }
        // Two threads may estimate the same tile.
        let error_m = self.with_buffers(|buffers| self.measured_m(key, buffers));
        kept().put(key, error_m);
        error_m
    }

    fn measured_m(&self, key: TileKey, buffers: &mut RowBuffers) -> f64 {
        let (world, lattice) = (self.world(), self.lattice(key, 0));
        world.find_rivers(&lattice, CELLS, buffers);
        let first = -1i64;
        let longitudes = meridians((first..=CELLS as i64 + 1).map(|column| lattice.longitude(column)));
        let mut has_land = false;
        let mut rows: Vec<Vec<f32>> = Vec::with_capacity(CELLS + 3);
        for row in first..=CELLS as i64 + 1 {
            world.ground_row_of(&longitudes, lattice.latitude(row), lattice.step_m(), buffers);
            has_land |= buffers.ground.depth_m.iter().any(|depth_m| *depth_m < 0.0);
            rows.push(buffers.ground.surface_m.clone());
        }
        let mut bent: Vec<(f32, i64)> = (0..=CELLS).map(|row| (bend_m(&rows[row..row + 3]), row as i64)).collect();
        bent.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut cells: Vec<i64> = bent.iter().take(BENT).flat_map(|(_, row)| [row - 1, *row]).collect();
        cells.retain(|row| (0..CELLS as i64).contains(row));
        cells.sort_unstable();
        cells.dedup();
        let measured_m = cells.iter().map(|row| row_error_m(self, key, *row, [LINES, PLACES], buffers));
        let measured_m = measured_m.fold(0.0, f64::max);
        let valley_m = match has_land && !world.has_rivers(lattice.step_m()) {
            true => VALLEY_MARGIN * f64::from(world.parameters.relief.rivers.incision_m),
            false => 0.0,
        };
        let margin = if lattice.step_m() > LARGE_CELL_M { LARGE_MARGIN } else { MARGIN };
        margin * measured_m + valley_m + bulge_m(self, key.level)
    }
}

/// Returns how far the surface bends at the samples of the second of three rows, along it and across it.
fn bend_m(rows: &[Vec<f32>]) -> f32 {
    let [south, own, north] = rows else { return 0.0 };
    let bend_m = |before: f32, here: f32, behind: f32| (before - 2.0 * here + behind).abs();
    let along_m = own.windows(3).map(|three| bend_m(three[0], three[1], three[2])).fold(0.0, f32::max);
    let across_m = own.iter().zip(south).zip(north).map(|((own, south), north)| bend_m(*south, *own, *north));
    across_m.fold(along_m, f32::max)
}
