//! The states of leaves: how the chains of state sets of a page map to the state graph and to the stage. Culling thread.
//!
//! Both mappings are filled on demand and kept for one page, so that a leaf costs one array access.

use std::sync::Arc;

use crate::cull::fading::FadeBand;
use crate::cull::sorting::{ROOT, StateGraph};
use crate::cull::stage::{DrawnPart, RenderStage};
use crate::scene::{BLEND, LocalLights, NONE, Page, VIEW};
use crate::state::{CullFace, FrontFace, StateSet};

/// The state graph and its mapping from the paths (chains of state sets) of the current page.
///
/// `NONE` in a mapping means that the path was not looked up yet.
#[derive(Debug, Default)]
pub(in crate::cull) struct PageStates {
    graph: StateGraph,
    /// By path: index among the states of the stage.
    in_stage: Vec<u32>,
    /// By path: node of the state graph.
    in_graph: Vec<u32>,
    /// Copies of `in_graph`, one for each push of state sets that was not popped.
    pushed: Vec<u32>,
    /// Index of the current view in the view stack.
    view: u32,
    /// The dither band of leaves, below a Lod that fades.
    band: FadeBand,
}

impl PageStates {
    /// Starts a frame.
    pub fn start_frame(&mut self) {
        self.graph.start_frame();
    }

    /// Forgets all states between two culls.
    pub fn prune(&mut self) {
        self.graph.prune();
    }

    /// Returns true if a state culls the back faces of single-sided drawables, in the usual winding order.
    pub fn culls_backs(&self, state: u32) -> bool {
        let state = self.graph.resolved(state);
        state.culled_face(false) == Some(CullFace::Back) && state.front_face() == FrontFace::CounterClockwise
    }

    /// Starts a stage: none of its states has leaves.
    pub fn start_stage(&mut self) {
        self.graph.start_stage();
        (self.view, self.band) = (0, FadeBand::FULL);
    }

    /// Starts a page, under a node of the state graph.
    pub fn start_page(&mut self, page: &Page, state: u32) {
        self.band = FadeBand::FULL;
        for map in [&mut self.in_stage, &mut self.in_graph] {
            map.clear();
            map.resize(page.state_paths().len(), NONE);
        }
        if let Some(root) = self.in_graph.first_mut() {
            *root = state;
        }
    }

    /// Changes the view that Projection and Camera nodes of the page refer to.
    pub fn enter_view(&mut self, view: u32) {
        self.view = view;
    }

    /// Changes the dither band of the leaves that follow and returns the one before.
    pub fn enter_band(&mut self, band: FadeBand) -> FadeBand {
        self.in_stage.fill(NONE);
        std::mem::replace(&mut self.band, band)
    }

    /// Returns the node of the scene's roots, below the state set of the camera where it has one.
    pub fn root(&mut self, set: Option<&Arc<StateSet>>) -> u32 {
        set.map_or(ROOT, |set| self.graph.find_or_insert(ROOT, set))
    }

    /// Returns the node of the stage's own view under a node that was found in another stage.
    pub fn in_stage_view(&mut self, state: u32) -> u32 {
        self.graph.find_or_insert_view(state, 0)
    }

    /// Overrides the node of a path: that of a camera whose stage this is, or of local lights.
    pub fn set_path(&mut self, path: u32, state: u32) {
        if let Some(known) = self.in_graph.get_mut(path as usize) {
            *known = state;
        }
    }

    /// Puts state sets of a cull callback between a path and those below it, until [`Self::pop`].
    #[cold]
    pub fn push(&mut self, page: &Page, path: u32, sets: &[Arc<StateSet>]) {
        let state = self.path_below(page, path, sets);
        self.pushed.extend_from_slice(&self.in_graph);
        // All paths that are looked up until then are below this one.
        self.in_graph.fill(NONE);
        self.in_stage.fill(NONE);
        self.set_path(path, state);
    }

    /// Undoes the last [`Self::push`], which was for the same page.
    #[cold]
    pub fn pop(&mut self) {
        let first = self.pushed.len() - self.in_graph.len();
        self.in_graph.copy_from_slice(&self.pushed[first..]);
        self.pushed.truncate(first);
        self.in_stage.fill(NONE);
    }

    /// Returns the index among the stage's states for leaves of a path below further state sets.
    #[cold]
    pub fn leaf_state_below(&mut self, page: &Page, path: u32, sets: &[Arc<StateSet>], stage: &mut RenderStage) -> u32 {
        let state = self.path_below(page, path, sets);
        let state = self.faded(state, self.band, stage);
        self.graph.meet(state, stage)
    }

    fn path_below(&mut self, page: &Page, path: u32, sets: &[Arc<StateSet>]) -> u32 {
        let state = self.path_state(page, path);
        sets.iter().fold(state, |state, set| self.graph.find_or_insert(state, set))
    }

