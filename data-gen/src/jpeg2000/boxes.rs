//! The boxes of a JPEG 2000 file: where its codestream begins, its georeference, and the channels of its palette. The thread that
//! opens a file.

use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};

use roxmltree::{Document, Node, ParsingOptions};

use crate::georeference::GeoTransform;

/// The largest box that is read, the most boxes, and the most boxes inside of one another.
const MAX_BOX_BYTES: u64 = 16 << 20;
const MAX_BOXES: usize = 4096;
const MAX_DEPTH: usize = 4;
/// The largest number of nodes in a document of GML.
const MAX_NODES: u32 = 1 << 16;
/// The bytes of a channel in the box that maps components to channels.
const CHANNEL_BYTES: usize = 4;
/// The name of GeoJP2's box.
const GEO_JP2: [u8; 16] = [0xb1, 0x4b, 0xf8, 0xbd, 8, 0x3d, 0x4b, 0x43, 0xa5, 0xae, 0x8c, 0xd7, 0xd5, 0xa6, 0xce, 3];
/// The first bytes of a codestream.
pub(super) const CODESTREAM: [u8; 4] = [0xff, 0x4f, 0xff, 0x51];

/// The codestream and the georeference in the boxes of a file.
#[derive(Default)]
pub(super) struct Boxes {
    /// The position of the codestream.
    pub codestream: Option<u64>,
    /// A TIFF whose tags georeference the image.
    pub geotiff: Option<Vec<u8>>,
    /// Texts of XML.
    pub texts: Vec<String>,
    /// The number of channels that a palette makes of the components; 0 without one.
    pub palette_channels: usize,
}

impl Boxes {
    /// Reads the boxes of a file of a number of bytes.
    pub fn read(file: &mut File, file_bytes: u64) -> std::io::Result<Self> {
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
            if kind == *b"jp2h" && end - at > MAX_BOX_BYTES {
                // Whatever its palette is: too many for an image.
                boxes.palette_channels = usize::MAX;
            }
            if matches!(&kind, b"uuid" | b"asoc" | b"xml " | b"jp2h") && length >= start && end - at <= MAX_BOX_BYTES {
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
            b"cmap" => self.palette_channels = self.palette_channels.saturating_add(bytes.len() / CHANNEL_BYTES),
            b"asoc" | b"jp2h" if depth < MAX_DEPTH => {
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

/// Returns the transform of the first grid of a document of GML, and its reference system. `None` without one.
pub(super) fn grid_of_gml(text: &str) -> Option<(GeoTransform, Option<String>)> {
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
