//! Tests of blocks: heights and errors of one block and of many.

use std::collections::HashMap;

use glam::DVec3;
use terrane::math::{Geodetic, WGS84};

use super::block::Block;
use super::grid::Grid;
use super::plan::{Layer, Plan, tiles_with_data};
use super::record::Record;
use super::samples::Window;
use super::tile::{CELLS, Coverage, TileFacts, TileKey};
use crate::{ElevationSource, Extent, GenError, Procedural, SourceSample, Voids};

/// The tiles of a set: their facts, heights with a border, which triangles have data, and colours' heights.
type Tiles = HashMap<TileKey, (TileFacts, Vec<u32>, Vec<[bool; 2]>, Vec<u32>)>;

/// Makes all blocks of a set, as [`crate::output::Builder`] does.
fn make(grid: &Grid<'_>, block_levels: u32) -> Tiles {
    let plan = Plan::with_block_levels(grid.levels, block_levels);
    let mut records: HashMap<TileKey, Record> = HashMap::new();
    let mut tiles = Tiles::new();
    for (k, layer) in plan.layers.iter().enumerate() {
        let has_data = |key| grid.voids != Voids::Cut || grid.may_have_data_in_tile(key);
        for root in tiles_with_data(layer.root, &has_data) {
            let block = match k {
                0 => Block::sample(grid, *layer, root, true).unwrap(),
                _ => Block::assemble(grid, *layer, root, true, &|key| Ok(records.get(&key).cloned())).unwrap(),
            };
            for key in block.keys() {
                add(&mut tiles, &block, key);
            }
            let record = block.record(0, [0.0; 6], 0.0, String::new());
            records.insert(root, Record::from_bytes(&record.to_bytes()).unwrap());
        }
    }
    tiles
}

fn add(tiles: &mut Tiles, block: &Block<'_>, key: TileKey) {
    let last = CELLS as i64 + 1;
    let vertices = (-1..=last).flat_map(|j| (-1..=last).map(move |i| (i, j)));
    let heights = vertices.map(|(i, j)| block.height_m(key, i, j).to_bits()).collect();
    let triangles = (0..CELLS * CELLS).map(|k| block.triangles(key, k % CELLS, k / CELLS)).collect();
    let surface = block.surface(key.level);
    let mut colors = Vec::new();
    for lattice in surface.lattices() {
        let per_tile = lattice.cells as f64 / f64::from(1u32 << key.level);
        for k in 0..289 {
            let at = |tile: u32, c: i32| per_tile * (f64::from(tile) + f64::from(c) / 16.0);
            colors.push(lattice.samples.bilinear(at(key.x, k % 17), at(key.y, k / 17)).to_bits());
        }
    }
    tiles.insert(key, (block.facts(key), heights, triangles, colors));
}

/// An island of noise, with lakes without data.
struct Island;

impl ElevationSource for Island {
    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
        let hole = |x: f64, y: f64, radius: f64| (longitude - x).hypot(latitude - y) < radius;
        let is_land =
            longitude < 0.1406 && latitude > 0.8203 && !hole(0.1396, 0.821, 0.0002) && !hole(0.1401, 0.8211, 1e-5);
        let noise = Procedural { seed: 7, cos_latitude: 0.68 };
        if is_land { noise.height_m(longitude, latitude) } else { Ok(None) }
    }

    fn may_have_data_in(&self, extent: &Extent) -> bool {
        extent.west < 0.1406 && extent.north > 0.8203
    }
}

/// The same hills as [`Procedural`], known at samples between the vertices of the finest level.
struct Sampled;

const SAMPLES: f64 = 467.0;

impl Sampled {
    fn place(column: i32, row: i32) -> [f64; 2] {
        [EXTENT.west + 0.002 * f64::from(column) / SAMPLES, EXTENT.south + 0.0015 * f64::from(row) / SAMPLES]
    }

