//! [`DeviceHandle`]: the main thread's end of a device and its contexts, which a draw thread may own.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use image::RgbaImage;

use super::draw_side::{DrawSide, DrawSideEnds};
use super::frame_job::{DrawCommand, FrameDone, FrameJob, Reply};
use super::upload_ticket::UploadOwner;
use crate::draw::ViewChange;
use crate::gpu::{CompileBudget, CompileOperation, Compiled, ContextTraits, GpuError, GraphicsContext};
use crate::pager::{CompileContext, ImageChange};
use crate::scene::{BlockFormats, DrawKind, DrawSlot, Drawable, Mesh};
use crate::sync::primitives::channel::{self, Receiver, RecvTimeoutError, Sender};
use crate::sync::{Operation, OperationQueue, OperationThread};
use crate::viewer::ViewerError;

/// The length of the command queue; many small uploads fit between two frames.
const COMMAND_QUEUE: usize = 1024;

/// The time limit of uploads between two frames; a frame sent after them waits no longer than this.
const MAX_UPLOAD_SLICE: Duration = Duration::from_millis(2);

/// Waiting for a frame in flight gives up after this time.
const FRAME_TIMEOUT: Duration = Duration::from_secs(5);

/// The owner of the device.
enum Side {
    /// The main thread.
    Here(Box<DrawSide>),
    /// The device's draw thread.
    Thread(OperationThread<DrawSide>),
    /// Lost: its thread panicked or could not be started.
    Lost,
}

/// A context, as the main thread knows it.
struct ContextOnDevice {
    id: u32,
    /// The screen of its window, and the position there.
    place: (u32, [i32; 2]),
    size_px: [u32; 2],
    /// The last frame whose result has arrived.
    done_frame: u32,
    /// The application's operations, which the owner of the device runs.
    operations: Arc<OperationQueue<GraphicsContext>>,
}

/// Sends commands to a device, takes its answers, and gives pagers access to its upload queue. It has a field for each
/// channel and for the state of each kind of answer.
pub(in crate::viewer) struct DeviceHandle {
    /// The number of its first context, even after that was closed.
    id: u32,
    /// In the order drawn.
    contexts: Vec<ContextOnDevice>,
    side: Side,
    /// True once a command or an answer has failed.
    is_dead: bool,
    /// True when it could not finish its uploads.
    is_stuck: bool,
    commands: Sender<DrawCommand>,
    replies: Receiver<Reply>,
    /// Read by the draw thread while it waits for a frame.
    stopping: Arc<AtomicBool>,
    compiled: Receiver<Compiled>,
    /// The number of uploads in flight.
    compiling: usize,
    /// True while an upload between frames is queued; cleared by the draw thread.
    running_compiles: Arc<AtomicBool>,
    /// Finished uploads that their owners have not taken.
    arrived: Vec<Compiled>,
    /// Frame jobs in flight, one for each context of a frame.
    in_flight: usize,
    /// Waits for all uploads when results are taken, in the blocking mode.
    finish_compiles: bool,
    adapter_name: String,
    /// The families of compressed texture formats that the present device samples. They may change when a lost device is
    /// replaced.
    block_formats: BlockFormats,
    is_software: bool,
    is_host_device: bool,
    /// The application's operations on the compile thread, or on the device's thread if there is none.
    compile_operations: Arc<OperationQueue<wgpu::Device>>,
}

