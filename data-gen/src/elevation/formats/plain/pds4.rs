//! Images of NASA's Planetary Data System, version 4: plain samples, and a label in XML beside them (`.xml`) with the
//! cartography, which the thread that opens a file reads.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use roxmltree::{Document, Node, ParsingOptions};

use super::headers::{finite, whole};
use super::planetary::PlanetaryMap;
use super::samples::Sample;
use super::{Header, Interleave};
use crate::GenError;
use crate::georeference::named_unit_m;
use crate::store::{BlockCache, text_of, with_extension};

/// The root of a label.
const ROOT: &str = "Product_Observational";
/// The bytes in which the root begins.
const START_BYTES: usize = 4096;
/// The largest number of nodes in a label.
const MAX_NODES: u32 = 1 << 16;

/// Returns the header beside the samples, and its file. `None` without one.
pub(super) fn header(path: &Path, cache: &Arc<BlockCache>) -> Result<Option<(PathBuf, Header)>, GenError> {
    let is_label =
        |bytes: &[u8]| bytes[..bytes.len().min(START_BYTES)].windows(ROOT.len()).any(|part| part == ROOT.as_bytes());
    let beside = with_extension(path, "xml");
    if beside == path {
        return Ok(None);
    }
    let Some(text) = text_of(&beside, cache, is_label)? else { return Ok(None) };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let header = parse(&text, &name).map_err(|reason| GenError::invalid(&beside, format!("PDS4: {reason}")))?;
    Ok(Some((beside, header)))
}

/// Returns the first element of a name below another.
fn below<'a, 'b>(node: Node<'a, 'b>, name: &str) -> Option<Node<'a, 'b>> {
    node.descendants().find(|node| node.is_element() && node.tag_name().name() == name)
}

fn text<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    below(node, name).and_then(|node| node.text()).map(str::trim)
}

/// Returns a number in metres or degrees below an element. The error is the reason.
fn number(node: Node<'_, '_>, name: &str) -> Result<Option<f64>, String> {
    let Some(found) = below(node, name) else { return Ok(None) };
    let factor = match found.attribute("unit").unwrap_or_default() {
        "" | "m" | "m/pixel" | "deg" => 1.0,
        "km" | "km/pixel" => 1000.0,
        other => return Err(format!("{name} in `{}`", other.escape_debug())),
    };
    finite(found.text().unwrap_or_default().trim(), name).map(|number| Some(number * factor))
}

fn needed(node: Node<'_, '_>, name: &str) -> Result<f64, String> {
    number(node, name)?.ok_or_else(|| format!("no {name} in the label"))
}

/// Reads the label of a file of samples. The error is the reason.
fn parse(label: &str, file: &str) -> Result<Header, String> {
    let options = ParsingOptions { allow_dtd: false, nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(label, options).map_err(|e| e.to_string())?;
    let root = document.root_element();
    let mut areas = root.descendants().filter(|node| node.tag_name().name() == "File_Area_Observational");
    let area = areas.find(|area| text(*area, "file_name").is_some_and(|name| name.eq_ignore_ascii_case(file)));
    let area = area.ok_or_else(|| format!("no file `{}` in the label", file.escape_debug()))?;
    let arrays = ["Array_2D_Image", "Array_3D_Image", "Array_2D_Map", "Array_2D", "Array_3D", "Array"];
    let array = arrays.iter().find_map(|name| below(area, name)).ok_or("no array of samples in the label")?;
    if text(array, "axis_index_order").is_some_and(|order| order != "Last Index Fastest") {
        return Err("samples in another order than rows".to_owned());
    }
    let mut sides = [1u64; 3];
    let axes = array.children().filter(|node| node.tag_name().name() == "Axis_Array");
    let mut last = "";
    for axis in axes {
        let count = whole(text(axis, "elements").unwrap_or_default(), "elements")?;
        last = text(axis, "axis_name").unwrap_or_default();
        match last {
            "Sample" => sides[0] = count,
            "Line" => sides[1] = count,
            "Band" => sides[2] = count,
            other => return Err(format!("an axis `{}`", other.escape_debug())),
        }
    }
    if last != "Sample" || sides[2] != 1 {
        return Err(format!("{} bands, or samples in another order than rows, which are not supported", sides[2]));
    }
    if text(root, "vertical_display_direction").is_some_and(|direction| direction == "Bottom to Top") {
        return Err("rows from the bottom to the top, which are not supported".to_owned());
    }
    let element = below(array, "Element_Array").ok_or("no Element_Array in the label")?;
    let kind = text(element, "data_type").unwrap_or_default();
    let sample = match kind.replace("LSB", "").replace("MSB", "").as_str() {
        "UnsignedByte" => Sample::U8,
        "SignedByte" => Sample::I8,
        "Unsigned2" => Sample::U16,
        "Signed2" => Sample::I16,
        "Unsigned4" => Sample::U32,
        "Signed4" => Sample::I32,
        "IEEE754Single" => Sample::F32,
        "IEEE754Double" => Sample::F64,
        _ => return Err(format!("samples of the type `{}`", kind.escape_debug())),
    };
    let unit = text(element, "unit").unwrap_or_default();
    let unit_m = named_unit_m(unit).ok_or_else(|| format!("samples in units of `{}`", unit.escape_debug()))?;
    let missing = below(array, "Special_Constants").and_then(|constants| text(constants, "missing_constant"));
    let map = map(root)?;
    Ok(Header {
        size: [sides[0] as usize, sides[1] as usize],
        bands: 1,
        sample,
        is_big_endian: kind.contains("MSB"),
        interleave: Interleave::Bands,
        skipped: whole(text(array, "offset").unwrap_or("0"), "offset")?,
        row_bytes: None,
        band_bytes: None,
        tile: None,
        nodata: missing.and_then(|text| text.parse().ok()),
        unit_m: number(element, "scaling_factor")?.unwrap_or(1.0) * unit_m,
        offset_m: number(element, "value_offset")?.unwrap_or(0.0) * unit_m,
        transform: map.transform()?,
        system: Some(map.system()?),
    })
}

/// Reads the cartography of a label. The error is the reason.
fn map<'a>(root: Node<'a, '_>) -> Result<PlanetaryMap<'a>, String> {
    let map = below(root, "Cartography").ok_or("no georeference")?;
    let is = |name: &str, value: &str| text(map, name).is_some_and(|text| text.eq_ignore_ascii_case(value));
    let at = |name: &str| number(map, name).map(|number| number.unwrap_or(0.0));
    let latitude = at("latitude_of_projection_origin")?;
    let true_latitude = number(map, "standard_parallel_1")?.unwrap_or(latitude);
    Ok(PlanetaryMap {
        projection: text(map, "map_projection_name").ok_or("no map projection in the label")?,
        radii_m: [needed(map, "a_axis_radius")?, needed(map, "c_axis_radius")?],
        is_planetocentric: is("latitude_type", "Planetocentric"),
        is_west: is("longitude_direction", "Positive West"),
        center: [at("longitude_of_central_meridian")?, latitude],
        true_latitude,
        scale: number(map, "scale_factor_at_projection_origin")?.unwrap_or(1.0),
        corner_m: [needed(map, "upperleft_corner_x")?, needed(map, "upperleft_corner_y")?],
        pixel_m: [needed(map, "pixel_resolution_x")?, needed(map, "pixel_resolution_y")?],
    })
}
