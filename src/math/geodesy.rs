//! Ellipsoids of bodies: geodetic coordinates to and from metres of the axes that turn with the body (ECEF).
//!
//! ECEF: x through (0 N, 0 E), y through (0 N, 90 E), z through the north pole. NIMA TR8350.2; IAU WGCCRE 2015.

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

/// The ellipsoid of GPS, and of 3D Tiles that name no other.
pub const WGS84: Ellipsoid = Ellipsoid { semi_major_m: 6_378_137.0, semi_minor_m: 6_356_752.314_245_179 };
/// The sphere of the Moon.
pub const MOON: Ellipsoid = Ellipsoid { semi_major_m: 1_737_400.0, semi_minor_m: 1_737_400.0 };
/// The ellipsoid of Mars.
pub const MARS: Ellipsoid = Ellipsoid { semi_major_m: 3_396_190.0, semi_minor_m: 3_376_200.0 };

/// The smallest and the largest radius of a body, metres.
const RADII_M: std::ops::RangeInclusive<f64> = 1e3..=1e9;
/// The largest ratio of two radii of a body. The flattest round bodies that are known have a ratio of about 2.
const MAX_RADII_RATIO: f64 = 10.0;
/// Equatorial radii that differ by at most this share are one radius.
const SAME_RADIUS: f64 = 1e-6;
/// Bodies whose equatorial radius differs from the earth's by at most this share are the earth on another ellipsoid.
const EARTH_SHARE: f64 = 0.01;
/// The lowest and the highest ground of the earth, metres: below the deepest trench, and above the highest mountain.
const EARTH_GROUND_M: [f64; 2] = [-12_000.0, 9_000.0];
/// The largest distance of ground from the ellipsoid of another body, metres, and as a share of its radius: that of Olympus
/// Mons on Mars, and of the craters of Vesta.
const MAX_RELIEF_M: f64 = 25_000.0;
const MAX_RELIEF_SHARE: f64 = 0.2;
/// Steps of the iteration of the latitude. Those of a flat body converge slowly.
const STEPS: u32 = 8;
const STEPS_OF_FLAT: u32 = 100;
/// The first eccentricity squared beyond which a body counts as flat. That of Mars is 0.012.
const FLAT: f64 = 0.02;

/// Three radii that are those of no body.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("radii {0:?}: expected three numbers from 1e3 to 1e9 metres, of which none is more than ten times another")]
pub struct RadiiError(pub [f64; 3]);

impl Ellipsoid {
    /// Returns the ellipsoid of revolution with radii along x, y and z in metres. Where the equatorial ones differ, it has their
    /// mean; see [`Self::is_triaxial`].
    ///
    /// # Errors
    /// Fails for radii that are not finite, shorter than a kilometre or longer than a million kilometres, and for those of a needle
    /// or a disc.
    pub fn from_radii_m(radii_m: [f64; 3]) -> Result<Self, RadiiError> {
        let [x, y, z] = radii_m;
        // NaN is in no range.
        let is_valid = radii_m.iter().all(|radius_m| RADII_M.contains(radius_m));
        let (least, largest) = (x.min(y).min(z), x.max(y).max(z));
        if !is_valid || largest > MAX_RADII_RATIO * least {
            return Err(RadiiError(radii_m));
        }
        Ok(Self { semi_major_m: 0.5 * (x + y), semi_minor_m: z })
    }

    /// Returns true if radii along x, y and z are those of no ellipsoid of revolution: the equatorial ones differ by more than a
    /// millionth.
    pub fn is_triaxial([x, y, _]: [f64; 3]) -> bool {
        (x - y).abs() > SAME_RADIUS * x.max(y)
    }

    /// Returns the radii along x, y and z, metres.
    pub fn radii_m(&self) -> DVec3 {
        DVec3::new(self.semi_major_m, self.semi_major_m, self.semi_minor_m)
    }

    /// Returns true for the earth, on WGS84 or another of its ellipsoids.
    pub fn is_earth(&self) -> bool {
        (self.per_earth() - 1.0).abs() <= EARTH_SHARE
    }

    /// Returns a height below all ground of the body, and one above it, metres.
    pub fn ground_m(&self) -> [f64; 2] {
        if self.is_earth() {
            return EARTH_GROUND_M;
        }
        let relief_m = MAX_RELIEF_M.min(MAX_RELIEF_SHARE * self.semi_major_m.min(self.semi_minor_m));
        [-relief_m, relief_m]
    }

