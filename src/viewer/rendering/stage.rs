//! [`Rendering`]: devices with their contexts, cameras, and the frame that they render together. Driven by the main thread.

use std::sync::Arc;

use smallvec::SmallVec;

use super::super::ViewerError;
use super::super::ids::ContextId;
use super::cores;
use super::cull_side::{CullOutcome, CullSide, CullTask, SCENE_VIEWS};
use super::device::{DeviceHandle, DeviceOfScene};
use super::draw_side::DrawEnd;
use super::frame_job::{FrameDone, FrameJob};
use super::model::ThreadingModel;
use super::upload_ticket::UploadOwner;
use crate::cull::{CullVisitor, RenderStage};
use crate::gpu::{Compiled, ContextTraits, GpuError, GraphicsContext};
use crate::pager::CompileContext;
use crate::scene::{BlockFormats, DrawSlot, Drawable};
use crate::sync::primitives::channel::{self, Receiver, Sender};
use crate::sync::{Barrier, BlockCount, Operation, OperationQueue, OperationThread};
use crate::trace;

/// The number of frames that may be in flight to a context's thread; a camera has a render stage for each.
pub(in crate::viewer) const FRAMES_IN_FLIGHT: usize = SCENE_VIEWS;

/// The owner of a camera's [`CullSide`].
pub(super) enum CameraSide {
    /// The main thread.
    Here(Box<CullSide>),
    /// The camera's own thread.
    Thread(OperationThread<CullSide>),
    /// The thread of its device, which culls and draws.
    AtContext,
    /// Lost: its thread panicked or could not be started.
    Lost,
}

/// The main thread's end of a camera.
pub(super) struct CameraHandle {
    /// A number that is never used again.
    pub(super) number: u32,
    /// Number of the context that it is drawn in.
    pub(super) context: u32,
    pub(super) side: CameraSide,
    /// `None` once the culling thread has died: an open channel would keep its task, and with it the scene.
    tasks: Option<Sender<CullTask>>,
    outcomes: Receiver<CullOutcome>,
    /// The task of the next frame, until it is sent.
    next: Option<CullTask>,
    /// The result of the last frame's cull.
    outcome: CullOutcome,
    /// The application's operations, which the thread that culls runs.
    pub(super) operations: Arc<OperationQueue<CullVisitor>>,
}

/// The barriers that the threads of a model share.
pub(super) struct Running {
    pub(super) model: ThreadingModel,
    /// Culls, or the threads that cull and draw, wait here for the frame.
    pub(super) start: Option<Arc<Barrier>>,
    /// Threads that cull and draw meet the main thread here after the frame.
    pub(super) end: Option<Arc<Barrier>>,
    /// The main thread waits here until draw has read all data that update overwrites.
    pub(super) end_of_dynamic: Option<Arc<BlockCount>>,
}

/// The result of closing a context.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::viewer) enum Closed {
    /// There is no such context.
    Nothing,
    /// The context was closed; other contexts use its device.
    Context,
    /// The context and its device, given by number, were closed.
    Device(u32),
}

/// The devices, contexts, cameras and threads of a viewer.
pub(in crate::viewer) struct Rendering {
    pub(super) devices: Vec<DeviceHandle>,
    /// In the order drawn within their contexts.
    pub(super) cameras: Vec<CameraHandle>,
    next_context: u32,
    next_camera: u32,
    blocking: bool,
    /// Each thread is pinned to a core.
    pub(super) pins_threads: bool,
    /// The model that was asked for.
    pub(super) model: ThreadingModel,
    /// Runs for each context that is opened.
    pub(super) realize: Option<Arc<dyn Operation<GraphicsContext>>>,
    /// `None` until the first frame, and while contexts or cameras are added and removed.
    pub(super) running: Option<Running>,
}

impl Rendering {
    /// Creates a stage without contexts and cameras. `blocking` contexts finish all uploads whenever results are taken.
    pub(in crate::viewer) fn new(blocking: bool, pins_threads: bool) -> Self {
        // Before any thread is pinned.
        let _ = (cores::all(), cores::count());
        Self {
            devices: Vec::new(),
            cameras: Vec::new(),
            next_context: 0,
            next_camera: 0,
            blocking,
            pins_threads,
            model: ThreadingModel::SingleThreaded,
            realize: None,
            running: None,
        }
    }

    pub(in crate::viewer) fn devices_mut(&mut self) -> impl Iterator<Item = &mut DeviceHandle> {
        self.devices.iter_mut()
    }

    /// Returns the numbers of the devices; a device has the number of its first context.
    pub(in crate::viewer) fn device_ids(&self) -> impl Iterator<Item = u32> {
        self.devices.iter().map(DeviceHandle::number)
    }

    /// Returns the numbers of the contexts, by the screens of their windows and the positions there, then in the order opened.
    pub(in crate::viewer) fn context_ids(&self) -> impl Iterator<Item = u32> + use<> {
        let mut places: Vec<_> = self.devices.iter().flat_map(DeviceHandle::places).collect();
        places.sort_unstable();
        places.into_iter().map(|(.., context)| context)
    }

