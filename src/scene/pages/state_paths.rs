//! State paths: chains of state sets from the root of a page to a drawable or tile, each stored once.

use std::sync::Arc;

use crate::scene::id::NONE;
use crate::state::StateSet;

/// The pseudo state set of drawables whose material blends.
pub(crate) const BLEND: u32 = u32::MAX;
/// The pseudo state set of a path below a camera or projection node: its leaves have the view of that node.
pub(crate) const VIEW: u32 = u32::MAX - 1;
/// The pseudo state set of a path below a node with local lights: they shine on its leaves.
pub(crate) const LIGHTS: u32 = u32::MAX - 2;

/// The last link of a chain of state sets. Path 0 is the root of the page, without any state set.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StatePath {
    pub parent: u32,
    /// An index into [`StatePaths::state_sets`], [`BLEND`], [`VIEW`] or [`LIGHTS`].
    pub set: u32,
}

/// The state sets of a page and the paths over them.
#[derive(Debug)]
pub(crate) struct StatePaths {
    paths: Vec<StatePath>,
    state_sets: Vec<Arc<StateSet>>,
}

impl StatePaths {
    pub(super) fn new() -> Self {
        Self { paths: vec![StatePath { parent: NONE, set: NONE }], state_sets: Vec::new() }
    }

    #[inline(always)]
    pub fn paths(&self) -> &[StatePath] {
        &self.paths
    }

    #[inline(always)]
    pub fn state_sets(&self) -> &[Arc<StateSet>] {
        &self.state_sets
    }

    /// Returns the state sets, to be replaced by others.
    pub fn state_sets_mut(&mut self) -> &mut [Arc<StateSet>] {
        &mut self.state_sets
    }

    /// Appends a path and returns its index.
    pub(super) fn push_path(&mut self, parent: u32, set: u32) -> u32 {
        self.paths.push(StatePath { parent, set });
        self.paths.len() as u32 - 1
    }

    /// Appends a state set and returns its index.
    pub(super) fn push_set(&mut self, set: Arc<StateSet>) -> u32 {
        self.state_sets.push(set);
        self.state_sets.len() as u32 - 1
    }

    /// Returns the bytes of CPU memory, each state set counted with its shallow size.
    pub fn size_bytes(&self) -> usize {
        self.paths.len() * size_of::<StatePath>() + self.state_sets.len() * size_of::<StateSet>()
    }
}
