//! [`Placement`]: from the frame of the tiles to the earth.

use glam::{DAffine3, DMat3, DVec3};

use super::metadata::{Metadata, shortened};
use crate::math::{Geodetic, TransverseMercator, WGS84};

/// Half the length in metres over which a grid is measured to find its directions and scales.
const STEP_M: f64 = 10.0;

/// How the frame of the tiles lies on the earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Placement {
    /// It stays as it is.
    Local,
    /// One map to earth-centred coordinates.
    Fixed(DAffine3),
    /// Eastings, northings and heights above the ellipsoid, relative to an origin.
    Grid { grid: Grid, origin: DVec3 },
}

/// A grid of metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Grid {
    TransverseMercator(TransverseMercator),
    WebMercator,
}

impl Grid {
    fn ecef(&self, point: DVec3) -> DVec3 {
        let geodetic = match self {
            Self::TransverseMercator(grid) => grid.unproject([point.x, point.y], point.z),
            Self::WebMercator => Geodetic {
                longitude: point.x / WGS84.semi_major_m,
                latitude: (point.y / WGS84.semi_major_m).sinh().atan(),
                height_m: point.z,
            },
        };
        WGS84.ecef(&geodetic)
    }
}

impl Placement {
    /// Returns the placement of a reference system, or what is not supported.
    pub fn new(metadata: &Metadata) -> Result<Self, String> {
        let Metadata { srs, origin } = metadata;
        let unknown = || format!("{:?}", shortened(srs));
        let fixed = |map: DAffine3| Self::Fixed(map * DAffine3::from_translation(*origin));
        if srs.is_empty() {
            return Ok(Self::Local);
        }
        let upper = srs.to_ascii_uppercase();
        if let Some(place) = upper.strip_prefix("ENU:") {
            let parts: Vec<f64> = place.split(',').filter_map(|part| part.trim().parse().ok()).collect();
            return match parts[..] {
                [latitude, longitude] if latitude.abs() <= 90.0 && longitude.abs() <= 360.0 => {
                    let (latitude, longitude) = (latitude.to_radians(), longitude.to_radians());
                    Ok(fixed(WGS84.ecef_from_enu(&Geodetic { longitude, latitude, height_m: 0.0 })))
                }
                _ => Err(unknown()),
            };
        }
        if let Some(code) = upper.strip_prefix("EPSG:") {
            // A vertical system may follow; heights are taken for those above the ellipsoid.
            let code = code.split('+').next().and_then(|code| code.trim().parse::<u32>().ok()).ok_or_else(unknown)?;
            return match code {
                4978 => Ok(fixed(DAffine3::IDENTITY)),
                _ => grid_of_epsg(code).map(|grid| Self::Grid { grid, origin: *origin }).ok_or_else(unknown),
            };
        }
        if upper.starts_with("LOCAL_CS") {
            return Ok(Self::Local);
        }
        if upper.starts_with("GEOCCS") {
            return Ok(fixed(DAffine3::IDENTITY));
        }
        grid_of_wkt(&upper).map(|grid| Self::Grid { grid, origin: *origin }).ok_or_else(unknown)
    }

    /// Returns the map of the surroundings of a point in the frame of the tiles.
    pub fn ecef_from_local(&self, near: DVec3) -> DAffine3 {
        let (grid, origin) = match self {
            Self::Local => return DAffine3::IDENTITY,
            Self::Fixed(map) => return *map,
            Self::Grid { grid, origin } => (grid, *origin),
        };
        let ecef = |local: DVec3| grid.ecef(origin + local);
        let along = |axis: DVec3| (ecef(near + STEP_M * axis) - ecef(near - STEP_M * axis)) / (2.0 * STEP_M);
        let matrix3 = DMat3::from_cols(along(DVec3::X), along(DVec3::Y), along(DVec3::Z));
        let map = DAffine3 { matrix3, translation: ecef(near) - matrix3 * near };
        if map.is_finite() { map } else { DAffine3::IDENTITY }
    }
}

