//! The state graph: each state set once under each parent, found or inserted by identity.
//!
//! Kept from frame to frame, with what each chain of state sets resolves to, so that a steady frame resolves nothing.
//! Holds no state set alive: what is gone is noticed within some frames; and when most of it is no longer met, all of
//! it is forgotten. A page knows its own chains of state sets already
//! (`Page::paths`), so the hash is asked once per chain and page, not once per leaf.

use std::sync::{Arc, Weak};

use super::stage::RenderStage;
use crate::math::random::fibonacci_hash;
use crate::state::{ResolvedState, StateSet};

/// Key of the pseudo state set of blended drawables; no `Arc` has this address.
const BLEND_KEY: usize = 1;
/// Keys of the pseudo state sets of other views: odd numbers from here.
const VIEW_KEY: usize = 3;
/// Keys of the pseudo state sets of fades: even numbers that are no multiples of 4, from here.
const FADE_KEY: usize = 2;
// Addresses of state sets are multiples of 4.
const _: () = assert!(align_of::<StateSet>() >= 4);

/// What leaves have that no state set says.
#[derive(Clone, Copy, Debug, Default)]
struct At {
    /// Projection.
    view: u32,
    /// One more than the index of a fade of the stage.
    fade: u32,
}

#[derive(Debug)]
struct Node {
    parent: u32,
    key: usize,
    resolved: Arc<ResolvedState>,
    at: At,
    /// The stage in which it was last met, and its place there.
    met_in: u32,
    place: u32,
    /// Keeps the state set's address from being another's, not the state set.
    set: Option<Weak<StateSet>>,
}

/// Nodes, and an open-addressing table over them.
#[derive(Debug)]
pub(super) struct StateGraph {
    nodes: Vec<Node>,
    table: Vec<u32>,
    /// By path of a page: the state that was found last, mostly the one to be found.
    hints: Vec<u32>,
    /// Counts stages.
    stage: u32,
    /// Nodes met in the frame before.
    met: usize,
    /// Frames until state sets that are gone are looked for.
    until_sweep: u32,
}

/// The state without any state set.
pub(super) const ROOT: u32 = 0;
const EMPTY: u32 = u32::MAX;
/// Fewer nodes are never forgotten.
const FEW: usize = 4096;
/// Frames between two looks for state sets that are gone.
const SWEEP_FRAMES: u32 = 16;
/// Key of nodes whose state set, or one above, is gone; matches nothing.
const GONE: usize = usize::MAX;

impl Default for StateGraph {
    fn default() -> Self {
        let root =
            Node { parent: EMPTY, key: 0, resolved: Arc::default(), at: At::default(), met_in: 0, place: 0, set: None };
        Self {
            nodes: vec![root],
            table: vec![EMPTY; 64],
            hints: Vec::new(),
            stage: 0,
            met: 0,
            until_sweep: SWEEP_FRAMES,
        }
    }
}

impl StateGraph {
    /// Starts a frame: forgets everything when eight times as much is held as the frame before met.
    pub fn start_frame(&mut self) {
        if self.nodes.len() > FEW + 8 * self.met {
            let stage = self.stage;
            *self = Self { stage, ..Self::default() };
        }
        self.met = 0;
        self.until_sweep -= 1;
        if self.until_sweep == 0 {
            self.until_sweep = SWEEP_FRAMES;
            self.sweep();
        }
    }

    /// Lets go of what state sets that are gone came to, and what is below them. Parents come before their children.
    fn sweep(&mut self) {
        for node in 1..self.nodes.len() {
            let parent = self.nodes[node].parent as usize;
            let is_gone = |n: &Node| n.set.as_ref().is_some_and(|s| s.strong_count() == 0);
            if self.nodes[node].key != GONE && (self.nodes[parent].key == GONE || is_gone(&self.nodes[node])) {
                let root = self.nodes[0].resolved.clone();
                let node = &mut self.nodes[node];
                (node.key, node.set, node.resolved) = (GONE, None, root);
            }
        }
    }

    /// Starts a stage: no state has leaves.
    pub fn start_stage(&mut self) {
        self.stage = self.stage.wrapping_add(1);
    }

    /// The place of a state among those of the stage that have leaves.
    #[inline]
    pub fn meet(&mut self, state: u32, stage: &mut RenderStage) -> u32 {
        let Some(node) = self.nodes.get_mut(state as usize) else { return 0 };
        if node.met_in != self.stage {
            self.met += 1;
            let place = stage.view_of_state.len();
            (node.met_in, node.place) = (self.stage, place as u32);
            stage.view_of_state.push(node.at.view);
            stage.fade_of_state.push(node.at.fade);
            // Mostly the same as in the frame before: then nothing is counted up and down.
            match stage.state_sets.get_mut(place) {
                Some(held) if Arc::ptr_eq(held, &node.resolved) => {}
                Some(held) => *held = node.resolved.clone(),
                None => stage.state_sets.push(node.resolved.clone()),
            }
        }
        node.place
    }

