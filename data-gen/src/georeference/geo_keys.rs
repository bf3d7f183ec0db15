//! The GeoKeys of a GeoTIFF (OGC 19-008): the reference system and the units of its coordinates and heights.

use super::crs::{Crs, definition, has_other_meridian};
use super::projection::EARTH_AXES_M;

/// The value of a GeoKey whose system or unit has no EPSG code.
const USER_DEFINED: u32 = 32767;
/// The value of GTModelType for projected coordinates.
const PROJECTED: u32 = 1;
/// The value of GTModelType for longitude and latitude.
const GEODETIC: u32 = 2;

/// The international foot in metres.
pub(super) const FOOT_M: f64 = 0.3048;
/// The US survey foot in metres.
pub(super) const US_SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;

/// Returns a unit of length in metres by a name that GDAL writes, `None` for other names.
pub(crate) fn named_unit_m(name: &str) -> Option<f64> {
    Some(match &*name.to_ascii_lowercase() {
        // Some formats have a word for a unit that nobody named.
        "" | "unknown" | "unspecified" => 1.0,
        "m" | "metre" | "metres" | "meter" | "meters" => 1.0,
        "ft" | "foot" | "feet" | "international foot" | "international feet" => FOOT_M,
        "km" | "kilometre" | "kilometres" | "kilometer" | "kilometers" => 1000.0,
        "dm" | "decimetre" | "decimetres" | "decimeter" | "decimeters" => 0.1,
        "cm" | "centimetre" | "centimetres" | "centimeter" | "centimeters" => 0.01,
        "mm" | "millimetre" | "millimetres" | "millimeter" | "millimeters" => 0.001,
        "us survey foot" | "us survey feet" | "us_survey_foot" | "ftus" | "us-ft" | "sfoot" => US_SURVEY_FOOT_M,
        _ => return None,
    })
}

/// Returns EPSG's units of length in metres, `None` for other codes.
fn unit_m(code: u32) -> Option<f64> {
    Some(match code {
        1025 => 0.001,
        1033 => 0.01,
        9001 => 1.0,
        9002 => FOOT_M,
        9003 => US_SURVEY_FOOT_M,
        // Clarke's foot, the German legal metre, the kilometre.
        9005 => 0.304_797_265_4,
        9031 => 1.000_013_596_5,
        9036 => 1000.0,
        // The British foot (Sears 1922), the Indian foot, the foot of the Gold Coast, the British foot of 1936, the yard.
        9041 => 12.0 / 39.370_147,
        9080 => 12.0 * 0.025_399_956_415_78,
        9094 => 6_378_300.0 / 20_926_201.0,
        9095 => 0.304_800_749_1,
        9096 => 0.9144,
        _ => return None,
    })
}

/// EPSG codes of vertical systems that are positive downwards (dataset 11.022).
const DEPTHS: &[u32] = &[
    5336, 5612, 5614, 5706, 5715, 5734, 5739, 5789, 5831, 5861, 5862, 5863, 5864, 5865, 5866, 5867, 5873, 6357, 6358,
    6359, 7976, 8051, 8053, 8358, 8378, 8897, 9287, 9288, 9672, 10150, 10151, 10349, 10364, 10370, 10371, 10372, 10373,
    10374, 10375, 10376, 10377, 10378, 10379, 10547, 10548, 10549, 10550, 10551, 10552, 10649, 10650, 10678,
];

/// The words that ArcGIS writes before the WKT of a system that has no keys.
const ESRI_WKT: &str = "ESRI PE String = ";

/// The tags GeoKeyDirectory, GeoDoubleParams and GeoAsciiParams.
#[derive(Clone)]
pub(crate) struct GeoKeys {
    directory: Vec<u16>,
    doubles: Vec<f64>,
    texts: String,
}

impl GeoKeys {
    pub(super) fn new(directory: Vec<u16>, doubles: Vec<f64>, texts: String) -> Self {
        Self { directory, doubles, texts }
    }

    /// Returns the WKT of ArcGIS.
    fn esri_wkt(&self) -> Option<&str> {
        let (_, wkt) = self.texts.split_once(ESRI_WKT)?;
        wkt.split('|').next()
    }

    /// Returns the value of a key with a 16-bit number. 0 means undefined.
    pub(super) fn number(&self, id: u16) -> Option<u32> {
        let mut keys = self.directory.chunks_exact(4).skip(1);
        keys.find(|k| k[0] == id && k[1] == 0).map(|k| u32::from(k[3])).filter(|value| *value != 0)
    }

