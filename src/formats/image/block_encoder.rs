//! Compresses RGBA8 images: the mip levels that a KTX2 file lacks.
//!
//! BC7, ETC2 and the alpha of BC3 have the encoders of the transcoder's crate; that of BC7 divides a block among several pairs of
//! colours, that of ETC2 has two colours with shades of each. Other blocks are encoded as ASTC, in two of its simplest modes, and
//! transcoded: a fit of BC1 to the texels themselves has errors smaller by a sixteenth. Layouts are those of the Khronos Data
//! Format Specification 1.3, section 23. Decode threads.

// Hidden in the crate's documentation. The version is pinned.
use basisu::fastenc::bc7f;
use basisu::fastenc::etc1f::{PackEtc1State, pack_etc1};
use basisu::uastc::bc4::encode_bc4;
use basisu::{Error, Transcoder};

use super::transcode::{MAGIC, transcode};
use crate::scene::TexelFormat;

/// Texels along a side of a block.
const SIDE: usize = 4;
/// RGBA, 0 to 255.
type Color = [f32; 4];

/// Compresses an image of RGBA8 texels; returns it as it is for [`TexelFormat::Rgba8`].
pub(super) fn encode(width: u32, height: u32, texels: Vec<u8>, format: TexelFormat) -> Result<Vec<u8>, Error> {
    let (across, down) = (width as usize, height as usize);
    Ok(match format {
        TexelFormat::Rgba8 => texels,
        TexelFormat::Bc7 => bc7_blocks(across, down, &texels),
        TexelFormat::Etc2Rgb => etc1_blocks(across, down, &texels),
        TexelFormat::Bc1 | TexelFormat::Astc4x4 => by_astc(width, height, &texels, format)?,
        // Alpha and colours have a half of the block each, which does not depend on the other.
        TexelFormat::Bc3 => {
            let opaque = changed(&texels, |[r, g, b, _]| [r, g, b, u8::MAX]);
            halves(&bc4_blocks_of_alpha(across, down, &texels), &by_astc(width, height, &opaque, TexelFormat::Bc1)?)
        }
        TexelFormat::Etc2Rgba => {
            let black = changed(&texels, |[_, _, _, a]| [0, 0, 0, a]);
            let alpha = by_astc(width, height, &black, format)?;
            let alpha: Vec<u8> = alpha.chunks(16).flat_map(|block| &block[..8]).copied().collect();
            halves(&alpha, &etc1_blocks(across, down, &texels))
        }
    })
}

/// Compresses an image as ASTC, and transcodes it.
fn by_astc(width: u32, height: u32, texels: &[u8], format: TexelFormat) -> Result<Vec<u8>, Error> {
    let file = astc_file(width, height, &astc_blocks(width as usize, height as usize, texels));
    transcode(&Transcoder::new(&file)?, 0, format)
}

fn changed(texels: &[u8], change: impl Fn([u8; 4]) -> [u8; 4]) -> Vec<u8> {
    texels.as_chunks::<4>().0.iter().flat_map(|texel| change(*texel)).collect()
}

/// Returns blocks of two halves of 8 bytes each.
fn halves(first: &[u8], second: &[u8]) -> Vec<u8> {
    let pairs = first.as_chunks::<8>().0.iter().zip(second.as_chunks::<8>().0);
    pairs.flat_map(|(first, second)| [*first, *second]).flatten().collect()
}

/// Returns a KTX2 file with one level of ASTC blocks.
fn astc_file(width: u32, height: u32, blocks: &[u8]) -> Vec<u8> {
    /// `VK_FORMAT_ASTC_4x4_UNORM_BLOCK`.
    const FORMAT: u32 = 157;
    /// A basic descriptor: ASTC (162), BT.709, linear; blocks of 4 x 4 texels in 16 bytes; one sample with RGBA.
    const DESCRIPTOR: [u32; 11] =
        [44, 0, 2 | 40 << 16, 162 | 1 << 8 | 1 << 16, 3 | 3 << 8, 16, 0, 127 << 16 | 3 << 24, 0, 0, u32::MAX];
    const DESCRIPTOR_AT: u32 = 80 + 24;
    const BLOCKS_AT: u64 = (DESCRIPTOR_AT as u64 + 44).next_multiple_of(16);
    let mut file = Vec::with_capacity(BLOCKS_AT as usize + blocks.len());
    file.extend(MAGIC);
    // One level, one face, no layers, no supercompression; no key and value pairs, no global data.
    for word in [FORMAT, 1, width, height, 0, 0, 1, 1, 0, DESCRIPTOR_AT, 44, 0, 0, 0, 0, 0, 0] {
        file.extend(word.to_le_bytes());
    }
    for word in [BLOCKS_AT, blocks.len() as u64, blocks.len() as u64] {
        file.extend(word.to_le_bytes());
    }
    DESCRIPTOR.iter().for_each(|word| file.extend(word.to_le_bytes()));
    file.resize(BLOCKS_AT as usize, 0);
    file.extend(blocks);
    file
}

