//! The errors of the levels of a set, estimated from samples of the surface. A run measures each
//! tile against the finest tiles below it instead, and takes the estimate of the finest level only. The meshes of a level depend on
//! them. Servers of height tiles declare estimates of each tile ([`super::tile_errors`]).
//!
//! The difference between the triangles of a level and the surface itself is measured along rows of cells: in those rows of the
//! most uneven tiles whose samples bend most, and then in the rows beside the worst one, as long as they are worse. A level's
//! error is the largest difference with a factor for what was not measured, but at most the relief of the world, and the bulge
//! of the earth above flat triangles. Levels without rivers have the depth of valleys besides. An error is at least the size of
//! a small texel, so that images of flat ground are sharp near the eye, and a little larger than that of the next level, so
//! that none is skipped. The tests compare with other samples.

use rayon::prelude::*;
use terrane::math::random::SplitMix64;

use super::points::meridians;
use super::surface::{RowBuffers, TEXELS_PER_CELL};
use super::tiles::WorldSet;
use crate::TileKey;
use crate::pyramid::{CELLS, QUANTUM_M};

/// The largest numbers of tiles of a level whose unevenness is tried, and of those that are scanned.
const MAX_TRIED: u64 = 256;
const MAX_SCANNED: usize = 64;
/// The numbers of rows of cells that are scanned: at least in a tile, and in all tiles of a level that has enough rows.
const SCANNED_ROWS: usize = 4;
const ALL_SCANNED_ROWS: usize = 256;
/// The rows that are measured, and those that are measured to find a worse one beside the worst.
const MEASURED: usize = 24;
const CLIMBED: usize = 8;
/// The tiles in which the depth of valleys is measured.
const DEEP: usize = 12;
/// Lines in a row of cells, and places in a cell along a line.
const LINES: usize = 4;
const PLACES: usize = 4;
/// Factors for places that were not measured: of differences, of the depth of valleys, and of the relief.
const MARGIN: f64 = 1.6;
const VALLEY_MARGIN: f64 = 1.2;
const RELIEF_MARGIN: f64 = 1.25;
/// The largest texels that errors are at least as large as, so that flat ground near the eye is sharp.
const MAX_SHARP_M: f64 = 5.0;
/// The least ratio between the errors of two levels. Ranges in which levels morph may overlap: the shader follows six levels.
pub(super) const RATIO: f64 = 1.05;

/// The measurement of a level: the largest difference from the surface, and the lowest and the highest surface.
struct Measure {
    error_m: f64,
    range_m: [f32; 2],
}

/// Returns the errors of a set's levels in metres, root first.
fn level_errors_m(set: &WorldSet) -> Vec<f64> {
    let levels = set.levels();
    let measures: Vec<Measure> = (0..levels).into_par_iter().map(|level| measure(set, level)).collect();
    let valley_m = VALLEY_MARGIN * valley_m(set);
    let [low_m, high_m] = measures.iter().fold(NO_RANGE, |range, measure| both(range, measure.range_m));
    let relief_m = RELIEF_MARGIN * f64::from(high_m - low_m);
    let mut errors = vec![0.0; levels as usize];
    for level in (0..levels as usize).rev() {
        let next_m = errors.get(level + 1).copied().unwrap_or_default();
        let root = TileKey { level: level as u32, x: 0, y: 0 };
        let below_m = if set.world().has_rivers(set.lattice(root, 0).step_m()) { 0.0 } else { valley_m };
        let measured_m = (MARGIN * measures[level].error_m).min(relief_m) + below_m;
        errors[level] =
            (measured_m + bulge_m(set, level as u32)).max(least_error_m(set, level as u32)).max(RATIO * next_m);
    }
    errors
}

/// Returns the height of arcs above their chords, along both sides of a cell of a level, in metres.
pub(super) fn bulge_m(set: &WorldSet, level: u32) -> f64 {
    let e = set.extent(TileKey { level, x: 0, y: 0 });
    let cell = [e.east - e.west, e.north - e.south].map(|side| side / CELLS as f64);
    cell.iter().map(|side| set.world().radius_m() * side * side / 8.0).sum()
}

