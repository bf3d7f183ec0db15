//! Coordinate reference systems of elevation files, to and from longitude and latitude on WGS84.
//!
//! Transverse Mercator uses Krüger's series to the fourth order in n, with errors below a millimetre within a UTM zone
//! (C. F. F. Karney, Transverse Mercator with an accuracy of a few nanometers, 2011, equations 7 to 11, 35, 36).

use terrane::math::{Ellipsoid, WGS84};

use super::projection::Projection;

/// Parameters of datums as the crate's definitions name them, and those that PROJ uses: Amersfoort (EPSG:1672 and the newer
/// EPSG:15934), and Romania's Pulkovo 1942(58) (EPSG:15995, whose rotations have the other sign in the definitions), and
/// Israel 1993 (the more exact EPSG:9676).
const DATUMS: [[&str; 2]; 3] = [
    [
        "+towgs84=565.2369,50.0087,465.658,-0.406857,0.350733,-1.87035,4.0812",
        "+towgs84=565.4171,50.3319,465.5524,-0.398957388243134,0.343987817378283,-1.87740163998045,4.0725",
    ],
    [
        "+towgs84=2.329,-147.042,-92.08,0.309,-0.325,-0.497,5.69",
        "+towgs84=2.329,-147.042,-92.08,-0.309,0.325,0.497,5.69",
    ],
    ["+towgs84=-48,55,52,0,0,0,0", "+towgs84=23.772,17.49,17.859,-0.3132,-1.85274,1.67299,-5.4262"],
];

/// A supported coordinate reference system.
#[derive(Clone, Debug, PartialEq)]
pub enum Crs {
    /// Longitude and latitude in degrees, EPSG:4326. NAD83's 4269 and ETRS89's 4258 differ by less than two metres and
    /// are read as the same.
    Geographic,
    /// Longitude and latitude in degrees on another body than the earth.
    OnBody(Ellipsoid),
    /// Web Mercator, EPSG:3857, in metres.
    WebMercator,
    /// UTM in metres: EPSG:326zz and 327zz. 269zz (NAD83) and 258zz (ETRS89) differ by less than two metres and are read
    /// as the same.
    Utm {
        /// The zone, 1 to 60.
        zone: u32,
        /// True for the northern hemisphere, which has no false northing.
        north: bool,
    },
    /// Another system of EPSG, or one in PROJ's notation.
    Projection(Projection),
}

impl Crs {
    /// Returns the reference system of an EPSG code, `None` if it is not supported.
    pub fn from_epsg(code: u32) -> Option<Self> {
        match code {
            4326 | 4258 | 4269 | 4979 => Some(Self::Geographic),
            3857 | 900_913 | 3785 => Some(Self::WebMercator),
            32601..=32660 => Some(Self::Utm { zone: code - 32600, north: true }),
            32701..=32760 => Some(Self::Utm { zone: code - 32700, north: false }),
            25828..=25838 => Some(Self::Utm { zone: code - 25800, north: true }),
            26901..=26923 => Some(Self::Utm { zone: code - 26900, north: true }),
            // NAD83(CSRS) of several years.
            22207..=22222 | 22307..=22322 | 22407..=22422 | 22607..=22622 | 22707..=22722 | 22807..=22822 => {
                Some(Self::Utm { zone: code % 100, north: true })
            }
            // Saudi Arabia (KSA-GRF17) and Indonesia (SRGI2013).
            9356..=9360 => Some(Self::Utm { zone: code - 9320, north: true }),
            9476..=9482 => Some(Self::Utm { zone: code - 9430, north: true }),
            9487..=9494 => Some(Self::Utm { zone: code - 9440, north: false }),
            _ if has_other_meridian(code) || WRONG.contains(&code) => None,
            _ => Projection::new(&definition(code)?).ok().map(Self::Projection),
        }
    }

    /// Returns the system of a definition in PROJ's notation.
    pub(super) fn of(projection: Projection) -> Self {
        let ellipsoid = projection.ellipsoid();
        if ellipsoid != WGS84 && projection.is_plain_degrees() {
            return Self::OnBody(ellipsoid);
        }
        Self::Projection(projection)
    }