impl DeviceHandle {
    /// Takes a device with one context. The main thread owns it until threads are started.
    pub(super) fn new(id: u32, context: GraphicsContext, blocking: bool, frame: u32) -> Self {
        let (size_px, place) = (context.size_px(), context.place());
        let compile_operations = context.compile_operations().clone();
        let (adapter_name, is_software) = (context.adapter_name(), context.is_software());
        let (is_host_device, block_formats) = (context.is_host_device(), context.block_formats());
        let (commands, to_do) = channel::bounded(COMMAND_QUEUE);
        // Unbounded, since a device that the main thread owns sends to itself and must not block. Uploads are at most as many
        // as the pagers and scenes have in flight; replies at most one per context and frame in flight, and one more.
        let (compiled_sender, compiled) = channel::unbounded();
        let (reply_sender, replies) = channel::unbounded();
        let running_compiles = Arc::new(AtomicBool::new(false));
        let stopping = Arc::new(AtomicBool::new(false));
        let ends = DrawSideEnds {
            commands: to_do,
            replies: reply_sender,
            stopping: stopping.clone(),
            running_compiles: running_compiles.clone(),
            compiled: compiled_sender,
        };
        let mut side = DrawSide::new(context, id, ends, blocking);
        let operations = side.drawn_mut(id).map(|context| context.operations.clone()).unwrap_or_default();
        Self {
            id,
            contexts: vec![ContextOnDevice { id, place, size_px, done_frame: frame, operations }],
            side: Side::Here(Box::new(side)),
            is_dead: false,
            is_stuck: false,
            commands,
            replies,
            stopping,
            compiled,
            compiling: 0,
            running_compiles,
            arrived: Vec::new(),
            in_flight: 0,
            finish_compiles: blocking,
            adapter_name,
            block_formats,
            is_software,
            is_host_device,
            compile_operations,
        }
    }

    /// Returns the number of the device, which is never used again; draw slots of pages are kept under it.
    pub(in crate::viewer) fn number(&self) -> u32 {
        self.id
    }

    /// Returns the numbers of its contexts, in the order drawn.
    pub(super) fn context_ids(&self) -> impl Iterator<Item = u32> {
        self.contexts.iter().map(|context| context.id)
    }

    /// Its contexts, each with the screen of its window, the position there, and its number.
    pub(super) fn places(&self) -> impl Iterator<Item = (u32, [i32; 2], u32)> {
        self.contexts.iter().map(|context| (context.place.0, context.place.1, context.id))
    }

    /// Draws a context after the others. No frame may be in flight.
    pub(in crate::viewer) fn draw_last(&mut self, context: u32) {
        if let Some(at) = self.contexts.iter().position(|c| c.id == context) {
            let last = self.contexts.remove(at);
            self.contexts.push(last);
        }
    }

    /// Returns the size of a context's target after all commands; `None` when the context is another device's.
    pub(super) fn size_px(&self, context: u32) -> Option<[u32; 2]> {
        self.contexts.iter().find(|c| c.id == context).map(|c| c.size_px)
    }

    /// Adds a context while no thread runs; `add` adds its target to the device.
    pub(super) fn add_context(
        &mut self,
        id: u32,
        traits: &ContextTraits,
        frame: u32,
        add: impl FnOnce(&mut GraphicsContext, &ContextTraits) -> Result<(), GpuError>,
    ) -> Result<(), ViewerError> {
        let side = self.here().ok_or(ViewerError::DrawThreadStopped)?;
        add(&mut side.context, traits)?;
        side.push_context(id);
        let operations = side.drawn_mut(id).map(|context| context.operations.clone()).unwrap_or_default();
        let (place, size_px) = ((traits.screen, traits.position_px), traits.size_px);
        self.contexts.push(ContextOnDevice { id, place, size_px, done_frame: frame, operations });
        Ok(())
    }

    /// Returns the application's operations on a context; `None` when the context is another device's.
    pub(super) fn context_operations(&self, context: u32) -> Option<&Arc<OperationQueue<GraphicsContext>>> {
        self.contexts.iter().find(|c| c.id == context).map(|c| &c.operations)
    }

    /// Returns the application's operations on the compile thread.
    pub(super) fn compile_operations(&self) -> &Arc<OperationQueue<wgpu::Device>> {
        &self.compile_operations
    }

    /// Returns true while operations of the application wait.
    pub(super) fn has_operations(&self) -> bool {
        !self.compile_operations.is_empty() || self.contexts.iter().any(|context| !context.operations.is_empty())
    }

