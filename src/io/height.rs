//! Height tiles: EXR content of tile sets that `data-gen` writes, to [`HeightTile`]s.
//!
//! The asset's `extras.terrane` says what all tiles share; a tile's region (or `extras.terrane.plane`: least x and y,
//! largest x and y in metres, for sets that are not on the earth) and `extras.terrane.imagery` the rest.
//! The tileset's reader hands both to this reader as `reader_data`, JSON of [`TileData`].

use std::borrow::Cow;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::io::Cursor;
use std::sync::Arc;

use exr::prelude::{FlatSamples, ReadChannels, ReadLayers, read as exr_read};
use glam::{DAffine3, DMat3, DVec3, Vec4};
use serde::{Deserialize, Serialize};

use super::{Fetched, IoError, Limits, RootScope, image, resolve};
use crate::math::{Aabb, BoundingVolume, WGS84};
use crate::scene::{Drawable, Geometry, HeightTile, Material, Node, SharedParts, SharedStateManager, Texture};
use crate::state::CLAMPED;

/// What `asset.extras.terrane` may say.
#[derive(Debug, Deserialize)]
pub(crate) struct SetExtras {
    content: Option<String>,
    side: Option<u32>,
    border: Option<u32>,
    level_errors_m: Option<Vec<f64>>,
}

impl SetExtras {
    /// The tiles are of heights.
    pub fn is_height(&self) -> bool {
        self.content.as_deref() == Some("height")
    }
}

/// What `extras.terrane` of a tile may say.
#[derive(Debug, Deserialize)]
pub(crate) struct TileExtras {
    plane: Option<[f64; 4]>,
    /// A reference to the picture that is laid over it.
    pub imagery: Option<String>,
}

/// What `asset.extras.terrane` says about a height tile set.
pub(crate) struct HeightSet {
    side: u32,
    border: u32,
    level_errors_m: Vec<f64>,
}

/// What a height tile's reader needs beside the EXR.
#[derive(Serialize, Deserialize)]
struct TileData {
    #[serde(flatten)]
    place: Place,
    side: u32,
    border: u32,
    level: u32,
    /// Error of the level itself, then of the coarser levels, nearest first.
    errors_m: Vec<f64>,
    imagery: Option<Arc<str>>,
}

/// Where a tile lies. Its samples divide it evenly.
#[derive(Clone, Copy, Serialize, Deserialize)]
enum Place {
    /// West, south, east, north on WGS84, in radians.
    #[serde(rename = "region")]
    Region([f64; 4]),
    /// Least x and y, largest x and y of a plane with z up, in metres of the tile's frame (the world's, where no
    /// tile has a transform).
    #[serde(rename = "plane")]
    Plane([f64; 4]),
}

impl TileData {
    /// Applications may say anything of a tile, tilesets what [`HeightSet`] lets through.
    fn check(&self) -> Result<(), &'static str> {
        let parts = [
            (self.place.is_sound(), "region or plane"),
            (is_side(self.side), "side"),
            (self.border == 1, "border"),
            (are_errors(&self.errors_m), "errors_m"),
        ];
        parts.into_iter().find(|(is_sound, _)| !is_sound).map_or(Ok(()), |(_, part)| Err(part))
    }
}

/// Of samples along a side: a power of two and one.
fn is_side(side: u32) -> bool {
    (3..=257).contains(&side) && (side - 1).is_power_of_two()
}

fn are_errors(errors_m: &[f64]) -> bool {
    errors_m.len() <= 64 && errors_m.iter().all(|e| e.is_finite() && *e >= 0.0)
}

impl HeightSet {
    /// `None` when the tile set is not one of heights.
    pub fn from_extras(uri: &str, extras: Option<SetExtras>) -> Result<Option<Self>, IoError> {
        let Some(extras) = extras.filter(SetExtras::is_height) else { return Ok(None) };
        let bad = |what: &str| IoError::invalid(uri, format!("asset.extras.terrane.{what}"));
        Ok(Some(Self {
            side: extras.side.filter(|side| is_side(*side)).ok_or_else(|| bad("side"))?,
            border: extras.border.filter(|border| *border == 1).ok_or_else(|| bad("border"))?,
            level_errors_m: extras.level_errors_m.filter(|e| are_errors(e)).ok_or_else(|| bad("level_errors_m"))?,
        }))
    }

