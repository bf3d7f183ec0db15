//! Digital elevation models of the USGS in text (Standards for Digital Elevation Models, part 2, 1998): a record A about the whole,
//! and records B with profiles of heights, the westernmost first, each from south to north.
//!
//! The heads of the profiles are read when a file is opened; the threads of the run read the heights of several profiles at once.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use super::{Opened, RasterOptions, height_bits};
use crate::GenError;
use crate::georeference::{Crs, GeoTransform, Placement};
use crate::store::{BlockGrid, BlockReader, FileState, Rect};

/// The bytes of a record without the end of its line.
const RECORD: usize = 1024;
/// The bytes before the first height of a profile, and those of a height.
const HEAD: usize = 144;
const HEIGHT: usize = 6;
/// The heights in the first record of a profile, and in each further one.
const FIRST_HEIGHTS: usize = 146;
const MORE_HEIGHTS: usize = 170;
/// The bytes of a number with a decimal point.
const REAL: usize = 24;
/// Heights up to this are voids.
const VOID: i32 = -32_767;
const FOOT_M: f64 = 0.3048;
/// The number of profiles in a block, and the most in a file.
const PROFILES: usize = 64;
const MAX_PROFILES: usize = 1 << 16;
/// The most samples between the southernmost and the northernmost height.
const MAX_ROWS: f64 = 65_536.0;
/// The largest distance of a profile from its column of the grid, in samples.
const TOLERANCE: f64 = 0.25;

/// A profile of heights.
#[derive(Clone, Copy, Debug)]
struct Profile {
    /// The number of its first record.
    record: usize,
    /// The row of its first height, which is the southernmost one.
    row: usize,
    heights: usize,
    /// The height that is added to its heights, in the file's unit.
    datum: f64,
}

/// The header of a file, and the heads of its profiles.
#[derive(Debug)]
struct Header {
    size: [usize; 2],
    transform: GeoTransform,
    system: Option<String>,
    /// The factor of the heights, and metres for each unit.
    resolution: f64,
    unit_m: f64,
    /// The bytes of a record with the end of its line.
    stride: usize,
    /// The profile of each column; `None` where there is none.
    columns: Vec<Option<Profile>>,
}

/// A file, read by seeking.
struct UsgsDem {
    path: PathBuf,
    header: Header,
    options: RasterOptions,
    state: FileState,
}

/// Returns true for a file that begins with a record A: it has the codes of a reference system and of its units.
pub(super) fn is_usgs_dem(path: &Path) -> Result<bool, GenError> {
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(GenError::file(path))?;
    file.take(RECORD as u64).read_to_end(&mut bytes).map_err(GenError::file(path))?;
    let is_among =
        |at: usize, codes: std::ops::RangeInclusive<i32>| whole(&bytes, at).is_some_and(|n| codes.contains(&n));
    Ok(is_among(144, 1..=9) && is_among(156, 0..=20) && is_among(528, 0..=3) && is_among(534, 1..=2))
}

/// Opens a file.
pub(super) fn open(path: &Path, options: &RasterOptions) -> Result<Opened, GenError> {
    let bad = |reason: String| GenError::invalid(path, format!("USGS DEM: {reason}"));
    let state = FileState::of(path)?;
    let mut file = File::open(path).map_err(GenError::file(path))?;
    let header = Header::read(&mut file, state.bytes()).map_err(bad)?;
    let crs = match (&options.crs, &header.system) {
        (Some(crs), _) => crs.clone(),
        (None, Some(system)) => Crs::parse(system).map_err(bad)?,
        (None, None) => return Err(bad("a reference system that is not supported; --epsg CODE names it".to_owned())),
    };
    let placement = Placement::new(header.transform, crs);
    let grid = BlockGrid::new(header.size, [PROFILES, header.size[1]]);
    let reader = UsgsDem { path: path.to_owned(), header, options: options.clone(), state };
    Ok(Opened { grid, reader: Box::new(reader), placement })
}

