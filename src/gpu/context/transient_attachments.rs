//! [`TransientAttachments`]: depth buffers and multisampled colours, whose contents are used for one frame. Draw thread.
//!
//! They are reused by size and format, and freed when they were unused for some time; sooner if each frame has targets of
//! another size.

use crate::gpu::memory::Memory;

/// An attachment is freed after it was unused for this number of frames.
const MAX_UNUSED_FRAMES: u32 = 120;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Kind {
    size_px: [u32; 2],
    format: wgpu::TextureFormat,
    samples: u32,
    /// True if a shader reads it after it was drawn.
    is_read: bool,
}

impl Kind {
    fn bytes(&self) -> u64 {
        // wgpu does not return the size of depth with stencil.
        let texel = self.format.block_copy_size(None).unwrap_or(8);
        u64::from(self.size_px[0]) * u64::from(self.size_px[1]) * u64::from(self.samples * texel)
    }
}

struct Attachment {
    kind: Kind,
    view: wgpu::TextureView,
    /// The last frame that used it.
    used: u32,
    /// The owner in that frame. Passes of other owners must not share the attachment.
    owner: u32,
}

/// The transient attachments of a renderer.
#[derive(Default)]
pub(crate) struct TransientAttachments {
    all: Vec<Attachment>,
    frame: u32,
    /// The largest size that one of the last frames used, in bytes.
    peak_bytes: u64,
    /// The frame of `peak_bytes`.
    peak_frame: u32,
}

impl TransientAttachments {
    /// Frees attachments that were unused for some time. If the unused ones are larger than `targets` times the peak of the
    /// last frames, the longest unused are freed at once. `targets` is the number of targets that take turns.
    pub(crate) fn start_frame(&mut self, targets: usize) {
        let last = self.frame;
        let bytes_of = |all: &[Attachment], is_used: bool| -> u64 {
            all.iter().filter(|t| (t.used == last) == is_used).map(|t| t.kind.bytes()).sum()
        };
        let used = bytes_of(&self.all, true);
        if used >= self.peak_bytes || last.wrapping_sub(self.peak_frame) > MAX_UNUSED_FRAMES {
            (self.peak_bytes, self.peak_frame) = (used, last);
        }
        let frame = last.wrapping_add(1);
        self.frame = frame;
        self.all.retain(|t| frame.wrapping_sub(t.used) <= MAX_UNUSED_FRAMES);
        let max_unused = self.peak_bytes.saturating_mul(targets as u64);
        let mut unused = bytes_of(&self.all, false);
        while unused > max_unused {
            let ages = self.all.iter().map(|t| frame.wrapping_sub(t.used));
            let Some((oldest, _)) = ages.enumerate().max_by_key(|(_, age)| *age) else { break };
            unused -= self.all.remove(oldest).kind.bytes();
        }
    }

    /// Returns an attachment of a size and format. Passes of a frame with the same `owner` get the same one. Returns an error
    /// text if there is no memory.
    pub(crate) fn view(
        &mut self,
        memory: &Memory,
        size_px: [u32; 2],
        format: wgpu::TextureFormat,
        samples: u32,
        owner: u32,
    ) -> Result<wgpu::TextureView, String> {
        self.get(memory, Kind { size_px, format, samples, is_read: false }, owner)
    }

    /// Does the same as [`Self::view`] for an attachment that a shader reads.
    pub(crate) fn readable_view(
        &mut self,
        memory: &Memory,
        size_px: [u32; 2],
        format: wgpu::TextureFormat,
        samples: u32,
        owner: u32,
    ) -> Result<wgpu::TextureView, String> {
        self.get(memory, Kind { size_px, format, samples, is_read: true }, owner)
    }

    fn get(&mut self, memory: &Memory, kind: Kind, owner: u32) -> Result<wgpu::TextureView, String> {
        let Kind { size_px, format, samples, is_read } = kind;
        let frame = self.frame;
        let found = self.all.iter_mut().find(|t| t.kind == kind && (t.used != frame || t.owner == owner));
        if let Some(found) = found {
            (found.used, found.owner) = (frame, owner);
            return Ok(found.view.clone());
        }
        let attached = wgpu::TextureUsages::RENDER_ATTACHMENT;
        let descriptor = wgpu::TextureDescriptor {
            label: Some("transient"),
            size: wgpu::Extent3d { width: size_px[0], height: size_px[1], depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: samples,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: if is_read { attached | wgpu::TextureUsages::TEXTURE_BINDING } else { attached },
            view_formats: &[],
        };
        let what = "depth and samples of a target";
        let texture = memory.allocate(what, kind.bytes(), |device| device.create_texture(&descriptor))?;
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        self.all.push(Attachment { kind, view: view.clone(), used: frame, owner });
        Ok(view)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, DEPTH_FORMAT, GraphicsContext};

    fn context() -> GraphicsContext {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        GraphicsContext::new_offscreen(&traits).unwrap()
    }

    fn bytes(transients: &TransientAttachments) -> u64 {
        transients.all.iter().map(|t| t.kind.bytes()).sum()
    }

    /// Regression: while a window's edge was dragged, the attachments of each size were kept.
    #[test]
    fn attachments_of_passing_sizes_are_freed() {
        let ctx = context();
        let mut transients = TransientAttachments::default();
        for wider in [true, false] {
            for step in 0..200 {
                let width = 100 + if wider { step } else { 200 - step };
                transients.start_frame(1);
                for (owner, format) in [DEPTH_FORMAT, wgpu::TextureFormat::Rgba8Unorm].into_iter().enumerate() {
                    transients.view(ctx.memory(), [width, 100], format, 4, owner as u32).unwrap();
                }
                let largest = 2 * 300 * 100 * 4 * 4;
                assert!(bytes(&transients) <= 3 * largest, "{} bytes at width {width}", bytes(&transients));
            }
        }
        // With a constant size the others are freed in time.
        for _ in 0..2 * MAX_UNUSED_FRAMES {
            transients.start_frame(1);
            transients.view(ctx.memory(), [100, 100], DEPTH_FORMAT, 1, 0).unwrap();
        }
        assert_eq!(transients.all.len(), 1);
    }

    #[test]
    fn attachments_of_alternating_sizes_are_kept() {
        let ctx = context();
        // One target that alternates, and three targets.
        for (targets, widths) in [(1, &[100, 90][..]), (3, &[300, 200, 100])] {
            let mut transients = TransientAttachments::default();
            let mut draw = |width: u32| {
                transients.start_frame(targets);
                transients.view(ctx.memory(), [width, 100], DEPTH_FORMAT, 1, 0).unwrap()
            };
            let first: Vec<_> = widths.iter().map(|width| draw(*width)).collect();
            for _ in 0..100 {
                for (width, view) in widths.iter().zip(&first) {
                    assert!(draw(*width) == *view, "{width} of {widths:?} was created again");
                }
            }
        }
    }
}
