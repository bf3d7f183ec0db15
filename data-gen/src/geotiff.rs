//! GeoTIFF (OGC 19-008): samples by the `tiff` crate, the georeference from the tags.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

use crate::GenError;
use crate::placement::GeoTransform;
use crate::projection::Crs;

/// Most bytes of one decoded image.
const MAX_BYTES: usize = 4 << 30;

/// The value of a GeoKey for what EPSG has no code for.
const USER_DEFINED: u32 = 32767;
/// Values of GTModelType.
const PROJECTED: u32 = 1;
const GEODETIC: u32 = 2;

/// Metres.
const FOOT: f64 = 0.3048;
const US_SURVEY_FOOT: f64 = 1200.0 / 3937.0;

/// EPSG's vertical systems that are positive downwards (dataset 11.022).
const DEPTHS: &[u32] = &[
    5336, 5612, 5614, 5706, 5715, 5734, 5739, 5789, 5831, 5861, 5862, 5863, 5864, 5865, 5866, 5867, 5873, 6357, 6358,
    6359, 7976, 8051, 8053, 8358, 8378, 8897, 9287, 9288, 9672, 10150, 10151, 10349, 10364, 10370, 10371, 10372, 10373,
    10374, 10375, 10376, 10377, 10378, 10379, 10547, 10548, 10549, 10550, 10551, 10552, 10649, 10650, 10678,
];

/// What a TIFF holds: samples, row-major, north row first, channels interleaved.
pub(crate) struct Tiff {
    pub width: usize,
    pub height: usize,
    pub channels: usize,
    pub samples: DecodingResult,
    /// The last channel says what is there of a pixel.
    pub has_alpha: bool,
    pub transform: Option<GeoTransform>,
    pub keys: GeoKeys,
    pub nodata: Option<f64>,
    /// GDAL's word of the samples (tag 42112), XML.
    gdal: String,
}

impl Tiff {
    /// Heights in metres are a sample times the first plus the second. The error is the reason.
    pub fn metres(&self) -> Result<[f64; 2], String> {
        let number = |role: &str, usual: f64| match gdal_item(&self.gdal, role) {
            None => Ok(usual),
            Some(text) => text.parse().ok().filter(|n: &f64| n.is_finite()).ok_or_else(|| format!("{role} `{text}`")),
        };
        let unit = match (self.keys.metres_of_heights()?, gdal_item(&self.gdal, "unittype")) {
            (Some(metres), _) => Ok(metres),
            (None, None | Some("" | "m" | "metre" | "metres" | "meter" | "meters")) => Ok(1.0),
            (None, Some("ft" | "foot" | "feet")) => Ok(FOOT),
            (None, Some("US survey foot" | "US survey feet" | "ftUS" | "us-ft" | "sfoot")) => Ok(US_SURVEY_FOOT),
            (None, Some(other)) => Err(format!("heights in units of `{other}`")),
        };
        let (scale, offset) = (number("scale", 1.0), number("offset", 0.0));
        let not_understood = |what: String| format!("GDAL's metadata: {what}, which is not understood");
        let [scale, offset, unit] = [scale, offset, unit].map(|n| n.map_err(not_understood));
        let unit = unit?;
        Ok([scale? * unit, offset? * unit])
    }
}

/// What GDAL's metadata say of the first band in a role.
fn gdal_item<'a>(xml: &'a str, role: &str) -> Option<&'a str> {
    let items = xml.split("<Item ").skip(1).filter_map(|item| item.split('<').next()?.split_once('>'));
    let mut found = items.filter(|(said, _)| {
        said.contains(&format!("role=\"{role}\"")) && (said.contains("sample=\"0\"") || !said.contains("sample="))
    });
    found.next().map(|(_, value)| value.trim())
}

/// The GeoKeyDirectory, and GeoDoubleParams.
pub(crate) struct GeoKeys(Vec<u16>, Vec<f64>);

impl GeoKeys {
    /// A key whose value is a number of 16 bits; 0 says that there is none.
    fn number(&self, id: u16) -> Option<u32> {
        let mut keys = self.0.chunks_exact(4).skip(1);
        keys.find(|k| k[0] == id && k[1] == 0).map(|k| u32::from(k[3])).filter(|value| *value != 0)
    }

    /// A key whose value is among the GeoDoubleParams.
    fn double(&self, id: u16) -> Option<f64> {
        let mut keys = self.0.chunks_exact(4).skip(1);
        let key = keys.find(|k| k[0] == id && k[1] == 34736)?;
        self.1.get(usize::from(key[3])).copied()
    }

