//! Grids of Surfer (`.grd`): text (DSAA), binary of version 6 (DSBB) and of version 7 (DSRB). Rows are from the south.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::super::ascii_grid::{Words, number, words};
use super::super::{MAX_SAMPLES, Opened, RasterOptions};
use super::samples::Sample;
use super::{Header, Interleave, open_with};
use crate::GenError;
use crate::georeference::{GeoTransform, Placement};
use crate::store::{BlockCache, FileState, WholeReader, whole};

/// The bytes of the header of version 6, and the most that come before the samples of version 7.
const VERSION_6_BYTES: usize = 56;
const MAX_HEADER_BYTES: usize = 4096;
/// Values from this on are blank.
const BLANK: f64 = 1.701_41e38;

/// Returns true for the first bytes of such a grid.
pub(in super::super) fn is_surfer(magic: &[u8]) -> bool {
    [b"DSAA", b"DSBB", b"DSRB"].iter().any(|start| magic.starts_with(*start))
}

/// Opens a grid and reads its header.
pub(in super::super) fn open(
    path: &Path,
    options: &RasterOptions,
    cache: &Arc<BlockCache>,
) -> Result<Opened, GenError> {
    let bad = |reason: String| bad(path, &reason);
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(GenError::file(path))?;
    file.take(MAX_HEADER_BYTES as u64).read_to_end(&mut bytes).map_err(GenError::file(path))?;
    match bytes.get(..4) {
        Some(b"DSBB") => open_with(path, path, version_6(&bytes).map_err(bad)?, options, cache),
        Some(b"DSRB") => open_with(path, path, version_7(&bytes).map_err(bad)?, options, cache),
        _ => open_text(path, options, cache),
    }
}

fn bad(path: &Path, reason: &str) -> GenError {
    GenError::invalid(path, format!("Surfer grid: {reason}"))
}

/// The numbers of a header, one after another.
struct Numbers<'a>(&'a [u8]);

impl Numbers<'_> {
    fn bytes<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (found, rest) = self.0.split_first_chunk().ok_or("its header is cut off")?;
        self.0 = rest;
        Ok(*found)
    }

    fn integer(&mut self) -> Result<u32, String> {
        self.bytes().map(u32::from_le_bytes)
    }

    fn double(&mut self) -> Result<f64, String> {
        self.bytes().map(f64::from_le_bytes)
    }

    fn doubles<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut found = [0.0; N];
        for number in &mut found {
            *number = self.double()?;
        }
        Ok(found)
    }
}

/// Returns the map from pixels to coordinates, of which the first sample is the south-western one. The error is the reason.
fn transform([west, south]: [f64; 2], [dx, dy]: [f64; 2]) -> Result<GeoTransform, String> {
    let is_valid = [west, south, dx, dy].iter().all(|n| n.is_finite()) && dx > 0.0 && dy > 0.0;
    let transform = GeoTransform { origin: [west - 0.5 * dx, south - 0.5 * dy], dx: [dx, 0.0], dy: [0.0, dy] };
    if is_valid {
        Ok(transform)
    } else {
        Err(format!("its first sample is at {west}, {south}, its steps are {dx}, {dy}"))
    }
}

/// Returns the steps of a grid between the first and the last sample of each axis.
fn steps(size: [usize; 2], x: [f64; 2], y: [f64; 2]) -> [f64; 2] {
    [(x[1] - x[0]) / (size[0].max(2) - 1) as f64, (y[1] - y[0]) / (size[1].max(2) - 1) as f64]
}

fn header(size: [usize; 2], sample: Sample, skipped: usize, blank: f64, transform: GeoTransform) -> Header {
    Header {
        size,
        bands: 1,
        sample,
        is_big_endian: false,
        interleave: Interleave::Bands,
        skipped: skipped as u64,
        row_bytes: None,
        band_bytes: None,
        tile: None,
        nodata: Some(blank),
        unit_m: 1.0,
        offset_m: 0.0,
        transform,
        system: None,
    }
}

