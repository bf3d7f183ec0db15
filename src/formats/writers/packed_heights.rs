//! Writes packed heights: the form of height tiles in packed sets. A third of the size of EXR, and ten times as quick to write.

use std::cell::RefCell;

use crate::fetch::IoError;

/// Sides beyond this are no tiles.
const MAX_SIDE: usize = 1 << 12;
/// Steps beyond this have no room for differences.
const MAX_STEPS: f64 = (1i32 << 29) as f64;

/// Buffers that a thread uses again for each tile.
#[derive(Default)]
struct Buffers {
    steps: Vec<i32>,
    differences: Vec<u32>,
    planes: Vec<u8>,
}

thread_local! {
    static BUFFERS: RefCell<Buffers> = RefCell::default();
}

/// Returns the bytes of `side * side` heights in metres, **south row first**. Heights that are whole numbers of `step_m` take the
/// fewest bytes; if any is not, all keep the bits of their floats. `compress` makes a zstd frame: this crate has no encoder that
/// is quick. Errors name `uri`.
pub fn write_packed_heights(
    uri: &str,
    side: usize,
    step_m: f64,
    heights: &[f32],
    compress: impl FnOnce(&[u8]) -> std::io::Result<Vec<u8>>,
) -> Result<Vec<u8>, IoError> {
    let invalid = |reason: String| IoError::Invalid { uri: uri.to_owned(), reason };
    if side == 0 || side > MAX_SIDE || heights.len() != side * side {
        return Err(invalid(format!("{} heights for {side} x {side}", heights.len())));
    }
    if !(step_m.is_finite() && step_m > 0.0 && heights.iter().all(|h| h.is_finite())) {
        return Err(invalid("heights or their step are not finite".to_owned()));
    }
    BUFFERS.with_borrow_mut(|Buffers { steps, differences, planes }| {
        let step_m = if count_steps(heights, step_m, steps) { step_m } else { 0.0 };
        if step_m == 0.0 {
            steps.clear();
            // The order of the numbers is that of the floats.
            steps.extend(heights.iter().map(|h| h.to_bits() as i32).map(|bits| bits ^ ((bits >> 31) & i32::MAX)));
        }
        let first = steps[0];
        let all = subtract(steps, side, differences);
        let bytes = (4 - all.leading_zeros() as usize / 8).min(4);
        planes.clear();
        for plane in 0..bytes {
            planes.extend(differences.iter().map(|difference| (difference >> (8 * plane)) as u8));
        }
        let data = compress(planes).map_err(|e| invalid(format!("zstd: {e}")))?;
        // Bytes that do not become fewer are stored as they are.
        let (compression, data) = if data.len() < planes.len() { (1, &data) } else { (0, &*planes) };
        let mut file = Vec::with_capacity(24 + data.len());
        file.extend(b"TRHT");
        file.extend([1, bytes as u8, compression, 0]);
        file.extend((side as u32).to_le_bytes());
        file.extend(first.to_le_bytes());
        file.extend(step_m.to_le_bytes());
        file.extend_from_slice(data);
        Ok(file)
    })
}

/// Counts the steps of each height. Returns false if a height is not a whole number of them, or too many.
fn count_steps(heights: &[f32], step_m: f64, steps: &mut Vec<i32>) -> bool {
    /// Numbers from here on have steps of 1, so that adding it rounds, and the lowest bits are the sum.
    const ROUNDER: f64 = (3u64 << 51) as f64;
    let per_m = 1.0 / step_m;
    steps.clear();
    // Steps of more than 31 bits become others, which are found below.
    steps.extend(heights.iter().map(|h| (f64::from(*h) * per_m + ROUNDER).to_bits() as i32));
    // Negative zero has other bits than zero.
    heights.iter().zip(&*steps).fold(true, |all, (h, step)| {
        let is_same = ((f64::from(*step) * step_m) as f32).to_bits() == h.to_bits();
        all & is_same & (f64::from(step.wrapping_abs()) < MAX_STEPS)
    })
}

/// Replaces samples by their differences from the plane through three neighbours, with the sign in the lowest bit. Returns the
/// bits that any difference has.
fn subtract(steps: &[i32], side: usize, differences: &mut Vec<u32>) -> u32 {
    let zigzag = |difference: i32| (difference << 1 ^ difference >> 31) as u32;
    differences.clear();
    let mut all = 0u32;
    let (first, others) = steps.split_at(side);
    differences.push(0);
    differences.extend(first.windows(2).map(|two| zigzag(two[1].wrapping_sub(two[0]))));
    let mut below = first;
    for row in others.chunks_exact(side) {
        differences.push(zigzag(row[0].wrapping_sub(below[0])));
        let pairs = row.windows(2).zip(below.windows(2));
        differences.extend(
            pairs.map(|(own, below)| zigzag(own[1].wrapping_sub(own[0]).wrapping_sub(below[1].wrapping_sub(below[0])))),
        );
        below = row;
    }
    differences.iter().for_each(|difference| all |= difference);
    all
}
