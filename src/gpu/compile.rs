//! Uploads in small steps: what the pager loaded becomes drawable without a frame taking longer for it.
//!
//! Runs on the draw thread, between draws. An operation's drawables get their places one after the other, and
//! each place is filled slice by slice; the queue stops when the frame's budget is spent and goes on from there
//! in the next frame. Where the context has a compile thread that fills the places, and what it has recorded goes to the
//! adapter before the next frame (`compile_thread.rs`).

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::DrawableEntry;
use super::budget::CompileBudget;
use super::compile_thread::CompileThread;
use super::custom::{CompileInfo, CustomCompile};
use super::drawable::{DrawableTable, Pools, Shape};
use super::memory::Memory;
use super::mesh_pool::MeshUploads;
use super::packing::VertexFormat;
use super::staging::{Filling, Stagings};
use super::uploads::{QueueSink, Source, Upload};
use crate::scene::{ContentKey, CustomGeometry, DrawSlot, Drawable, Geometry, HeightTile, Mesh, SharedParts};

/// Most bytes of one slice: about 100 us of copying, so that the time budget is met closely.
const SLICE_BYTES: u64 = 256 << 10;
/// What the first slice of a call may have however small the budget, so that every upload ends.
const LEAST_SLICE_BYTES: u64 = 16 << 10;
/// Uploads are handed to the driver at the latest when so many bytes wait: while frames are drawn, whose submissions
/// take them along and which a submission in between may wait for; and while none are.
const FLUSH_BYTES_DRAWING: u64 = 4 << 20;
const FLUSH_BYTES: u64 = 256 << 10;
/// Bytes that the compile thread may have before it; further operations wait for their places.
const MOST_IN_FLIGHT: u64 = 32 << 20;
/// Batches of the compile thread that may wait for the next frame's submission; it has some more to fill.
const MOST_UNSUBMITTED: usize = 4;
/// A budget of so much time is one without end.
const ENDLESS: Duration = Duration::from_secs(60);
/// How long such a call waits for the thread at once.
const POLL: Duration = Duration::from_millis(1);

/// Drawables to upload together, usually one page's.
#[derive(Debug)]
pub struct CompileOperation {
    /// Chosen by the caller; comes back in [`Compiled`].
    pub ticket: u64,
    /// What to upload; dropped when done.
    pub drawables: Vec<Drawable>,
}

/// What a finished [`CompileOperation`] gave.
#[derive(Debug)]
pub struct Compiled {
    /// The operation's ticket.
    pub ticket: u64,
    /// One slot a drawable, in order; [`DrawSlot::NONE`] for those that could not be made. None at all where the operation
    /// was cancelled.
    pub slots: Vec<DrawSlot>,
    /// Bytes of GPU memory that were newly taken by what is not shared by content.
    pub bytes: u64,
    /// What is shared by content, with the bytes of its place, whoever took it first.
    pub shared: Vec<(ContentKey, u64)>,
    /// What was wrong with those that could not be made.
    pub errors: Vec<String>,
}

impl Compiled {
    /// Of an operation of which nothing is made yet, with room for so many slots.
    fn nothing(ticket: u64, drawables: usize) -> Self {
        Self { ticket, slots: Vec::with_capacity(drawables), bytes: 0, shared: Vec::new(), errors: Vec::new() }
    }

    fn count(&mut self, content: Option<&ContentKey>, bytes: u64, is_new: bool) {
        match content {
            Some(key) => self.shared.push((*key, bytes)),
            None => self.bytes += if is_new { bytes } else { 0 },
        }
    }
}

/// What one call of `run_compiles` did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CompileStats {
    /// Bytes uploaded.
    pub bytes: u64,
    /// Slices uploaded.
    pub slices: u32,
    /// Operations finished.
    pub finished: u32,
    /// Operations still waiting or under way.
    pub pending: usize,
    /// Time taken.
    pub time: Duration,
}

struct Job {
    drawables: std::vec::IntoIter<Drawable>,
    compiled: Compiled,
}