    /// The state of a set under a parent, of a page's path.
    #[inline]
    pub fn find_or_insert_path(&mut self, path: u32, parent: u32, set: &Arc<StateSet>) -> u32 {
        let hint = self.hints.get(path as usize).copied().unwrap_or(ROOT);
        match self.nodes.get(hint as usize) {
            Some(node) if node.parent == parent && node.key == Arc::as_ptr(set) as usize => hint,
            _ => self.find_path(path, parent, set),
        }
    }

    #[inline(never)]
    fn find_path(&mut self, path: u32, parent: u32, set: &Arc<StateSet>) -> u32 {
        let found = self.find_or_insert(parent, set);
        if self.hints.len() <= path as usize {
            self.hints.resize(path as usize + 1, ROOT);
        }
        self.hints[path as usize] = found;
        found
    }

    /// The state of a set under a parent.
    pub fn find_or_insert(&mut self, parent: u32, set: &Arc<StateSet>) -> u32 {
        let key = Arc::as_ptr(set) as usize;
        self.find(parent, key).unwrap_or_else(|place| {
            let above = &self.nodes[parent as usize];
            let (resolved, at) = (Arc::new(above.resolved.below(set)), above.at);
            self.insert(place, parent, key, resolved, at, Some(Arc::downgrade(set)))
        })
    }

    /// The state of blended drawables under a parent.
    pub fn find_or_insert_blend(&mut self, parent: u32) -> u32 {
        self.find(parent, BLEND_KEY).unwrap_or_else(|place| {
            let above = &self.nodes[parent as usize];
            let (resolved, at) = (Arc::new(above.resolved.blended()), above.at);
            self.insert(place, parent, BLEND_KEY, resolved, at, None)
        })
    }

    /// The state of what has another projection under a parent. View 0 begins a stage, which has fades of its own.
    pub fn find_or_insert_view(&mut self, parent: u32, view: u32) -> u32 {
        let key = VIEW_KEY + 2 * view as usize;
        self.find(parent, key).unwrap_or_else(|place| {
            let Node { resolved, at, .. } = &self.nodes[parent as usize];
            let (resolved, at) = (resolved.clone(), At { view, fade: if view == 0 { 0 } else { at.fade } });
            self.insert(place, parent, key, resolved, at, None)
        })
    }

    /// The state of what is drawn in a part of the pixels under a parent: one more than the index of a fade.
    pub fn find_or_insert_fade(&mut self, parent: u32, fade: u32) -> u32 {
        let key = FADE_KEY + 4 * fade as usize;
        self.find(parent, key).unwrap_or_else(|place| {
            let Node { resolved, at, .. } = &self.nodes[parent as usize];
            let (resolved, at) = (resolved.clone(), At { fade, ..*at });
            self.insert(place, parent, key, resolved, at, None)
        })
    }

    fn insert(
        &mut self,
        place: usize,
        parent: u32,
        key: usize,
        resolved: Arc<ResolvedState>,
        at: At,
        set: Option<Weak<StateSet>>,
    ) -> u32 {
        let node = self.nodes.len() as u32;
        let met_in = self.stage.wrapping_sub(1);
        self.nodes.push(Node { parent, key, resolved, at, met_in, place: 0, set });
        self.table[place] = node;
        if self.nodes.len() * 2 > self.table.len() {
            self.grow();
        }
        node
    }

    fn find(&self, parent: u32, key: usize) -> Result<u32, usize> {
        let mask = self.table.len() - 1;
        let mut place = hash(parent, key) & mask;
        loop {
            let node = self.table[place];
            if node == EMPTY {
                return Err(place);
            }
            let found = &self.nodes[node as usize];
            if found.parent == parent && found.key == key {
                return Ok(node);
            }
            place = (place + 1) & mask;
        }
    }

    fn grow(&mut self) {
        let size = self.table.len() * 2;
        self.table.clear();
        self.table.resize(size, EMPTY);
        for node in 1..self.nodes.len() {
            let Node { parent, key, .. } = self.nodes[node];
            if key == GONE {
                continue;
            }
            if let Err(place) = self.find(parent, key) {
                self.table[place] = node as u32;
            }
        }
    }
}

