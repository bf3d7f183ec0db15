//! [`FrameTimer`]: the GPU time of a frame's passes, from timestamp queries that are read a few frames late so that nothing
//! waits. Draw thread.
//!
//! A software adapter stops at each timestamp until everything before it is done, which takes up to half of a small frame,
//! and its times are the processor's anyway. There, passes are timed only while a trace is recorded.
//!
//! While a trace is recorded, the passes are written to a track per context, at times that `adapter_clock.rs` converts.
//! Lengths are the adapter's own.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Instant;

use super::adapter_clock::AdapterClock;
use super::graphics_context::GraphicsContext;
use crate::trace::{self, Track};

/// The states of a slot.
const IDLE: u8 = 0;
const IN_FLIGHT: u8 = 1;
const READY: u8 = 2;
const FAILED: u8 = 3;

/// The number of draws whose results may be outstanding. A frame has one draw per context of the device; further draws are
/// not measured.
const SLOTS: usize = 8;
/// The number of passes of a frame that are measured at first. A frame with more has no times, and later frames measure as
/// many.
const INITIAL_PASSES: usize = 32;
/// The maximum number of measured passes: wgpu's limit for a query set.
const MAX_PASSES: usize = wgpu::QUERY_SET_MAX_QUERIES as usize / 2;

/// The measurement of a frame.
struct Slot {
    buffer: wgpu::Buffer,
    /// The number of the context.
    context: u32,
    frame: u32,
    /// The names of the measured passes.
    names: Vec<&'static str>,
    /// The number of passes that were not measured.
    unmeasured: usize,
    submitted: Instant,
    /// Written by wgpu's map callback, which runs inside poll on the draw thread, and read by the timer.
    state: Arc<AtomicU8>,
}

/// Two timestamps per pass, and a ring of read-back buffers.
pub(crate) struct FrameTimer {
    queries: PassQueries,
    /// The largest number of passes that a frame had.
    max_passes: usize,
    slots: Vec<Slot>,
    /// Index of the slot of the next measured frame.
    next: usize,
    /// Index of the slot of the current frame, if it is measured.
    current: Option<usize>,
    period_ns: f64,
    is_software: bool,
    clock: AdapterClock,
    /// Milliseconds by pass of each context's latest frame whose result has arrived.
    latest_ms: Vec<(u32, Vec<f64>)>,
    /// By context.
    tracks: Vec<(u32, Track)>,
    /// The timestamps of the slot that is read; kept for its memory.
    ticks: Vec<[u64; 2]>,
}

const READ_BACK: wgpu::BufferUsages = wgpu::BufferUsages::COPY_DST.union(wgpu::BufferUsages::MAP_READ);
const RESOLVE: wgpu::BufferUsages = wgpu::BufferUsages::QUERY_RESOLVE.union(wgpu::BufferUsages::COPY_SRC);

/// Creates a buffer for the timestamps of a number of passes.
fn create_buffer(device: &wgpu::Device, usage: wgpu::BufferUsages, passes: usize) -> wgpu::Buffer {
    let (label, size) = (Some("frame time"), 16 * passes as u64);
    device.create_buffer(&wgpu::BufferDescriptor { label, size, usage, mapped_at_creation: false })
}

/// A query set for a number of passes, with its resolve buffer.
struct PassQueries {
    set: wgpu::QuerySet,
    resolve: wgpu::Buffer,
    passes: usize,
}

impl PassQueries {
    fn new(device: &wgpu::Device, passes: usize) -> Self {
        let set = device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("frame time"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * passes as u32,
        });
        Self { set, resolve: create_buffer(device, RESOLVE, passes), passes }
    }
}

impl FrameTimer {
    /// Creates a timer; returns `None` if the adapter has no timestamps.
    pub(crate) fn new(ctx: &GraphicsContext) -> Option<Self> {
        let device = ctx.device();
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        let slots = (0..SLOTS)
            .map(|_| Slot {
                buffer: create_buffer(device, READ_BACK, INITIAL_PASSES),
                context: 0,
                frame: 0,
                names: Vec::with_capacity(INITIAL_PASSES),
                unmeasured: 0,
                submitted: Instant::now(),
                state: Arc::new(AtomicU8::new(IDLE)),
            })
            .collect();
        Some(Self {
            queries: PassQueries::new(device, INITIAL_PASSES),
            max_passes: INITIAL_PASSES,
            slots,
            next: 0,
            current: None,
            period_ns: f64::from(ctx.queue().get_timestamp_period()),
            is_software: ctx.is_software(),
            clock: AdapterClock::default(),
            latest_ms: Vec::new(),
            tracks: Vec::new(),
            ticks: Vec::with_capacity(INITIAL_PASSES),
        })
    }

    /// Begins a frame of a context. It is not measured while all read-back buffers are outstanding.
    pub(crate) fn start_frame(&mut self, device: &wgpu::Device, context: u32, frame: u32) {
        self.current = None;
        if self.is_software && !trace::is_recording() {
            self.latest_ms.clear();
            return;
        }
        if let Some(slot) = self.slots.get_mut(self.next)
            && slot.state.load(Ordering::Acquire) == IDLE
        {
            slot.names.clear();
            slot.unmeasured = 0;
            (slot.context, slot.frame) = (context, frame);
            self.current = Some(self.next);
            if self.max_passes > self.queries.passes {
                self.queries = PassQueries::new(device, self.max_passes.next_power_of_two().min(MAX_PASSES));
            }
            // The slot is idle, so its buffer has no reader.
            if slot.buffer.size() < self.queries.resolve.size() {
                slot.buffer = create_buffer(device, READ_BACK, self.queries.passes);
            }
        }
    }