/// Operations in the order they came, the first of them under way.
#[derive(Default)]
pub(super) struct CompileQueue {
    waiting: VecDeque<CompileOperation>,
    job: Option<Job>,
    uploads: VecDeque<Upload>,
    finished: Vec<Compiled>,
    /// Carries uploads where the context has one.
    thread: Option<CompileThread>,
    /// What carries them where it has none, and what of that is being filled.
    stagings: Stagings,
    filling: Option<Filling>,
    /// Recorded and not submitted, and the staging buffers that they copy from.
    commands: Vec<wgpu::CommandBuffer>,
    recorded: Vec<wgpu::Buffer>,
    /// Staging buffers whose commands were submitted.
    submitted: Vec<wgpu::Buffer>,
    unflushed_bytes: u64,
    /// Why uploads wait, and whether that was said: once, until they go on.
    refusal: Option<String>,
    is_refused: bool,
    /// For bytes that are made on their way.
    scratch: Vec<u8>,
    /// A frame was drawn since uploads were last flushed on their own.
    drawing: bool,
}

/// How many units of a slice fit; the first slice of a call has at least one.
fn fitting(left: usize, unit_bytes: usize, most_bytes: u64, is_first: bool) -> usize {
    let most_bytes = if is_first { most_bytes.max(LEAST_SLICE_BYTES) } else { most_bytes };
    let fit = (most_bytes.min(SLICE_BYTES) / unit_bytes.max(1) as u64) as usize;
    // A unit larger than a slice (a row of a huge image) goes alone.
    let fit = if fit == 0 && (is_first || unit_bytes as u64 <= most_bytes) { 1 } else { fit };
    fit.min(left)
}

impl CompileQueue {
    pub(super) fn push(&mut self, operation: CompileOperation) {
        self.waiting.push_back(operation);
    }

    /// Ends operations that have not begun: nothing is made of them, and they are told to have finished.
    pub(super) fn cancel(&mut self, tickets: &[u64]) {
        let Self { waiting, finished, .. } = self;
        waiting.retain(|operation| {
            let is_cancelled = tickets.contains(&operation.ticket);
            finished.extend(is_cancelled.then(|| Compiled::nothing(operation.ticket, 0)));
            !is_cancelled
        });
    }

    /// Everything written so far went to the driver with a draw.
    pub(super) fn flushed(&mut self) {
        self.unflushed_bytes = 0;
        self.drawing = true;
    }

    /// With a thread of its own to carry uploads.
    pub(super) fn threaded(memory: &Memory) -> std::io::Result<Self> {
        Ok(Self { thread: Some(CompileThread::start(memory)?), ..Self::default() })
    }

    /// False once its thread has stopped although nobody told it to.
    pub(super) fn is_alive(&self) -> bool {
        self.thread.as_ref().is_none_or(|thread| !thread.has_died)
    }

    /// Operations that are waiting or under way.
    pub(super) fn pending(&self) -> usize {
        let in_thread = self.thread.as_ref().map_or(0, |thread| thread.operations);
        self.waiting.len() + usize::from(self.job.is_some()) + in_thread
    }

    pub(super) fn take_finished(&mut self) -> Vec<Compiled> {
        std::mem::take(&mut self.finished)
    }

    /// Commands of uploads that go to the driver with the next submission, before all that reads them.
    pub(super) fn take_commands(&mut self, into: &mut Vec<wgpu::CommandBuffer>) {
        self.end_filling();
        into.append(&mut self.commands);
        self.submitted.append(&mut self.recorded);
    }

    pub(super) fn run(
        &mut self,
        memory: &Memory,
        queue: &wgpu::Queue,
        pools: &mut Pools,
        drawables: &mut DrawableTable,
        pipeline_cache: Option<&wgpu::PipelineCache>,
        budget: &CompileBudget,
    ) -> CompileStats {
        let start = Instant::now();
        let device = memory.device();
        // As it was made: another borrow than that of the pools.
        let frame_layout = pools.layouts.frame.clone();
        let info = CompileInfo { device, queue, frame_layout: &frame_layout, pipeline_cache };
        let mut stats = match self.thread.take() {
            Some(mut thread) => {
                let stats = self.run_threaded(&mut thread, &info, pools, drawables, budget);
                self.thread = Some(thread);
                stats
            }
            None => self.run_here(memory, &info, pools, drawables, budget),
        };
        self.unflushed_bytes += stats.bytes;
        let most = if self.drawing { FLUSH_BYTES_DRAWING } else { FLUSH_BYTES };
        if self.unflushed_bytes >= most {
            self.flush(device, queue);
        }
        stats.pending = self.pending();
        stats.time = start.elapsed();
        stats
    }