    /// Closes a context while no thread runs, also on a lost device. Returns false when it is the last one.
    pub(super) fn remove_context(&mut self, id: u32) -> bool {
        if self.contexts.len() <= 1 {
            return false;
        }
        if let Some(side) = self.here() {
            side.remove_context(id);
        }
        self.contexts.retain(|context| context.id != id);
        true
    }

    /// Returns true when all its contexts have drawn a frame.
    pub(super) fn is_done(&self, frame: u32) -> bool {
        self.contexts.iter().all(|context| context.done_frame >= frame)
    }

    /// Returns the name of the adapter.
    pub(super) fn adapter_name(&self) -> &str {
        &self.adapter_name
    }

    /// Returns the families of compressed texture formats that the device samples.
    pub(super) fn block_formats(&self) -> BlockFormats {
        self.block_formats
    }

    /// Returns true if the adapter is a software driver.
    pub(super) fn is_software(&self) -> bool {
        self.is_software
    }

    /// Returns true if the application made the device and uses it too.
    pub(super) fn is_host_device(&self) -> bool {
        self.is_host_device
    }

    /// Returns the number of frames in flight.
    pub(in crate::viewer) fn in_flight(&self) -> usize {
        self.in_flight.div_ceil(self.contexts.len().max(1))
    }

    /// Returns the draw side while the main thread owns it; `None` while a draw thread does.
    pub(super) fn here(&mut self) -> Option<&mut DrawSide> {
        match &mut self.side {
            Side::Here(side) => Some(side),
            _ => None,
        }
    }

    /// Starts the draw thread with the operations of its loop.
    pub(super) fn start(&mut self, operations: Vec<Arc<dyn Operation<DrawSide>>>) -> Result<(), ViewerError> {
        match std::mem::replace(&mut self.side, Side::Lost) {
            Side::Here(side) => {
                self.stopping.store(false, Ordering::Release);
                let thread = OperationThread::start(&format!("draw {}", self.id), *side, operations);
                self.side = Side::Thread(thread.map_err(ViewerError::Thread)?);
                Ok(())
            }
            Side::Thread(thread) => {
                self.side = Side::Thread(thread);
                Ok(())
            }
            Side::Lost => Err(ViewerError::DrawThreadStopped),
        }
    }

    /// Makes the thread end before its next operation.
    pub(super) fn end(&self) {
        if let Side::Thread(thread) = &self.side {
            thread.end();
        }
    }

    /// Ends and wakes the thread, without waiting for it.
    pub(super) fn cancel(&self) {
        if let Side::Thread(thread) = &self.side {
            self.stopping.store(true, Ordering::Release);
            thread.cancel();
            // With a full queue the thread is awake and checks the flag.
            let _ = self.commands.try_send(DrawCommand::Wake);
        }
    }

    /// Joins the thread, takes the device back and executes the commands that were left.
    pub(super) fn stop(&mut self) {
        self.cancel();
        self.side = match std::mem::replace(&mut self.side, Side::Lost) {
            Side::Thread(thread) => match thread.join() {
                Ok(mut side) => {
                    side.catch_up();
                    // Frames that the thread did not draw are never answered.
                    self.in_flight = self.in_flight.min(self.replies.len());
                    Side::Here(Box::new(side))
                }
                Err(panicked) => {
                    log::error!("{panicked}");
                    Side::Lost
                }
            },
            other => other,
        };
    }

    /// Sends the job of one context. A device that the main thread owns draws once it has the jobs of all contexts.
    pub(in crate::viewer) fn frame(&mut self, job: FrameJob) -> Result<(), ViewerError> {
        self.send(DrawCommand::Frame(Box::new(job)))?;
        self.in_flight += 1;
        Ok(())
    }

    /// Draws a frame of a single context, with no other frame in flight.
    pub(in crate::viewer) fn draw_alone(&mut self, job: FrameJob) -> Result<Box<FrameDone>, ViewerError> {
        debug_assert_eq!(self.in_flight, 0, "frames in flight would answer first");
        self.frame(job)?;
        if let Some(side) = self.here() {
            side.render();
            side.swap();
        }
        self.wait_done()?.ok_or(ViewerError::DrawThreadStopped)
    }