    /// The error that all tiles of a level switch by, so that neighbours morph alike.
    pub fn level_error_m(&self, level: u32) -> Option<f64> {
        self.level_errors_m.get(level as usize).copied()
    }

    /// The `reader_data` of a tile.
    pub fn tile_data(
        &self,
        tileset_uri: &str,
        level: u32,
        bounds: &BoundingVolume,
        extras: Option<&TileExtras>,
        scope: &RootScope,
    ) -> Result<Option<Arc<str>>, IoError> {
        let plane = extras.and_then(|own| own.plane);
        let place = match (bounds, plane) {
            (BoundingVolume::Region(r), None) => {
                let east = if r.east < r.west { r.east + TAU } else { r.east };
                Place::Region([r.west, r.south, east, r.north])
            }
            (_, Some(p)) if Place::Plane(p).is_sound() => Place::Plane(p),
            _ => return Err(IoError::invalid(tileset_uri, "a height tile needs a region, or a plane in its extras")),
        };
        let imagery = extras.and_then(|own| own.imagery.as_deref());
        let data = TileData {
            place,
            side: self.side,
            border: self.border,
            level,
            errors_m: (0..=level).rev().take(7).filter_map(|l| self.level_error_m(l)).collect(),
            imagery: imagery.map(|reference| resolve(tileset_uri, reference, scope)).transpose()?,
        };
        let json = serde_json::to_string(&data).map_err(|e| IoError::invalid(tileset_uri, e.to_string()))?;
        Ok(Some(json.into()))
    }
}

/// The imagery of a height tile.
pub(crate) fn companions(_uri: &Arc<str>, reader_data: Option<&Arc<str>>) -> Vec<Arc<str>> {
    let data = reader_data.and_then(|d| serde_json::from_str::<TileData>(d).ok());
    data.and_then(|d| d.imagery).into_iter().collect()
}

/// An EXR with one channel of heights, and its imagery. Imagery that failed leaves the tile white and is an error of
/// its own kind: the tile is refused, so that its parent stays on screen with colour.
pub(crate) fn read(
    uri: &str,
    bytes: &[u8],
    reader_data: Option<&str>,
    companions: Vec<Fetched>,
    limits: &Limits,
    sharing: Option<&SharedStateManager>,
) -> Result<Node, IoError> {
    let data: TileData = match reader_data {
        Some(text) => serde_json::from_str(text).map_err(|e| IoError::invalid(uri, format!("tile data: {e}")))?,
        None => return Err(IoError::unsupported(uri, "EXR outside a height tile set")),
    };
    data.check().map_err(|part| IoError::invalid(uri, format!("tile data: {part}")))?;
    let stride = data.side as usize + 2 * data.border as usize;
    let heights = heights(uri, bytes, stride, limits)?;
    let (mut texture, mut shared): (Option<Arc<Texture>>, _) = (None, None);
    for (companion, bytes) in companions {
        let (image, content) = image::decode_shared(&companion, &bytes?, CLAMPED, limits, sharing)?;
        (texture, shared) = (Some(image), content);
    }
    let (world_from_tile, tile) = build(&data, heights, texture);
    let mut tile = Arc::new(tile);
    let geometry = sharing.and_then(|sharing| sharing.height_tile(&mut tile, shared.as_ref().map(|s| &s.key)));
    let mut drawable = Drawable::new(Geometry::Height(tile), Material::default());
    drawable.shared = SharedParts { geometry, indices: None, texture: shared };
    Ok(Node::transform(world_from_tile, vec![Node::geode(vec![drawable])]))
}