    /// Hands over what waits. Staging memory (several times the bytes for small images) is only given back once it was
    /// submitted and the device was polled.
    fn flush(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) {
        self.end_filling();
        queue.submit(self.commands.drain(..));
        self.submitted.append(&mut self.recorded);
        if let Err(error) = device.poll(wgpu::PollType::Poll) {
            log::error!("uploads: {error}");
        }
        self.unflushed_bytes = 0;
        self.drawing = false;
    }

    /// What comes by the queue itself runs before what is recorded and not submitted: that goes first.
    pub(super) fn flush_recorded(&mut self, device: &wgpu::Device, queue: &wgpu::Queue) {
        if self.filling.is_some() || !self.commands.is_empty() {
            self.flush(device, queue);
        }
    }

    fn end_filling(&mut self) {
        if let Some((commands, staging)) = self.filling.take().map(Filling::finish) {
            self.commands.push(commands);
            self.recorded.push(staging);
        }
    }

    /// Why uploads wait, when they begin to.
    pub(super) fn take_refusal(&mut self) -> Option<String> {
        self.refusal.take()
    }

    /// Uploads wait for memory.
    pub(super) fn is_refused(&self) -> bool {
        self.is_refused
    }

    fn refused(&mut self, error: String) {
        if !std::mem::replace(&mut self.is_refused, true) {
            self.refusal = Some(error);
        }
    }

    /// Writes the next units of the first upload, at most `count`: as many as the staging buffer has room for. `None`
    /// where there is no memory for a buffer: it is tried again in the next frame.
    fn write_staged(&mut self, memory: &Memory, info: &CompileInfo<'_>, count: usize) -> Option<u64> {
        let Self { uploads, filling, stagings, scratch, .. } = self;
        let Some((upload, (_, unit_bytes))) = uploads.front_mut().and_then(|u| u.left().map(|left| (u, left))) else {
            return Some(0);
        };
        let room = |filling: &Filling| filling.room(unit_bytes, upload.has_rows());
        // A part of an image begins in a new buffer where it fits no more: wgpu clears an image that is written in parts.
        if filling.as_ref().is_some_and(|filling| room(filling) < count) {
            self.end_filling();
            if !self.drawing {
                self.flush(info.device, info.queue);
                self.stagings.submitted(&mut self.submitted);
            }
            return Some(0);
        }
        if filling.is_none() {
            match stagings.fill(memory, unit_bytes) {
                Ok(made) => *filling = made,
                Err(error) => {
                    self.refused(error);
                    return None;
                }
            }
            self.is_refused = false;
        }
        Some(match filling {
            Some(filling) => {
                let count = count.min(room(filling));
                upload.write(filling, scratch, count)
            }
            None => upload.write(&mut QueueSink(info.queue), scratch, count),
        })
    }

