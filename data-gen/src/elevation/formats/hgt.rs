//! SRTM tiles: big-endian int16 over one degree, with samples on the edges. Their name gives the south-west corner.

use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::Path;

use super::super::raster::Raster;
use crate::GenError;
use crate::georeference::{Crs, GeoTransform, Placement};

/// Reads an HGT file.
pub(super) fn read(path: &Path) -> Result<Raster, GenError> {
    let bytes = std::fs::read(path).map_err(GenError::file(path))?;
    let name = path.file_stem().and_then(|s| s.to_str()).unwrap_or("");
    decode(path, name, &bytes)
}

/// Reads the first HGT file of a zip file. The name of that file, or of the zip file, tells the position.
pub(super) fn read_zip(path: &Path) -> Result<Raster, GenError> {
    let bad = |reason: String| GenError::invalid(path, format!("zip: {reason}"));
    let mut file = std::fs::File::open(path).map_err(GenError::file(path))?;
    file.seek(SeekFrom::Start(0)).map_err(GenError::file(path))?;
    let mut archive = zip::ZipArchive::new(std::io::BufReader::new(file)).map_err(|e| bad(e.to_string()))?;
    let names = archive.file_names().filter_map(|name| Some(name.ok()?.into_owned()));
    let name = names.filter(|name| name.to_ascii_lowercase().ends_with(".hgt")).min();
    let name = name.ok_or_else(|| bad("no HGT file in it".to_owned()))?;
    let member = archive.by_name(&name).map_err(|e| bad(e.to_string()))?;
    let mut bytes = Vec::new();
    member.take(MAX_BYTES).read_to_end(&mut bytes).map_err(|e| bad(format!("{name}: {e}")))?;
    let stem = name.rsplit(['/', '\\']).next().unwrap_or(&name);
    let own = path.file_name().and_then(|s| s.to_str()).unwrap_or("");
    decode(path, if corner(stem).is_some() { stem } else { own }, &bytes)
}

/// A byte more than the largest file that is read.
const MAX_BYTES: u64 = 3602 * 3602 * 2;

/// Decodes the bytes of a file whose name begins with its south-west corner, such as N42E001.
fn decode(path: &Path, name: &str, bytes: &[u8]) -> Result<Raster, GenError> {
    let side = match bytes.len() {
        // Some distributors append a few bytes to the samples.
        n if (1201 * 1201 * 2..1202 * 1202 * 2).contains(&n) => 1201,
        n if (3601 * 3601 * 2..3602 * 3602 * 2).contains(&n) => 3601,
        n => return Err(GenError::invalid(path, format!("HGT of {n} bytes: neither 1201 nor 3601 samples a side"))),
    };
    let [west, south] = corner(name).ok_or_else(|| GenError::invalid(path, "HGT: the name is not like N42E001"))?;
    let pixel = 1.0 / (side - 1) as f64;
    let samples = bytes
        .chunks_exact(2)
        .take(side * side)
        .map(|b| match i16::from_be_bytes([b[0], b[1]]) {
            i16::MIN => f32::NAN,
            h => f32::from(h),
        })
        .collect();
    let origin = [west - 0.5 * pixel, south + 1.0 + 0.5 * pixel];
    let transform = GeoTransform { origin, dx: [pixel, 0.0], dy: [0.0, -pixel] };
    Ok(Raster::new([side, side], samples, Placement::new(transform, Crs::Geographic)))
}

/// Returns the longitude and latitude of the south-west corner in degrees.
fn corner(name: &str) -> Option<[f64; 2]> {
    let name = name.to_ascii_uppercase();
    let (ns, rest) = name.split_at_checked(1)?;
    let (lat, rest) = rest.split_at_checked(2)?;
    let (ew, lon) = rest.split_at_checked(1)?;
    let (lat, lon): (f64, f64) = (lat.parse().ok()?, lon.get(..3)?.parse().ok()?);
    let sign = |c: &str, plus: &str, minus: &str| match c {
        _ if c == plus => Some(1.0),
        _ if c == minus => Some(-1.0),
        _ => None,
    };
    Some([lon * sign(ew, "E", "W")?, lat * sign(ns, "N", "S")?])
}
