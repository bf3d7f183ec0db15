//! Images of NASA's Planetary Data System, version 3: samples in `.img`, and a label of lines `NAME = VALUE` in `.lbl` or before the
//! samples. Those in cylindrical projections are placed by the longitudes and latitudes of their edges.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::headers::{finite, whole};
use super::samples::Sample;
use super::{Header, Interleave};
use crate::GenError;
use crate::georeference::{GeoTransform, named_unit_m};
use crate::store::{BlockCache, text_of, with_extension};

/// The name of the first value of a label.
const FIRST: &str = "PDS_VERSION_ID";
/// The bytes in which a label begins.
const START_BYTES: usize = 256;
/// The largest difference of a side from what the edges and the resolution say, in samples.
const TOLERANCE: f64 = 0.5;
/// The largest share of the radius by which an offset differs from it, if the samples are distances from the body's middle.
const NEAR_RADIUS: f64 = 0.1;

/// Returns the header beside the samples, and its file. `None` without one.
pub(super) fn header(path: &Path, cache: &Arc<BlockCache>) -> Result<Option<(PathBuf, Header)>, GenError> {
    // A line of another standard may come first.
    let is_label =
        |bytes: &[u8]| bytes[..bytes.len().min(START_BYTES)].windows(FIRST.len()).any(|part| part == FIRST.as_bytes());
    let beside = with_extension(path, "lbl");
    if beside == path {
        return Ok(None);
    }
    let Some(text) = text_of(&beside, cache, is_label)? else { return Ok(None) };
    let header = Label::new(&text).header().map_err(|reason| GenError::invalid(&beside, format!("PDS: {reason}")))?;
    Ok(Some((beside, header)))
}

/// The values of a label: the object that they are in, their names, and their texts.
struct Label<'a>(Vec<(&'a str, &'a str, &'a str)>);

impl<'a> Label<'a> {
    fn new(text: &'a str) -> Self {
        let mut objects = Vec::new();
        let mut values = Vec::new();
        for line in text.lines() {
            let Some((name, value)) = line.split_once('=') else { continue };
            let value = value.split("/*").next().unwrap_or_default();
            let (name, value) = (name.trim(), value.trim().trim_matches('"').trim());
            match name {
                "OBJECT" => objects.push(value),
                "END_OBJECT" => drop(objects.pop()),
                _ => values.push((objects.last().copied().unwrap_or_default(), name, value)),
            }
        }
        Self(values)
    }

