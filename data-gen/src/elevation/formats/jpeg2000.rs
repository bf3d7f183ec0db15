//! JPEG 2000 with elevation (ISO 15444-1), in boxes (`.jp2`) or without them (`.j2k`), decoded by the crate `hayro-jpeg2000`. A
//! file is placed by the TIFF in its GeoJP2 box, by GML in its GMLJP2 box (OGC 05-047r3), or by the files beside it.
//!
//! The header is read when a file is opened; a thread of the run decodes the image as a whole.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use hayro_jpeg2000::{DecodeSettings, DecoderContext, Image};
use roxmltree::{Document, Node, ParsingOptions};
use terrane::fetch::DECODER_PANICKED;

use super::{Opened, RasterOptions, height_bits};
use crate::GenError;
use crate::georeference::{GeoTransform, Metadata, Placement};
use crate::store::{BlockCache, FileState, WholeReader, whole};

/// The largest number of samples of all components, which are decoded at once: about those of a tile of Sentinel-2.
const MAX_SAMPLES: u64 = 1 << 27;
/// The number of samples that a file of any length may have, and those that each of its bytes may stand for in a longer one.
const MIN_SAMPLES: u64 = 1 << 20;
const MAX_SAMPLES_PER_BYTE: u64 = 1 << 16;
/// The largest file.
const MAX_FILE_BYTES: u64 = 1 << 30;
/// The largest box with a georeference, the most boxes, and the most boxes inside of one another.
const MAX_BOX_BYTES: u64 = 16 << 20;
const MAX_BOXES: usize = 4096;
const MAX_DEPTH: usize = 4;
/// The largest number of nodes in a document of GML.
const MAX_NODES: u32 = 1 << 16;
/// The most tiles of an image, and the most bits of a sample: heights are 32-bit floats.
const MAX_TILES: u64 = 65_535;
const MAX_BITS: u8 = 24;
/// The bytes of a codestream before its components, and of each component.
const SIZE_BYTES: usize = 42;
const COMPONENT_BYTES: usize = 3;
/// The name of GeoJP2's box.
const GEO_JP2: [u8; 16] = [0xb1, 0x4b, 0xf8, 0xbd, 8, 0x3d, 0x4b, 0x43, 0xa5, 0xae, 0x8c, 0xd7, 0xd5, 0xa6, 0xce, 3];
/// The first bytes of a codestream.
const CODESTREAM: [u8; 4] = [0xff, 0x4f, 0xff, 0x51];

/// Returns true for the first bytes of a file.
pub(super) fn is_jpeg2000(magic: &[u8]) -> bool {
    magic.starts_with(&[0, 0, 0, 12, b'j', b'P']) || magic.starts_with(&CODESTREAM)
}

/// The size of an image, and its samples.
#[derive(Clone, Copy, Debug)]
struct Header {
    size: [usize; 2],
    components: usize,
    /// The component with heights.
    channel: usize,
    bits: u8,
    is_signed: bool,
}

/// The codestream and the georeference in the boxes of a file.
#[derive(Default)]
struct Boxes {
    /// The position of the codestream.
    codestream: Option<u64>,
    /// A TIFF whose tags georeference the image.
    geotiff: Option<Vec<u8>>,
    /// Texts of XML.
    texts: Vec<String>,
}

/// A file, which is decoded as a whole.
struct Jpeg2000 {
    path: PathBuf,
    header: Header,
    options: RasterOptions,
    /// The factor and the offset that convert samples to metres.
    units: [f64; 2],
    state: FileState,
}

