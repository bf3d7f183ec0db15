//! Bounding volumes and transforms of tiles.

use glam::{DAffine3, DMat3, DMat4, DVec3, DVec4};

use super::json::VolumeJson;
use crate::fetch::IoError;
use crate::math::{BoundingSphere, BoundingVolume, OrientedBox, Region};

/// Parses the transform of a tile.
pub(super) fn affine(uri: &str, m: &[f64]) -> Result<DAffine3, IoError> {
    let m: [f64; 16] =
        m.try_into().map_err(|_| IoError::invalid(uri, format!("transform of {} numbers, 16 expected", m.len())))?;
    let m = DMat4::from_cols_array(&m);
    if !m.is_finite() || m.row(3) != DVec4::W {
        return Err(IoError::invalid(uri, "transform of a tile is not affine and finite"));
    }
    Ok(DAffine3::from_mat4(m))
}

/// Parses a volume and transforms it by `world`, except for regions, which transforms of tiles do not move. A region is given
/// in the frame of the whole set, which `set_from_content` maps to.
pub(super) fn bounding_volume(
    uri: &str,
    json: &VolumeJson,
    world: &DAffine3,
    set_from_content: &DAffine3,
) -> Result<BoundingVolume, IoError> {
    let bad = |what: &str, v: &[f64]| IoError::invalid(uri, format!("bounding {what} {v:?} is invalid"));
    if let Some(v) = &json.oriented_box {
        let &[cx, cy, cz, ax, ay, az, bx, by, bz, gx, gy, gz] = v.as_slice() else { return Err(bad("box", v)) };
        let b = OrientedBox {
            center: DVec3::new(cx, cy, cz),
            half_axes: DMat3::from_cols(DVec3::new(ax, ay, az), DVec3::new(bx, by, bz), DVec3::new(gx, gy, gz)),
        };
        if !v.iter().all(|x| x.is_finite() && x.abs() < 1e15) {
            return Err(bad("box", v));
        }
        return Ok(BoundingVolume::Box(b.transformed(world)));
    }
    if let Some(v) = &json.region {
        let &[west, south, east, north, min_height_m, max_height_m] = v.as_slice() else {
            return Err(bad("region", v));
        };
        let pi = std::f64::consts::PI + 1e-6;
        let finite = v.iter().all(|x| x.is_finite() && x.abs() < 1e9);
        let angles = west.abs() <= pi && east.abs() <= pi && south.abs() <= 0.5 * pi && north.abs() <= 0.5 * pi;
        if !finite || !angles || south > north || min_height_m > max_height_m {
            return Err(bad("region", v));
        }
        let region = BoundingVolume::Region(Region { west, south, east, north, min_height_m, max_height_m });
        // The transforms of the tiles above this tileset will move it; the inverse keeps the region in its position.
        let content_from_set = set_from_content.inverse();
        if *set_from_content == DAffine3::IDENTITY || !content_from_set.is_finite() {
            return Ok(region);
        }
        let moved = region.oriented_box().map(|b| BoundingVolume::Box(b.transformed(&content_from_set)));
        return Ok(moved.unwrap_or(BoundingVolume::Sphere(region.bounding_sphere().transformed(&content_from_set))));
    }
    if let Some(v) = &json.sphere {
        let &[x, y, z, radius_m] = v.as_slice() else { return Err(bad("sphere", v)) };
        if !v.iter().all(|x| x.is_finite() && x.abs() < 1e15) || radius_m < 0.0 {
            return Err(bad("sphere", v));
        }
        let s = BoundingSphere::new(DVec3::new(x, y, z), radius_m);
        return Ok(BoundingVolume::Sphere(s.transformed(world)));
    }
    Err(IoError::invalid(uri, "boundingVolume has neither box, region nor sphere"))
}
