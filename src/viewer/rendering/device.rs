//! [`DeviceHandle`]: the main thread's end of a device and its contexts, whatever thread owns them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use image::RgbaImage;

use super::draw_side::{DrawCommand, DrawSide, DrawSideEnds, FrameDone, FrameJob, Reply};
use crate::gpu::{CompileBudget, CompileOperation, Compiled, ContextTraits, GpuError, GraphicsContext, SurfaceAnswer};
use crate::pager::{CompileContext, ImageChange};
use crate::scene::{DrawKind, DrawSlot, Drawable, Mesh};
use crate::sync::primitives::channel::{self, Receiver, RecvTimeoutError, Sender};
use crate::sync::{Operation, OperationThread};
use crate::viewer::ViewerError;

/// Commands that may wait before the sender does; many small uploads fit between two frames.
const COMMAND_QUEUE: usize = 1024;

/// Most time for uploads between two frames at once, so that a frame sent after them does not wait longer.
const MOST_COMPILING: Duration = Duration::from_millis(2);

/// A frame that takes longer does not come.
const MOST_WAIT: Duration = Duration::from_secs(5);

/// Set in the tickets of pages that the application made; the rest are the pagers'.
const OWN_TICKET: u64 = 1 << 63;

/// Where in a ticket its scene is told; what the pager chose lies below.
const OWNER_SHIFT: u32 = 48;
const TICKET_MASK: u64 = (1 << OWNER_SHIFT) - 1;

/// What tells the uploads of a scene from others.
fn owner_bits(owner: u16, is_own: bool) -> u64 {
    (u64::from(owner & 0x7fff) << OWNER_SHIFT) | if is_own { OWN_TICKET } else { 0 }
}

/// Who owns the device now.
enum Side {
    /// The main thread.
    Here(Box<DrawSide>),
    /// A thread of its own.
    Thread(OperationThread<DrawSide>),
    /// Nobody any more: its thread panicked, or could not be started.
    Lost,
}

/// A context, as the main thread knows it.
struct ContextOnDevice {
    id: u32,
    size_px: [u32; 2],
    /// Last frame that came back.
    done_frame: u32,
}

/// Sends commands, takes answers, and is what the pager compiles through.
pub(in crate::viewer) struct DeviceHandle {
    /// Of its first context, even once that was closed.
    id: u32,
    /// In the order opened.
    contexts: Vec<ContextOnDevice>,
    side: Side,
    /// It has failed to take a command, or to answer.
    is_dead: bool,
    /// It could not upload what it was to finish.
    is_stuck: bool,
    commands: Sender<DrawCommand>,
    replies: Receiver<Reply>,
    /// Read by the context's thread where it waits for a frame.
    stopping: Arc<AtomicBool>,
    compiled: Receiver<Compiled>,
    /// Operations sent whose answers were not taken.
    compiling: usize,
    /// An upload between frames was sent and has not been done.
    running_compiles: Arc<AtomicBool>,
    /// Compiled and not asked for yet by those whose they are.
    arrived: Vec<Compiled>,
    /// Pictures sent for and not yet back: one for each context of a frame.
    in_flight: usize,
    /// Wait for every upload when the pager asks what is compiled: the blocking mode.
    finish_compiles: bool,
    adapter_name: String,
}

impl DeviceHandle {
    /// Takes a device with one context of a number; it is the main thread's until threads are started.
    pub(super) fn new(id: u32, context: GraphicsContext, blocking: bool, frame: u32) -> Self {
        let contexts = vec![ContextOnDevice { id, size_px: context.size_px(), done_frame: frame }];
        let adapter_name = context.adapter_name();
        let (commands, to_do) = channel::bounded(COMMAND_QUEUE);
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
        Self {
            id,
            contexts,
            side: Side::Here(Box::new(DrawSide::new(context, id, ends))),
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
        }
    }

    /// Never the same again; what uploads are known by.
    pub(in crate::viewer) fn number(&self) -> u32 {
        self.id
    }

