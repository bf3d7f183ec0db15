//! Transverse Mercator, the projection of UTM and of Gauss-Krueger grids. Plain values.
//!
//! Both directions are Krueger's series in the third flattening up to its fourth power (C. Karney, "Transverse Mercator with
//! an accuracy of a few nanometers", 2011, section 4), exact to a millimetre within 3,000 km of the central meridian.

use super::geodesy::{Ellipsoid, Geodetic, WGS84};

/// A Transverse Mercator grid on the WGS84 ellipsoid. Angles in radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransverseMercator {
    /// The longitude of the grid's north axis.
    pub central_meridian: f64,
    /// The latitude at which northings start.
    pub latitude_of_origin: f64,
    /// The scale on the central meridian.
    pub scale: f64,
    /// The easting of the central meridian in metres.
    pub false_easting_m: f64,
    /// The northing of the latitude of origin in metres.
    pub false_northing_m: f64,
}

/// Coefficients of the series, for an ellipsoid.
struct Series {
    /// The radius of the rectifying sphere in metres.
    radius_m: f64,
    eccentricity: f64,
    /// From the conformal sphere to the plane, and back.
    alpha: [f64; 4],
    beta: [f64; 4],
    /// From conformal to geodetic latitude.
    delta: [f64; 4],
}

impl Series {
    fn new(ellipsoid: &Ellipsoid) -> Self {
        let e2 = ellipsoid.eccentricity_squared();
        let flattening = 1.0 - (1.0 - e2).sqrt();
        let n = flattening / (2.0 - flattening);
        let (n2, n3, n4) = (n * n, n * n * n, n * n * n * n);
        Self {
            radius_m: ellipsoid.semi_major_m / (1.0 + n) * (1.0 + n2 / 4.0 + n4 / 64.0),
            eccentricity: e2.sqrt(),
            alpha: [
                n / 2.0 - 2.0 / 3.0 * n2 + 5.0 / 16.0 * n3 + 41.0 / 180.0 * n4,
                13.0 / 48.0 * n2 - 3.0 / 5.0 * n3 + 557.0 / 1440.0 * n4,
                61.0 / 240.0 * n3 - 103.0 / 140.0 * n4,
                49561.0 / 161_280.0 * n4,
            ],
            beta: [
                n / 2.0 - 2.0 / 3.0 * n2 + 37.0 / 96.0 * n3 - n4 / 360.0,
                n2 / 48.0 + n3 / 15.0 - 437.0 / 1440.0 * n4,
                17.0 / 480.0 * n3 - 37.0 / 840.0 * n4,
                4397.0 / 161_280.0 * n4,
            ],
            delta: [
                2.0 * n - 2.0 / 3.0 * n2 - 2.0 * n3 + 116.0 / 45.0 * n4,
                7.0 / 3.0 * n2 - 8.0 / 5.0 * n3 - 227.0 / 45.0 * n4,
                56.0 / 15.0 * n3 - 136.0 / 35.0 * n4,
                4279.0 / 630.0 * n4,
            ],
        }
    }

    /// Returns the position on the plane, in radii, of a latitude and an angle from the central meridian.
    fn plane(&self, latitude: f64, angle: f64) -> (f64, f64) {
        let e = self.eccentricity;
        let sine = latitude.sin();
        // The tangent of the conformal latitude.
        let t = (sine.atanh() - e * (e * sine).atanh()).sinh();
        let (north, east) = (t.atan2(angle.cos()), (angle.sin() / t.hypot(angle.cos())).asinh());
        let (mut x, mut y) = (north, east);
        for (j, alpha) in (1..).map(|j| 2.0 * f64::from(j)).zip(self.alpha) {
            x += alpha * (j * north).sin() * (j * east).cosh();
            y += alpha * (j * north).cos() * (j * east).sinh();
        }
        (x, y)
    }
}

impl TransverseMercator {
    /// Returns the grid of a zone of UTM, 1 to 60.
    pub fn utm(zone: u8, is_south: bool) -> Self {
        Self {
            central_meridian: (f64::from(zone) * 6.0 - 183.0).to_radians(),
            latitude_of_origin: 0.0,
            scale: 0.9996,
            false_easting_m: 500_000.0,
            false_northing_m: if is_south { 10_000_000.0 } else { 0.0 },
        }
    }