    /// Returns the timestamp writes of the frame's next render pass; `None` if it is not measured.
    pub(crate) fn pass(&mut self, name: &'static str) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        let first = self.next_query(name)?;
        Some(wgpu::RenderPassTimestampWrites {
            query_set: &self.queries.set,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }

    /// Returns the timestamp writes of the frame's next compute pass; `None` if it is not measured.
    pub(crate) fn compute_pass(&mut self, name: &'static str) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let first = self.next_query(name)?;
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &self.queries.set,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }

    fn next_query(&mut self, name: &'static str) -> Option<u32> {
        let slot = self.slots.get_mut(self.current?)?;
        if slot.names.len() == self.queries.passes {
            slot.unmeasured += 1;
            return None;
        }
        slot.names.push(name);
        Some(2 * (slot.names.len() as u32 - 1))
    }

    /// Records the copy of the timestamps, after the passes have ended.
    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        if let Some(slot) = self.current.and_then(|i| self.slots.get(i)).filter(|s| !s.names.is_empty()) {
            let PassQueries { set, resolve, .. } = &self.queries;
            encoder.resolve_query_set(set, 0..2 * slot.names.len() as u32, resolve, 0);
            encoder.copy_buffer_to_buffer(resolve, 0, &slot.buffer, 0, 16 * slot.names.len() as u64);
        }
    }

    /// Requests the result after the frame's submission, which began at a moment.
    pub(crate) fn submitted(&mut self, at: Instant) {
        if let Some(slot) = self.current.take().and_then(|i| self.slots.get_mut(i)).filter(|s| !s.names.is_empty()) {
            self.max_passes = self.max_passes.max(slot.names.len() + slot.unmeasured);
            slot.submitted = at;
            slot.state.store(IN_FLIGHT, Ordering::Release);
            let state = slot.state.clone();
            slot.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
                state.store(if result.is_ok() { READY } else { FAILED }, Ordering::Release);
            });
            self.next = (self.next + 1) % SLOTS;
        }
    }

    /// Reads the results that have arrived, the oldest first.
    pub(crate) fn read(&mut self) {
        for index in (self.next..SLOTS).chain(0..self.next) {
            let Some(slot) = self.slots.get(index) else { continue };
            match slot.state.load(Ordering::Acquire) {
                READY => {
                    if let Ok(view) = slot.buffer.get_mapped_range(..) {
                        let passes = view.chunks_exact(16).take(slot.names.len());
                        self.ticks.clear();
                        self.ticks.extend(passes.map(bytemuck::pod_read_unaligned::<[u64; 2]>));
                        note_latest(&mut self.latest_ms, slot, &self.ticks, self.period_ns);
                        if trace::is_recording() {
                            self.clock.observe(self.ticks[0][0] as f64 * self.period_ns, slot.submitted);
                            let (clock, period_ns) = (&self.clock, self.period_ns);
                            let instant =
                                |ticks: u64| clock.instant(ticks as f64 * period_ns).unwrap_or(slot.submitted);
                            record(&mut self.tracks, slot, &self.ticks, instant);
                        }
                    }
                    slot.buffer.unmap();
                    slot.state.store(IDLE, Ordering::Release);
                }
                FAILED => slot.state.store(IDLE, Ordering::Release),
                _ => {}
            }
        }
    }

    /// Returns milliseconds by pass of a context's latest frame whose result was read. Empty before the first result, and if
    /// not all passes of the frame were measured.
    pub(crate) fn latest_ms(&self, context: u32) -> &[f64] {
        self.latest_ms.iter().find(|(id, _)| *id == context).map_or(&[], |(_, ms)| ms)
    }
}

/// Stores the times of a frame as the latest of its context.
fn note_latest(all: &mut Vec<(u32, Vec<f64>)>, slot: &Slot, ticks: &[[u64; 2]], period_ns: f64) {
    let index = all.iter().position(|(id, _)| *id == slot.context).unwrap_or_else(|| {
        all.push((slot.context, Vec::with_capacity(INITIAL_PASSES)));
        all.len() - 1
    });
    let ms = |[begin, end]: &[u64; 2]| end.saturating_sub(*begin) as f64 * period_ns * 1e-6;
    let (_, latest) = &mut all[index];
    latest.clear();
    if slot.unmeasured == 0 {
        latest.extend(ticks.iter().map(ms));
    }
}

/// Writes a frame and its passes to the track of its context.
fn record(tracks: &mut Vec<(u32, Track)>, slot: &Slot, passes: &[[u64; 2]], instant: impl Fn(u64) -> Instant) {
    let Some([began, _]) = passes.first() else { return };
    let Slot { context, frame, .. } = slot;
    let index = tracks.iter().position(|(id, _)| id == context).unwrap_or_else(|| {
        tracks.push((*context, Track::new(format!("gpu {context}"))));
        tracks.len() - 1
    });
    let end = passes.iter().map(|[_, end]| *end).max().unwrap_or(0);
    let spans = passes.iter().zip(&slot.names).map(|(ticks, name)| (*name, ticks.map(&instant)));
    tracks[index].1.spans("frame", || frame.to_string().into(), [instant(*began), instant(end)], spans);
}
