//! Bounding volumes and transforms of tiles.

use std::f64::consts::{PI, TAU};

use glam::{DAffine3, DMat3, DVec3};
use serde::Deserialize;
use serde_json::Value;

use super::json::VolumeJson;
use crate::fetch::IoError;
use crate::formats::implicit::RootVolume;
use crate::formats::lenient::{Numbers, object};
use crate::formats::tile::{S2Cell, tile_transform};
use crate::math::{BoundingSphere, BoundingVolume, Ellipsoid, OrientedBox, Region};

/// Parses the transform of a tile.
pub(super) fn affine(uri: &str, m: &[f64]) -> Result<DAffine3, IoError> {
    let m: [f64; 16] =
        m.try_into().map_err(|_| IoError::invalid(uri, format!("transform of {} numbers, 16 expected", m.len())))?;
    tile_transform(&m).ok_or_else(|| IoError::invalid(uri, "transform of a tile is not affine and finite"))
}

/// Parses a volume and transforms it by `world`, except for regions, which transforms of tiles do not move. A region is given
/// in the frame of the whole set, which `set_from_content` maps to, and on the ellipsoid.
pub(super) fn bounding_volume(
    uri: &str,
    json: &VolumeJson,
    world: &DAffine3,
    set_from_content: &DAffine3,
    ellipsoid: Ellipsoid,
) -> Result<BoundingVolume, IoError> {
    let bad = |what: &str, v: &[f64], expected| IoError::invalid(uri, reason(what, v, expected));
    if let Some((cell, heights)) = s2(uri, json)? {
        let b = cell.oriented_box(&ellipsoid, heights[0], heights[1]);
        return Ok(BoundingVolume::Box(inverse(set_from_content).map_or(b, |map| b.transformed(&map))));
    }
    if let Some(v) = json.oriented_box.as_ref().map(|v| v.0.as_slice()) {
        let &[cx, cy, cz, ax, ay, az, bx, by, bz, gx, gy, gz] = v else { return Err(bad("box", v, 12)) };
        let b = OrientedBox {
            center: DVec3::new(cx, cy, cz),
            half_axes: DMat3::from_cols(DVec3::new(ax, ay, az), DVec3::new(bx, by, bz), DVec3::new(gx, gy, gz)),
        };
        if !v.iter().all(|x| x.is_finite() && x.abs() < 1e15) {
            return Err(bad("box", v, 12));
        }
        return Ok(BoundingVolume::Box(b.transformed(world)));
    }
    if let Some(region) = region(uri, json, ellipsoid)? {
        // The transforms of the tiles above this tileset will move it; the inverse keeps the region in its position.
        let Some(content_from_set) = inverse(set_from_content) else { return Ok(BoundingVolume::Region(region)) };
        return Ok(BoundingVolume::Box(region.oriented_box().transformed(&content_from_set)));
    }
    if let Some(v) = json.sphere.as_ref().map(|v| v.0.as_slice()) {
        let &[x, y, z, radius_m] = v else { return Err(bad("sphere", v, 4)) };
        if !v.iter().all(|x| x.is_finite() && x.abs() < 1e15) || radius_m < 0.0 {
            return Err(bad("sphere", v, 4));
        }
        let s = BoundingSphere::new(DVec3::new(x, y, z), radius_m);
        return Ok(BoundingVolume::Sphere(s.transformed(world)));
    }
    Err(IoError::invalid(uri, "boundingVolume has neither box, region nor sphere"))
}

/// Returns the volume of a tile in the frame of the set, and the frame of the tile, from its JSON.
pub(in crate::formats) fn volume_and_frame(
    uri: &str,
    tile: &Value,
    set_from_parent: &DAffine3,
    ellipsoid: Ellipsoid,
) -> Result<(BoundingVolume, DAffine3), IoError> {
    #[derive(Default, Deserialize)]
    #[serde(rename_all = "camelCase")]
    struct Placed {
        #[serde(default, deserialize_with = "object")]
        bounding_volume: VolumeJson,
        transform: Option<Numbers>,
    }
    let placed = Placed::deserialize(tile).map_err(|e| IoError::invalid(uri, format!("tile: {e}")))?;
    let own = placed.transform.map_or(Ok(DAffine3::IDENTITY), |transform| affine(uri, &transform.0))?;
    let set_from_tile = *set_from_parent * own;
    Ok((bounding_volume(uri, &placed.bounding_volume, &set_from_tile, &DAffine3::IDENTITY, ellipsoid)?, set_from_tile))
}