/// Returns the grid with a code: UTM on WGS84 and ETRS89, Gauss-Krueger on CGCS2000, and Web Mercator. These ellipsoids are
/// the same to a tenth of a millimetre.
fn grid_of_epsg(code: u32) -> Option<Grid> {
    let gauss_krueger = |meridian: u32, zone: u32| TransverseMercator {
        central_meridian: f64::from(meridian).to_radians(),
        latitude_of_origin: 0.0,
        scale: 1.0,
        false_easting_m: f64::from(zone) * 1e6 + 500_000.0,
        false_northing_m: 0.0,
    };
    Some(Grid::TransverseMercator(match code {
        32601..=32660 => TransverseMercator::utm((code - 32600) as u8, false),
        32701..=32760 => TransverseMercator::utm((code - 32700) as u8, true),
        25828..=25838 => TransverseMercator::utm((code - 25800) as u8, false),
        // Zones of six degrees from 13, with and without the zone in the easting, and then of three degrees from 25.
        4491..=4501 => gauss_krueger((code - 4491 + 13) * 6 - 3, code - 4491 + 13),
        4502..=4512 => gauss_krueger(75 + (code - 4502) * 6, 0),
        4513..=4533 => gauss_krueger((code - 4513 + 25) * 3, code - 4513 + 25),
        4534..=4554 => gauss_krueger(75 + (code - 4534) * 3, 0),
        3857 => return Some(Grid::WebMercator),
        _ => return None,
    }))
}

/// Returns the Transverse Mercator grid that a WKT of the first version in upper case describes, if its ellipsoid is about
/// WGS84 and its unit is the metre.
fn grid_of_wkt(wkt: &str) -> Option<Grid> {
    let compact: String = wkt.chars().filter(|c| !c.is_whitespace()).collect();
    if !compact.contains("PROJCS[") {
        return None;
    }
    let is_known = ["PROJECTION[\"TRANSVERSE_MERCATOR\"", "PROJECTION[\"GAUSS_KRUGER\""];
    if !is_known.iter().any(|projection| compact.contains(projection)) {
        return None;
    }
    let numbers_behind = |start: &str| -> Option<Vec<f64>> {
        let rest = &compact[compact.find(start)? + start.len()..];
        let list = &rest[..rest.find([']', '['])?];
        Some(list.split(',').filter_map(|number| number.parse().ok()).collect())
    };
    // The name of an ellipsoid comes before its numbers.
    let spheroid = compact.split("SPHEROID[").nth(1).or(compact.split("ELLIPSOID[").nth(1))?;
    let mut parts = spheroid.split([',', ']']).skip(1).map_while(|part| part.parse::<f64>().ok());
    let (semi_major_m, inverse_flattening) = (parts.next()?, parts.next()?);
    if (semi_major_m - WGS84.semi_major_m).abs() > 0.5 || (inverse_flattening - 298.257).abs() > 0.01 {
        return None;
    }
    // The unit of the grid is the last one. Those of angles come before it.
    let unit = compact.rsplit("UNIT[").next()?;
    let metres: f64 = unit.split([',', ']']).nth(1)?.parse().ok()?;
    if (metres - 1.0).abs() > 1e-9 {
        return None;
    }
    let parameter =
        |name: &str| numbers_behind(&format!("PARAMETER[\"{name}\",")).and_then(|list| list.first().copied());
    let grid = TransverseMercator {
        central_meridian: parameter("CENTRAL_MERIDIAN")?.to_radians(),
        latitude_of_origin: parameter("LATITUDE_OF_ORIGIN").unwrap_or(0.0).to_radians(),
        scale: parameter("SCALE_FACTOR").unwrap_or(1.0),
        false_easting_m: parameter("FALSE_EASTING").unwrap_or(0.0),
        false_northing_m: parameter("FALSE_NORTHING").unwrap_or(0.0),
    };
    Some(Grid::TransverseMercator(grid))
}

#[cfg(test)]
mod tests {
    use super::*;