    /// Returns GTModelType.
    pub(super) fn model(&self) -> Option<u32> {
        self.number(1024)
    }

    /// Returns the value of a key that is stored in GeoDoubleParams.
    fn double(&self, id: u16) -> Option<f64> {
        let mut keys = self.directory.chunks_exact(4).skip(1);
        let key = keys.find(|k| k[0] == id && k[1] == 34736)?;
        self.doubles.get(usize::from(key[3])).copied()
    }

    /// Returns the reference system; `given` if the keys name a projection without a code, `None` if they name no system.
    /// The error is the reason.
    pub fn crs(&self, given: Option<Crs>) -> Result<Option<Crs>, String> {
        let crs = self.system(given)?;
        // Units and a meridian that differ from those of the system make it another system.
        let is_geographic = crs == Some(Crs::Geographic);
        let length = crs.as_ref().map_or(&[][..], Crs::units_of_length);
        let usual: [(u16, &str, &[u32]); 3] = [
            // GeogAngularUnits: degrees; GeogPrimeMeridian: Greenwich; ProjLinearUnits.
            (2054, "angles in units of", if is_geographic { &[9102, 9122] } else { &[] }),
            (2051, "longitudes from the meridian", if is_geographic { &[8901] } else { &[] }),
            (3076, "coordinates in units of", length),
        ];
        for (key, what, values) in usual {
            if let Some(value) = self.number(key).filter(|value| !values.is_empty() && !values.contains(value)) {
                return Err(format!("GeoTIFF: {what} EPSG:{value}, which is not supported"));
            }
        }
        // GeogPrimeMeridianLongitude.
        if let Some(east) = self.double(2061).filter(|east| is_geographic && *east != 0.0) {
            return Err(format!("GeoTIFF: longitudes from a meridian at {east}, which is not supported"));
        }
        // GeogSemiMajorAxis, unless GeogLinearUnits is another unit than the metre.
        match self.axis_elsewhere_m() {
            Some(axis_m) if !crs.as_ref().and_then(Crs::ellipsoid).is_some_and(|own| own.semi_major_m == axis_m) => {
                Err(format!("GeoTIFF: an ellipsoid of {axis_m} m in a system of another one"))
            }
            _ => Ok(crs),
        }
    }

    /// Returns GeogSemiMajorAxis in metres, if it is not one of the earth's.
    fn axis_elsewhere_m(&self) -> Option<f64> {
        let axis_m = self.double(2057).filter(|axis_m| !EARTH_AXES_M.contains(axis_m))?;
        matches!(self.number(2052), None | Some(9001)).then_some(axis_m)
    }

    fn system(&self, given: Option<Crs>) -> Result<Option<Crs>, String> {
        // GTModelType, ProjectedCRS and GeodeticCRS. With a projection the last is only its base.
        let model = self.model();
        // GDAL gives projections that GeoTIFF lacks, such as Mollweide, no model type, but ArcGIS's WKT.
        let is_base = model == Some(PROJECTED) || (model == Some(USER_DEFINED) && self.esri_wkt().is_some());
        let code = self.number(3072).or_else(|| self.number(2048).filter(|_| !is_base));
        match (code, model) {
            (Some(code), model) if code != USER_DEFINED => Crs::from_epsg(code)
                // Geodetic systems in degrees from Greenwich differ from WGS84 by a few hundred metres at most.
                .or((model == Some(GEODETIC) && !has_other_meridian(code)).then_some(Crs::Geographic))
                .or(given)
                .map(Some)
                .ok_or_else(|| format!("GeoTIFF: EPSG:{code} is not supported; --epsg names another system")),
            (_, Some(USER_DEFINED | PROJECTED)) if self.esri_wkt().is_some() => {
                let system = Crs::parse(self.esri_wkt().unwrap_or_default());
                system.or_else(|reason| given.ok_or(reason)).map(Some).map_err(|reason| format!("GeoTIFF: {reason}"))
            }
            // Another body, or GeogTOWGS84: the shift of a datum without a code.
            (_, Some(GEODETIC)) if self.axis_elsewhere_m().or(self.shift().map(|_| 0.0)).is_some() => {
                let datum = self.datum().unwrap_or_default();
                Crs::parse(&format!("+proj=longlat {datum}")).map(Some).map_err(|reason| format!("GeoTIFF: {reason}"))
            }
            (_, Some(GEODETIC)) => Ok(Some(Crs::Geographic)),
            (None, None) => Ok(None),
            (_, Some(PROJECTED) | None) => {
                if let Some(own) = self.own_projection() {
                    return Crs::parse(&own).map(Some).map_err(|reason| format!("GeoTIFF: {reason}"));
                }
                if given.is_some() {
                    return Ok(given);
                }
                Err("GeoTIFF: a projection without a code; --epsg CODE names it if it has one".to_owned())
            }
            (_, Some(model)) => Err(format!("GeoTIFF: model type {model} is not supported")),
        }
    }