/// `stride * stride` heights, south-west first.
fn heights(uri: &str, bytes: &[u8], stride: usize, limits: &Limits) -> Result<Vec<f32>, IoError> {
    let bad = |reason: String| IoError::invalid(uri, reason);
    // The header first: a decoder must not be made to allocate for a size we would refuse.
    let meta = exr::meta::MetaData::read_from_buffered(Cursor::new(bytes), false)
        .map_err(|e| bad(format!("EXR header: {e}")))?;
    for header in &meta.headers {
        let size = header.layer_size;
        if size.width() != stride || size.height() != stride {
            return Err(bad(format!(
                "EXR of {} x {} samples, {stride} x {stride} expected",
                size.width(),
                size.height()
            )));
        }
        if header.channels.list.len() > 8 || (stride * stride * 32) as u64 > limits.max_image_bytes {
            return Err(bad("EXR with too many channels".to_owned()));
        }
    }
    let image = exr_read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(|e| bad(format!("EXR: {e}")))?;
    let channels = &image.layer_data.channel_data.list;
    let channel = channels
        .iter()
        .find(|c| c.name.eq("Y"))
        .or_else(|| channels.first().filter(|_| channels.len() == 1))
        .ok_or_else(|| bad("EXR without a channel Y".to_owned()))?;
    let samples: Cow<'_, [f32]> = match &channel.sample_data {
        FlatSamples::F32(samples) => samples.into(),
        other => other.values_as_f32().collect(),
    };
    if samples.len() != stride * stride {
        return Err(bad(format!("EXR with {} samples, {} expected", samples.len(), stride * stride)));
    }
    if !samples.iter().all(|h| h.is_finite() && h.abs() < 1e6) {
        return Err(bad("EXR with a height that is not finite".to_owned()));
    }
    // Images start in the north, tiles in the south.
    let mut heights = Vec::with_capacity(samples.len());
    samples.chunks_exact(stride).rev().for_each(|row| heights.extend_from_slice(row));
    Ok(heights)
}

/// The tile in small differences: what the rows, columns and the origin mean is said at [`HeightTile`].
struct Layout {
    rows: Vec<[f32; 4]>,
    columns: Vec<[f32; 2]>,
    p0_m: f64,
    cell_m: [f32; 2],
    world_from_tile: DAffine3,
}

impl Place {
    fn is_sound(self) -> bool {
        // East of the date line longitudes go on.
        let ([w, s, e, n], [most_x, most_y]) = match self {
            Self::Region(region) => (region, [2.0 * TAU, FRAC_PI_2 + 1e-6]),
            Self::Plane(plane) => (plane, [1e9, 1e9]),
        };
        w.abs().max(e.abs()) < most_x && s.abs().max(n.abs()) < most_y && w < e && s < n
    }

    fn layout(self, side: usize) -> Layout {
        match self {
            Self::Region(region) => on_ellipsoid(region, side),
            Self::Plane(plane) => on_plane(plane, side),
        }
    }
}

fn on_ellipsoid([west, south, east, north]: [f64; 4], side: usize) -> Layout {
    let cells = (side - 1) as f64;
    let (lon_0, lat_0) = (0.5 * (west + east), 0.5 * (south + north));
    let e2 = WGS84.eccentricity_squared();
    let n_0 = WGS84.prime_vertical_radius_m(lat_0);
    let (p_0, z_0) = (n_0 * lat_0.cos(), n_0 * (1.0 - e2) * lat_0.sin());
    let row = |j: usize| {
        let lat = south + (north - south) * j as f64 / cells;
        let n = WGS84.prime_vertical_radius_m(lat.clamp(-FRAC_PI_2, FRAC_PI_2));
        let (sin, cos) = lat.sin_cos();
        [(n * cos - p_0) as f32, (n * (1.0 - e2) * sin - z_0) as f32, cos as f32, sin as f32]
    };
    let column = |i: usize| {
        let half = 0.5 * ((east - west) * (i as f64 / cells - 0.5));
        [(2.0 * half).sin() as f32, (2.0 * half.sin() * half.sin()) as f32]
    };
    let (sin_lon, cos_lon) = lon_0.sin_cos();
    let axes = DMat3::from_cols(DVec3::new(-sin_lon, cos_lon, 0.0), DVec3::new(cos_lon, sin_lon, 0.0), DVec3::Z);
    Layout {
        rows: (0..side).map(row).collect(),
        columns: (0..side).map(column).collect(),
        p0_m: p_0,
        cell_m: [(p_0 * (east - west) / cells) as f32, ((north - south) / cells * WGS84.semi_major_m) as f32],
        world_from_tile: DAffine3 { matrix3: axes, translation: DVec3::new(p_0 * cos_lon, p_0 * sin_lon, z_0) },
    }
}

