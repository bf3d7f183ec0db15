//! Decodes a height tile: heights, placement and imagery to a [`HeightTile`]. Decode threads.

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec4};

use super::corner_errors::largest;
use super::layout::Layout;
use super::tile_data::TileData;
use super::{exr, packed};
use crate::fetch::IoError;
use crate::formats::ignored::Notes;
use crate::formats::image::{self, ImageUse};
use crate::formats::options::{Fetched, ReadOptions};
use crate::math::{Aabb, Ellipsoid};
use crate::scene::{BlockFormats, Drawable, Geometry, HeightTile, Material, Node, Sampling, SharedParts, Texture};

/// Decodes an EXR with one channel of heights, or packed heights, and the imagery. Fails if the imagery is missing or invalid:
/// the parent tile then stays visible with its colours, instead of a white tile.
pub(in crate::formats) fn read(
    uri: &str,
    bytes: &[u8],
    reader_data: Option<&str>,
    companions: Vec<Fetched>,
    options: &ReadOptions,
    notes: &Notes,
) -> Result<Node, IoError> {
    let data: TileData = match reader_data {
        Some(text) => serde_json::from_str(text).map_err(|e| IoError::invalid(uri, format!("tile data: {e}")))?,
        None => return Err(IoError::unsupported(uri, "heights outside a height tile set")),
    };
    data.check().map_err(|part| IoError::invalid(uri, format!("tile data: {part} is invalid")))?;
    let stride = data.side as usize + 2 * data.border as usize;
    let heights = match bytes.starts_with(packed::MAGIC) {
        true => packed::decode_heights(uri, bytes, stride, &options.limits)?,
        false => exr::decode_heights(uri, bytes, stride, &options.limits)?,
    };
    let (mut texture, mut shared): (Option<Arc<Texture>>, _) = (None, None);
    // Overlays are composed over the texels.
    let formats = if options.overlays.is_some() { BlockFormats::NONE } else { options.block_formats };
    let of_imagery = ImageUse::colors(Sampling::default(), formats);
    for (companion, bytes) in companions.into_iter().filter(|(uri, _)| data.imagery.as_ref() == Some(uri)) {
        let decoded = image::decode_shared(&companion, &bytes?, of_imagery, options, notes)?;
        (texture, shared) = (Some(decoded.0), decoded.1);
    }
    let (world_from_tile, tile) = build(&data, &options.ellipsoid, heights, texture);
    let mut tile = Arc::new(tile);
    let geometry =
        options.sharing.as_ref().and_then(|sharing| sharing.height_tile(&mut tile, shared.as_ref().map(|s| &s.key)));
    let mut drawable = Drawable::new(Geometry::Height(tile), Material::default());
    drawable.shared = SharedParts { geometry, texture: shared, ..SharedParts::default() };
    Ok(Node::transform(world_from_tile, vec![Node::geode(vec![drawable])]))
}

/// Builds a tile on an ellipsoid, and its transform.
fn build(
    data: &TileData,
    ellipsoid: &Ellipsoid,
    heights: Vec<f32>,
    texture: Option<Arc<Texture>>,
) -> (DAffine3, HeightTile) {
    let side = data.side as usize;
    let Layout { rows, columns, p0_m, cell_m, world_from_tile } = data.placement.layout(ellipsoid, side);
    let stride = side + 2 * data.border as usize;
    let own_error_m = data.errors_m.first().map_or(0.0, largest);
    let coarser_errors_m = data.errors_m.iter().skip(1).map(|corners| corners.map(|error_m| error_m as f32)).collect();
    // Both sides of an edge deviate from the ground by at most their errors. The skirt is deep enough for any neighbour, also
    // for the coarsest one, which is visible while its children load.
    let coarsest_m = data.errors_m.iter().map(largest).fold(own_error_m, f64::max);
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

/// Returns a box around the tile and its skirts. `heights` are rows with their border samples, beginning with the first row
/// inside the tile. The lowest and the highest sample of each row count, whatever their column.
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
            // The position is linear in each of them, so the corners enclose all samples.
            for (s, c1) in sines.into_iter().zip(versines) {
                let corner = DVec3::new(p * s, dp + h * cos - p * c1, dz + h * sin);
                bounds = Aabb { min: bounds.min.min(corner), max: bounds.max.max(corner) };
            }
        }
    }
    bounds
}