    const WKT: &str = r#"PROJCS["WGS 84 / UTM zone 32N",GEOGCS["WGS 84",DATUM["WGS_1984",
        SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],
        PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],
        PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],
        PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1,AUTHORITY["EPSG","9001"]],
        AUTHORITY["EPSG","32632"]]"#;

    fn placement(srs: &str, origin: [f64; 3]) -> Result<Placement, String> {
        Placement::new(&Metadata { srs: srs.into(), origin: DVec3::from_array(origin) })
    }

    #[test]
    fn codes_and_wkt_of_one_grid_are_the_same() {
        let origin = [463_900.0, 5_248_700.0, 400.0];
        let epsg = placement("EPSG:32632", origin).unwrap();
        assert_eq!(placement(WKT, origin).unwrap(), epsg);
        assert_eq!(placement("epsg:32632+5773", origin).unwrap(), epsg);
        assert_eq!(placement("EPSG:25832", origin).unwrap(), epsg);
        let by_zone = placement("EPSG:4547", [500_000.0, 3e6, 0.0]).unwrap().ecef_from_local(DVec3::ZERO);
        let with_zone = placement("EPSG:4526", [38_500_000.0, 3e6, 0.0]).unwrap().ecef_from_local(DVec3::ZERO);
        assert!(by_zone.abs_diff_eq(with_zone, 1e-6), "both have the meridian of 114 degrees");
    }

    #[test]
    fn tiles_lie_upright_in_their_place() {
        let map = placement("EPSG:32632", [463_900.0, 5_248_700.0, 400.0]).unwrap();
        let near = DVec3::new(120.0, -80.0, 5.0);
        let map = map.ecef_from_local(near);
        let at = WGS84.geodetic(map.transform_point3(near));
        let [easting, northing] = TransverseMercator::utm(32, false).project(&at);
        assert!((easting - 464_020.0).abs() < 1e-3 && (northing - 5_248_620.0).abs() < 1e-3);
        assert!((at.height_m - 405.0).abs() < 1e-3);
        assert!((map.matrix3.z_axis.dot(WGS84.up(&at)) - 1.0).abs() < 1e-6);
        // A metre of the grid is a metre divided by its scale, and longer at a height.
        let metre = map.matrix3.x_axis.length();
        assert!((metre - (1.0 + 405.0 / 6.38e6) / 0.99962).abs() < 5e-5, "{metre}");
        // A kilometre away the surface has fallen below the plane of this map, by d^2 / 2r.
        let away = near + DVec3::X * 1000.0;
        let drop = WGS84.geodetic(map.transform_point3(away)).height_m - 405.0;
        assert!((drop - 0.078).abs() < 0.01, "{drop}");
    }

    #[test]
    fn local_frames_stand_on_the_earth() {
        let map = placement("ENU:47.5,8.25", [10.0, 20.0, 30.0]).unwrap().ecef_from_local(DVec3::ZERO);
        let at = WGS84.geodetic(map.translation);
        assert!((at.height_m - 30.0).abs() < 1e-3);
        assert!((at.latitude.to_degrees() - 47.5).abs() < 1e-3 && (at.longitude.to_degrees() - 8.25).abs() < 1e-3);
        assert_eq!(placement("", [1.0; 3]).unwrap(), Placement::Local);
        assert_eq!(placement("EPSG:4978", [1.0; 3]).unwrap().ecef_from_local(DVec3::ZERO).translation, DVec3::ONE);
        let mercator = placement("EPSG:3857", [0.0; 3]).unwrap().ecef_from_local(DVec3::ZERO);
        assert!(mercator.translation.distance(DVec3::X * WGS84.semi_major_m) < 1e-6);
    }

    #[test]
    fn other_systems_are_refused_by_name() {
        let krassowsky = WKT.replace("6378137,298.257223563", "6378245,298.3");
        let feet = WKT.replace(r#"UNIT["metre",1"#, r#"UNIT["foot",0.3048"#);
        let conic = WKT.replace("Transverse_Mercator", "Lambert_Conformal_Conic_2SP");
        for bad in ["EPSG:2056", "EPSG:x", "ENU:91,0", "ENU:1", "PROJCS[", "utm", &krassowsky, &feet, &conic] {
            let error = placement(bad, [0.0; 3]).unwrap_err();
            assert!(error.contains(&bad[..3].to_string()), "{error}");
        }
    }
}