    /// Returns the projection that the keys define by its method and parameters, in PROJ's notation. `None` without a known
    /// method, unit or ellipsoid.
    fn own_projection(&self) -> Option<String> {
        // GeodeticCRS, and the PrimeMeridian of a system without a code.
        let is_elsewhere = self.number(2048).is_some_and(has_other_meridian)
            || self.number(2051).is_some_and(|meridian| ![8901, USER_DEFINED].contains(&meridian))
            || self.double(2061).is_some_and(|east| east != 0.0);
        if is_elsewhere {
            return None;
        }
        let datum = self.datum()?;
        // Projection: the zones of UTM.
        match self.number(3074) {
            Some(zone @ 16001..=16060) => return Some(format!("+proj=utm +zone={} {datum}", zone - 16000)),
            Some(zone @ 16101..=16160) => return Some(format!("+proj=utm +zone={} +south {datum}", zone - 16100)),
            _ => {}
        }
        let unit_m = match self.number(3076) {
            None => 1.0,
            Some(unit) => unit_m(unit).or_else(|| self.double(3077).filter(|unit_m| *unit_m > 0.0))?,
        };
        let first = |keys: &[u16]| keys.iter().find_map(|key| self.double(*key));
        // The origin may be the natural one, the false one, or the centre.
        let latitude = first(&[3081, 3085, 3089]).unwrap_or(0.0);
        let longitude = first(&[3080, 3084, 3088, 3095]).unwrap_or(0.0);
        let [parallel_1, parallel_2] = [3078, 3079].map(|key| self.double(key));
        let scale = first(&[3092, 3093]).unwrap_or(1.0);
        // ProjCoordTrans.
        let method = match self.number(3075)? {
            1 => format!("tmerc +lat_0={latitude} +k={scale}"),
            7 => match parallel_1 {
                Some(parallel) => format!("merc +lat_ts={parallel}"),
                None => format!("merc +k={scale}"),
            },
            8 => format!("lcc +lat_0={latitude} +lat_1={} +lat_2={}", parallel_1?, parallel_2?),
            9 => format!("lcc +lat_0={latitude} +lat_1={latitude} +k_0={scale}"),
            10 => format!("laea +lat_0={latitude}"),
            11 => format!("aea +lat_0={latitude} +lat_1={} +lat_2={}", parallel_1?, parallel_2?),
            // The latitude of origin of a polar projection is where its scale is true.
            15 if latitude != 0.0 => format!("stere +lat_0={} +lat_ts={latitude} +k={scale}", 90.0 * latitude.signum()),
            16 => format!("sterea +lat_0={latitude} +k={scale}"),
            13 => format!("eqdc +lat_0={latitude} +lat_1={} +lat_2={}", parallel_1?, parallel_2?),
            18 => format!("cass +lat_0={latitude}"),
            22 => format!("poly +lat_0={latitude}"),
            17 => format!("eqc +lat_0={latitude} +lat_ts={}", parallel_1.unwrap_or(0.0)),
            24 => "sinu".to_owned(),
            28 => format!("cea +lat_ts={}", parallel_1.unwrap_or(0.0)),
            _ => return None,
        };
        let [x_m, y_m] = [first(&[3082, 3086, 3090]), first(&[3083, 3087, 3091])].map(|v| v.unwrap_or(0.0) * unit_m);
        Some(format!("+proj={method} +lon_0={longitude} +x_0={x_m} +y_0={y_m} {datum} +to_meter={unit_m}"))
    }

