//! [`Rendering`]: the rendering stage of the frame. Contexts and cameras, the threads that a model gives them to, and
//! what these wait for. Driven by the main thread.
//!
//! One frame, where the reference has it:
//!
//! ```text
//! reset the end of dynamic draws
//! tasks to the cameras, jobs to the contexts
//! start barrier             CullDrawThreadPerContext: contexts; CullThreadPerCamera...: cameras
//! cull                      of the cameras that the main thread has
//! draw, swap                of the contexts that the main thread has
//! end barrier               CullDrawThreadPerContext: contexts
//! end of dynamic draws      DrawThreadPerContext and CullThreadPerCamera...
//! ```
//! Whichever thread culls has dropped the scene by then, so that between two frames it is the main thread's alone.
//! `tests/stage_models.rs` runs these very files under thousands of schedules.

mod cull_side;
mod device;
mod draw_side;
mod model;
mod operations;
mod threads;

use std::sync::Arc;
use std::time::Duration;

use self::device::{DeviceHandle, DeviceOfScene};
pub(super) use cull_side::{CullOutcome, CullTask, Lens, Sight};
pub(super) use draw_side::{FrameDone, FrameJob};
pub use model::{THREADING_VARIABLE, ThreadingModel};

use self::cull_side::{CullSide, SCENE_VIEWS};
use self::draw_side::DrawEnd;
use super::ViewerError;
use super::view::ContextId;
use crate::cull::{CullVisitor, RenderStage};
use crate::gpu::{Compiled, ContextTraits, GpuError, GraphicsContext};
use crate::pager::CompileContext;
use crate::scene::{DrawSlot, Drawable};
use crate::sync::primitives::channel::{self, Receiver, Sender};
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

/// What closing a context came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Closed {
    /// There is none.
    Nothing,
    /// The context alone: others have its device.
    Context,
    /// Its device of a number too.
    Device(u32),
}