    /// Returns easting and northing in metres of a point; its height does not count.
    pub fn project(&self, point: &Geodetic) -> [f64; 2] {
        let series = Series::new(&WGS84);
        let factor = self.scale * series.radius_m;
        let (origin, _) = series.plane(self.latitude_of_origin, 0.0);
        let (north, east) = series.plane(point.latitude, point.longitude - self.central_meridian);
        [self.false_easting_m + factor * east, self.false_northing_m + factor * (north - origin)]
    }

    /// Returns the point with an easting and a northing in metres, at a height above the ellipsoid.
    pub fn unproject(&self, [easting_m, northing_m]: [f64; 2], height_m: f64) -> Geodetic {
        let series = Series::new(&WGS84);
        let factor = self.scale * series.radius_m;
        let (origin, _) = series.plane(self.latitude_of_origin, 0.0);
        let x = origin + (northing_m - self.false_northing_m) / factor;
        let y = (easting_m - self.false_easting_m) / factor;
        let (mut north, mut east) = (x, y);
        for (j, beta) in (1..).map(|j| 2.0 * f64::from(j)).zip(series.beta) {
            north -= beta * (j * x).sin() * (j * y).cosh();
            east -= beta * (j * x).cos() * (j * y).sinh();
        }
        let conformal = (north.sin() / east.cosh()).asin();
        let mut latitude = conformal;
        for (j, delta) in (1..).map(|j| 2.0 * f64::from(j)).zip(series.delta) {
            latitude += delta * (j * conformal).sin();
        }
        let longitude = self.central_meridian + east.sinh().atan2(north.cos());
        Geodetic { longitude, latitude, height_m }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn geodetic(longitude: f64, latitude: f64) -> Geodetic {
        Geodetic { longitude: longitude.to_radians(), latitude: latitude.to_radians(), height_m: 0.0 }
    }

    /// A published position, and positions that follow from the definition.
    #[test]
    fn grids_agree_with_known_coordinates() {
        let near = |grid: TransverseMercator, longitude, latitude, expected: [f64; 2]| {
            let [easting, northing] = grid.project(&geodetic(longitude, latitude));
            assert!(
                (easting - expected[0]).abs() < 0.6 && (northing - expected[1]).abs() < 0.6,
                "{easting} {northing}"
            );
        };
        // The CN tower in Toronto, rounded to whole metres.
        near(TransverseMercator::utm(17, false), -79.387_139, 43.642_567, [630_084.0, 4_833_439.0]);
        // On the central meridian at the equator, and a degree north of it along the meridian.
        near(TransverseMercator::utm(32, false), 9.0, 0.0, [500_000.0, 0.0]);
        near(TransverseMercator::utm(32, true), 9.0, 0.0, [500_000.0, 10_000_000.0]);
        // A degree of the meridian from the equator is 110,574.4 m.
        near(TransverseMercator::utm(32, false), 9.0, 1.0, [500_000.0, 110_574.4 * 0.9996]);
    }

    #[test]
    fn points_come_back() {
        let odd = TransverseMercator {
            central_meridian: 0.3,
            latitude_of_origin: 0.7,
            scale: 1.0,
            false_easting_m: 3.5e6,
            false_northing_m: -1e5,
        };
        for grid in [TransverseMercator::utm(32, false), TransverseMercator::utm(33, true), odd] {
            for (angle, latitude) in [(0.0, 0.0), (3.0, 47.0), (-5.0, -33.0), (8.0, 78.0), (0.5, -80.0)] {
                let point = geodetic(grid.central_meridian.to_degrees() + angle, latitude);
                let back = grid.unproject(grid.project(&point), 0.0);
                let (lat, lon) = (back.latitude - point.latitude, back.longitude - point.longitude);
                assert!(lat.abs() < 1e-10 && lon.abs() < 1e-10, "{angle} {latitude}: {lat} {lon}");
            }
        }
        let [easting, northing] = odd.project(&Geodetic { longitude: 0.3, latitude: 0.7, height_m: 0.0 });
        assert!((easting - 3.5e6).abs() < 1e-6 && (northing + 1e5).abs() < 1e-6);
    }
}
