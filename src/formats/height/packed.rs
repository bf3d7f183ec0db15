//! Decodes packed heights: steps of one size for a whole set, as differences from a plane through three neighbours, their bytes
//! in planes, compressed by zstd. `docs/formats/packed-sets.md` describes every byte.

use crate::fetch::{IoError, Limits, about_to_allocate, encoding};

/// The first bytes of packed heights.
pub(in crate::formats) const MAGIC: &[u8; 4] = b"TRHT";
const HEADER_BYTES: usize = 24;

/// Decodes `stride * stride` heights in metres, southern row first, each row from west to east.
pub(super) fn decode_heights(uri: &str, bytes: &[u8], stride: usize, limits: &Limits) -> Result<Vec<f32>, IoError> {
    let bad = |reason: &str| IoError::invalid(uri, format!("packed heights: {reason}"));
    let Some((header, data)) = bytes.split_at_checked(HEADER_BYTES) else { return Err(bad("end early")) };
    let (header, _) = header.as_chunks::<4>();
    let word = |at: usize| u32::from_le_bytes(header[at]);
    let [_, [version, planes, compression, _], [low, high, _, _], ..] = *header else { return Err(bad("end early")) };
    if version != 1 {
        return Err(IoError::unsupported(uri, format!("packed heights of version {version}")));
    }
    let side = usize::from(u16::from_le_bytes([low, high]));
    if side != stride {
        return Err(bad(&format!("{side} x {side} samples, {stride} x {stride} expected")));
    }
    if planes > 4 {
        return Err(bad("differences of more than four bytes"));
    }
    let (count, first) = (side * side, word(3) as i32);
    let size = count * usize::from(planes);
    if 4 * count as u64 > limits.max_image_bytes {
        return Err(bad("too many samples"));
    }
    // The steps and the heights.
    about_to_allocate(8 * count as u64).map_err(|error| error.at(uri))?;
    let step_m = f64::from_bits(u64::from(word(4)) | u64::from(word(5)) << 32);
    let unpacked;
    let data = match compression {
        0 => data,
        1 => {
            unpacked = encoding::unzstd(uri, data, size as u64)?;
            &unpacked
        }
        _ => return Err(IoError::unsupported(uri, "a compression of packed heights")),
    };
    if data.len() != size {
        return Err(bad(&format!("{} bytes of differences, {size} expected", data.len())));
    }
    let mut steps = vec![0i32; count];
    for (plane, bytes) in data.chunks_exact(count).enumerate() {
        steps.iter_mut().zip(bytes).for_each(|(step, byte)| *step |= (u32::from(*byte) << (8 * plane)) as i32);
    }
    restore(&mut steps, side, first);
    let heights: Vec<f32> = match step_m {
        0.0 => steps.iter().map(|step| f32::from_bits((step ^ ((step >> 31) & i32::MAX)) as u32)).collect(),
        _ => steps.iter().map(|step| (f64::from(*step) * step_m) as f32).collect(),
    };
    if !heights.iter().all(|h| h.is_finite() && h.abs() < 1e6) {
        return Err(bad("a height is not finite"));
    }
    Ok(heights)
}

/// Replaces differences by samples. A difference is from the plane through the western, southern and south-western neighbours;
/// in the first row and column from the only neighbour.
fn restore(steps: &mut [i32], side: usize, first: i32) {
    let signed = |difference: i32| ((difference as u32 >> 1) as i32) ^ -(difference & 1);
    let mut before: &[i32] = &[];
    for row in steps.chunks_exact_mut(side) {
        // The sum of a row's differences is the difference of this row and the one before.
        let mut sum = 0i32;
        if before.is_empty() {
            sum = first;
        }
        for (k, own) in row.iter_mut().enumerate() {
            sum = sum.wrapping_add(signed(*own));
            *own = before.get(k).map_or(sum, |below| below.wrapping_add(sum));
        }
        before = row;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::writers::write_packed_heights;

    /// Returns heights that were written and read, and the bytes of the file.
    fn read_back(side: usize, step_m: f64, heights: &[f32]) -> (Vec<f32>, usize) {
        let file = write(side, step_m, heights);
        (decode_heights("t", &file, side, &Limits::default()).unwrap(), file.len())
    }

    fn write(side: usize, step_m: f64, heights: &[f32]) -> Vec<u8> {
        use ruzstd::encoding::{CompressionLevel, compress_to_vec};
        let compress = |bytes: &[u8]| Ok(compress_to_vec(bytes, CompressionLevel::Fastest));
        write_packed_heights("t", side, step_m, heights, compress).unwrap()
    }

    fn hills(side: usize, step_m: f64) -> Vec<f32> {
        let height = |k: usize| {
            let (x, y) = ((k % side) as f64, (k / side) as f64);
            800.0 + 90.0 * (0.11 * x).sin() * (0.07 * y).cos() - 3.7 * x
        };
        (0..side * side).map(|k| ((height(k) / step_m).round() * step_m) as f32).collect()
    }

    #[test]
    fn heights_are_read_back_bit_for_bit() {
        for (side, step_m) in [(1, 1.0), (2, 0.5), (67, 1.0 / 128.0), (67, 0.1), (259, 0.25)] {
            let heights = hills(side, step_m);
            let (read, bytes) = read_back(side, step_m, &heights);
            assert!(read == heights, "{side} {step_m}");
            assert!(side < 67 || bytes < side * side * 3 / 2, "{bytes} bytes for {side} x {side}");
        }
        assert_eq!(read_back(67, 0.5, &[250.5; 67 * 67]), (vec![250.5; 67 * 67], HEADER_BYTES));
        let far: Vec<f32> = (0..9).map(|k| if k % 2 == 0 { 9e5 } else { -9e5 }).collect();
        assert_eq!(read_back(3, 1.0 / 128.0, &far).0, far);
    }

    /// Heights that are no steps keep their bits.
    #[test]
    fn heights_between_steps_are_not_rounded() {
        let heights: Vec<f32> = (0..49).map(|k| (k as f32 - 20.0) * 0.1 + 1.0 / 3.0).chain([-0.0; 15]).collect();
        let read = read_back(8, 1.0 / 128.0, &heights).0;
        assert!(read.iter().map(|h| h.to_bits()).eq(heights.iter().map(|h| h.to_bits())));
    }

    #[test]
    fn invalid_bytes_are_errors() {
        let file = write(67, 0.25, &hills(67, 0.25));
        let decode = |bytes: &[u8]| decode_heights("a/t.heights", bytes, 67, &Limits::default());
        // The last four bytes are the checksum of the zstd frame.
        for size in 0..file.len() - 4 {
            assert!(decode(&file[..size]).unwrap_err().to_string().contains("a/t.heights"), "{size}");
        }
        let with = |at: usize, byte: u8| {
            let mut file = file.clone();
            file[at] = byte;
            decode(&file).unwrap_err().to_string()
        };
        assert!(with(4, 9).contains("version 9"));
        assert!(with(5, 5).contains("four bytes"));
        assert!(with(5, 2).contains("t.heights"));
        assert!(with(6, 7).contains("compression"));
        assert!(with(8, 66).contains("66 x 66 samples, 67 x 67 expected"));
        assert!(with(23, 0x7f).contains("not finite"));
    }
}
