//! The state graph: each state set once under each parent, found or inserted by identity. Culling thread.
//!
//! It is kept from frame to frame with the resolved state of each node, so that a steady frame resolves nothing. It keeps
//! no state set alive: dropped ones are removed within [`SWEEP_FRAMES`] frames. When most nodes are no longer met, the
//! whole graph is cleared. Pages know their chains of state sets (`Page::state_paths`), so that the hash table is used once
//! per chain and page and not once per leaf.

use std::any::Any;
use std::sync::{Arc, Weak};

use crate::cull::stage::RenderStage;
use crate::math::random::fibonacci_hash;
use crate::scene::LocalLights;
use crate::state::{ResolvedState, StateSet};

/// Key of the pseudo state set of blended drawables; no state set has this address.
const BLEND_KEY: usize = 1;
/// First key of the pseudo state sets of views, which are odd numbers from here on.
const VIEW_KEY: usize = 3;
/// First key of the pseudo state sets of drawn parts, which are even and not multiples of 4 from here on.
const PART_KEY: usize = 2;
// Addresses of state sets and of local lights are multiples of 4.
const _: () = assert!(align_of::<StateSet>() >= 4 && align_of::<LocalLights>() >= 4);

/// Properties of leaves that come from the traversal and not from state sets.
#[derive(Clone, Copy, Debug, Default)]
struct LeafContext {
    /// The view, as in [`RenderStage::view_of_state`].
    view: u32,
    /// The drawn part, as in [`RenderStage::part_of_state`].
    part: u32,
    /// The node of the innermost local lights above; the root without any.
    lights: u32,
}

/// A state set under a parent.
#[derive(Debug)]
struct Node {
    parent: u32,
    /// Address of the state set or of the local lights, or the key of a pseudo state set.
    key: usize,
    resolved: Arc<ResolvedState>,
    context: LeafContext,
    /// Number of the stage in which the node was met last.
    met_in: u32,
    /// Index among the states of that stage.
    index_in_stage: u32,
    /// The group of local lights in the stage that they were met in last, as in [`RenderStage::lights_of_state`]; 0 for
    /// other nodes. It depends on what was met before in the stage, so that it is not part of the key.
    light_group: u32,
    /// Keeps the address of the state set or the lights from being reused, but not the object alive.
    object: Option<Weak<dyn Any + Send + Sync>>,
}

/// All nodes, and a hash table over them by open addressing.
#[derive(Debug)]
pub(in crate::cull) struct StateGraph {
    nodes: Vec<Node>,
    table: Vec<u32>,
    /// By path of a page: the node that was found last, which is usually found again.
    hints: Vec<u32>,
    /// Number of the current stage.
    stage: u32,
    /// Nodes met in the current frame.
    met: usize,
    /// Frames until the next sweep for dropped state sets.
    until_sweep: u32,
}

/// The node without any state set.
pub(in crate::cull) const ROOT: u32 = 0;
/// Marks a free entry of the hash table.
const EMPTY: u32 = u32::MAX;
/// The graph is never cleared below this number of nodes.
const MIN_NODES_TO_CLEAR: usize = 4096;
/// Frames between two sweeps for dropped state sets.
const SWEEP_FRAMES: u32 = 16;
/// Key of nodes whose state set, or one above, was dropped; it matches no state set.
const GONE: usize = usize::MAX;

