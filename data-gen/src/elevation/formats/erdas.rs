//! Erdas Imagine (`.img`): a tree of named entries, of which those of the type `Eimg_Layer` are the bands. Their samples are
//! blocks, plain or with few bits for each sample, and runs of equal ones.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::plain::Sample;
use super::{MAX_SAMPLES, Opened, RasterOptions, height_bits};
use crate::GenError;
use crate::georeference::{GeoTransform, Metadata, Placement};
use crate::store::{BlockCache, BlockGrid, BlockReader, FileState, Rect};

/// The most entries and the largest content of one that is read at once.
const MAX_ENTRIES: usize = 1 << 16;
const MAX_ENTRY_BYTES: usize = 1 << 20;
/// The largest side of a block.
const MAX_BLOCK: u32 = 2048;
/// The lengths of an entry, of a block in the table of blocks, and of the head of a compressed block.
const ENTRY_BYTES: usize = 128;
const BLOCK_BYTES: u64 = 14;
const PACKED_HEAD_BYTES: usize = 13;
/// The bytes before the bits that tell which blocks of another file were written.
const FLAGS_HEAD_BYTES: u64 = 20;

/// Reads numbers one after another.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (found, rest) = self.0.split_at_checked(count).ok_or("an entry is cut off")?;
        self.0 = rest;
        Ok(found)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        self.take(N).map(|bytes| bytes.try_into().expect("it has that length"))
    }

    fn short(&mut self) -> Result<u16, String> {
        self.array().map(u16::from_le_bytes)
    }

    fn long(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_le_bytes)
    }

    fn double(&mut self) -> Result<f64, String> {
        self.array().map(f64::from_le_bytes)
    }

    /// Reads the head of values that lie apart: their number.
    fn count(&mut self) -> Result<usize, String> {
        let count = self.long()? as usize;
        self.long().map(|_| count)
    }

    fn text(&mut self) -> Result<String, String> {
        let count = self.count()?;
        let bytes = self.take(count)?;
        Ok(String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned())
    }
}

/// The type of a band's samples.
#[derive(Clone, Copy, Debug, PartialEq)]
enum BandSample {
    /// A number of bits, at most 4.
    Bits(u32),
    Whole(Sample),
}

impl BandSample {
    fn of(number: u16) -> Result<Self, String> {
        use Sample::{F32, F64, I8, I16, I32, U8, U16, U32};
        match number {
            0..=2 => Ok(Self::Bits(1 << number)),
            _ => {
                let known = [U8, I8, U16, I16, U32, I32, F32, F64].get(usize::from(number) - 3);
                known.copied().map(Self::Whole).ok_or_else(|| "complex samples are not heights".to_owned())
            }
        }
    }

    fn bits(self) -> usize {
        match self {
            Self::Bits(bits) => bits as usize,
            Self::Whole(sample) => 8 * sample.bytes() as usize,
        }
    }

    /// Returns the value of a sample with an index in the bytes of a block.
    fn at(self, bytes: &[u8], k: usize) -> f64 {
        match self {
            Self::Bits(bits) => f64::from(small(bytes, k, bits)),
            Self::Whole(sample) => {
                let count = sample.bytes() as usize;
                let mut number = [0; 8];
                number[..count].copy_from_slice(&bytes[k * count..][..count]);
                sample.value(number)
            }
        }
    }

    /// Returns the value of a sample of a compressed block. Its highest bits do not count if it has fewer than 32.
    fn of_bits(self, bits: u32) -> f64 {
        match self {
            Self::Bits(_) => f64::from(bits as u8),
            Self::Whole(sample) => sample.value(u64::from(bits).to_le_bytes()),
        }
    }
}

/// Returns a number of at most 4 bits; the first one is in the lowest bits.
fn small(bytes: &[u8], k: usize, bits: u32) -> u32 {
    let at = k * bits as usize;
    (u32::from(bytes[at / 8]) >> (at % 8)) & ((1 << bits) - 1)
}

/// An entry of the tree.
struct Entry {
    name: String,
    kind: String,
    child: u32,
    next: u32,
    data: u32,
    bytes: u32,
}

/// A file, read by seeking.
struct Tree {
    file: File,
    length: u64,
}

impl Tree {
    fn read(&mut self, at: u64, count: usize) -> Result<Vec<u8>, String> {
        if at.checked_add(count as u64).is_none_or(|end| end > self.length) {
            return Err(format!("{} bytes, and more are needed", self.length));
        }
        let mut bytes = vec![0; count];
        self.file
            .seek(SeekFrom::Start(at))
            .and_then(|_| self.file.read_exact(&mut bytes))
            .map_err(|e| e.to_string())?;
        Ok(bytes)
    }