    fn take_reply(&mut self, reply: Reply) -> Option<Box<FrameDone>> {
        match reply {
            Reply::Frame(done) => {
                self.in_flight = self.in_flight.saturating_sub(1);
                if let Some(context) = self.contexts.iter_mut().find(|c| c.id == done.context) {
                    context.done_frame = context.done_frame.max(done.frame);
                }
                Some(done)
            }
            // Requests for these replies are sent while no frame is in flight, and their senders wait for them.
            Reply::Image(_) | Reply::ColorView(_) | Reply::CompilesFinished { .. } => None,
        }
    }

    /// Takes the result of a frame if one has arrived.
    pub(in crate::viewer) fn try_done(&mut self) -> Option<Box<FrameDone>> {
        let reply = self.replies.try_recv().ok()?;
        self.take_reply(reply)
    }

    /// Waits for the result of the next frame for a limited time.
    pub(in crate::viewer) fn wait_done_for(
        &mut self,
        timeout: Duration,
    ) -> Result<Option<Box<FrameDone>>, ViewerError> {
        match self.replies.recv_timeout(timeout) {
            Ok(reply) => Ok(self.take_reply(reply)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(ViewerError::DrawThreadStopped),
        }
    }

    /// Waits for the result of the next frame; `None` when none is in flight.
    pub(in crate::viewer) fn wait_done(&mut self) -> Result<Option<Box<FrameDone>>, ViewerError> {
        if self.in_flight == 0 {
            return Ok(None);
        }
        match self.replies.recv() {
            Ok(reply) => Ok(self.take_reply(reply)),
            Err(_) => Err(ViewerError::DrawThreadStopped),
        }
    }

    /// Uploads a page of the application. `owner` stands for its scene, `number` for the page.
    pub(super) fn compile_own(&mut self, owner: u16, number: u32, drawables: Vec<Drawable>) -> Result<(), ViewerError> {
        let ticket = UploadOwner::Pages(owner).mark(u64::from(number));
        self.compiling += 1;
        self.send(DrawCommand::Compile(CompileOperation { ticket, drawables }))
    }

    /// Creates the pipelines for kinds of drawables before the frames that draw them.
    pub(in crate::viewer) fn prewarm(&mut self, kinds: &Arc<[DrawKind]>) {
        if !kinds.is_empty() {
            self.tell(DrawCommand::Prewarm(kinds.clone()));
        }
    }

    /// Creates the pipelines for kinds of drawables at once.
    pub(in crate::viewer) fn prewarm_now(&mut self, kinds: &Arc<[DrawKind]>) {
        self.tell(DrawCommand::PrewarmNow(kinds.clone()));
    }

    /// Creates the pipelines for a change of views, after the frames that were sent before.
    pub(in crate::viewer) fn prewarm_change(&mut self, change: &ViewChange) {
        self.tell(DrawCommand::PrewarmChange(Box::new(*change)));
    }

    /// Uploads drawables for a pager.
    pub(super) fn compile(&mut self, owner: u16, operation: CompileOperation) {
        let ticket = UploadOwner::Pager(owner).mark(operation.ticket);
        self.compiling += 1;
        self.tell(DrawCommand::Compile(CompileOperation { ticket, ..operation }));
    }

    /// Cancels uploads of a pager that have not begun. They are answered all the same.
    pub(super) fn cancel_compiles(&mut self, owner: u16, tickets: &[u64]) {
        let tickets = tickets.iter().map(|ticket| UploadOwner::Pager(owner).mark(*ticket)).collect();
        self.tell(DrawCommand::CancelCompiles(tickets));
    }

    /// Uploads between two frames. A draw thread first draws the frames that were sent before.
    pub(super) fn run_compiles(&mut self, budget: &CompileBudget) {
        if self.compiling > 0 && !self.running_compiles.swap(true, Ordering::AcqRel) {
            let budget = CompileBudget { time: budget.time.min(MAX_UPLOAD_SLICE), ..*budget };
            self.tell(DrawCommand::RunCompiles(budget));
        }
    }

    /// Waits for all uploads, unless a frame is in flight or the device is lost.
    pub(super) fn end_compiles(&mut self, waits_for_memory: bool) {
        self.is_stuck = false;
        // Answers arrive in order, so frames in flight would be answered first; the blocking mode has none.
        let finish = DrawCommand::FinishCompiles { waits_for_memory };
        if self.compiling > 0 && self.in_flight == 0 && self.send(finish).is_ok() {
            match self.replies.recv() {
                Ok(reply) => self.is_stuck = matches!(reply, Reply::CompilesFinished { all: false }),
                Err(_) => self.is_dead = true,
            }
        }
    }

    /// Takes the finished uploads of an owner, with its own tickets.
    pub(super) fn take_compiled(&mut self, owner: UploadOwner) -> Vec<Compiled> {
        if self.finish_compiles {
            self.end_compiles(false);
        }
        let before = self.arrived.len();
        self.arrived.extend(self.compiled.try_iter());
        self.compiling = self.compiling.saturating_sub(self.arrived.len() - before);
        let of_owner = self.arrived.extract_if(.., |compiled| owner.owns(compiled.ticket));
        of_owner.map(|c| Compiled { ticket: UploadOwner::ticket(c.ticket), ..c }).collect()
    }

    /// Frees slots after the last frame that draws them.
    pub(super) fn release(&mut self, slots: Vec<DrawSlot>) {
        if !slots.is_empty() {
            self.tell(DrawCommand::Release(slots));
        }
    }

    /// Keeps slots that are released for some frames.
    pub(in crate::viewer) fn retain_released(&mut self, frames: u32) {
        self.tell(DrawCommand::RetainReleased { frames });
    }

    /// Frees all released slots at once.
    pub(in crate::viewer) fn flush_released(&mut self) {
        self.tell(DrawCommand::FlushReleased);
    }

    /// Replaces the mesh of a drawable from the next frame on.
    pub(in crate::viewer) fn rewrite(&mut self, slot: DrawSlot, mesh: Arc<Mesh>) -> Result<(), ViewerError> {
        self.send(DrawCommand::Rewrite { slot, mesh })
    }

    /// Shows an image in a texture from the next frame on.
    pub(in crate::viewer) fn show(&mut self, change: ImageChange) -> Result<(), ViewerError> {
        self.send(DrawCommand::Show(change))
    }

    /// Resizes the target of a context.
    pub(in crate::viewer) fn resize(&mut self, context: u32, size_px: [u32; 2]) -> Result<(), ViewerError> {
        if let Some(of) = self.contexts.iter_mut().find(|c| c.id == context) {
            of.size_px = size_px;
        }
        self.send(DrawCommand::Resize { context, size_px })
    }

    /// Sets whether a context waits for the vertical blank.
    pub(in crate::viewer) fn set_vsync(&mut self, context: u32, vsync: bool) -> Result<(), ViewerError> {
        self.send(DrawCommand::SetVsync { context, vsync })
    }

    /// Loses the device as if the driver had lost it.
    #[cfg(feature = "testing")]
    pub(in crate::viewer) fn lose_device(&mut self) -> Result<(), ViewerError> {
        self.send(DrawCommand::LoseDevice)
    }

    /// Sets the next answers of a window's surface.
    #[cfg(feature = "testing")]
    pub(in crate::viewer) fn pretend_surface(
        &mut self,
        context: u32,
        answers: &[crate::gpu::SurfaceAnswer],
    ) -> Result<(), ViewerError> {
        self.send(DrawCommand::PretendSurface { context, answers: answers.to_vec() })
    }

    /// Waits for all frames in flight, drawn or lost. Gives up after a timeout, since a frame whose thread died is never
    /// answered.
    pub(super) fn end_frames(&mut self) -> Result<Vec<FrameDone>, ViewerError> {
        let mut done = Vec::new();
        while self.in_flight > 0
            && let Some(frame) = self.wait_done_for(FRAME_TIMEOUT)?
        {
            done.push(*frame);
        }
        self.in_flight = 0;
        Ok(done)
    }

    /// Replaces the device if it is lost, with no thread and no frame in flight. Returns false if it is not lost.
    pub(super) fn renew(&mut self) -> Result<bool, ViewerError> {
        let side = self.here().ok_or(ViewerError::DrawThreadStopped)?;
        let renewed = side.renew()?;
        self.block_formats = side.context.block_formats();
        if renewed {
            // Uploads to the old device are void.
            while self.compiled.try_recv().is_ok() {}
            self.arrived.clear();
            self.compiling = 0;
        }
        Ok(renewed)
    }

    /// Reads back the last frame of a context; no frame may be in flight.
    pub(in crate::viewer) fn read_back(&mut self, context: u32) -> Result<RgbaImage, ViewerError> {
        debug_assert_eq!(self.in_flight, 0, "frames in flight would answer first");
        self.send(DrawCommand::ReadBack { context })?;
        match self.replies.recv() {
            Ok(Reply::Image(image)) => Ok(image?),
            _ => Err(ViewerError::DrawThreadStopped),
        }
    }

    /// Returns a view of the texture that an offscreen context draws into; no frame may be in flight. `None` for a window.
    pub(in crate::viewer) fn color_view(&mut self, context: u32) -> Result<Option<wgpu::TextureView>, ViewerError> {
        debug_assert_eq!(self.in_flight, 0, "frames in flight would answer first");
        self.send(DrawCommand::ColorView { context })?;
        match self.replies.recv() {
            Ok(Reply::ColorView(view)) => Ok(view),
            _ => Err(ViewerError::DrawThreadStopped),
        }
    }

    /// Sends a command whose failure the next frame reports: then the draw thread has ended.
    fn tell(&mut self, command: DrawCommand) {
        let _ = self.send(command);
    }

    fn send(&mut self, command: DrawCommand) -> Result<(), ViewerError> {
        let sent = match &mut self.side {
            Side::Here(side) => {
                side.execute(command);
                Ok(())
            }
            Side::Thread(_) => self.commands.send(command).map_err(|_| ViewerError::DrawThreadStopped),
            Side::Lost => Err(ViewerError::DrawThreadStopped),
        };
        self.is_dead |= sent.is_err();
        sent
    }
}

/// A device as one pager sees it.
pub(super) struct DeviceOfScene<'a> {
    pub(super) handle: &'a mut DeviceHandle,
    /// The owner number of the pager.
    pub(super) owner: u16,
}

impl CompileContext for DeviceOfScene<'_> {
    fn id(&self) -> u32 {
        self.handle.id
    }

    fn block_formats(&self) -> BlockFormats {
        self.handle.block_formats
    }

    fn prewarm(&mut self, kinds: &Arc<[DrawKind]>) {
        self.handle.prewarm(kinds);
    }

    fn set_max_bytes(&mut self, max_bytes: u64) {
        self.handle.tell(DrawCommand::SetMaxBytes { owner: self.owner, max_bytes });
    }

    fn compile(&mut self, operation: CompileOperation) {
        self.handle.compile(self.owner, operation);
    }

    fn cancel(&mut self, tickets: &[u64]) {
        self.handle.cancel_compiles(self.owner, tickets);
    }

    fn run_compiles(&mut self, budget: &CompileBudget) {
        self.handle.run_compiles(budget);
    }

    fn take_compiled(&mut self) -> Vec<Compiled> {
        self.handle.take_compiled(UploadOwner::Pager(self.owner))
    }

    fn release(&mut self, slots: Vec<DrawSlot>) {
        self.handle.release(slots);
    }

    fn is_alive(&self) -> bool {
        !self.handle.is_dead && !self.handle.is_stuck
    }
}
