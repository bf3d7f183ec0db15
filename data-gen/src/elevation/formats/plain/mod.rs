//! Rasters of plain samples whose layout a header tells: of ESRI, the USGS, ENVI, SAGA and NASA's PDS in a text file beside the
//! samples, of Surfer and ISIS before them.

mod headers;
mod isis;
mod pds;
mod pds4;
mod planetary;
mod saga;
mod samples;
mod surfer;

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{MAX_SAMPLES, Opened, RasterOptions, height_bits};
use crate::GenError;
use crate::georeference::{GeoTransform, Metadata, Placement};
use crate::store::{BlockCache, BlockGrid, BlockReader, FileState, Rect};

pub(super) use isis::{is_isis, open as open_isis};
pub(super) use samples::Sample;
pub(super) use surfer::{is_surfer, open as open_surfer};

/// The largest number of samples in a block.
const MAX_BLOCK: usize = 1 << 20;
/// The largest number of rows in a block.
const MAX_ROWS: usize = 64;

/// The order of the samples of several bands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Interleave {
    /// A row of each band, then the next row.
    Lines,
    /// All bands of a pixel, then the next pixel.
    Pixels,
    /// One band, then the next.
    Bands,
}

/// The header of a raster.
#[derive(Clone, Debug, PartialEq)]
struct Header {
    size: [usize; 2],
    bands: usize,
    sample: Sample,
    is_big_endian: bool,
    interleave: Interleave,
    /// The bytes before the first sample.
    skipped: u64,
    /// The bytes from a row of a band to the band's next one, and from a band to the next, where a header names them.
    row_bytes: Option<u64>,
    band_bytes: Option<u64>,
    /// The columns and rows of the tiles that a band is divided into, one after another, all of them whole.
    tile: Option<[usize; 2]>,
    /// The value of samples without data.
    nodata: Option<f64>,
    /// Metres for each unit.
    unit_m: f64,
    /// Metres that are added.
    offset_m: f64,
    transform: GeoTransform,
    /// The reference system, as WKT.
    system: Option<String>,
}

/// The positions of the samples of a band.
#[derive(Clone, Copy, Debug)]
struct Steps {
    start: u64,
    row: u64,
    column: u64,
}

impl Header {
    /// Returns where the samples of a band are; the error says how many bytes a file of a length lacks.
    fn steps(&self, band: usize, file_bytes: u64) -> Result<Steps, String> {
        let [width, height] = self.size.map(|side| side as u64);
        let sample = self.sample.bytes();
        let lacks = || format!("{file_bytes} bytes for {width} x {height} samples of {} bands", self.bands);
        let is_sane = width > 0 && height > 0 && (1..=1 << 20).contains(&self.bands);
        if !is_sane || width.checked_mul(height).is_none_or(|count| count > MAX_SAMPLES as u64) {
            return Err(format!("{width} x {height} samples of {} bands", self.bands));
        }
        let (bands, band) = (self.bands as u64, band as u64);
        if let Some(tile) = self.tile {
            let [across, down] = [0, 1].map(|axis| self.size[axis].div_ceil(tile[axis]) as u64);
            let tile_bytes = tile[0] as u64 * tile[1] as u64 * sample;
            let band_bytes = across.checked_mul(down).and_then(|tiles| tiles.checked_mul(tile_bytes));
            let start = band_bytes.and_then(|bytes| bytes.checked_mul(band)?.checked_add(self.skipped));
            let end = start.zip(band_bytes).and_then(|(start, bytes)| start.checked_add(bytes));
            let steps = start.map(|start| Steps { start, row: tile[0] as u64 * sample, column: sample });
            return steps.filter(|_| end.is_some_and(|end| end <= file_bytes)).ok_or_else(lacks);
        }
        let steps = || {
            let row = width * sample;
            let (row, from_band, column) = match self.interleave {
                Interleave::Lines => {
                    let from_band = self.band_bytes.unwrap_or(row);
                    (self.row_bytes.unwrap_or(from_band.checked_mul(bands)?), from_band, sample)
                }
                Interleave::Pixels => (self.row_bytes.unwrap_or(row.checked_mul(bands)?), sample, sample * bands),
                Interleave::Bands => {
                    let row = self.row_bytes.unwrap_or(row);
                    (row, self.band_bytes.unwrap_or(row.checked_mul(height)?), sample)
                }
            };
            let start = self.skipped.checked_add(band.checked_mul(from_band)?)?;
            let last = row.checked_mul(height - 1)?.checked_add(column.checked_mul(width - 1)?)?;
            let end = start.checked_add(last)?.checked_add(sample)?;
            (end <= file_bytes && column * (width - 1) + sample <= row).then_some(Steps { start, row, column })
        };
        steps().ok_or_else(lacks)
    }
}

