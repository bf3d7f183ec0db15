//! Headers in text files beside the samples (`.hdr`): those of ESRI and the USGS (`.bil`, `.bip`, `.bsq`, `.flt`, GTOPO30's `.dem`)
//! and of ENVI.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::samples::Sample;
use super::{Header, Interleave};
use crate::GenError;
use crate::georeference::GeoTransform;
use crate::store::{BlockCache, text_of, with_extension, with_more};

/// Returns the header beside a raster, and its file: with its extension replaced, or with one more.
pub(super) fn header(path: &Path, cache: &Arc<BlockCache>) -> Result<Option<(PathBuf, Header)>, GenError> {
    let is_header = |bytes: &[u8]| {
        let text = String::from_utf8_lossy(bytes).to_ascii_lowercase();
        text.trim_start().starts_with("envi") || text.contains("nrows")
    };
    for beside in [with_extension(path, "hdr"), with_more(path, "hdr")] {
        if beside != path
            && let Some(text) = text_of(&beside, cache, is_header)?
        {
            let header = Header::parse(&text, path).map_err(|reason| GenError::invalid(&beside, reason))?;
            return Ok(Some((beside, header)));
        }
    }
    Ok(None)
}

impl Header {
    /// Reads the text of a header. The error is the reason.
    fn parse(text: &str, raster: &Path) -> Result<Self, String> {
        match text.trim_start().starts_with("ENVI") {
            true => Self::of_envi(text),
            false => Self::of_esri(text, raster),
        }
    }

    /// Reads a header of lines with a name and a value.
    fn of_esri(text: &str, raster: &Path) -> Result<Self, String> {
        let entries: Vec<(String, &str)> = text
            .lines()
            .filter_map(|line| line.trim().split_once(char::is_whitespace))
            .map(|(name, value)| (name.to_ascii_lowercase(), value.split_whitespace().next().unwrap_or_default()))
            .collect();
        let named = |name: &str| entries.iter().find(|(own, _)| own == name).map(|(_, value)| *value);
        let number = |name: &str| named(name).map(|value| finite(value, name)).transpose();
        let whole = |name: &str| named(name).map(|value| whole(value, name)).transpose();
        let needed = |name: &str| whole(name)?.ok_or_else(|| format!("no {name} in the header"));
        let size = [needed("ncols")?, needed("nrows")?].map(|side| side as usize);
        let bands = whole("nbands")?.unwrap_or(1) as usize;
        let is_float = raster.extension().is_some_and(|e| e.eq_ignore_ascii_case("flt"));
        let bits = whole("nbits")?.unwrap_or(if is_float { 32 } else { 8 });
        let kind = named("pixeltype").map(str::to_ascii_lowercase);
        let kind = kind.as_deref().unwrap_or(if is_float { "float" } else { "" });
        let is_unsigned = kind.starts_with('u');
        let sample = match (bits, kind) {
            (32, kind) if kind.starts_with('f') => Sample::F32,
            (64, kind) if kind.starts_with('f') => Sample::F64,
            (8, kind) if kind.starts_with('s') => Sample::I8,
            (8, _) => Sample::U8,
            (16, _) => {
                if is_unsigned {
                    Sample::U16
                } else {
                    Sample::I16
                }
            }
            (32, _) => {
                if is_unsigned {
                    Sample::U32
                } else {
                    Sample::I32
                }
            }
            (bits, kind) => return Err(format!("samples of {bits} bits {kind}")),
        };
        let order = named("byteorder").unwrap_or("I").to_ascii_uppercase();
        let interleave = match named("layout").unwrap_or("BIL").to_ascii_uppercase().as_str() {
            "BIL" => Interleave::Lines,
            "BIP" => Interleave::Pixels,
            "BSQ" => Interleave::Bands,
            other => return Err(format!("its layout is `{other}`")),
        };
        let row = size[0] as u64 * sample.bytes();
        let (row_bytes, band_bytes) = match interleave {
            Interleave::Lines => (whole("totalrowbytes")?, whole("bandrowbytes")?),
            Interleave::Pixels => (whole("totalrowbytes")?, None),
            Interleave::Bands => {
                let own = whole("bandrowbytes")?.unwrap_or(row);
                let gap = whole("bandgapbytes")?.unwrap_or(0);
                (Some(own), own.checked_mul(size[1] as u64).and_then(|bytes| bytes.checked_add(gap)))
            }
        };
        let cell = number("cellsize")?;
        let step = |name: &str| Ok(cell.or(number(name)?).unwrap_or(1.0)) as Result<f64, String>;
        let (dx, dy) = (step("xdim")?, step("ydim")?);
        // The map coordinates are those of the centre of the north-western pixel; corners are those in the south-west.
        let place = |names: [&str; 3], step: f64, below: f64| {
            let [upper, corner, center] = [number(names[0])?, number(names[1])?, number(names[2])?];
            let upper = upper.map(|center| center - 0.5 * step);
            let found = upper.or(corner.map(|edge| edge + below)).or(center.map(|at| at - 0.5 * step.abs() + below));
            found.ok_or_else(|| format!("neither {} nor {} in the header", names[0], names[1]))
        };
        let west = place(["ulxmap", "xllcorner", "xllcenter"], dx, 0.0)?;
        let north = place(["ulymap", "yllcorner", "yllcenter"], -dy, dy * size[1] as f64)?;
        Ok(Self {
            size,
            bands,
            sample,
            is_big_endian: order.starts_with('M'),
            interleave,
            skipped: whole("skipbytes")?.unwrap_or(0),
            row_bytes,
            band_bytes,
            tile: None,
            nodata: number("nodata")?.or(number("nodata_value")?),
            unit_m: 1.0,
            offset_m: 0.0,
            transform: GeoTransform { origin: [west, north], dx: [dx, 0.0], dy: [0.0, -dy] },
            system: None,
        })
    }

