//! GPU time of the passes of a frame from timestamp queries, read a few frames late so that nothing waits.
//!
//! A software adapter stops at each timestamp until all before it is done, which is up to half of a small frame; what it
//! would tell is the processor's time anyway. There passes are only timed while a timeline is recorded.
//!
//! While a timeline is recorded the passes go on it, on a line for each context. The adapter's clock is not ours, and
//! wgpu has nothing that reads both at once. But no pass begins before it was submitted: times on the adapter are moved by
//! the least that agrees with this for all of the last frames. So a span lies too early by the least time for which one of
//! those submissions waited, some tens of microseconds where the adapter was idle once, and never too
//! late, but for what the clocks have drifted apart in 512 frames. Lengths are the adapter's own.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

use super::GraphicsContext;
use crate::trace::{self, Track};

const IDLE: u8 = 0;
const IN_FLIGHT: u8 = 1;
const READY: u8 = 2;
const FAILED: u8 = 3;

/// Draws whose results may be outstanding at a time; a frame has one for each context of the device, and one beyond goes
/// unmeasured.
const RING: usize = 8;
/// Passes of a frame that are measured at first. Of a frame with more there are no times, and those after it measure as
/// many.
const PASSES: usize = 32;
/// The most: wgpu's limit of a query set.
const MOST_PASSES: usize = wgpu::QUERY_SET_MAX_QUERIES as usize / 2;

/// Frames after which a bound on the clocks' difference is forgotten, as they may drift.
const FORGOTTEN_AFTER: u32 = 256;

struct Slot {
    buffer: wgpu::Buffer,
    /// Number of the context, and of its frame.
    of: (u32, u32),
    /// Those of its passes that are measured.
    names: Vec<&'static str>,
    /// Passes that were not measured.
    missed: usize,
    submitted: Instant,
    /// Written by wgpu's map callback (which runs inside poll on the draw thread), read by the timer.
    state: Arc<AtomicU8>,
}

/// Two timestamps a pass and a ring of read-back buffers.
pub(crate) struct FrameTimer {
    queries: wgpu::QuerySet,
    resolve: wgpu::Buffer,
    /// Passes that these have room for, and the most that a frame had.
    passes: usize,
    most: usize,
    slots: Vec<Slot>,
    next: usize,
    current: Option<usize>,
    period_ns: f64,
    /// The adapter is a processor.
    is_software: bool,
    /// Our times are counted from here.
    epoch: Option<Instant>,
    clock: ClockFit,
    /// By pass, of each context's latest frame whose result has arrived.
    last_ms: Vec<(u32, Vec<f64>)>,
    tracks: Vec<(u32, Track)>,
    /// Of the slot that is read; kept for its memory.
    ticks: Vec<[u64; 2]>,
}

const READ_BACK: wgpu::BufferUsages = wgpu::BufferUsages::COPY_DST.union(wgpu::BufferUsages::MAP_READ);
const RESOLVE: wgpu::BufferUsages = wgpu::BufferUsages::QUERY_RESOLVE.union(wgpu::BufferUsages::COPY_SRC);

/// For the timestamps of so many passes.
fn buffer(device: &wgpu::Device, usage: wgpu::BufferUsages, passes: usize) -> wgpu::Buffer {
    let (label, size) = (Some("frame time"), 16 * passes as u64);
    device.create_buffer(&wgpu::BufferDescriptor { label, size, usage, mapped_at_creation: false })
}

fn query_set(device: &wgpu::Device, passes: usize) -> wgpu::QuerySet {
    device.create_query_set(&wgpu::QuerySetDescriptor {
        label: Some("frame time"),
        ty: wgpu::QueryType::Timestamp,
        count: 2 * passes as u32,
    })
}

/// How far a clock of the adapter is from ours, nanoseconds: bounded from below by each event that cannot have come
/// before a moment of ours.
#[derive(Default)]
struct ClockFit {
    /// The largest bound of this run of frames and of the one before.
    bounds: [Option<f64>; 2],
    frames: u32,
}

impl ClockFit {
    /// Something began at a time of the adapter's, and not before one of ours.
    fn observe(&mut self, adapter_ns: f64, not_before_ns: f64) {
        let bound = not_before_ns - adapter_ns;
        self.frames += 1;
        if self.frames > FORGOTTEN_AFTER {
            self.bounds = [None, self.bounds[0]];
            self.frames = 0;
        }
        self.bounds[0] = Some(self.bounds[0].map_or(bound, |known| known.max(bound)));
    }

