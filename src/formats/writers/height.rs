//! Writes EXR height tiles: one f32 channel "Y", compressed with ZIP16. Reading 65 x 65 heights takes 52 us; PIZ would be ten
//! times slower. Any thread.
//!
//! The layout is that of OpenEXR 2: a header of named attributes, a table of the offsets of blocks, and blocks of 16 rows.

use std::cell::RefCell;

use flate2::{Compress, Compression, FlushCompress, Status};

use crate::fetch::IoError;

/// The rows of a block.
const BLOCK_ROWS: usize = 16;
/// Sides beyond this have no offsets of 31 bits.
const MAX_SIDE: usize = 1 << 14;
/// Bytes with more bits of information than this, by their frequencies, are not compressed: they would lose less than a tenth.
const MAX_BITS_OF_A_BYTE: f32 = 7.25;

thread_local! {
    /// Its tables are used again for each block. Level 1 would take a third of the time, but up to a third more bytes; 3 to 6
    /// save less than a hundredth.
    static COMPRESSOR: RefCell<Compress> = RefCell::new(Compress::new(Compression::new(2), true));
}

/// Returns the bytes of an EXR file with `side * side` heights in metres, **north row first**. Errors name `uri`.
pub fn write_height_exr(uri: &str, side: usize, heights: Vec<f32>) -> Result<Vec<u8>, IoError> {
    let invalid = |reason: String| IoError::Invalid { uri: uri.to_owned(), reason };
    if side == 0 || side > MAX_SIDE || heights.len() != side * side {
        return Err(invalid(format!("{} heights for {side} x {side}", heights.len())));
    }
    let mut file = header(side as u32 - 1);
    let blocks = side.div_ceil(BLOCK_ROWS);
    let table = file.len();
    file.resize(table + 8 * blocks, 0);
    let mut plain = Vec::with_capacity(4 * side * BLOCK_ROWS);
    let mut reordered = Vec::with_capacity(plain.capacity());
    let mut packed = Vec::with_capacity(plain.capacity());
    for (block, rows) in heights.chunks(BLOCK_ROWS * side).enumerate() {
        let offset = (file.len() as u64).to_le_bytes();
        file[table + 8 * block..table + 8 * (block + 1)].copy_from_slice(&offset);
        plain.clear();
        plain.extend(rows.iter().flat_map(|height_m| height_m.to_le_bytes()));
        reorder(&plain, &mut reordered);
        // A block that does not become smaller is stored as it is.
        let data =
            if compress(&reordered, &mut packed).map_err(|e| invalid(format!("EXR: {e}")))? { &packed } else { &plain };
        file.extend(((block * BLOCK_ROWS) as u32).to_le_bytes());
        file.extend((data.len() as u32).to_le_bytes());
        file.extend_from_slice(data);
    }
    Ok(file)
}

/// Returns the header of a file whose last row and column are `last`.
fn header(last: u32) -> Vec<u8> {
    /// `FLOAT`.
    const PIXEL_TYPE: u32 = 2;
    /// `ZIP_COMPRESSION`: zlib over 16 rows.
    const ZIP: u8 = 3;
    let words = |words: &[u32]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    // The name, the type of the samples, a flag and padding, a sample for each pixel; then the end of the list.
    let channels = [b"Y\0".to_vec(), words(&[PIXEL_TYPE, 0, 1, 1]), vec![0]].concat();
    let window = words(&[0, 0, last, last]);
    let one = words(&[1f32.to_bits()]);
    let attributes: [(&str, &str, &[u8]); 8] = [
        ("channels", "chlist", &channels),
        ("compression", "compression", &[ZIP]),
        ("dataWindow", "box2i", &window),
        ("displayWindow", "box2i", &window),
        ("lineOrder", "lineOrder", &[0]),
        ("pixelAspectRatio", "float", &one),
        ("screenWindowCenter", "v2f", &[0; 8]),
        ("screenWindowWidth", "float", &one),
    ];
    // The magic number, and version 2 without flags.
    let mut bytes = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
    for (name, kind, value) in attributes {
        for text in [name, kind] {
            bytes.extend(text.as_bytes());
            bytes.push(0);
        }
        bytes.extend((value.len() as u32).to_le_bytes());
        bytes.extend(value);
    }
    bytes.push(0);
    bytes
}

/// Compresses bytes with zlib. Returns false if they would not become fewer, or hardly.
fn compress(bytes: &[u8], packed: &mut Vec<u8>) -> Result<bool, flate2::CompressError> {
    packed.clear();
    if bits_of_a_byte(bytes) > MAX_BITS_OF_A_BYTE {
        return Ok(false);
    }
    packed.reserve(bytes.len());
    COMPRESSOR.with_borrow_mut(|compressor| {
        compressor.reset();
        // It fills the capacity at most.
        let status = compressor.compress_vec(bytes, packed, FlushCompress::Finish)?;
        Ok(status == Status::StreamEnd && packed.len() < bytes.len())
    })
}

/// Returns the information of a byte in bits, by the frequencies of the bytes.
fn bits_of_a_byte(bytes: &[u8]) -> f32 {
    let mut counts = [0u32; 256];
    bytes.iter().for_each(|byte| counts[usize::from(*byte)] += 1);
    let all = bytes.len() as f32;
    counts.iter().filter(|count| **count > 0).map(|count| *count as f32 / all).map(|share| -share * share.log2()).sum()
}

/// Separates the bytes at even and at odd offsets, and replaces each by its difference from the one before, plus 128.
fn reorder(plain: &[u8], out: &mut Vec<u8>) {
    out.clear();
    out.extend(plain.iter().step_by(2));
    out.extend(plain.iter().skip(1).step_by(2));
    let mut before = out.first().copied().unwrap_or(0);
    for byte in out.iter_mut().skip(1) {
        let own = *byte;
        *byte = own.wrapping_sub(before).wrapping_add(128);
        before = own;
    }
}

#[cfg(test)]
mod tests {
    use exr::prelude::{ReadChannels as _, ReadLayers as _};

    use super::*;

    #[test]
    fn files_are_read_by_the_crate_exr() {
        let smooth = |k: usize| 0.125 * (k * 7919 % 1001) as f32 - 40.0;
        // All bytes are as frequent as others: such blocks are stored.
        let noise = |k: usize| f32::from_bits(0x3f80_0000 | (k as u32).wrapping_mul(2_654_435_761) >> 9);
        let cases = [(1, false), (2, false), (15, true), (16, false), (17, true), (67, false), (67, true)];
        for (side, is_noise) in cases {
            let heights: Vec<f32> = (0..side * side).map(|k| if is_noise { noise(k) } else { smooth(k) }).collect();
            let file = write_height_exr("t", side, heights.clone()).unwrap();
            assert!(side < 67 || (file.len() < 4 * side * side) != is_noise, "{} bytes", file.len());
            let image = exr::prelude::read()
                .no_deep_data()
                .largest_resolution_level()
                .all_channels()
                .first_valid_layer()
                .all_attributes()
                .from_buffered(std::io::Cursor::new(&file))
                .unwrap();
            let channel = &image.layer_data.channel_data.list[0];
            assert_eq!((channel.name.to_string().as_str(), image.layer_data.size.width()), ("Y", side));
            assert!(channel.sample_data.values_as_f32().eq(heights), "{side}");
        }
        assert!(write_height_exr("t", 3, vec![0.0; 8]).unwrap_err().to_string().contains("8 heights for 3 x 3"));
    }
}
