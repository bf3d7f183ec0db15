//! Reads GeoTIFF (OGC 19-008): samples with the `tiff` crate, the georeference from the tags.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use super::crs::Crs;
use super::transform::GeoTransform;
use crate::GenError;

/// Largest size of one decoded image.
const MAX_BYTES: usize = 4 << 30;

/// The value of a GeoKey whose system or unit has no EPSG code.
const USER_DEFINED: u32 = 32767;
/// The value of GTModelType for projected coordinates.
const PROJECTED: u32 = 1;
/// The value of GTModelType for longitude and latitude.
const GEODETIC: u32 = 2;

/// The international foot in metres.
const FOOT_M: f64 = 0.3048;
/// The US survey foot in metres.
const US_SURVEY_FOOT_M: f64 = 1200.0 / 3937.0;

/// EPSG codes of vertical systems that are positive downwards (dataset 11.022).
const DEPTHS: &[u32] = &[
    5336, 5612, 5614, 5706, 5715, 5734, 5739, 5789, 5831, 5861, 5862, 5863, 5864, 5865, 5866, 5867, 5873, 6357, 6358,
    6359, 7976, 8051, 8053, 8358, 8378, 8897, 9287, 9288, 9672, 10150, 10151, 10349, 10364, 10370, 10371, 10372, 10373,
    10374, 10375, 10376, 10377, 10378, 10379, 10547, 10548, 10549, 10550, 10551, 10552, 10649, 10650, 10678,
];

/// The content of a TIFF. Samples are row-major, north row first, with interleaved channels.
pub(crate) struct Tiff {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub samples: DecodingResult,
    /// True if the last channel is the opacity.
    pub has_alpha: bool,
    pub transform: Option<GeoTransform>,
    pub keys: GeoKeys,
    pub nodata: Option<f64>,
    /// GDAL's metadata about the samples (tag 42112), XML.
    gdal: String,
}

impl Tiff {
    /// Returns the factor and the offset that convert samples to heights in metres. The error is the reason.
    pub fn factor_and_offset_m(&self) -> Result<[f64; 2], String> {
        let number = |role: &str, usual: f64| match gdal_item(&self.gdal, role) {
            None => Ok(usual),
            Some(text) => text.parse().ok().filter(|n: &f64| n.is_finite()).ok_or_else(|| format!("{role} `{text}`")),
        };
        let unit = match (self.keys.height_unit_m()?, gdal_item(&self.gdal, "unittype")) {
            (Some(metres), _) => Ok(metres),
            (None, None | Some("" | "m" | "metre" | "metres" | "meter" | "meters")) => Ok(1.0),
            (None, Some("ft" | "foot" | "feet")) => Ok(FOOT_M),
            (None, Some("US survey foot" | "US survey feet" | "ftUS" | "us-ft" | "sfoot")) => Ok(US_SURVEY_FOOT_M),
            (None, Some(other)) => Err(format!("heights in units of `{other}`")),
        };
        let (scale, offset) = (number("scale", 1.0), number("offset", 0.0));
        let unsupported = |what: String| format!("GDAL's metadata: {what}, which is not supported");
        let [scale, offset, unit] = [scale, offset, unit].map(|n| n.map_err(unsupported));
        let unit = unit?;
        Ok([scale? * unit, offset? * unit])
    }
}

/// Returns the value of a role ("scale", "offset", "unittype") of the first band in GDAL's metadata.
fn gdal_item<'a>(xml: &'a str, role: &str) -> Option<&'a str> {
    let items = xml.split("<Item ").skip(1).filter_map(|item| item.split('<').next()?.split_once('>'));
    let mut found = items.filter(|(attributes, _)| {
        attributes.contains(&format!("role=\"{role}\""))
            && (attributes.contains("sample=\"0\"") || !attributes.contains("sample="))
    });
    found.next().map(|(_, value)| value.trim())
}

/// The tags GeoKeyDirectory and GeoDoubleParams.
pub(crate) struct GeoKeys(Vec<u16>, Vec<f64>);

impl GeoKeys {
    /// Returns the value of a key with a 16-bit number. 0 means undefined.
    fn number(&self, id: u16) -> Option<u32> {
        let mut keys = self.0.chunks_exact(4).skip(1);
        keys.find(|k| k[0] == id && k[1] == 0).map(|k| u32::from(k[3])).filter(|value| *value != 0)
    }

    /// Returns the value of a key that is stored in GeoDoubleParams.
    fn double(&self, id: u16) -> Option<f64> {
        let mut keys = self.0.chunks_exact(4).skip(1);
        let key = keys.find(|k| k[0] == id && k[1] == 34736)?;
        self.1.get(usize::from(key[3])).copied()
    }

