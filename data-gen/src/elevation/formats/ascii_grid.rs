//! ASCII grids of ESRI and GDAL: a header of names and numbers, then the samples, north row first.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{MAX_SAMPLES, Opened, RasterOptions};
use crate::GenError;
use crate::georeference::{GeoTransform, Placement};
use crate::store::{BlockCache, FileState, WholeReader, whole};

/// The header of an ASCII grid.
#[derive(Debug)]
struct Header {
    size: [usize; 2],
    transform: GeoTransform,
    /// The value of samples without data.
    nodata: f64,
}

/// An ASCII grid.
struct AsciiGrid {
    path: PathBuf,
    options: RasterOptions,
    size: [usize; 2],
    state: FileState,
}

/// Opens an ASCII grid and reads its header.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let state = FileState::of(path)?;
    let header = Header::read(&mut words(path)?).map_err(|reason| bad(path, reason))?;
    // A sample has a digit and a space at least.
    if (header.size[0] * header.size[1]) as u64 > state.bytes() / 2 + 1 {
        let reason = format!("{} bytes for {} x {} samples", state.bytes(), header.size[0], header.size[1]);
        return Err(bad(path, reason));
    }
    let placement = Placement::of_unnamed(path, header.transform, header.size, options.crs.clone(), cache)?;
    let size = header.size;
    let grid = AsciiGrid { path: path.to_owned(), options: options.clone(), size, state };
    let (grid, reader) = whole(Box::new(grid), size, cache);
    Ok(Opened { grid, reader, placement })
}

fn bad(path: &Path, reason: String) -> GenError {
    GenError::invalid(path, format!("ASCII grid: {reason}"))
}

pub(super) fn words(path: &Path) -> Result<Words<BufReader<std::fs::File>>, GenError> {
    let file = std::fs::File::open(path).map_err(GenError::file(path))?;
    Ok(Words { text: BufReader::with_capacity(1 << 16, file), next: None })
}

impl WholeReader for AsciiGrid {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        self.state.check(&self.path)?;
        let mut words = words(&self.path)?;
        let bad = |reason: String| bad(&self.path, reason);
        let header = Header::read(&mut words).map_err(bad)?;
        let (mut row, mut found) = (Vec::new(), 0);
        while let Some(word) = words.next().map_err(bad)? {
            found += 1;
            let sample = number(&word).ok_or_else(|| bad(format!("sample {found} is `{word}`")))?;
            let height_m = if sample == header.nodata { f32::NAN } else { self.options.height_m(sample as f32) };
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

/// The longest word of a grid in bytes: numbers have a few digits.
const MAX_WORD: usize = 400;

/// The words of a text, read one after another.
pub(super) struct Words<R> {
    text: R,
    /// A word that was read and given back.
    next: Option<String>,
}

impl<R: BufRead> Words<R> {
    /// Returns the next word, `None` at the end. The error is the reason.
    pub fn next(&mut self) -> Result<Option<String>, String> {
        if let Some(word) = self.next.take() {
            return Ok(Some(word));
        }
        let mut word = Vec::new();
        loop {
            let buffer = self.text.fill_buf().map_err(|e| e.to_string())?;
            if buffer.is_empty() {
                break;
            }
            let skipped =
                if word.is_empty() { buffer.iter().take_while(|b| b.is_ascii_whitespace()).count() } else { 0 };
            let rest = &buffer[skipped..];
            let length = rest.iter().take_while(|b| !b.is_ascii_whitespace()).count();
            word.extend_from_slice(&rest[..length.min(MAX_WORD + 1)]);
            let is_whole = length < rest.len() && length > 0 || word.len() > MAX_WORD;
            self.text.consume(skipped + length);
            if is_whole || (length == 0 && !word.is_empty()) {
                break;
            }
        }
        if word.len() > MAX_WORD {
            return Err(format!("a word of more than {MAX_WORD} bytes"));
        }
        Ok((!word.is_empty()).then(|| String::from_utf8_lossy(&word).into_owned()))
    }
}

impl Header {
    /// Reads the header. The error is the reason.
    fn read<R: BufRead>(words: &mut Words<R>) -> Result<Self, String> {
        let mut header: Vec<(String, String)> = Vec::new();
        // The first word that is a number begins the samples; the header's words are names such as "ncols".
        while let Some(name) = words.next()? {
            if number(&name).is_some() || header.len() >= MAX_NAMES {
                words.next = Some(name);
                break;
            }
            let value = words.next()?.ok_or_else(|| format!("no value of {name}"))?;
            header.push((name.trim_start_matches('\u{feff}').to_ascii_lowercase(), value));
        }
        for (name, value) in header.iter().filter(|(name, _)| NAMES.contains(&name.as_str())) {
            number(value).ok_or_else(|| format!("{name} is `{value}`, not a number"))?;
        }
        let value = |name: &str| header.iter().find(|(other, _)| other == name).and_then(|(_, value)| number(value));
        let needed = |name: &str| value(name).ok_or_else(|| format!("no {name} in the header"));
        let side = |name: &str| {
            let count = needed(name)?;
            let is_valid = count.fract() == 0.0 && (1.0..=MAX_SAMPLES as f64).contains(&count);
            if is_valid { Ok(count as usize) } else { Err(format!("{name} is {count}")) }
        };
        let (width, height) = (side("ncols")?, side("nrows")?);
        let count = width.checked_mul(height).filter(|count| *count <= MAX_SAMPLES);
        count.ok_or_else(|| format!("{width} x {height} samples"))?;
        let cell = value("cellsize");
        let step = |name: &str| cell.or_else(|| value(name)).ok_or_else(|| "no cellsize in the header".to_owned());
        let (dx, dy) = (step("dx")?, step("dy")?);
        // Corners are those of the south-western cell; centres are half a cell inside.
        let edge = |corner: &str, center: &str, step: f64| match (value(corner), value(center)) {
            (Some(edge), _) => Ok(edge),
            (None, Some(center)) => Ok(center - 0.5 * step),
            (None, None) => Err(format!("neither {corner} nor {center} in the header")),
        };
        let (west, south) = (edge("xllcorner", "xllcenter", dx)?, edge("yllcorner", "yllcenter", dy)?);
        // The format's own value where the header names none.
        let nodata = value("nodata_value").unwrap_or(-9999.0);
        let origin = [west, south + dy * height as f64];
        let transform = GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] };
        Ok(Self { size: [width, height], transform, nodata })
    }
}

