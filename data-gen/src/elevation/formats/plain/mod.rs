//! Rasters of plain samples whose layout is in a text file beside them (`.hdr`): those of ESRI and the USGS (`.bil`, `.bip`,
//! `.bsq`, `.flt`, GTOPO30's `.dem`) and of ENVI.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{MAX_SAMPLES, Opened, RasterOptions, height_bits};
use crate::GenError;
use crate::georeference::{GeoTransform, Metadata, Placement};
use crate::store::{BlockCache, BlockGrid, BlockReader, FileState, Rect, text_of, with_extension, with_more};

/// The largest number of samples in a block.
const MAX_BLOCK: usize = 1 << 20;
/// The largest number of rows in a block.
const MAX_ROWS: usize = 64;

/// The type of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sample {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    F32,
    F64,
}

impl Sample {
    fn bytes(self) -> u64 {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Returns the value of a sample; its bytes start with the lowest one.
    fn value(self, b: [u8; 8]) -> f64 {
        let four = [b[0], b[1], b[2], b[3]];
        match self {
            Self::U8 => f64::from(b[0]),
            Self::I8 => f64::from(b[0] as i8),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U32 => f64::from(u32::from_le_bytes(four)),
            Self::I32 => f64::from(i32::from_le_bytes(four)),
            Self::F32 => f64::from(f32::from_le_bytes(four)),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

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
    /// The value of samples without data.
    nodata: Option<f64>,
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
    /// Reads the text of a header. The error is the reason.
    fn parse(text: &str, raster: &Path) -> Result<Self, String> {
        match text.trim_start().starts_with("ENVI") {
            true => Self::of_envi(text),
            false => Self::of_esri(text, raster),
        }
    }

    /// Reads a header of lines with a name and a value.
    fn of_esri(text: &str, raster: &Path) -> Result<Self, String> {
        let entries: Vec<(String, &str)> = text
            .lines()
            .filter_map(|line| line.trim().split_once(char::is_whitespace))
            .map(|(name, value)| (name.to_ascii_lowercase(), value.split_whitespace().next().unwrap_or_default()))
            .collect();
        let named = |name: &str| entries.iter().find(|(own, _)| own == name).map(|(_, value)| *value);
        let number = |name: &str| named(name).map(|value| finite(value, name)).transpose();
        let whole = |name: &str| named(name).map(|value| whole(value, name)).transpose();
        let needed = |name: &str| whole(name)?.ok_or_else(|| format!("no {name} in the header"));
        let size = [needed("ncols")?, needed("nrows")?].map(|side| side as usize);
        let bands = whole("nbands")?.unwrap_or(1) as usize;
        let is_float = raster.extension().is_some_and(|e| e.eq_ignore_ascii_case("flt"));
        let bits = whole("nbits")?.unwrap_or(if is_float { 32 } else { 8 });
        let kind = named("pixeltype").map(str::to_ascii_lowercase);
        let kind = kind.as_deref().unwrap_or(if is_float { "float" } else { "" });
        let is_unsigned = kind.starts_with('u');
        let sample = match (bits, kind) {
            (32, kind) if kind.starts_with('f') => Sample::F32,
            (64, kind) if kind.starts_with('f') => Sample::F64,
            (8, kind) if kind.starts_with('s') => Sample::I8,
            (8, _) => Sample::U8,
            (16, _) => {
                if is_unsigned {
                    Sample::U16
                } else {
                    Sample::I16
                }
            }
            (32, _) => {
                if is_unsigned {
                    Sample::U32
                } else {
                    Sample::I32
                }
            }
            (bits, kind) => return Err(format!("samples of {bits} bits {kind}")),
        };
        let order = named("byteorder").unwrap_or("I").to_ascii_uppercase();
        let interleave = match named("layout").unwrap_or("BIL").to_ascii_uppercase().as_str() {
            "BIL" => Interleave::Lines,
            "BIP" => Interleave::Pixels,
            "BSQ" => Interleave::Bands,
            other => return Err(format!("its layout is `{other}`")),
        };
        let row = size[0] as u64 * sample.bytes();
        let (row_bytes, band_bytes) = match interleave {
            Interleave::Lines => (whole("totalrowbytes")?, whole("bandrowbytes")?),
            Interleave::Pixels => (whole("totalrowbytes")?, None),
            Interleave::Bands => {
                let own = whole("bandrowbytes")?.unwrap_or(row);
                let gap = whole("bandgapbytes")?.unwrap_or(0);
                (Some(own), own.checked_mul(size[1] as u64).and_then(|bytes| bytes.checked_add(gap)))
            }
        };
        let cell = number("cellsize")?;
        let step = |name: &str| Ok(cell.or(number(name)?).unwrap_or(1.0)) as Result<f64, String>;
        let (dx, dy) = (step("xdim")?, step("ydim")?);
        // The map coordinates are those of the centre of the north-western pixel; corners are those in the south-west.
        let place = |names: [&str; 3], step: f64, below: f64| {
            let [upper, corner, center] = [number(names[0])?, number(names[1])?, number(names[2])?];
            let upper = upper.map(|center| center - 0.5 * step);
            let found = upper.or(corner.map(|edge| edge + below)).or(center.map(|at| at - 0.5 * step.abs() + below));
            found.ok_or_else(|| format!("neither {} nor {} in the header", names[0], names[1]))
        };
        let west = place(["ulxmap", "xllcorner", "xllcenter"], dx, 0.0)?;
        let north = place(["ulymap", "yllcorner", "yllcenter"], -dy, dy * size[1] as f64)?;
        Ok(Self {
            size,
            bands,
            sample,
            is_big_endian: order.starts_with('M'),
            interleave,
            skipped: whole("skipbytes")?.unwrap_or(0),
            row_bytes,
            band_bytes,
            nodata: number("nodata")?.or(number("nodata_value")?),
            transform: GeoTransform { origin: [west, north], dx: [dx, 0.0], dy: [0.0, -dy] },
            system: None,
        })
    }

    /// Reads a header of ENVI: `name = value`, where braces may hold several values and lines.
    fn of_envi(text: &str) -> Result<Self, String> {
        let entries = envi_entries(text);
        let named = |name: &str| entries.iter().find(|(own, _)| own == name).map(|(_, value)| value.as_str());
        let number = |name: &str| named(name).map(|value| finite(value, name)).transpose();
        let whole = |name: &str| named(name).map(|value| whole(value, name)).transpose();
        let needed = |name: &str| whole(name)?.ok_or_else(|| format!("no `{name}` in the header"));
        let sample = match needed("data type")? {
            1 => Sample::U8,
            2 => Sample::I16,
            3 => Sample::I32,
            4 => Sample::F32,
            5 => Sample::F64,
            12 => Sample::U16,
            13 => Sample::U32,
            other => return Err(format!("its data type is {other}")),
        };
        let interleave = match named("interleave").unwrap_or("bsq").to_ascii_lowercase().as_str() {
            "bil" => Interleave::Lines,
            "bip" => Interleave::Pixels,
            "bsq" => Interleave::Bands,
            other => return Err(format!("its interleave is `{other}`")),
        };
        let map: Vec<&str> =
            named("map info").ok_or("no `map info` in the header")?.split(',').map(str::trim).collect();
        if map.iter().any(|part| part.strip_prefix("rotation=").is_some_and(|angle| angle.parse() != Ok(0.0))) {
            return Err("a rotated map, which is not supported".to_owned());
        }
        let at = |k: usize| finite(map.get(k).copied().unwrap_or_default(), "map info");
        let (dx, dy) = (at(5)?, at(6)?);
        let origin = [at(3)? - (at(1)? - 1.0) * dx, at(4)? + (at(2)? - 1.0) * dy];
        let utm = || {
            let zone: u32 = map.get(7)?.parse().ok().filter(|zone| (1..=60).contains(zone))?;
            let is_wgs84 = map.get(9).is_some_and(|datum| datum.replace(['-', ' '], "").eq_ignore_ascii_case("WGS84"));
            let first = if map.get(8)?.eq_ignore_ascii_case("North") { 32600 } else { 32700 };
            is_wgs84.then(|| format!("EPSG:{}", first + zone))
        };
        let system = named("coordinate system string").filter(|wkt| !wkt.is_empty()).map(str::to_owned);
        let system = system.or_else(|| if map[0].eq_ignore_ascii_case("UTM") { utm() } else { None });
        Ok(Self {
            size: [needed("samples")? as usize, needed("lines")? as usize],
            bands: whole("bands")?.unwrap_or(1) as usize,
            sample,
            is_big_endian: whole("byte order")? == Some(1),
            interleave,
            skipped: whole("header offset")?.unwrap_or(0),
            row_bytes: None,
            band_bytes: None,
            nodata: number("data ignore value")?,
            transform: GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] },
            system,
        })
    }

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

/// Reads a finite number. The error is the reason.
fn finite(text: &str, name: &str) -> Result<f64, String> {
    text.parse().ok().filter(|n: &f64| n.is_finite()).ok_or_else(|| format!("{name} is `{}`", text.escape_debug()))
}

/// Reads a whole number of at most 15 digits. The error is the reason.
fn whole(text: &str, name: &str) -> Result<u64, String> {
    let number = finite(text, name)?;
    let is_whole = number.fract() == 0.0 && (0.0..1e15).contains(&number);
    if is_whole { Ok(number as u64) } else { Err(format!("{name} is {number}")) }
}

/// Returns the names and values of a header of ENVI, without braces.
fn envi_entries(text: &str) -> Vec<(String, String)> {
    let mut entries = Vec::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let Some((name, value)) = line.split_once('=') else { continue };
        let mut value = value.trim().to_owned();
        if value.starts_with('{') {
            while !value.contains('}')
                && let Some(line) = lines.next()
            {
                value.push(' ');
                value.push_str(line.trim());
            }
            value = value.trim_start_matches('{').split('}').next().unwrap_or_default().trim().to_owned();
        }
        entries.push((name.trim().to_ascii_lowercase(), value));
    }
    entries
}

/// A raster, read by seeking.
struct Plain {
    path: PathBuf,
    header: Header,
    steps: Steps,
    options: RasterOptions,
    state: FileState,
}

/// Opens a raster that has such a header beside it. `None` without one.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Option<Opened>, GenError> {
    let Some((beside, text)) = header_text(path, cache)? else { return Ok(None) };
    let header = Header::parse(&text, path).map_err(|reason| GenError::invalid(&beside, reason))?;
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
        Some(text) => Metadata::of_system(&beside, text),
        None => Metadata::beside(path, cache)?,
    };
    let placement = Placement::of_header(path, header.transform, header.size, options.crs.clone(), &system, cache)?;
    let rows = (MAX_BLOCK / header.size[0]).clamp(1, MAX_ROWS);
    let grid = BlockGrid::new(header.size, [header.size[0], rows]);
    let plain = Plain { path: path.to_owned(), header, steps, options: options.clone(), state };
    Ok(Some(Opened { grid, reader: Box::new(plain), placement }))
}

/// Returns the header beside a raster: with its extension replaced, or with one more.
fn header_text(path: &Path, cache: &Arc<BlockCache>) -> Result<Option<(PathBuf, String)>, GenError> {
    let is_header = |bytes: &[u8]| {
        let text = String::from_utf8_lossy(bytes).to_ascii_lowercase();
        text.trim_start().starts_with("envi") || text.contains("nrows")
    };
    for beside in [with_extension(path, "hdr"), with_more(path, "hdr")] {
        if beside != path
            && let Some(text) = text_of(&beside, cache, is_header)?
        {
            return Ok(Some((beside, text)));
        }
    }
    Ok(None)
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
            let at = start + y as u64 * row + (block.column * column) as u64;
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
                if is_unknown { f32::NAN } else { self.options.height_m(value as f32) }
            }));
        }
        Ok(height_bits(heights))
    }
}
