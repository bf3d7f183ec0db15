//! [`CullSide`]: culls one camera, on the thread that the threading model assigns.
//!
//! It owns the camera's visitor. The scene arrives with each task as an `Arc` and is dropped before the outcome is sent, so
//! that the main thread then has the only reference again. Each camera has two render stages (OSG's two scene views): one is
//! culled into while the other is drawn.

use std::sync::Arc;
use std::time::Instant;

use glam::DMat4;

use super::frame_job::millis;
use crate::cull::{CullCamera, CullCounters, CullVisitor, PageRequest, RenderStage, Stereo, StereoMode};
use crate::draw::{BinCallback, CameraCallbacks};
use crate::scene::{CameraTarget, ClampProjection, ComputeNearFar, Environment, Scene};
use crate::state::{DataVariance, OpaqueDrawData, StateSet};
use crate::sync::primitives::channel::{Receiver, Sender, TryRecvError};
use crate::sync::{BlockCount, OperationQueue};
use crate::trace;
use crate::viewer::Camera;

/// The number of a camera's stages: one for cull, one for draw.
pub(super) const SCENE_VIEWS: usize = 2;

/// One cull of one camera.
#[derive(Clone)]
pub(in crate::viewer) struct CullTask {
    pub(in crate::viewer) scene: Arc<Scene>,
    pub(in crate::viewer) camera: CullCamera,
    /// Computes the projection once the nearest object is known.
    pub(in crate::viewer) lens: Lens,
    pub(in crate::viewer) sight: Sight,
    /// Sun, sky and fog.
    pub(in crate::viewer) environment: Environment,
    /// The state set above all roots.
    pub(in crate::viewer) state_set: Option<Arc<StateSet>>,
    /// Callbacks while the camera is drawn.
    pub(in crate::viewer) callbacks: Option<OpaqueDrawData>,
    /// Adjusts near and far where the settings compute them.
    pub(in crate::viewer) clamp_projection: Option<ClampProjection>,
    /// The part of the context's target as x, y, width and height in pixels; `None` is all of it.
    pub(in crate::viewer) viewport_px: Option<[u32; 4]>,
    /// Draw reads data of this frame that update overwrites.
    pub(in crate::viewer) is_dynamic: bool,
    /// An empty vector for the requests, to use its memory again.
    pub(in crate::viewer) requests: Vec<PageRequest>,
}

/// The eyes with which a camera is culled.
#[derive(Clone)]
pub(in crate::viewer) enum Sight {
    /// A single eye in the middle.
    Middle,
    /// One eye of a pair; index 0 is the left one.
    One(Stereo, usize),
    /// Both eyes, drawn into separate targets and then composed.
    Both(Stereo, [Arc<CameraTarget>; 2]),
}

/// The projection of a camera.
#[derive(Clone, Copy)]
pub(in crate::viewer) struct Lens {
    pub(in crate::viewer) camera: Camera,
    pub(in crate::viewer) size_px: [u32; 2],
    /// A transform of clip space.
    pub(in crate::viewer) offset: DMat4,
}

impl Lens {
    pub(in crate::viewer) fn clip_from_eye(&self, near_m: f64) -> DMat4 {
        self.offset * self.camera.clip_from_eye(self.size_px, near_m)
    }
}

/// The result of a cull, for the main thread.
#[derive(Default)]
pub(in crate::viewer) struct CullOutcome {
    pub(in crate::viewer) requests: Vec<PageRequest>,
    pub(in crate::viewer) counters: CullCounters,
    pub(in crate::viewer) cull_ms: f64,
    /// Distance of the near plane in metres.
    pub(in crate::viewer) near_m: f64,
}

/// A culled stage for draw.
pub(super) struct Culled {
    /// The camera that the stage is returned to; `None` for a stage that arrived with its frame.
    pub(super) camera: Option<u32>,
    pub(super) stage: RenderStage,
    pub(super) environment: Environment,
    /// Draw signals the end of dynamic draws for it; otherwise cull has done so.
    pub(super) completes: bool,
}