/// Fibonacci hashing of the pair.
fn hash(parent: u32, key: usize) -> usize {
    let mixed = (key as u64 >> 1) ^ (u64::from(parent) << 40) ^ u64::from(parent);
    (fibonacci_hash(mixed) >> 32) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{Attribute, BinDetails, Depth, Mode, StateValue};

    #[test]
    fn finds_by_identity_under_the_parent() {
        let mut graph = StateGraph::default();
        let sets: Vec<_> = (0..300).map(|_| Arc::new(StateSet::default())).collect();
        for _ in 0..3 {
            graph.start_frame();
            graph.start_stage();
            let first: Vec<u32> = sets.iter().map(|s| graph.find_or_insert(ROOT, s)).collect();
            let again: Vec<u32> = sets.iter().map(|s| graph.find_or_insert(ROOT, s)).collect();
            assert_eq!(first, again);
            assert_eq!(first, (1..=300).collect::<Vec<u32>>());
            let below = graph.find_or_insert(first[7], &sets[0]);
            assert_eq!(below, 301);
            assert_ne!(graph.find_or_insert_blend(ROOT), below);
            assert_eq!(graph.nodes.len(), 303);
            let mut stage = RenderStage::new();
            assert_eq!([below, 5, below, 0].map(|s| graph.meet(s, &mut stage)), [0, 1, 0, 2]);
            assert_eq!(stage.state_sets.len(), 3);
        }
    }

    #[test]
    fn what_is_no_longer_met_is_forgotten() {
        let mut graph = StateGraph::default();
        let mut stage = RenderStage::new();
        let kept = Arc::new(StateSet::default());
        for _ in 0..3 * FEW {
            graph.start_frame();
            graph.start_stage();
            let a = graph.find_or_insert(ROOT, &kept);
            let b = graph.find_or_insert(ROOT, &Arc::new(StateSet::default()));
            stage.state_sets.clear();
            stage.view_of_state.clear();
            assert_eq!([graph.meet(a, &mut stage), graph.meet(b, &mut stage)], [0, 1]);
        }
        assert!(graph.nodes.len() < 2 * FEW);
        assert_eq!(Arc::strong_count(&kept), 1);
    }

    #[test]
    fn what_is_gone_is_let_go_with_all_below_it() {
        let mut graph = StateGraph::default();
        let mut stage = RenderStage::new();
        let (above, below) = (Arc::new(StateSet::default()), Arc::new(StateSet::default()));
        graph.start_stage();
        let parent = graph.find_or_insert(ROOT, &above);
        let child = graph.find_or_insert(parent, &below);
        graph.meet(child, &mut stage);
        let held = Arc::downgrade(&stage.state_sets[0]);
        stage.state_sets.clear();
        drop(above);
        for _ in 0..=SWEEP_FRAMES {
            graph.start_frame();
        }
        assert!(held.upgrade().is_none());
        let another = Arc::new(StateSet::default());
        assert_eq!([graph.find_or_insert(ROOT, &another), graph.find_or_insert(ROOT, &below)], [3, 4]);
    }

    #[test]
    fn inherits_and_overrides() {
        let mut graph = StateGraph::default();
        let mut stage = RenderStage::new();
        let red = Arc::new(StateSet { color: Some([0.5, 0.0, 0.0, 1.0]), ..StateSet::default() });
        let write = Arc::new(
            StateSet { color: Some([0.5; 4]), ..StateSet::default() }.with(Attribute::Depth(Depth::default())),
        );
        let a = graph.find_or_insert(ROOT, &red);
        let blended = graph.find_or_insert_blend(a);
        let b = graph.find_or_insert(a, &write);
        let blended_below = graph.find_or_insert_blend(b);
        let other_view = graph.find_or_insert_view(b, 2);
        let fading = graph.find_or_insert_fade(other_view, 3);
        assert_ne!(graph.find_or_insert_fade(other_view, 4), fading);
        let (inside, of_stage) = (graph.find_or_insert_view(fading, 1), graph.find_or_insert_view(fading, 0));
        graph.start_stage();
        let states = [blended, blended_below, b, other_view, fading, inside, of_stage];
        assert_eq!(states.map(|s| graph.meet(s, &mut stage)), [0, 1, 2, 3, 4, 5, 6]);
        let [blended, below, b, other] = [0, 1, 2, 3].map(|i: usize| stage.state_sets[i].clone());
        assert!(!blended.writes_depth());
        assert_eq!(blended.bin(), BinDetails::TRANSPARENT);
        assert!(below.writes_depth());
        assert_eq!(b.color, [0.25, 0.0, 0.0, 0.5]);
        assert!(b.mode(Mode::DepthTest) && Arc::ptr_eq(&b, &other));
        assert_eq!((stage.view_of_state, stage.fade_of_state), (vec![0, 0, 0, 2, 2, 1, 0], vec![0, 0, 0, 0, 3, 3, 0]));
        assert!(Arc::ptr_eq(&other, &stage.state_sets[4]));
        assert_ne!(StateValue::ON, StateValue::OFF);
    }
}
