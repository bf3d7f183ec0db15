//! The state graph: each state set once under each parent, found or inserted by identity.
//!
//! Rebuilt every frame in memory that is kept. A page knows its own chains of state sets already
//! (`Page::paths`), so the hash is asked once per chain and page, not once per leaf.

use std::sync::Arc;

use crate::state::{ResolvedState, StateSet};

/// Key of the pseudo state set of blended drawables; no `Arc` has this address.
const BLEND_KEY: usize = 1;

#[derive(Clone, Copy, Debug)]
struct Node {
    parent: u32,
    key: usize,
}

/// Open-addressing table over the nodes; entries of older frames are told by their stamp.
#[derive(Debug, Default)]
pub(super) struct StateGraph {
    nodes: Vec<Node>,
    table: Vec<(u32, u32)>,
    stamp: u32,
    /// States that have leaves, in the order first met.
    met: Vec<u32>,
    /// By state: whether it is in `met`.
    is_met: Vec<bool>,
}

/// A state without leaves.
pub(super) const NOT_MET: u32 = u32::MAX;

/// The state without any state set.
pub(super) const ROOT: u32 = 0;

impl StateGraph {
    /// Forgets the frame before and starts a new list of resolved states with the default one.
    pub fn clear(&mut self, resolved: &mut Vec<ResolvedState>) {
        self.nodes.clear();
        self.nodes.push(Node { parent: u32::MAX, key: 0 });
        resolved.clear();
        resolved.push(ResolvedState::default());
        self.met.clear();
        self.is_met.clear();
        if self.table.is_empty() || self.stamp == u32::MAX {
            self.table.clear();
            self.table.resize(64, (0, 0));
            self.stamp = 0;
        }
        self.stamp += 1;
    }

    /// States that have leaves, in the order first met.
    pub fn met(&self) -> &[u32] {
        &self.met
    }

    /// Notes that a state has leaves.
    pub fn meet(&mut self, state: u32) {
        if self.is_met.len() <= state as usize {
            self.is_met.resize(self.nodes.len(), false);
        }
        if let Some(is_met) = self.is_met.get_mut(state as usize).filter(|m| !**m) {
            *is_met = true;
            self.met.push(state);
        }
    }

    /// The state of a set under a parent.
    pub fn find_or_insert(&mut self, parent: u32, set: &Arc<StateSet>, resolved: &mut Vec<ResolvedState>) -> u32 {
        let key = Arc::as_ptr(set) as usize;
        self.find_or_insert_key(parent, key, resolved, |above| above.below(set))
    }

    /// The state of blended drawables under a parent.
    pub fn find_or_insert_blend(&mut self, parent: u32, resolved: &mut Vec<ResolvedState>) -> u32 {
        self.find_or_insert_key(parent, BLEND_KEY, resolved, ResolvedState::blended)
    }

    fn find_or_insert_key(
        &mut self,
        parent: u32,
        key: usize,
        resolved: &mut Vec<ResolvedState>,
        below: impl FnOnce(ResolvedState) -> ResolvedState,
    ) -> u32 {
        let place = match self.find(parent, key) {
            Ok(node) => return node,
            Err(place) => place,
        };
        let node = self.nodes.len() as u32;
        self.nodes.push(Node { parent, key });
        let above = resolved[parent as usize];
        resolved.push(below(above));
        self.table[place] = (self.stamp, node);
        if self.nodes.len() * 2 > self.table.len() {
            self.grow();
        }
        node
    }

    fn find(&self, parent: u32, key: usize) -> Result<u32, usize> {
        let mask = self.table.len() - 1;
        let mut place = hash(parent, key) & mask;
        loop {
            let (stamp, node) = self.table[place];
            if stamp != self.stamp {
                return Err(place);
            }
            let found = self.nodes[node as usize];
            if found.parent == parent && found.key == key {
                return Ok(node);
            }
            place = (place + 1) & mask;
        }
    }

    fn grow(&mut self) {
        let size = self.table.len() * 2;
        self.table.clear();
        self.table.resize(size, (0, 0));
        self.stamp = 1;
        for node in 1..self.nodes.len() {
            let Node { parent, key } = self.nodes[node];
            if let Err(place) = self.find(parent, key) {
                self.table[place] = (self.stamp, node as u32);
            }
        }
    }
}

/// Fibonacci hashing of the pair.
fn hash(parent: u32, key: usize) -> usize {
    let mixed = (key as u64 >> 3) ^ (u64::from(parent) << 40) ^ u64::from(parent);
    (mixed.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 32) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{Attribute, Depth};

    #[test]
    fn finds_by_identity_under_the_parent() {
        let mut graph = StateGraph::default();
        let mut resolved = Vec::new();
        let sets: Vec<_> = (0..300).map(|_| Arc::new(StateSet::default())).collect();
        for _ in 0..3 {
            graph.clear(&mut resolved);
            let first: Vec<u32> = sets.iter().map(|s| graph.find_or_insert(ROOT, s, &mut resolved)).collect();
            let again: Vec<u32> = sets.iter().map(|s| graph.find_or_insert(ROOT, s, &mut resolved)).collect();
            assert_eq!(first, again);
            assert_eq!(first, (1..=300).collect::<Vec<u32>>());
            let below = graph.find_or_insert(first[7], &sets[0], &mut resolved);
            assert_eq!(below, 301);
            assert_ne!(graph.find_or_insert_blend(ROOT, &mut resolved), below);
            assert_eq!(resolved.len(), 303);
        }
    }

    #[test]
    fn inherits_and_overrides() {
        let mut graph = StateGraph::default();
        let mut resolved = Vec::new();
        graph.clear(&mut resolved);
        let red = Arc::new(StateSet { color: Some([0.5, 0.0, 0.0, 1.0]), ..StateSet::default() });
        let write = Arc::new(
            StateSet { color: Some([0.5; 4]), ..StateSet::default() }.with(Attribute::Depth(Depth::default())),
        );
        let a = graph.find_or_insert(ROOT, &red, &mut resolved);
        let blended = graph.find_or_insert_blend(a, &mut resolved);
        assert!(!resolved[blended as usize].writes_depth());
        assert_eq!(resolved[blended as usize].bin, crate::state::BinDetails::TRANSPARENT);
        let b = graph.find_or_insert(a, &write, &mut resolved);
        let blended = graph.find_or_insert_blend(b, &mut resolved);
        assert!(resolved[blended as usize].writes_depth());
        assert_eq!(resolved[b as usize].color, [0.25, 0.0, 0.0, 0.5]);
    }
}
