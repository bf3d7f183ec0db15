//! [`SceneSet`]: the scenes that a pager gets with each call.

use crate::scene::{NodeId, Scene, SceneNumber, SlotInfo};

/// The scenes that a [`DatabasePager`](super::super::DatabasePager) serves, all of them in each call: a [`Scene`] alone, or
/// several in a vector or an array.
pub trait SceneSet {
    /// Returns a scene by its position, in any order; `None` after the last.
    fn at(&self, index: usize) -> Option<&Scene>;
    /// Returns a scene by its position, mutably.
    fn at_mut(&mut self, index: usize) -> Option<&mut Scene>;
}

impl SceneSet for Scene {
    fn at(&self, index: usize) -> Option<&Scene> {
        (index == 0).then_some(self)
    }

    fn at_mut(&mut self, index: usize) -> Option<&mut Scene> {
        (index == 0).then_some(self)
    }
}

impl<const N: usize> SceneSet for [&mut Scene; N] {
    fn at(&self, index: usize) -> Option<&Scene> {
        self.get(index).map(|scene| &**scene)
    }

    fn at_mut(&mut self, index: usize) -> Option<&mut Scene> {
        self.get_mut(index).map(|scene| &mut **scene)
    }
}

impl SceneSet for Vec<&mut Scene> {
    fn at(&self, index: usize) -> Option<&Scene> {
        self.get(index).map(|scene| &**scene)
    }

    fn at_mut(&mut self, index: usize) -> Option<&mut Scene> {
        self.get_mut(index).map(|scene| &mut **scene)
    }
}

impl dyn SceneSet + '_ {
    /// Returns all scenes.
    pub(in crate::pager) fn all(&self) -> impl Iterator<Item = &Scene> {
        (0..).map_while(|index| self.at(index))
    }

    /// Returns the scene with a number; a linear search, as there are few.
    pub(in crate::pager) fn numbered(&self, number: SceneNumber) -> Option<&Scene> {
        self.all().find(|scene| scene.number() == number)
    }

    /// Returns the scene with a number, mutably.
    pub(in crate::pager) fn numbered_mut(&mut self, number: SceneNumber) -> Option<&mut Scene> {
        let index = self.all().position(|scene| scene.number() == number)?;
        self.at_mut(index)
    }

    /// Returns a content slot of one of the scenes.
    pub(in crate::pager) fn slot(&self, id: NodeId) -> Option<SlotInfo<'_>> {
        self.numbered(id.page.scene)?.slot(id)
    }

    /// Forgets the failures of a slot; see [`Scene::forget_failure`].
    pub(in crate::pager) fn forget_failure(&mut self, slot: NodeId) {
        if let Some(scene) = self.numbered_mut(slot.page.scene) {
            scene.forget_failure(slot);
        }
    }

    /// Sets or clears the failure mark of a slot; see [`Scene::set_failed`].
    pub(in crate::pager) fn set_failed(&mut self, slot: NodeId, failed: bool) {
        if let Some(scene) = self.numbered_mut(slot.page.scene) {
            scene.set_failed(slot, failed);
        }
    }
}
