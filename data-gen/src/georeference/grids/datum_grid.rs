//! Shifts from a datum to WGS84 by a grid in the format NTv2 or GeoTIFF, which the user names. The crate `proj4rs`
//! interpolates it. A GeoTIFF is converted to NTv2.
//!
//! An NTv2 file has a header and, for each grid, another header and its shifts: records of 16 bytes, the key and the value.

use std::io::Cursor;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use proj4rs::nadgrids::{catalog, formats};
use terrane::math::random::fnv1a;

use super::super::projection::OWN_GRID;
use super::grid_tiff::{self, GridImage};
use crate::GenError;

const HEADER_BYTES: usize = 11 * 16;
const RECORD_BYTES: usize = 16;
/// The largest file.
const MAX_BYTES: u64 = 1 << 30;
/// The largest number of points along a side of a grid.
const MAX_SIDE: f64 = 1e5;

/// The type of GeoTIFFs with shifts.
const SHIFT: &str = "HORIZONTAL_OFFSET";

/// A grid that was read.
#[derive(Debug)]
pub(crate) struct DatumGrid {
    /// The name of the grid for `proj4rs`.
    pub(in super::super) name: String,
    is_used: AtomicBool,
}

impl DatumGrid {
    /// Reads a file.
    pub fn read(path: &Path) -> Result<Self, GenError> {
        GenError::if_not_regular(path)?;
        let bad = |reason: String| GenError::invalid(path, format!("NTv2 grid: {reason}"));
        let length = std::fs::metadata(path).map_err(GenError::file(path))?.len();
        if length > MAX_BYTES {
            return Err(bad(format!("{length} bytes; {MAX_BYTES} are supported")));
        }
        let mut bytes = std::fs::read(path).map_err(GenError::file(path))?;
        if grid_tiff::is_tiff(&bytes) {
            bytes = ntv2_of_tiff(path)?;
        }
        check(&bytes).map_err(bad)?;
        let name = format!("{OWN_GRID}{:016x}", fnv1a(&bytes));
        // The crate keeps all grids until the program ends.
        if !catalog::find_grids(&name, &mut Vec::new()) {
            let added = catalog::with_catalog(|grids| formats::read(grids, &name, &mut Cursor::new(&bytes)));
            added.map_err(|e| bad(e.to_string()))?;
        }
        Ok(Self { name, is_used: AtomicBool::new(false) })
    }

    /// Notes that a source is shifted by the grid.
    pub(in super::super) fn set_used(&self) {
        self.is_used.store(true, Ordering::Relaxed);
    }

    /// Returns true if a source is shifted by the grid.
    pub fn is_used(&self) -> bool {
        self.is_used.load(Ordering::Relaxed)
    }
}

/// Converts the images of a GeoTIFF to the grids of an NTv2 file.
fn ntv2_of_tiff(path: &Path) -> Result<Vec<u8>, GenError> {
    let images = described(path, grid_tiff::open(path, SHIFT)?)?;
    let mut file = Vec::new();
    let text = |text: &str| {
        let mut bytes = [b' '; 8];
        bytes.iter_mut().zip(text.bytes()).for_each(|(byte, own)| *byte = own);
        bytes
    };
    let int = |n: u32| (u64::from(n)).to_le_bytes();
    let record = |file: &mut Vec<u8>, key: &str, value: [u8; 8]| {
        file.extend(text(key));
        file.extend(value);
    };
    record(&mut file, "NUM_OREC", int(11));
    record(&mut file, "NUM_SREC", int(11));
    record(&mut file, "NUM_FILE", int(images.len() as u32));
    record(&mut file, "GS_TYPE", text("SECONDS"));
    file.resize(HEADER_BYTES, 0);
    for (number, (image, channels)) in images.iter().enumerate() {
        let [columns, rows] = image.size;
        let start = image.south_west.map(|degrees| degrees * 3600.0);
        let step = image.step.map(|degrees| degrees * 3600.0);
        let end = [0, 1].map(|k| start[k] + step[k] * (image.size[k] - 1) as f64);
        // A finer grid lies inside of the one that it refines, which comes before it.
        let around = images[..number].iter().rposition(|(other, _)| contains(other, image));
        let parent = around.map_or_else(|| "NONE".to_owned(), |parent| format!("GRID{parent}"));
        for (key, value) in [
            ("SUB_NAME", text(&format!("GRID{number}"))),
            ("PARENT", text(&parent)),
            ("CREATED", text("")),
            ("UPDATED", text("")),
            ("S_LAT", start[1].to_le_bytes()),
            ("N_LAT", end[1].to_le_bytes()),
            ("E_LONG", (-end[0]).to_le_bytes()),
            ("W_LONG", (-start[0]).to_le_bytes()),
            ("LAT_INC", step[1].to_le_bytes()),
            ("LONG_INC", step[0].to_le_bytes()),
            ("GS_COUNT", int((columns * rows) as u32)),
        ] {
            record(&mut file, key, value);
        }
        let north = image.values(channels.north, channels.seconds)?;
        let east = image.values(channels.east, if channels.is_west { -channels.seconds } else { channels.seconds })?;
        // Points count from the south-eastern one to the west, and shifts to the west.
        for row in 0..rows {
            for point in (0..columns).rev().map(|column| row * columns + column) {
                for value in [north[point], -east[point], 0.0, 0.0] {
                    file.extend(value.to_le_bytes());
                }
            }
        }
    }
    file.extend(text("END"));
    file.extend([0; 8]);
    Ok(file)
}