    /// Numbers of its contexts, in the order opened.
    pub(super) fn context_ids(&self) -> impl Iterator<Item = u32> {
        self.contexts.iter().map(|context| context.id)
    }

    /// Size of a context's target, or what it will be; `None` where it is another device's.
    pub(super) fn size_px(&self, context: u32) -> Option<[u32; 2]> {
        self.contexts.iter().find(|c| c.id == context).map(|c| c.size_px)
    }

    /// Takes a context on the device, with no thread; `add` gives the device its target.
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
        self.contexts.push(ContextOnDevice { id, size_px: traits.size_px, done_frame: frame });
        Ok(())
    }

    /// Closes a context with no thread, on a device that has died too; true where others are left.
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

    /// All of its contexts have drawn a frame.
    pub(super) fn is_done(&self, frame: u32) -> bool {
        self.contexts.iter().all(|context| context.done_frame >= frame)
    }

    /// Name of the adapter that draws.
    pub(super) fn adapter_name(&self) -> &str {
        &self.adapter_name
    }

    /// Frames sent and not yet back.
    pub(in crate::viewer) fn in_flight(&self) -> usize {
        self.in_flight.div_ceil(self.contexts.len().max(1))
    }

    /// What the main thread owns; `None` while a thread does.
    pub(super) fn here(&mut self) -> Option<&mut DrawSide> {
        match &mut self.side {
            Side::Here(side) => Some(side),
            _ => None,
        }
    }

    /// Gives the context to a thread with operations to do again and again.
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

    /// The thread takes no further operation.
    pub(super) fn end(&self) {
        if let Side::Thread(thread) = &self.side {
            thread.end();
        }
    }

    /// Tells the thread to end; does not wait.
    pub(super) fn cancel(&self) {
        if let Side::Thread(thread) = &self.side {
            self.stopping.store(true, Ordering::Release);
            thread.cancel();
            // With a full queue the thread is awake, and looks at the flag.
            let _ = self.commands.try_send(DrawCommand::Wake);
        }
    }

    /// Takes the context back from its thread, with what was left to do done.
    pub(super) fn stop(&mut self) {
        self.cancel();
        self.side = match std::mem::replace(&mut self.side, Side::Lost) {
            Side::Thread(thread) => match thread.join() {
                Ok(mut side) => {
                    side.catch_up();
                    // What its thread did not draw never comes back.
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

    /// Sends a frame's work in one of the contexts. Where the main thread owns the device, it draws once it has all.
    pub(in crate::viewer) fn frame(&mut self, job: FrameJob) -> Result<(), ViewerError> {
        self.send(DrawCommand::Frame(Box::new(job)))?;
        self.in_flight += 1;
        Ok(())
    }

    /// Draws one frame that is not one of all contexts, with no other on its way.
    pub(in crate::viewer) fn draw_alone(&mut self, job: FrameJob) -> Result<Box<FrameDone>, ViewerError> {
        debug_assert_eq!(self.in_flight, 0, "frames in flight would answer first");
        self.frame(job)?;
        if let Some(side) = self.here() {
            side.render();
            side.swap();
        }
        self.wait_done()?.ok_or(ViewerError::DrawThreadStopped)
    }

    fn came(&mut self, reply: Reply) -> Option<Box<FrameDone>> {
        match reply {
            Reply::Frame(done) => {
                self.in_flight = self.in_flight.saturating_sub(1);
                if let Some(context) = self.contexts.iter_mut().find(|c| c.id == done.context) {
                    context.done_frame = context.done_frame.max(done.frame);
                }
                Some(done)
            }
            // Images and finished compiles are taken by those who asked, once no frame is in flight before them.
            Reply::Image(_) | Reply::CompilesFinished { .. } => None,
        }
    }

    /// A frame that came back, if one has.
    pub(in crate::viewer) fn try_done(&mut self) -> Option<Box<FrameDone>> {
        let reply = self.replies.try_recv().ok()?;
        self.came(reply)
    }

    /// Waits a while for the next frame to come back.
    pub(in crate::viewer) fn wait_done_for(
        &mut self,
        patience: Duration,
    ) -> Result<Option<Box<FrameDone>>, ViewerError> {
        match self.replies.recv_timeout(patience) {
            Ok(reply) => Ok(self.came(reply)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(ViewerError::DrawThreadStopped),
        }
    }

    /// Waits for the next frame to come back; `None` when none is on its way.
    pub(in crate::viewer) fn wait_done(&mut self) -> Result<Option<Box<FrameDone>>, ViewerError> {
        if self.in_flight == 0 {
            return Ok(None);
        }
        match self.replies.recv() {
            Ok(reply) => Ok(self.came(reply)),
            Err(_) => Err(ViewerError::DrawThreadStopped),
        }
    }

    /// Uploads what the application made itself, under a number of its scene's.
    pub(super) fn compile_own(&mut self, owner: u16, number: u32, drawables: Vec<Drawable>) -> Result<(), ViewerError> {
        let ticket = owner_bits(owner, true) | u64::from(number);
        self.compiling += 1;
        self.send(DrawCommand::Compile(CompileOperation { ticket, drawables }))
    }

    /// Makes what drawables that come need to be drawn, before the frames that draw them.
    pub(in crate::viewer) fn prewarm(&mut self, kinds: &Arc<[DrawKind]>) {
        if !kinds.is_empty() {
            // A draw thread that has ended shows at the next frame.
            let _ = self.send(DrawCommand::Prewarm(kinds.clone()));
        }
    }

    /// Uploads what a scene's pager asks for.
    pub(super) fn compile(&mut self, owner: u16, operation: CompileOperation) {
        let ticket = owner_bits(owner, false) | (operation.ticket & TICKET_MASK);
        self.compiling += 1;
        // A draw thread that has ended shows at the next frame.
        let _ = self.send(DrawCommand::Compile(CompileOperation { ticket, ..operation }));
    }

    /// Ends what a scene's pager does not want any more and is not begun; it is answered all the same.
    pub(super) fn cancel_compiles(&mut self, owner: u16, tickets: &[u64]) {
        let bits = owner_bits(owner, false);
        let tickets = tickets.iter().map(|ticket| bits | (ticket & TICKET_MASK)).collect();
        // A draw thread that has ended shows at the next frame.
        let _ = self.send(DrawCommand::CancelCompiles(tickets));
    }

    /// Uploads between two frames. On a draw thread this waits behind the frames sent before.
    pub(super) fn run_compiles(&mut self, budget: &CompileBudget) {
        if self.compiling > 0 && !self.running_compiles.swap(true, Ordering::AcqRel) {
            let budget = CompileBudget { time: budget.time.min(MOST_COMPILING), ..*budget };
            // A draw thread that has ended shows at the next frame.
            let _ = self.send(DrawCommand::RunCompiles(budget));
        }
    }

    /// Waits until all that was sent to be uploaded is, unless a frame is in flight, or the device is lost.
    pub(super) fn end_compiles(&mut self, waits_for_memory: bool) {
        self.is_stuck = false;
        // Answers come in order, so frames in flight would have to be taken first; the blocking mode has none.
        let finish = DrawCommand::FinishCompiles { waits_for_memory };
        if self.compiling > 0 && self.in_flight == 0 && self.send(finish).is_ok() {
            match self.replies.recv() {
                Ok(reply) => self.is_stuck = matches!(reply, Reply::CompilesFinished { all: false }),
                Err(_) => self.is_dead = true,
            }
        }
    }

    /// What was uploaded for a scene: for its own pages, with their numbers, or for its pager.
    pub(super) fn take_compiled(&mut self, owner: u16, is_own: bool) -> Vec<Compiled> {
        if self.finish_compiles {
            self.end_compiles(false);
        }
        let before = self.arrived.len();
        self.arrived.extend(self.compiled.try_iter());
        self.compiling = self.compiling.saturating_sub(self.arrived.len() - before);
        let bits = owner_bits(owner, is_own);
        let of_owner = self.arrived.extract_if(.., |c| c.ticket & !TICKET_MASK == bits);
        of_owner.map(|c| Compiled { ticket: c.ticket & TICKET_MASK, ..c }).collect()
    }

    /// Frees slots after the last frame that draws them.
    pub(super) fn release(&mut self, slots: Vec<DrawSlot>) {
        if !slots.is_empty() {
            // As above.
            let _ = self.send(DrawCommand::Release(slots));
        }
    }

    /// Puts another mesh in the place of a drawable's, from the next frame on.
    pub(in crate::viewer) fn rewrite(&mut self, slot: DrawSlot, mesh: Arc<Mesh>) -> Result<(), ViewerError> {
        self.send(DrawCommand::Rewrite { slot, mesh })
    }

    /// Another image for a texture, from the next frame on.
    pub(in crate::viewer) fn show(&mut self, change: ImageChange) -> Result<(), ViewerError> {
        self.send(DrawCommand::Show(change))
    }

    /// The target of a context has a new size.
    pub(in crate::viewer) fn resize(&mut self, context: u32, size_px: [u32; 2]) -> Result<(), ViewerError> {
        if let Some(of) = self.contexts.iter_mut().find(|c| c.id == context) {
            of.size_px = size_px;
        }
        self.send(DrawCommand::Resize { context, size_px })
    }

    /// Frames of a context wait for the screen, or not.
    pub(in crate::viewer) fn set_vsync(&mut self, context: u32, vsync: bool) -> Result<(), ViewerError> {
        self.send(DrawCommand::SetVsync { context, vsync })
    }

    /// The device goes.
    pub(in crate::viewer) fn lose_device(&mut self) -> Result<(), ViewerError> {
        self.send(DrawCommand::LoseDevice)
    }

    /// What a window's surface answers next.
    pub(in crate::viewer) fn pretend_surface(
        &mut self,
        context: u32,
        answers: &[SurfaceAnswer],
    ) -> Result<(), ViewerError> {
        self.send(DrawCommand::PretendSurface { context, answers: answers.to_vec() })
    }

    /// Waits for the frames under way, whatever became of them. One whose threads have ended never comes.
    pub(super) fn end_frames(&mut self) -> Result<Vec<FrameDone>, ViewerError> {
        let mut done = Vec::new();
        while self.in_flight > 0
            && let Some(frame) = self.wait_done_for(MOST_WAIT)?
        {
            done.push(*frame);
        }
        self.in_flight = 0;
        Ok(done)
    }

    /// Takes a new device where the old one is lost, with no thread and no frame under way; false where it is not.
    pub(super) fn renew(&mut self) -> Result<bool, ViewerError> {
        let renewed = self.here().ok_or(ViewerError::DrawThreadStopped)?.renew()?;
        if renewed {
            // What was uploaded to the old one is of no use.
            while self.compiled.try_recv().is_ok() {}
            self.arrived.clear();
            self.compiling = 0;
        }
        Ok(renewed)
    }

    /// The picture of a context's last frame; the caller has taken all frames in flight before.
    pub(in crate::viewer) fn read_back(&mut self, context: u32) -> Result<RgbaImage, ViewerError> {
        debug_assert_eq!(self.in_flight, 0, "frames in flight would answer first");
        self.send(DrawCommand::ReadBack { context })?;
        match self.replies.recv() {
            Ok(Reply::Image(image)) => Ok(image?),
            _ => Err(ViewerError::DrawThreadStopped),
        }
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

/// A device as the pager of one scene sees it.
pub(super) struct DeviceOfScene<'a> {
    pub(super) handle: &'a mut DeviceHandle,
    /// Tells the scene's uploads from others.
    pub(super) owner: u16,
}

impl CompileContext for DeviceOfScene<'_> {
    fn id(&self) -> u32 {
        self.handle.id
    }

    fn prewarm(&mut self, kinds: &Arc<[DrawKind]>) {
        self.handle.prewarm(kinds);
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
        self.handle.take_compiled(self.owner, false)
    }

    fn release(&mut self, slots: Vec<DrawSlot>) {
        self.handle.release(slots);
    }

    fn is_alive(&self) -> bool {
        !self.handle.is_dead && !self.handle.is_stuck
    }
}