    /// Returns the ellipsoid of the body that the system is of. `None` for degrees and Web Mercator, which are used on other bodies
    /// as well: their coordinates depend on angles alone.
    pub(crate) fn ellipsoid(&self) -> Option<Ellipsoid> {
        match self {
            Self::Geographic | Self::WebMercator => None,
            Self::Utm { .. } => Some(WGS84),
            Self::OnBody(ellipsoid) => Some(*ellipsoid),
            Self::Projection(projection) => Some(projection.ellipsoid()),
        }
    }

    fn is_degrees(&self) -> bool {
        matches!(self, Self::Geographic | Self::OnBody(_))
    }

    /// Returns the EPSG codes of the system's unit of length; empty for degrees and for units that are not known.
    pub(super) fn units_of_length(&self) -> &'static [u32] {
        let Self::Projection(projection) = self else {
            return if self.is_degrees() { &[] } else { &[9001] };
        };
        match projection.unit_m() {
            Some(1.0) => &[9001],
            Some(metres) if (metres - 0.3048).abs() < 1e-9 => &[9002],
            Some(metres) if (metres - 1200.0 / 3937.0).abs() < 1e-9 => &[9003],
            _ => &[],
        }
    }

    /// Converts a longitude and latitude in radians to coordinates in the system, in degrees or metres.
    pub fn project(&self, longitude: f64, latitude: f64) -> [f64; 2] {
        match self {
            Self::Geographic | Self::OnBody(_) | Self::WebMercator => {
                [self.x_of_longitude(longitude), self.y_of_latitude(latitude).unwrap_or(f64::NAN)]
            }
            Self::Utm { zone, north } => utm_from_geodetic(*zone, *north, longitude, latitude),
            Self::Projection(projection) => projection.project(longitude, latitude),
        }
    }

    /// Returns the second coordinate of a latitude in radians if it is the same at all longitudes, in degrees or metres.
    pub(super) fn y_of_latitude(&self, latitude: f64) -> Option<f64> {
        match self {
            Self::Geographic | Self::OnBody(_) => Some(latitude.to_degrees()),
            Self::WebMercator => Some(WGS84.semi_major_m * (std::f64::consts::FRAC_PI_4 + 0.5 * latitude).tan().ln()),
            Self::Utm { .. } | Self::Projection(_) => None,
        }
    }

    /// Returns the first coordinate of a longitude in radians, in degrees or metres, in systems in which it is the same at
    /// all latitudes.
    pub(super) fn x_of_longitude(&self, longitude: f64) -> f64 {
        if self.is_degrees() { longitude.to_degrees() } else { WGS84.semi_major_m * longitude }
    }

    /// Converts coordinates in the system to a longitude and latitude in radians.
    pub fn unproject(&self, x: f64, y: f64) -> [f64; 2] {
        match self {
            Self::Geographic | Self::OnBody(_) => [x.to_radians(), y.to_radians()],
            Self::WebMercator => {
                let latitude = 2.0 * (y / WGS84.semi_major_m).exp().atan() - std::f64::consts::FRAC_PI_2;
                [x / WGS84.semi_major_m, latitude]
            }
            Self::Utm { zone, north } => utm_to_geodetic(*zone, *north, x, y),
            Self::Projection(projection) => projection.unproject(x, y),
        }
    }
}

/// Codes whose definitions in the crate place them elsewhere: axes to the south and west, or units of length that are chains.
const WRONG: [u32; 5] = [2065, 3167, 5513, 8044, 8045];

