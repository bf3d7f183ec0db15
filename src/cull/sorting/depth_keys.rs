//! Sorting by depth with integer keys. Culling thread.
//!
//! A key of 64 bits holds a depth and an index, so that equal depths keep their order. Few keys are sorted by comparison,
//! many by a radix sort that skips the bits that all keys share.

use crate::cull::stage::RenderLeaf;

/// Maps a depth to an integer with the same order; NaN counts as 0 so that it cannot break the order.
fn depth_key(depth: f32) -> u32 {
    let bits = if depth.is_nan() { 0 } else { depth.to_bits() };
    bits ^ (((bits as i32 >> 31) as u32) | 0x8000_0000)
}

/// Returns a key that orders by depth and then by index: front to back, or back to front if all bits of `flip` are set.
pub(super) fn depth_order_key(depth: f32, flip: u32, index: u32) -> u64 {
    u64::from(depth_key(depth) ^ flip) << 32 | u64::from(index)
}

/// Returns true if leaves are in order of their depths.
pub(super) fn is_in_order(leaves: &[RenderLeaf], flips: bool) -> bool {
    leaves.windows(2).all(|w| if flips { w[0].depth >= w[1].depth } else { w[0].depth <= w[1].depth })
}

/// Sorts leaves by depth.
#[derive(Debug, Default)]
pub(super) struct DepthKeys {
    keys: Vec<u64>,
    scratch: Vec<u64>,
    radix: Radix,
}

impl DepthKeys {
    /// Sorts the keys of leaves; [`Self::gather`] then copies the leaves.
    pub fn sort(&mut self, leaves: &[RenderLeaf], flips: bool) {
        let flip = if flips { u32::MAX } else { 0 };
        self.keys.clear();
        self.keys
            .extend(leaves.iter().enumerate().map(|(index, leaf)| depth_order_key(leaf.depth, flip, index as u32)));
        self.radix.sort(&mut self.keys, &mut self.scratch);
    }

    /// Copies the leaves in the order of the keys.
    pub fn gather(&self, leaves: &[RenderLeaf], sorted: &mut [RenderLeaf]) {
        for (leaf, key) in sorted.iter_mut().zip(&self.keys) {
            *leaf = leaves[*key as u32 as usize];
        }
    }
}

/// A radix sort of the high halves of keys whose low halves are in ascending order.
#[derive(Debug, Default)]
struct Radix {
    counts: Vec<u32>,
}

impl Radix {
    /// Fewer keys than this are sorted by comparison, which is faster then.
    const FEW: usize = 192;

    fn sort(&mut self, keys: &mut [u64], scratch: &mut Vec<u64>) {
        if keys.len() < Self::FEW {
            keys.sort_unstable();
            return;
        }
        let (mut min, mut max) = (u32::MAX, 0);
        for key in keys.iter() {
            let depth = (*key >> 32) as u32;
            min = min.min(depth);
            max = max.max(depth);
        }
        let bits = u32::BITS - (max - min).leading_zeros();
        let widest = if keys.len() < 4096 { 8 } else { 11 };
        let passes = bits.div_ceil(widest).max(1);
        let digit_bits = bits.div_ceil(passes);
        let buckets = 1usize << digit_bits;
        let digit =
            |key: u64, pass: u32| ((((key >> 32) as u32 - min) >> (pass * digit_bits)) as usize) & (buckets - 1);
        self.counts.clear();
        self.counts.resize(buckets * passes as usize, 0);
        for key in keys.iter() {
            for pass in 0..passes {
                self.counts[pass as usize * buckets + digit(*key, pass)] += 1;
            }
        }
        if scratch.len() < keys.len() {
            scratch.resize(keys.len(), 0);
        }
        let scratch = &mut scratch[..keys.len()];
        let mut in_scratch = false;
        for pass in 0..passes {
            let counts = &mut self.counts[pass as usize * buckets..][..buckets];
            if counts.iter().any(|c| *c as usize == keys.len()) {
                continue; // all keys have the same digit
            }
            let mut start = 0;
            for count in counts.iter_mut() {
                start += std::mem::replace(count, start);
            }
            let (from, to) = if in_scratch { (&*scratch, &mut *keys) } else { (&*keys, &mut *scratch) };
            for key in from {
                let next = &mut counts[digit(*key, pass)];
                to[*next as usize] = *key;
                *next += 1;
            }
            in_scratch = !in_scratch;
        }
        if in_scratch {
            keys.copy_from_slice(scratch);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn radix_sorts_like_the_standard_sort(depths in prop::collection::vec(any::<f32>(), 0..6000), shift in 0u32..3) {
            let mut radix = Radix::default();
            let key = |(i, d): (usize, &f32)| u64::from(depth_key(*d) >> (8 * shift)) << 32 | i as u64;
            let mut keys: Vec<u64> = depths.iter().enumerate().map(key).collect();
            let mut expected = keys.clone();
            expected.sort_unstable();
            radix.sort(&mut keys, &mut Vec::new());
            prop_assert_eq!(keys, expected);
        }
    }

    #[test]
    fn depth_keys_keep_the_order() {
        let depths = [f32::NEG_INFINITY, -3.0, -0.5, 0.0, 1e-20, 0.5, 3.0, f32::INFINITY];
        assert!(depths.windows(2).all(|d| depth_key(d[0]) < depth_key(d[1])));
        assert_eq!(depth_key(f32::NAN), depth_key(0.0));
    }
}