/// A raster, read by seeking.
struct Plain {
    path: PathBuf,
    header: Header,
    steps: Steps,
    options: RasterOptions,
    state: FileState,
}

/// Opens a raster that has a header beside it. `None` without one.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Option<Opened>, GenError> {
    let found = match [saga::header, pds::header, pds4::header]
        .into_iter()
        .find_map(|header| header(path, cache).transpose())
    {
        Some(found) => Some(found?),
        None => headers::header(path, cache)?,
    };
    found.map(|(beside, header)| open_with(path, &beside, header, options, cache)).transpose()
}

/// Opens a raster with a header that is in the file `beside`.
fn open_with(
    path: &Path,
    beside: &Path,
    header: Header,
    options: &RasterOptions,
    cache: &Arc<BlockCache>,
) -> Result<Opened, GenError> {
    let state = FileState::of(path)?;
    let band = match (&options.channel, header.bands) {
        (None, 1) => 0,
        (None, count) => {
            let reason = format!("{count} bands; elevation has one channel, --channel N chooses it");
            return Err(GenError::invalid(path, reason));
        }
        (Some(name), count) => {
            let number = name.parse().ok().filter(|n| (1..=count).contains(n));
            number
                .ok_or_else(|| GenError::invalid(path, format!("--channel {name}: the file has bands 1 to {count}")))?
                - 1
        }
    };
    let steps = header.steps(band, state.bytes()).map_err(|reason| GenError::invalid(path, reason))?;
    let system = match &header.system {
        Some(text) => Metadata::of_system(beside, text),
        None => Metadata::beside(path, cache)?,
    };
    let placement = Placement::of_header(path, header.transform, header.size, options.crs.clone(), &system, cache)?;
    let rows = (MAX_BLOCK / header.size[0]).clamp(1, MAX_ROWS);
    let grid = match header.tile {
        // Tiles beyond the edges are whole in the file.
        Some(tile) => BlockGrid { size: header.size, block: tile },
        None => BlockGrid::new(header.size, [header.size[0], rows]),
    };
    let plain = Plain { path: path.to_owned(), header, steps, options: options.clone(), state };
    Ok(Opened { grid, reader: Box::new(plain), placement })
}

impl BlockReader for Plain {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        self.state.check(&self.path)?;
        let Steps { start, row, column } = self.steps;
        let (sample, column) = (self.header.sample, column as usize);
        let bytes_of_sample = sample.bytes() as usize;
        let mut file = File::open(&self.path).map_err(GenError::file(&self.path))?;
        let mut bytes = vec![0; column * (block.width - 1) + bytes_of_sample];
        let mut heights = Vec::with_capacity(block.pixels());
        for y in block.row..block.row + block.height {
            let at = match self.header.tile {
                None => start + y as u64 * row + (block.column * column) as u64,
                Some([width, height]) => {
                    let across = self.header.size[0].div_ceil(width) as u64;
                    let tile = (block.row / height) as u64 * across + (block.column / width) as u64;
                    start + (tile * height as u64 + (y - block.row) as u64) * row
                }
            };
            file.seek(SeekFrom::Start(at))
                .and_then(|_| file.read_exact(&mut bytes))
                .map_err(GenError::file(&self.path))?;
            heights.extend((0..block.width).map(|x| {
                let mut le = [0; 8];
                le[..bytes_of_sample].copy_from_slice(&bytes[x * column..x * column + bytes_of_sample]);
                if self.header.is_big_endian {
                    le[..bytes_of_sample].reverse();
                }
                let value = sample.value(le);
                // The text of a header may have fewer digits than the samples.
                let is_unknown = self.header.nodata.is_some_and(|nodata| nodata as f32 == value as f32);
                if is_unknown {
                    f32::NAN
                } else {
                    self.options.height_m((value * self.header.unit_m + self.header.offset_m) as f32)
                }
            }));
        }
        Ok(height_bits(heights))
    }
}