/// Reads a whole number of six characters.
fn whole(bytes: &[u8], at: usize) -> Option<i32> {
    std::str::from_utf8(bytes.get(at..at + HEIGHT)?).ok()?.trim().parse().ok()
}

/// Reads a finite number of a width, with an exponent of Fortran.
fn real(bytes: &[u8], at: usize, width: usize) -> Option<f64> {
    let text = std::str::from_utf8(bytes.get(at..at + width)?).ok()?.trim().replace(['D', 'd'], "E");
    text.parse().ok().filter(|n: &f64| n.is_finite())
}

impl Header {
    /// Reads the header and the heads of all profiles. The error is the reason.
    fn read(file: &mut File, file_bytes: u64) -> Result<Self, String> {
        let mut record = vec![0; RECORD + 2];
        let start = record.len().min(file_bytes as usize);
        file.read_exact(&mut record[..start]).map_err(|e| e.to_string())?;
        let stride = match record[RECORD..] {
            [b'\r', b'\n'] => RECORD + 2,
            [b'\n' | b'\r', _] => RECORD + 1,
            _ => RECORD,
        };
        let needed = |number: Option<i32>, name: &str| number.ok_or_else(|| format!("no {name}"));
        let code = needed(whole(&record, 156), "reference system")?;
        let zone = whole(&record, 162).unwrap_or(0);
        let to_unit = match whole(&record, 528) {
            Some(0) => 180.0 / std::f64::consts::PI,
            Some(1) => FOOT_M,
            Some(2) => 1.0,
            Some(3) => 1.0 / 3600.0,
            other => return Err(format!("coordinates in the unit {}", other.unwrap_or(-1))),
        };
        let unit_m = if whole(&record, 534) == Some(1) { FOOT_M } else { 1.0 };
        let steps = [0, 1, 2].map(|axis| real(&record, 816 + 12 * axis, 12).filter(|step| *step > 0.0));
        let [Some(dx), Some(dy), resolution] = steps else { return Err("no spacing of its heights".to_owned()) };
        let (dx, dy) = (dx * to_unit, dy * to_unit);
        let datum = std::str::from_utf8(&record[890..892]).unwrap_or_default().trim().to_owned();
        let columns = needed(whole(&record, 858), "number of profiles")?;
        if !(1..=MAX_PROFILES as i32).contains(&columns) {
            return Err(format!("{columns} profiles"));
        }
        let heads = heads(file, stride, columns as usize, to_unit)?;
        let from = |axis: usize| heads.iter().map(|(at, _)| at[axis]).fold(f64::INFINITY, f64::min);
        let (west, south) = (from(0), from(1));
        let row = |at: f64| ((at - south) / dy).round();
        let top = heads.iter().map(|(at, profile)| row(at[1]) + profile.heights as f64).fold(0.0, f64::max);
        let east = heads.iter().map(|(at, _)| ((at[0] - west) / dx).round()).fold(0.0, f64::max);
        if !(1.0..=MAX_ROWS).contains(&top) || east >= 2.0 * heads.len() as f64 {
            return Err(format!("{} profiles in {} x {top} samples", heads.len(), east + 1.0));
        }
        let mut columns = vec![None; east as usize + 1];
        for ([x, y], profile) in heads {
            let place = [(x - west) / dx, (y - south) / dy];
            // Profiles in UTM begin where their quadrangle does, a part of a step off.
            if (place[0] - place[0].round()).abs() > TOLERANCE {
                return Err(format!("a profile at {x}, which is not a whole step from {west}"));
            }
            columns[place[0].round() as usize] = Some(Profile { row: place[1].round() as usize, ..profile });
        }
        let size = [columns.len(), top as usize];
        // Heights are points; pixels reach half a step around them.
        let origin = [west - 0.5 * dx, south + (top - 0.5) * dy];
        let transform = GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] };
        let resolution = resolution.unwrap_or(1.0);
        Ok(Self { size, transform, system: system(code, zone, &datum), resolution, unit_m, stride, columns })
    }

    /// Returns the bytes of a profile.
    fn bytes_of(&self, file: &mut File, profile: &Profile) -> std::io::Result<Vec<u8>> {
        let records = 1 + profile.heights.saturating_sub(FIRST_HEIGHTS).div_ceil(MORE_HEIGHTS);
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start((profile.record * self.stride) as u64))?;
        file.take((records * self.stride) as u64).read_to_end(&mut bytes)?;
        Ok(bytes)
    }
}

