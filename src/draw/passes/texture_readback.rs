//! Read-back of camera textures: copies them to buffers, and hands the images over as [`Picture`] some frames later. Draw
//! thread; nothing waits for them.

use std::sync::Arc;

use glam::DMat4;

use crate::cull::{CullCamera, RenderStage};
use crate::draw::mapping::{Mapping, MappingState};
use crate::draw::resources::Resources;
use crate::gpu::{GraphicsContext, Memory};
use crate::scene::{Attachment, CameraTarget, Picture, PictureSink, ReadBack};
use crate::state::TextureFormat;

/// Copies that may be in flight.
const MAX_PICTURES: usize = 8;
/// A sink that has not asked for this many draws, of all targets, loses its turn.
const WAITING_DRAWS: u32 = 32;

/// The reason why a part of a camera's target is not read back.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum ReadBackError {
    #[error("a camera without colour {0}, which is to be read back")]
    NoColor(usize),
    #[error("a camera without a depth texture, which is to be read back")]
    NoDepth,
    #[error("texture {name:?} holds depth in 24 bits, which cannot be copied to be read back; Depth32Stencil8 can")]
    Uncopied { name: String },
    #[error("texture {name:?} has no stencil, which is to be read back")]
    NoStencil { name: String },
}

/// A part of a camera's target, and the format it is read in.
#[derive(Clone, Copy)]
struct Source<'a> {
    attachment: &'a Attachment,
    aspect: wgpu::TextureAspect,
    format: TextureFormat,
}

impl<'a> Source<'a> {
    /// Reads a colour in its texture's format.
    fn color(attachment: &'a Attachment) -> Self {
        Self { attachment, aspect: wgpu::TextureAspect::All, format: attachment.texture.format }
    }

