//! [`Extent`]: where a tile is on its body, and how fine its images must be. Decode threads and loading threads.

use glam::DVec3;

use super::grid::GeoRectangle;
use crate::formats::height;
use crate::formats::tile::TileVolume;
use crate::math::{Ellipsoid, OrientedBox};
use crate::scene::ReaderData;

/// Distances from the body's centre between which there is ground, as shares of its shortest and of its longest radius.
const GROUND: [f64; 2] = [0.9832, 1.0191];
/// A volume of at least this radius, as a share of the equatorial one, is around all of the body.
const MAX_RADIUS: f64 = 0.6272;
/// Steps along each axis of a box at which its longitudes and latitudes are looked up.
const STEPS: i32 = 4;

/// A tile as overlays see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::formats) struct Extent {
    pub rectangle: GeoRectangle,
    /// Metres of the earth: images are chosen by the angles that their texels cover, and a metre of a small body is a large angle.
    pub geometric_error_m: f64,
    /// True for a height tile.
    pub is_height: bool,
}

impl Extent {
    /// Returns the extent of a tile; `None` if it is not on the ellipsoid. A region that its reader kept is exact, the rectangle
    /// around a box may be larger.
    pub fn new(
        volume: &TileVolume,
        reader_data: Option<&ReaderData>,
        is_height: bool,
        ellipsoid: &Ellipsoid,
    ) -> Option<Self> {
        let of_height = || height::region(reader_data?.text()?);
        let region = reader_data.and_then(ReaderData::region).or_else(of_height);
        let rectangle = match region {
            Some(region) => GeoRectangle::from_degrees(region.map(f64::to_degrees)),
            None => rectangle_of(&volume.bounds, ellipsoid),
        };
        let of_content = reader_data.and_then(ReaderData::geometric_error_m);
        let geometric_error_m = of_content.unwrap_or(volume.geometric_error_m);
        let geometric_error_m = geometric_error_m / ellipsoid.per_earth();
        Some(Self { rectangle: rectangle?, geometric_error_m, is_height })
    }
}

/// Returns the longitudes and latitudes of a box in ECEF metres.
fn rectangle_of(bounds: &OrientedBox, ellipsoid: &Ellipsoid) -> Option<GeoRectangle> {
    let Ellipsoid { semi_major_m, semi_minor_m } = *ellipsoid;
    let (shortest_m, longest_m) = (semi_major_m.min(semi_minor_m), semi_major_m.max(semi_minor_m));
    let (distance, radius) = (bounds.center.length(), bounds.bounding_sphere().radius_m);
    if !(radius.is_finite() && distance.is_finite())
        || distance - radius > GROUND[1] * longest_m
        || distance + radius < GROUND[0] * shortest_m
    {
        return None;
    }
    if radius >= MAX_RADIUS * semi_major_m {
        return Some(GeoRectangle::WORLD);
    }
    let middle = ellipsoid.geodetic(bounds.center).longitude;
    let steps = || (-STEPS..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
    let points = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| DVec3::new(x, y, z))));
    let points = points.map(|at| ellipsoid.geodetic(bounds.center + bounds.half_axes * at));
    let mut rectangle = GeoRectangle::around(middle, points.map(|point| [point.longitude, point.latitude]))?;
    // Around a pole there are all longitudes.
    for pole in [1.0, -1.0] {
        if bounds.distance_to(DVec3::new(0.0, 0.0, pole * semi_minor_m)) < 1.0 {
            (rectangle.west, rectangle.east) = (GeoRectangle::WORLD.west, GeoRectangle::WORLD.east);
            let edge = if pole > 0.0 { &mut rectangle.north } else { &mut rectangle.south };
            *edge = pole * std::f64::consts::FRAC_PI_2;
        }
    }
    Some(rectangle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{MOON, Region, WGS84};

    #[test]
    fn box_around_a_region_has_its_longitudes_and_latitudes() {
        for [west, south, east, north] in [[0.1, 0.8, 0.101, 0.801], [3.1, -0.2, -3.1, 0.1], [-2.0, 1.2, -1.5, 1.4]] {
            let region =
                Region { west, south, east, north, min_height_m: -100.0, max_height_m: 3000.0, ellipsoid: WGS84 };
            let found = rectangle_of(&region.oriented_box(), &WGS84).unwrap();
            let east = region.west + region.width();
            // A box is as wide at its northern edge as at its southern one, which has fewer metres a degree in the north.
            let slack = 0.55 * (south.cos() / north.cos() - 1.0).max(0.5) * region.width();
            assert!(found.west <= west + 1e-9 && found.west >= west - slack, "{found:?}");
            assert!(found.east >= east - 1e-9 && found.east <= east + slack, "{found:?}");
            assert!(found.south <= south + 1e-9 && found.north >= north - 1e-9, "{found:?}");
        }
    }

    #[test]
    fn volumes_beside_the_earth_have_none() {
        let bounds = |center: DVec3, half: f64| OrientedBox {
            center,
            half_axes: glam::DMat3::from_diagonal(DVec3::splat(half)),
        };
        assert_eq!(rectangle_of(&bounds(DVec3::ZERO, 1000.0), &WGS84), None, "a local frame");
        assert_eq!(rectangle_of(&bounds(DVec3::new(3e7, 0.0, 0.0), 1000.0), &WGS84), None);
        assert_eq!(rectangle_of(&bounds(DVec3::ZERO, 7e6), &WGS84), Some(GeoRectangle::WORLD));
        let pole = rectangle_of(&bounds(DVec3::new(0.0, 0.0, WGS84.semi_minor_m), 1e5), &WGS84).unwrap();
        assert_eq!((pole.width(), pole.north), (std::f64::consts::TAU, std::f64::consts::FRAC_PI_2));
        assert!(pole.south > 1.5);
    }

    /// A texel covers an angle, whatever the size of the body.
    #[test]
    fn extents_on_the_moon_are_angles() {
        let region = |ellipsoid| {
            let [west, south, east, north] = [0.3, 0.5, 0.31, 0.51];
            Region { west, south, east, north, min_height_m: -100.0, max_height_m: 500.0, ellipsoid }
        };
        let extent = |ellipsoid: Ellipsoid, geometric_error_m| {
            let volume = TileVolume { bounds: region(ellipsoid).oriented_box(), geometric_error_m };
            Extent::new(&volume, None, false, &ellipsoid).unwrap()
        };
        let (earth, moon) = (extent(WGS84, 6_378.137), extent(MOON, 1_737.4));
        assert!((earth.geometric_error_m - moon.geometric_error_m).abs() < 1e-6, "{earth:?} {moon:?}");
        let sides = |of: &Extent| [of.rectangle.west, of.rectangle.south, of.rectangle.east, of.rectangle.north];
        for (a, b) in sides(&earth).into_iter().zip(sides(&moon)) {
            assert!((a - b).abs() < 1e-3, "{earth:?} {moon:?}");
        }
        let volume = TileVolume { bounds: region(MOON).oriented_box(), geometric_error_m: 1.0 };
        assert!(Extent::new(&volume, None, false, &WGS84).is_none(), "the Moon's surface is deep in the earth");
    }
}