    /// Returns the ratio of the body's size to the earth's.
    pub(crate) fn per_earth(&self) -> f64 {
        self.semi_major_m / WGS84.semi_major_m
    }

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
    /// error is below 1e-9 m from the surface of the earth to geostationary height.
    pub fn geodetic(&self, p: DVec3) -> Geodetic {
        let e2 = self.eccentricity_squared();
        let r = p.x.hypot(p.y);
        let longitude = if r > 0.0 { p.y.atan2(p.x) } else { 0.0 };
        // Sine and cosine of the latitude take a root instead of an angle in each step.
        let towards = |z: f64, r: f64| {
            let length = (z * z + r * r).sqrt();
            if length > 0.0 { (z / length, r / length) } else { (0.0, 1.0) }
        };
        let (mut sin, mut cos) = towards(p.z, r * (1.0 - e2));
        let mut height_m = 0.0;
        for _ in 0..if e2.abs() < FLAT { STEPS } else { STEPS_OF_FLAT } {
            let flatter = (1.0 - e2 * sin * sin).sqrt();
            let n = self.semi_major_m / flatter;
            height_m = r * cos + p.z * sin - self.semi_major_m * flatter;
            let (next_sin, next_cos) = towards(p.z, r * (1.0 - e2 * n / (n + height_m)));
            if (next_sin * cos - next_cos * sin).abs() < 1e-15 {
                break;
            }
            (sin, cos) = (next_sin, next_cos);
        }
        let latitude = sin.atan2(cos);
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
    fn places_of_other_bodies_round_trip() {
        let flat = Ellipsoid { semi_major_m: 1e6, semi_minor_m: 5e5 };
        let long = Ellipsoid { semi_major_m: 5e5, semi_minor_m: 9e5 };
        for (body, heights_m) in [(MOON, [-9e3, 2e7]), (MARS, [-8e3, 2e7]), (flat, [-1e3, 1e6]), (long, [-1e3, 1e6])] {
            for (lat, lon, height_m) in
                [-1.57, -0.7, 0.0, 0.3, 1.5].into_iter().flat_map(|lat| heights_m.map(|height_m| (lat, 2.0, height_m)))
            {
                let g = Geodetic { longitude: lon, latitude: lat, height_m };
                let back = body.geodetic(body.ecef(&g));
                let off_m = body.ecef(&g).distance(body.ecef(&back));
                assert!(off_m < 1e-3 && (back.height_m - height_m).abs() < 1e-3, "{body:?} {g:?} {back:?}");
            }
        }
        // On a sphere the latitude is the angle from the equator.
        let at = MOON.ecef(&Geodetic { longitude: 0.0, latitude: 0.5, height_m: 1000.0 });
        assert!(at.distance(DVec3::new(0.5f64.cos(), 0.0, 0.5f64.sin()) * 1_738_400.0) < 1e-6, "{at}");
    }

    #[test]
    fn radii_of_no_body_are_refused() {
        let of = Ellipsoid::from_radii_m;
        assert_eq!(of([6_378_137.0, 6_378_137.0, WGS84.semi_minor_m]), Ok(WGS84));
        assert_eq!(of([1_737_400.0; 3]), Ok(MOON));
        for bad in [[f64::NAN, 1e6, 1e6], [1e6, 1e6, f64::INFINITY], [-1e6; 3], [0.0; 3], [999.0; 3], [1.1e9; 3]] {
            assert!(of(bad).is_err(), "{bad:?}");
        }
        let disc = of([1e6, 1e6, 9e4]).unwrap_err().to_string();
        assert!(disc.contains("90000") && disc.contains("ten times"), "{disc}");
        // Vesta.
        let vesta = [286_300.0, 278_600.0, 223_200.0];
        assert_eq!(of(vesta), Ok(Ellipsoid { semi_major_m: 282_450.0, semi_minor_m: 223_200.0 }));
        assert!(Ellipsoid::is_triaxial(vesta) && !Ellipsoid::is_triaxial([1_000_000.5, 1e6, 9e5]));
        assert!(!MOON.is_earth() && Ellipsoid { semi_major_m: 6_371_000.0, semi_minor_m: 6_371_000.0 }.is_earth());
        assert_eq!((MOON.ground_m(), WGS84.ground_m()), ([-25_000.0, 25_000.0], [-12_000.0, 9_000.0]));
    }

    #[test]
    fn enu_is_right_handed() {
        let f = WGS84.ecef_from_enu(&Geodetic { longitude: 0.3, latitude: 0.7, height_m: 12.0 });
        assert!((f.matrix3.determinant() - 1.0).abs() < 1e-12);
    }
}
