//! Moves leaves to the bins of a stage, in draw order. Culling thread.
//!
//! Sorting by state is a stable counting sort. Sorting by depth leaves alone what is in order already, and otherwise uses
//! [`DepthKeys`], so that leaves of equal depth keep their order.

use std::cmp::Ordering;

use super::depth_keys::{DepthKeys, depth_order_key, is_in_order};
use crate::cull::stage::{RenderBin, RenderLeaf, RenderStage};
use crate::state::{BinDetails, SortLeaf, SortMode};

/// Scratch memory of the sorts.
#[derive(Debug, Default)]
pub(in crate::cull) struct Sorter {
    /// By state: the index of its bin.
    bin_of_state: Vec<u32>,
    /// By state: the number of its leaves, and then the index of the next one in the output.
    next_index: Vec<u32>,
    /// By state: the depth of its nearest leaf, and the number of its leaves.
    groups: Vec<(f32, u32)>,
    /// States in the order of their nearest leaves, in the low halves of the keys.
    order: Vec<u64>,
    keys: DepthKeys,
    /// Keys of the application with the indices of leaves.
    custom: Vec<(u64, u32)>,
    /// By bin: its leaves, where there are several bins.
    parts: Vec<Vec<RenderLeaf>>,
}

/// Compares bins in draw order: a bin's own leaves are drawn between its bins of negative numbers and the others.
fn bin_order(a: &[BinDetails], b: &[BinDetails]) -> Ordering {
    for depth in 0..a.len().max(b.len()) {
        let number = |path: &[BinDetails]| path.get(depth).map_or((0, false), |bin| (bin.number, true));
        let key = |path: &[BinDetails]| path.get(depth).map(BinDetails::order_key);
        match number(a).cmp(&number(b)).then_with(|| key(a).cmp(&key(b))) {
            Ordering::Equal => {}
            order => return order,
        }
    }
    Ordering::Equal
}

impl Sorter {
    /// Moves leaves in traversal order to the bins of the stage, and sorts each bin by its mode.
    pub fn fill_bins(&mut self, leaves: &mut Vec<RenderLeaf>, stage: &mut RenderStage) {
        stage.spare.bins.append(&mut stage.bins);
        for state in &stage.state_sets {
            let known = stage.bins.iter_mut().find(|b| b.path == state.bins);
            if let Some(bin) = known {
                bin.add_callbacks(&state.bin_callbacks);
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
                new.add_callbacks(&state.bin_callbacks);
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

    /// Moves all leaves to one bin, whatever bins their states name. For passes in which the order is invisible.
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

    /// Fills one bin; the contents of `leaves` are unspecified afterwards.
    fn fill_bin(&mut self, leaves: &mut Vec<RenderLeaf>, bin: &mut RenderBin, states: usize) {
        match bin.sort {
            SortMode::ByState if states > 1 => {
                self.count_by_state(leaves, states);
                self.scatter(leaves, &mut bin.leaves);
            }
            SortMode::TraversalOrder | SortMode::ByState => std::mem::swap(leaves, &mut bin.leaves),
            SortMode::ByKey(key) => {
                self.custom.clear();
                self.custom.extend(leaves.iter().zip(0..).map(|(leaf, order)| {
                    let RenderLeaf { state, depth, .. } = *leaf;
                    (key.of(&SortLeaf { depth, state, order }), order)
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

    /// Sets `next_index` to the start of each state's leaves, for states in the order in which they were met.
    fn count_by_state(&mut self, leaves: &[RenderLeaf], states: usize) {
        self.next_index.clear();
        self.next_index.resize(states, 0);
        for leaf in leaves {
            self.next_index[leaf.state as usize] += 1;
        }
        let mut start = 0;
        for next in &mut self.next_index {
            start += std::mem::replace(next, start);
        }
    }

    /// Sets `order` to the states by their nearest leaf, and `next_index` to the start of each state's leaves.
    fn group_by_nearest(&mut self, leaves: &[RenderLeaf], states: usize) {
        self.groups.clear();
        self.groups.resize(states, (f32::INFINITY, 0));
        for leaf in leaves {
            let (nearest, count) = &mut self.groups[leaf.state as usize];
            *nearest = if leaf.depth < *nearest { leaf.depth } else { *nearest };
            *count += 1;
        }
        self.order.clear();
        self.order.extend(self.groups.iter().zip(0..).map(|((nearest, _), state)| depth_order_key(*nearest, 0, state)));
        self.order.sort_unstable();
        self.next_index.clear();
        self.next_index.resize(states, 0);
        let mut start = 0;
        for state in &self.order {
            let state = *state as u32 as usize;
            self.next_index[state] = start;
            start += self.groups[state].1;
        }
    }

    /// Copies each leaf to the next index of its state.
    fn scatter(&mut self, leaves: &[RenderLeaf], to: &mut Vec<RenderLeaf>) {
        resize(to, leaves.len());
        for leaf in leaves {
            let next = &mut self.next_index[leaf.state as usize];
            to[*next as usize] = *leaf;
            *next += 1;
        }
    }
}

/// Sets the length of a vector that the caller overwrites.
fn resize(leaves: &mut Vec<RenderLeaf>, len: usize) {
    let filler = RenderLeaf { slot: crate::scene::DrawSlot::NONE, state: 0, matrix: 0, depth: 0.0 };
    leaves.resize(len, filler);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_leaves_are_drawn_between_negative_bins_and_the_others() {
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
}