    fn run_here(
        &mut self,
        memory: &Memory,
        info: &CompileInfo<'_>,
        pools: &mut Pools,
        drawables: &mut DrawableTable,
        budget: &CompileBudget,
    ) -> CompileStats {
        let start = Instant::now();
        let mut stats = CompileStats::default();
        self.stagings.submitted(&mut self.submitted);
        if self.pending() == 0 {
            self.stagings.trim();
        }
        loop {
            let left_bytes = budget.bytes.saturating_sub(stats.bytes);
            if stats.slices > 0 && (left_bytes == 0 || start.elapsed() >= budget.time) {
                break;
            }
            if let Some(upload) = self.uploads.front_mut() {
                let Some((units, unit_bytes)) = upload.left() else {
                    self.uploads.pop_front();
                    continue;
                };
                let count = fitting(units, unit_bytes, left_bytes, stats.slices == 0);
                if count == 0 {
                    break;
                }
                let Some(bytes) = self.write_staged(memory, info, count) else { break };
                stats.bytes += bytes;
                stats.slices += u32::from(bytes > 0);
                if self.uploads.front().is_some_and(|upload| upload.left().is_none()) {
                    self.uploads.pop_front();
                }
            } else if self.job.is_some() {
                match self.prepare_next(info, pools, drawables, &mut stats) {
                    None => {}
                    Some(compiled) => {
                        self.finished.push(compiled);
                        stats.finished += 1;
                    }
                }
            } else if !self.begin_next() {
                break;
            }
        }
        // A finished upload whose operation has nothing left is reported now, not a frame later.
        if self.uploads.is_empty() && self.job.as_ref().is_some_and(|j| j.drawables.len() == 0) {
            self.finished.extend(self.job.take().map(|j| j.compiled));
            stats.finished += 1;
        }
        stats
    }

    /// Gives places, and takes what the thread has recorded; both within the budget, and without waiting unless that is
    /// without end.
    fn run_threaded(
        &mut self,
        thread: &mut CompileThread,
        info: &CompileInfo<'_>,
        pools: &mut Pools,
        drawables: &mut DrawableTable,
        budget: &CompileBudget,
    ) -> CompileStats {
        let start = Instant::now();
        let (mut made, mut stats) = (CompileStats::default(), CompileStats::default());
        self.submitted.drain(..).for_each(|staging| thread.submitted(staging));
        thread.give_back();
        let is_over = || start.elapsed() >= budget.time;
        while thread.bytes_in_flight() < MOST_IN_FLIGHT && (self.job.is_some() || self.begin_next()) {
            let finished = self.prepare_next(info, pools, drawables, &mut made);
            self.uploads.drain(..).for_each(|upload| thread.upload(upload));
            finished.into_iter().for_each(|compiled| thread.finish(compiled));
            if is_over() {
                break;
            }
        }
        let waits = budget.time >= ENDLESS && thread.operations > 0;
        while stats.slices == 0 || (stats.bytes < budget.bytes && !is_over()) {
            let patience = if waits && stats.slices == 0 { POLL } else { Duration::ZERO };
            let Some(batch) = thread.batch(patience) else { break };
            stats.slices += 1;
            stats.bytes += batch.bytes;
            stats.finished += batch.finished.len() as u32;
            self.finished.extend(batch.finished);
            self.commands.extend(batch.commands);
            self.recorded.extend(batch.staging);
            match batch.refusal {
                Some(error) => self.refused(error),
                None => self.is_refused = false,
            }
        }
        // Nobody else may submit and poll meanwhile, and the thread may wait for staging memory.
        let is_dry = stats.slices == 0 && thread.operations > 0;
        if waits || (is_dry && (!self.drawing || self.recorded.len() >= MOST_UNSUBMITTED)) {
            self.flush(info.device, info.queue);
        } else if is_dry && let Err(error) = info.device.poll(wgpu::PollType::Poll) {
            log::error!("uploads: {error}");
        }
        stats.bytes += made.bytes;
        stats.slices += made.slices;
        stats
    }

    /// Begins with the operation that waits longest; false without one.
    fn begin_next(&mut self) -> bool {
        let Some(operation) = self.waiting.pop_front() else { return false };
        let compiled = Compiled::nothing(operation.ticket, operation.drawables.len());
        self.job = Some(Job { drawables: operation.drawables.into_iter(), compiled });
        true
    }

    /// Gives the next drawable of the operation under way its places, or ends it where there is none. What the
    /// application makes is made at once, and counted.
    fn prepare_next(
        &mut self,
        info: &CompileInfo<'_>,
        pools: &mut Pools,
        drawables: &mut DrawableTable,
        stats: &mut CompileStats,
    ) -> Option<Compiled> {
        let job = self.job.as_mut()?;
        match job.drawables.next() {
            Some(drawable) => {
                let made = prepare(info, pools, drawables, drawable, job, &mut self.uploads);
                stats.bytes += made.unwrap_or(0);
                stats.slices += u32::from(made.is_some());
                None
            }
            None => self.job.take().map(|job| job.compiled),
        }
    }

