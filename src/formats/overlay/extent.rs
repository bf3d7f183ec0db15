//! [`Extent`]: where a tile is on the earth, and how fine its images must be. Decode threads and loading threads.

use glam::DVec3;

use super::grid::GeoRectangle;
use crate::formats::height;
use crate::math::{OrientedBox, WGS84};
use crate::scene::ReaderData;

/// Distances from the earth's centre between which there is ground, metres.
const GROUND_M: [f64; 2] = [6_250_000.0, 6_500_000.0];
/// A volume of at least this radius is around all of the earth.
const MAX_RADIUS_M: f64 = 4_000_000.0;
/// Steps along each axis of a box at which its longitudes and latitudes are looked up.
const STEPS: i32 = 4;

/// The declared volume of the tile that a content is for, as the scene knows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileVolume {
    /// The volume, or the box around it, in the frame of the whole set.
    pub bounds: OrientedBox,
    /// The geometric error of the tile in metres, or what follows from those above if it has none; 0 if it is unknown.
    pub geometric_error_m: f64,
}

/// A tile as overlays see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Extent {
    pub rectangle: GeoRectangle,
    pub geometric_error_m: f64,
    /// True for a height tile.
    pub is_height: bool,
}

impl Extent {
    /// Returns the extent of a tile; `None` if it is not on the earth. A region that its reader kept is exact, the rectangle
    /// around a box may be larger.
    pub fn new(volume: &TileVolume, reader_data: Option<&ReaderData>, is_height: bool) -> Option<Self> {
        let of_height = || height::region(reader_data?.text()?);
        let region = reader_data.and_then(ReaderData::region).or_else(of_height);
        let rectangle = match region {
            Some(region) => GeoRectangle::from_degrees(region.map(f64::to_degrees)),
            None => rectangle_of(&volume.bounds),
        };
        let of_content = reader_data.and_then(ReaderData::geometric_error_m);
        let geometric_error_m = of_content.unwrap_or(volume.geometric_error_m);
        Some(Self { rectangle: rectangle?, geometric_error_m, is_height })
    }
}

/// Returns the longitudes and latitudes of a box in ECEF metres.
fn rectangle_of(bounds: &OrientedBox) -> Option<GeoRectangle> {
    let (distance, radius) = (bounds.center.length(), bounds.bounding_sphere().radius_m);
    if !(radius.is_finite() && distance.is_finite())
        || distance - radius > GROUND_M[1]
        || distance + radius < GROUND_M[0]
    {
        return None;
    }
    if radius >= MAX_RADIUS_M {
        return Some(GeoRectangle::WORLD);
    }
    let middle = WGS84.geodetic(bounds.center).longitude;
    let steps = || (-STEPS..=STEPS).map(|step| f64::from(step) / f64::from(STEPS));
    let points = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| DVec3::new(x, y, z))));
    let points = points.map(|at| WGS84.geodetic(bounds.center + bounds.half_axes * at));
    let mut rectangle = GeoRectangle::around(middle, points.map(|point| [point.longitude, point.latitude]))?;
    // Around a pole there are all longitudes.
    for pole in [1.0, -1.0] {
        if bounds.distance_to(DVec3::new(0.0, 0.0, pole * WGS84.semi_minor_m)) < 1.0 {
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
    use crate::math::Region;

    #[test]
    fn box_around_a_region_has_its_longitudes_and_latitudes() {
        for [west, south, east, north] in [[0.1, 0.8, 0.101, 0.801], [3.1, -0.2, -3.1, 0.1], [-2.0, 1.2, -1.5, 1.4]] {
            let region = Region { west, south, east, north, min_height_m: -100.0, max_height_m: 3000.0 };
            let found = rectangle_of(&region.oriented_box()).unwrap();
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
        assert_eq!(rectangle_of(&bounds(DVec3::ZERO, 1000.0)), None, "a local frame");
        assert_eq!(rectangle_of(&bounds(DVec3::new(3e7, 0.0, 0.0), 1000.0)), None);
        assert_eq!(rectangle_of(&bounds(DVec3::ZERO, 7e6)), Some(GeoRectangle::WORLD));
        let pole = rectangle_of(&bounds(DVec3::new(0.0, 0.0, WGS84.semi_minor_m), 1e5)).unwrap();
        assert_eq!((pole.width(), pole.north), (std::f64::consts::TAU, std::f64::consts::FRAC_PI_2));
        assert!(pole.south > 1.5);
    }
}
