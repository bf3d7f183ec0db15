//! Conversion to 3D Tiles 1.1: what is read and what is written hold the same.

mod crop;
mod kinds;
mod levels;

use std::path::Path;

use serde_json::Value;
use terrane::fetch::Limits;
use terrane::formats::{ConvertOptions, Converted, convert, verify};

/// Converts a set. What is written can be read whole.
fn converted(source: &Path, out: &Path) -> Converted {
    converted_with(source, out, &ConvertOptions::default())
}

fn converted_with(source: &Path, out: &Path, options: &ConvertOptions) -> Converted {
    let converted = convert(source.to_str().unwrap(), out, options, &mut |_| {}).unwrap();
    assert_eq!(converted.source, converted.written, "{:?}", converted.errors);
    let verified = verify(out.to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.failed, verified.contents), (0, converted.source.contents()), "{:?}", verified.errors);
    converted
}

/// Returns the tileset of a folder.
fn tileset(folder: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(folder.join("tileset.json")).unwrap()).unwrap()
}

/// Returns the JSON of the glb that a tile refers to.
fn glb_json(folder: &Path, tile: &Value) -> Value {
    let bytes = std::fs::read(folder.join(tile["content"]["uri"].as_str().unwrap())).unwrap();
    let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&bytes[20..20 + length]).unwrap()
}