    /// Returns the shift to WGS84 in PROJ's notation.
    fn shift(&self) -> Option<String> {
        let mut keys = self.directory.chunks_exact(4).skip(1);
        let key = keys.find(|k| k[0] == 2062 && k[1] == 34736 && matches!(k[2], 3 | 7))?;
        let first = usize::from(key[3]);
        let numbers = self.doubles.get(first..first + usize::from(key[2]))?;
        Some(format!("+towgs84={}", numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",")))
    }

    /// Returns the datum or the ellipsoid in PROJ's notation.
    fn datum(&self) -> Option<String> {
        let ellipsoid = self.ellipsoid()?;
        Some(match self.shift() {
            Some(shift) if !ellipsoid.contains("+towgs84=") => format!("{ellipsoid} {shift}"),
            _ => ellipsoid,
        })
    }

    /// Returns the datum of a code, or the ellipsoid, in PROJ's notation.
    fn ellipsoid(&self) -> Option<String> {
        // GeodeticCRS, or GeodeticDatum: a datum's code is larger by 2000 than that of the system in degrees.
        let datum = || self.number(2050).filter(|code| (6001..=6999).contains(code)).map(|code| code - 2000);
        let code = self.number(2048).filter(|code| *code != USER_DEFINED).or_else(datum);
        if let Some(known) = code.filter(|code| !has_other_meridian(*code)).and_then(definition) {
            let parts = known.split_whitespace().filter(|part| !matches!(*part, "+proj=longlat" | "+no_defs"));
            return Some(parts.collect::<Vec<_>>().join(" "));
        }
        let axis_m = self.double(2057);
        match (axis_m, self.double(2059), self.double(2058)) {
            (Some(axis_m), Some(flattening), _) => Some(format!("+a={axis_m} +rf={flattening}")),
            (Some(axis_m), None, Some(minor_m)) => Some(format!("+a={axis_m} +b={minor_m}")),
            (Some(radius_m), None, None) if self.axis_elsewhere_m().is_some() => Some(format!("+R={radius_m}")),
            _ => match self.number(2056)? {
                7030 => Some("+ellps=WGS84".to_owned()),
                7019 => Some("+ellps=GRS80".to_owned()),
                7001 => Some("+ellps=airy".to_owned()),
                7004 => Some("+ellps=bessel".to_owned()),
                7008 => Some("+ellps=clrk66".to_owned()),
                7022 => Some("+ellps=intl".to_owned()),
                7024 => Some("+ellps=krass".to_owned()),
                _ => None,
            },
        }
    }

    /// Returns the unit of heights in metres, `None` if the keys do not name it. The error is the reason. The unit of the
    /// plane (ProjLinearUnits, 3076) does not apply to heights.
    pub(super) fn height_unit_m(&self) -> Result<Option<f64>, String> {
        // VerticalUnits, or the unit of the system in Vertical: EPSG's systems that are not listed are in metres.
        match (self.number(4099), self.number(4096)) {
            (_, Some(system)) if DEPTHS.contains(&system) => {
                Err(format!("GeoTIFF: depths in EPSG:{system}; only heights are supported"))
            }
            (Some(unit), _) => unit_m(unit)
                .map(Some)
                .ok_or_else(|| format!("GeoTIFF: heights in units of EPSG:{unit}, which is not supported")),
            (None, Some(6130..=6132 | 8050 | 8228)) => Ok(Some(FOOT_M)),
            (None, Some(5702 | 6360 | 8052)) => Ok(Some(US_SURVEY_FOOT_M)),
            // The British foot of 1936.
            (None, Some(5754)) => Ok(unit_m(9095)),
            (None, Some(USER_DEFINED)) => Err("GeoTIFF: user-defined heights without a unit".to_owned()),
            (None, Some(_)) => Ok(Some(1.0)),
            (None, None) => self.esri_height_unit_m(),
        }
    }

    /// Returns the unit of heights in the WKT of ArcGIS, `None` without a vertical system. The error is the reason.
    fn esri_height_unit_m(&self) -> Result<Option<f64>, String> {
        let Some((_, system)) = self.esri_wkt().and_then(|wkt| wkt.split_once("VERTCS[")) else { return Ok(None) };
        let after = |key: &str| {
            let (_, rest) = system.rsplit_once(key)?;
            rest.split_once(',')?.1.split(']').next()?.trim().parse::<f64>().ok()
        };
        let direction = system.split_once("\"Direction\",").and_then(|(_, rest)| rest.split(']').next());
        if direction.is_some_and(|direction| direction.trim().starts_with('-')) {
            return Err("GeoTIFF: depths; only heights are supported".to_owned());
        }
        Ok(after("UNIT["))
    }
}
