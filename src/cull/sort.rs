//! Leaves to bins, in draw order.

use super::stage::{RenderBin, RenderLeaf, RenderStage};
use crate::state::SortMode;

/// Memory of bins that a frame did not need.
#[derive(Debug, Default)]
pub(super) struct Spare {
    bins: Vec<RenderBin>,
}

/// Scratch memory of the sorts.
#[derive(Debug, Default)]
pub(super) struct Sorter {
    bin_of_state: Vec<u32>,
    ranks: Vec<u32>,
    nearest: Vec<(f32, u32)>,
    keys: Vec<(u64, u32)>,
    scratch: Vec<RenderLeaf>,
}

impl Sorter {
    /// Moves the leaves (in traversal order) to the bins of the stage, each in its order.
    pub fn fill_bins(&mut self, leaves: &mut Vec<RenderLeaf>, stage: &mut RenderStage) {
        stage.spare.bins.append(&mut stage.bins);
        for state in 0..stage.state_sets.len() {
            let bin = stage.state_sets[state].bin;
            if !stage.bins.iter().any(|b| b.number == bin.number) {
                let mut new = stage.spare.bins.pop().unwrap_or(RenderBin {
                    number: 0,
                    sort: SortMode::ByState,
                    leaves: Vec::new(),
                });
                new.leaves.clear();
                (new.number, new.sort) = (bin.number, bin.sort);
                stage.bins.push(new);
            }
        }
        stage.bins.sort_by_key(|b| b.number);
        self.bin_of_state.clear();
        for state in &stage.state_sets {
            let bin = stage.bins.iter().position(|b| b.number == state.bin.number).unwrap_or(0);
            self.bin_of_state.push(bin as u32);
        }
        for leaf in leaves.iter() {
            stage.bins[self.bin_of_state[leaf.state as usize] as usize].leaves.push(*leaf);
        }
        let mut bin = 0;
        while bin < stage.bins.len() {
            if stage.bins[bin].leaves.is_empty() {
                let empty = stage.bins.remove(bin);
                stage.spare.bins.push(empty);
            } else {
                self.sort_bin(&mut stage.bins[bin], stage.state_sets.len());
                bin += 1;
            }
        }
    }

    fn sort_bin(&mut self, bin: &mut RenderBin, states: usize) {
        let leaves = &mut bin.leaves;
        self.ranks.clear();
        match bin.sort {
            SortMode::TraversalOrder => return,
            SortMode::ByState => self.ranks.extend(0..states as u32),
            SortMode::ByStateThenFrontToBack => {
                self.nearest.clear();
                self.nearest.extend((0..states as u32).map(|s| (f32::INFINITY, s)));
                for leaf in leaves.iter() {
                    let nearest = &mut self.nearest[leaf.state as usize].0;
                    *nearest = nearest.min(leaf.depth);
                }
                self.nearest.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
                self.ranks.resize(states, 0);
                for (rank, (_, state)) in self.nearest.iter().enumerate() {
                    self.ranks[*state as usize] = rank as u32;
                }
            }
            SortMode::FrontToBack | SortMode::BackToFront => self.ranks.resize(states, 0),
        }
        self.keys.clear();
        self.keys.extend(leaves.iter().enumerate().map(|(i, leaf)| {
            let depth = match bin.sort {
                SortMode::ByState | SortMode::TraversalOrder => 0,
                SortMode::BackToFront => !depth_key(leaf.depth),
                _ => depth_key(leaf.depth),
            };
            (u64::from(self.ranks[leaf.state as usize]) << 32 | u64::from(depth), i as u32)
        }));
        self.keys.sort_unstable();
        self.scratch.clear();
        self.scratch.extend(self.keys.iter().map(|(_, i)| leaves[*i as usize]));
        std::mem::swap(leaves, &mut self.scratch);
    }
}

/// Maps depths to integers in the same order; NaN counts as 0 so that it cannot break the order.
pub(super) fn depth_key(depth: f32) -> u32 {
    let bits = if depth.is_nan() { 0 } else { depth.to_bits() };
    bits ^ (((bits as i32 >> 31) as u32) | 0x8000_0000)
}
