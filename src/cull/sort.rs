//! Leaves to bins, in draw order.
//!
//! By state: a stable counting sort. By depth: `u64` keys of depth and traversal index, so that equal depths keep
//! their order, through `sort_unstable` when few, else a radix sort that skips the bits all keys share.

use super::stage::{RenderBin, RenderLeaf, RenderStage};
use super::state_graph::NOT_MET;
use crate::state::SortMode;

/// Memory of bins that a frame did not need.
#[derive(Debug, Default)]
pub(super) struct Spare {
    bins: Vec<RenderBin>,
}

/// Scratch memory of the sorts.
#[derive(Debug, Default)]
pub(super) struct Sorter {
    /// By state: bin, and what the current pass needs.
    bin_of_state: Vec<u32>,
    /// By group: leaves, then the place of the next one.
    places: Vec<u32>,
    /// By state: the group of its leaves in the current bin.
    group_of_state: Vec<u32>,
    nearest: Vec<(f32, u32)>,
    keys: Vec<u64>,
    keys_scratch: Vec<u64>,
    radix: Radix,
    /// Leaves by bin, where there are several bins.
    parts: Vec<Vec<RenderLeaf>>,
}

impl Sorter {
    /// Moves the leaves (in traversal order) to the bins of the stage, each in its order. `met` holds the states
    /// that have leaves, in the order first met.
    pub fn fill_bins(&mut self, leaves: &mut Vec<RenderLeaf>, met: &[u32], stage: &mut RenderStage) {
        stage.spare.bins.append(&mut stage.bins);
        for state in met {
            let bin = stage.state_sets[*state as usize].bin;
            if !stage.bins.iter().any(|b| b.number == bin.number) {
                let mut new = stage.spare.bins.pop().unwrap_or(RenderBin {
                    number: 0,
                    sort: SortMode::ByState,
                    leaves: Vec::new(),
                });
                (new.number, new.sort) = (bin.number, bin.sort);
                stage.bins.push(new);
            }
        }
        stage.bins.sort_unstable_by_key(|b| b.number);
        if let [bin] = stage.bins.as_mut_slice() {
            self.fill_bin(leaves, met, bin, stage.state_sets.len());
            return;
        }
        self.bin_of_state.clear();
        self.bin_of_state.resize(stage.state_sets.len(), 0);
        for state in met {
            let number = stage.state_sets[*state as usize].bin.number;
            let bin = stage.bins.iter().position(|b| b.number == number).unwrap_or(0);
            self.bin_of_state[*state as usize] = bin as u32;
        }
        if self.parts.len() < stage.bins.len() {
            self.parts.resize_with(stage.bins.len(), Vec::new);
        }
        let mut parts = std::mem::take(&mut self.parts);
        for part in &mut parts {
            part.clear();
        }
        for leaf in leaves.iter() {
            parts[self.bin_of_state[leaf.state as usize] as usize].push(*leaf);
        }
        for (bin, part) in stage.bins.iter_mut().zip(&mut parts) {
            self.fill_bin(part, met, bin, stage.state_sets.len());
        }
        self.parts = parts;
    }