/// Opens a file and reads its boxes.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let bad = |reason: String| bad(path, &reason);
    let state = FileState::of(path)?;
    let mut file = File::open(path).map_err(GenError::file(path))?;
    let boxes = Boxes::read(&mut file, state.bytes()).map_err(GenError::file(path))?;
    let start = boxes.codestream.ok_or_else(|| bad("no codestream".to_owned()))?;
    let mut bytes = Vec::new();
    file.seek(SeekFrom::Start(start)).map_err(GenError::file(path))?;
    let longest = (SIZE_BYTES + COMPONENT_BYTES * usize::from(u16::MAX)) as u64;
    file.take(longest).read_to_end(&mut bytes).map_err(GenError::file(path))?;
    let header = Header::parse(&bytes, options.channel.as_deref(), state.bytes()).map_err(bad)?;
    let metadata = Metadata::beside(path, cache)?;
    let units = metadata.factor_and_offset_m(header.channel + 1).map_err(bad)?;
    let nodata = options.nodata.or(metadata.nodata_of(header.channel + 1));
    let placement = placement(path, &boxes, header.size, options, &metadata, cache)?;
    let options = RasterOptions { nodata, ..options.clone() };
    let file = Jpeg2000 { path: path.to_owned(), header, options, units, state };
    let (grid, reader) = whole(Box::new(file), header.size, cache);
    Ok(Opened { grid, reader, placement })
}

fn bad(path: &Path, reason: &dyn std::fmt::Display) -> GenError {
    GenError::invalid(path, format!("JPEG 2000: {reason}"))
}

/// Returns the placement of a file: GDAL's metadata beside it stand above its boxes, and these above a world file.
fn placement(
    path: &Path,
    boxes: &Boxes,
    size: [usize; 2],
    options: &RasterOptions,
    metadata: &Metadata,
    cache: &Arc<BlockCache>,
) -> Result<Placement, GenError> {
    if metadata.transform.is_none() {
        if let Some(tiff) = &boxes.geotiff
            && let Some(found) = Placement::of_embedded(path, tiff, size, options.crs.clone(), cache)?
        {
            return Ok(found);
        }
        if let Some((transform, system)) = boxes.texts.iter().find_map(|text| grid_of_gml(text)) {
            let own = system.map_or_else(|| metadata.clone(), |system| Metadata::of_system(path, &system));
            return Placement::of_header(path, transform, size, options.crs.clone(), &own, cache);
        }
    }
    let beside = Placement::of_image(path, size, options.crs.clone(), cache)?;
    beside.ok_or_else(|| bad(path, &"no georeference: neither GeoJP2, GMLJP2, nor a world file"))
}

impl Boxes {
    /// Reads the boxes of a file of a number of bytes.
    fn read(file: &mut File, file_bytes: u64) -> std::io::Result<Self> {
        let mut boxes = Self::default();
        let mut at = 0;
        for _ in 0..MAX_BOXES {
            if at + 8 > file_bytes {
                break;
            }
            file.seek(SeekFrom::Start(at))?;
            let mut head = [0; 16];
            let length = (file_bytes - at).min(16) as usize;
            file.read_exact(&mut head[..length])?;
            if head.starts_with(&CODESTREAM) {
                boxes.codestream.get_or_insert(at);
                break;
            }
            let (kind, start, length) = box_head(&head, file_bytes - at);
            let end = at.saturating_add(length).min(file_bytes);
            if kind == *b"jp2c" {
                boxes.codestream.get_or_insert(at + start);
            }
            if matches!(&kind, b"uuid" | b"asoc" | b"xml ") && length >= start && end - at <= MAX_BOX_BYTES {
                file.seek(SeekFrom::Start(at + start))?;
                let mut bytes = vec![0; (end - at).saturating_sub(start) as usize];
                file.read_exact(&mut bytes)?;
                boxes.add(kind, &bytes, 0);
            }
            if length < start {
                break;
            }
            at = end;
        }
        Ok(boxes)
    }