/// Definitions of codes that the crate does not know yet: the Southern Ocean's and Colombia's systems, the Albers projections of
/// Australia and New Zealand's waters, and Alabama's zones in feet.
const NEW: [(u32, &str); 6] = [
    (9191, "+proj=aea +lat_0=-40 +lon_0=175 +lat_1=-30 +lat_2=-50 +datum=WGS84"),
    (9354, "+proj=stere +lat_0=-90 +lat_ts=-65 +lon_0=0 +datum=WGS84"),
    (9377, "+proj=tmerc +lat_0=4 +lon_0=-73 +k=0.9992 +x_0=5000000 +y_0=2000000 +ellps=GRS80"),
    (9473, "+proj=aea +lat_0=0 +lon_0=132 +lat_1=-18 +lat_2=-36 +ellps=GRS80"),
    (9748, "+proj=tmerc +lat_0=30.5 +lon_0=-85.8333333333333 +k=0.99996 +x_0=200000.0001016 +ellps=GRS80 +units=us-ft"),
    (9749, "+proj=tmerc +lat_0=30 +lon_0=-87.5 +k=0.999933333 +x_0=600000 +ellps=GRS80 +units=us-ft"),
];

/// Returns the definition of an EPSG code in PROJ's notation.
pub(super) fn definition(code: u32) -> Option<String> {
    // New realizations of a datum that differ by centimetres.
    let code = match code {
        8888 | 9053..=9057 | 9755 | 10604..=10606 => 4326,
        // RGF93 v2 and v2b: Lambert-93, and its nine zones.
        9793 | 9794 => 2154,
        9822..=9830 => code - 9822 + 3942,
        9842..=9850 => code - 9842 + 3942,
        code => code,
    };
    let definition = match NEW.iter().find(|(new, _)| *new == code) {
        Some((_, definition)) => definition,
        None => crs_definitions::from_code(code.try_into().ok()?)?.proj4,
    };
    Some(DATUMS.iter().fold(definition.to_owned(), |definition, [known, used]| definition.replace(known, used)))
}

/// Returns true for EPSG's geographic systems whose longitudes do not start at Greenwich. Some of them use grads.
pub(super) fn has_other_meridian(code: u32) -> bool {
    matches!(code, 4801..=4821 | 4901..=4904 | 5229 | 8042 | 8043)
}

/// The coefficients of Krüger's series.
struct Series {
    /// The scale factor k0 times the rectifying radius.
    scale_m: f64,
    eccentricity: f64,
    alpha: [f64; 4],
    beta: [f64; 4],
}

fn series() -> Series {
    let f = (WGS84.semi_major_m - WGS84.semi_minor_m) / WGS84.semi_major_m;
    let n = f / (2.0 - f);
    let (n2, n3, n4) = (n * n, n * n * n, n * n * n * n);
    Series {
        scale_m: 0.9996 * WGS84.semi_major_m / (1.0 + n) * (1.0 + n2 / 4.0 + n4 / 64.0),
        eccentricity: 2.0 * n.sqrt() / (1.0 + n),
        alpha: [
            n / 2.0 - 2.0 * n2 / 3.0 + 5.0 * n3 / 16.0 + 41.0 * n4 / 180.0,
            13.0 * n2 / 48.0 - 3.0 * n3 / 5.0 + 557.0 * n4 / 1440.0,
            61.0 * n3 / 240.0 - 103.0 * n4 / 140.0,
            49561.0 * n4 / 161_280.0,
        ],
        beta: [
            n / 2.0 - 2.0 * n2 / 3.0 + 37.0 * n3 / 96.0 - n4 / 360.0,
            n2 / 48.0 + n3 / 15.0 - 437.0 * n4 / 1440.0,
            17.0 * n3 / 480.0 - 37.0 * n4 / 840.0,
            4397.0 * n4 / 161_280.0,
        ],
    }
}

fn central_meridian(zone: u32) -> f64 {
    (f64::from(zone) * 6.0 - 183.0).to_radians()
}