    /// Ends all uploads that are under way, the thread's too: what shares their places may be drawn after that. A device
    /// that is lost ends none.
    pub(super) fn end_uploads(&mut self, device: &wgpu::Device, queue: &wgpu::Queue, is_lost: impl Fn() -> bool) {
        for mut upload in self.uploads.drain(..) {
            while let Some((units, _)) = upload.left() {
                upload.write(&mut QueueSink(queue), &mut self.scratch, units);
            }
        }
        let Some(mut thread) = self.thread.take() else { return };
        while thread.bytes_in_flight() > 0 && !thread.has_died && !is_lost() {
            if let Some(batch) = thread.batch(POLL) {
                self.finished.extend(batch.finished);
                self.commands.extend(batch.commands);
                self.recorded.extend(batch.staging);
                match batch.refusal {
                    Some(error) => self.refused(error),
                    None => self.is_refused = false,
                }
            }
            self.flush(device, queue);
            self.submitted.drain(..).for_each(|staging| thread.submitted(staging));
            thread.give_back();
        }
        self.thread = Some(thread);
    }
}

/// Puts another mesh in the place of a drawable's, with all of its data at once; true where it has
/// places of a mesh that was there before.
pub(super) fn rewrite(
    queue: &wgpu::Queue,
    pools: &mut Pools,
    table: &mut DrawableTable,
    slot: DrawSlot,
    mesh: &Arc<Mesh>,
) -> Result<bool, String> {
    let entry = *table.entry(slot).ok_or("a mesh is to be rewritten that is not there")?;
    let Shape::Mesh { place: old, texture, .. } = entry.shape else {
        return Err("what is no mesh is not to be rewritten as one".into());
    };
    let placed = pools.meshes.allocate(&mut pools.memory, mesh, &SharedParts::default(), VertexFormat::Full)?;
    let is_shared = placed.vertices.is_none() || placed.indices.is_none();
    let (mut uploads, mut scratch) = (VecDeque::new(), Vec::new());
    push_mesh(pools, &placed, mesh, &mut uploads);
    for mut upload in uploads {
        while let Some((units, _)) = upload.left() {
            upload.write(&mut QueueSink(queue), &mut scratch, units);
        }
    }
    let shape = Shape::of_mesh(mesh, placed.place, texture);
    table.replace(slot, DrawableEntry { shape, ..entry });
    // Free at once: later uploads run after the draws already submitted.
    pools.meshes.release(&old);
    Ok(is_shared)
}

/// What of a newly placed mesh is to be uploaded.
fn push_mesh(pools: &Pools, placed: &MeshUploads, mesh: &Arc<Mesh>, uploads: &mut VecDeque<Upload>) {
    let vertices = placed.vertices.and_then(|range| pools.meshes.vertex_destination(range));
    let indices = placed.indices.and_then(|range| pools.meshes.index_destination(range));
    let format = pools.meshes.format_of(placed.place.vertex_chunk);
    uploads.extend(vertices.map(|into| Upload::new(Source::Vertices(mesh.clone(), format), into)));
    let list = if placed.indices.is_some_and(|range| range.is_short()) {
        Source::ShortIndices(mesh.clone())
    } else {
        Source::Indices(mesh.clone())
    };
    uploads.extend(indices.map(|into| Upload::new(list, into)));
}