    /// Adds the content of a box, which is inside of `depth` others.
    fn add(&mut self, kind: [u8; 4], bytes: &[u8], depth: usize) {
        match &kind {
            b"uuid" => {
                let tiff = bytes.strip_prefix(&GEO_JP2);
                self.geotiff = self.geotiff.take().or_else(|| tiff.map(<[u8]>::to_vec));
            }
            b"xml " => self.texts.push(String::from_utf8_lossy(bytes).trim_end_matches('\0').to_owned()),
            b"asoc" if depth < MAX_DEPTH => {
                let mut rest = bytes;
                while rest.len() >= 8 {
                    let mut head = [0; 16];
                    let known = rest.len().min(16);
                    head[..known].copy_from_slice(&rest[..known]);
                    let (kind, start, length) = box_head(&head, rest.len() as u64);
                    let end = length.min(rest.len() as u64) as usize;
                    let Some(content) = rest.get(start as usize..end) else { break };
                    self.add(kind, content, depth + 1);
                    rest = &rest[end..];
                }
            }
            _ => {}
        }
    }
}

/// Returns the kind of a box, the bytes before its content, and its length; `rest` is the number of bytes until the file's end.
fn box_head(head: &[u8; 16], rest: u64) -> ([u8; 4], u64, u64) {
    let [a, b, c, d, e, f, g, h, long @ ..] = *head;
    let kind = [e, f, g, h];
    match u32::from_be_bytes([a, b, c, d]) {
        0 => (kind, 8, rest),
        1 => (kind, 16, u64::from_be_bytes(long)),
        length => (kind, 8, length.into()),
    }
}

impl Header {
    /// Reads the first segments of a codestream. The error is the reason.
    fn parse(bytes: &[u8], channel: Option<&str>, file_bytes: u64) -> Result<Self, String> {
        if !bytes.starts_with(&CODESTREAM) || bytes.len() < SIZE_BYTES {
            return Err("no size of the image".to_owned());
        }
        let number =
            |at: usize| u64::from(u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]));
        let components = usize::from(u16::from_be_bytes([bytes[40], bytes[41]]));
        // The ends and the starts of the image's sides, the sides of tiles, and the start of the first one.
        let [ends, starts, tile, first] = [8, 16, 24, 32].map(|at| [number(at), number(at + 4)]);
        let sides = [0, 1].map(|axis| ends[axis].saturating_sub(starts[axis]));
        let samples = sides[0].saturating_mul(sides[1]).saturating_mul(components.max(1) as u64);
        let most = file_bytes.saturating_mul(MAX_SAMPLES_PER_BYTE).clamp(MIN_SAMPLES, MAX_SAMPLES);
        if samples == 0 || samples > most || file_bytes > MAX_FILE_BYTES {
            let [width, height] = sides;
            let reason = format!(
                "{width} x {height} pixels of {components} components in {file_bytes} bytes; at most {most} samples are \
                 decoded at once, gdal_translate writes larger images as GeoTIFF"
            );
            return Err(reason);
        }
        let tiles = [0, 1].map(|axis| ends[axis].saturating_sub(first[axis]).div_ceil(tile[axis].max(1)));
        if tile.contains(&0) || tiles[0].saturating_mul(tiles[1]) > MAX_TILES {
            return Err(format!("tiles of {} x {} pixels", tile[0], tile[1]));
        }
        let channel = match channel {
            None if components == 1 => 0,
            None => {
                return Err(format!("{components} components; elevation has one channel, --channel N chooses it"));
            }
            Some(name) => {
                let number = name.parse().ok().filter(|n| (1..=components).contains(n));
                number.ok_or_else(|| format!("--channel {name}: the file has components 1 to {components}"))? - 1
            }
        };
        let own = bytes.get(SIZE_BYTES + COMPONENT_BYTES * channel..).and_then(<[u8]>::first_chunk::<COMPONENT_BYTES>);
        let &[kind, wider, higher] = own.ok_or("no components")?;
        let bits = (kind & 0x7f) + 1;
        if bits > MAX_BITS || [wider, higher] != [1, 1] {
            return Err(format!("samples of {bits} bits, one in {wider} x {higher} pixels, which is not supported"));
        }
        let size = sides.map(|side| side as usize);
        Ok(Self { size, components, channel, bits, is_signed: kind & 0x80 != 0 })
    }
}