impl Default for StateGraph {
    fn default() -> Self {
        let root = Node {
            parent: EMPTY,
            key: 0,
            resolved: Arc::default(),
            context: LeafContext::default(),
            met_in: 0,
            index_in_stage: 0,
            light_group: 0,
            object: None,
        };
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
    /// Starts a frame. Clears the graph if it holds over eight times as many nodes as the frame before met.
    pub fn start_frame(&mut self) {
        if self.nodes.len() > MIN_NODES_TO_CLEAR + 8 * self.met {
            self.prune();
        }
        self.met = 0;
        self.until_sweep -= 1;
        if self.until_sweep == 0 {
            self.until_sweep = SWEEP_FRAMES;
            self.sweep();
        }
    }

    /// Forgets all states, so that the next cull resolves again what it meets.
    pub fn prune(&mut self) {
        let stage = self.stage;
        *self = Self { stage, ..Self::default() };
    }

    /// Returns the resolved state of a node.
    pub fn resolved(&self, state: u32) -> &ResolvedState {
        &self.nodes.get(state as usize).unwrap_or(&self.nodes[ROOT as usize]).resolved
    }

    /// Releases the resolved states of dropped state sets and of all nodes below them. Parents precede their children.
    fn sweep(&mut self) {
        for node in 1..self.nodes.len() {
            let parent = self.nodes[node].parent as usize;
            let is_gone = |n: &Node| n.object.as_ref().is_some_and(|o| o.strong_count() == 0);
            if self.nodes[node].key != GONE && (self.nodes[parent].key == GONE || is_gone(&self.nodes[node])) {
                let root = self.nodes[0].resolved.clone();
                let node = &mut self.nodes[node];
                (node.key, node.object, node.resolved) = (GONE, None, root);
            }
        }
    }

    /// Starts a stage: no state has leaves.
    pub fn start_stage(&mut self) {
        self.stage = self.stage.wrapping_add(1);
    }

    /// Returns the index of a node among the states of the stage, to which it is added when it is met first.
    #[inline]
    pub fn meet(&mut self, state: u32, stage: &mut RenderStage) -> u32 {
        let Some(node) = self.nodes.get_mut(state as usize) else { return 0 };
        if node.met_in != self.stage {
            self.met += 1;
            let index = stage.view_of_state.len();
            (node.met_in, node.index_in_stage) = (self.stage, index as u32);
            stage.view_of_state.push(node.context.view);
            stage.part_of_state.push(node.context.part);
            // Usually the same as in the frame before, so that no reference count changes.
            match stage.state_sets.get_mut(index) {
                Some(held) if Arc::ptr_eq(held, &node.resolved) => {}
                Some(held) => *held = node.resolved.clone(),
                None => stage.state_sets.push(node.resolved.clone()),
            }
            let group = self.light_group_of(state);
            stage.lights_of_state.push(group);
            return index as u32;
        }
        node.index_in_stage
    }

    /// Returns the node of a state set under a parent, at the end of a path of a page.
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

    /// Returns the node of a state set under a parent.
    pub fn find_or_insert(&mut self, parent: u32, set: &Arc<StateSet>) -> u32 {
        let key = Arc::as_ptr(set) as usize;
        self.find(parent, key).unwrap_or_else(|entry| {
            let above = &self.nodes[parent as usize];
            let (resolved, context) = (Arc::new(above.resolved.below(set)), above.context);
            let object: Weak<StateSet> = Arc::downgrade(set);
            self.insert(entry, parent, key, resolved, context, Some(object))
        })
    }

    /// Returns the node of blended drawables under a parent.
    pub fn find_or_insert_blend(&mut self, parent: u32) -> u32 {
        self.find(parent, BLEND_KEY).unwrap_or_else(|entry| {
            let above = &self.nodes[parent as usize];
            let (resolved, context) = (Arc::new(above.resolved.blended()), above.context);
            self.insert(entry, parent, BLEND_KEY, resolved, context, None)
        })
    }

    /// Returns the node of another view under a parent. View 0 starts a stage, which has no drawn parts and local lights yet.
    pub fn find_or_insert_view(&mut self, parent: u32, view: u32) -> u32 {
        let key = VIEW_KEY + 2 * view as usize;
        self.find(parent, key).unwrap_or_else(|entry| {
            let Node { resolved, context, .. } = &self.nodes[parent as usize];
            let context = if view == 0 { LeafContext::default() } else { LeafContext { view, ..*context } };
            let resolved = resolved.clone();
            self.insert(entry, parent, key, resolved, context, None)
        })
    }

    /// Returns the node of a drawn part under a parent; `part` is one more than its index in the stage.
    pub fn find_or_insert_part(&mut self, parent: u32, part: u32) -> u32 {
        let key = PART_KEY + 4 * part as usize;
        self.find(parent, key).unwrap_or_else(|entry| {
            let Node { resolved, context, .. } = &self.nodes[parent as usize];
            let (resolved, context) = (resolved.clone(), LeafContext { part, ..*context });
            self.insert(entry, parent, key, resolved, context, None)
        })
    }

    /// Returns the node of local lights under a parent, which are a group of the stage from now on.
    pub fn enter_lights(&mut self, parent: u32, lights: &Arc<LocalLights>, group: u32) -> u32 {
        let key = Arc::as_ptr(lights) as usize;
        let node = self.find(parent, key).unwrap_or_else(|entry| {
            let above = &self.nodes[parent as usize];
            let context = LeafContext { lights: self.nodes.len() as u32, ..above.context };
            let resolved = Arc::new(above.resolved.below_local_lights());
            let object: Weak<LocalLights> = Arc::downgrade(lights);
            self.insert(entry, parent, key, resolved, context, Some(object))
        });
        self.nodes[node as usize].light_group = group;
        node
    }

    /// Returns the group of local lights that shine on the leaves of a node; 0 if there are none.
    pub fn light_group_of(&self, state: u32) -> u32 {
        let lights = self.nodes.get(state as usize).map_or(ROOT, |node| node.context.lights);
        self.nodes[lights as usize].light_group
    }

    fn insert(
        &mut self,
        entry: usize,
        parent: u32,
        key: usize,
        resolved: Arc<ResolvedState>,
        context: LeafContext,
        object: Option<Weak<dyn Any + Send + Sync>>,
    ) -> u32 {
        let node = self.nodes.len() as u32;
        let met_in = self.stage.wrapping_sub(1);
        let (index_in_stage, light_group) = (0, 0);
        self.nodes.push(Node { parent, key, resolved, context, met_in, index_in_stage, light_group, object });
        self.table[entry] = node;
        if self.nodes.len() * 2 > self.table.len() {
            self.grow();
        }
        node
    }

    /// Finds a node; the error is the free entry of the table where it belongs.
    fn find(&self, parent: u32, key: usize) -> Result<u32, usize> {
        let mask = self.table.len() - 1;
        let mut entry = hash(parent, key) & mask;
        loop {
            let node = self.table[entry];
            if node == EMPTY {
                return Err(entry);
            }
            let found = &self.nodes[node as usize];
            if found.parent == parent && found.key == key {
                return Ok(node);
            }
            entry = (entry + 1) & mask;
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
            if let Err(entry) = self.find(parent, key) {
                self.table[entry] = node as u32;
            }
        }
    }
}

/// Hashes the pair of a parent and a key.
fn hash(parent: u32, key: usize) -> usize {
    let mixed = (key as u64 >> 1) ^ (u64::from(parent) << 40) ^ u64::from(parent);
    (fibonacci_hash(mixed) >> 32) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{Attribute, BinDetails, Depth, Mode, StateValue};

    #[test]
    fn state_sets_are_found_by_identity_under_their_parent() {
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
    fn graph_is_cleared_when_most_nodes_are_no_longer_met() {
        let mut graph = StateGraph::default();
        let mut stage = RenderStage::new();
        let kept = Arc::new(StateSet::default());
        for _ in 0..3 * MIN_NODES_TO_CLEAR {
            graph.start_frame();
            graph.start_stage();
            let a = graph.find_or_insert(ROOT, &kept);
            let b = graph.find_or_insert(ROOT, &Arc::new(StateSet::default()));
            stage.state_sets.clear();
            stage.view_of_state.clear();
            assert_eq!([graph.meet(a, &mut stage), graph.meet(b, &mut stage)], [0, 1]);
        }
        assert!(graph.nodes.len() < 2 * MIN_NODES_TO_CLEAR);
        assert_eq!(Arc::strong_count(&kept), 1);
    }

    #[test]
    fn dropped_state_sets_are_released_with_all_nodes_below() {
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
    fn local_lights_have_one_node_and_the_group_of_the_stage() {
        let mut graph = StateGraph::default();
        let mut stage = RenderStage::new();
        let lights = [(); 2].map(|()| Arc::new(LocalLights::default()));
        let set = Arc::new(StateSet::default());
        let mut met = |groups: [u32; 2]| {
            graph.start_stage();
            stage.lights_of_state.clear();
            let [a, b] = [0, 1].map(|i| graph.enter_lights(ROOT, &lights[i], groups[i]));
            let below = graph.find_or_insert(a, &set);
            let (view, other_stage) = (graph.find_or_insert_view(below, 1), graph.find_or_insert_view(below, 0));
            let states = [below, b, view, other_stage, graph.find_or_insert(ROOT, &set)];
            assert_eq!(graph.light_group_of(view), groups[0]);
            states.iter().for_each(|state| _ = graph.meet(*state, &mut stage));
            assert_eq!(graph.nodes.len(), 7);
            stage.lights_of_state.clone()
        };
        assert_eq!([met([1, 2]), met([2, 1])], [[1, 2, 1, 0, 0], [2, 1, 2, 0, 0]]);
        let held = Arc::downgrade(&graph.nodes[1].resolved);
        drop(lights);
        (0..=SWEEP_FRAMES).for_each(|_| graph.start_frame());
        assert!(held.upgrade().is_none(), "released with their page");
    }

    #[test]
    fn nodes_inherit_from_their_parents() {
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
        let fading = graph.find_or_insert_part(other_view, 3);
        assert_ne!(graph.find_or_insert_part(other_view, 4), fading);
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
        assert_eq!((stage.view_of_state, stage.part_of_state), (vec![0, 0, 0, 2, 2, 1, 0], vec![0, 0, 0, 0, 3, 3, 0]));
        assert!(Arc::ptr_eq(&other, &stage.state_sets[4]));
        assert_ne!(StateValue::ON, StateValue::OFF);
    }
}