    fn sample(column: i32, row: i32) -> f64 {
        let peak = if column % 29 == 3 && row % 31 == 5 { 300.0 } else { 0.0 };
        (f64::from(column) * 0.05).sin() * 80.0 + f64::from(row) + peak
    }
}

impl ElevationSource for Sampled {
    fn height_m(&self, longitude: f64, latitude: f64) -> Result<Option<f64>, GenError> {
        let x = (longitude - EXTENT.west) / 0.002 * SAMPLES;
        let y = (latitude - EXTENT.south) / 0.0015 * SAMPLES;
        let (i, j) = (x.floor() as i32, y.floor() as i32);
        let (fx, fy) = (x - x.floor(), y - y.floor());
        let row = |j: i32| Self::sample(i, j) * (1.0 - fx) + Self::sample(i + 1, j) * fx;
        Ok(Some(row(j) * (1.0 - fy) + row(j + 1) * fy))
    }

    fn samples_in(&self, e: &Extent, call: &mut dyn FnMut(SourceSample)) -> Result<(), GenError> {
        let range = |low: f64, high: f64, first: f64, side: f64| {
            let at = |c: f64| ((c - first) / side * SAMPLES).clamp(-1.0, SAMPLES);
            (at(low) as i32).max(0)..=(at(high) + 1.0).min(SAMPLES) as i32
        };
        let columns = range(e.west, e.east, EXTENT.west, 0.002);
        let rows = range(e.south, e.north, EXTENT.south, 0.0015);
        for (column, row) in rows.flat_map(|row| columns.clone().map(move |c| (c, row))) {
            let [longitude, latitude] = Self::place(column, row);
            if (e.west..=e.east).contains(&longitude) && (e.south..=e.north).contains(&latitude) {
                let is_extremum = column % 29 == 3 && row % 31 == 5;
                call(SourceSample { longitude, latitude, height_m: Self::sample(column, row), is_extremum });
            }
        }
        Ok(())
    }
}

const EXTENT: Extent = Extent { west: 0.139, south: 0.82, east: 0.141, north: 0.8215 };
const HILLS: Procedural = Procedural { seed: 7, cos_latitude: 0.68 };

/// The blocks' size changes no bit of a height, an error, a coverage or a height for colours.
#[test]
fn many_blocks_equal_one() {
    for (name, source, voids, extrema) in [
        ("hills", &HILLS as &dyn ElevationSource, Voids::Cut, false),
        ("cut", &Island, Voids::Cut, false),
        ("fill", &Island, Voids::Fill, false),
        ("sea", &Island, Voids::Sea, false),
        ("samples", &Sampled, Voids::Cut, true),
    ] {
        let levels = 4;
        let grid = || Grid::new(source, EXTENT, levels, voids, extrema);
        let one = make(&grid(), levels);
        let many = make(&grid(), 2);
        let mut keys = [one.keys().collect::<Vec<_>>(), many.keys().collect()];
        keys.iter_mut().for_each(|keys| keys.sort());
        assert_eq!(keys[0], keys[1], "{name}");
        for (key, (facts, heights, triangles, colors)) in &one {
            let other = &many[key];
            assert_eq!(*facts, other.0, "{name} {key:?}");
            assert!(*heights == other.1 && *triangles == other.2, "{name} {key:?}: heights differ");
            assert!(*colors == other.3, "{name} {key:?}: heights for colours differ");
        }
        if name == "cut" {
            assert!(
                one.values().any(|(facts, ..)| facts.coverage == Coverage::Part) && one.len() < 85,
                "{}",
                one.len()
            );
        }
    }
}