/// Distance from the axis that makes an earth flat: what a tile's side is to it vanishes in `f32`.
const FLAT_M: f64 = 1e15;

/// A plane is the ellipsoid's form at the pole of an endless earth: the radial axis points south, the polar one up.
fn on_plane([x_0, y_0, x_1, y_1]: [f64; 4], side: usize) -> Layout {
    let cells = (side - 1) as f64;
    let from_center = |k: usize| k as f64 / cells - 0.5;
    Layout {
        rows: (0..side).map(|j| [((y_0 - y_1) * from_center(j)) as f32, 0.0, 0.0, 1.0]).collect(),
        columns: (0..side).map(|i| [((x_1 - x_0) * from_center(i) / FLAT_M) as f32, 0.0]).collect(),
        p0_m: FLAT_M,
        cell_m: [((x_1 - x_0) / cells) as f32, ((y_1 - y_0) / cells) as f32],
        world_from_tile: DAffine3 {
            matrix3: DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::Z),
            translation: DVec3::new(0.5 * (x_0 + x_1), 0.5 * (y_0 + y_1), 0.0),
        },
    }
}

/// The tile and its place.
fn build(data: &TileData, heights: Vec<f32>, texture: Option<Arc<Texture>>) -> (DAffine3, HeightTile) {
    let side = data.side as usize;
    let Layout { rows, columns, p0_m, cell_m, world_from_tile } = data.place.layout(side);
    let stride = side + 2 * data.border as usize;
    let own_error_m = data.errors_m.first().copied().unwrap_or(0.0);
    let coarser_errors_m: Vec<f32> = data.errors_m.iter().skip(1).map(|e| *e as f32).collect();
    // Both sides of an edge lie within their errors of the same ground: deep enough for any neighbour, the coarsest
    // too, which stands there while its children load.
    let coarsest_m = data.errors_m.iter().copied().fold(own_error_m, f64::max);
    let skirt_m = (own_error_m + coarsest_m + 1.0) as f32;
    let bounds = bounds(&rows, &columns, p0_m, heights.chunks_exact(stride).skip(1), skirt_m);
    let tile = HeightTile {
        side: data.side,
        heights,
        rows,
        columns,
        p0_m: p0_m as f32,
        level: data.level,
        coarser_errors_m,
        skirt_m,
        cell_m,
        texture,
        bounds,
    };
    (world_from_tile, tile)
}

/// A box around the tile and its skirts. `heights` are rows with their border, from the first of the tile on. Of each row
/// the lowest and the highest are looked at, wherever they are in it.
fn bounds<'a>(
    rows: &[[f32; 4]],
    columns: &[[f32; 2]],
    p0_m: f64,
    heights: impl Iterator<Item = &'a [f32]>,
    skirt_m: f32,
) -> Aabb {
    let [sines, versines] = [0, 1].map(|k| range(&columns.iter().map(|column| column[k]).collect::<Vec<_>>()));
    let mut bounds = Aabb::EMPTY;
    for (row, heights) in rows.iter().zip(heights) {
        let [dp, dz, cos, sin] = row.map(f64::from);
        let inner = heights.get(1..=columns.len()).unwrap_or_default();
        let [low, high] = range(inner);
        for h in [low - f64::from(skirt_m), high] {
            let p = p0_m + dp + h * cos;
            // Linear in each of them: nothing lies beyond the corners.
            for (s, c1) in sines.into_iter().zip(versines) {
                let corner = DVec3::new(p * s, dp + h * cos - p * c1, dz + h * sin);
                bounds = Aabb { min: bounds.min.min(corner), max: bounds.max.max(corner) };
            }
        }
    }
    bounds
}

