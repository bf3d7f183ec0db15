//! Decompresses the blocks of DXT (S3TC) images: BC1, BC2 and BC3. CPU only; any thread.
//!
//! A block has 4 x 4 texels: two colours of 5, 6 and 5 bits, and two-bit weights between them. In BC2 and BC3 eight bytes of
//! alpha come first (Khronos Data Format Specification 1.3, section 19).

/// The kinds of blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats) enum BlockKind {
    /// DXT1, in which a texel may be transparent if the format has alpha.
    Bc1 { has_alpha: bool },
    /// DXT3: alpha of four bits.
    Bc2,
    /// DXT5: two values of alpha with three-bit weights between them.
    Bc3,
}

/// Returns the RGBA8 texels of an image; `None` if there are too few blocks. Blocks behind the image are ignored.
pub(in crate::formats) fn decode_blocks(kind: BlockKind, width: u32, height: u32, bytes: &[u8]) -> Option<Vec<u8>> {
    let (width, height) = (width as usize, height as usize);
    let (columns, rows) = (width.div_ceil(4), height.div_ceil(4));
    let block_bytes = if matches!(kind, BlockKind::Bc1 { .. }) { 8 } else { 16 };
    let blocks = bytes.get(..columns.checked_mul(rows)?.checked_mul(block_bytes)?)?;
    let mut texels = vec![0; width * height * 4];
    for (index, block) in blocks.chunks_exact(block_bytes).enumerate() {
        let decoded = decode_block(kind, block);
        let (left, top) = (index % columns * 4, index / columns * 4);
        for y in top..(top + 4).min(height) {
            for x in left..(left + 4).min(width) {
                let at = (y * width + x) * 4;
                texels[at..at + 4].copy_from_slice(&decoded[(y - top) * 4 + x - left]);
            }
        }
    }
    Some(texels)
}

fn decode_block(kind: BlockKind, block: &[u8]) -> [[u8; 4]; 16] {
    match kind {
        BlockKind::Bc1 { has_alpha } => colors(block, true, has_alpha),
        BlockKind::Bc2 => {
            let mut texels = colors(&block[8..], false, false);
            for (i, texel) in texels.iter_mut().enumerate() {
                // Four bits become eight.
                texel[3] = (block[i / 2] >> (i % 2 * 4) & 0xf) * 17;
            }
            texels
        }
        BlockKind::Bc3 => {
            let mut texels = colors(&block[8..], false, false);
            let [low, high] = [block[0], block[1]].map(u16::from);
            let weights = (0..6).fold(0u64, |bits, i| bits | u64::from(block[2 + i]) << (8 * i));
            for (i, texel) in texels.iter_mut().enumerate() {
                let weight = (weights >> (3 * i) & 7) as u16;
                texel[3] = match weight {
                    0 => low,
                    1 => high,
                    _ if low > high => ((8 - weight) * low + (weight - 1) * high) / 7,
                    6 => 0,
                    7 => 255,
                    _ => ((6 - weight) * low + (weight - 1) * high) / 5,
                } as u8;
            }
            texels
        }
    }
}

/// Decodes two colours and the weights between them. `may_have_three`: the order of the colours selects three colours and
/// black, which is transparent if `has_alpha`.
fn colors(block: &[u8], may_have_three: bool, has_alpha: bool) -> [[u8; 4]; 16] {
    let packed = [0, 2].map(|at| u16::from(block[at]) | u16::from(block[at + 1]) << 8);
    let [a, b] = packed.map(|color| {
        let (red, green, blue) = (color >> 11, color >> 5 & 0x3f, color & 0x1f);
        [red << 3 | red >> 2, green << 2 | green >> 4, blue << 3 | blue >> 2]
    });
    let between = |weight_a: u16, weight_b: u16| -> [u8; 4] {
        let part = |i: usize| ((weight_a * a[i] + weight_b * b[i]) / (weight_a + weight_b)) as u8;
        [part(0), part(1), part(2), 255]
    };
    let has_three = may_have_three && packed[0] <= packed[1];
    let palette = match has_three {
        false => [between(1, 0), between(0, 1), between(2, 1), between(1, 2)],
        true => [between(1, 0), between(0, 1), between(1, 1), [0, 0, 0, if has_alpha { 0 } else { 255 }]],
    };
    let weights = u32::from_le_bytes([4, 5, 6, 7].map(|at| block[at]));
    std::array::from_fn(|i| palette[(weights >> (2 * i) & 3) as usize])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Red and blue, in the order that has four colours, with the weights 0, 1, 2, 3 in each row.
    const FOUR: [u8; 8] = [0x00, 0xf8, 0x1f, 0x00, 0xe4, 0xe4, 0xe4, 0xe4];

    #[test]
    fn colors_lie_between_the_two_of_the_block() {
        let texels = decode_blocks(BlockKind::Bc1 { has_alpha: true }, 4, 4, &FOUR).unwrap();
        assert_eq!(texels[..16], [255, 0, 0, 255, 0, 0, 255, 255, 170, 0, 85, 255, 85, 0, 170, 255]);
        // The other order has three colours and a transparent one.
        let three = [0x1f, 0x00, 0x00, 0xf8, 0xe4, 0xe4, 0xe4, 0xe4];
        let texels = decode_blocks(BlockKind::Bc1 { has_alpha: true }, 4, 4, &three).unwrap();
        assert_eq!(texels[8..16], [127, 0, 127, 255, 0, 0, 0, 0]);
        let texels = decode_blocks(BlockKind::Bc1 { has_alpha: false }, 4, 4, &three).unwrap();
        assert_eq!(texels[12..16], [0, 0, 0, 255]);
    }

    #[test]
    fn alpha_has_four_or_eight_values() {
        let bc2 = [&[0xf0, 0x21, 0, 0, 0, 0, 0, 0], &FOUR[..]].concat();
        let texels = decode_blocks(BlockKind::Bc2, 4, 4, &bc2).unwrap();
        assert_eq!([3, 7, 11, 15].map(|at| texels[at]), [0, 255, 17, 34]);
        // Weights 0, 1, 2, 7 of the first texels.
        let bc3 = [&[255, 0, 0b1000_1000, 0b0000_1110, 0, 0, 0, 0], &FOUR[..]].concat();
        let texels = decode_blocks(BlockKind::Bc3, 4, 4, &bc3).unwrap();
        assert_eq!([3, 7, 11, 15].map(|at| texels[at]), [255, 0, 218, 36]);
    }

    #[test]
    fn images_need_whole_blocks_and_may_end_inside_of_one() {
        let kind = BlockKind::Bc1 { has_alpha: false };
        assert_eq!(decode_blocks(kind, 5, 3, &[FOUR, FOUR].concat()).unwrap().len(), 5 * 3 * 4);
        assert!(decode_blocks(kind, 5, 3, &FOUR).is_none());
        assert!(decode_blocks(BlockKind::Bc3, u32::MAX, u32::MAX, &FOUR).is_none());
    }
}
