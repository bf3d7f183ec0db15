//! [`Rendering`]: the rendering stage of the frame. Contexts and cameras, the threads that a model gives them to, and
//! what these wait for. Driven by the main thread.
//!
//! One frame, where the reference has it:
//!
//! ```text
//! reset the end of dynamic draws
//! jobs to the contexts, tasks to the cameras
//! start barrier             CullDrawThreadPerContext: contexts; CullThreadPerCamera...: cameras
//! cull                      of the cameras that the main thread has
//! draw, swap                of the contexts that the main thread has
//! end barrier               CullDrawThreadPerContext: contexts
//! end of dynamic draws      DrawThreadPerContext and CullThreadPerCamera...
//! ```
//! Whichever thread culls has dropped the scene by then, so that between two frames it is the main thread's alone.

mod context;
mod cull_side;
mod draw_side;
mod model;
mod operations;
mod threads;

use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender};

use self::context::{ContextHandle, ContextOfScene};
pub(super) use cull_side::{CullOutcome, CullTask, Lens};
pub(super) use draw_side::{FrameDone, FrameJob};
pub use model::{THREADING_VARIABLE, ThreadingModel};

use self::cull_side::{CullSide, SCENE_VIEWS};
use self::draw_side::DrawEnd;
use super::ViewerError;
use crate::cull::{CullVisitor, RenderStage};
use crate::gpu::{Compiled, GraphicsContext};
use crate::pager::CompileContext;
use crate::scene::{DrawSlot, Drawable};
use crate::sync::{Barrier, BlockCount, OperationThread};
use crate::timeline;

/// Frames that may be on their way to or in a context's thread; as many as a camera has stages.
pub(super) const FRAMES_IN_FLIGHT: usize = SCENE_VIEWS;

/// A duration in milliseconds.
pub(super) fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// Who has what culls a camera.
enum CameraSide {
    /// The main thread.
    Here(Box<CullSide>),
    /// A thread of its own.
    Thread(OperationThread<CullSide>),
    /// The thread of its context.
    AtContext,
    /// Nobody any more: its thread panicked, or could not be started.
    Lost,
}

/// The main thread's end of a camera.
struct CameraHandle {
    /// Never used again.
    number: u32,
    /// Number of the context that it is drawn in.
    context: u32,
    side: CameraSide,
    /// `None` once whoever culled is gone: a channel keeps its task, and with it the scene, while one end is there.
    tasks: Option<Sender<CullTask>>,
    outcomes: Receiver<CullOutcome>,
    /// About to be sent.
    next: Option<CullTask>,
    /// Of the last frame.
    outcome: CullOutcome,
}

/// What all threads of a model have in common.
struct Running {
    model: ThreadingModel,
    start: Option<Arc<Barrier>>,
    end: Option<Arc<Barrier>>,
    end_of_dynamic: Option<Arc<BlockCount>>,
}

/// Contexts, cameras and threads of a viewer.
pub(super) struct Rendering {
    contexts: Vec<ContextHandle>,
    /// In the order drawn within their contexts.
    cameras: Vec<CameraHandle>,
    next_context: u32,
    next_camera: u32,
    blocking: bool,
    /// The threads stay on cores of their own.
    keeps_cores: bool,
    /// What was asked for.
    model: ThreadingModel,
    /// `None` until the first frame, and while contexts or cameras come and go.
    running: Option<Running>,
}

impl Rendering {
    /// Without contexts and cameras; `blocking` contexts finish all uploads when they are asked for them.
    pub(super) fn new(blocking: bool, keeps_cores: bool) -> Self {
        Self {
            contexts: Vec::new(),
            cameras: Vec::new(),
            next_context: 0,
            next_camera: 0,
            blocking,
            keeps_cores,
            model: ThreadingModel::SingleThreaded,
            running: None,
        }
    }

    pub(super) fn contexts_mut(&mut self) -> impl Iterator<Item = &mut ContextHandle> {
        self.contexts.iter_mut()
    }

    /// Numbers of the contexts, in the order opened.
    pub(super) fn context_ids(&self) -> impl Iterator<Item = u32> {
        self.contexts.iter().map(ContextHandle::number)
    }

    pub(super) fn context_count(&self) -> usize {
        self.contexts.len()
    }

    pub(super) fn context_mut(&mut self, context: u32) -> Option<&mut ContextHandle> {
        self.contexts.iter_mut().find(|c| c.number() == context)
    }

    pub(super) fn context_at(&mut self, place: usize) -> Option<&mut ContextHandle> {
        self.contexts.get_mut(place)
    }