    fn entry(&mut self, at: u32) -> Result<Entry, String> {
        let bytes = self.read(at.into(), ENTRY_BYTES)?;
        let mut fields = Fields(&bytes);
        let [next, _, _, child, data, length] =
            [fields.long()?, fields.long()?, fields.long()?, fields.long()?, fields.long()?, fields.long()?];
        let mut text = |count: usize| {
            let bytes = fields.take(count)?;
            let end = bytes.iter().position(|b| *b == 0).unwrap_or(count);
            Ok::<_, String>(String::from_utf8_lossy(&bytes[..end]).into_owned())
        };
        Ok(Entry { name: text(64)?, kind: text(32)?, child, next, data, bytes: length })
    }

    /// Returns the entries directly below one.
    fn children(&mut self, entry: &Entry) -> Result<Vec<Entry>, String> {
        let mut found = Vec::new();
        let mut at = entry.child;
        while at != 0 {
            if found.len() >= MAX_ENTRIES {
                return Err(format!("more than {MAX_ENTRIES} entries"));
            }
            found.push(self.entry(at)?);
            at = found.last().map_or(0, |entry: &Entry| entry.next);
        }
        Ok(found)
    }

    fn content(&mut self, entry: &Entry) -> Result<Vec<u8>, String> {
        self.read(entry.data.into(), (entry.bytes as usize).min(MAX_ENTRY_BYTES))
    }
}

/// The blocks of a band.
enum Blocks {
    /// In the file itself, with a table of them at this position.
    Listed(u64),
    /// In another file beside it (`.ige`), whose blocks are not compressed.
    Beside(Beside),
}

/// The blocks of a band in another file.
struct Beside {
    path: PathBuf,
    state: FileState,
    /// The positions of the bits that tell which blocks were written, and of the first block.
    flags: u64,
    first: u64,
    /// The number of bands in the file, and the number of this one from 0 on.
    bands: u64,
    band: u64,
}

/// A band.
struct Band {
    grid: BlockGrid,
    sample: BandSample,
    blocks: Blocks,
    nodata: Option<f64>,
    transform: GeoTransform,
    system: Option<String>,
}

/// A file whose blocks are read by seeking.
struct Erdas {
    path: PathBuf,
    band: Band,
    options: RasterOptions,
    state: FileState,
}

/// Opens a file and reads the entries of its bands.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let state = FileState::of(path)?;
    let file = File::open(path).map_err(GenError::file(path))?;
    let band = band(path, Tree { file, length: state.bytes() }, options).map_err(|reason| bad(path, &reason))?;
    let metadata = match &band.system {
        Some(text) => Metadata::of_system(path, text),
        None => Metadata::beside(path, cache)?,
    };
    let grid = band.grid;
    let placement = Placement::of_header(path, band.transform, grid.size, options.crs.clone(), &metadata, cache)?;
    let reader = Erdas { path: path.to_owned(), band, options: options.clone(), state };
    Ok(Opened { grid, reader: Box::new(reader), placement })
}

fn bad(path: &Path, reason: &dyn std::fmt::Display) -> GenError {
    GenError::invalid(path, format!("Erdas Imagine: {reason}"))
}