    /// The reference system, `given` where only that it is projected is said; `None` where nothing is. The error is the
    /// reason.
    pub fn crs(&self, given: Option<Crs>) -> Result<Option<Crs>, String> {
        let crs = self.system(given)?;
        // Units and meridian that are said beside a system are its own, or it is another one.
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
                return Err(format!("GeoTIFF: {what} EPSG:{value}, which is not understood"));
            }
        }
        // GeogPrimeMeridianLongitude.
        if let Some(east) = self.double(2061).filter(|east| crs == Some(Crs::Geographic) && *east != 0.0) {
            return Err(format!("GeoTIFF: longitudes from a meridian at {east}, which is not understood"));
        }
        // GeogSemiMajorAxis, where GeogLinearUnits says nothing else than metres.
        match self.double(2057).filter(|axis_m| !(6.3e6..6.5e6).contains(axis_m)) {
            Some(axis_m) if matches!(self.number(2052), None | Some(9001)) => {
                Err(format!("GeoTIFF: an ellipsoid of {axis_m} m is not the earth's"))
            }
            _ => Ok(crs),
        }
    }

    fn system(&self, given: Option<Crs>) -> Result<Option<Crs>, String> {
        // GTModelType, ProjectedCRS, GeodeticCRS: the last is only what the projection is of where there is one.
        let model = self.number(1024);
        let code = self.number(3072).or_else(|| self.number(2048).filter(|_| model != Some(PROJECTED)));
        match (code, model) {
            (Some(code), model) if code != USER_DEFINED => Crs::from_epsg(code)
                // Any geodetic system in degrees from Greenwich is within a few hundred metres of WGS84 at worst.
                .or((model == Some(GEODETIC) && !has_other_meridian(code)).then_some(Crs::Geographic))
                .map(Some)
                .ok_or_else(|| format!("GeoTIFF: EPSG:{code} is not understood")),
            (_, Some(GEODETIC)) => Ok(Some(Crs::Geographic)),
            (None, None) => Ok(None),
            (_, Some(PROJECTED) | None) if given.is_some() => Ok(given),
            (_, Some(PROJECTED) | None) => {
                Err("GeoTIFF: a projection without a code; --epsg CODE names it if it has one".to_owned())
            }
            (_, Some(model)) => Err(format!("GeoTIFF: model type {model} is not understood")),
        }
    }

    /// Metres in a unit of height, `None` where nothing is said of them; those of the raster's plane are another matter
    /// (ProjLinearUnits, 3076). The error is the reason.
    fn metres_of_heights(&self) -> Result<Option<f64>, String> {
        // VerticalUnits, else what the system in Vertical is in: all of EPSG's that are not listed are in metres.
        match (self.number(4099), self.number(4096)) {
            (_, Some(system)) if DEPTHS.contains(&system) => {
                Err(format!("GeoTIFF: depths in EPSG:{system}, where heights are understood"))
            }
            (Some(9001), _) => Ok(Some(1.0)),
            (Some(9002), _) => Ok(Some(FOOT)),
            (Some(9003), _) => Ok(Some(US_SURVEY_FOOT)),
            (Some(unit), _) => Err(format!("GeoTIFF: heights in units of EPSG:{unit}, which is not understood")),
            (None, Some(6130..=6132 | 8050 | 8228)) => Ok(Some(FOOT)),
            (None, Some(5702 | 6360 | 8052)) => Ok(Some(US_SURVEY_FOOT)),
            // Feet of Ireland of 1936.
            (None, Some(5754)) => Err("GeoTIFF: heights in EPSG:5754, which is not understood".to_owned()),
            (None, Some(USER_DEFINED)) => Err("GeoTIFF: user-defined heights without a unit".to_owned()),
            (None, Some(_)) => Ok(Some(1.0)),
            (None, None) => Ok(None),
        }
    }
}

/// EPSG's geographic systems whose longitudes do not count from Greenwich; some of them in grads.
fn has_other_meridian(code: u32) -> bool {
    matches!(code, 4801..=4821 | 4901..=4904 | 5229 | 8042 | 8043)
}

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
        // The decoder would read the first only.
        return Err(GenError::invalid(path, "TIFF with its channels in separate planes; interleave them by pixel"));
    }
    // 1 and 2 are alpha, premultiplied or not; other channels beside the colours are something else.
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
        _ => return Err(GenError::invalid(path, "TIFF: sample format that is not read")),
    };
    if width == 0 || height == 0 || count % (width * height) != 0 || count == 0 {
        return Err(GenError::invalid(path, format!("TIFF: {count} samples for {width} x {height} pixels")));
    }
    let channels = count / (width * height);
    Ok(Tiff { width, height, channels, samples, has_alpha, transform, keys, nodata, gdal })
}

/// The tags ModelPixelScale + ModelTiepoint or ModelTransformation.
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
    // GTRasterType: 1 area (the reference is the pixel's corner), 2 point (its centre).
    if keys.number(1025) == Some(2) {
        transform.origin[0] -= 0.5 * (transform.dx[0] + transform.dy[0]);
        transform.origin[1] -= 0.5 * (transform.dx[1] + transform.dy[1]);
    }
    Some(transform)
}