    pub(in crate::viewer) fn device_count(&self) -> usize {
        self.devices.len()
    }

    pub(in crate::viewer) fn device_at(&mut self, index: usize) -> Option<&mut DeviceHandle> {
        self.devices.get_mut(index)
    }

    /// Returns the device of a context.
    pub(in crate::viewer) fn device_of(&mut self, context: u32) -> Option<&mut DeviceHandle> {
        self.devices.iter_mut().find(|d| d.size_px(context).is_some())
    }

    /// Returns the size of a context's target.
    pub(in crate::viewer) fn size_px(&self, context: u32) -> Option<[u32; 2]> {
        self.devices.iter().find_map(|d| d.size_px(context))
    }

    /// Returns the name of the first context's adapter.
    pub(in crate::viewer) fn adapter_name(&self) -> &str {
        self.devices.first().map_or("", DeviceHandle::adapter_name)
    }

    /// Returns the families of compressed texture formats that all devices sample.
    pub(in crate::viewer) fn block_formats(&self) -> BlockFormats {
        self.devices.iter().map(DeviceHandle::block_formats).reduce(BlockFormats::intersection).unwrap_or_default()
    }

    /// Returns true if the first context's adapter is a software driver.
    pub(in crate::viewer) fn is_software(&self) -> bool {
        self.devices.first().is_some_and(DeviceHandle::is_software)
    }

    /// Returns the number of frames in flight on the device of an index; 0 without such a device.
    pub(in crate::viewer) fn in_flight(&self, index: usize) -> usize {
        self.devices.get(index).map_or(0, DeviceHandle::in_flight)
    }

    /// Returns true when all contexts have drawn a frame.
    pub(in crate::viewer) fn all_done(&self, frame: u32) -> bool {
        self.devices.iter().all(|d| d.is_done(frame))
    }

    /// Gives a pager, known by its owner number, access to the upload queues of all devices.
    pub(in crate::viewer) fn compile_for<R>(
        &mut self,
        owner: u16,
        work: impl FnOnce(&mut [&mut dyn CompileContext]) -> R,
    ) -> R {
        // Updates of up to four devices allocate nothing here.
        let devices = self.devices.iter_mut().map(|handle| DeviceOfScene { handle, owner });
        let mut contexts: SmallVec<[_; 4]> = devices.collect();
        let mut contexts: SmallVec<[_; 4]> = contexts.iter_mut().map(|c| c as &mut dyn CompileContext).collect();
        work(&mut contexts)
    }

    /// Uploads a page of the application to all devices. `owner` stands for its scene, `number` for the page.
    pub(in crate::viewer) fn compile_own(
        &mut self,
        owner: u16,
        number: u32,
        drawables: Vec<Drawable>,
    ) -> Result<(), ViewerError> {
        let Some((last, others)) = self.devices.split_last_mut() else { return Ok(()) };
        for context in others {
            context.compile_own(owner, number, drawables.clone())?;
        }
        last.compile_own(owner, number, drawables)
    }

    /// Does the same as [`Self::compile_own`] for one device.
    pub(in crate::viewer) fn compile_own_in(
        &mut self,
        device: u32,
        owner: u16,
        number: u32,
        drawables: Vec<Drawable>,
    ) -> Result<(), ViewerError> {
        self.numbered(device).map_or(Ok(()), |d| d.compile_own(owner, number, drawables))
    }

    /// Takes the finished uploads of a scene's own pages: device, number of the page, result.
    pub(in crate::viewer) fn take_compiled_own(&mut self, owner: u16) -> Vec<(u32, u32, Compiled)> {
        let of_device = |d: &mut DeviceHandle| {
            let device = d.number();
            d.take_compiled(UploadOwner::Pages(owner))
                .into_iter()
                .map(move |compiled| (device, compiled.ticket as u32, compiled))
        };
        self.devices.iter_mut().flat_map(of_device).collect()
    }

    /// Waits for all uploads, except on devices that are lost. No frame may be in flight.
    pub(in crate::viewer) fn finish_compiles(&mut self) {
        self.devices.iter_mut().for_each(|device| device.end_compiles(true));
    }

    /// Releases the finished uploads of a scene or pager that was removed.
    pub(in crate::viewer) fn release_compiled(&mut self, owner: UploadOwner) {
        for device in &mut self.devices {
            for compiled in device.take_compiled(owner) {
                device.release(compiled.slots);
            }
        }
    }

    fn numbered(&mut self, device: u32) -> Option<&mut DeviceHandle> {
        self.devices.iter_mut().find(|d| d.number() == device)
    }

    /// Frees draw slots of a device after the last frame that draws them.
    pub(in crate::viewer) fn release(&mut self, device: u32, slots: Vec<DrawSlot>) {
        if let Some(device) = self.numbered(device) {
            device.release(slots);
        }
    }

    fn next_context(&mut self) -> u32 {
        let number = self.next_context;
        self.next_context += 1;
        number
    }

