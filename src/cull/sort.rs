//! Leaves to bins, in draw order.
//!
//! By state: a stable counting sort. By depth: what is in order already stays; else `u64` keys of depth and traversal
//! index, so that equal depths keep their order, through `sort_unstable` when few, else a radix sort that skips the bits
//! all keys share.

use std::cmp::Ordering;

use super::ShadowCascade;
use super::stage::{RenderBin, RenderLeaf, RenderStage};
use crate::state::{BinDetails, DrawHook, SortKey, SortLeaf, SortMode};

/// Memory of bins and stages that a frame did not need.
#[derive(Debug, Default)]
pub(super) struct Spare {
    bins: Vec<RenderBin>,
    pub stages: Vec<RenderStage>,
    pub cascades: Vec<Vec<ShadowCascade>>,
}

/// Scratch memory of the sorts.
#[derive(Debug, Default)]
pub(super) struct Sorter {
    /// By state: its bin.
    bin_of_state: Vec<u32>,
    /// By state: leaves, then the place of the next one.
    places: Vec<u32>,
    /// By state: its nearest leaf, and how many there are.
    groups: Vec<(f32, u32)>,
    /// States by their nearest leaf, in the low halves.
    order: Vec<u64>,
    keys: Keys,
    custom: Vec<(u64, u32)>,
    /// Leaves by bin, where there are several bins.
    parts: Vec<Vec<RenderLeaf>>,
}

/// The order in which bins are drawn: a bin's own leaves stand between its negative bins and the others.
fn bin_order(a: &[BinDetails], b: &[BinDetails]) -> Ordering {
    for depth in 0..a.len().max(b.len()) {
        let number = |path: &[BinDetails]| path.get(depth).map_or((0, false), |bin| (bin.number, true));
        let place = |path: &[BinDetails]| path.get(depth).map(BinDetails::place);
        match number(a).cmp(&number(b)).then_with(|| place(a).cmp(&place(b))) {
            Ordering::Equal => {}
            order => return order,
        }
    }
    Ordering::Equal
}

impl RenderBin {
    /// Takes callbacks where there are none yet.
    fn called_by(&mut self, callbacks: &[Option<DrawHook>]) {
        for (place, callback) in callbacks.iter().enumerate().filter(|(_, c)| c.is_some()) {
            if self.callbacks.len() <= place {
                self.callbacks.resize(place + 1, None);
            }
            if let Some(own @ None) = self.callbacks.get_mut(place) {
                own.clone_from(callback);
            }
        }
    }
}

impl Sorter {
    /// Moves the leaves (in traversal order) to the bins of the stage, each in its order.
    pub fn fill_bins(&mut self, leaves: &mut Vec<RenderLeaf>, stage: &mut RenderStage) {
        stage.spare.bins.append(&mut stage.bins);
        for state in &stage.state_sets {
            let known = stage.bins.iter_mut().find(|b| b.path == state.bins);
            if let Some(bin) = known {
                bin.called_by(&state.bin_callbacks);
            } else {
                let mut new = stage.spare.bins.pop().unwrap_or(RenderBin {
                    path: Vec::new(),
                    callbacks: Vec::new(),
                    sort: SortMode::ByState,
                    leaves: Vec::new(),
                });
                new.path.clear();
                new.path.extend_from_slice(&state.bins);
                new.callbacks.clear();
                new.called_by(&state.bin_callbacks);
                new.sort = state.bin().sort;
                stage.bins.push(new);
            }
        }
        stage.bins.sort_unstable_by(|a, b| bin_order(&a.path, &b.path));
        let states = stage.state_sets.len();
        if let [bin] = stage.bins.as_mut_slice() {
            self.fill_bin(leaves, bin, states);
            return;
        }
        self.bin_of_state.clear();
        for state in &stage.state_sets {
            let bin = stage.bins.iter().position(|b| b.path == state.bins);
            self.bin_of_state.push(bin.unwrap_or(0) as u32);
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
            self.fill_bin(part, bin, states);
        }
        self.parts = parts;
    }

    /// Moves the leaves to one bin, whatever bins their states name: for passes in which no order can be seen.
    pub fn fill_one_bin(&mut self, leaves: &mut Vec<RenderLeaf>, stage: &mut RenderStage) {
        stage.spare.bins.extend(stage.bins.drain(1.min(stage.bins.len())..));
        if stage.bins.is_empty() {
            let bin = stage.spare.bins.pop();
            stage.bins.push(bin.unwrap_or(RenderBin {
                path: Vec::new(),
                sort: SortMode::ByState,
                leaves: Vec::new(),
                callbacks: Vec::new(),
            }));
        }
        if let Some(bin) = stage.bins.first_mut() {
            bin.path.clear();
            bin.callbacks.clear();
            bin.sort = SortMode::ByState;
            std::mem::swap(leaves, &mut bin.leaves);
        }
    }

