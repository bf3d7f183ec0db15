//! [`CullSide`]: what culls one camera, on whatever thread the model gives it to.
//!
//! It owns the camera's visitor. The scene comes with each task as an `Arc` and is dropped before anybody is told that
//! the cull is over, so that the main thread, once told, is again the only one to have it. Each camera has two render
//! stages (the reference's two scene views): one is culled into while the other is drawn.

use std::sync::Arc;
use std::time::Instant;

use glam::DMat4;

use super::millis;
use crate::cull::{CullCamera, CullCounters, CullVisitor, PageRequest, RenderStage, Stereo, StereoMode};
use crate::draw::{BinCallback, CameraCallbacks, Environment};
use crate::scene::{CameraTarget, ClampProjection, ComputeNearFar, DataVariance, OpaqueDrawData, Scene};
use crate::state::StateSet;
use crate::sync::BlockCount;
use crate::sync::primitives::channel::{Receiver, Sender, TryRecvError};
use crate::timeline;
use crate::viewer::Camera;

/// Stages of a camera: one for cull, one for draw.
pub(super) const SCENE_VIEWS: usize = 2;

/// One cull of one camera.
#[derive(Clone)]
pub(in crate::viewer) struct CullTask {
    pub(in crate::viewer) scene: Arc<Scene>,
    pub(in crate::viewer) camera: CullCamera,
    /// Gives the projection again once the nearest thing is known.
    pub(in crate::viewer) lens: Lens,
    pub(in crate::viewer) sight: Sight,
    /// Sun, sky and fog of its picture.
    pub(in crate::viewer) environment: Environment,
    /// State above all roots.
    pub(in crate::viewer) state_set: Option<Arc<StateSet>>,
    /// What is called while its picture is drawn.
    pub(in crate::viewer) callbacks: Option<OpaqueDrawData>,
    /// Changes near and far where its settings have them computed.
    pub(in crate::viewer) clamp_projection: Option<ClampProjection>,
    /// Part of the context's target: x, y, width and height; `None`: all of it.
    pub(in crate::viewer) viewport_px: Option<[u32; 4]>,
    /// What draw does for the frame besides reads what update changes.
    pub(in crate::viewer) is_dynamic: bool,
    /// Memory for the requests.
    pub(in crate::viewer) requests: Vec<PageRequest>,
}

/// With which eyes a camera sees.
#[derive(Clone)]
pub(in crate::viewer) enum Sight {
    /// One, its own.
    Middle,
    /// One of two: 0 is the left one.
    One(Stereo, usize),
    /// Two, whose pictures are drawn into targets and put together.
    Both(Stereo, [Arc<CameraTarget>; 2]),
}

/// What a camera sees through.
#[derive(Clone, Copy)]
pub(in crate::viewer) struct Lens {
    pub(in crate::viewer) camera: Camera,
    pub(in crate::viewer) size_px: [u32; 2],
    /// Applied to clip space.
    pub(in crate::viewer) offset: DMat4,
}

impl Lens {
    pub(in crate::viewer) fn clip_from_eye(&self, near_m: f64) -> DMat4 {
        self.offset * self.camera.clip_from_eye(self.size_px, near_m)
    }
}

/// What the main thread needs to know of a cull.
#[derive(Default)]
pub(in crate::viewer) struct CullOutcome {
    pub(in crate::viewer) requests: Vec<PageRequest>,
    pub(in crate::viewer) counters: CullCounters,
    pub(in crate::viewer) cull_ms: f64,
    /// Where the near plane is, metres.
    pub(in crate::viewer) near_m: f64,
}

/// A stage on its way to draw.
pub(super) struct Culled {
    /// Number of the camera that it goes back to; `None`: it came with its frame.
    pub(super) camera: Option<u32>,
    pub(super) stage: RenderStage,
    pub(super) environment: Environment,
    /// Draw completes the end of dynamic draws for it; cull has otherwise.
    pub(super) completes: bool,
}

impl CullTask {
    /// Culls into a stage; the scene is dropped.
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
                    // The near plane of this very frame, from what cull has just found.
                    stage.set_projection(lens.clip_from_eye(lens.camera.near_for(stage.near_m)));
                }
            }
            Sight::One(stereo, place) => {
                // In a picture of its own, whatever both would share.
                let stereo = Stereo { mode: StereoMode::LeftEye, ..*stereo };
                visitor.cull(&scene, &stereo.eyes(&camera)[*place], stage);
                if !fits_itself {
                    let near_m = lens.camera.near_for(stage.near_m);
                    let camera = CullCamera { clip_from_eye: lens.clip_from_eye(near_m), ..camera };
                    stage.set_projection(stereo.eyes(&camera)[*place].clip_from_eye);
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
        // The stage goes to the draw thread; its requests stay for the next update.
        std::mem::swap(&mut requests, &mut stage.requests);
        let near_m = stage.camera.clip_from_eye.w_axis.z;
        CullOutcome { requests, counters: stage.counters, cull_ms: millis(start.elapsed()), near_m }
    }
}

/// What culls one camera. Owned by the main thread, by the camera's thread or by its context's thread.
pub(super) struct CullSide {
    /// Number of the camera.
    pub(super) camera: u32,
    pub(super) visitor: CullVisitor,
    /// From the main thread; holds one at most. Dropped before `outcomes`: who finds that gone has the scene back once
    /// it drops its own end of this.
    pub(super) tasks: Receiver<CullTask>,
    /// To the main thread, which takes each before it sends another task.
    pub(super) outcomes: Sender<CullOutcome>,
    /// Stages that draw has done with; never more than there are.
    pub(super) available: Receiver<RenderStage>,
    /// To the thread that draws.
    pub(super) culled: Sender<Culled>,
    /// The main thread waits at it at the end of the frame, in models that overlap frames.
    pub(super) end_of_dynamic: Option<Arc<BlockCount>>,
}

impl CullSide {
    /// Culls what there is to be culled; nothing where there is no task.
    pub(super) fn cull(&mut self) {
        let task = match self.tasks.try_recv() {
            Ok(task) => task,
            Err(TryRecvError::Empty | TryRecvError::Disconnected) => return,
        };
        // The main thread starts no frame before a stage is free; none comes where the thread that draws is gone.
        let span = timeline::span("wait for stage");
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
        let waits = self.end_of_dynamic.is_some() && (is_dynamic || has_dynamic_callbacks(&stage));
        // Each fails only where the other end is gone, which shows there.
        let _ = self.outcomes.send(outcome);
        let lost =
            self.culled.send(Culled { camera: Some(self.camera), stage, environment, completes: waits }).is_err();
        if !waits || lost {
            self.completed();
        }
    }

    fn completed(&self) {
        if let Some(block) = &self.end_of_dynamic {
            block.completed();
        }
    }
}

/// True when callbacks of the stage or of one around it read what update changes.
fn has_dynamic_callbacks(stage: &RenderStage) -> bool {
    CameraCallbacks::variance_of(&stage.target.callbacks) == DataVariance::Dynamic
        || BinCallback::are_dynamic(stage)
        || stage.pre_render.iter().chain(&stage.post_render).any(has_dynamic_callbacks)
}