    /// Size of a context's target.
    pub(super) fn size_px(&self, context: u32) -> Option<[u32; 2]> {
        self.contexts.iter().find(|c| c.number() == context).map(ContextHandle::size_px)
    }

    /// Name of the first context's adapter.
    pub(super) fn adapter_name(&self) -> &str {
        self.contexts.first().map_or("", ContextHandle::adapter_name)
    }

    /// Frames that a context was sent and has not answered; 0 where there is none.
    pub(super) fn in_flight(&self, place: usize) -> usize {
        self.contexts.get(place).map_or(0, ContextHandle::in_flight)
    }

    /// All contexts have drawn a frame.
    pub(super) fn all_done(&self, frame: u32) -> bool {
        self.contexts.iter().all(|c| c.done_frame >= frame)
    }

    /// Lets the pager of a scene upload to all contexts.
    pub(super) fn compile_for<R>(&mut self, owner: u16, work: impl FnOnce(&mut [&mut dyn CompileContext]) -> R) -> R {
        let mut contexts: Vec<_> = self.contexts.iter_mut().map(|handle| ContextOfScene { handle, owner }).collect();
        let mut contexts: Vec<_> = contexts.iter_mut().map(|c| c as &mut dyn CompileContext).collect();
        work(&mut contexts)
    }

    /// Uploads what the application made to all contexts, under a number of its scene's.
    pub(super) fn compile_own(&mut self, owner: u16, number: u32, drawables: Vec<Drawable>) -> Result<(), ViewerError> {
        let Some((last, others)) = self.contexts.split_last_mut() else { return Ok(()) };
        for context in others {
            context.compile_own(owner, number, drawables.clone())?;
        }
        last.compile_own(owner, number, drawables)
    }

    /// As [`Self::compile_own`], to one context.
    pub(super) fn compile_own_in(
        &mut self,
        context: u32,
        owner: u16,
        number: u32,
        drawables: Vec<Drawable>,
    ) -> Result<(), ViewerError> {
        self.context_mut(context).map_or(Ok(()), |c| c.compile_own(owner, number, drawables))
    }

    /// What was uploaded for a scene's own pages: context, number, slots.
    pub(super) fn take_compiled_own(&mut self, owner: u16) -> Vec<(u32, u32, Compiled)> {
        let of_context = |c: &mut ContextHandle| {
            let context = c.number();
            c.take_compiled(owner, true).into_iter().map(move |compiled| (context, compiled.ticket as u32, compiled))
        };
        self.contexts.iter_mut().flat_map(of_context).collect()
    }

    /// Frees slots of a context after the last frame that draws them.
    pub(super) fn release(&mut self, context: u32, slots: Vec<DrawSlot>) {
        if let Some(context) = self.context_mut(context) {
            context.release(slots);
        }
    }

    /// Adds a context; its number. Ends the threads.
    pub(super) fn add_context(&mut self, context: GraphicsContext, frame: u32) -> u32 {
        self.stop_threads();
        let number = self.next_context;
        self.next_context += 1;
        self.contexts.push(ContextHandle::new(number, context, self.blocking, frame));
        number
    }

    /// Drops a context and its cameras; false when there is none. Ends the threads.
    pub(super) fn remove_context(&mut self, context: u32) -> bool {
        self.stop_threads();
        let before = self.contexts.len();
        self.contexts.retain(|c| c.number() != context);
        self.cameras.retain(|c| c.context != context);
        self.contexts.len() < before
    }

    /// Gives contexts whose devices are lost new ones, with nothing uploaded to them; their numbers. Ends the threads,
    /// and drops what is under way.
    pub(super) fn renew_lost(&mut self) -> Result<Vec<u32>, ViewerError> {
        for context in &mut self.contexts {
            context.drop_frames()?;
        }
        self.stop_threads();
        let mut renewed = Vec::new();
        for context in &mut self.contexts {
            if context.renew()? {
                renewed.push(context.number());
            }
        }
        Ok(renewed)
    }

    /// Drops a camera. Ends the threads.
    pub(super) fn remove_camera(&mut self, number: u32) {
        self.stop_threads();
        for side in self.contexts.iter_mut().filter_map(ContextHandle::here) {
            side.cameras.retain(|end| end.camera != number);
        }
        self.cameras.retain(|c| c.number != number);
    }

