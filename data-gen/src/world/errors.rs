//! The errors of the levels of a set, measured.
//!
//! The difference between a level and one three levels finer is measured along rows of several tiles, among them the ones
//! with the highest mountains of those that are tried. A level's error is that difference with a factor for places that were
//! not measured, the error of the finer level, and the bulge of the earth above flat triangles, but no more than the relief of
//! the whole world and the bulge. Each is a little larger than the next, so that no level is skipped. The test compares with other
//! places.

use rayon::prelude::*;

use super::planet::RowBuffers;
use super::points::{RADIUS_M, meridians};
use super::tiles::WorldSet;
use crate::TileKey;
use crate::pyramid::{CELLS, QUANTUM_M};

/// The number of tiles that are tried for each level, and of those that are measured.
const TRIED: usize = 48;
const MEASURED: usize = 4;
/// The rows of cells that are measured in each tile.
const ROWS: [i64; 3] = [9, 31, 52];
/// Levels from a level to the one that it is compared with.
const FINER: u32 = 3;
/// Factors for places that were not measured: of differences and of the relief.
const MARGIN: f64 = 1.6;
const RELIEF_MARGIN: f64 = 1.25;
/// The least ratio between the errors of two levels. Ranges in which levels morph may overlap: the shader follows six levels.
const RATIO: f64 = 1.05;

/// The measurement of a level: the largest difference from the finer one, and the lowest and the highest surface.
struct Measure {
    error_m: f64,
    range_m: [f32; 2],
}

/// Returns the errors of a set's levels in metres, root first.
pub(super) fn level_errors_m(set: &WorldSet) -> Vec<f64> {
    let levels = set.levels();
    let measures: Vec<Measure> = (0..levels).into_par_iter().map(|level| measure(set, level)).collect();
    let [low_m, high_m] = measures.iter().fold(NO_RANGE, |range, measure| both(range, measure.range_m));
    let relief_m = RELIEF_MARGIN * f64::from(high_m - low_m);
    let mut errors = vec![0.0; levels as usize];
    for level in (0..levels as usize).rev() {
        let finer_m = errors.get(level + FINER as usize).copied().unwrap_or_default();
        let next_m = errors.get(level + 1).copied().unwrap_or_default();
        let e = set.extent(TileKey { level: level as u32, x: 0, y: 0 });
        let cell = [e.east - e.west, e.north - e.south].map(|side| side / CELLS as f64);
        // The height of arcs above their chords, along both sides of a cell.
        let bulge_m: f64 = cell.iter().map(|side| RADIUS_M * side * side / 8.0).sum();
        let measured_m = (MARGIN * measures[level].error_m + finer_m).min(relief_m);
        errors[level] = (measured_m + bulge_m).max(RATIO * next_m).max(QUANTUM_M);
    }
    errors
}

const NO_RANGE: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

/// Returns the range of two ranges.
fn both(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Measures a level.
fn measure(set: &WorldSet, level: u32) -> Measure {
    let mut random = terrane::math::random::SplitMix64::new(u64::from(level));
    let mut buffers = RowBuffers::default();
    let mut range_m = NO_RANGE;
    let tiles = 1u64 << level;
    let pick = |random: &mut terrane::math::random::SplitMix64| (random.next_u64() % tiles) as u32;
    let tried = (0..TRIED).map(|_| TileKey { level, x: pick(&mut random), y: pick(&mut random) });
    let mut keys = Vec::with_capacity(TRIED);
    for key in tried {
        keys.push((unevenness_m(set, key, &mut buffers), key));
        range_m = buffers.ground.surface_m.iter().fold(range_m, |range, surface_m| both(range, [*surface_m; 2]));
    }
    keys.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    keys.dedup_by_key(|(_, key)| *key);
    let mut error_m = 0.0f64;
    for (key, row) in keys.iter().take(MEASURED).flat_map(|(_, key)| ROWS.map(|row| (*key, row))) {
        error_m = error_m.max(row_error_m(set, key, row, &mut buffers));
        range_m = buffers.ground.surface_m.iter().fold(range_m, |range, surface_m| both(range, [*surface_m; 2]));
    }
    Measure { error_m, range_m }
}

/// Returns the sum of the differences between neighbouring samples of a row, as a measure to choose tiles by.
fn unevenness_m(set: &WorldSet, key: TileKey, buffers: &mut RowBuffers) -> f32 {
    let lattice = set.lattice(key, 0);
    let longitudes = meridians((0..=8).map(|k| lattice.longitude(8 * k)));
    set.world().ground_row_of(&longitudes, lattice.latitude(CELLS as i64 / 2), lattice.step_m(), buffers);
    buffers.ground.surface_m.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum()
}

/// Returns the largest difference between the triangles of a row of cells and the samples of the finer level, along five
/// lines.
fn row_error_m(set: &WorldSet, key: TileKey, row: i64, buffers: &mut RowBuffers) -> f64 {
    let lattice = set.lattice(key, 0);
    let longitudes = meridians((0..=CELLS as i64).map(|k| lattice.longitude(k)));
    // The vertices of the triangles: coarse levels have no rivers, the finer one may have some.
    let vertices = [row, row + 1].map(|row| {
        set.world().ground_row_of(&longitudes, lattice.latitude(row), lattice.step_m(), buffers);
        buffers.ground.surface_m.clone()
    });
    let lattice = set.lattice(key, FINER);
    let steps = 1usize << FINER;
    let longitudes = meridians((0..=(CELLS * steps) as i64).map(|k| lattice.longitude(k)));
    let lines: Vec<Vec<f32>> = (0..=steps as i64)
        .step_by(steps / 4)
        .map(|k| {
            set.world().ground_row_of(&longitudes, lattice.latitude((row << FINER) + k), lattice.step_m(), buffers);
            buffers.ground.surface_m.clone()
        })
        .collect();
    let mut error = 0.0f32;
    for i in (0..CELLS * steps).step_by(steps) {
        let corner = |right: usize, up: usize| vertices[up][i / steps + right];
        for (line, v) in lines.iter().zip([0.0, 0.25, 0.5, 0.75, 1.0f32]) {
            for k in 0..=steps {
                let u = k as f32 / steps as f32;
                // The diagonal runs from south-west to north-east.
                let surface = match u >= v {
                    true => corner(0, 0) + u * (corner(1, 0) - corner(0, 0)) + v * (corner(1, 1) - corner(1, 0)),
                    false => corner(0, 0) + v * (corner(0, 1) - corner(0, 0)) + u * (corner(1, 1) - corner(0, 1)),
                };
                error = error.max((line[i + k] - surface).abs());
            }
        }
    }
    f64::from(error) + QUANTUM_M
}