/// The error is the reason.
fn version_6(bytes: &[u8]) -> Result<Header, String> {
    let mut numbers = Numbers(&bytes[4..]);
    let size = [numbers.bytes()?, numbers.bytes()?].map(|side| usize::from(u16::from_le_bytes(side)));
    let ([x, y], _) = ([numbers.doubles()?, numbers.doubles()?], numbers.doubles::<2>()?);
    let transform = transform([x[0], y[0]], steps(size, x, y))?;
    Ok(header(size, Sample::F32, VERSION_6_BYTES, BLANK, transform))
}

/// Sections with a name and a length follow one another: the grid's is before that of the samples. The error is the reason.
fn version_7(bytes: &[u8]) -> Result<Header, String> {
    let mut found = None;
    let mut at = 0;
    while at < bytes.len() {
        let mut numbers = Numbers(&bytes[at..]);
        let name: [u8; 4] = numbers.bytes()?;
        let length = numbers.integer()? as usize;
        at += 8;
        match &name {
            b"GRID" => {
                let [rows, columns] = [numbers.integer()?, numbers.integer()?].map(|side| side as usize);
                let [west, south, dx, dy, _, _, rotation, blank] = numbers.doubles()?;
                if rotation != 0.0 {
                    return Err("a rotated grid, which is not supported".to_owned());
                }
                found = Some(([columns, rows], blank, transform([west, south], [dx, dy])?));
            }
            b"DATA" => {
                let (size, blank, transform) = found.ok_or("samples before the section GRID")?;
                return Ok(header(size, Sample::F64, at, blank, transform));
            }
            _ => {}
        }
        at = at.saturating_add(length);
    }
    Err("no section with samples".to_owned())
}

/// A grid of text.
struct Text {
    path: PathBuf,
    options: RasterOptions,
    size: [usize; 2],
    state: FileState,
}

/// Reads the header of a text. The error is the reason.
fn text_header<R: std::io::BufRead>(words: &mut Words<R>) -> Result<([usize; 2], GeoTransform), String> {
    words.next()?;
    let mut next = || {
        let word = words.next()?.ok_or("its header is cut off")?;
        number(&word).filter(|n| n.is_finite()).ok_or_else(|| format!("`{}` in its header", word.escape_debug()))
    };
    let sides = [next()?, next()?];
    let is_valid = sides.iter().all(|n| n.fract() == 0.0 && *n >= 1.0) && sides[0] * sides[1] <= MAX_SAMPLES as f64;
    if !is_valid {
        return Err(format!("{} x {} samples", sides[0], sides[1]));
    }
    let size = sides.map(|side| side as usize);
    let ([x, y], _) = ([[next()?, next()?], [next()?, next()?]], [next()?, next()?]);
    Ok((size, transform([x[0], y[0]], steps(size, x, y))?))
}

fn open_text(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let state = FileState::of(path)?;
    let (size, transform) = text_header(&mut words(path)?).map_err(|reason| bad(path, &reason))?;
    // A sample has a digit and a space at least.
    if (size[0] * size[1]) as u64 > state.bytes() / 2 + 1 {
        return Err(bad(path, &format!("{} bytes for {} x {} samples", state.bytes(), size[0], size[1])));
    }
    let placement = Placement::of_unnamed(path, transform, size, options.crs.clone(), cache)?;
    let text = Text { path: path.to_owned(), options: options.clone(), size, state };
    let (grid, reader) = whole(Box::new(text), size, cache);
    Ok(Opened { grid, reader, placement })
}

impl WholeReader for Text {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        self.state.check(&self.path)?;
        let bad = |reason: String| bad(&self.path, &reason);
        let mut words = words(&self.path)?;
        text_header(&mut words).map_err(bad)?;
        let mut row = Vec::with_capacity(self.size[0]);
        while let Some(word) = words.next().map_err(bad)? {
            let sample = number(&word).ok_or_else(|| bad(format!("a sample is `{}`", word.escape_debug())))?;
            let height_m = if sample >= BLANK { f32::NAN } else { self.options.height_m(sample as f32) };
            row.push(height_m.to_bits());
            if row.len() == self.size[0] {
                call(&row)?;
                row.clear();
            }
        }
        call(&row)
    }

    fn path(&self) -> &Path {
        &self.path
    }
}