    /// Returns the reference system; `given` if the keys name a projection without a code, `None` if they name no system.
    /// The error is the reason.
    pub fn crs(&self, given: Option<Crs>) -> Result<Option<Crs>, String> {
        let crs = self.system(given)?;
        // Units and a meridian that differ from those of the system make it another system.
        let usual: &[(u16, &str, &[u32])] = match crs {
            // GeogAngularUnits: degrees; GeogPrimeMeridian: Greenwich.
            Some(Crs::Geographic) => {
                &[(2054, "angles in units of", &[9102, 9122]), (2051, "longitudes from the meridian", &[8901])]
            }
            // ProjLinearUnits: metres.
            Some(Crs::WebMercator | Crs::Utm { .. }) => &[(3076, "coordinates in units of", &[9001])],
            None => &[],
        };
        for (key, what, values) in usual {
            if let Some(value) = self.number(*key).filter(|value| !values.contains(value)) {
                return Err(format!("GeoTIFF: {what} EPSG:{value}, which is not supported"));
            }
        }
        // GeogPrimeMeridianLongitude.
        if let Some(east) = self.double(2061).filter(|east| crs == Some(Crs::Geographic) && *east != 0.0) {
            return Err(format!("GeoTIFF: longitudes from a meridian at {east}, which is not supported"));
        }
        // GeogSemiMajorAxis, unless GeogLinearUnits is another unit than the metre.
        match self.double(2057).filter(|axis_m| !(6.3e6..6.5e6).contains(axis_m)) {
            Some(axis_m) if matches!(self.number(2052), None | Some(9001)) => {
                Err(format!("GeoTIFF: an ellipsoid of {axis_m} m is not the earth's"))
            }
            _ => Ok(crs),
        }
    }

    fn system(&self, given: Option<Crs>) -> Result<Option<Crs>, String> {
        // GTModelType, ProjectedCRS and GeodeticCRS. With a projection the last is only its base.
        let model = self.number(1024);
        let code = self.number(3072).or_else(|| self.number(2048).filter(|_| model != Some(PROJECTED)));
        match (code, model) {
            (Some(code), model) if code != USER_DEFINED => Crs::from_epsg(code)
                // Geodetic systems in degrees from Greenwich differ from WGS84 by a few hundred metres at most.
                .or((model == Some(GEODETIC) && !has_other_meridian(code)).then_some(Crs::Geographic))
                .map(Some)
                .ok_or_else(|| format!("GeoTIFF: EPSG:{code} is not supported")),
            (_, Some(GEODETIC)) => Ok(Some(Crs::Geographic)),
            (None, None) => Ok(None),
            (_, Some(PROJECTED) | None) if given.is_some() => Ok(given),
            (_, Some(PROJECTED) | None) => {
                Err("GeoTIFF: a projection without a code; --epsg CODE names it if it has one".to_owned())
            }
            (_, Some(model)) => Err(format!("GeoTIFF: model type {model} is not supported")),
        }
    }

    /// Returns the unit of heights in metres, `None` if the keys do not name it. The error is the reason. The unit of the
    /// plane (ProjLinearUnits, 3076) does not apply to heights.
    fn height_unit_m(&self) -> Result<Option<f64>, String> {
        // VerticalUnits, or the unit of the system in Vertical: EPSG's systems that are not listed are in metres.
        match (self.number(4099), self.number(4096)) {
            (_, Some(system)) if DEPTHS.contains(&system) => {
                Err(format!("GeoTIFF: depths in EPSG:{system}; only heights are supported"))
            }
            (Some(9001), _) => Ok(Some(1.0)),
            (Some(9002), _) => Ok(Some(FOOT_M)),
            (Some(9003), _) => Ok(Some(US_SURVEY_FOOT_M)),
            (Some(unit), _) => Err(format!("GeoTIFF: heights in units of EPSG:{unit}, which is not supported")),
            (None, Some(6130..=6132 | 8050 | 8228)) => Ok(Some(FOOT_M)),
            (None, Some(5702 | 6360 | 8052)) => Ok(Some(US_SURVEY_FOOT_M)),
            // EPSG:5754 uses the British foot of 1936.
            (None, Some(5754)) => Err("GeoTIFF: heights in EPSG:5754, which is not supported".to_owned()),
            (None, Some(USER_DEFINED)) => Err("GeoTIFF: user-defined heights without a unit".to_owned()),
            (None, Some(_)) => Ok(Some(1.0)),
            (None, None) => Ok(None),
        }
    }
}