/// Returns the volume of the root of an implicit tree.
pub(super) fn root_volume(uri: &str, json: &VolumeJson, ellipsoid: Ellipsoid) -> Result<RootVolume, IoError> {
    if let Some((cell, heights_m)) = s2(uri, json)? {
        return Ok(RootVolume::S2 { cell, heights_m });
    }
    if json.oriented_box.is_none()
        && let Some(region) = region(uri, json, ellipsoid)?
    {
        return Ok(RootVolume::Region(region));
    }
    match bounding_volume(uri, json, &DAffine3::IDENTITY, &DAffine3::IDENTITY, ellipsoid)? {
        BoundingVolume::Box(b) => Ok(RootVolume::Box(b)),
        _ => {
            Err(IoError::invalid(uri, "the boundingVolume of an implicit root is a sphere, expected a box or a region"))
        }
    }
}

/// Returns why the numbers of a volume are invalid.
fn reason(what: &str, v: &[f64], expected: usize) -> String {
    match v.len() == expected {
        true => format!("bounding {what} {v:?} is invalid: a number is out of range"),
        false => format!("bounding {what} has {} numbers, expected {expected}", v.len()),
    }
}

/// Parses the region of a volume, if it has one.
fn region(uri: &str, json: &VolumeJson, ellipsoid: Ellipsoid) -> Result<Option<Region>, IoError> {
    let Some(v) = json.region.as_ref().map(|v| v.0.as_slice()) else { return Ok(None) };
    let bad = || IoError::invalid(uri, reason("region", v, 6));
    let &[west, south, east, north, min_height_m, max_height_m] = v else { return Err(bad()) };
    let pi = PI + 1e-6;
    let finite = v.iter().all(|x| x.is_finite() && x.abs() < 1e9);
    let angles = west.abs() <= 2.0 * pi && east.abs() <= 2.0 * pi && south.abs() <= 0.5 * pi && north.abs() <= 0.5 * pi;
    if !finite || !angles {
        return Err(bad());
    }
    // Some writers count longitudes from 0 to 360 degrees, or go on beyond 180. Others mix up the lower and the upper corner.
    let is_whole_turn = east - west >= TAU - 1e-6;
    let wrapped = |longitude: f64| match longitude.abs() > pi {
        true => longitude - TAU.copysign(longitude),
        false => longitude,
    };
    let (west, east) = if is_whole_turn { (-PI, PI) } else { (wrapped(west), wrapped(east)) };
    let (south, north) = (south.min(north), south.max(north));
    let (min_height_m, max_height_m) = (min_height_m.min(max_height_m), min_height_m.max(max_height_m));
    Ok(Some(Region { west, south, east, north, min_height_m, max_height_m, ellipsoid }))
}

/// Parses the S2 cell of a volume, with its lowest and highest height in metres, if it has one.
fn s2(uri: &str, json: &VolumeJson) -> Result<Option<(S2Cell, [f64; 2])>, IoError> {
    let Some(s2) = json.s2() else { return Ok(None) };
    let token = s2.token.0.as_deref().unwrap_or_default();
    let cell = S2Cell::from_token(token);
    let cell =
        cell.ok_or_else(|| IoError::invalid(uri, format!("bounding volume: S2 token {token:.40?} is invalid")))?;
    let heights = [&s2.minimum_height, &s2.maximum_height].map(|height| height.map_or(f64::NAN, |height| height.0));
    if !(heights[0] <= heights[1] && heights.iter().all(|height| height.abs() < 1e9)) {
        return Err(IoError::invalid(uri, format!("bounding volume: heights {heights:?} of an S2 cell are invalid")));
    }
    Ok(Some((cell, heights)))
}

/// Returns the map from the frame of the whole set to that of a tileset; `None` if they are the same or it has no inverse.
pub(super) fn inverse(set_from_content: &DAffine3) -> Option<DAffine3> {
    // A transform that undoes the one above it leaves rounding errors, which are micrometres on the earth.
    let is_identity = set_from_content.matrix3.abs_diff_eq(DMat3::IDENTITY, 1e-12)
        && set_from_content.translation.abs_diff_eq(DVec3::ZERO, 1e-5);
    let inverse = set_from_content.inverse();
    (!is_identity && inverse.is_finite()).then_some(inverse)
}