impl CullTask {
    /// Culls into a stage and drops the scene.
    pub(in crate::viewer) fn run(self, visitor: &mut CullVisitor, stage: &mut RenderStage) -> CullOutcome {
        let start = Instant::now();
        let Self { scene, camera, lens, sight, environment, viewport_px, mut requests, .. } = self;
        visitor.state_set = self.state_set;
        visitor.callbacks = self.callbacks;
        visitor.clamp_projection = self.clamp_projection;
        visitor.environment = Some(environment);
        visitor.viewport_px = viewport_px;
        let fits_itself = camera.settings.compute_near_far != ComputeNearFar::Off;
        match &sight {
            Sight::Middle => {
                visitor.cull(&scene, &camera, stage);
                if !fits_itself {
                    // The near plane of this frame, from what cull has just found.
                    stage.set_projection(lens.clip_from_eye(lens.camera.near_for(stage.near_m)));
                }
            }
            Sight::One(stereo, index) => {
                // An eye alone has a separate image, whatever the mode does with both.
                let stereo = Stereo { mode: StereoMode::LeftEye, ..*stereo };
                visitor.cull(&scene, &stereo.eyes(&camera)[*index], stage);
                if !fits_itself {
                    let near_m = lens.camera.near_for(stage.near_m);
                    let camera = CullCamera { clip_from_eye: lens.clip_from_eye(near_m), ..camera };
                    stage.set_projection(stereo.eyes(&camera)[*index].clip_from_eye);
                }
            }
            Sight::Both(stereo, targets) => {
                visitor.cull_stereo(&scene, &camera, stereo, targets, stage);
                if !fits_itself {
                    let near_m = lens.camera.near_for(stage.near_m);
                    let camera = CullCamera { clip_from_eye: lens.clip_from_eye(near_m), ..camera };
                    for (eye, of_eye) in stereo.eyes(&camera).iter().zip(&mut stage.pre_render) {
                        of_eye.set_projection(eye.clip_from_eye);
                    }
                }
            }
        }
        drop(scene);
        requests.clear();
        // The stage goes to the draw thread; the requests stay here for the next update.
        std::mem::swap(&mut requests, &mut stage.requests);
        let near_m = stage.camera.clip_from_eye.w_axis.z;
        CullOutcome { requests, counters: stage.counters, cull_ms: millis(start.elapsed()), near_m }
    }
}

/// Culls one camera. Owned by the main thread, by the camera's thread or by its device's thread.
pub(super) struct CullSide {
    /// Number of the camera.
    pub(super) camera: u32,
    pub(super) visitor: CullVisitor,
    /// From the main thread; holds one task at most. The field is dropped before `outcomes`: once the main thread finds that
    /// closed, dropping its own end of this channel releases the scene.
    pub(super) tasks: Receiver<CullTask>,
    /// To the main thread, which takes each outcome before it sends another task.
    pub(super) outcomes: Sender<CullOutcome>,
    /// Stages that draw has returned.
    pub(super) available: Receiver<RenderStage>,
    /// To the thread that draws.
    pub(super) culled: Sender<Culled>,
    /// The main thread waits here at the end of the frame, in models that overlap frames.
    pub(super) end_of_dynamic: Option<Arc<BlockCount>>,
    /// The application's operations, run after each cull. Other threads add to them.
    pub(super) operations: Arc<OperationQueue<CullVisitor>>,
}

impl CullSide {
    /// Culls the waiting task; does nothing without one.
    pub(super) fn cull(&mut self) {
        let task = match self.tasks.try_recv() {
            Ok(task) => task,
            Err(TryRecvError::Empty | TryRecvError::Disconnected) => return,
        };
        // The main thread starts no frame before a stage is free. The channel is closed when the draw thread has died.
        let span = trace::span("wait for stage");
        let available = self.available.recv();
        drop(span);
        let Ok(mut stage) = available else {
            let requests = task.requests;
            drop(task.scene);
            let _ = self.outcomes.send(CullOutcome { requests, ..CullOutcome::default() });
            return self.completed();
        };
        let (is_dynamic, environment) = (task.is_dynamic, task.environment);
        let outcome = task.run(&mut self.visitor, &mut stage);
        // Before the outcome is sent, so that they have run when the frame is complete on the main thread.
        self.operations.run_operations(&mut self.visitor);
        let waits = self.end_of_dynamic.is_some() && (is_dynamic || has_dynamic_callbacks(&stage));
        // Fails only when the receiving thread has died, which is reported there.
        let _ = self.outcomes.send(outcome);
        let is_lost =
            self.culled.send(Culled { camera: Some(self.camera), stage, environment, completes: waits }).is_err();
        if !waits || is_lost {
            self.completed();
        }
    }

    fn completed(&self) {
        if let Some(block) = &self.end_of_dynamic {
            block.completed();
        }
    }
}

/// Returns true when callbacks of the stage, or of its pre- and post-render stages, read data that update overwrites.
fn has_dynamic_callbacks(stage: &RenderStage) -> bool {
    CameraCallbacks::variance_of(&stage.target.callbacks) == DataVariance::Dynamic
        || BinCallback::are_dynamic(stage)
        || stage.pre_render.iter().chain(&stage.post_render).any(has_dynamic_callbacks)
}