    /// Returns the group of local lights that shine above a path.
    pub fn lights_above(&mut self, page: &Page, path: u32) -> u32 {
        let above = self.path_above(page, path);
        self.graph.light_group_of(above)
    }

    /// Has local lights, which are a group of the stage, shine on what is below a path.
    pub fn enter_lights(&mut self, page: &Page, path: u32, lights: &Arc<LocalLights>, group: u32) {
        let above = self.path_above(page, path);
        let state = self.graph.enter_lights(above, lights, group);
        self.set_path(path, state);
    }

    /// Returns the node of the path above a path.
    fn path_above(&mut self, page: &Page, path: u32) -> u32 {
        let parent = page.state_paths().get(path as usize).map_or(0, |link| link.parent);
        self.path_state(page, parent)
    }

    /// Returns the node of a path of another page, with the state set at its end, under a node.
    pub fn below(&mut self, path: u32, state: u32, set: &Arc<StateSet>) -> u32 {
        self.graph.find_or_insert_path(path, state, set)
    }

    /// Returns the index among the stage's states of a node that has leaves.
    #[inline]
    pub fn meet(&mut self, state: u32, stage: &mut RenderStage) -> u32 {
        self.graph.meet(state, stage)
    }

    /// Returns the index among the stage's states for leaves of a path of the page.
    #[inline(always)]
    pub fn leaf_state(&mut self, page: &Page, path: u32, stage: &mut RenderStage) -> u32 {
        match self.in_stage.get(path as usize) {
            Some(&state) if state != NONE => state,
            _ => self.meet_path(page, path, stage),
        }
    }

    /// Returns the indices for the leaves of four paths, as [`Self::leaf_state`].
    #[inline(always)]
    pub fn leaf_states(&mut self, page: &Page, paths: [u32; 4], stage: &mut RenderStage) -> [u32; 4] {
        let known = &self.in_stage[..];
        let states = paths.map(|path| known.get(path as usize).copied().unwrap_or(NONE));
        if states.contains(&NONE) { paths.map(|path| self.leaf_state(page, path, stage)) } else { states }
    }

    #[inline(never)]
    fn meet_path(&mut self, page: &Page, path: u32, stage: &mut RenderStage) -> u32 {
        let state = self.path_state(page, path);
        let state = self.faded(state, self.band, stage);
        let state = self.graph.meet(state, stage);
        if let Some(known) = self.in_stage.get_mut(path as usize) {
            *known = state;
        }
        state
    }

    /// Returns the node of a dither band under a node.
    #[inline(always)]
    pub fn faded(&mut self, state: u32, band: FadeBand, stage: &mut RenderStage) -> u32 {
        if band.is_full() { state } else { self.part(state, DrawnPart::Band(band), stage) }
    }

    /// Returns the node of a drawn part under a node.
    #[cold]
    pub fn part(&mut self, state: u32, part: DrawnPart, stage: &mut RenderStage) -> u32 {
        let parts = &mut stage.parts;
        let index = parts.iter().position(|p| *p == part).unwrap_or_else(|| {
            parts.push(part);
            parts.len() - 1
        });
        self.graph.find_or_insert_part(state, index as u32 + 1)
    }

    /// Returns the node of a path of the page, whether or not it has leaves.
    #[inline(always)]
    pub fn path_state(&mut self, page: &Page, path: u32) -> u32 {
        match self.in_graph.get(path as usize) {
            Some(&state) if state != NONE => state,
            Some(_) => self.find_path(page, path),
            None => ROOT,
        }
    }

    #[inline(always)]
    fn find_path(&mut self, page: &Page, path: u32) -> u32 {
        match self.find_below_known(page, path) {
            NONE => self.find_parents(page, path),
            state => state,
        }
    }

    /// Finds a path whose parents are unknown: up to the first path below a known one, one step down, and again. Paths
    /// are at most as deep as the graph of nodes.
    #[cold]
    fn find_parents(&mut self, page: &Page, path: u32) -> u32 {
        loop {
            let mut at = path;
            let state = loop {
                match self.find_below_known(page, at) {
                    NONE => at = page.state_paths()[at as usize].parent,
                    state => break state,
                }
            };
            if at == path {
                return state;
            }
        }
    }

    /// Finds and stores the node of a path whose parent is known; returns `NONE` where the parent is not.
    #[inline(always)]
    fn find_below_known(&mut self, page: &Page, path: u32) -> u32 {
        let Some(link) = page.state_paths().get(path as usize) else { return ROOT };
        let above = match self.in_graph.get(link.parent as usize) {
            Some(&NONE) if link.parent != path => return NONE,
            Some(&NONE) | None => ROOT,
            Some(&above) => above,
        };
        let state = match page.state_sets().get(link.set as usize) {
            Some(set) => self.graph.find_or_insert_path(path, above, set),
            None if link.set == BLEND => self.graph.find_or_insert_blend(above),
            None if link.set == VIEW => self.graph.find_or_insert_view(above, self.view),
            None => above,
        };
        self.in_graph[path as usize] = state;
        state
    }
}