/// Returns the least error of a level in metres: with a smaller one its images would be replaced too late.
pub(super) fn least_error_m(set: &WorldSet, level: u32) -> f64 {
    let texel_m = set.lattice(TileKey { level, x: 0, y: 0 }, 0).step_m() / TEXELS_PER_CELL as f64;
    if texel_m < MAX_SHARP_M { texel_m.max(QUANTUM_M) } else { QUANTUM_M }
}

const NO_RANGE: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

/// Returns the range of two ranges.
fn both(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// Returns the range of the surface of a row.
fn range_m(buffers: &RowBuffers) -> [f32; 2] {
    buffers.ground.surface_m.iter().fold(NO_RANGE, |range, surface_m| both(range, [*surface_m; 2]))
}

/// Returns some tiles of a level, most uneven first, and the range of their surface.
fn uneven_tiles(set: &WorldSet, level: u32, buffers: &mut RowBuffers) -> (Vec<TileKey>, [f32; 2]) {
    let mut random = SplitMix64::new(u64::from(level));
    let side = 1u64 << level;
    let all = side * side;
    let mut keys = Vec::new();
    let mut range = NO_RANGE;
    for k in 0..all.min(MAX_TRIED) {
        let [x, y] = if all <= MAX_TRIED { [k % side, k / side] } else { [0, 1].map(|_| random.next_u64() % side) };
        let key = TileKey { level, x: x as u32, y: y as u32 };
        keys.push((unevenness_m(set, key, buffers), key));
        range = both(range, range_m(buffers));
    }
    keys.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    keys.dedup_by_key(|(_, key)| *key);
    (keys.into_iter().map(|(_, key)| key).collect(), range)
}

/// Returns how far the surface bends at the samples of a row, along it and across it, as a measure to choose rows by.
fn bend_m(set: &WorldSet, key: TileKey, row: i64, buffers: &mut RowBuffers) -> f32 {
    let lattice = set.lattice(key, 0);
    let longitudes = meridians((0..=CELLS as i64).map(|k| lattice.longitude(k)));
    let [south, own, north] = [row - 1, row, row + 1].map(|row| {
        set.world().ground_row_of(&longitudes, lattice.latitude(row), lattice.step_m(), buffers);
        buffers.ground.surface_m.clone()
    });
    let bend_m = |before: f32, here: f32, behind: f32| (before - 2.0 * here + behind).abs();
    let along_m = own.windows(3).map(|three| bend_m(three[0], three[1], three[2])).fold(0.0, f32::max);
    let across = own.iter().zip(&south).zip(&north);
    across.map(|((own, south), north)| bend_m(*south, *own, *north)).fold(along_m, f32::max)
}

/// Measures a level.
fn measure(set: &WorldSet, level: u32) -> Measure {
    set.with_buffers(|buffers| {
        let (mut keys, mut range) = uneven_tiles(set, level, buffers);
        keys.truncate(MAX_SCANNED);
        let rows = (ALL_SCANNED_ROWS / keys.len().max(1)).clamp(SCANNED_ROWS, CELLS);
        let places = keys.iter().flat_map(|key| (0..rows).map(|k| (*key, ((2 * k + 1) * CELLS / (2 * rows)) as i64)));
        let mut places: Vec<(f32, TileKey, i64)> = places
            .map(|(key, row)| {
                let bend_m = bend_m(set, key, row, buffers);
                range = both(range, range_m(buffers));
                (bend_m, key, row)
            })
            .collect();
        places.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut worst = (0.0f64, TileKey { level, x: 0, y: 0 }, 0);
        let mut of_row = |key: TileKey, row: i64, buffers: &mut RowBuffers| {
            let error_m = row_error_m(set, key, row, [LINES, PLACES], buffers);
            range = both(range, range_m(buffers));
            error_m
        };
        for (_, key, row) in places.into_iter().take(MEASURED) {
            let error_m = of_row(key, row, buffers);
            if error_m > worst.0 {
                worst = (error_m, key, row);
            }
        }
        for toward in [1, -1] {
            for _ in 0..CLIMBED / 2 {
                let row = worst.2 + toward;
                if !(0..CELLS as i64).contains(&row) {
                    break;
                }
                let error_m = of_row(worst.1, row, buffers);
                if error_m <= worst.0 {
                    break;
                }
                worst = (error_m, worst.1, row);
            }
        }
        Measure { error_m: worst.0, range_m: range }
    })
}

/// Returns the largest effect of valleys and lakes on the surface, if there are levels without rivers.
fn valley_m(set: &WorldSet) -> f64 {
    let step_m = |level: u32| set.lattice(TileKey { level, x: 0, y: 0 }, 0).step_m();
    let has_rivers = |level: u32| set.world().has_rivers(step_m(level));
    let Some(level) = (1..32).find(|level| has_rivers(*level) && !has_rivers(level - 1)) else { return 0.0 };
    if set.levels() == 0 || has_rivers(0) {
        return 0.0;
    }
    let keys = set.with_buffers(|buffers| uneven_tiles(set, level, buffers).0);
    let of_tile = |key: &TileKey| {
        set.with_buffers(|buffers| {
            let lattice = set.lattice(*key, 0);
            // A valley is wider than the distance between these places.
            let places = 16 * CELLS;
            let longitudes = meridians((0..places).map(|k| lattice.at_longitude(k as f64 / 16.0)));
            let latitude = lattice.at_latitude(0.5 * CELLS as f64);
            set.world().ground_row(&longitudes, latitude, buffers);
            let wet_m = buffers.ground.surface_m.clone();
            set.world().ground_row_of(&longitudes, latitude, f64::MAX, buffers);
            let differences = wet_m.iter().zip(&buffers.ground.surface_m).map(|(wet, dry)| (wet - dry).abs());
            differences.fold(0.0f32, f32::max)
        })
    };
    let deepest = keys[..keys.len().min(DEEP)].par_iter().map(of_tile).reduce(|| 0.0, f32::max);
    f64::from(deepest)
}

/// Returns the sum of the differences between neighbouring samples of a row, as a measure to choose tiles by.
fn unevenness_m(set: &WorldSet, key: TileKey, buffers: &mut RowBuffers) -> f32 {
    let lattice = set.lattice(key, 0);
    let longitudes = meridians((0..=8).map(|k| lattice.longitude(8 * k)));
    set.world().ground_row_of(&longitudes, lattice.latitude(CELLS as i64 / 2), lattice.step_m(), buffers);
    buffers.ground.surface_m.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum()
}

/// Returns the largest difference between the triangles of a row of cells and the surface: along a number of lines, at a number of
/// points in each cell.
pub(super) fn row_error_m(
    set: &WorldSet,
    key: TileKey,
    row: i64,
    [lines, places]: [usize; 2],
    buffers: &mut RowBuffers,
) -> f64 {
    let lattice = set.lattice(key, 0);
    let step_m = lattice.step_m();
    let longitudes = meridians((0..=CELLS as i64).map(|k| lattice.longitude(k)));
    let vertices = [row, row + 1].map(|row| {
        set.world().ground_row_of(&longitudes, lattice.latitude(row), step_m, buffers);
        buffers.ground.surface_m.clone()
    });
    let mut random = SplitMix64::new(row as u64 ^ u64::from(key.x) << 32 ^ u64::from(key.y));
    let mut within = || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let mut error = 0.0f32;
    for line in 0..lines {
        let v = (line as f64 + within()) / lines as f64;
        let columns: Vec<f64> = (0..CELLS * places).map(|k| (k as f64 + within()) / places as f64).collect();
        let longitudes = meridians(columns.iter().map(|column| lattice.at_longitude(*column)));
        set.world().ground_row_of(&longitudes, lattice.at_latitude(row as f64 + v), step_m, buffers);
        let v = v as f32;
        for (column, surface_m) in columns.iter().zip(&buffers.ground.surface_m) {
            let (i, u) = (column.floor() as usize, column.fract() as f32);
            let corner = |right: usize, up: usize| vertices[up][i + right];
            // The diagonal runs from south-west to north-east.
            let triangle = match u >= v {
                true => corner(0, 0) + u * (corner(1, 0) - corner(0, 0)) + v * (corner(1, 1) - corner(1, 0)),
                false => corner(0, 0) + v * (corner(0, 1) - corner(0, 0)) + u * (corner(1, 1) - corner(0, 1)),
            };
            error = error.max((surface_m - triangle).abs());
        }
    }
    f64::from(error) + QUANTUM_M
}

impl WorldSet {
    /// Returns the errors of levels in metres, root first. The first call measures them on the threads of the rayon pool.
    pub fn level_errors_m(&self) -> &[f64] {
        self.level_errors_m.get_or_init(|| level_errors_m(self))
    }
}