/// Returns the texels of an image, row by row of blocks. Texels beyond the edges repeat those at the edges.
fn blocks(width: usize, height: usize, texels: &[u8]) -> impl Iterator<Item = [[u8; 4]; SIDE * SIDE]> {
    let texels = texels.as_chunks::<4>().0;
    let (columns, rows) = (width.div_ceil(SIDE), height.div_ceil(SIDE));
    (0..rows * columns).map(move |block| {
        let (row, column) = (block / columns, block % columns);
        std::array::from_fn(|i| {
            let x = (column * SIDE + i % SIDE).min(width - 1);
            let y = (row * SIDE + i / SIDE).min(height - 1);
            texels[y * width + x]
        })
    })
}

/// Compresses an image as ASTC.
fn astc_blocks(width: usize, height: usize, texels: &[u8]) -> Vec<u8> {
    let blocks = blocks(width, height, texels);
    blocks.flat_map(|block| astc_block(&block.map(|texel| texel.map(f32::from))).to_le_bytes()).collect()
}

/// Compresses the colours of an image as ETC1, which is a part of ETC2.
fn etc1_blocks(width: usize, height: usize, texels: &[u8]) -> Vec<u8> {
    let mut state = PackEtc1State::new();
    let blocks = blocks(width, height, texels).map(|block| {
        let mut packed = [0; 8];
        pack_etc1(&mut packed, &block, &mut state);
        packed
    });
    blocks.flatten().collect()
}

/// Compresses an image as BC7.
fn bc7_blocks(width: usize, height: usize, texels: &[u8]) -> Vec<u8> {
    blocks(width, height, texels)
        .flat_map(|block| {
            let mut packed = [0; 16];
            bc7f::fast_pack_bc7_auto_rgba(&mut packed, &block, bc7f::flags::DEFAULT_PARTIALLY_ANALYTICAL);
            packed
        })
        .collect()
}

/// Compresses the alpha of an image as BC4.
fn bc4_blocks_of_alpha(width: usize, height: usize, texels: &[u8]) -> Vec<u8> {
    let packed = blocks(width, height, texels).map(|block| {
        let mut packed = [0; 8];
        encode_bc4(&mut packed, &block.map(|texel| texel[3]));
        packed
    });
    packed.flatten().collect()
}

/// Compresses a block: two colours of 8 bits a channel, and a weight between them for each texel, of 3 bits in opaque blocks
/// and of 2 bits in others.
fn astc_block(texels: &[Color; SIDE * SIDE]) -> u128 {
    /// Block modes of 4 x 4 weights of 3 and of 2 bits.
    const WEIGHTS_3_BITS: u128 = 0x53;
    const WEIGHTS_2_BITS: u128 = 0x42;
    /// Color endpoint modes: two RGB or two RGBA colours.
    const RGB: u128 = 8;
    const RGBA: u128 = 12;
    let is_opaque = texels.iter().all(|texel| texel[3] >= 255.0);
    let (mode, endpoint_mode, channels, weight_bits) =
        if is_opaque { (WEIGHTS_3_BITS, RGB, 3, 3u32) } else { (WEIGHTS_2_BITS, RGBA, 4, 2) };
    let [low, high] = endpoints(texels);
    // Bits 11 and 12 are the number of partitions less one.
    let mut block = mode | endpoint_mode << 13;
    for channel in 0..channels {
        let pair = u128::from(low[channel] as u8) | u128::from(high[channel] as u8) << 8;
        block |= pair << (17 + 16 * channel);
    }
    let max_weight = ((1 << weight_bits) - 1) as f32;
    let axis = difference(high, low);
    let length = dot(axis, axis);
    for (i, texel) in texels.iter().enumerate() {
        let along = if length > 0.0 { dot(difference(*texel, low), axis) / length } else { 0.0 };
        let weight = (along.clamp(0.0, 1.0) * max_weight).round() as u128;
        // Weights begin at the last bit and run backwards.
        for bit in 0..weight_bits {
            block |= (weight >> bit & 1) << (127 - (i as u32 * weight_bits + bit));
        }
    }
    block
}

