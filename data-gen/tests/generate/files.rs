//! Writes small input files for the tests, and reads finished sets.

use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::Path;

use serde_json::Value;
use terrane_data_gen::GenArgs;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::{ColorType, Gray16, Gray32Float, GrayI16};
use tiff::tags::Tag;

/// The number of samples along a side of the elevation files.
pub const SIDE: u32 = 40;

/// The georeference of a GeoTIFF in EPSG:4326, in degrees.
#[derive(Clone, Copy)]
pub struct Place {
    /// The column and row of the tie point.
    pub tie_px: [f64; 2],
    /// The longitude and latitude of the tie point.
    pub tie_deg: [f64; 2],
    pub pixel_deg: [f64; 2],
    /// False if samples are areas around pixel centres, true if they are points, the first at the tie point.
    pub point: bool,
}

pub const PLACE: Place = Place { tie_px: [0.0; 2], tie_deg: [7.5, 46.5], pixel_deg: [0.001, 0.0008], point: false };

impl Place {
    /// Returns west, south, east and north of the outermost samples in radians.
    pub fn bounds(&self) -> [f64; 4] {
        let half = if self.point { 0.0 } else { 0.5 };
        let last = f64::from(SIDE - 1);
        let longitude = |column: f64| self.tie_deg[0] + (column + half - self.tie_px[0]) * self.pixel_deg[0];
        let latitude = |row: f64| self.tie_deg[1] - (row + half - self.tie_px[1]) * self.pixel_deg[1];
        [longitude(0.0), latitude(last), longitude(last), latitude(0.0)].map(f64::to_radians)
    }
}

fn encode<C: ColorType>(samples: &[C::Inner], place: Option<Place>, nodata: Option<&str>) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    encode_keyed::<C>(samples, place, &[(42113, nodata.unwrap_or_default())], &[])
}

/// Encodes a TIFF with text tags and additional GeoKeys, each an id and its value.
fn encode_keyed<C: ColorType>(
    samples: &[C::Inner],
    place: Option<Place>,
    texts: &[(u16, &str)],
    more: &[[u16; 2]],
) -> Vec<u8>
where
    [C::Inner]: tiff::encoder::TiffValue,
{
    let mut bytes = Cursor::new(Vec::new());
    let mut tiff = TiffEncoder::new(&mut bytes).unwrap();
    let mut image = tiff.new_image::<C>(SIDE, SIDE).unwrap();
    if let Some(p) = place {
        let scale = [p.pixel_deg[0], p.pixel_deg[1], 0.0];
        let tie = [p.tie_px[0], p.tie_px[1], 0.0, p.tie_deg[0], p.tie_deg[1], 0.0];
        let raster_type = if p.point { 2 } else { 1 };
        let keys = geo_keys(&[&[[1024, 2], [1025, raster_type], [2048, 4326]], more].concat());
        image.encoder().write_tag(Tag::ModelPixelScaleTag, &scale[..]).unwrap();
        image.encoder().write_tag(Tag::ModelTiepointTag, &tie[..]).unwrap();
        image.encoder().write_tag(Tag::GeoKeyDirectoryTag, &keys[..]).unwrap();
    } else if !more.is_empty() {
        image.encoder().write_tag(Tag::GeoKeyDirectoryTag, &geo_keys(more)[..]).unwrap();
    }
    for (tag, text) in texts.iter().filter(|(_, text)| !text.is_empty()) {
        image.encoder().write_tag(Tag::from_u16_exhaustive(*tag), *text).unwrap();
    }
    image.encoder().write_tag(Tag::GeoDoubleParamsTag, &DOUBLES[..]).unwrap();
    image.write_data(samples).unwrap();
    bytes.into_inner()
}

/// Values of GeoDoubleParams: semi-major axes of Clarke's earth and of the moon in metres, and the longitudes of Paris
/// and Greenwich in degrees.
pub const DOUBLES: [f64; 4] = [6_378_206.4, 1_737_400.0, 2.337, 0.0];

/// Returns a GeoKeyDirectory of ids and values. Semi-major axes and meridian longitudes are indices into [`DOUBLES`].
pub fn geo_keys(keys: &[[u16; 2]]) -> Vec<u16> {
    let entries =
        keys.iter().flat_map(|[id, value]| [*id, if matches!(id, 2057 | 2061) { 34736 } else { 0 }, 1, *value]);
    [1, 1, 0, keys.len() as u16].into_iter().chain(entries).collect()
}

