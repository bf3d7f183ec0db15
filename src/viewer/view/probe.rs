//! [`Probe`]: culls a view outside of the frame's own culls, on the main thread: for prefetching, for the blocking mode and
//! to draw a view once more.

use crate::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use crate::scene::Scene;
use crate::viewer::rendering::{CullOutcome, CullTask};

/// A visitor and the stage that it culls into.
pub(in crate::viewer) struct Probe {
    visitor: CullVisitor,
    stage: RenderStage,
}

impl Probe {
    pub(in crate::viewer) fn new() -> Self {
        Self { visitor: CullVisitor::looking(), stage: RenderStage::new() }
    }

    /// Culls a camera of a view into the stage.
    pub(in crate::viewer) fn cull(&mut self, task: CullTask) -> CullOutcome {
        task.run(&mut self.visitor, &mut self.stage)
    }

    /// Returns the pages that a camera lacks. Nothing is drawn of this cull: it needs no fades, shadows or order of leaves.
    pub(in crate::viewer) fn requests_of(&mut self, scene: &Scene, camera: &CullCamera) -> &[PageRequest] {
        self.clear_requests();
        let mut camera = *camera;
        camera.settings.lod_fade_s = 0.0;
        self.visitor.traverse(scene, &camera, &mut self.stage);
        &self.stage.requests
    }

    pub(in crate::viewer) fn clear_requests(&mut self) {
        self.stage.requests.clear();
    }

    /// Returns the stage of the last cull.
    pub(in crate::viewer) fn stage(&self) -> &RenderStage {
        &self.stage
    }

    /// Takes the stage of the last cull, to be drawn; [`Self::put_back_stage`] returns it for its memory.
    pub(in crate::viewer) fn take_stage(&mut self) -> RenderStage {
        std::mem::take(&mut self.stage)
    }

    pub(in crate::viewer) fn put_back_stage(&mut self, stage: RenderStage) {
        self.stage = stage;
    }
}