/// Returns whole colours at both ends of a block's longest axis. The second has the larger sum of red, green and blue, since
/// the other order selects another encoding.
fn endpoints(texels: &[Color; SIDE * SIDE]) -> [Color; 2] {
    let mean: Color = std::array::from_fn(|c| texels.iter().map(|texel| texel[c]).sum::<f32>() / 16.0);
    let centered = texels.map(|texel| difference(texel, mean));
    // The power method finds the axis of the largest variance, from the longest diagonal of the block's box.
    let mut axis: Color =
        centered.iter().fold([0.0; 4], |longest, of| if dot(*of, *of) > dot(longest, longest) { *of } else { longest });
    for _ in 0..4 {
        let mut next = [0.0; 4];
        for texel in &centered {
            let along = dot(*texel, axis);
            (0..4).for_each(|c| next[c] += along * texel[c]);
        }
        let length = dot(next, next).sqrt();
        if length <= f32::EPSILON {
            break;
        }
        axis = next.map(|part| part / length);
    }
    let length = dot(axis, axis).sqrt();
    let axis = if length > f32::EPSILON { axis.map(|part| part / length) } else { [0.0; 4] };
    let along = centered.map(|texel| dot(texel, axis));
    let end = |at: f32| -> Color { std::array::from_fn(|c| (mean[c] + at * axis[c]).clamp(0.0, 255.0).round()) };
    let low = end(along.iter().copied().fold(0.0, f32::min));
    let high = end(along.iter().copied().fold(0.0, f32::max));
    let sum = |color: Color| color[..3].iter().sum::<f32>();
    if sum(low) <= sum(high) { [low, high] } else { [high, low] }
}

fn difference(a: Color, b: Color) -> Color {
    std::array::from_fn(|c| a[c] - b[c])
}