/// Gives a drawable its places and queues what has to be uploaded to them. What the application makes is made at once:
/// its bytes.
fn prepare(
    info: &CompileInfo<'_>,
    pools: &mut Pools,
    table: &mut DrawableTable,
    drawable: Drawable,
    job: &mut Job,
    uploads: &mut VecDeque<Upload>,
) -> Option<u64> {
    let CompileInfo { queue, .. } = *info;
    let material = &drawable.material;
    let bytes_before = job.compiled.bytes;
    let placed = match &drawable.geometry {
        Geometry::Height(tile) => place_tile(pools, tile, &drawable, &mut job.compiled, uploads),
        Geometry::Mesh(mesh) => place_mesh(queue, pools, mesh, &drawable, &mut job.compiled, uploads),
        Geometry::Custom(custom) => place_custom(info, pools, custom, &mut job.compiled),
    };
    let is_custom = matches!(drawable.geometry, Geometry::Custom(_));
    let slot = match placed {
        Ok(shape) => table.insert(DrawableEntry::new(shape, material)),
        Err(error) => {
            job.compiled.errors.push(error);
            DrawSlot::NONE
        }
    };
    job.compiled.slots.push(slot);
    is_custom.then(|| job.compiled.bytes - bytes_before)
}

fn place_custom(
    info: &CompileInfo<'_>,
    pools: &mut Pools,
    custom: &CustomGeometry,
    compiled: &mut Compiled,
) -> Result<Shape, String> {
    let hook = custom.hook.0.downcast_ref::<CustomCompile>();
    let compile = hook.ok_or("a custom geometry that was not made by `draw::custom_geometry`")?;
    let shape = (compile.0)(info, &pools.customs.targets)?;
    compiled.bytes += shape.bytes;
    Ok(Shape::Custom(pools.customs.insert(shape)))
}

fn place_tile(
    pools: &mut Pools,
    tile: &Arc<HeightTile>,
    drawable: &Drawable,
    compiled: &mut Compiled,
    uploads: &mut VecDeque<Upload>,
) -> Result<Shape, String> {
    let content = drawable.shared.geometry.as_ref().map(|s| &s.key);
    let (place, is_new) = pools.heights.allocate(&mut pools.memory, &pools.layouts, tile, content)?;
    compiled.count(content, pools.heights.bytes_of(place), is_new);
    if !is_new {
        return Ok(Shape::Height(place));
    }
    if let Some([heights, tables, color]) = pools.heights.destinations(place) {
        uploads.push_back(Upload::new(Source::Tables(tile.clone()), tables));
        uploads.push_back(Upload::new(Source::Heights(tile.clone()), heights));
        uploads.push_back(Upload::new(tile.texture.clone().map_or(Source::White, Source::Image), color));
    }
    Ok(Shape::Height(place))
}

fn place_mesh(
    queue: &wgpu::Queue,
    pools: &mut Pools,
    mesh: &Arc<Mesh>,
    drawable: &Drawable,
    compiled: &mut Compiled,
    uploads: &mut VecDeque<Upload>,
) -> Result<Shape, String> {
    let image = drawable.material.texture.as_ref();
    let [geometry, indices, texture_content] =
        [&drawable.shared.geometry, &drawable.shared.indices, &drawable.shared.texture]
            .map(|s| s.as_ref().map(|s| &s.key));
    let placed = pools.meshes.allocate(&mut pools.memory, mesh, &drawable.shared, drawable.vertex_format())?;
    let texture = match image {
        Some(image) => pools.textures.allocate(&mut pools.memory, &pools.layouts, image, texture_content),
        None => pools.textures.white(&mut pools.memory, queue, &pools.layouts).map(|place| (place, false)),
    };
    let (texture, is_new_texture) = match texture {
        Ok(texture) => texture,
        Err(error) => {
            pools.meshes.release(&placed.place);
            return Err(error);
        }
    };
    let [vertex_bytes, index_bytes] = placed.place_bytes;
    compiled.count(geometry, vertex_bytes, placed.vertices.is_some());
    compiled.count(indices, index_bytes, placed.indices.is_some());
    if image.is_some() {
        compiled.count(texture_content, pools.textures.bytes_of(texture), is_new_texture);
    }
    push_mesh(pools, &placed, mesh, uploads);
    if let Some(image) = image.filter(|_| is_new_texture)
        && let Some(into) = pools.textures.destination(texture)
    {
        uploads.push_back(Upload::new(Source::Image(image.clone()), into));
    }
    Ok(Shape::of_mesh(mesh, placed.place, texture))
}