/// Reads the position and the head of each profile. The error is the reason.
fn heads(file: &mut File, stride: usize, count: usize, to_unit: f64) -> Result<Vec<([f64; 2], Profile)>, String> {
    let mut heads = Vec::new();
    let mut record = 1;
    let mut bytes = [0; HEAD];
    for number in 1..=count {
        let lacks = |what: &str| format!("profile {number} of {count} has no {what}");
        file.seek(SeekFrom::Start((record * stride) as u64)).map_err(|e| e.to_string())?;
        file.read_exact(&mut bytes).map_err(|_| lacks("head"))?;
        let heights = whole(&bytes, 12).filter(|n| (1..=MAX_ROWS as i32).contains(n));
        let heights = heights.ok_or_else(|| lacks("number of heights"))? as usize;
        let [x, y, datum] = [24, 48, 72].map(|at| real(&bytes, at, REAL));
        let (x, y) = (x.ok_or_else(|| lacks("place"))? * to_unit, y.ok_or_else(|| lacks("place"))? * to_unit);
        heads.push(([x, y], Profile { record, row: 0, heights, datum: datum.unwrap_or(0.0) }));
        record += 1 + heights.saturating_sub(FIRST_HEIGHTS).div_ceil(MORE_HEIGHTS);
    }
    Ok(heads)
}

/// Returns the reference system of a code, a zone and a horizontal datum; `None` if it is not supported.
fn system(code: i32, zone: i32, datum: &str) -> Option<String> {
    // 1 to 4 are NAD27, WGS72, WGS84 and NAD83; files without a datum are older than NAD83.
    let (degrees, north, south) = match datum {
        "2" => (4322, 32200, 32300),
        "3" => (4326, 32600, 32700),
        "4" => (4269, 26900, 0),
        _ => (4267, 26700, 0),
    };
    let utm = |first: i32| (first != 0 && (1..=60).contains(&zone.abs())).then(|| first + zone.abs());
    let code = match code {
        0 => Some(degrees),
        1 => utm(if zone < 0 { south } else { north }),
        _ => None,
    };
    code.map(|code| format!("EPSG:{code}"))
}

impl BlockReader for UsgsDem {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        self.state.check(&self.path)?;
        let bad = |reason: String| GenError::invalid(&self.path, format!("USGS DEM: {reason}"));
        let mut file = File::open(&self.path).map_err(GenError::file(&self.path))?;
        let mut heights = vec![f32::NAN; block.pixels()];
        let header = &self.header;
        for column in 0..block.width {
            let Some(profile) = header.columns[block.column + column] else { continue };
            let bytes = header.bytes_of(&mut file, &profile).map_err(GenError::file(&self.path))?;
            for k in 0..profile.heights {
                let at = match k.checked_sub(FIRST_HEIGHTS) {
                    None => HEAD + HEIGHT * k,
                    Some(more) => header.stride * (1 + more / MORE_HEIGHTS) + HEIGHT * (more % MORE_HEIGHTS),
                };
                let found = whole(&bytes, at).ok_or_else(|| {
                    bad(format!("height {} of profile {} is no number", k + 1, block.column + column + 1))
                })?;
                // A block has all heights of its profiles.
                let height_m = (profile.datum + f64::from(found) * header.resolution) * header.unit_m;
                let is_unknown = found <= VOID || self.options.nodata == Some(f64::from(found));
                if !is_unknown {
                    heights[(block.height - 1 - profile.row - k) * block.width + column] =
                        self.options.scaled_m(height_m as f32);
                }
            }
        }
        Ok(height_bits(heights))
    }
}
