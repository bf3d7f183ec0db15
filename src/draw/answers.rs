//! What comes back from the adapter some frames later: samples of occlusion queries, pictures of cameras. Draw thread;
//! nothing waits for it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use glam::DMat4;

use crate::cull::{CullCamera, OcclusionQuery};
use crate::gpu::Memory;
use crate::scene::{Attachment, CameraTarget, OcclusionResults, Picture, PictureSink, ReadBack};
use crate::state::TextureFormat;

const IDLE: u8 = 0;
const IN_FLIGHT: u8 = 1;
const READY: u8 = 2;
const FAILED: u8 = 3;

/// Queries of a frame that are asked; those beyond wait for another.
pub(super) const MOST_QUERIES: u32 = 1024;
/// Draws whose answers may be outstanding: a frame has one for each target of the device.
const RING: usize = 8;
/// Pictures that may be outstanding.
const MOST_PICTURES: usize = 8;

fn map(buffer: &wgpu::Buffer, state: &Arc<AtomicU8>) {
    state.store(IN_FLIGHT, Ordering::Release);
    let state = state.clone();
    buffer.map_async(wgpu::MapMode::Read, .., move |result| {
        state.store(if result.is_ok() { READY } else { FAILED }, Ordering::Release);
    });
}

struct QuerySlot {
    buffer: wgpu::Buffer,
    /// With their thresholds and frames.
    asked: Vec<(Arc<OcclusionResults>, u32, u32)>,
    state: Arc<AtomicU8>,
}

/// Occlusion queries of a renderer; made when the first one comes.
pub(super) struct Queries {
    pub(super) set: wgpu::QuerySet,
    resolve: wgpu::Buffer,
    slots: Vec<QuerySlot>,
    current: Option<usize>,
}

impl Queries {
    /// Bytes of the samples of a frame's queries.
    const FRAME_BYTES: u64 = 8 * MOST_QUERIES as u64;

    /// Those of a renderer; why there is no memory for them.
    pub(super) fn new(memory: &Memory) -> Result<Self, String> {
        memory.make("occlusion queries", Self::FRAME_BYTES * (1 + RING as u64), Self::of_device)
    }

    fn of_device(device: &wgpu::Device) -> Self {
        let buffer = |label, usage| {
            let size = Self::FRAME_BYTES;
            device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
        };
        Self {
            set: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("occlusion"),
                ty: wgpu::QueryType::Occlusion,
                count: MOST_QUERIES,
            }),
            resolve: buffer("occlusion", wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            slots: (0..RING)
                .map(|_| QuerySlot {
                    buffer: buffer("occlusion answers", wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
                    asked: Vec::new(),
                    state: Arc::new(AtomicU8::new(IDLE)),
                })
                .collect(),
            current: None,
        }
    }

    pub(super) fn start_frame(&mut self) {
        self.current = self.slots.iter().position(|s| s.state.load(Ordering::Acquire) == IDLE);
        if let Some(slot) = self.current.and_then(|i| self.slots.get_mut(i)) {
            slot.asked.clear();
        }
    }

    /// The index of a query; `None` when it has to wait for another frame. Until then what there is no room for counts as
    /// seen: others may have taken its place each time.
    pub(super) fn ask(&mut self, query: &OcclusionQuery) -> Option<u32> {
        let slot = self.current.and_then(|current| self.slots.get_mut(current));
        let room = slot.as_ref().map(|slot| slot.asked.len() < MOST_QUERIES as usize);
        match slot.filter(|_| room == Some(true)) {
            Some(slot) => {
                slot.asked.push((query.results.clone(), query.visibility_threshold, query.frame));
                Some(slot.asked.len() as u32 - 1)
            }
            None => {
                query.results.was_not_asked(room == Some(false), query.frame);
                None
            }
        }
    }

    /// Takes back what was asked in a frame that is not drawn: it counts as seen.
    pub(super) fn forget_asked(&mut self) {
        if let Some(slot) = self.current.take().and_then(|current| self.slots.get_mut(current)) {
            slot.asked.drain(..).for_each(|(results, _, frame)| results.was_not_asked(true, frame));
        }
    }

    pub(super) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        if let Some(slot) = self.current.and_then(|i| self.slots.get(i)).filter(|s| !s.asked.is_empty()) {
            let count = slot.asked.len() as u32;
            encoder.resolve_query_set(&self.set, 0..count, &self.resolve, 0);
            encoder.copy_buffer_to_buffer(&self.resolve, 0, &slot.buffer, 0, 8 * u64::from(count));
        }
    }

    pub(super) fn submitted(&mut self) {
        if let Some(slot) = self.current.take().and_then(|i| self.slots.get(i)).filter(|s| !s.asked.is_empty()) {
            map(&slot.buffer, &slot.state);
        }
    }

    /// Passes on what has arrived.
    pub(super) fn deliver(&mut self) {
        for slot in &mut self.slots {
            match slot.state.load(Ordering::Acquire) {
                READY => {
                    if let Ok(view) = slot.buffer.get_mapped_range(..) {
                        for ((results, threshold, frame), samples) in slot.asked.iter().zip(view.chunks_exact(8)) {
                            results.answered(bytemuck::pod_read_unaligned(samples), *threshold, *frame);
                        }
                    }
                    slot.buffer.unmap();
                    slot.asked.clear();
                    slot.state.store(IDLE, Ordering::Release);
                }
                FAILED => slot.state.store(IDLE, Ordering::Release),
                _ => {}
            }
        }
    }
}