/// Returns the heights of a slope with a bump, in whole metres from 200 to about 900.
pub fn heights() -> Vec<f32> {
    let n = SIDE as i32;
    (0..n * n)
        .map(|k| {
            let (i, j) = (k % n, k / n);
            (200 + 5 * i + 9 * j + ((i * j * 7) % 61)) as f32
        })
        .collect()
}

pub fn tiff_int16(heights: &[f32], place: Option<Place>, nodata: Option<&str>) -> Vec<u8> {
    let samples: Vec<i16> = heights.iter().map(|h| *h as i16).collect();
    encode::<GrayI16>(&samples, place, nodata)
}

/// Like [`tiff_int16`], with additional GeoKeys, each an id and its value.
pub fn tiff_int16_keyed(heights: &[f32], place: Option<Place>, more: &[[u16; 2]]) -> Vec<u8> {
    let samples: Vec<i16> = heights.iter().map(|h| *h as i16).collect();
    encode_keyed::<GrayI16>(&samples, place, &[], more)
}

/// Like [`tiff_int16_keyed`], with GDAL's metadata about the samples and a value for missing data.
pub fn tiff_int16_with_metadata(heights: &[f32], metadata: &str, nodata: &str, more: &[[u16; 2]]) -> Vec<u8> {
    let samples: Vec<i16> = heights.iter().map(|h| *h as i16).collect();
    encode_keyed::<GrayI16>(&samples, Some(PLACE), &[(42112, metadata), (42113, nodata)], more)
}

pub fn tiff_uint16(heights: &[f32], place: Option<Place>, nodata: Option<&str>) -> Vec<u8> {
    let samples: Vec<u16> = heights.iter().map(|h| *h as u16).collect();
    encode::<Gray16>(&samples, place, nodata)
}

pub fn tiff_float32(heights: &[f32], place: Option<Place>, nodata: Option<&str>) -> Vec<u8> {
    encode::<Gray32Float>(heights, place, nodata)
}

/// Sets the first value of a tag in a little-endian classic TIFF.
pub fn set_tag(tiff: &mut [u8], tag: u16, value: u32) {
    let word = |at: usize| u16::from_le_bytes([tiff[at], tiff[at + 1]]);
    let ifd = u32::from_le_bytes(tiff[4..8].try_into().unwrap()) as usize;
    let entries = usize::from(word(ifd));
    let entry = (0..entries).map(|k| ifd + 2 + 12 * k).find(|at| word(*at) == tag).unwrap();
    tiff[entry + 8..entry + 12].copy_from_slice(&value.to_le_bytes());
}

/// Writes an elevation file into `folder` and returns the options to generate a set from it.
pub fn from_dem(folder: &Path, name: &str, bytes: &[u8]) -> GenArgs {
    let path = folder.join(name);
    fs::write(&path, bytes).unwrap();
    GenArgs { dem: vec![path], levels: Some(2), jobs: Some(1), ..GenArgs::new(folder.join(format!("{name}.set"))) }
}

/// The file that `--update` needs; it has the names and times of the sources.
pub const MANIFEST: &str = "manifest.zip";

/// Returns the content of all files below a folder by their paths.
pub fn files_below(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().to_string_lossy().into_owned();
                if name != MANIFEST {
                    found.insert(name, fs::read(&path).unwrap());
                }
            }
        }
    }
    found
}

pub fn tileset(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("tileset.json")).unwrap()).unwrap()
}

/// Returns the region of a tile: west, south, east and north in radians, the lowest and highest height in metres.
pub fn region(tile: &Value) -> Vec<f64> {
    let region = tile["boundingVolume"]["region"].as_array().unwrap();
    region.iter().map(|v| v.as_f64().unwrap()).collect()
}

/// Calls with every tile and its parent, root first.
pub fn each_tile<'a>(tile: &'a Value, parent: Option<&'a Value>, call: &mut impl FnMut(&'a Value, Option<&'a Value>)) {
    call(tile, parent);
    for child in tile["children"].as_array().into_iter().flatten() {
        each_tile(child, Some(tile), call);
    }
}

/// The number of samples along a side of a height tile's file: 65 and a border on both sides.
pub const TILE_SIDE: usize = 67;

/// Reads the heights of a tile's EXR, north row first.
pub fn tile_heights(folder: &Path, level: u32, x: u32, y: u32) -> Vec<f32> {
    let path = folder.join(format!("{level}/{x}/{y}.exr"));
    let image = exr::prelude::read_first_flat_layer_from_file(&path).unwrap();
    let channel = &image.layer_data.channel_data.list[0];
    let heights: Vec<f32> = channel.sample_data.values_as_f32().collect();
    assert_eq!(heights.len(), TILE_SIDE * TILE_SIDE);
    heights
}
