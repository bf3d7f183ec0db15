//! A visitor that takes some turns for its cull, and the stage that it fills.

use std::sync::Arc;

use glam::DMat4;
use shuttle::thread;
pub use terrane::cull::{CullCamera, CullCounters, PageRequest, Stereo, StereoMode};
use terrane::scene::{CameraTarget, ClampProjection, Environment};
use terrane::state::{OpaqueDrawData, StateSet};

use super::{Panics, Scene};
use crate::schedules::thread::panic_on_purpose;

/// The target of a stage.
#[derive(Default)]
pub struct StageTarget {
    pub callbacks: Option<OpaqueDrawData>,
}

#[derive(Default)]
pub struct RenderStage {
    /// The camera. `frame` is the culled frame and `context` the number of the camera.
    pub camera: CullCamera,
    pub counters: CullCounters,
    pub near_m: f64,
    pub target: StageTarget,
    pub requests: Vec<PageRequest>,
    pub pre_render: Vec<RenderStage>,
    pub post_render: Vec<RenderStage>,
}

impl RenderStage {
    pub fn new() -> Self {
        Self::default()
    }

    pub fn set_projection(&mut self, clip_from_eye: DMat4) {
        self.camera.clip_from_eye = clip_from_eye;
    }
}

#[derive(Default)]
pub struct CullVisitor {
    pub state_set: Option<Arc<StateSet>>,
    pub callbacks: Option<OpaqueDrawData>,
    pub clamp_projection: Option<ClampProjection>,
    pub environment: Option<Environment>,
    pub viewport_px: Option<[u32; 4]>,
}

impl CullVisitor {
    pub fn new() -> Self {
        Self::default()
    }

    pub fn cull(&mut self, scene: &Scene, camera: &CullCamera, stage: &mut RenderStage) {
        scene.seen.culls(camera.context, camera.frame);
        assert!(stage.camera.frame < camera.frame || camera.frame == 1, "a stage of an earlier frame");
        thread::yield_now();
        assert_eq!(scene.frame, camera.frame, "update has ended, and the next has not begun");
        if scene.seen.panics == (Panics::InCull { camera: camera.context, frame: camera.frame }) {
            panic_on_purpose();
        }
        stage.camera = *camera;
        stage.target.callbacks = self.callbacks.take();
        // The main thread checks it.
        stage.counters.leaves = camera.frame;
    }

    pub fn cull_stereo(
        &mut self,
        scene: &Scene,
        camera: &CullCamera,
        _stereo: &Stereo,
        _targets: &[Arc<CameraTarget>; 2],
        stage: &mut RenderStage,
    ) {
        self.cull(scene, camera, stage);
    }
}