fn dot(a: Color, b: Color) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORMATS: [TexelFormat; 6] = [
        TexelFormat::Bc1,
        TexelFormat::Bc3,
        TexelFormat::Bc7,
        TexelFormat::Etc2Rgb,
        TexelFormat::Etc2Rgba,
        TexelFormat::Astc4x4,
    ];

    /// Returns the decompressed texels of an image.
    fn encoded_and_decoded(width: u32, height: u32, texels: &[u8]) -> Vec<u8> {
        let file = astc_file(width, height, &astc_blocks(width as usize, height as usize, texels));
        transcode(&Transcoder::new(&file).unwrap(), 0, TexelFormat::Rgba8).unwrap()
    }

    type Decode = fn(&[u8], usize, usize, &mut [u32]) -> Result<(), &'static str>;

    /// Returns the texels of an image by a decoder that is not the transcoder's.
    fn decoded(side: usize, blocks: &[u8], decode: Decode) -> Vec<u8> {
        let mut texels = vec![0; side * side];
        decode(blocks, side, side, &mut texels).unwrap();
        texels.into_iter().flat_map(|texel: u32| [2, 1, 0, 3].map(|c| texel.to_le_bytes()[c])).collect()
    }

    fn mean_difference(a: &[u8], b: &[u8]) -> f64 {
        assert_eq!(a.len(), b.len());
        a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / a.len() as f64
    }

    #[test]
    fn flat_colours_and_ramps_are_kept() {
        for color in [[0, 0, 0, 255], [255; 4], [200, 100, 50, 255], [10, 220, 30, 128], [9, 9, 9, 0]] {
            let flat = color.repeat(6 * 5);
            assert_eq!(encoded_and_decoded(6, 5, &flat), flat, "{color:?}");
        }
        for alpha in [255, 200] {
            let ramp: Vec<u8> =
                (0..64u32).flat_map(|i| [(i % 8 * 30) as u8, 255 - (i % 8 * 30) as u8, 40, alpha]).collect();
            let difference = mean_difference(&ramp, &encoded_and_decoded(8, 8, &ramp));
            assert!(difference < 4.0, "{alpha}: {difference}");
        }
    }

    #[test]
    fn every_format_has_its_size() {
        let texels: Vec<u8> = (0..9 * 5u32).flat_map(|i| [(i * 5) as u8, 80, 200 - (i * 3) as u8, 255]).collect();
        for format in FORMATS {
            let blocks = encode(9, 5, texels.clone(), format).unwrap();
            assert_eq!(blocks.len() as u64, format.image_bytes(9, 5), "{format:?}");
        }
        assert_eq!(encode(9, 5, texels.clone(), TexelFormat::Rgba8).unwrap(), texels);
    }

    /// Regression: BC7 was made of ASTC blocks of two colours, so that blocks of more colours lost them. Levels filtered from
    /// a mosaic are such blocks.
    #[test]
    fn bc7_keeps_blocks_of_several_colours() {
        let mut random = 1u32;
        let mut patch = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            random.to_le_bytes()
        };
        for alpha in [true, false] {
            let colors: Vec<[u8; 4]> = (0..16 * 16).map(|_| patch()).collect();
            let texel = |i: usize| {
                let [r, g, b, a] = colors[i / 64 * 16 + i % 32 / 2];
                [r, g, b, if alpha { a } else { 255 }]
            };
            let mosaic: Vec<u8> = (0..32 * 32).flat_map(texel).collect();
            let of = |blocks: &[u8]| {
                let mut texels = vec![0; 32 * 32];
                texture2ddecoder::decode_bc7(blocks, 32, 32, &mut texels).unwrap();
                let rgba = texels.into_iter().flat_map(|texel: u32| [2, 1, 0, 3].map(|c| texel.to_le_bytes()[c]));
                mean_difference(&mosaic, &rgba.collect::<Vec<_>>())
            };
            let direct = of(&encode(32, 32, mosaic.clone(), TexelFormat::Bc7).unwrap());
            let file = astc_file(32, 32, &astc_blocks(32, 32, &mosaic));
            let by_astc = of(&transcode(&Transcoder::new(&file).unwrap(), 0, TexelFormat::Bc7).unwrap());
            assert!(direct < 0.6 * by_astc, "alpha {alpha}: {direct} instead of {by_astc}");
        }
    }

    /// Regression: blocks with alpha were made of ASTC blocks of two colours, along which alpha changed too.
    #[test]
    fn alpha_does_not_follow_the_colours() {
        // Stripes of a colour across, and alpha down.
        let texel = |i: usize| {
            let [across, down] = [i % 32, i / 32].map(|at| (at * 37 % 256) as u8);
            [across, 255 - across, 90, down]
        };
        let image: Vec<u8> = (0..32 * 32).flat_map(texel).collect();
        let formats: [(TexelFormat, Decode); 2] = [
            (TexelFormat::Bc3, texture2ddecoder::decode_bc3),
            (TexelFormat::Etc2Rgba, texture2ddecoder::decode_etc2_rgba8),
        ];
        for (format, decode) in formats {
            let of = |blocks: &[u8]| {
                let mut texels = vec![0; 32 * 32];
                decode(blocks, 32, 32, &mut texels).unwrap();
                let rgba = texels.into_iter().flat_map(|texel: u32| [2, 1, 0, 3].map(|c| texel.to_le_bytes()[c]));
                mean_difference(&image, &rgba.collect::<Vec<_>>())
            };
            let halves = of(&encode(32, 32, image.clone(), format).unwrap());
            let together = of(&by_astc(32, 32, &image, format).unwrap());
            assert!(halves < 0.8 * together, "{format:?}: {halves} instead of {together}");
        }
    }

    /// Regression: ETC2 was made of ASTC blocks of two colours, and so fitted twice.
    #[test]
    fn etc2_is_fitted_to_the_texels_themselves() {
        for (name, image, most) in [("noise", noise(64), 0.91), ("hills", hills(64), 0.95)] {
            let of = |blocks: &[u8]| mean_difference(&image, &decoded(64, blocks, texture2ddecoder::decode_etc2_rgb));
            let direct = of(&encode(64, 64, image.clone(), TexelFormat::Etc2Rgb).unwrap());
            let twice = of(&by_astc(64, 64, &image, TexelFormat::Etc2Rgb).unwrap());
            assert!(direct < most * twice, "{name}: {direct} instead of {twice}");
        }
    }

    /// Returns an image of unrelated colours.
    fn noise(side: usize) -> Vec<u8> {
        let mut random = 1u32;
        let mut texel = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            [random >> 24, random >> 16, random >> 8, 255].map(|part| part as u8)
        };
        (0..side * side).flat_map(|_| texel()).collect()
    }

    /// Returns an image like one from above: soft slopes with edges between green, brown and white.
    fn hills(side: usize) -> Vec<u8> {
        let texel = |i: usize| {
            let (x, y) = ((i % side) as f32, (i / side) as f32);
            let height = (0.21 * x).sin() * (0.13 * y).cos() + 0.4 * (0.9 * x + 0.7 * y).sin();
            let [r, g, b] = match height {
                ..-0.3 => [60.0, 90.0, 50.0],
                ..0.4 => [130.0, 110.0, 80.0],
                _ => [230.0, 235.0, 240.0],
            };
            let shade = 0.8 + 0.2 * (0.5 * x - 0.3 * y).cos();
            [(r * shade) as u8, (g * shade) as u8, (b * shade) as u8, 255]
        };
        (0..side * side).flat_map(texel).collect()
    }

    /// A transparent texel in an opaque image would be a hole in a mask.
    #[test]
    fn bc1_has_no_transparent_texels() {
        let texels: Vec<u8> = (0..64 * 64u32).flat_map(|i| [(i * i % 251) as u8, (i % 3) as u8, 0, 255]).collect();
        let blocks = encode(64, 64, texels, TexelFormat::Bc1).unwrap();
        for block in blocks.as_chunks::<8>().0 {
            let [a, b] = [0, 2].map(|at| u16::from_le_bytes([block[at], block[at + 1]]));
            let has_fourth =
                (0..32).step_by(2).any(|bit| u32::from_le_bytes([4, 5, 6, 7].map(|i| block[i])) >> bit & 3 == 3);
            assert!(a > b || !has_fourth, "{block:02x?}");
        }
    }
}