    /// Adds a camera that is drawn in a context after those that are there; its number. Ends the threads.
    pub(super) fn add_camera(&mut self, context: u32) -> Option<u32> {
        self.stop_threads();
        let side = self.contexts.iter_mut().find(|c| c.number() == context)?.here()?;
        let number = self.next_camera;
        self.next_camera += 1;
        let (tasks, tasks_in) = crossbeam_channel::bounded(1);
        let (outcomes_out, outcomes) = crossbeam_channel::bounded(1);
        let (culled_out, culled) = crossbeam_channel::bounded(SCENE_VIEWS);
        let (available, available_in) = crossbeam_channel::bounded(SCENE_VIEWS);
        for _ in 0..SCENE_VIEWS {
            // There is room for as many.
            let _ = available.try_send(RenderStage::new());
        }
        side.cameras.push(DrawEnd { camera: number, culled, available });
        let cull = CullSide {
            camera: number,
            visitor: CullVisitor::new(),
            tasks: tasks_in,
            outcomes: outcomes_out,
            available: available_in,
            culled: culled_out,
            end_of_dynamic: None,
        };
        let side = CameraSide::Here(Box::new(cull));
        let outcome = CullOutcome::default();
        let tasks = Some(tasks);
        self.cameras.push(CameraHandle { number, context, side, tasks, outcomes, next: None, outcome });
        Some(number)
    }

    /// Renders one frame of all contexts. `job` gives the job of each context, `task` the task of each camera from its
    /// number and its last outcome, whose memory is used again; `None` is an error of ours.
    pub(super) fn frame(
        &mut self,
        job: impl FnMut(u32) -> FrameJob,
        task: impl FnMut(u32, CullOutcome) -> Option<CullTask>,
    ) -> Result<(), ViewerError> {
        let rendered = self.dispatch(job, task);
        if rendered.is_err() {
            // Barriers that were let go are of no use any more.
            self.stop_threads();
        }
        rendered
    }

    /// Goes through all steps whatever fails, so that no thread is left waiting and no cull has the scene.
    fn dispatch(
        &mut self,
        mut job: impl FnMut(u32) -> FrameJob,
        mut task: impl FnMut(u32, CullOutcome) -> Option<CullTask>,
    ) -> Result<(), ViewerError> {
        let mut result = Ok(());
        let Some(running) = &self.running else { return Err(ViewerError::DrawThreadStopped) };
        for camera in &mut self.cameras {
            camera.next = task(camera.number, std::mem::take(&mut camera.outcome));
            debug_assert!(camera.next.is_some(), "camera {} belongs to no view", camera.number);
        }
        if self.cameras.iter().any(|camera| camera.next.is_none()) {
            // A context would wait for its stage.
            self.cameras.iter_mut().for_each(|camera| camera.next = None);
            return Err(ViewerError::DrawThreadStopped);
        }
        if let Some(block) = &running.end_of_dynamic {
            block.reset();
        }
        for context in &mut self.contexts {
            let job = job(context.number());
            result = result.and(context.frame(job));
        }
        for camera in &mut self.cameras {
            let Some(task) = camera.next.take() else { continue };
            let sent = camera.tasks.as_ref().is_some_and(|tasks| tasks.send(task).is_ok());
            result = result.and(if sent { Ok(()) } else { Err(ViewerError::DrawThreadStopped) });
        }
        if let Some(barrier) = &running.start {
            let _span = timeline::span("start barrier");
            barrier.block();
        }
        for camera in &mut self.cameras {
            if let CameraSide::Here(side) = &mut camera.side {
                side.cull();
            }
        }
        for context in &mut self.contexts {
            if let Some(side) = context.here() {
                side.render();
            }
        }
        for context in &mut self.contexts {
            if let Some(side) = context.here() {
                side.swap();
            }
        }
        if let Some(barrier) = &running.end {
            let _span = timeline::span("end barrier");
            barrier.block();
        }
        if let Some(block) = &running.end_of_dynamic {
            let _span = timeline::span("end of dynamic draws");
            block.block();
        }
        let _span = timeline::span("wait for culls");
        for camera in &mut self.cameras {
            match camera.outcomes.recv() {
                Ok(outcome) => camera.outcome = outcome,
                Err(_) => {
                    camera.tasks = None;
                    result = result.and(Err(ViewerError::DrawThreadStopped));
                }
            }
        }
        result
    }

    /// What the cameras' culls of the last frame gave.
    pub(super) fn outcomes(&self) -> impl Iterator<Item = (u32, &CullOutcome)> {
        self.cameras.iter().map(|c| (c.number, &c.outcome))
    }
}
