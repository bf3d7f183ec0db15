//! GPU time of a frame from timestamp queries, read a few frames late so that nothing waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

const IDLE: u8 = 0;
const IN_FLIGHT: u8 = 1;
const READY: u8 = 2;
const FAILED: u8 = 3;

/// Frames whose results may be outstanding at a time; a frame beyond that goes unmeasured.
const RING: usize = 4;

struct Slot {
    buffer: wgpu::Buffer,
    /// Written by wgpu's map callback (which runs inside poll on the draw thread), read by the timer.
    state: Arc<AtomicU8>,
}

/// Two timestamps a frame and a ring of read-back buffers.
pub(crate) struct FrameTimer {
    queries: wgpu::QuerySet,
    resolve: wgpu::Buffer,
    slots: Vec<Slot>,
    next: usize,
    current: Option<usize>,
    period_ns: f32,
    last_ms: Option<f64>,
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
                size: 16,
                usage,
                mapped_at_creation: false,
            })
        };
        let slots = (0..RING)
            .map(|_| Slot {
                buffer: buffer("frame time read-back", wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
                state: Arc::new(AtomicU8::new(IDLE)),
            })
            .collect();
        Some(Self {
            queries: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("frame time"),
                ty: wgpu::QueryType::Timestamp,
                count: 2,
            }),
            resolve: buffer("frame time", wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            slots,
            next: 0,
            current: None,
            period_ns: queue.get_timestamp_period(),
            last_ms: None,
        })
    }

    /// The writes for this frame's pass; `None` while every read-back buffer is outstanding.
    pub(crate) fn begin(&mut self) -> Option<wgpu::RenderPassTimestampWrites<'_>> {
        let slot = self.slots.get(self.next)?;
        self.current = (slot.state.load(Ordering::Acquire) == IDLE).then_some(self.next);
        self.current?;
        Some(wgpu::RenderPassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(0),
            end_of_pass_write_index: Some(1),
        })
    }

    /// Copies the timestamps after the pass has ended.
    pub(crate) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        if let Some(slot) = self.current.and_then(|i| self.slots.get(i)) {
            encoder.resolve_query_set(&self.queries, 0..2, &self.resolve, 0);
            encoder.copy_buffer_to_buffer(&self.resolve, 0, &slot.buffer, 0, 16);
        }
    }

    /// Asks for the result once the frame is submitted.
    pub(crate) fn submitted(&mut self) {
        if let Some(slot) = self.current.take().and_then(|i| self.slots.get(i)) {
            slot.state.store(IN_FLIGHT, Ordering::Release);
            let state = slot.state.clone();
            slot.buffer.map_async(wgpu::MapMode::Read, .., move |result| {
                state.store(if result.is_ok() { READY } else { FAILED }, Ordering::Release);
            });
            self.next = (self.next + 1) % RING;
        }
    }

    /// Milliseconds of the latest frame whose result has arrived.
    pub(crate) fn latest_ms(&mut self) -> Option<f64> {
        for slot in &self.slots {
            match slot.state.load(Ordering::Acquire) {
                READY => {
                    if let Ok(view) = slot.buffer.get_mapped_range(..) {
                        let ticks: [u64; 2] = bytemuck::pod_read_unaligned(&view);
                        self.last_ms =
                            Some(ticks[1].saturating_sub(ticks[0]) as f64 * f64::from(self.period_ns) * 1e-6);
                    }
                    slot.buffer.unmap();
                    slot.state.store(IDLE, Ordering::Release);
                }
                FAILED => slot.state.store(IDLE, Ordering::Release),
                _ => {}
            }
        }
        self.last_ms
    }
}