/// Reads the entries of a band. The error is the reason.
fn band(path: &Path, mut tree: Tree, options: &RasterOptions) -> Result<Band, String> {
    let header = tree.read(16, 4)?;
    let header = tree.read(Fields(&header).long()?.into(), 18)?;
    let root = tree.entry(Fields(&header[8..]).long()?)?;
    let mut layers = tree.children(&root)?;
    layers.retain(|entry| entry.kind == "Eimg_Layer");
    let number = match (&options.channel, layers.len()) {
        (_, 0) => return Err("no band".to_owned()),
        (None, 1) => 1,
        (None, count) => return Err(format!("{count} bands; elevation has one channel, --channel N chooses it")),
        (Some(name), count) => {
            let number = name.parse().ok().filter(|n| (1..=count).contains(n));
            number.ok_or_else(|| format!("--channel {name}: the file has bands 1 to {count}"))?
        }
    };
    let layer = layers.swap_remove(number - 1);
    let content = tree.content(&layer)?;
    let mut fields = Fields(&content);
    let size = [fields.long()?, fields.long()?];
    let (_, kind) = (fields.short()?, fields.short()?);
    let block = [fields.long()?, fields.long()?];
    let is_sane = size.iter().all(|side| *side > 0) && u64::from(size[0]) * u64::from(size[1]) <= MAX_SAMPLES as u64;
    if !is_sane || !block.iter().all(|side| (1..=MAX_BLOCK).contains(side)) {
        return Err(format!("{} x {} samples in blocks of {} x {}", size[0], size[1], block[0], block[1]));
    }
    // Blocks beyond the edges are whole in the file.
    let grid = BlockGrid { size: size.map(|side| side as usize), block: block.map(|side| side as usize) };
    let [across, down] = grid.blocks();
    let parts = tree.children(&layer)?;
    let part = |name: &str| parts.iter().find(|entry| entry.name == name);
    let blocks = match (part("RasterDMS"), part("ExternalRasterDMS")) {
        (Some(entry), _) => {
            let content = tree.content(entry)?;
            let mut fields = Fields(content.get(14..).unwrap_or_default());
            let (count, table) = (fields.long()? as usize, fields.long()?);
            if count < across * down || u64::from(table) + count as u64 * BLOCK_BYTES > tree.length {
                return Err(format!("a table of {count} blocks for {across} x {down}"));
            }
            Blocks::Listed(table.into())
        }
        (None, Some(entry)) => Blocks::Beside(Beside::read(path, &tree.content(entry)?)?),
        (None, None) => return Err("a band without samples".to_owned()),
    };
    let nodata = part("Eimg_NonInitializedValue").map(|entry| tree.content(entry)).transpose()?;
    let nodata = nodata.and_then(|content| nodata_of(&content));
    let map = part("Map_Info").map(|entry| tree.content(entry)).transpose()?.ok_or("no georeference")?;
    let transform = map_info(&map)?;
    let described = part("ProjectionX").map(|entry| tree.content(entry)).transpose()?;
    let mut system = described.and_then(|content| wkt_in(&content));
    if let (None, Some(entry)) = (&system, part("Projection")) {
        let (content, below) = (tree.content(entry)?, tree.children(entry)?);
        let datum = below.iter().find(|entry| entry.kind == "Eprj_Datum");
        let datum = datum.map(|entry| tree.content(entry)).transpose()?;
        let datum = datum.and_then(|content| Fields(&content).text().ok()).unwrap_or_default();
        system = match definition(&content, &datum) {
            Ok(definition) => Some(definition),
            Err(_) if options.crs.is_some() => None,
            Err(reason) => return Err(reason),
        };
    }
    Ok(Band { grid, sample: BandSample::of(kind)?, blocks, nodata, transform, system })
}

/// Returns the value of samples without data: a matrix of one number.
fn nodata_of(content: &[u8]) -> Option<f64> {
    let mut fields = Fields(content);
    fields.count().ok()?;
    let [rows, columns] = [fields.long().ok()?, fields.long().ok()?];
    let sample = BandSample::of(fields.short().ok()?).ok()?;
    fields.short().ok()?;
    let is_one = rows == 1 && columns == 1 && fields.0.len() * 8 >= sample.bits();
    is_one.then(|| sample.at(fields.0, 0))
}

/// Reads the position of the north-western pixel and the size of pixels. The error is the reason.
fn map_info(content: &[u8]) -> Result<GeoTransform, String> {
    let mut fields = Fields(content);
    fields.text()?;
    let mut pair = || {
        fields.count()?;
        Ok::<_, String>([fields.double()?, fields.double()?])
    };
    let ([x, y], [_, south], [dx, dy]) = (pair()?, pair()?, pair()?);
    if !([x, y, south].iter().all(|n| n.is_finite()) && dx > 0.0 && dy > 0.0) {
        return Err(format!("its first pixel is at {x}, {y}, pixels have {dx} x {dy}"));
    }
    let dy = if south > y { dy } else { -dy };
    Ok(GeoTransform { origin: [x - 0.5 * dx, y - 0.5 * dy], dx: [dx, 0.0], dy: [0.0, dy] })
}

/// Returns the WKT in an entry.
fn wkt_in(content: &[u8]) -> Option<String> {
    let start = [&b"PROJCS["[..], b"GEOGCS["].iter().find_map(|name| content.windows(7).position(|w| w == *name))?;
    let text = &content[start..];
    let end = text.iter().position(|b| *b == 0).unwrap_or(text.len());
    std::str::from_utf8(&text[..end]).ok().map(str::to_owned)
}