/// Returns the transform of the first grid of a document of GML, and its reference system. `None` without one.
fn grid_of_gml(text: &str) -> Option<(GeoTransform, Option<String>)> {
    let options = ParsingOptions { allow_dtd: false, nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text.trim(), options).ok()?;
    let grid = document.descendants().find(|node| node.tag_name().name() == "RectifiedGrid")?;
    let named = |name: &'static str| grid.descendants().filter(move |node| node.tag_name().name() == name);
    let pair = |node: Node<'_, '_>| {
        let mut numbers = node.text()?.split([' ', ',', '\n', '\t']).filter_map(|word| word.parse::<f64>().ok());
        let [a, b] = [numbers.next()?, numbers.next()?];
        (a.is_finite() && b.is_finite()).then_some([a, b])
    };
    let origin = named("pos").chain(named("coordinates")).find_map(pair)?;
    let mut vectors = named("offsetVector").filter_map(pair);
    let (mut dx, mut dy) = (vectors.next()?, vectors.next()?);
    let mut origin = origin;
    // Systems with latitudes or northings first say so nowhere in the document: a row of the image runs along the first axis.
    if dx[1].abs() > dx[0].abs() {
        (origin, dx, dy) = ([origin[1], origin[0]], [dx[1], dx[0]], [dy[1], dy[0]]);
    }
    // The origin is the middle of the first pixel.
    let corner = [0, 1].map(|axis| origin[axis] - 0.5 * (dx[axis] + dy[axis]));
    let system = grid.descendants().find_map(|node| node.attribute("srsName")).and_then(|name| {
        let code = name.rsplit([':', '#', '/']).next()?;
        let is_epsg = name.to_ascii_uppercase().contains("EPSG") && code.parse::<u32>().is_ok();
        is_epsg.then(|| format!("EPSG:{code}"))
    });
    Some((GeoTransform { origin: corner, dx, dy }, system))
}

impl WholeReader for Jpeg2000 {
    fn read_all(&self, call: &mut dyn FnMut(&[u32]) -> Result<(), GenError>) -> Result<(), GenError> {
        self.state.check(&self.path)?;
        let bytes = std::fs::read(&self.path).map_err(GenError::file(&self.path))?;
        let Header { size: [width, height], components, channel, bits, is_signed } = self.header;
        let failed = |reason: &dyn std::fmt::Display| bad(&self.path, reason);
        let settings = DecodeSettings { resolve_palette_indices: false, ..DecodeSettings::default() };
        let decode = || {
            let image = Image::new(&bytes, &settings).map_err(|e| failed(&e))?;
            let mut context = DecoderContext::default();
            let decoded = image.decode(&mut context).map_err(|e| failed(&e))?;
            let found = decoded.components();
            let samples = found.get(channel).map(|component| component.samples()).unwrap_or_default();
            if found.len() != components || samples.len() != width * height {
                return Err(failed(&"another size than in the header"));
            }
            Ok(samples.to_vec())
        };
        // The decoder is another's, and asserts what it expects of a file.
        let samples = std::panic::catch_unwind(std::panic::AssertUnwindSafe(decode))
            .unwrap_or_else(|_| Err(failed(&DECODER_PANICKED)))?;
        // The decoder shifts signed samples as if they were not.
        let shift = if is_signed { (1u32 << (bits - 1)) as f32 } else { 0.0 };
        let [factor, offset] = self.units;
        for row in samples.chunks_exact(width) {
            let height_m = |sample: &f32| {
                let sample = (sample - shift).round();
                let is_unknown = self.options.nodata.is_some_and(|nodata| nodata as f32 == sample);
                let height_m = (f64::from(sample) * factor + offset) as f32;
                if is_unknown { f32::NAN } else { self.options.scaled_m(height_m) }
            };
            call(&height_bits(row.iter().map(height_m).collect()))?;
        }
        Ok(())
    }

    fn path(&self) -> &Path {
        &self.path
    }
}