    /// Fills one bin; `leaves` is used up.
    fn fill_bin(&mut self, leaves: &mut Vec<RenderLeaf>, met: &[u32], bin: &mut RenderBin, states: usize) {
        let by_depth = match bin.sort {
            SortMode::TraversalOrder => false,
            SortMode::ByState if met.len() > 1 => {
                self.group_by_state(leaves, met, states, false);
                resize(&mut bin.leaves, leaves.len());
                for leaf in leaves.iter() {
                    let place = &mut self.places[self.group_of_state[leaf.state as usize] as usize];
                    bin.leaves[*place as usize] = *leaf;
                    *place += 1;
                }
                return;
            }
            SortMode::ByState => false,
            SortMode::ByStateThenFrontToBack | SortMode::FrontToBack | SortMode::BackToFront => true,
        };
        if !by_depth {
            std::mem::swap(leaves, &mut bin.leaves);
            return;
        }
        let flip = if bin.sort == SortMode::BackToFront { u32::MAX } else { 0 };
        let key = |index: usize, leaf: &RenderLeaf| u64::from(depth_key(leaf.depth) ^ flip) << 32 | index as u64;
        if bin.sort == SortMode::ByStateThenFrontToBack && met.len() > 1 {
            self.group_by_state(leaves, met, states, true);
            self.keys.resize(leaves.len(), 0);
            for (index, leaf) in leaves.iter().enumerate() {
                let place = &mut self.places[self.group_of_state[leaf.state as usize] as usize];
                self.keys[*place as usize] = key(index, leaf);
                *place += 1;
            }
            // The place behind the last leaf of a group is now the start of the next.
            let mut start = 0;
            for end in &self.places {
                self.radix.sort(&mut self.keys[start..*end as usize], &mut self.keys_scratch);
                start = *end as usize;
            }
        } else {
            self.keys.clear();
            self.keys.extend(leaves.iter().enumerate().map(|(index, leaf)| key(index, leaf)));
            self.radix.sort(&mut self.keys, &mut self.keys_scratch);
        }
        bin.leaves.clear();
        bin.leaves.extend(self.keys.iter().map(|key| leaves[*key as u32 as usize]));
    }

    /// Counts the leaves of each state and leaves in `places` where each state's group starts; groups in the order
    /// first met, or by their nearest leaf.
    fn group_by_state(&mut self, leaves: &[RenderLeaf], met: &[u32], states: usize, by_nearest: bool) {
        let groups = met.len();
        self.group_of_state.clear();
        self.group_of_state.resize(states, NOT_MET);
        if by_nearest {
            self.nearest.clear();
            self.nearest.resize(states, (f32::INFINITY, NOT_MET));
            for (order, state) in met.iter().enumerate() {
                self.nearest[*state as usize].1 = order as u32;
            }
            for leaf in leaves {
                let nearest = &mut self.nearest[leaf.state as usize].0;
                *nearest = if leaf.depth < *nearest { leaf.depth } else { *nearest };
            }
            // From "by state" to "by group": nearest first, then first met.
            self.nearest.retain(|(_, order)| *order != NOT_MET);
            self.nearest.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for (group, (_, order)) in self.nearest.iter().enumerate() {
                self.group_of_state[met[*order as usize] as usize] = group as u32;
            }
        } else {
            for (order, state) in met.iter().enumerate() {
                self.group_of_state[*state as usize] = order as u32;
            }
        }
        self.places.clear();
        self.places.resize(groups, 0);
        for leaf in leaves {
            self.places[self.group_of_state[leaf.state as usize] as usize] += 1;
        }
        let mut start = 0;
        for place in &mut self.places {
            start += std::mem::replace(place, start);
        }
    }
}

/// Gives a vector a length; what it holds is overwritten by the caller.
fn resize(leaves: &mut Vec<RenderLeaf>, len: usize) {
    let filler = RenderLeaf { slot: crate::scene::DrawSlot::NONE, state: 0, matrix: 0, depth: 0.0 };
    leaves.resize(len, filler);
}

/// Maps depths to integers in the same order; NaN counts as 0 so that it cannot break the order.
fn depth_key(depth: f32) -> u32 {
    let bits = if depth.is_nan() { 0 } else { depth.to_bits() };
    bits ^ (((bits as i32 >> 31) as u32) | 0x8000_0000)
}

/// Sorts keys whose low halves rise already.
#[derive(Debug, Default)]
struct Radix {
    counts: Vec<u32>,
}

impl Radix {
    /// Fewer keys are sorted by comparison.
    const FEW: usize = 192;

    fn sort(&mut self, keys: &mut [u64], scratch: &mut Vec<u64>) {
        if keys.is_sorted() {
            return;
        }
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
                continue; // one digit for all
            }
            let mut start = 0;
            for count in counts.iter_mut() {
                start += std::mem::replace(count, start);
            }
            let (from, to) = if in_scratch { (&*scratch, &mut *keys) } else { (&*keys, &mut *scratch) };
            for key in from {
                let place = &mut counts[digit(*key, pass)];
                to[*place as usize] = *key;
                *place += 1;
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
