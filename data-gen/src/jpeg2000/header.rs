//! The header of a JPEG 2000 codestream: the size of the image and its components. The thread that opens a file.

use super::boxes::CODESTREAM;

/// The number of samples that a file of any length may have, and those that each of its bytes may stand for in a longer one.
const MIN_SAMPLES: u64 = 1 << 20;
const MAX_SAMPLES_PER_BYTE: u64 = 1 << 16;
/// The most tiles of an image.
const MAX_TILES: u64 = 65_535;
/// The bytes of a codestream before its components, and of each component.
const SIZE_BYTES: usize = 42;
const COMPONENT_BYTES: usize = 3;
/// The bytes of the longest header.
pub(super) const MAX_BYTES: u64 = (SIZE_BYTES + COMPONENT_BYTES * u16::MAX as usize) as u64;

/// A component of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Component {
    pub bits: u8,
    pub is_signed: bool,
    /// The numbers of columns and of rows that have one sample.
    pub spacing: [u8; 2],
}

/// The size of an image in pixels, and its components.
#[derive(Clone, Debug)]
pub(crate) struct Header {
    pub size: [usize; 2],
    pub components: Vec<Component>,
}

impl Header {
    /// Reads the first segments of a codestream in a file of a number of bytes, whose palette makes a number of channels. An image
    /// of more than `max_samples` is refused. The error is the reason.
    pub(super) fn parse(
        bytes: &[u8],
        file_bytes: u64,
        palette_channels: usize,
        max_samples: u64,
    ) -> Result<Self, String> {
        if !bytes.starts_with(&CODESTREAM) || bytes.len() < SIZE_BYTES {
            return Err("no size of the image".to_owned());
        }
        let number =
            |at: usize| u64::from(u32::from_be_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]));
        let count = usize::from(u16::from_be_bytes([bytes[40], bytes[41]]));
        // The ends and the starts of the image's sides, the sides of tiles, and the start of the first one.
        let [ends, starts, tile, first] = [8, 16, 24, 32].map(|at| [number(at), number(at + 4)]);
        let sides = [0, 1].map(|axis| ends[axis].saturating_sub(starts[axis]));
        let planes = count.max(1).max(palette_channels) as u64;
        let samples = sides[0].saturating_mul(sides[1]).saturating_mul(planes);
        let most = file_bytes.saturating_mul(MAX_SAMPLES_PER_BYTE).clamp(MIN_SAMPLES, max_samples);
        if samples == 0 || samples > most {
            let [width, height] = sides;
            let reason = format!(
                "{width} x {height} pixels of {planes} components in {file_bytes} bytes; at most {most} samples are \
                 decoded at once, gdal_translate writes larger images as GeoTIFF"
            );
            return Err(reason);
        }
        let tiles = [0, 1].map(|axis| ends[axis].saturating_sub(first[axis]).div_ceil(tile[axis].max(1)));
        if tile.contains(&0) || tiles[0].saturating_mul(tiles[1]) > MAX_TILES {
            return Err(format!("tiles of {} x {} pixels", tile[0], tile[1]));
        }
        let component = |&[kind, wider, higher]: &[u8; COMPONENT_BYTES]| Component {
            bits: (kind & 0x7f) + 1,
            is_signed: kind & 0x80 != 0,
            spacing: [wider, higher],
        };
        let components: Vec<Component> = bytes[SIZE_BYTES..].as_chunks().0.iter().take(count).map(component).collect();
        if components.is_empty() || components.len() < count {
            return Err("no components".to_owned());
        }
        Ok(Self { size: sides.map(|side| side as usize), components })
    }
}
