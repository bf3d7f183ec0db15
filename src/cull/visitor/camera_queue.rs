//! Cameras of the scene graph that were met while a stage was culled and are culled after it. Culling thread.

use super::page_queue::PageVisit;
use crate::cull::stage::StageTarget;
use crate::cull::views::View;
use crate::scene::CameraShadows;

/// A camera node, with its position in the graph as its own cull needs it.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct CameraVisit {
    /// The camera's page, seen from the camera.
    pub page: PageVisit,
    /// The camera's node in the page.
    pub node: u32,
    /// State graph node above the camera's children.
    pub state: u32,
    /// Path of the page that `state` belongs to.
    pub path: u32,
    /// The scene's roots are shown besides the camera's children.
    pub shows_scene: bool,
}

/// A camera that has its own stage.
#[derive(Debug)]
pub(in crate::cull) struct DeferredCamera {
    pub visit: CameraVisit,
    pub view: View,
    /// The stage is drawn before the one that the camera was met in.
    pub is_pre: bool,
    pub target: StageTarget,
}

/// A nested camera with shadows. It is part of the stage that it was met in; its shadows are culled after the stage.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct NestedCamera {
    pub visit: CameraVisit,
    /// Index of its view in the stage's list of views.
    pub stage_view: usize,
    pub shadows: CameraShadows,
}

/// Cameras that wait for their culls.
///
/// Deferred cameras of several stages lie behind one another, since cameras hang below cameras. Nested ones belong to
/// the stage that was culled last.
#[derive(Debug, Default)]
pub(in crate::cull) struct CameraQueue {
    deferred: Vec<DeferredCamera>,
    nested: Vec<NestedCamera>,
}

impl CameraQueue {
    /// Starts a frame.
    pub fn start_frame(&mut self) {
        self.deferred.clear();
    }

    /// Starts a stage.
    pub fn start_stage(&mut self) {
        self.nested.clear();
    }

    /// Adds a camera that has its own stage.
    pub fn defer(&mut self, camera: DeferredCamera) {
        self.deferred.push(camera);
    }

    /// Adds a nested camera with shadows.
    pub fn add_nested(&mut self, camera: NestedCamera) {
        self.nested.push(camera);
    }

    /// Returns the number of deferred cameras.
    pub fn deferred_count(&self) -> usize {
        self.deferred.len()
    }

    /// Takes the deferred camera at an index, keeping the order of the others.
    pub fn take_deferred(&mut self, index: usize) -> Option<DeferredCamera> {
        (index < self.deferred.len()).then(|| self.deferred.remove(index))
    }

    /// Drops the deferred cameras from an index on.
    pub fn truncate_deferred(&mut self, count: usize) {
        self.deferred.truncate(count);
    }

    /// Takes the nested cameras of the last stage; [`Self::give_back_nested`] returns the memory.
    pub fn take_nested(&mut self) -> Vec<NestedCamera> {
        std::mem::take(&mut self.nested)
    }

    /// Gives back the memory of [`Self::take_nested`].
    pub fn give_back_nested(&mut self, mut nested: Vec<NestedCamera>) {
        nested.clear();
        self.nested = nested;
    }
}
