//! The views of one stage, and the nearest and farthest depth met in each. Culling thread.

use super::view::{DepthRange, View};

/// All views of a stage, index 0 being the stage's own, and the one that nodes are tested against now.
///
/// The current view is a copy, so that the hot loops read it without an index. Its depths are kept beside it and written
/// back when another view is entered.
#[derive(Debug)]
pub(in crate::cull) struct ViewStack<'a> {
    all: &'a mut Vec<View>,
    current: View,
    depths: DepthRange,
}

impl<'a> ViewStack<'a> {
    /// Starts a stage with its own view; `memory` is overwritten.
    pub fn new(memory: &'a mut Vec<View>, view: View) -> Self {
        memory.clear();
        memory.push(view);
        Self { all: memory, current: view, depths: DepthRange::EMPTY }
    }

    /// Returns the view that nodes are tested against.
    #[inline(always)]
    pub fn current(&self) -> &View {
        &self.current
    }

    /// Returns the depths that were met so far in the current view.
    #[inline(always)]
    pub fn depths(&self) -> DepthRange {
        self.depths
    }

    /// Replaces the depths of the current view.
    #[inline(always)]
    pub fn set_depths(&mut self, depths: DepthRange) {
        self.depths = depths;
    }

    /// Widens the depths of the current view; NaN changes nothing.
    #[inline(always)]
    pub fn widen(&mut self, near: f32, far: f32) {
        if near < self.depths.near {
            self.depths.near = near;
        }
        if far > self.depths.far {
            self.depths.far = far;
        }
    }

    /// Adds a view without entering it.
    pub fn push(&mut self, view: View) {
        self.all.push(view);
    }

    /// Makes another view the current one.
    pub fn enter(&mut self, index: u32) {
        self.write_back();
        self.current = self.all[index as usize];
        self.depths = self.current.depths;
    }

    /// Returns all views with the depths met in them, by index.
    pub fn all_mut(&mut self) -> &mut [View] {
        self.write_back();
        self.all
    }

    fn write_back(&mut self) {
        self.all[self.current.index as usize].depths = self.depths;
    }
}
