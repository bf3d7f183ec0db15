//! Writes terrain tiles of the format quantized-mesh-1.0, and layer.json.

use std::collections::HashMap;
use std::f64::consts::{PI, TAU};
use std::path::Path;

use glam::DVec3;
use terrane::math::{Geodetic, WGS84};

/// A height in metres at a longitude and a latitude in radians.
pub type Height = fn(f64, f64) -> f64;

/// A tile to be written: a grid over its place in the division of EPSG:4326.
#[derive(Clone, Debug)]
pub struct TerrainTile {
    /// Level, column, and row from the south.
    pub at: [u32; 3],
    /// The number of cells along a side.
    pub cells: u32,
    /// The height of the ground.
    pub height: Height,
    /// Adds the normals of the vertices: those of the ellipsoid.
    pub has_normals: bool,
    /// The bytes of the water mask.
    pub water: Option<Vec<u8>>,
    /// The JSON of the metadata.
    pub metadata: Option<String>,
}

impl TerrainTile {
    /// Creates a tile without extensions. It has 16 x 16 cells, or more on the first levels, so that cells are at most 2.8
    /// degrees wide.
    pub fn new(at: [u32; 3], height: Height) -> Self {
        Self { at, cells: (64 >> at[0].min(2)).max(16), height, has_normals: false, water: None, metadata: None }
    }

    /// Returns west, south, east and north in radians.
    pub fn rectangle(&self) -> [f64; 4] {
        let [level, x, y] = self.at;
        let side = PI / f64::from(level).exp2();
        let (west, south) = (f64::from(x) * side - TAU / 2.0, f64::from(y) * side - PI / 2.0);
        [west, south, west + side, south + side]
    }

    /// Returns the bytes of the file.
    pub fn bytes(&self) -> Vec<u8> {
        let [west, south, east, north] = self.rectangle();
        let share = |i: u32| f64::from(i) / f64::from(self.cells);
        // Vertices are numbered in the order in which triangles first name them.
        let (mut numbers, mut grid, mut indices) = (HashMap::new(), Vec::new(), Vec::new());
        let side = self.cells;
        for (i, j) in (0..side).flat_map(|j| (0..side).map(move |i| (i, j))) {
            for corner in [(i, j), (i + 1, j), (i + 1, j + 1), (i, j), (i + 1, j + 1), (i, j + 1)] {
                let next = grid.len() as u32;
                indices.push(*numbers.entry(corner).or_insert_with(|| {
                    grid.push(corner);
                    next
                }));
            }
        }
        let place = |(i, j): (u32, u32)| (west + (east - west) * share(i), south + (north - south) * share(j));
        let heights: Vec<f64> = grid.iter().map(|at| place(*at)).map(|(lon, lat)| (self.height)(lon, lat)).collect();
        let (low, high) = heights.iter().fold((f64::MAX, f64::MIN), |(low, high), h| (low.min(*h), high.max(*h)));
        let (low, high) = (low as f32, high as f32);
        let ecef = |longitude, latitude, height_m| WGS84.ecef(&Geodetic { longitude, latitude, height_m });
        let center = ecef(0.5 * (west + east), 0.5 * (south + north), f64::from(0.5 * (low + high)));
        let mut out = Vec::new();
        let put_point = |out: &mut Vec<u8>, point: DVec3| {
            point.to_array().iter().for_each(|x| out.extend(x.to_le_bytes()));
        };
        put_point(&mut out, center);
        [low, high].iter().for_each(|height| out.extend(height.to_le_bytes()));
        put_point(&mut out, center);
        out.extend(center.distance(ecef(west, south, 0.0)).to_le_bytes());
        put_point(&mut out, center / WGS84.semi_major_m);
        out.extend((grid.len() as u32).to_le_bytes());
        let range = (f64::from(high) - f64::from(low)).max(1e-9);
        let scaled = |share: f64| (share * 32767.0).round() as i32;
        put_differences(&mut out, grid.iter().map(|(i, _)| scaled(share(*i))));
        put_differences(&mut out, grid.iter().map(|(_, j)| scaled(share(*j))));
        put_differences(&mut out, heights.iter().map(|h| scaled(((h - f64::from(low)) / range).clamp(0.0, 1.0))));
        let size = if grid.len() > 1 << 16 { 4 } else { 2 };
        out.resize(out.len().next_multiple_of(size), 0);
        let put = |out: &mut Vec<u8>, index: u32| out.extend(&index.to_le_bytes()[..size]);
        out.extend((indices.len() as u32 / 3).to_le_bytes());
        let mut next = 0;
        for index in &indices {
            put(&mut out, next - index);
            next += u32::from(*index == next);
        }
        let is_on: [fn(u32, u32, u32) -> bool; 4] =
            [|i, _, _| i == 0, |_, j, _| j == 0, |i, _, side| i == side, |_, j, side| j == side];
        for is_on in is_on {
            let edge = grid.iter().enumerate().filter(|(_, (i, j))| is_on(*i, *j, side));
            let edge: Vec<u32> = edge.map(|(number, _)| number as u32).collect();
            out.extend((edge.len() as u32).to_le_bytes());
            edge.iter().for_each(|index| put(&mut out, *index));
        }
        let mut extension = |id: u8, data: &[u8]| {
            out.push(id);
            out.extend((data.len() as u32).to_le_bytes());
            out.extend(data);
        };
        if self.has_normals {
            let up = |at: &(u32, u32)| {
                let (longitude, latitude) = place(*at);
                oct_code(WGS84.up(&Geodetic { longitude, latitude, height_m: 0.0 }))
            };
            extension(1, &grid.iter().flat_map(up).collect::<Vec<u8>>());
        }
        if let Some(water) = &self.water {
            extension(2, water);
        }
        if let Some(metadata) = &self.metadata {
            let length = (metadata.len() as u32).to_le_bytes();
            extension(4, &[&length[..], metadata.as_bytes()].concat());
        }
        out
    }
}