/// Returns the smallest and the largest value.
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

    use super::super::layout::Placement;
    use super::super::tile_data::{HeightSet, HeightTileJson};
    use super::*;
    use crate::fetch::Limits;
    use crate::math::{BoundingVolume, Geodetic, Region, WGS84};

    #[test]
    fn differences_reproduce_a_plane() {
        let placement = Placement::Plane([4000.0, -3000.0, 5000.0, -1000.0]);
        let data = TileData { placement, side: 5, border: 1, level: 0, errors_m: vec![[10.0; 4]], imagery: None };
        let (world_from_tile, tile) = build(&data, &WGS84, (0..49).map(|i| i as f32 * 37.5).collect(), None);
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
    fn data_from_applications_is_checked() {
        let options = ReadOptions::for_root("/set/tileset.json", Limits::default());
        let error_of = |place: &str, side: u32, border: u32, error: &str| {
            let data = format!(r#"{{{place},"side":{side},"border":{border},"level":0,"errors_m":[[{error},0,0,0]]}}"#);
            read("t.exr", &[], Some(&data), Vec::new(), &options, &Notes::default()).err().unwrap().to_string()
        };
        let plane = r#""plane":[0,0,10,10]"#;
        assert!(error_of(plane, 33, 1, "1.5").contains("EXR header"), "only the file is invalid");
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
            let text = error_of(place, side, border, error);
            assert!(text.contains("t.exr") && text.contains(&format!("tile data: {part}")), "{text}");
        }
    }

    /// It has the same columns as a tile elsewhere.
    #[test]
    fn a_tile_across_the_antimeridian_is_whole() {
        let set = HeightSet::for_tests(5, 10.0);
        let tile = |west: f64, east: f64| {
            let region =
                Region { west, south: 0.2, east, north: 0.21, min_height_m: 0.0, max_height_m: 9.0, ellipsoid: WGS84 };
            let bounds = BoundingVolume::Region(region);
            let tile = HeightTileJson {
                level: 0,
                bounds: &bounds,
                plane: None,
                region: None,
                imagery: None,
                corner_errors_m: None,
                geometric_error_m: 0.0,
            };
            let errors = set.errors("/set/tileset.json", &tile, None).unwrap();
            let data = set.tile_data("/set/tileset.json", tile, &errors).unwrap();
            let data: TileData = serde_json::from_str(&data).unwrap();
            assert_eq!(data.check(), Ok(()));
            build(&data, &WGS84, (0..49).map(|i| i as f32).collect(), None)
        };
        let (ecef_from_tile, across) = tile(PI - 0.004, 0.006 - PI);
        let (_, elsewhere) = tile(1.0, 1.01);
        for ([a, b], [c, d]) in across.columns.iter().zip(&elsewhere.columns) {
            assert!((a - c).abs() < 1e-7 && (b - d).abs() < 1e-7);
        }
        let center = WGS84.geodetic(ecef_from_tile.translation);
        assert!((center.longitude + PI - 0.001).abs() < 1e-9, "{center:?}");
    }

    /// The test includes tiles wider than half of the earth, and a peak in any column.
    #[test]
    fn bounds_are_tight() {
        for (west, east) in [(0.1, 0.101), (0.1, 1.9), (-3.0, 3.1)] {
            for peak in 0..81 {
                let placement = Placement::Region([west, 0.3, east, 0.6]);
                let data =
                    TileData { placement, side: 7, border: 1, level: 0, errors_m: vec![[10.0; 4]], imagery: None };
                let heights = (0..81).map(|k| if k == peak { 3000.0 } else { (k % 5) as f32 }).collect();
                let (_, tile) = build(&data, &WGS84, heights, None);
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
                // The slack covers the rounding of `p0_m` to f32, and a peak anywhere in its row.
                let (low, high) = (tight.min - tile.bounds.min, tile.bounds.max - tight.max);
                assert!(low.min_element() >= -1.0 && high.min_element() >= -1.0, "{west} {peak}: {low} {high}");
                assert!(low.max_element() <= 3_100.0 && high.max_element() <= 3_100.0, "{west} {peak}: {low} {high}");
            }
        }
    }

    #[test]
    fn differences_reproduce_the_ellipsoid() {
        let data = TileData {
            placement: Placement::Region([0.14, 0.81, 0.15, 0.82]),
            side: 5,
            border: 1,
            level: 0,
            errors_m: vec![[10.0; 4]],
            imagery: None,
        };
        let (ecef_from_tile, tile) = build(&data, &WGS84, (0..49).map(|i| i as f32 * 37.5).collect(), None);
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
