//! Grids of SAGA: samples in `.sdat`, and a header of lines `NAME = VALUE` in `.sgrd`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::headers::{finite, whole};
use super::samples::Sample;
use super::{Header, Interleave};
use crate::GenError;
use crate::georeference::{GeoTransform, named_unit_m};
use crate::store::{BlockCache, text_of, with_extension};

/// Returns the header beside the samples, and its file. `None` without one.
pub(super) fn header(path: &Path, cache: &Arc<BlockCache>) -> Result<Option<(PathBuf, Header)>, GenError> {
    if !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("sdat")) {
        return Ok(None);
    }
    let beside = with_extension(path, "sgrd");
    let Some(text) = text_of(&beside, cache, |bytes| !bytes.contains(&0))? else { return Ok(None) };
    let header = parse(&text).map_err(|reason| GenError::invalid(&beside, reason))?;
    Ok(Some((beside, header)))
}

/// The error is the reason.
fn parse(text: &str) -> Result<Header, String> {
    let lines = || text.lines().filter_map(|line| line.split_once('='));
    let named = |name: &str| lines().find(|(own, _)| own.trim() == name).map(|(_, value)| value.trim());
    let needed = |name: &str| named(name).ok_or_else(|| format!("no {name} in the header"));
    let number = |name: &str| finite(needed(name)?, name);
    let side = |name: &str| whole(needed(name)?, name).map(|side| side as usize);
    let is_true = |name: &str| named(name).is_some_and(|value| value.eq_ignore_ascii_case("true"));
    let sample = match needed("DATAFORMAT")? {
        "BYTE_UNSIGNED" => Sample::U8,
        "BYTE" => Sample::I8,
        "SHORTINT_UNSIGNED" => Sample::U16,
        "SHORTINT" => Sample::I16,
        "INTEGER_UNSIGNED" => Sample::U32,
        "INTEGER" => Sample::I32,
        "FLOAT" => Sample::F32,
        "DOUBLE" => Sample::F64,
        other => return Err(format!("samples of the format {}", other.escape_debug())),
    };
    let size = [side("CELLCOUNT_X")?, side("CELLCOUNT_Y")?];
    let cell = number("CELLSIZE")?;
    // The position is that of the middle of the south-western cell.
    let [west, south] = [number("POSITION_XMIN")?, number("POSITION_YMIN")?].map(|middle| middle - 0.5 * cell);
    let (origin, down) = match is_true("TOPTOBOTTOM") {
        true => ([west, south + cell * size[1] as f64], -cell),
        false => ([west, south], cell),
    };
    let unit = named("UNIT").unwrap_or_default();
    let unit_m = named_unit_m(unit).ok_or_else(|| format!("heights in units of `{}`", unit.escape_debug()))?;
    let factor = named("Z_FACTOR").map_or(Ok(1.0), |value| finite(value, "Z_FACTOR"))?;
    // A range of values has two numbers.
    let nodata = named("NODATA_VALUE").and_then(|value| value.split(';').next()?.trim().parse().ok());
    Ok(Header {
        size,
        bands: 1,
        sample,
        is_big_endian: is_true("BYTEORDER_BIG"),
        interleave: Interleave::Bands,
        skipped: named("DATAFILE_OFFSET").map_or(Ok(0), |value| whole(value, "DATAFILE_OFFSET"))?,
        row_bytes: None,
        band_bytes: None,
        tile: None,
        nodata,
        unit_m: unit_m * factor,
        offset_m: 0.0,
        transform: GeoTransform { origin, dx: [cell, 0.0], dy: [0.0, down] },
        system: None,
    })
}
