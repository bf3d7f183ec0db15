//! GPU time of the passes of a frame from timestamp queries, read a few frames late so that nothing waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

const IDLE: u8 = 0;
const IN_FLIGHT: u8 = 1;
const READY: u8 = 2;
const FAILED: u8 = 3;

/// Frames whose results may be outstanding at a time; a frame beyond that goes unmeasured.
const RING: usize = 4;
/// Passes of a frame that are measured; those beyond go unmeasured.
const PASSES: usize = 32;

struct Slot {
    buffer: wgpu::Buffer,
    passes: usize,
    /// Written by wgpu's map callback (which runs inside poll on the draw thread), read by the timer.
    state: Arc<AtomicU8>,
}

/// Two timestamps a pass and a ring of read-back buffers.
pub(crate) struct FrameTimer {
    queries: wgpu::QuerySet,
    resolve: wgpu::Buffer,
    slots: Vec<Slot>,
    next: usize,
    current: Option<usize>,
    period_ns: f32,
    /// By pass, of the latest frame whose result has arrived.
    last_ms: Vec<f64>,
}

impl FrameTimer {
    /// `None` where the adapter has no timestamps.
    pub(crate) fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Option<Self> {
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        let buffer = |label, usage| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: 16 * PASSES as u64,
                usage,
                mapped_at_creation: false,
            })
        };
        let slots = (0..RING)
            .map(|_| Slot {
                buffer: buffer("frame time read-back", wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
                passes: 0,
                state: Arc::new(AtomicU8::new(IDLE)),
            })
            .collect();
        Some(Self {
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("frame time"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * PASSES as u32,
            }),
            resolve: buffer("frame time", wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            slots,
            next: 0,
            current: None,
            period_ns: queue.get_timestamp_period(),
            last_ms: Vec::new(),
        })
    }

    /// Starts a frame; it goes unmeasured while every read-back buffer is outstanding.
    pub(crate) fn start_frame(&mut self) {
        self.current = None;
        if let Some(slot) = self.slots.get_mut(self.next)
            && slot.state.load(Ordering::Acquire) == IDLE
        {
            slot.passes = 0;
            self.current = Some(self.next);
        }
    }

    /// The writes for the frame's next pass.
    pub(crate) fn pass(&mut self) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        let slot = self.slots.get_mut(self.current?)?;
        if slot.passes == PASSES {
            return None;
        }
        let first = 2 * slot.passes as u32;
        slot.passes += 1;
        Some(wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        })
    }

    /// Copies the timestamps after the passes have ended.
    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        if let Some(slot) = self.current.and_then(|i| self.slots.get(i)).filter(|s| s.passes > 0) {
            encoder.resolve_query_set(&self.queries, 0..2 * slot.passes as u32, &self.resolve, 0);
            encoder.copy_buffer_to_buffer(&self.resolve, 0, &slot.buffer, 0, 16 * slot.passes as u64);
        }
    }

    /// Asks for the result once the frame is submitted.
    pub(crate) fn submitted(&mut self) {
        if let Some(slot) = self.current.take().and_then(|i| self.slots.get(i)).filter(|s| s.passes > 0) {
            slot.state.store(IN_FLIGHT, Ordering::Release);
            let state = slot.state.clone();
            slot.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
                state.store(if result.is_ok() { READY } else { FAILED }, Ordering::Release);
            });
            self.next = (self.next + 1) % RING;
        }
    }

    /// Milliseconds by pass of the latest frame whose result has arrived; empty before the first.
    pub(crate) fn latest_ms(&mut self) -> &[f64] {
        for slot in &self.slots {
            match slot.state.load(Ordering::Acquire) {
                READY => {
                    if let Ok(view) = slot.buffer.get_mapped_range(..) {
                        let ms = |pass: &[u8]| {
                            let ticks: [u64; 2] = bytemuck::pod_read_unaligned(pass);
                            ticks[1].saturating_sub(ticks[0]) as f64 * f64::from(self.period_ns) * 1e-6
                        };
                        self.last_ms.clear();
                        self.last_ms.extend(view.chunks_exact(16).take(slot.passes).map(ms));
                    }
                    slot.buffer.unmap();
                    slot.state.store(IDLE, Ordering::Release);
                }
                FAILED => slot.state.store(IDLE, Ordering::Release),
                _ => {}
            }
        }
        &self.last_ms
    }
}