/// Returns true for EPSG's geographic systems whose longitudes do not start at Greenwich. Some of them use grads.
fn has_other_meridian(code: u32) -> bool {
    matches!(code, 4801..=4821 | 4901..=4904 | 5229 | 8042 | 8043)
}

/// Reads a TIFF whole. Its size is limited to 4 GiB of samples.
pub(crate) fn read(path: &Path) -> Result<Tiff, GenError> {
    let bad = |e: tiff::TiffError| GenError::invalid(path, format!("TIFF: {e}"));
    let file = File::open(path).map_err(GenError::file(path))?;
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_BYTES;
    limits.intermediate_buffer_size = 1 << 30;
    limits.ifd_value_size = 256 << 20;
    let mut decoder = Decoder::new(BufReader::new(file)).map_err(bad)?.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(bad)?;
    let directory = decoder.get_tag_u16_vec(Tag::GeoKeyDirectoryTag).unwrap_or_default();
    let keys = GeoKeys(directory, decoder.get_tag_f64_vec(Tag::GeoDoubleParamsTag).unwrap_or_default());
    let gdal = decoder.get_tag_ascii_string(Tag::Unknown(42112)).unwrap_or_default();
    let transform = transform(&mut decoder, &keys);
    let nodata = decoder
        .get_tag_ascii_string(Tag::GdalNodata)
        .ok()
        .and_then(|t| t.trim_matches(|c: char| c == '\0' || c.is_whitespace()).parse().ok());
    let mut number = |tag| decoder.get_tag_unsigned::<u16>(tag).ok();
    let (planes, channels) = (number(Tag::PlanarConfiguration), number(Tag::SamplesPerPixel));
    if planes == Some(2) && channels.is_some_and(|channels| channels > 1) {
        // The decoder would read the first plane only.
        return Err(GenError::invalid(path, "TIFF with its channels in separate planes; interleave them by pixel"));
    }
    // 1 and 2 are premultiplied and straight alpha. Other extra channels are not opacity.
    let extra = decoder.get_tag_u16_vec(Tag::ExtraSamples).unwrap_or_default();
    let has_alpha = extra.last().is_some_and(|kind| matches!(kind, 1 | 2));
    let samples = decoder.read_image().map_err(bad)?;
    let (width, height) = (width as usize, height as usize);
    let count = match &samples {
        DecodingResult::U8(v) => v.len(),
        DecodingResult::U16(v) => v.len(),
        DecodingResult::U32(v) => v.len(),
        DecodingResult::I8(v) => v.len(),
        DecodingResult::I16(v) => v.len(),
        DecodingResult::I32(v) => v.len(),
        DecodingResult::F32(v) => v.len(),
        DecodingResult::F64(v) => v.len(),
        _ => return Err(GenError::invalid(path, "TIFF: unsupported sample format")),
    };
    if width == 0 || height == 0 || count % (width * height) != 0 || count == 0 {
        return Err(GenError::invalid(path, format!("TIFF: {count} samples for {width} x {height} pixels")));
    }
    let channels = count / (width * height);
    Ok(Tiff { width, height, channels, samples, has_alpha, transform, keys, nodata, gdal })
}

/// Returns the transform in the tags ModelPixelScale and ModelTiepoint, or in ModelTransformation.
fn transform<R: std::io::Read + std::io::Seek>(decoder: &mut Decoder<R>, keys: &GeoKeys) -> Option<GeoTransform> {
    let mut numbers = |tag| decoder.get_tag_f64_vec(tag).ok();
    let scale = numbers(Tag::ModelPixelScaleTag);
    let tie = numbers(Tag::ModelTiepointTag);
    let matrix = numbers(Tag::ModelTransformationTag);
    let mut transform = match (scale.as_deref(), tie.as_deref(), matrix.as_deref()) {
        (Some([sx, sy, ..]), Some([i, j, _, x, y, ..]), _) => {
            GeoTransform { origin: [x - i * sx, y + j * sy], dx: [*sx, 0.0], dy: [0.0, -sy] }
        }
        (_, _, Some(m)) if m.len() >= 8 => GeoTransform { origin: [m[3], m[7]], dx: [m[0], m[4]], dy: [m[1], m[5]] },
        _ => return None,
    };
    // GTRasterType: with 1 (area) the reference is a pixel's corner, with 2 (point) its centre.
    if keys.number(1025) == Some(2) {
        transform.origin[0] -= 0.5 * (transform.dx[0] + transform.dy[0]);
        transform.origin[1] -= 0.5 * (transform.dx[1] + transform.dy[1]);
    }
    Some(transform)
}