/// Devices with their contexts, cameras and threads of a viewer.
pub(super) struct Rendering {
    devices: Vec<DeviceHandle>,
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
            devices: Vec::new(),
            cameras: Vec::new(),
            next_context: 0,
            next_camera: 0,
            blocking,
            keeps_cores,
            model: ThreadingModel::SingleThreaded,
            running: None,
        }
    }

    pub(super) fn devices_mut(&mut self) -> impl Iterator<Item = &mut DeviceHandle> {
        self.devices.iter_mut()
    }

    /// Numbers of the devices: of the contexts that they were opened for.
    pub(super) fn device_ids(&self) -> impl Iterator<Item = u32> {
        self.devices.iter().map(DeviceHandle::number)
    }

    /// Numbers of the contexts, in the order opened.
    pub(super) fn context_ids(&self) -> impl Iterator<Item = u32> + use<> {
        let mut contexts: Vec<u32> = self.devices.iter().flat_map(DeviceHandle::context_ids).collect();
        contexts.sort_unstable();
        contexts.into_iter()
    }

    pub(super) fn device_count(&self) -> usize {
        self.devices.len()
    }

    pub(super) fn device_at(&mut self, place: usize) -> Option<&mut DeviceHandle> {
        self.devices.get_mut(place)
    }

    /// The device of a context.
    pub(super) fn device_of(&mut self, context: u32) -> Option<&mut DeviceHandle> {
        self.devices.iter_mut().find(|d| d.size_px(context).is_some())
    }

    /// Size of a context's target.
    pub(super) fn size_px(&self, context: u32) -> Option<[u32; 2]> {
        self.devices.iter().find_map(|d| d.size_px(context))
    }

    /// Name of the first context's adapter.
    pub(super) fn adapter_name(&self) -> &str {
        self.devices.first().map_or("", DeviceHandle::adapter_name)
    }

    /// Frames that a device was sent and has not answered; 0 where there is none.
    pub(super) fn in_flight(&self, place: usize) -> usize {
        self.devices.get(place).map_or(0, DeviceHandle::in_flight)
    }

    /// All contexts have drawn a frame.
    pub(super) fn all_done(&self, frame: u32) -> bool {
        self.devices.iter().all(|d| d.is_done(frame))
    }

    /// Lets the pager of a scene upload to all devices.
    pub(super) fn compile_for<R>(&mut self, owner: u16, work: impl FnOnce(&mut [&mut dyn CompileContext]) -> R) -> R {
        let mut contexts: Vec<_> = self.devices.iter_mut().map(|handle| DeviceOfScene { handle, owner }).collect();
        let mut contexts: Vec<_> = contexts.iter_mut().map(|c| c as &mut dyn CompileContext).collect();
        work(&mut contexts)
    }

    /// Uploads what the application made to all devices, under a number of its scene's.
    pub(super) fn compile_own(&mut self, owner: u16, number: u32, drawables: Vec<Drawable>) -> Result<(), ViewerError> {
        let Some((last, others)) = self.devices.split_last_mut() else { return Ok(()) };
        for context in others {
            context.compile_own(owner, number, drawables.clone())?;
        }
        last.compile_own(owner, number, drawables)
    }

    /// As [`Self::compile_own`], to one device.
    pub(super) fn compile_own_in(
        &mut self,
        device: u32,
        owner: u16,
        number: u32,
        drawables: Vec<Drawable>,
    ) -> Result<(), ViewerError> {
        self.numbered(device).map_or(Ok(()), |d| d.compile_own(owner, number, drawables))
    }

    /// What was uploaded for a scene's own pages: device, number, slots.
    pub(super) fn take_compiled_own(&mut self, owner: u16) -> Vec<(u32, u32, Compiled)> {
        let of_device = |d: &mut DeviceHandle| {
            let device = d.number();
            d.take_compiled(owner, true).into_iter().map(move |compiled| (device, compiled.ticket as u32, compiled))
        };
        self.devices.iter_mut().flat_map(of_device).collect()
    }

    /// Waits until all that was sent to be uploaded is, but to devices that are lost. No frame is under way.
    pub(super) fn finish_compiles(&mut self) {
        self.devices.iter_mut().for_each(|device| device.end_compiles(true));
    }

    /// Releases what was uploaded for somebody who is gone.
    pub(super) fn release_compiled(&mut self, owner: u16, is_own: bool) {
        for device in &mut self.devices {
            for compiled in device.take_compiled(owner, is_own) {
                device.release(compiled.slots);
            }
        }
    }

    fn numbered(&mut self, device: u32) -> Option<&mut DeviceHandle> {
        self.devices.iter_mut().find(|d| d.number() == device)
    }

    /// Frees slots of a device after the last frame that draws them.
    pub(super) fn release(&mut self, device: u32, slots: Vec<DrawSlot>) {
        if let Some(device) = self.numbered(device) {
            device.release(slots);
        }
    }

    fn next_context(&mut self) -> u32 {
        let number = self.next_context;
        self.next_context += 1;
        number
    }

    /// Adds a device with one context; its number, which is the device's too. Ends the threads.
    pub(super) fn add_context(&mut self, context: GraphicsContext, frame: u32) -> u32 {
        self.stop_threads();
        let number = self.next_context();
        self.devices.push(DeviceHandle::new(number, context, self.blocking, frame));
        number
    }

    /// Adds a context on the device of another one, which `add` gives its target; its number. Ends the threads.
    pub(super) fn add_context_on(
        &mut self,
        other: u32,
        traits: &ContextTraits,
        frame: u32,
        add: impl FnOnce(&mut GraphicsContext, &ContextTraits) -> Result<(), GpuError>,
    ) -> Result<u32, ViewerError> {
        self.stop_threads();
        let number = self.next_context;
        let device = self.device_of(other).ok_or(ViewerError::NoContext(ContextId(other)))?;
        device.add_context(number, traits, frame, add)?;
        Ok(self.next_context())
    }

    /// Drops a context and its cameras, and its device where no other context has that. Ends the threads.
    pub(super) fn remove_context(&mut self, context: u32) -> Closed {
        self.stop_threads();
        let Some(device) = self.device_of(context) else { return Closed::Nothing };
        let number = device.number();
        self.cameras.retain(|c| c.context != context);
        match self.device_of(context).is_some_and(|d| d.remove_context(context)) {
            true => Closed::Context,
            false => {
                self.devices.retain(|d| d.number() != number);
                Closed::Device(number)
            }
        }
    }

    /// Waits for all frames under way.
    pub(super) fn end_frames(&mut self) -> Result<Vec<FrameDone>, ViewerError> {
        let mut done = Vec::new();
        for device in &mut self.devices {
            done.append(&mut device.end_frames()?);
        }
        Ok(done)
    }

    /// Gives contexts whose devices are lost new ones, with nothing uploaded to them; the devices' numbers, which stay.
    /// Ends the threads; no frame is under way.
    pub(super) fn renew_lost(&mut self) -> Result<Vec<u32>, ViewerError> {
        self.stop_threads();
        let mut renewed = Vec::new();
        for device in &mut self.devices {
            if device.renew()? {
                renewed.push(device.number());
            }
        }
        Ok(renewed)
    }

    /// Drops a camera. Ends the threads.
    pub(super) fn remove_camera(&mut self, number: u32) {
        self.stop_threads();
        for side in self.devices.iter_mut().filter_map(DeviceHandle::here) {
            side.contexts.iter_mut().for_each(|context| context.cameras.retain(|end| end.camera != number));
        }
        self.cameras.retain(|c| c.number != number);
    }

    /// Adds a camera that is drawn in a context after those that are there; the numbers of the camera and of the device
    /// that draws it. Ends the threads.
    pub(super) fn add_camera(&mut self, context: u32) -> Option<(u32, u32)> {
        self.stop_threads();
        let number = self.next_camera;
        let device = self.device_of(context)?;
        let device_id = device.number();
        let drawn = device.here()?.drawn_mut(context)?;
        let (tasks, tasks_in) = channel::bounded(1);
        let (outcomes_out, outcomes) = channel::bounded(1);
        let (culled_out, culled) = channel::bounded(SCENE_VIEWS);
        let (available, available_in) = channel::bounded(SCENE_VIEWS);
        for _ in 0..SCENE_VIEWS {
            // There is room for as many.
            let _ = available.try_send(RenderStage::new());
        }
        drawn.cameras.push(DrawEnd { camera: number, culled, available });
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
        self.next_camera += 1;
        Some((number, device_id))
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

    /// Goes through all steps whatever fails, so that no thread is left waiting and no cull has the scene. A thread that
    /// dies lets go whoever waits for it: that is an error of this very frame, which ends the threads, as the others may
    /// still read what the next update changes.
    fn dispatch(
        &mut self,
        mut job: impl FnMut(u32) -> FrameJob,
        mut task: impl FnMut(u32, CullOutcome) -> Option<CullTask>,
    ) -> Result<(), ViewerError> {
        let mut result = Ok(());
        let unless_dead = |is_there: bool| if is_there { Ok(()) } else { Err(ViewerError::DrawThreadStopped) };
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
        // Before the jobs: once a thread has died no barrier holds the others back, and those that cull for themselves
        // would look for a task that is still to come, and wait for its stage for ever.
        for camera in &mut self.cameras {
            let Some(task) = camera.next.take() else { continue };
            let sent = camera.tasks.as_ref().is_some_and(|tasks| tasks.send(task).is_ok());
            result = result.and(unless_dead(sent));
        }
        for device in &mut self.devices {
            for place in 0..device.context_ids().count() {
                let Some(context) = device.context_ids().nth(place) else { break };
                result = result.and(device.frame(FrameJob { context, ..job(context) }));
            }
        }
        if let Some(barrier) = &running.start {
            let _span = timeline::span("start barrier");
            result = result.and(unless_dead(barrier.block()));
        }
        for camera in &mut self.cameras {
            if let CameraSide::Here(side) = &mut camera.side {
                side.cull();
            }
        }
        for device in &mut self.devices {
            if let Some(side) = device.here() {
                side.render();
            }
        }
        for device in &mut self.devices {
            if let Some(side) = device.here() {
                side.swap();
            }
        }
        if let Some(barrier) = &running.end {
            let _span = timeline::span("end barrier");
            result = result.and(unless_dead(barrier.block()));
        }
        if let Some(block) = &running.end_of_dynamic {
            let _span = timeline::span("end of dynamic draws");
            result = result.and(unless_dead(block.block()));
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