/// The names whose values are numbers. Others, such as `byteorder`, do not matter.
const NAMES: [&str; 10] =
    ["ncols", "nrows", "xllcorner", "yllcorner", "xllcenter", "yllcenter", "cellsize", "dx", "dy", "nodata_value"];

/// Returns true for the first bytes of an ASCII grid.
pub(super) fn is_ascii_grid(magic: &[u8]) -> bool {
    let magic = magic.strip_prefix(b"\xef\xbb\xbf").unwrap_or(magic).trim_ascii_start().to_ascii_lowercase();
    [&b"nco"[..], b"nro", b"xll", b"yll", b"dx ", b"cel"].iter().any(|start| magic.starts_with(start))
}

/// Reads a number, which may have a decimal comma. Words of C for what is not a number are NaN.
pub(super) fn number(word: &str) -> Option<f64> {
    match word.parse() {
        Ok(number) => Some(number),
        Err(_) if ["#IND", "#QNAN", "#INF"].iter().any(|name| word.contains(name)) => Some(f64::NAN),
        Err(_) => word.replace(',', ".").parse().ok(),
    }
}

/// The largest number of names in a header.
const MAX_NAMES: usize = 32;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Rect;

    fn heights(text: &str) -> Result<(GeoTransform, Vec<f32>), String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.asc");
        std::fs::write(&path, text).unwrap();
        let opened =
            open(&path, &RasterOptions::default(), &Arc::new(BlockCache::new(0))).map_err(|e| e.to_string())?;
        let [width, height] = opened.grid.size;
        let block = Rect { column: 0, row: 0, width, height };
        let samples = opened.reader.read(block).map_err(|e| e.to_string())?;
        let header = Header::read(&mut words(&path).unwrap())?;
        Ok((header.transform, samples.into_iter().map(f32::from_bits).collect()))
    }

    #[test]
    fn corners_and_centres_place_the_same_grid() {
        let grid = |place: &str| format!("ncols 3\nNROWS 2\n{place}\nNODATA_value -1\n1 2 3\r\n4 -1 6.5\n");
        let (transform, samples) = heights(&grid("xllcorner 7\nyllcorner 45\ncellsize 0.5")).unwrap();
        assert_eq!((transform.origin, transform.dx, transform.dy), ([7.0, 46.0], [0.5, 0.0], [0.0, -0.5]));
        assert_eq!(samples[..4], [1.0, 2.0, 3.0, 4.0]);
        assert!(samples.len() == 6 && samples[4].is_nan() && samples[5] == 6.5);
        let (centred, _) = heights(&grid("xllcenter 7.25\nyllcenter 45.25\ndx 0.5\ndy 0.5")).unwrap();
        assert_eq!(centred, transform);
    }

    /// Regression: decimal commas, byte order marks, C's words for NaN and names of other programs were errors.
    #[test]
    fn grids_of_many_programs_are_read() {
        let grid =
            |header: &str, samples: &str| format!("{header}ncols 2\r\nnrows 1\r\nxllcorner 7\nyllcorner 45\n{samples}");
        for text in [
            grid("\u{feff}", "cellsize 0.5\n1.5 nan"),
            grid("\n  ", "cellsize 0,5\nNODATA_value -9999\n1,5 -1.#IND"),
            grid("", "cellsize 0.5\nbyteorder LSBFIRST\nnodata_value NaN\n15e-1 NaN"),
        ] {
            assert!(is_ascii_grid(&text.as_bytes()[..8]), "{text}");
            let (transform, samples) = heights(&text).unwrap();
            assert_eq!((transform.origin, samples[0], samples[1].is_nan()), ([7.0, 45.5], 1.5, true), "{text}");
        }
        assert!(is_ascii_grid(b"NROWS 12") && !is_ascii_grid(b"notes on"));
    }

    #[test]
    fn wrong_headers_and_counts_are_refused() {
        let all = "ncols 2\nnrows 2\nxllcorner 7\nyllcorner 45\ncellsize 1\n";
        for (text, why) in [
            ("ncols 40\nnrows 40\n".to_owned(), "no cellsize"),
            (all.replace("nrows 2", "nrows -2") + "1 2 3 4", "nrows is -2"),
            (all.replace("ncols 2", "ncols 1e9").replace("nrows 2", "nrows 9") + "1", "samples"),
            (all.replace("xllcorner", "xll") + "1 2 3 4", "neither xllcorner nor xllcenter"),
            (all.to_owned() + "1 2 3", "3 samples for 2 x 2"),
            (all.to_owned() + "1 2 3 4 5", "5 samples for 2 x 2"),
            (all.to_owned() + "1 2 3 high", "sample 4 is `high`"),
            (all.replace("cellsize 1", "cellsize wide"), "cellsize is `wide`"),
            (all.to_owned() + &"1".repeat(500), "a word of more than 400 bytes"),
        ] {
            let error = heights(&text).err().unwrap();
            assert!(error.contains(why), "{error}, not {why}");
        }
    }
}
