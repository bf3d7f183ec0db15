//! Tests whether a bounding volume overlaps a region of a body's surface. The result may be true for volumes close to it.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::DAffine3;

use crate::math::{BoundingVolume, Ellipsoid, Region};

/// A lower bound of the distance from a body's centre to its surface, as a share of its shortest radius.
const MIN_RADIUS: f64 = 0.9753;

/// Returns true if the volume, in the frame `world` of its tileset, overlaps the region. The set lies on an ellipsoid, which is
/// that of the region whatever the region says. Heights are ignored.
pub(in crate::formats) fn overlaps(
    volume: &BoundingVolume,
    world: &DAffine3,
    region: &Region,
    ellipsoid: &Ellipsoid,
) -> bool {
    if let BoundingVolume::Region(r) = volume {
        return latitudes_overlap(r.south, r.north, region) && longitudes_overlap(r.west, r.width(), region);
    }
    let sphere = volume.bounding_sphere().transformed(world);
    let distance_m = sphere.center.length();
    if sphere.radius_m >= distance_m {
        return true;
    }
    // The factor covers the flattening: a normal is turned by its share at most, twice over.
    let Ellipsoid { semi_major_m, semi_minor_m } = ellipsoid;
    let ratio = (semi_major_m / semi_minor_m).max(semi_minor_m / semi_major_m);
    let angle = (ratio * ratio).max(1.01) * (sphere.radius_m / distance_m).asin() + 1e-9;
    let center = ellipsoid.geodetic(sphere.center);
    let (south, north) = (center.latitude - angle, center.latitude + angle);
    if !latitudes_overlap(south, north, region) {
        return false;
    }
    // A volume that contains a pole covers all longitudes.
    let half_width = angle.sin() / center.latitude.cos();
    if south <= -FRAC_PI_2 || north >= FRAC_PI_2 || half_width >= 1.0 {
        return true;
    }
    let half_width = half_width.asin();
    longitudes_overlap(center.longitude - half_width, 2.0 * half_width, region)
}

/// Returns true if the volume is on the body, false if its tileset has a local frame.
pub(in crate::formats) fn is_on_body(volume: &BoundingVolume, world: &DAffine3, ellipsoid: &Ellipsoid) -> bool {
    let sphere = volume.bounding_sphere().transformed(world);
    let min_radius_m = MIN_RADIUS * ellipsoid.semi_major_m.min(ellipsoid.semi_minor_m);
    matches!(volume, BoundingVolume::Region(_)) || sphere.center.length() + sphere.radius_m > min_radius_m
}

fn latitudes_overlap(south: f64, north: f64, region: &Region) -> bool {
    south <= region.north && north >= region.south
}

fn longitudes_overlap(west: f64, width: f64, region: &Region) -> bool {
    (region.west - west).rem_euclid(TAU) <= width || (west - region.west).rem_euclid(TAU) <= region.width()
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::math::{BoundingSphere, Geodetic, WGS84};

    fn region([west, south, east, north]: [f64; 4]) -> Region {
        let [west, south, east, north] = [west, south, east, north].map(f64::to_radians);
        Region { west, south, east, north, min_height_m: 0.0, max_height_m: 100.0, ellipsoid: WGS84 }
    }

    fn sphere(longitude: f64, latitude: f64, radius_m: f64) -> BoundingVolume {
        let g = Geodetic { longitude: longitude.to_radians(), latitude: latitude.to_radians(), height_m: 0.0 };
        BoundingVolume::Sphere(BoundingSphere::new(WGS84.ecef(&g), radius_m))
    }

    #[test]
    fn regions_with_regions() {
        let over = |a: [f64; 4], b: [f64; 4]| {
            let one = overlaps(&BoundingVolume::Region(region(a)), &DAffine3::IDENTITY, &region(b), &WGS84);
            assert_eq!(one, overlaps(&BoundingVolume::Region(region(b)), &DAffine3::IDENTITY, &region(a), &WGS84));
            one
        };
        assert!(over([5.0, 45.0, 10.0, 48.0], [9.0, 40.0, 12.0, 46.0]));
        assert!(!over([5.0, 45.0, 10.0, 48.0], [11.0, 40.0, 12.0, 46.0]));
        assert!(!over([5.0, 45.0, 10.0, 48.0], [6.0, 49.0, 7.0, 50.0]));
        assert!(over([170.0, 0.0, -170.0, 10.0], [-175.0, 5.0, -160.0, 6.0]), "over the antimeridian");
        assert!(!over([170.0, 0.0, -170.0, 10.0], [-165.0, 5.0, -160.0, 6.0]));
        assert!(over([-180.0, -90.0, 180.0, 90.0], [7.0, 46.0, 7.1, 46.1]), "the whole earth");
    }

    #[test]
    fn spheres_with_regions() {
        let of = region([5.0, 45.0, 10.0, 48.0]);
        let over = |volume: BoundingVolume| overlaps(&volume, &DAffine3::IDENTITY, &of, &WGS84);
        assert!(over(sphere(7.0, 46.0, 10.0)), "inside");
        assert!(over(sphere(4.0, 46.0, 100_000.0)) && !over(sphere(3.0, 46.0, 100_000.0)), "a degree is 77 km there");
        assert!(over(sphere(7.0, 44.0, 120_000.0)) && !over(sphere(7.0, 43.0, 120_000.0)), "a degree is 111 km");
        assert!(over(sphere(-170.0, 89.0, 5_000_000.0)), "over the pole");
        assert!(over(BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 6.4e6))), "the whole earth");
        let moved = DAffine3::from_translation(match sphere(7.0, 46.0, 1.0) {
            BoundingVolume::Sphere(s) => s.center,
            _ => DVec3::ZERO,
        });
        let local = BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 50.0));
        assert!(overlaps(&local, &moved, &of, &WGS84) && is_on_body(&local, &moved, &WGS84));
        assert!(!is_on_body(&local, &DAffine3::IDENTITY, &WGS84));
    }
}
