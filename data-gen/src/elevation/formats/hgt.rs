//! SRTM tiles: big-endian int16 over one degree, with samples on the edges. Their name gives the south-west corner.

use std::io::{BufReader, Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use flate2::bufread::MultiGzDecoder;

use super::Opened;
use crate::GenError;
use crate::georeference::{Crs, GeoTransform, Placement};
use crate::store::{BlockCache, BlockGrid, BlockReader, FileState, Rect, WholeReader, whole};

/// An HGT file, read by seeking.
struct Hgt {
    path: PathBuf,
    size: [usize; 2],
    state: FileState,
}

/// Opens an HGT file.
pub(super) fn open(path: &Path) -> Result<Opened, GenError> {
    let name = path.file_stem().and_then(|s| s.to_str()).unwrap_or("");
    let state = FileState::of(path)?;
    let (size, placement) = place(path, name, state.bytes())?;
    let grid = BlockGrid::new(size, [size[0], ROWS]);
    Ok(Opened { grid, reader: Box::new(Hgt { path: path.to_owned(), size, state }), placement })
}

/// The number of rows of a block.
const ROWS: usize = 64;

impl BlockReader for Hgt {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let failed = GenError::file(&self.path);
        let read = || {
            let mut file = std::fs::File::open(&self.path)?;
            // A block is as wide as the file.
            file.seek(SeekFrom::Start(2 * (block.row * self.size[0]) as u64))?;
            let mut bytes = vec![0; 2 * block.pixels()];
            file.read_exact(&mut bytes)?;
            Ok(bytes)
        };
        self.state.check(&self.path)?;
        read().map(|bytes| samples(&bytes)).map_err(failed)
    }
}

/// Returns the bits of the heights of big-endian samples.
fn samples(bytes: &[u8]) -> Vec<u32> {
    let height_m = |b: &[u8; 2]| match i16::from_be_bytes(*b) {
        i16::MIN => f32::NAN,
        h => f32::from(h),
    };
    bytes.as_chunks().0.iter().map(height_m).map(f32::to_bits).collect()
}

/// The first HGT file of a zip file.
struct Zipped {
    path: PathBuf,
    member: String,
    size: [usize; 2],
}

/// Opens the first HGT file of a zip file. The name of that file, or of the zip file, tells the position.
pub(super) fn open_zip(path: &Path, cache: &BlockCache) -> Result<Opened, GenError> {
    let bad = |reason: String| GenError::invalid(path, format!("zip: {reason}"));
    let mut archive = archive(path)?;
    let names = archive.file_names().filter_map(|name| Some(name.ok()?.into_owned()));
    let member = names.filter(|name| name.to_ascii_lowercase().ends_with(".hgt")).min();
    let member = member.ok_or_else(|| bad("no HGT file in it".to_owned()))?;
    let bytes = archive.by_name(&member).map_err(|e| bad(e.to_string()))?.size();
    let stem = member.rsplit(['/', '\\']).next().unwrap_or(&member);
    let own = path.file_name().and_then(|s| s.to_str()).unwrap_or("");
    let (size, placement) = place(path, if corner(stem).is_some() { stem } else { own }, bytes)?;
    let zipped = Zipped { path: path.to_owned(), member, size };
    let (grid, reader) = whole(Box::new(zipped), size, cache);
    Ok(Opened { grid, reader, placement })
}

fn archive(path: &Path) -> Result<zip::ZipArchive<BufReader<std::fs::File>>, GenError> {
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    zip::ZipArchive::new(BufReader::new(file)).map_err(|e| GenError::invalid(path, format!("zip: {e}")))
}

impl WholeReader for Zipped {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        let bad = |e: &dyn std::fmt::Display| GenError::invalid(&self.path, format!("zip: {}: {e}", self.member));
        let mut archive = archive(&self.path)?;
        let mut member = archive.by_name(&self.member).map_err(|e| bad(&e))?;
        let mut row = vec![0; 2 * self.size[0]];
        for _ in 0..self.size[1] {
            member.read_exact(&mut row).map_err(|e| bad(&e))?;
            call(&samples(&row))?;
        }
        // The checksum of the member is compared at its end.
        std::io::copy(&mut member, &mut std::io::sink()).map(|_| ()).map_err(|e| bad(&e))
    }

    fn path(&self) -> &Path {
        &self.path
    }
}

/// An HGT file that was compressed by gzip.
struct Gzipped {
    path: PathBuf,
    size: [usize; 2],
}

/// The largest number of bytes that follow the samples.
const MAX_MORE_BYTES: u64 = 64 << 10;

/// Opens an HGT file that was compressed by gzip. The name tells the position.
pub(super) fn open_gzip(path: &Path, cache: &BlockCache) -> Result<Opened, GenError> {
    // A file ends with the length of its content.
    let length = || {
        let mut file = std::fs::File::open(path)?;
        file.seek(SeekFrom::End(-4))?;
        let mut bytes = [0; 4];
        file.read_exact(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes))
    };
    let length = length().map_err(GenError::file(path))?;
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or("");
    let (size, placement) = place(path, name, length.into())?;
    let (grid, reader) = whole(Box::new(Gzipped { path: path.to_owned(), size }), size, cache);
    Ok(Opened { grid, reader, placement })
}

impl WholeReader for Gzipped {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        let bad = |e: std::io::Error| GenError::invalid(&self.path, format!("gzip: {e}"));
        let file = std::fs::File::open(&self.path).map_err(GenError::file(&self.path))?;
        let mut content = MultiGzDecoder::new(BufReader::new(file));
        let mut row = vec![0; 2 * self.size[0]];
        for _ in 0..self.size[1] {
            content.read_exact(&mut row).map_err(bad)?;
            call(&samples(&row))?;
        }
        // The checksum is compared at the end.
        std::io::copy(&mut content.take(MAX_MORE_BYTES), &mut std::io::sink()).map(|_| ()).map_err(bad)
    }

    fn path(&self) -> &Path {
        &self.path
    }
}

/// The columns and rows of files: of 3 seconds and of 1 second, the latter also with half of the columns beyond 50 degrees of
/// latitude, and of half a second.
const SIZES: [[usize; 2]; 4] = [[1201; 2], [1801, 3601], [3601; 2], [7201; 2]];

/// Returns the columns and rows and the placement of a file of a size, whose name begins with its south-west corner, such as
/// N42E001.
fn place(path: &Path, name: &str, bytes: u64) -> Result<([usize; 2], Placement), GenError> {
    // Some distributors append a few bytes to the samples.
    let has =
        |[columns, rows]: [usize; 2]| (2 * columns * rows..2 * (columns + 1) * (rows + 1)).contains(&(bytes as usize));
    let size = SIZES.into_iter().find(|size| has(*size)).ok_or_else(|| {
        let known = SIZES.map(|[columns, rows]| format!("{columns} x {rows}")).join(", ");
        GenError::invalid(path, format!("HGT of {bytes} bytes: not {known} samples"))
    })?;
    let [west, south] = corner(name).ok_or_else(|| GenError::invalid(path, "HGT: the name is not like N42E001"))?;
    let [dx, dy] = size.map(|side| 1.0 / (side - 1) as f64);
    let origin = [west - 0.5 * dx, south + 1.0 + 0.5 * dy];
    let transform = GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] };
    Ok((size, Placement::new(transform, Crs::Geographic)))
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