    /// The least difference that agrees with what was seen.
    fn ours_ns(&self, adapter_ns: f64) -> f64 {
        let least = self.bounds.iter().flatten().copied().fold(f64::NEG_INFINITY, f64::max);
        adapter_ns + if least.is_finite() { least } else { 0.0 }
    }
}

impl FrameTimer {
    /// `None` where the adapter has no timestamps.
    pub(crate) fn new(ctx: &GraphicsContext) -> Option<Self> {
        let device = ctx.device();
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        let slots = (0..RING)
            .map(|_| Slot {
                buffer: buffer(device, READ_BACK, PASSES),
                of: (0, 0),
                names: Vec::with_capacity(PASSES),
                missed: 0,
                submitted: Instant::now(),
                state: Arc::new(AtomicU8::new(IDLE)),
            })
            .collect();
        Some(Self {
            queries: query_set(device, PASSES),
            resolve: buffer(device, RESOLVE, PASSES),
            passes: PASSES,
            most: PASSES,
            slots,
            next: 0,
            current: None,
            period_ns: f64::from(ctx.queue().get_timestamp_period()),
            is_software: ctx.is_software(),
            epoch: None,
            clock: ClockFit::default(),
            last_ms: Vec::new(),
            tracks: Vec::new(),
            ticks: Vec::with_capacity(PASSES),
        })
    }

    /// Starts a context's frame of a number; it goes unmeasured while every read-back buffer is outstanding.
    pub(crate) fn start_frame(&mut self, device: &wgpu::Device, context: u32, frame: u32) {
        self.current = None;
        if self.is_software && !trace::is_recording() {
            self.last_ms.clear();
            return;
        }
        if let Some(slot) = self.slots.get_mut(self.next)
            && slot.state.load(Ordering::Acquire) == IDLE
        {
            slot.names.clear();
            slot.missed = 0;
            slot.of = (context, frame);
            self.current = Some(self.next);
            if self.most > self.passes {
                self.passes = self.most.next_power_of_two().min(MOST_PASSES);
                (self.queries, self.resolve) = (query_set(device, self.passes), buffer(device, RESOLVE, self.passes));
            }
            // Nobody reads it.
            if slot.buffer.size() < self.resolve.size() {
                slot.buffer = buffer(device, READ_BACK, self.passes);
            }
        }
    }

    /// The writes for the frame's next pass, by its name.
    pub(crate) fn pass(&mut self, name: &'static str) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        let first = self.next_query(name)?;
        Some(wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }

    /// The same for one that computes.
    pub(crate) fn compute_pass(&mut self, name: &'static str) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let first = self.next_query(name)?;
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }

    fn next_query(&mut self, name: &'static str) -> Option<u32> {
        let slot = self.slots.get_mut(self.current?)?;
        if slot.names.len() == self.passes {
            slot.missed += 1;
            return None;
        }
        slot.names.push(name);
        Some(2 * (slot.names.len() as u32 - 1))
    }

    /// Copies the timestamps after the passes have ended.
    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        if let Some(slot) = self.current.and_then(|i| self.slots.get(i)).filter(|s| !s.names.is_empty()) {
            encoder.resolve_query_set(&self.queries, 0..2 * slot.names.len() as u32, &self.resolve, 0);
            encoder.copy_buffer_to_buffer(&self.resolve, 0, &slot.buffer, 0, 16 * slot.names.len() as u64);
        }
    }

