//! [`MapFrame`] and [`Place`]: positions of a set as places on a map with heights. Plain values.

use std::f64::consts::{FRAC_PI_2, TAU};

use glam::{DVec3, dvec3};

use crate::math::{BoundingVolume, Ellipsoid, Geodetic, Region};

/// How the positions of a set become places on a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MapFrame {
    /// Longitude and latitude in radians on an ellipsoid, heights above it.
    Globe(Ellipsoid),
    /// x and y in metres of the set's frame, heights along z.
    Local,
}

/// A point of a set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// In metres of the set's frame.
    pub position: DVec3,
    /// The place on the map; see [`MapFrame`].
    pub at: [f64; 2],
    pub height_m: f64,
}

/// Latitudes that differ by less from a pole's are that pole's, radians: some metres, since positions are `f32` in their tile.
const POLE_WIDTH: f64 = 1e-6;

impl MapFrame {
    /// Returns true if places are longitudes and latitudes.
    pub fn is_globe(self) -> bool {
        matches!(self, Self::Globe(_))
    }

    pub(super) fn place(self, position: DVec3) -> Place {
        match self {
            Self::Globe(ellipsoid) => {
                let Geodetic { longitude, latitude, height_m } = ellipsoid.geodetic(position);
                Place { position, at: [longitude, latitude], height_m }
            }
            Self::Local => Place { position, at: [position.x, position.y], height_m: position.z },
        }
    }

    /// Returns the point at a place of the map.
    pub(super) fn place_at(self, at: [f64; 2], height_m: f64) -> Place {
        let [longitude, latitude] = at;
        let position = match self {
            Self::Globe(ellipsoid) => ellipsoid.ecef(&Geodetic { longitude, latitude, height_m }),
            Self::Local => dvec3(at[0], at[1], height_m),
        };
        Place { position, at, height_m }
    }

    /// Returns the directions east, north and up at a place.
    pub(super) fn axes(self, place: &Place) -> [DVec3; 3] {
        match self {
            Self::Local => [DVec3::X, DVec3::Y, DVec3::Z],
            Self::Globe(_) => {
                let [(sin, cos), (sin_lat, cos_lat)] = place.at.map(f64::sin_cos);
                let (east, up) = (dvec3(-sin, cos, 0.0), dvec3(cos_lat * cos, cos_lat * sin, sin_lat));
                [east, up.cross(east), up]
            }
        }
    }

    /// Returns the longitude, or x, that is nearest to another one.
    pub(super) fn near(self, x: f64, other: f64) -> f64 {
        match self {
            // Most are near: rounding would be a call.
            Self::Globe(_) if (x - other).abs() >= 0.5 * TAU => x - ((x - other) / TAU).round() * TAU,
            _ => x,
        }
    }

    /// Returns true if all longitudes are the same place.
    pub(super) fn is_pole(self, y: f64) -> bool {
        self.is_globe() && y.abs() > FRAC_PI_2 - POLE_WIDTH
    }

    /// Returns the metres of a step of one along x and along y of the map, at a latitude.
    pub(super) fn metres(self, y: f64) -> [f64; 2] {
        match self {
            Self::Globe(ellipsoid) => [ellipsoid.semi_major_m * y.cos().max(1e-6), ellipsoid.semi_major_m],
            Self::Local => [1.0, 1.0],
        }
    }

    /// Returns a rectangle of the map around a volume in the set's frame: the smallest x and y, then the largest. The largest
    /// x is beyond pi across the antimeridian. `None` for a volume that has no bounds.
    pub(super) fn rectangle(self, volume: &BoundingVolume) -> Option<[f64; 4]> {
        if let (BoundingVolume::Region(r), Self::Globe(_)) = (volume, self) {
            return Some([r.west, r.south, r.west + r.width(), r.north]);
        }
        let sphere = volume.bounding_sphere();
        if !sphere.center.is_finite() || !(0.0..1e15).contains(&sphere.radius_m) {
            return None;
        }
        let corners: Vec<DVec3> = match volume.oriented_box() {
            Some(b) => {
                let m = b.half_axes;
                let signs = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]];
                let faces = signs.map(|[j, k]| m.y_axis * j + m.z_axis * k);
                faces.iter().flat_map(|face| [b.center + m.x_axis + *face, b.center - m.x_axis + *face]).collect()
            }
            None => {
                let [east, north, _] = self.axes(&self.place(sphere.center));
                let turn = |k: i32| (f64::from(k) * TAU / 8.0).sin_cos();
                let rim =
                    (0..8).map(turn).map(|(sin, cos)| sphere.center + (east * cos + north * sin) * sphere.radius_m);
                rim.collect()
            }
        };
        let middle = self.place(sphere.center);
        if self.is_globe() && sphere.radius_m > 0.5 * sphere.center.length() {
            return Some([-0.5 * TAU, -FRAC_PI_2, 0.5 * TAU, FRAC_PI_2]);
        }
        let mut rectangle = [middle.at[0], middle.at[1], middle.at[0], middle.at[1]];
        for corner in corners {
            let [x, y] = self.place(corner).at;
            extend(&mut rectangle, [self.near(x, middle.at[0]), y]);
        }
        Some(rectangle)
    }

    /// Returns how far a point lies outside of a volume, both in the set's frame, in metres; 0 inside.
    pub(super) fn outside_m(self, volume: &BoundingVolume, place: &Place) -> f64 {
        match volume {
            BoundingVolume::Sphere(s) => (s.center.distance(place.position) - s.radius_m).max(0.0),
            BoundingVolume::Box(b) => b.distance_to(place.position),
            BoundingVolume::Region(region) => outside_region_m(region, self, place),
        }
    }
}

fn outside_region_m(r: &Region, frame: MapFrame, place: &Place) -> f64 {
    let globe = MapFrame::Globe(r.ellipsoid);
    let place = if frame.is_globe() { *place } else { globe.place(place.position) };
    let [x, y] = place.at;
    let [per_x, per_y] = globe.metres(y);
    let middle = r.west + 0.5 * r.width();
    let beyond = |value: f64, low: f64, high: f64| (low - value).max(value - high).max(0.0);
    let x_m = match globe.is_pole(y) {
        true => 0.0,
        false => per_x * beyond(globe.near(x, middle), r.west, r.west + r.width()),
    };
    let y_m = per_y * beyond(y, r.south, r.north);
    let z_m = beyond(place.height_m, r.min_height_m, r.max_height_m);
    dvec3(x_m, y_m, z_m).length()
}

/// Extends a rectangle to a point.
pub(super) fn extend(rectangle: &mut [f64; 4], [x, y]: [f64; 2]) {
    let [west, south, east, north] = *rectangle;
    *rectangle = [west.min(x), south.min(y), east.max(x), north.max(y)];
}