/// `--memory` counts on it.
#[test]
fn blocks_take_at_most_the_bytes_of_the_plan() {
    for (source, voids) in [(&HILLS as &dyn ElevationSource, Voids::Cut), (&Island, Voids::Fill), (&Island, Voids::Cut)]
    {
        for paints in [true, false] {
            let grid = Grid::new(source, EXTENT, 4, voids, false);
            let plan = Plan::with_block_levels(4, 2);
            let mut records: HashMap<TileKey, Record> = HashMap::new();
            for (k, layer) in plan.layers.iter().enumerate() {
                let only = Plan { layers: plan.layers[..=k].to_vec() };
                for root in tiles_with_data(layer.root, &|_| true) {
                    let block = match k {
                        0 => Block::sample(&grid, *layer, root, paints).unwrap(),
                        _ => {
                            Block::assemble(&grid, *layer, root, paints, &|key| Ok(records.get(&key).cloned())).unwrap()
                        }
                    };
                    assert!(
                        block.bytes() > 0 && block.bytes() <= only.work_bytes(paints),
                        "{root:?} {}",
                        block.bytes()
                    );
                    records.insert(root, block.record(0, [0.0; 6], 0.0, String::new()));
                }
            }
        }
    }
}

/// Blocks beside the data are known to have none only when they are sampled.
#[test]
fn block_without_data_leaves_the_record_of_its_voids() {
    struct Half;
    impl ElevationSource for Half {
        fn height_m(&self, longitude: f64, _: f64) -> Result<Option<f64>, GenError> {
            Ok((longitude < 0.13999).then_some(700.0))
        }
    }
    for paints in [true, false] {
        let grid = Grid::new(&Half, EXTENT, 3, Voids::Cut, false);
        let layer = Plan::with_block_levels(3, 2).finest();
        // The margin of this block has data.
        let root = TileKey { level: 1, x: 1, y: 0 };
        let east = Block::sample(&grid, layer, root, paints).unwrap();
        assert_eq!((east.keys().count(), east.facts(root).coverage), (0, Coverage::None));
        let record = east.record(0, [0.0; 6], 0.0, String::new());
        assert_eq!((record.totals.tiles, record.totals.voids), (0, 129 * 128));
        assert!(record.known.values.len() == 33 * 33 && !record.known.has_data_in(&record.known.window));
        assert_eq!((record.above_m, record.cells), (vec![0.0], Some(vec![false; 32 * 32])));
        assert_eq!(record.texels.map(|texels| texels.values.len()), paints.then_some(129 * 129));
    }
}

/// The root of a set of the whole earth declares the distance that is measured, and no more.
#[test]
fn error_of_the_whole_earth_is_the_measured_one() {
    // At the poles triangles have no area.
    let [west, south, east, north] = [-180.0, -85.0, 180.0, 85.0].map(f64::to_radians);
    let globe = Extent { west, south, east, north };
    let grid = Grid::new(&Flat, globe, 3, Voids::Cut, false);
    let (error, brute) = (whole(&grid).facts(TileKey::ROOT).error_m, farthest_m(&grid, TileKey::ROOT));
    // 5.6 x 2.7 degrees at the equator: the square of the diagonal by eight radii.
    assert!((9_100.0..9_700.0).contains(&error), "{error}");
    assert!(error > 0.99 * brute && error < 1.03 * brute, "{error} {brute}");
}

/// A set in one block.
fn whole<'a>(grid: &'a Grid<'a>) -> Block<'a> {
    Block::sample(grid, Layer { root: 0, finest: grid.levels - 1 }, TileKey::ROOT, true).unwrap()
}

#[test]
fn shared_vertices_have_equal_bits() {
    let grid = Grid::new(&HILLS, EXTENT, 3, Voids::Cut, false);
    let block = whole(&grid);
    for key in block.keys() {
        for t in 0..=64 {
            if key.x + 1 < 1 << key.level {
                let east = TileKey { x: key.x + 1, ..key };
                assert_eq!(block.height_m(key, 64, t).to_bits(), block.height_m(east, 0, t).to_bits());
            }
            if key.level + 1 < grid.levels && t % 2 == 0 {
                let child = TileKey { level: key.level + 1, x: 2 * key.x + 1, y: 2 * key.y };
                let (coarse, fine) = (block.height_m(key, 32 + t / 2, t / 2), block.height_m(child, t, t));
                assert_eq!(coarse.to_bits(), fine.to_bits());
            }
        }
    }
}