    /// Asks for the result once the frame is submitted; that began at a moment.
    pub(crate) fn submitted(&mut self, at: Instant) {
        if let Some(slot) = self.current.take().and_then(|i| self.slots.get_mut(i)).filter(|s| !s.names.is_empty()) {
            self.most = self.most.max(slot.names.len() + slot.missed);
            slot.submitted = at;
            slot.state.store(IN_FLIGHT, Ordering::Release);
            let state = slot.state.clone();
            slot.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
                state.store(if result.is_ok() { READY } else { FAILED }, Ordering::Release);
            });
            self.next = (self.next + 1) % RING;
        }
    }

    /// Takes what has arrived.
    pub(crate) fn read(&mut self) {
        // The oldest first.
        for place in (self.next..RING).chain(0..self.next) {
            let Some(slot) = self.slots.get(place) else { continue };
            match slot.state.load(Ordering::Acquire) {
                READY => {
                    if let Ok(view) = slot.buffer.get_mapped_range(..) {
                        let passes = view.chunks_exact(16).take(slot.names.len());
                        self.ticks.clear();
                        self.ticks.extend(passes.map(bytemuck::pod_read_unaligned::<[u64; 2]>));
                        let ticks = &self.ticks;
                        note(&mut self.last_ms, slot, ticks, self.period_ns);
                        if trace::is_recording() {
                            let began_ns = ticks[0][0] as f64 * self.period_ns;
                            let epoch = *self.epoch.get_or_insert(slot.submitted);
                            self.clock.observe(began_ns, signed_ns(epoch, slot.submitted));
                            let ours =
                                |ticks: u64| from_signed_ns(epoch, self.clock.ours_ns(ticks as f64 * self.period_ns));
                            record(&mut self.tracks, slot, ticks, ours);
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

    /// Milliseconds by pass of a context's latest frame whose result has been read; empty before the first, and where
    /// not all of its passes were measured.
    pub(crate) fn latest_ms(&self, context: u32) -> &[f64] {
        self.last_ms.iter().find(|(of, _)| *of == context).map_or(&[], |(_, ms)| ms)
    }
}

fn note(all: &mut Vec<(u32, Vec<f64>)>, slot: &Slot, ticks: &[[u64; 2]], period_ns: f64) {
    let place = all.iter().position(|(of, _)| *of == slot.of.0).unwrap_or_else(|| {
        all.push((slot.of.0, Vec::with_capacity(PASSES)));
        all.len() - 1
    });
    let ms = |[begin, end]: &[u64; 2]| end.saturating_sub(*begin) as f64 * period_ns * 1e-6;
    let (_, last) = &mut all[place];
    last.clear();
    if slot.missed == 0 {
        last.extend(ticks.iter().map(ms));
    }
}

/// Puts a frame on its context's line.
fn record(tracks: &mut Vec<(u32, Track)>, slot: &Slot, passes: &[[u64; 2]], ours: impl Fn(u64) -> Instant) {
    let Some([began, _]) = passes.first() else { return };
    let (context, frame) = slot.of;
    let place = tracks.iter().position(|(of, _)| *of == context).unwrap_or_else(|| {
        tracks.push((context, Track::new(format!("gpu {context}"))));
        tracks.len() - 1
    });
    let end = passes.iter().map(|[_, end]| *end).max().unwrap_or(0);
    let spans = passes.iter().zip(&slot.names).map(|(ticks, name)| (*name, ticks.map(&ours)));
    tracks[place].1.spans("frame", || frame.to_string().into(), [ours(*began), ours(end)], spans);
}

/// Nanoseconds from one moment to another, which may be before it.
fn signed_ns(from: Instant, to: Instant) -> f64 {
    match to.checked_duration_since(from) {
        Some(after) => after.as_nanos() as f64,
        None => -(from.saturating_duration_since(to).as_nanos() as f64),
    }
}

fn from_signed_ns(from: Instant, ns: f64) -> Instant {
    let distance = Duration::from_nanos(ns.abs() as u64);
    let moved = if ns >= 0.0 { from.checked_add(distance) } else { from.checked_sub(distance) };
    moved.unwrap_or(from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_adapters_clock_is_laid_where_nothing_begins_before_it_was_submitted() {
        let mut fit = ClockFit::default();
        assert_eq!(fit.ours_ns(5.0), 5.0);
        // The adapter's clock is 1,000 behind ours; submissions wait for 70, 20 and 300 before they begin.
        for (submitted, waits) in [(5_000.0, 70.0), (6_000.0, 20.0), (7_000.0, 300.0)] {
            fit.observe(submitted + waits - 1_000.0, submitted);
            assert!(fit.ours_ns(submitted + waits - 1_000.0) >= submitted);
        }
        // Off by the shortest wait.
        assert_eq!(fit.ours_ns(9_000.0), 9_980.0);
        // It runs faster by 1 in 1,000: the bound follows, some runs of frames behind.
        for frame in 0..4 * FORGOTTEN_AFTER {
            let ours = 10_000.0 + 1_000.0 * f64::from(frame);
            fit.observe(ours * 1.001 - 1_000.0, ours);
        }
        let last = 10_000.0 + 1_000.0 * f64::from(4 * FORGOTTEN_AFTER);
        let off = fit.ours_ns(last * 1.001 - 1_000.0) - last;
        assert!((0.0..=f64::from(3 * FORGOTTEN_AFTER)).contains(&off), "{off}");
    }

    #[test]
    fn moments_go_both_ways() {
        let now = Instant::now();
        for ns in [0.0, 1_500.0, -1_500.0] {
            assert_eq!(signed_ns(now, from_signed_ns(now, ns)), ns);
        }
    }
}
