//! The errors of the levels of a set, measured.
//!
//! The difference between a level and the next finer one is measured along rows of several tiles, among them the ones with
//! the highest mountains of those that are tried. The differences of all finer levels are added up, with a factor for
//! places that were not measured, and the bulge of the earth above flat triangles. The test compares with other places.

use rayon::prelude::*;

use super::planet::{RowBuffers, World, meridians};
use super::points::RADIUS_M;
use super::tiles::WorldSet;
use crate::TileKey;
use crate::pyramid::{CELLS, QUANTUM_M};

/// The number of tiles that are tried for each level, and of those that are measured.
const TRIED: usize = 48;
const MEASURED: usize = 4;
/// The rows of cells that are measured in each tile.
const ROWS: [i64; 3] = [9, 31, 52];
/// Factor for places that were not measured.
const MARGIN: f64 = 2.0;
/// Levels beyond the finest one that count as its error.
const BEYOND: u32 = 2;

/// Returns the errors of a set's levels in metres, root first, each at least 1.5 times the next.
pub(super) fn level_errors_m(set: &WorldSet) -> Vec<f64> {
    let levels = set.levels();
    let steps: Vec<f64> = (0..levels + BEYOND).into_par_iter().map(|level| step_error_m(set, level)).collect();
    let mut errors = vec![0.0; levels as usize];
    let mut finer_m: f64 = steps[levels as usize..].iter().sum();
    let mut last_m = 0.0;
    for level in (0..levels).rev() {
        finer_m += steps[level as usize];
        let e = set.extent(TileKey { level, x: 0, y: 0 });
        let cell = [e.east - e.west, e.north - e.south].map(|side| side / CELLS as f64);
        // The height of arcs above their chords, along both sides of a cell.
        let bulge_m: f64 = cell.iter().map(|side| RADIUS_M * side * side / 8.0).sum();
        let error_m = (MARGIN * finer_m + bulge_m).max(1.5 * last_m).max(QUANTUM_M);
        errors[level as usize] = error_m;
        last_m = error_m;
    }
    errors
}

/// Measures the largest difference between a level and the next finer one.
fn step_error_m(set: &WorldSet, level: u32) -> f64 {
    let mut random = terrane::math::random::SplitMix64::new(u64::from(level));
    let mut buffers = RowBuffers::default();
    let tiles = 1u64 << level;
    let pick = |random: &mut terrane::math::random::SplitMix64| (random.next_u64() % tiles) as u32;
    let tried = (0..TRIED).map(|_| TileKey { level, x: pick(&mut random), y: pick(&mut random) });
    let mut keys: Vec<(f32, TileKey)> = tried.map(|key| (unevenness_m(set, key, &mut buffers), key)).collect();
    keys.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    keys.dedup_by_key(|(_, key)| *key);
    let measured = keys.iter().take(MEASURED).flat_map(|(_, key)| ROWS.map(|row| (*key, row)));
    measured.map(|(key, row)| row_error_m(set, key, row, &mut buffers)).fold(0.0, f64::max)
}

/// Returns the sum of the differences between neighbouring samples of a row, as a measure to choose tiles by.
fn unevenness_m(set: &WorldSet, key: TileKey, buffers: &mut RowBuffers) -> f32 {
    let lattice = set.lattice(key, 0);
    let longitudes = meridians((0..=8).map(|k| lattice.longitude(8 * k)));
    set.world().ground_row(&longitudes, lattice.latitude(CELLS as i64 / 2), buffers);
    let heights = surface(set.world(), buffers);
    heights.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum()
}

fn surface(world: &World, buffers: &RowBuffers) -> Vec<f32> {
    buffers.ground.bed_m.iter().map(|bed| bed.max(world.water_m())).collect()
}

/// Returns the largest difference between the triangles of a row of cells and the samples of the next finer level.
fn row_error_m(set: &WorldSet, key: TileKey, row: i64, buffers: &mut RowBuffers) -> f64 {
    let lattice = set.lattice(key, 1);
    let longitudes = meridians((0..=2 * CELLS as i64).map(|k| lattice.longitude(k)));
    let lines = [0, 1, 2].map(|k| {
        set.world().ground_row(&longitudes, lattice.latitude(2 * row + k), buffers);
        surface(set.world(), buffers)
    });
    let mut error = 0.0f32;
    for i in (0..2 * CELLS).step_by(2) {
        let [south, middle, north] = [&lines[0][i..], &lines[1][i..], &lines[2][i..]];
        // The diagonal runs from south-west to north-east.
        for (sample, ends) in [
            (south[1], [south[0], south[2]]),
            (north[1], [north[0], north[2]]),
            (middle[0], [south[0], north[0]]),
            (middle[2], [south[2], north[2]]),
            (middle[1], [south[0], north[2]]),
        ] {
            error = error.max((sample - 0.5 * (ends[0] + ends[1])).abs());
        }
    }
    f64::from(error) + QUANTUM_M
}
