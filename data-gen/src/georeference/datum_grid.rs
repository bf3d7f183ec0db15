//! Shifts from a datum to WGS84 by a grid in the format NTv2, which the user names. The crate `proj4rs` interpolates it.
//!
//! A file has a header and, for each grid, another header and its shifts: records of 16 bytes, the key and the value.

use std::io::Cursor;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use proj4rs::nadgrids::{catalog, formats};

use crate::GenError;
use crate::pyramid::checksum;

const HEADER_BYTES: usize = 11 * 16;
const RECORD_BYTES: usize = 16;
/// The largest file.
const MAX_BYTES: u64 = 1 << 30;
/// The largest number of points along a side of a grid.
const MAX_SIDE: f64 = 1e5;

/// A grid that was read.
#[derive(Debug)]
pub(crate) struct DatumGrid {
    /// The name of the grid for `proj4rs`.
    pub(super) name: String,
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
        let bytes = std::fs::read(path).map_err(GenError::file(path))?;
        check(&bytes).map_err(bad)?;
        let name = format!("terrane{:016x}", checksum(&bytes));
        // The crate keeps all grids until the program ends.
        if !catalog::find_grids(&name, &mut Vec::new()) {
            let added = catalog::with_catalog(|grids| formats::read(grids, &name, &mut Cursor::new(&bytes)));
            added.map_err(|e| bad(e.to_string()))?;
        }
        Ok(Self { name, is_used: AtomicBool::new(false) })
    }

    /// Notes that a source is shifted by the grid.
    pub(super) fn set_used(&self) {
        self.is_used.store(true, Ordering::Relaxed);
    }

    /// Returns true if a source is shifted by the grid.
    pub fn is_used(&self) -> bool {
        self.is_used.load(Ordering::Relaxed)
    }
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