    /// Reads a header of ENVI: `name = value`, where braces may hold several values and lines.
    fn of_envi(text: &str) -> Result<Self, String> {
        let entries = envi_entries(text);
        let named = |name: &str| entries.iter().find(|(own, _)| own == name).map(|(_, value)| value.as_str());
        let number = |name: &str| named(name).map(|value| finite(value, name)).transpose();
        let whole = |name: &str| named(name).map(|value| whole(value, name)).transpose();
        let needed = |name: &str| whole(name)?.ok_or_else(|| format!("no `{name}` in the header"));
        let sample = match needed("data type")? {
            1 => Sample::U8,
            2 => Sample::I16,
            3 => Sample::I32,
            4 => Sample::F32,
            5 => Sample::F64,
            12 => Sample::U16,
            13 => Sample::U32,
            other => return Err(format!("its data type is {other}")),
        };
        let interleave = match named("interleave").unwrap_or("bsq").to_ascii_lowercase().as_str() {
            "bil" => Interleave::Lines,
            "bip" => Interleave::Pixels,
            "bsq" => Interleave::Bands,
            other => return Err(format!("its interleave is `{other}`")),
        };
        let map: Vec<&str> =
            named("map info").ok_or("no `map info` in the header")?.split(',').map(str::trim).collect();
        if map.iter().any(|part| part.strip_prefix("rotation=").is_some_and(|angle| angle.parse() != Ok(0.0))) {
            return Err("a rotated map, which is not supported".to_owned());
        }
        let at = |k: usize| finite(map.get(k).copied().unwrap_or_default(), "map info");
        let (dx, dy) = (at(5)?, at(6)?);
        let origin = [at(3)? - (at(1)? - 1.0) * dx, at(4)? + (at(2)? - 1.0) * dy];
        let utm = || {
            let zone: u32 = map.get(7)?.parse().ok().filter(|zone| (1..=60).contains(zone))?;
            let is_wgs84 = map.get(9).is_some_and(|datum| datum.replace(['-', ' '], "").eq_ignore_ascii_case("WGS84"));
            let first = if map.get(8)?.eq_ignore_ascii_case("North") { 32600 } else { 32700 };
            is_wgs84.then(|| format!("EPSG:{}", first + zone))
        };
        let system = named("coordinate system string").filter(|wkt| !wkt.is_empty()).map(str::to_owned);
        let system = system.or_else(|| if map[0].eq_ignore_ascii_case("UTM") { utm() } else { None });
        Ok(Self {
            size: [needed("samples")? as usize, needed("lines")? as usize],
            bands: whole("bands")?.unwrap_or(1) as usize,
            sample,
            is_big_endian: whole("byte order")? == Some(1),
            interleave,
            skipped: whole("header offset")?.unwrap_or(0),
            row_bytes: None,
            band_bytes: None,
            tile: None,
            nodata: number("data ignore value")?,
            unit_m: 1.0,
            offset_m: 0.0,
            transform: GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] },
            system,
        })
    }
}

/// Reads a finite number. The error is the reason.
pub(super) fn finite(text: &str, name: &str) -> Result<f64, String> {
    text.parse().ok().filter(|n: &f64| n.is_finite()).ok_or_else(|| format!("{name} is `{}`", text.escape_debug()))
}

/// Reads a whole number of at most 15 digits. The error is the reason.
pub(super) fn whole(text: &str, name: &str) -> Result<u64, String> {
    let number = finite(text, name)?;
    let is_whole = number.fract() == 0.0 && (0.0..1e15).contains(&number);
    if is_whole { Ok(number as u64) } else { Err(format!("{name} is {number}")) }
}

/// Returns the names and values of a header of ENVI, without braces.
fn envi_entries(text: &str) -> Vec<(String, String)> {
    let mut entries = Vec::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let Some((name, value)) = line.split_once('=') else { continue };
        let mut value = value.trim().to_owned();
        if value.starts_with('{') {
            while !value.contains('}')
                && let Some(line) = lines.next()
            {
                value.push(' ');
                value.push_str(line.trim());
            }
            value = value.trim_start_matches('{').split('}').next().unwrap_or_default().trim().to_owned();
        }
        entries.push((name.trim().to_ascii_lowercase(), value));
    }
    entries
}