/// Writes each value as its difference from the one before, with the sign in the lowest bit.
fn put_differences(out: &mut Vec<u8>, values: impl Iterator<Item = i32>) {
    let mut before = 0;
    for value in values {
        let difference = value - before;
        out.extend(((difference << 1 ^ difference >> 31) as u16).to_le_bytes());
        before = value;
    }
}

/// Returns the two bytes of a unit vector on an octahedron.
fn oct_code(normal: DVec3) -> [u8; 2] {
    let flat = normal / (normal.x.abs() + normal.y.abs() + normal.z.abs());
    let sign = |x: f64| if x >= 0.0 { 1.0 } else { -1.0 };
    let folded = match flat.z < 0.0 {
        true => [(1.0 - flat.y.abs()) * sign(flat.x), (1.0 - flat.x.abs()) * sign(flat.y)],
        false => [flat.x, flat.y],
    };
    folded.map(|x| ((x * 0.5 + 0.5) * 255.0).round() as u8)
}

/// Returns the ranges of tiles, one for each tile, by level.
pub fn ranges(first_level: u32, levels: u32, has: impl Fn([u32; 3]) -> bool) -> String {
    let of_level = |level: u32| {
        let tiles = (0..1u32 << level).flat_map(|y| (0..2u32 << level).map(move |x| [level, x, y]));
        let ranges = tiles
            .filter(|at| has(*at))
            .map(|[_, x, y]| format!(r#"{{"startX":{x},"startY":{y},"endX":{x},"endY":{y}}}"#));
        format!("[{}]", ranges.collect::<Vec<_>>().join(","))
    };
    let levels: Vec<String> = (first_level..first_level + levels).map(of_level).collect();
    format!("[{}]", levels.join(","))
}

/// Returns a layer.json with further members, such as `"available":[]`.
pub fn layer_json(members: &str) -> String {
    format!(
        r#"{{"tilejson":"2.1.0","format":"quantized-mesh-1.0","version":"1.0.0","scheme":"tms","projection":"EPSG:4326",
        "tiles":["{{z}}/{{x}}/{{y}}.terrain?v={{version}}"],"bounds":[-180,-90,180,90],{members}}}"#
    )
}

/// Writes the tiles of some levels to a folder, with a layer.json that names them.
pub fn write_set(folder: &Path, levels: u32, has: impl Fn([u32; 3]) -> bool, height: Height) {
    let available = ranges(0, levels, &has);
    std::fs::write(folder.join("layer.json"), layer_json(&format!(r#""available":{available}"#))).unwrap();
    for level in 0..levels {
        for (x, y) in (0..2u32 << level).flat_map(|x| (0..1u32 << level).map(move |y| (x, y))) {
            if has([level, x, y]) {
                let column = folder.join(level.to_string()).join(x.to_string());
                std::fs::create_dir_all(&column).unwrap();
                std::fs::write(column.join(format!("{y}.terrain")), TerrainTile::new([level, x, y], height).bytes())
                    .unwrap();
            }
        }
    }
}

/// Returns level, column and row of a path that ends in `LEVEL/X/Y.terrain`.
pub fn tile_in(path: &str) -> Option<[u32; 3]> {
    let mut parts = path.strip_suffix(".terrain")?.rsplit('/').map(str::parse::<u32>);
    let (y, x, level) = (parts.next()?.ok()?, parts.next()?.ok()?, parts.next()?.ok()?);
    Some([level, x, y])
}

/// Returns the tile of a level at a longitude and a latitude in radians.
pub fn tile_at(level: u32, longitude: f64, latitude: f64) -> [u32; 3] {
    let side = PI / f64::from(level).exp2();
    [level, ((longitude + PI) / side) as u32, ((latitude + PI / 2.0) / side) as u32]
}