/// Returns true if an image has the same points as a part of another, or finer ones.
fn contains(outer: &GridImage, inner: &GridImage) -> bool {
    (0..2).all(|k| {
        let end = |image: &GridImage| image.south_west[k] + image.step[k] * (image.size[k] - 1) as f64;
        let tolerance = 1e-3 * inner.step[k];
        outer.south_west[k] <= inner.south_west[k] + tolerance && end(inner) <= end(outer) + tolerance
    })
}

/// The channels of an image with shifts to the north and to the east.
#[derive(Clone, Copy)]
struct Channels {
    north: usize,
    east: usize,
    /// The unit in seconds.
    seconds: f64,
    /// True if shifts to the west are positive.
    is_west: bool,
}

/// Finds the channels of images. What an image does not name is as in those before it, and images of other values are left
/// out, as PROJ reads them.
fn described(path: &Path, images: Vec<GridImage>) -> Result<Vec<(GridImage, Channels)>, GenError> {
    let mut channels = Channels { north: 0, east: 1, seconds: 1.0, is_west: false };
    let mut found = Vec::new();
    for image in images {
        let bad = |reason: String| GenError::invalid(path, reason);
        match (image.channel(&["latitude_offset"]), image.channel(&["longitude_offset"])) {
            (Some(north), Some(east)) => {
                let positive = image.item("name=\"positive_value\"", east);
                let is_west = positive.map_or(channels.is_west, |positive| positive == "west");
                channels = Channels { north, east, is_west, ..channels };
            }
            (None, None) if !image.has_names() => {}
            (None, None) if !found.is_empty() => continue,
            (north, _) => {
                let name = if north.is_none() { "latitude_offset" } else { "longitude_offset" };
                return Err(bad(format!("no channel {name}")));
            }
        }
        if channels.north.max(channels.east) >= image.channels() {
            return Err(bad("no channel longitude_offset".to_owned()));
        }
        channels.seconds = match image.item("role=\"unittype\"", channels.east).as_deref() {
            None => channels.seconds,
            Some("arc-second") => 1.0,
            Some("degree") => 3600.0,
            Some("radian") => 3600.0 * 1f64.to_degrees(),
            Some(other) => return Err(bad(format!("shifts in units of `{other}`"))),
        };
        found.push((image, channels));
    }
    Ok(found)
}

/// Checks the headers of a file, which `proj4rs` trusts. The error is the reason.
fn check(bytes: &[u8]) -> Result<(), String> {
    let is_little = bytes.get(8) == Some(&11);
    let value = |at: usize| -> Result<[u8; 8], String> {
        let value = bytes.get(at..at + 8).and_then(|value| value.first_chunk::<8>()).copied();
        value.ok_or_else(|| "shorter than its headers".to_owned())
    };
    let count = |at: usize| {
        let [a, b, c, d, ..] = value(at)?;
        Ok::<u32, String>(if is_little { u32::from_le_bytes([a, b, c, d]) } else { u32::from_be_bytes([a, b, c, d]) })
    };
    let number = |at: usize| {
        let value = value(at)?;
        Ok::<f64, String>(if is_little { f64::from_le_bytes(value) } else { f64::from_be_bytes(value) })
    };
    if !bytes.starts_with(b"NUM_OREC") || count(8)? != 11 {
        return Err("it does not begin with NUM_OREC and 11".to_owned());
    }
    if !value(56)?.starts_with(b"SECONDS") {
        return Err("shifts in other units than seconds".to_owned());
    }
    let mut at = HEADER_BYTES;
    for grid in 0..count(40)? {
        if &value(at)? != b"SUB_NAME" {
            return Err(format!("grid {grid} does not begin with SUB_NAME"));
        }
        let mut numbers = [0.0; 6];
        for (k, n) in numbers.iter_mut().enumerate() {
            *n = number(at + 72 + RECORD_BYTES * k)?;
        }
        // Longitudes count to the west.
        let [south, north, east, west, latitudes, longitudes] = numbers;
        let side = |from: f64, to: f64, step: f64| ((to - from) / step + 1.5).floor();
        let [rows, columns] = [side(south, north, latitudes), side(east, west, longitudes)];
        let is_valid =
            [rows, columns].iter().all(|n| (2.0..=MAX_SIDE).contains(n)) && latitudes > 0.0 && longitudes > 0.0;
        if !is_valid || rows * columns != f64::from(count(at + 168)?) {
            return Err(format!("grid {grid} has a header that is not valid"));
        }
        at += HEADER_BYTES + RECORD_BYTES * (rows * columns) as usize;
        if at > bytes.len() {
            return Err(format!("grid {grid} ends beyond the file"));
        }
    }
    Ok(())
}