    /// Fills one bin; `leaves` is used up.
    fn fill_bin(&mut self, leaves: &mut Vec<RenderLeaf>, bin: &mut RenderBin, states: usize) {
        match bin.sort {
            SortMode::ByState if states > 1 => {
                self.count_by_state(leaves, states);
                self.scatter(leaves, &mut bin.leaves);
            }
            SortMode::TraversalOrder | SortMode::ByState => std::mem::swap(leaves, &mut bin.leaves),
            SortMode::ByKey(SortKey(key)) => {
                self.custom.clear();
                self.custom.extend(leaves.iter().zip(0..).map(|(leaf, order)| {
                    let RenderLeaf { state, depth, .. } = *leaf;
                    (key(&SortLeaf { depth, state, order }), order)
                }));
                self.custom.sort_unstable();
                bin.leaves.clear();
                bin.leaves.extend(self.custom.iter().map(|(_, order)| leaves[*order as usize]));
            }
            SortMode::ByStateThenFrontToBack if states > 1 => {
                self.group_by_nearest(leaves, states);
                self.scatter(leaves, &mut bin.leaves);
                let mut start = 0;
                for state in &self.order {
                    let end = start + self.groups[*state as u32 as usize].1 as usize;
                    let group = &mut bin.leaves[start..end];
                    if !is_in_order(group, false) {
                        self.keys.sort(group, false);
                        let sorted = &mut leaves[start..end];
                        self.keys.gather(group, sorted);
                        group.copy_from_slice(sorted);
                    }
                    start = end;
                }
            }
            SortMode::ByStateThenFrontToBack | SortMode::FrontToBack | SortMode::BackToFront => {
                let flips = bin.sort == SortMode::BackToFront;
                if is_in_order(leaves, flips) {
                    std::mem::swap(leaves, &mut bin.leaves);
                } else {
                    self.keys.sort(leaves, flips);
                    resize(&mut bin.leaves, leaves.len());
                    self.keys.gather(leaves, &mut bin.leaves);
                }
            }
        }
    }

    /// Leaves in `places` where each state's leaves start; states in the order first met.
    fn count_by_state(&mut self, leaves: &[RenderLeaf], states: usize) {
        self.places.clear();
        self.places.resize(states, 0);
        for leaf in leaves {
            self.places[leaf.state as usize] += 1;
        }
        let mut start = 0;
        for place in &mut self.places {
            start += std::mem::replace(place, start);
        }
    }

    /// Leaves in `places` where each state's leaves start, and in `order` the states by their nearest leaf.
    fn group_by_nearest(&mut self, leaves: &[RenderLeaf], states: usize) {
        self.groups.clear();
        self.groups.resize(states, (f32::INFINITY, 0));
        for leaf in leaves {
            let (nearest, count) = &mut self.groups[leaf.state as usize];
            *nearest = if leaf.depth < *nearest { leaf.depth } else { *nearest };
            *count += 1;
        }
        self.order.clear();
        self.order.extend(self.groups.iter().zip(0..).map(|((nearest, _), state)| ordered(*nearest, 0, state)));
        self.order.sort_unstable();
        self.places.clear();
        self.places.resize(states, 0);
        let mut start = 0;
        for state in &self.order {
            let state = *state as u32 as usize;
            self.places[state] = start;
            start += self.groups[state].1;
        }
    }

    /// Moves each leaf to the next place of its state.
    fn scatter(&mut self, leaves: &[RenderLeaf], to: &mut Vec<RenderLeaf>) {
        resize(to, leaves.len());
        for leaf in leaves {
            let place = &mut self.places[leaf.state as usize];
            to[*place as usize] = *leaf;
            *place += 1;
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

/// The key of something with a depth: rising from front to back, or where all bits of `flip` are set from back to front,
/// then by its place.
fn ordered(depth: f32, flip: u32, place: u32) -> u64 {
    u64::from(depth_key(depth) ^ flip) << 32 | u64::from(place)
}

/// True for leaves that are in order of their depths.
fn is_in_order(leaves: &[RenderLeaf], flips: bool) -> bool {
    leaves.windows(2).all(|w| if flips { w[0].depth >= w[1].depth } else { w[0].depth <= w[1].depth })
}

/// Depths and places of leaves, in order.
#[derive(Debug, Default)]
struct Keys {
    keys: Vec<u64>,
    scratch: Vec<u64>,
    radix: Radix,
}

impl Keys {
    fn sort(&mut self, leaves: &[RenderLeaf], flips: bool) {
        let flip = if flips { u32::MAX } else { 0 };
        self.keys.clear();
        self.keys.extend(leaves.iter().enumerate().map(|(place, leaf)| ordered(leaf.depth, flip, place as u32)));
        self.radix.sort(&mut self.keys, &mut self.scratch);
    }

    /// Copies the leaves in the order of the keys.
    fn gather(&self, leaves: &[RenderLeaf], sorted: &mut [RenderLeaf]) {
        for (leaf, key) in sorted.iter_mut().zip(&self.keys) {
            *leaf = leaves[*key as u32 as usize];
        }
    }
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
    fn bins_nest_between_the_negative_and_the_others() {
        let bin = |numbers: &[i32]| -> Vec<BinDetails> {
            numbers.iter().map(|n| BinDetails::new(*n, SortMode::ByState)).collect()
        };
        let drawn: Vec<_> =
            [&[-2][..], &[-1, -5], &[-1], &[-1, 3], &[], &[0], &[3, -1], &[3], &[3, 0], &[3, 7], &[10]].map(bin).into();
        for (i, a) in drawn.iter().enumerate() {
            for (j, b) in drawn.iter().enumerate() {
                assert_eq!(bin_order(a, b), i.cmp(&j), "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn depth_keys_keep_the_order() {
        let depths = [f32::NEG_INFINITY, -3.0, -0.5, 0.0, 1e-20, 0.5, 3.0, f32::INFINITY];
        assert!(depths.windows(2).all(|d| depth_key(d[0]) < depth_key(d[1])));
        assert_eq!(depth_key(f32::NAN), depth_key(0.0));
    }
}