/// Returns a projection by its number and parameters in PROJ's notation. The error is the reason.
fn definition(content: &[u8], datum: &str) -> Result<String, String> {
    let mut fields = Fields(content);
    fields.short()?;
    let number = fields.long()?;
    let _names = [fields.text()?, fields.text()?];
    let zone = fields.long()?;
    let count = fields.count()?;
    let mut parameters = [0.0; 15];
    for parameter in parameters.iter_mut().take(count) {
        *parameter = fields.double()?;
    }
    fields.take(8 * count.saturating_sub(parameters.len()))?;
    fields.count()?;
    let _sphere = fields.text()?;
    let [a, b] = [fields.double()?, fields.double()?];
    let upper = datum.to_uppercase();
    let shape = match &*upper {
        _ if upper.contains("WGS") && upper.contains("84") => "+datum=WGS84".to_owned(),
        _ if upper.contains("NAD83") || upper.contains("GRS80") || upper.contains("ETRS") => "+ellps=GRS80".to_owned(),
        _ if upper.contains("NAD27") => "+datum=NAD27".to_owned(),
        // Another datum of the earth needs a shift; other bodies do not.
        _ if a > 0.0 && b > 0.0 && !(6.3e6..6.5e6).contains(&a) => format!("+a={a} +b={b}"),
        _ => return Err(format!("the datum `{}`; --epsg CODE names the reference system", datum.escape_debug())),
    };
    let degrees = |k: usize| parameters[k].to_degrees();
    let at = |latitude: &str| {
        format!("+{latitude}={} +lon_0={} +x_0={} +y_0={}", degrees(5), degrees(4), parameters[6], parameters[7])
    };
    let parallels = || format!("+lat_1={} +lat_2={}", degrees(2), degrees(3));
    let projection = match number {
        0 => "+proj=longlat".to_owned(),
        1 => format!("+proj=utm +zone={zone}{}", if parameters[3] < 0.0 { " +south" } else { "" }),
        3 => format!("+proj=aea {} {}", parallels(), at("lat_0")),
        4 => format!("+proj=lcc {} {}", parallels(), at("lat_0")),
        5 => format!("+proj=merc {}", at("lat_ts")),
        6 => format!("+proj=stere +lat_0={} {}", if parameters[5] < 0.0 { -90 } else { 90 }, at("lat_ts")),
        9 => format!("+proj=tmerc +k={} {}", parameters[2], at("lat_0")),
        11 => format!("+proj=laea {}", at("lat_0")),
        _ => return Err(format!("the projection with the number {number}; --epsg CODE names the reference system")),
    };
    Ok(format!("{projection} {shape}"))
}

/// Decodes a compressed block. The error is the reason.
fn unpack(bytes: &[u8], sample: BandSample, count: usize) -> Result<Vec<f64>, String> {
    let mut head = Fields(bytes);
    let (low, runs, values) = (head.long()?, head.long()?, head.long()? as usize);
    let bits = u32::from(head.array::<1>()?[0]);
    if ![0, 1, 2, 4, 8, 16, 32].contains(&bits) {
        return Err(format!("a block of {bits} bits a sample"));
    }
    let cut = || "a block is cut off".to_owned();
    let is_plain = runs == u32::MAX;
    let packed = bytes.get(if is_plain { PACKED_HEAD_BYTES } else { values }..).ok_or_else(cut)?;
    // Numbers of more than 4 bits begin with their highest byte.
    let value = |k: usize| {
        let width = bits as usize / 8;
        let found = match bits {
            0 => 0,
            1..8 if k * bits as usize / 8 < packed.len() => small(packed, k, bits),
            8.. => {
                packed.get(k * width..(k + 1) * width).ok_or_else(cut)?.iter().fold(0, |n, b| n << 8 | u32::from(*b))
            }
            _ => return Err(cut()),
        };
        Ok::<_, String>(sample.of_bits(found.wrapping_add(low)))
    };
    if is_plain {
        return (0..count).map(value).collect();
    }
    let mut found = Vec::with_capacity(count);
    for k in 0..runs as usize {
        // The two highest bits tell how many bytes follow the first.
        let first = head.array::<1>()?[0];
        let more = head.take(usize::from(first >> 6))?;
        let length = more.iter().fold(usize::from(first & 0x3f), |n, b| n << 8 | usize::from(*b));
        if length > count - found.len() {
            return Err("a block has runs of more samples than it holds".to_owned());
        }
        found.resize(found.len() + length, value(k)?);
    }
    if found.len() == count { Ok(found) } else { Err(format!("a block has {} of {count} samples", found.len())) }
}