/// Returns the largest distance between a tile's triangles, flat in space, and the finest samples, in metres.
fn farthest_m(grid: &Grid<'_>, key: TileKey) -> f64 {
    let s = 1i64 << key.depth(grid.levels);
    let side = CELLS as i64 * s;
    let (first, e) = ([key.x, key.y].map(|t| i64::from(t) * side), grid.extent);
    let heights = grid.sample(0, Window::around(first, side, 0, grid.cells(0))).unwrap();
    let cells = grid.cells(0) as f64;
    let at = |i: i64, j: i64| Geodetic {
        longitude: e.west + (e.east - e.west) * (first[0] + i) as f64 / cells,
        latitude: e.south + (e.north - e.south) * (first[1] + j) as f64 / cells,
        height_m: heights.at(first[0] + i, first[1] + j).into(),
    };
    let ecef = |g: Geodetic| -> DVec3 { WGS84.ecef(&g) };
    let mut worst = 0.0f64;
    for fj in 0..=side {
        for fi in 0..=side {
            let (i, j) = ((fi / s).min(CELLS as i64 - 1) * s, (fj / s).min(CELLS as i64 - 1) * s);
            let other = if fi - i >= fj - j { at(i + s, j) } else { at(i, j + s) };
            let [a, b, c] = [at(i, j), other, at(i + s, j + s)].map(ecef);
            let (sample, normal) = (at(fi, fj), (b - a).cross(c - a));
            let up = WGS84.ecef_from_enu(&sample).matrix3.z_axis;
            worst = worst.max((normal.dot(a - ecef(sample)) / normal.dot(up)).abs());
        }
    }
    worst
}

#[test]
fn errors_equal_brute_force_and_are_at_least_those_of_children() {
    let grid = Grid::new(&HILLS, EXTENT, 4, Voids::Cut, false);
    // Two layers: the coarse levels are measured part by part.
    let tiles = make(&grid, 2);
    for (key, (facts, ..)) in tiles.iter().filter(|(key, _)| key.level + 1 < grid.levels) {
        let mut expected = farthest_m(&grid, *key);
        for child in key.children().map(|child| tiles[&child].0) {
            assert!(facts.error_m >= child.error_m);
            expected = expected.max(child.error_m);
        }
        // Flat triangles in space are not exactly triangles in longitude and latitude.
        assert!((facts.error_m - expected).abs() < 0.005, "{key:?} {} {expected}", facts.error_m);
    }
}

struct Flat;

impl ElevationSource for Flat {
    fn height_m(&self, _: f64, _: f64) -> Result<Option<f64>, GenError> {
        Ok(Some(1000.0))
    }
}

/// Regression: flat land of several degrees had no error, and moved by metres between levels.
#[test]
fn errors_include_the_bulge_of_the_earth() {
    for (south, wide) in [(-2.0f64, 5.0f64), (44.0, 6.0), (70.0, 10.0)] {
        let [west, south, east, north] = [10.0, south, 10.0 + wide, south + 4.0].map(f64::to_radians);
        let grid = Grid::new(&Flat, Extent { west, south, east, north }, 3, Voids::Cut, false);
        let block = whole(&grid);
        for key in block.keys().filter(|k| k.level + 1 < grid.levels) {
            let (error, brute) = (block.facts(key).error_m, farthest_m(&grid, key));
            assert!(error > 0.99 * brute && error < 1.02 * brute + 0.01, "{key:?} {error} {brute}");
        }
        let latitude = if south < 0.0 { 0.0 } else { south };
        let diagonal = ((east - west) / 64.0 * latitude.cos()).hypot((north - south) / 64.0) * 6_371_000.0;
        let error = block.facts(TileKey::ROOT).error_m;
        assert!((error / (diagonal * diagonal / (8.0 * 6_371_000.0)) - 1.0).abs() < 0.02, "{error}");
    }
}