/// Why a part of a camera's target is not read back.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum ReadBackError {
    #[error("a camera without colour {0}, which is to be read back")]
    NoColor(usize),
    #[error("a camera without a depth texture, which is to be read back")]
    NoDepth,
    #[error("texture {name:?} holds depth in 24 bits, which cannot be copied to be read back; Depth32Stencil8 can")]
    Uncopied { name: String },
    #[error("texture {name:?} has no stencil, which is to be read back")]
    NoStencil { name: String },
}

/// A part of a camera's target, and what it is read as.
#[derive(Clone, Copy)]
pub(super) struct Read<'a> {
    pub(super) attachment: &'a Attachment,
    aspect: wgpu::TextureAspect,
    format: TextureFormat,
}

impl<'a> Read<'a> {
    /// A colour as it is.
    fn color(attachment: &'a Attachment) -> Self {
        Self { attachment, aspect: wgpu::TextureAspect::All, format: attachment.texture.format }
    }

    pub(super) fn of(camera: &'a CameraTarget, part: ReadBack) -> Result<Self, ReadBackError> {
        let depth = || camera.depth.as_ref().ok_or(ReadBackError::NoDepth);
        match part {
            ReadBack::Color(location) => {
                camera.colors.get(location).map(Self::color).ok_or(ReadBackError::NoColor(location))
            }
            ReadBack::Depth => {
                let attachment = depth()?;
                let texture = &attachment.texture;
                if texture.format == TextureFormat::Depth24Stencil8 {
                    return Err(ReadBackError::Uncopied { name: texture.name.clone() });
                }
                Ok(Self { attachment, aspect: wgpu::TextureAspect::DepthOnly, format: TextureFormat::Depth32 })
            }
            ReadBack::Stencil => {
                let attachment = depth()?;
                let texture = &attachment.texture;
                if !texture.format.has_stencil() {
                    return Err(ReadBackError::NoStencil { name: texture.name.clone() });
                }
                Ok(Self { attachment, aspect: wgpu::TextureAspect::StencilOnly, format: TextureFormat::R8 })
            }
        }
    }
}

struct PictureSlot {
    buffer: wgpu::Buffer,
    sink: Arc<PictureSink>,
    size_px: [u32; 2],
    format: TextureFormat,
    frame: u32,
    clip_from_eye: DMat4,
    is_new: bool,
    state: Arc<AtomicU8>,
}

/// Pictures under way from cameras to whoever wants them.
#[derive(Default)]
pub(super) struct PictureReads {
    slots: Vec<PictureSlot>,
    /// Those that found no room, who asked first in front, each with the draw in which it last asked.
    waiting: Vec<(Arc<PictureSink>, u32)>,
    /// Counts on with each draw.
    draw: u32,
}

/// Who has not asked in so many draws, of all targets, is not waited for.
const WAITING_DRAWS: u32 = 32;

impl PictureReads {
    /// Whether there is room for a sink besides those that have waited longer; else it waits.
    fn has_room(&mut self, sink: &Arc<PictureSink>) -> bool {
        let is_busy = |s: &&PictureSlot| s.is_new || s.state.load(Ordering::Acquire) != IDLE;
        let free = MOST_PICTURES.saturating_sub(self.slots.iter().filter(is_busy).count());
        let place = self.waiting.iter().position(|(waits, _)| Arc::ptr_eq(waits, sink));
        let has_room = place.unwrap_or(self.waiting.len()) < free;
        match place {
            Some(place) if has_room => _ = self.waiting.remove(place),
            Some(place) => self.waiting[place].1 = self.draw,
            None if has_room => {}
            None => self.waiting.push((sink.clone(), self.draw)),
        }
        has_room
    }

