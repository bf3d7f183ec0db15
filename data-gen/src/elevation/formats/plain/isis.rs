//! Cubes of ISIS, version 3 (USGS): a label in text of objects, groups and lines `NAME = VALUE`, and the samples behind it, in rows
//! or in tiles. The thread that opens a file reads the label.

use std::path::Path;
use std::sync::Arc;

use super::headers::{finite, whole};
use super::planetary::PlanetaryMap;
use super::samples::Sample;
use super::{Header, Interleave, MAX_BLOCK, open_with};
use crate::GenError;
use crate::elevation::formats::{Opened, RasterOptions};
use crate::store::BlockCache;

/// The first bytes of a cube.
const MAGIC: &[u8] = b"Object =";
/// The largest label.
const MAX_LABEL_BYTES: u64 = 4 << 20;

/// Returns true for the first bytes of a cube.
pub(in crate::elevation::formats) fn is_isis(magic: &[u8]) -> bool {
    magic.starts_with(MAGIC)
}

/// Opens a cube and reads its label.
pub(in crate::elevation::formats) fn open(
    path: &Path,
    options: &RasterOptions,
    cache: &Arc<BlockCache>,
) -> Result<Opened, GenError> {
    use std::io::Read as _;
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    let mut bytes = Vec::new();
    file.take(MAX_LABEL_BYTES).read_to_end(&mut bytes).map_err(GenError::file(path))?;
    let header = header(&bytes).map_err(|reason| GenError::invalid(path, format!("ISIS cube: {reason}")))?;
    open_with(path, path, header, options, cache)
}

/// The lines of a label: the innermost object or group that they are in, their names, and their texts.
struct Label<'a>(Vec<(&'a str, &'a str, &'a str)>);

impl<'a> Label<'a> {
    fn new(text: &'a str) -> Self {
        let (mut inside, mut lines) = (Vec::new(), Vec::new());
        for line in text.lines() {
            let line = line.trim();
            match line {
                "End" => break,
                "End_Object" | "End_Group" => drop(inside.pop()),
                _ => {}
            }
            let Some((name, value)) = line.split_once('=') else { continue };
            let (name, value) = (name.trim(), value.trim().trim_matches('"'));
            match name {
                "Object" | "Group" => inside.push(value),
                _ => lines.push((inside.last().copied().unwrap_or_default(), name, value)),
            }
        }
        Self(lines)
    }

    fn text(&self, inside: &str, name: &str) -> Option<&'a str> {
        self.0.iter().find(|(own, other, _)| *own == inside && *other == name).map(|(_, _, value)| *value)
    }

    fn needed(&self, inside: &str, name: &str) -> Result<&'a str, String> {
        self.text(inside, name).ok_or_else(|| format!("no {name} of {inside} in the label"))
    }

    fn count(&self, inside: &str, name: &str) -> Result<u64, String> {
        whole(self.needed(inside, name)?, name)
    }

    /// Returns a number in metres or degrees; a unit follows it in angular brackets. The error is the reason.
    fn number(&self, inside: &str, name: &str) -> Result<f64, String> {
        let (number, unit) = self.needed(inside, name)?.split_once('<').unwrap_or((self.needed(inside, name)?, ""));
        let factor = match unit.trim_end_matches('>').trim().to_ascii_lowercase().as_str() {
            "" | "m" | "meters" | "meters/pixel" | "degrees" => 1.0,
            "km" | "kilometers" | "kilometers/pixel" | "km/pixel" => 1000.0,
            other => return Err(format!("{name} in `{}`", other.escape_debug())),
        };
        finite(number.trim(), name).map(|number| number * factor)
    }
}

/// Reads a label. The error is the reason.
fn header(bytes: &[u8]) -> Result<Header, String> {
    // The samples follow, which are no text.
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    let text = String::from_utf8_lossy(&bytes[..end]);
    let label = Label::new(&text);
    let (core, map) = ("Core", "Mapping");
    if label.text(core, "^Core").is_some() {
        return Err("samples in another file, which are not supported; gdal_translate writes it as GeoTIFF".to_owned());
    }
    let dimensions = |name: &str| label.count("Dimensions", name).map(|count| count as usize);
    let (sample, nodata) = match label.needed("Pixels", "Type")? {
        "UnsignedByte" => (Sample::U8, Some(0.0)),
        "UnsignedWord" => (Sample::U16, Some(0.0)),
        "SignedWord" => (Sample::I16, Some(-32768.0)),
        "UnsignedInteger" => (Sample::U32, None),
        "SignedInteger" => (Sample::I32, None),
        // Its values without data are larger than heights.
        "Real" => (Sample::F32, None),
        "Double" => (Sample::F64, None),
        other => return Err(format!("samples of the type `{}`", other.escape_debug())),
    };
    let tile = match label.needed(core, "Format")? {
        "BandSequential" => None,
        "Tile" => {
            let sides = [label.count(core, "TileSamples")?, label.count(core, "TileLines")?];
            let is_sane = sides[0] > 0 && sides[1] > 0 && sides[0].saturating_mul(sides[1]) <= MAX_BLOCK as u64;
            Some(sides.map(|side| side as usize))
                .filter(|_| is_sane)
                .ok_or("tiles of a size that is not supported")?
                .into()
        }
        other => return Err(format!("samples in the order `{}`", other.escape_debug())),
    };
    let mapping = PlanetaryMap {
        projection: label.needed(map, "ProjectionName").map_err(|_| "no georeference".to_owned())?,
        radii_m: [label.number(map, "EquatorialRadius")?, label.number(map, "PolarRadius")?],
        is_planetocentric: label
            .text(map, "LatitudeType")
            .is_none_or(|kind| kind.eq_ignore_ascii_case("Planetocentric")),
        is_west: label.text(map, "LongitudeDirection").is_some_and(|kind| kind.eq_ignore_ascii_case("PositiveWest")),
        center: [label.number(map, "CenterLongitude")?, label.number(map, "CenterLatitude")?],
        true_latitude: label.number(map, "CenterLatitude")?,
        scale: label.number(map, "scaleFactor").unwrap_or(1.0),
        corner_m: [label.number(map, "UpperLeftCornerX")?, label.number(map, "UpperLeftCornerY")?],
        pixel_m: [label.number(map, "PixelResolution")?; 2],
    };
    Ok(Header {
        size: [dimensions("Samples")?, dimensions("Lines")?],
        bands: dimensions("Bands")?,
        sample,
        is_big_endian: label.text("Pixels", "ByteOrder").is_some_and(|order| order.eq_ignore_ascii_case("Msb")),
        interleave: Interleave::Bands,
        skipped: label.count(core, "StartByte")?.max(1) - 1,
        row_bytes: None,
        band_bytes: None,
        tile,
        nodata,
        unit_m: label.number("Pixels", "Multiplier").unwrap_or(1.0),
        offset_m: label.number("Pixels", "Base").unwrap_or(0.0),
        transform: mapping.transform()?,
        system: Some(mapping.system()?),
    })
}