    fn of(camera: &'a CameraTarget, part: ReadBack) -> Result<Self, ReadBackError> {
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

/// An image that was copied, and who gets it.
struct Copied {
    sink: Arc<PictureSink>,
    size_px: [u32; 2],
    format: TextureFormat,
    frame: u32,
    clip_from_eye: DMat4,
}

impl Copied {
    /// Returns the bytes of a row in the buffer, which copies pad.
    fn padded_row_bytes(&self) -> u32 {
        let row_bytes = self.size_px[0] * self.format.texel_bytes() as u32;
        row_bytes.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
    }

    fn buffer_bytes(&self) -> u64 {
        u64::from(self.padded_row_bytes()) * u64::from(self.size_px[1])
    }

    /// Hands the image over.
    fn deliver(self, buffer: &[u8]) {
        let padded = self.padded_row_bytes() as usize;
        let Self { sink, size_px: [width, height], format, frame, clip_from_eye } = self;
        let row_bytes = width as usize * format.texel_bytes();
        let mut texels = Vec::with_capacity(row_bytes * height as usize);
        for row in buffer.chunks_exact(padded) {
            texels.extend_from_slice(&row[..row_bytes]);
        }
        sink.put(Picture { size_px: [width, height], frame, clip_from_eye, format, texels });
    }
}

struct PictureSlot {
    buffer: wgpu::Buffer,
    /// The image that is on its way.
    copied: Option<Copied>,
    /// True from the copy until its draw is submitted.
    is_recorded: bool,
    mapping: Mapping,
}

impl PictureSlot {
    /// Creates a slot for images of a size in bytes; returns an error if there is no memory for the buffer.
    fn new(memory: &Memory, size: u64) -> Result<Self, String> {
        let descriptor = wgpu::BufferDescriptor {
            label: Some("picture"),
            size,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        };
        let buffer = memory.allocate("image to be read back", size, |device| device.create_buffer(&descriptor))?;
        Ok(Self { buffer, copied: None, is_recorded: false, mapping: Mapping::default() })
    }

    fn is_idle(&self) -> bool {
        !self.is_recorded && self.mapping.state() == MappingState::Idle
    }
}

/// A sink that found no free slot.
struct WaitingSink {
    sink: Arc<PictureSink>,
    /// The draw in which it last asked.
    draw: u32,
}

/// The camera textures of a renderer that are being read back.
#[derive(Default)]
pub(in crate::draw) struct TextureReadback {
    slots: Vec<PictureSlot>,
    /// In the order in which they first asked.
    waiting: Vec<WaitingSink>,
    /// The number of the current draw.
    draw: u32,
}

impl TextureReadback {
    /// Records the copies that the sinks of a stage's camera ask for, once the stage and all that draws into the same
    /// target is recorded.
    pub(in crate::draw) fn record(
        &mut self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        encoder: &mut wgpu::CommandEncoder,
        stage: &RenderStage,
    ) {
        let Some(camera) = stage.target.camera.as_ref().filter(|_| !stage.target.is_shared) else { return };
        for (part, sink) in camera.read_backs() {
            let source = match Source::of(camera, part) {
                Ok(source) => source,
                Err(error) => {
                    resources.errors.report_once(error);
                    continue;
                }
            };
            // A texture that could not be created was reported when the target was.
            let textures = &resources.state_groups.textures;
            let Some(texture) = textures.texture(&source.attachment.texture) else { continue };
            if let Err(error) = self.copy(ctx.memory(), encoder, texture, source, sink, &stage.camera) {
                resources.errors.report_once(error);
            }
        }
    }

    /// Returns true if a slot is free for a sink besides those for sinks that have waited longer. Otherwise the sink
    /// waits.
    fn take_turn(&mut self, sink: &Arc<PictureSink>) -> bool {
        let busy = self.slots.iter().filter(|slot| !slot.is_idle()).count();
        let free = MAX_PICTURES.saturating_sub(busy);
        let position = self.waiting.iter().position(|waiting| Arc::ptr_eq(&waiting.sink, sink));
        let has_turn = position.unwrap_or(self.waiting.len()) < free;
        match position {
            Some(position) if has_turn => _ = self.waiting.remove(position),
            Some(position) => self.waiting[position].draw = self.draw,
            None if has_turn => {}
            None => self.waiting.push(WaitingSink { sink: sink.clone(), draw: self.draw }),
        }
        has_turn
    }

    /// Records the copy of a part of a camera's target, unless too many copies are in flight. Returns an error if
    /// there is no memory for the buffer.
    fn copy(
        &mut self,
        memory: &Memory,
        encoder: &mut wgpu::CommandEncoder,
        texture: &wgpu::Texture,
        source: Source<'_>,
        sink: &Arc<PictureSink>,
        camera: &CullCamera,
    ) -> Result<(), String> {
        if !self.take_turn(sink) {
            return Ok(());
        }
        let Source { attachment: Attachment { level, layer, .. }, aspect, format } = source;
        let (level, layer) = (*level, *layer);
        let CullCamera { frame, clip_from_eye, .. } = *camera;
        let size_px = [texture.width(), texture.height()].map(|side| (side >> level).max(1));
        let copied = Copied { sink: sink.clone(), size_px, format, frame, clip_from_eye };
        let row_bytes = copied.padded_row_bytes();
        let Some(slot) = self.free_slot(memory, copied.buffer_bytes())? else { return Ok(()) };
        (slot.copied, slot.is_recorded) = (Some(copied), true);
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

    /// Returns a slot whose buffer has a size in bytes: a free one of that size, or another one with a new buffer. Returns `None`
    /// while all are in flight.
    fn free_slot(&mut self, memory: &Memory, size: u64) -> Result<Option<&mut PictureSlot>, String> {
        let fitting = self.slots.iter().position(|slot| slot.is_idle() && slot.buffer.size() == size);
        let index = match fitting.or_else(|| self.slots.iter().position(PictureSlot::is_idle)) {
            Some(index) => index,
            None if self.slots.len() >= MAX_PICTURES => return Ok(None),
            None => self.slots.len(),
        };
        if index == self.slots.len() {
            self.slots.push(PictureSlot::new(memory, size)?);
        } else if fitting.is_none() {
            self.slots[index] = PictureSlot::new(memory, size)?;
        }
        Ok(self.slots.get_mut(index))
    }

    /// Maps the copies of a submitted draw for reading, and drops sinks that no longer ask.
    pub(in crate::draw) fn submitted(&mut self) {
        self.draw = self.draw.wrapping_add(1);
        self.waiting.retain(|waiting| self.draw.wrapping_sub(waiting.draw) <= WAITING_DRAWS);
        for slot in self.slots.iter_mut().filter(|slot| slot.is_recorded) {
            slot.is_recorded = false;
            slot.mapping.start(&slot.buffer);
        }
    }

    /// Hands over the images that have arrived.
    pub(in crate::draw) fn deliver(&mut self) {
        for slot in &mut self.slots {
            match slot.mapping.state() {
                MappingState::Ready => {
                    if let (Some(copied), Ok(view)) = (slot.copied.take(), slot.buffer.get_mapped_range(..)) {
                        copied.deliver(&view);
                    }
                    slot.buffer.unmap();
                    slot.mapping.reset();
                }
                MappingState::Failed => slot.mapping.reset(),
                MappingState::Idle | MappingState::InFlight => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits};
    use crate::state::TextureObject;

    /// Regression test: the first eight sinks took all slots in every frame.
    #[test]
    fn more_sinks_than_slots_take_turns() {
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
        let attachment = Attachment::new(TextureObject::target("any", [4, 4], TextureFormat::Rgba8));
        let mut readback = TextureReadback::default();
        let sinks: Vec<Arc<PictureSink>> = (0..20).map(|_| Arc::default()).collect();
        let mut received = [0; 20];
        for frame in 0..20 {
            let mut encoder = ctx.device().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            // The last sink stops asking after two frames.
            for sink in &sinks[..if frame < 2 { 20 } else { 19 }] {
                let camera = CullCamera { frame, ..CullCamera::default() };
                readback.copy(ctx.memory(), &mut encoder, &texture, Source::color(&attachment), sink, &camera).unwrap();
            }
            ctx.queue().submit([encoder.finish()]);
            readback.submitted();
            ctx.device().poll(wgpu::PollType::wait_indefinitely()).unwrap();
            readback.deliver();
            sinks.iter().zip(&mut received).for_each(|(sink, count)| *count += u32::from(sink.take().is_some()));
        }
        assert!(received[..19].iter().all(|count| (6..=10).contains(count)), "{received:?}");
        assert!(readback.waiting.len() <= 20 && received[19] <= 1, "{received:?}");
        // Sinks that stopped asking lose their turn.
        (0..=WAITING_DRAWS).for_each(|_| readback.submitted());
        assert!(readback.waiting.is_empty());
    }
}