    /// Copies a part of a camera's target from its texture to where it can be read; not while too many are under way. Why
    /// it cannot be.
    pub(super) fn copy(
        &mut self,
        memory: &Memory,
        encoder: &mut wgpu::CommandEncoder,
        texture: &wgpu::Texture,
        read: Read<'_>,
        sink: &Arc<PictureSink>,
        camera: &CullCamera,
    ) -> Result<(), String> {
        if !self.has_room(sink) {
            return Ok(());
        }
        let Read { attachment: Attachment { level, layer, .. }, aspect, format } = read;
        let (level, layer) = (*level, *layer);
        let CullCamera { frame, clip_from_eye, .. } = *camera;
        let size_px = [texture.width(), texture.height()].map(|side| (side >> level).max(1));
        let row_bytes = (size_px[0] * format.texel_bytes() as u32).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let size = u64::from(row_bytes) * u64::from(size_px[1]);
        let is_idle = |s: &PictureSlot| !s.is_new && s.state.load(Ordering::Acquire) == IDLE;
        let fitting = self.slots.iter().position(|s| is_idle(s) && s.buffer.size() == size);
        let place = match fitting.or_else(|| self.slots.iter().position(is_idle)) {
            Some(place) => place,
            None if self.slots.len() >= MOST_PICTURES => return Ok(()),
            None => self.slots.len(),
        };
        if fitting.is_none() {
            let descriptor = wgpu::BufferDescriptor {
                label: Some("picture"),
                size,
                usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
                mapped_at_creation: false,
            };
            let what = "picture to be read back";
            let slot = PictureSlot {
                buffer: memory.make(what, size, |device| device.create_buffer(&descriptor))?,
                sink: sink.clone(),
                size_px,
                format,
                frame,
                clip_from_eye,
                is_new: true,
                state: Arc::new(AtomicU8::new(IDLE)),
            };
            if place < self.slots.len() {
                self.slots[place] = slot;
            } else {
                self.slots.push(slot);
            }
        }
        let slot = &mut self.slots[place];
        (slot.sink, slot.size_px, slot.format) = (sink.clone(), size_px, format);
        (slot.frame, slot.clip_from_eye, slot.is_new) = (frame, clip_from_eye, true);
        encoder.copy_texture_to_buffer(
            wgpu::TexelCopyTextureInfo {
                mip_level: level,
                origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
                aspect,
                texture,
            },
            wgpu::TexelCopyBufferInfo {
                buffer: &slot.buffer,
                layout: wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row_bytes), rows_per_image: None },
            },
            wgpu::Extent3d { width: size_px[0], height: size_px[1], depth_or_array_layers: 1 },
        );
        Ok(())
    }

    pub(super) fn submitted(&mut self) {
        self.draw = self.draw.wrapping_add(1);
        self.waiting.retain(|(_, asked)| self.draw.wrapping_sub(*asked) <= WAITING_DRAWS);
        for slot in self.slots.iter_mut().filter(|s| s.is_new) {
            slot.is_new = false;
            map(&slot.buffer, &slot.state);
        }
    }

    /// Hands over what has arrived.
    pub(super) fn deliver(&mut self) {
        for slot in &self.slots {
            match slot.state.load(Ordering::Acquire) {
                READY => {
                    if let Ok(view) = slot.buffer.get_mapped_range(..) {
                        let [width, height] = slot.size_px;
                        let row_bytes = width as usize * slot.format.texel_bytes();
                        let mut texels = Vec::with_capacity(row_bytes * height as usize);
                        let padded = row_bytes.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as usize);
                        for row in view.chunks_exact(padded) {
                            texels.extend_from_slice(&row[..row_bytes]);
                        }
                        let PictureSlot { size_px, format, frame, clip_from_eye, .. } = *slot;
                        slot.sink.put(Picture { size_px, frame, clip_from_eye, format, texels });
                    }
                    slot.buffer.unmap();
                    slot.state.store(IDLE, Ordering::Release);
                }
                FAILED => slot.state.store(IDLE, Ordering::Release),
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
    use crate::state::TextureObject;

    /// The first eight had all the room in every frame.
    #[test]
    fn of_many_pictures_each_comes_in_its_turn() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let texture = ctx.device().create_texture(&wgpu::TextureDescriptor {
            label: None,
            size: wgpu::Extent3d { width: 4, height: 4, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8Unorm,
            usage: wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let of = Attachment::new(TextureObject::target("any", [4, 4], TextureFormat::Rgba8));
        let mut reads = PictureReads::default();
        let sinks: Vec<Arc<PictureSink>> = (0..20).map(|_| Arc::default()).collect();
        let mut came = [0; 20];
        for frame in 0..20 {
            let mut encoder = ctx.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            // The last one asks no more after the first frames.
            for sink in &sinks[..if frame < 2 { 20 } else { 19 }] {
                let camera = CullCamera { frame, ..CullCamera::default() };
                reads.copy(ctx.memory(), &mut encoder, &texture, Read::color(&of), sink, &camera).unwrap();
            }
            ctx.queue().submit([encoder.finish()]);
            reads.submitted();
            ctx.device().poll(wgpu::PollType::wait_indefinitely()).unwrap();
            reads.deliver();
            sinks.iter().zip(&mut came).for_each(|(sink, came)| *came += u32::from(sink.take().is_some()));
        }
        assert!(came[..19].iter().all(|came| (6..=10).contains(came)), "{came:?}");
        assert!(reads.waiting.len() <= 20 && came[19] <= 1, "{came:?}");
        // Nobody waits for those who are gone.
        (0..=WAITING_DRAWS).for_each(|_| reads.submitted());
        assert!(reads.waiting.is_empty());
    }
}