    /// Adds a device with one context, and returns the number of both. Ends the threads.
    pub(in crate::viewer) fn add_context(&mut self, context: GraphicsContext, frame: u32) -> u32 {
        self.stop_threads();
        let number = self.next_context();
        self.devices.push(DeviceHandle::new(number, context, self.blocking, frame));
        self.realize_context(number);
        number
    }

    /// Adds a context on the device of another one, and returns its number. `add` creates the target. Ends the threads.
    pub(in crate::viewer) fn add_context_on(
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
        self.realize_context(number);
        Ok(self.next_context())
    }

    /// Drops a context and its cameras, and its device when no other context uses it. Ends the threads.
    pub(in crate::viewer) fn remove_context(&mut self, context: u32) -> Closed {
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

    /// Waits for all frames in flight.
    pub(in crate::viewer) fn end_frames(&mut self) -> Result<Vec<FrameDone>, ViewerError> {
        let mut done = Vec::new();
        for device in &mut self.devices {
            done.append(&mut device.end_frames()?);
        }
        Ok(done)
    }

    /// Replaces lost devices by new ones without uploads, and returns their numbers, which stay the same. Ends the threads;
    /// no frame may be in flight.
    pub(in crate::viewer) fn renew_lost(&mut self) -> Result<Vec<u32>, ViewerError> {
        self.stop_threads();
        let mut renewed = Vec::new();
        for device in &mut self.devices {
            if device.renew()? {
                renewed.push(device.number());
            }
        }
        // Resources that the operation has created for a context were on the old device.
        let contexts =
            self.devices.iter().filter(|d| renewed.contains(&d.number())).flat_map(DeviceHandle::context_ids);
        let contexts: Vec<u32> = contexts.collect();
        contexts.into_iter().for_each(|context| self.realize_context(context));
        Ok(renewed)
    }

    /// Drops a camera. Ends the threads.
    pub(in crate::viewer) fn remove_camera(&mut self, number: u32) {
        self.stop_threads();
        for side in self.devices.iter_mut().filter_map(DeviceHandle::here) {
            side.contexts.iter_mut().for_each(|context| context.cameras.retain(|end| end.camera != number));
        }
        self.cameras.retain(|c| c.number != number);
    }

    /// Adds a camera, drawn after the other cameras of its context. Returns its number and that of the device. Ends the
    /// threads.
    pub(in crate::viewer) fn add_camera(&mut self, context: u32) -> Option<(u32, u32)> {
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
            // The channel has room for all stages.
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
            operations: Arc::default(),
        };
        let operations = cull.operations.clone();
        let side = CameraSide::Here(Box::new(cull));
        let outcome = CullOutcome::default();
        let tasks = Some(tasks);
        let next = None;
        self.cameras.push(CameraHandle { number, context, side, tasks, outcomes, next, outcome, operations });
        self.next_camera += 1;
        Some((number, device_id))
    }

    /// Renders one frame of all contexts. `job` returns the job of a context, `task` the task of a camera for its number and
    /// its last outcome, whose memory is used again. A camera without a task is a bug of ours.
    pub(in crate::viewer) fn frame(
        &mut self,
        job: impl FnMut(u32) -> FrameJob,
        task: impl FnMut(u32, CullOutcome) -> Option<CullTask>,
    ) -> Result<(), ViewerError> {
        let rendered = self.dispatch(job, task);
        if rendered.is_err() {
            // Barriers that were released cannot be used again.
            self.stop_threads();
        }
        rendered
    }

    /// Runs all steps even after an error, so that no thread is left waiting and no cull holds the scene. A thread that dies
    /// releases the threads that wait for it. The frame then fails and ends all threads, because others may still read what
    /// the next update changes.
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
            // A context would wait for the stage of a camera without a task.
            self.cameras.iter_mut().for_each(|camera| camera.next = None);
            return Err(ViewerError::DrawThreadStopped);
        }
        if let Some(block) = &running.end_of_dynamic {
            block.reset();
        }
        // Tasks are sent before jobs. Once a thread has died, no barrier holds the others back; a thread that culls its own
        // cameras would then find no task and wait for the stage forever.
        for camera in &mut self.cameras {
            let Some(task) = camera.next.take() else { continue };
            let sent = camera.tasks.as_ref().is_some_and(|tasks| tasks.send(task).is_ok());
            result = result.and(unless_dead(sent));
        }
        for device in &mut self.devices {
            for index in 0..device.context_ids().count() {
                let Some(context) = device.context_ids().nth(index) else { break };
                result = result.and(device.frame(FrameJob { context, ..job(context) }));
            }
        }
        if let Some(barrier) = &running.start {
            let _span = trace::span("start barrier");
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
            let _span = trace::span("end barrier");
            result = result.and(unless_dead(barrier.block()));
        }
        if let Some(block) = &running.end_of_dynamic {
            let _span = trace::span("end of dynamic draws");
            result = result.and(unless_dead(block.block()));
        }
        let _span = trace::span("wait for culls");
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

    /// Returns the results of the last frame's culls, by number of the camera.
    pub(in crate::viewer) fn outcomes(&self) -> impl Iterator<Item = (u32, &CullOutcome)> {
        self.cameras.iter().map(|c| (c.number, &c.outcome))
    }
}