/// The lowest and the highest.
fn range(values: &[f32]) -> [f64; 2] {
    let (fours, rest) = values.as_chunks::<4>();
    let fold = |pick: fn(Vec4, Vec4) -> Vec4, start: f32| {
        let lanes = fours.iter().fold(Vec4::splat(start), |found, four| pick(found, Vec4::from_array(*four)));
        rest.iter().fold(lanes, |found, v| pick(found, Vec4::splat(*v)))
    };
    let (low, high) = (fold(Vec4::min, f32::INFINITY), fold(Vec4::max, f32::NEG_INFINITY));
    [low.min_element().into(), high.max_element().into()]
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::math::{Geodetic, Region};

    #[test]
    fn the_small_differences_are_the_plane() {
        let place = Place::Plane([4000.0, -3000.0, 5000.0, -1000.0]);
        let data = TileData { place, side: 5, border: 1, level: 0, errors_m: vec![10.0], imagery: None };
        let (world_from_tile, tile) = build(&data, (0..49).map(|i| i as f32 * 37.5).collect(), None);
        for j in 0..5 {
            for i in 0..5 {
                let h = tile.heights[(j + 1) * 7 + i + 1];
                let [dp, dz, cos, sin] = tile.rows[j];
                let [s, c1] = tile.columns[i];
                let p = tile.p0_m + dp + h * cos;
                let v = glam::Vec3::new(p * s, dp + h * cos - p * c1, dz + h * sin).as_dvec3();
                let exact = DVec3::new(4000.0 + 250.0 * i as f64, -3000.0 + 500.0 * j as f64, f64::from(h));
                assert!(world_from_tile.transform_point3(v).distance(exact) < 1e-3);
                assert!((tile.bounds.min - 1e-3).cmple(v).all() && v.cmple(tile.bounds.max + 1e-3).all());
            }
        }
    }

    #[test]
    fn what_an_application_says_of_a_tile_is_checked() {
        let say = |place: &str, side: u32, border: u32, error: &str| {
            let data = format!(r#"{{{place},"side":{side},"border":{border},"level":0,"errors_m":[{error}]}}"#);
            read("t.exr", &[], Some(&data), Vec::new(), &Limits::default(), None).err().unwrap().to_string()
        };
        let plane = r#""plane":[0,0,10,10]"#;
        assert!(say(plane, 33, 1, "1.5").contains("EXR header"), "all that is wrong is the file");
        for (place, side, border, error, part) in [
            (plane, 0, 1, "1", "side"),
            (plane, u32::MAX, 1, "1", "side"),
            (plane, 34, 1, "1", "side"),
            (plane, 33, 0, "1", "border"),
            (plane, 33, u32::MAX, "1", "border"),
            (plane, 33, 1, "-1", "errors_m"),
            (r#""plane":[0,0,-10,10]"#, 33, 1, "1", "region or plane"),
            (r#""region":[0,0.5,0.1,9]"#, 33, 1, "1", "region or plane"),
        ] {
            let said = say(place, side, border, error);
            assert!(said.contains("t.exr") && said.contains(&format!("tile data: {part}")), "{said}");
        }
    }

    /// As if it lay anywhere else.
    #[test]
    fn a_tile_across_the_date_line_is_whole() {
        let set = HeightSet { side: 5, border: 1, level_errors_m: vec![10.0] };
        let tile = |west: f64, east: f64| {
            let region = Region { west, south: 0.2, east, north: 0.21, min_height_m: 0.0, max_height_m: 9.0 };
            let scope = RootScope::of("/set/tileset.json");
            let data = set.tile_data("/set/tileset.json", 0, &BoundingVolume::Region(region), None, &scope).unwrap();
            let data: TileData = serde_json::from_str(&data.unwrap()).unwrap();
            assert_eq!(data.check(), Ok(()));
            build(&data, (0..49).map(|i| i as f32).collect(), None)
        };
        let (ecef_from_tile, across) = tile(PI - 0.004, 0.006 - PI);
        let (_, elsewhere) = tile(1.0, 1.01);
        for ([a, b], [c, d]) in across.columns.iter().zip(&elsewhere.columns) {
            assert!((a - c).abs() < 1e-7 && (b - d).abs() < 1e-7);
        }
        let center = WGS84.geodetic(ecef_from_tile.translation);
        assert!((center.longitude + PI - 0.001).abs() < 1e-9, "{center:?}");
    }

    /// However wide: over a half of the earth, and with the highest anywhere in a row.
    #[test]
    fn bounds_hold_all_and_little_more() {
        for (west, east) in [(0.1, 0.101), (0.1, 1.9), (-3.0, 3.1)] {
            for peak in 0..81 {
                let place = Place::Region([west, 0.3, east, 0.6]);
                let data = TileData { place, side: 7, border: 1, level: 0, errors_m: vec![10.0], imagery: None };
                let heights = (0..81).map(|k| if k == peak { 3000.0 } else { (k % 5) as f32 }).collect();
                let (_, tile) = build(&data, heights, None);
                let mut tight = Aabb::EMPTY;
                for (j, i) in (0..49).map(|k| (k / 7, k % 7)) {
                    let ([dp, dz, cos, sin], [s, c1]) = (tile.rows[j].map(f64::from), tile.columns[i].map(f64::from));
                    let h = f64::from(tile.heights[(j + 1) * 9 + i + 1]);
                    for h in [h, h - f64::from(tile.skirt_m)] {
                        let p = f64::from(tile.p0_m) + dp + h * cos;
                        let corner = DVec3::new(p * s, dp + h * cos - p * c1, dz + h * sin);
                        tight = Aabb { min: tight.min.min(corner), max: tight.max.max(corner) };
                    }
                }
                // What `p0_m` loses in f32, and a mountain that stands anywhere in its row.
                let (low, high) = (tight.min - tile.bounds.min, tile.bounds.max - tight.max);
                assert!(low.min_element() >= -1.0 && high.min_element() >= -1.0, "{west} {peak}: {low} {high}");
                assert!(low.max_element() <= 3_100.0 && high.max_element() <= 3_100.0, "{west} {peak}: {low} {high}");
            }
        }
    }

    #[test]
    fn the_small_differences_are_the_ellipsoid() {
        let data = TileData {
            place: Place::Region([0.14, 0.81, 0.15, 0.82]),
            side: 5,
            border: 1,
            level: 0,
            errors_m: vec![10.0],
            imagery: None,
        };
        let (ecef_from_tile, tile) = build(&data, (0..49).map(|i| i as f32 * 37.5).collect(), None);
        for j in 0..5 {
            for i in 0..5 {
                let h = tile.heights[(j + 1) * 7 + i + 1];
                let [dp, dz, cos, sin] = tile.rows[j];
                let [s, c1] = tile.columns[i];
                let p = tile.p0_m + dp + h * cos;
                let v = glam::Vec3::new(p * s, dp + h * cos - p * c1, dz + h * sin).as_dvec3();
                let exact = WGS84.ecef(&Geodetic {
                    longitude: 0.14 + 0.01 * i as f64 / 4.0,
                    latitude: 0.81 + 0.01 * j as f64 / 4.0,
                    height_m: f64::from(h),
                });
                assert!(ecef_from_tile.transform_point3(v).distance(exact) < 0.02, "f32 of a 60 km tile");
                assert!((tile.bounds.min - 0.02).cmple(v).all() && v.cmple(tile.bounds.max + 0.02).all());
            }
        }
    }
}