    fn text(&self, object: &str, name: &str) -> Option<&'a str> {
        self.0.iter().find(|(own, other, _)| *own == object && *other == name).map(|(_, _, value)| *value)
    }

    /// Returns a number, in the unit that follows it in angular brackets. The error is the reason.
    fn number(&self, object: &str, name: &str) -> Result<Option<f64>, String> {
        let Some(text) = self.text(object, name) else { return Ok(None) };
        let (number, unit) = text.split_once('<').unwrap_or((text, ""));
        let factor = if unit.trim_end_matches('>').trim().eq_ignore_ascii_case("km") { 1000.0 } else { 1.0 };
        finite(number.trim(), name).map(|number| Some(number * factor))
    }

    fn needed(&self, object: &str, name: &str) -> Result<f64, String> {
        self.number(object, name)?.ok_or_else(|| format!("no {name} of the {object} in the label"))
    }

    /// The error is the reason.
    fn header(&self) -> Result<Header, String> {
        let (image, map) = ("IMAGE", "IMAGE_MAP_PROJECTION");
        let count = |name: &str| whole(self.text(image, name).unwrap_or("0"), name).map(|count| count as usize);
        let size = [count("LINE_SAMPLES")?, count("LINES")?];
        let bands = count("BANDS")?.max(1);
        if [count("LINE_PREFIX_BYTES")?, count("LINE_SUFFIX_BYTES")?] != [0, 0] || bands != 1 {
            return Err("lines with more than the samples of one band, which are not supported".to_owned());
        }
        let kind = self.text(image, "SAMPLE_TYPE").unwrap_or_default();
        let bits = count("SAMPLE_BITS")?;
        let is_big_endian = !["LSB_", "PC_", "VAX_"].iter().any(|start| kind.starts_with(start));
        let sample = match bits {
            _ if kind.starts_with("VAX_REAL") => Err(()),
            32 if kind.ends_with("REAL") => Ok(Sample::F32),
            64 if kind.ends_with("REAL") => Ok(Sample::F64),
            8 if kind.contains("UNSIGNED") => Ok(Sample::U8),
            16 if kind.contains("UNSIGNED") => Ok(Sample::U16),
            32 if kind.contains("UNSIGNED") => Ok(Sample::U32),
            8 if kind.ends_with("INTEGER") => Ok(Sample::I8),
            16 if kind.ends_with("INTEGER") => Ok(Sample::I16),
            32 if kind.ends_with("INTEGER") => Ok(Sample::I32),
            _ => Err(()),
        };
        let sample = sample.map_err(|()| format!("samples of {bits} bits {}", kind.escape_debug()))?;
        // A number of a record from 1 on, or of bytes.
        let place = self.text("", "^IMAGE").unwrap_or_default().trim_matches(['(', ')']);
        let place = place.rsplit(',').next().unwrap_or_default().trim().trim_matches('"');
        let (place, is_bytes) = match place.split_once('<') {
            Some((number, unit)) => (number.trim(), unit.to_ascii_uppercase().starts_with("BYTES")),
            None => (place, false),
        };
        let first = place.parse::<u64>().unwrap_or(1).max(1) - 1;
        let record = whole(self.text("", "RECORD_BYTES").unwrap_or("1"), "RECORD_BYTES")?;
        let skipped = first.checked_mul(if is_bytes { 1 } else { record }).ok_or("^IMAGE is beyond the file")?;
        let unit = self.text(image, "UNIT").unwrap_or_default();
        let unit_m = named_unit_m(unit).ok_or_else(|| format!("samples in units of `{}`", unit.escape_debug()))?;
        let factor = self.number(image, "SCALING_FACTOR")?.unwrap_or(1.0) * unit_m;
        let [a, c] = ["A_AXIS_RADIUS", "C_AXIS_RADIUS"].map(|name| self.needed(map, name));
        let (a, c) = (a?, c?);
        let latitudes = self.text(map, "COORDINATE_SYSTEM_NAME").unwrap_or_default();
        if a != c && latitudes.to_ascii_uppercase().contains("CENTRIC") {
            return Err("planetocentric latitudes on an ellipsoid are not supported".to_owned());
        }
        let offset_m = self.number(image, "OFFSET")?.unwrap_or(0.0) * unit_m;
        // Distances from the middle of a sphere become heights above it.
        let is_radius = (offset_m - a).abs() < NEAR_RADIUS * a;
        let offset_m = if is_radius { offset_m - a } else { offset_m };
        Ok(Header {
            size,
            bands,
            sample,
            is_big_endian,
            interleave: Interleave::Bands,
            skipped,
            row_bytes: None,
            band_bytes: None,
            tile: None,
            nodata: self.text(image, "MISSING_CONSTANT").and_then(|text| text.parse().ok()),
            unit_m: factor,
            offset_m,
            transform: self.transform(map, size)?,
            system: Some(format!("+proj=longlat +a={a} +b={c}")),
        })
    }

    /// Returns the place of an image over longitudes and latitudes. The error is the reason.
    fn transform(&self, map: &str, size: [usize; 2]) -> Result<GeoTransform, String> {
        let kind = self.text(map, "MAP_PROJECTION_TYPE").unwrap_or_default().to_ascii_uppercase();
        if self
            .text(map, "POSITIVE_LONGITUDE_DIRECTION")
            .is_some_and(|direction| direction.eq_ignore_ascii_case("WEST"))
        {
            return Err("longitudes to the west, which are not supported".to_owned());
        }
        let is_equator = self.number(map, "CENTER_LATITUDE")?.unwrap_or(0.0) == 0.0;
        if !(kind == "SIMPLE CYLINDRICAL" || kind == "EQUIRECTANGULAR" && is_equator) {
            return Err(format!("the projection `{}`; gdal_translate writes it as GeoTIFF", kind.escape_debug()));
        }
        let [west, east] = ["WESTERNMOST_LONGITUDE", "EASTERNMOST_LONGITUDE"].map(|name| self.needed(map, name));
        let [south, north] = ["MINIMUM_LATITUDE", "MAXIMUM_LATITUDE"].map(|name| self.needed(map, name));
        let (west, mut east, south, north) = (west?, east?, south?, north?);
        if east <= west {
            east += 360.0;
        }
        let resolution = self.needed(map, "MAP_RESOLUTION")?;
        let sides = [(east - west) * resolution, (north - south) * resolution];
        if (0..2).any(|axis| (sides[axis] - size[axis] as f64).abs() > TOLERANCE) {
            let [width, height] = size;
            return Err(format!("{width} x {height} samples, and its edges have room for {} x {}", sides[0], sides[1]));
        }
        let [dx, dy] = [(east - west) / size[0] as f64, (north - south) / size[1] as f64];
        Ok(GeoTransform { origin: [west, north], dx: [dx, 0.0], dy: [0.0, -dy] })
    }
}