/// Converts a longitude and latitude in radians to UTM easting and northing in metres.
pub fn utm_from_geodetic(zone: u32, north: bool, longitude: f64, latitude: f64) -> [f64; 2] {
    let s = series();
    let lambda = longitude - central_meridian(zone);
    let sin = latitude.sin();
    let t = (sin.atanh() - s.eccentricity * (s.eccentricity * sin).atanh()).sinh();
    let xi_0 = t.atan2(lambda.cos());
    let eta_0 = (lambda.sin() / (1.0 + t * t).sqrt()).atanh();
    let (mut xi, mut eta) = (xi_0, eta_0);
    for (j, a) in s.alpha.iter().enumerate() {
        let k = 2.0 * (j + 1) as f64;
        xi += a * (k * xi_0).sin() * (k * eta_0).cosh();
        eta += a * (k * xi_0).cos() * (k * eta_0).sinh();
    }
    [500_000.0 + s.scale_m * eta, s.scale_m * xi + if north { 0.0 } else { 10_000_000.0 }]
}

/// Converts UTM easting and northing in metres to a longitude and latitude in radians.
pub fn utm_to_geodetic(zone: u32, north: bool, easting_m: f64, northing_m: f64) -> [f64; 2] {
    let s = series();
    let xi = (northing_m - if north { 0.0 } else { 10_000_000.0 }) / s.scale_m;
    let eta = (easting_m - 500_000.0) / s.scale_m;
    let (mut xi_0, mut eta_0) = (xi, eta);
    for (j, b) in s.beta.iter().enumerate() {
        let k = 2.0 * (j + 1) as f64;
        xi_0 -= b * (k * xi).sin() * (k * eta).cosh();
        eta_0 -= b * (k * xi).cos() * (k * eta).sinh();
    }
    let lambda = eta_0.sinh().atan2(xi_0.cos());
    let sin_conformal = xi_0.sin() / eta_0.cosh();
    let mut sin = sin_conformal;
    // Each step of the fixed-point iteration reduces the error by the factor e^2.
    for _ in 0..12 {
        sin = (sin_conformal.atanh() + s.eccentricity * (s.eccentricity * sin).atanh()).tanh();
    }
    [lambda + central_meridian(zone), sin.asin()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn utm_of_known_point() {
        // The CN Tower, Wikipedia's worked example: 43 38 33.24 N 79 23 13.7 W is 630084 E 4833438 N in zone 17.
        let lat = (43.0 + 38.0 / 60.0 + 33.24 / 3600.0f64).to_radians();
        let lon = -(79.0 + 23.0 / 60.0 + 13.7 / 3600.0f64).to_radians();
        let [e, n] = utm_from_geodetic(17, true, lon, lat);
        assert!((e - 630_084.0).abs() < 1.0 && (n - 4_833_438.0).abs() < 1.0, "{e} {n}");
    }

    #[test]
    fn wkt_is_read_by_its_code_or_its_parameters() {
        let mercator = r#"PROJCS["a",GEOGCS["b",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],
            PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]],
            PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",9],
            PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1]"#;
        let coded = format!("{mercator},\n  AUTHORITY[\"EPSG\",\"32632\"]]");
        assert_eq!(Crs::parse(&coded), Ok(Crs::Utm { zone: 32, north: true }));
        let [x, y] = Crs::parse(&format!("{mercator}]")).unwrap().project(0.15, 0.82);
        let expected = utm_from_geodetic(32, true, 0.15, 0.82);
        assert!((x - expected[0]).abs() < 1e-3 && (y - expected[1]).abs() < 1e-3, "{x} {y}, not {expected:?}");
        assert!(Crs::parse("PROJCS[\"nothing\"").is_err());
    }

    #[test]
    fn project_and_unproject_are_inverse() {
        for crs in
            [Crs::Geographic, Crs::WebMercator, Crs::Utm { zone: 32, north: true }, Crs::Utm { zone: 5, north: false }]
        {
            let lon_0 = match crs {
                Crs::Utm { zone, .. } => central_meridian(zone),
                _ => 0.1,
            };
            for dlon in [-0.05, 0.0, 0.05] {
                for lat in [-1.2, -0.3, 0.0, 0.7, 1.4f64] {
                    let [x, y] = crs.project(lon_0 + dlon, lat);
                    let [lon, back] = crs.unproject(x, y);
                    assert!((lon - lon_0 - dlon).abs() < 1e-10 && (back - lat).abs() < 1e-10, "{crs:?} {lat}");
                }
            }
        }
    }
}