impl Beside {
    /// Reads the entry that names the file. The error is the reason.
    fn read(path: &Path, content: &[u8]) -> Result<Self, String> {
        let mut fields = Fields(content);
        let name = fields.text()?;
        // It lies beside the file, wherever it was written.
        let name = name.rsplit(['/', '\\']).next().unwrap_or_default();
        let path = path.with_file_name(name);
        let state = FileState::of(&path).map_err(|e| e.to_string())?;
        let mut double_long = || Ok::<_, String>(u64::from(fields.long()?) | u64::from(fields.long()?) << 32);
        let (flags, first) = (double_long()?, double_long()?);
        let [bands, band] = [fields.long()?, fields.long()?].map(u64::from);
        Ok(Self { path, state, flags, first, bands, band })
    }

    /// Returns the bytes of a block; `None` for one that was never written. The error is the reason.
    fn block(&self, grid: &BlockGrid, index: u64, bytes: usize) -> Result<Option<Vec<u8>>, String> {
        self.state.check(&self.path).map_err(|e| e.to_string())?;
        let file = File::open(&self.path).map_err(|e| format!("{}: {e}", self.path.display()))?;
        let mut tree = Tree { file, length: self.state.bytes() };
        let across = grid.blocks()[0] as u64;
        let (row, column) = (index / across, index % across);
        let beyond = || "a block beyond the file".to_owned();
        let at = self.flags.checked_add(FLAGS_HEAD_BYTES + row * across.div_ceil(8) + column / 8).ok_or_else(beyond)?;
        if tree.read(at, 1)?[0] >> (column % 8) & 1 == 0 {
            return Ok(None);
        }
        let block = index.checked_mul(self.bands).and_then(|block| block.checked_add(self.band));
        let at = block.and_then(|block| block.checked_mul(bytes as u64)?.checked_add(self.first)).ok_or_else(beyond)?;
        tree.read(at, bytes).map(Some)
    }
}

impl Erdas {
    /// Reads all samples of the block with an index; `None` for one that was never written. The error is the reason.
    fn block(&self, index: u64) -> Result<Option<Vec<f64>>, String> {
        let Band { grid, sample, blocks, .. } = &self.band;
        let count = grid.block[0] * grid.block[1];
        let plain_bytes = (count * sample.bits()).div_ceil(8);
        let plain = |bytes: Vec<u8>| (0..count).map(|k| sample.at(&bytes, k)).collect::<Vec<f64>>();
        let table = match blocks {
            Blocks::Listed(table) => table,
            Blocks::Beside(beside) => return Ok(beside.block(grid, index, plain_bytes)?.map(plain)),
        };
        let file = File::open(&self.path).map_err(|e| e.to_string())?;
        let mut tree = Tree { file, length: self.state.bytes() };
        let entry = tree.read(table + index * BLOCK_BYTES, BLOCK_BYTES as usize)?;
        let mut fields = Fields(&entry);
        let (_, at, length) = (fields.short()?, fields.long()?, fields.long()? as usize);
        let (is_valid, compression) = (fields.short()?, fields.short()?);
        if is_valid == 0 {
            return Ok(None);
        }
        match compression {
            0 => tree.read(at.into(), plain_bytes).map(|bytes| Some(plain(bytes))),
            // Blocks that do not shrink are a little longer.
            1 if *sample != BandSample::Whole(Sample::F64) && length <= 2 * plain_bytes + MAX_ENTRY_BYTES => {
                unpack(&tree.read(at.into(), length)?, *sample, count).map(Some)
            }
            other => Err(format!("a block of {length} bytes with the compression {other}")),
        }
    }
}

impl BlockReader for Erdas {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        self.state.check(&self.path)?;
        let Band { grid, nodata, .. } = &self.band;
        let (_, index) = grid.block_of(block.column, block.row);
        let Some(samples) = self.block(index).map_err(|reason| bad(&self.path, &reason))? else {
            // GDAL reads blocks that were never written as nodata, or as 0.
            let height_m = if nodata.is_some() { f32::NAN } else { 0.0 };
            return Ok(height_bits(vec![height_m; block.pixels()]));
        };
        let height_m = |sample: f64| match *nodata == Some(sample) {
            true => f32::NAN,
            false => self.options.height_m(sample as f32),
        };
        let rows = samples.chunks_exact(grid.block[0]).take(block.height);
        Ok(height_bits(rows.flat_map(|row| &row[..block.width]).map(|sample| height_m(*sample)).collect()))
    }
}
