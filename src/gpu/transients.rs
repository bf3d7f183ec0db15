//! Depth buffers and multisampled colour that live for a pass: kept by size and format, freed when long unused, and
//! sooner where targets of another size come each frame. Draw thread only.

use super::memory::Memory;

/// Frames after which an unused one is freed.
const KEPT_FRAMES: u32 = 120;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Kind {
    size_px: [u32; 2],
    format: wgpu::TextureFormat,
    samples: u32,
    /// By a shader, once it is drawn.
    is_read: bool,
}

impl Kind {
    fn bytes(&self) -> u64 {
        // Of depth with stencil, wgpu does not say.
        let texel = self.format.block_copy_size(None).unwrap_or(8);
        u64::from(self.size_px[0]) * u64::from(self.size_px[1]) * u64::from(self.samples * texel)
    }
}

struct Transient {
    kind: Kind,
    view: wgpu::TextureView,
    used: u32,
    /// Taken by a pass of this frame that must not share it.
    owner: u32,
}

/// The buffers of a renderer.
#[derive(Default)]
pub(crate) struct Transients {
    all: Vec<Transient>,
    frame: u32,
    /// The most bytes that one of the last frames used, and which.
    most: (u64, u32),
}

impl Transients {
    /// Frees what was not used for long; and, the longest unused first, what is more than one of the last frames
    /// needed, for each of so many targets that take turns.
    pub(crate) fn start_frame(&mut self, targets: usize) {
        let last = self.frame;
        let bytes_of = |all: &[Transient], is_used: bool| -> u64 {
            all.iter().filter(|t| (t.used == last) == is_used).map(|t| t.kind.bytes()).sum()
        };
        let used = bytes_of(&self.all, true);
        if used >= self.most.0 || last.wrapping_sub(self.most.1) > KEPT_FRAMES {
            self.most = (used, last);
        }
        let frame = last.wrapping_add(1);
        self.frame = frame;
        self.all.retain(|t| frame.wrapping_sub(t.used) <= KEPT_FRAMES);
        let room = self.most.0.saturating_mul(targets as u64);
        let mut unused = bytes_of(&self.all, false);
        while unused > room {
            let ages = self.all.iter().map(|t| frame.wrapping_sub(t.used));
            let Some((oldest, _)) = ages.enumerate().max_by_key(|(_, age)| *age) else { break };
            unused -= self.all.remove(oldest).kind.bytes();
        }
    }

    /// A buffer for a target: passes with the same `owner` get the same one. Why there is none.
    pub(crate) fn view(
        &mut self,
        memory: &Memory,
        size_px: [u32; 2],
        format: wgpu::TextureFormat,
        samples: u32,
        owner: u32,
    ) -> Result<wgpu::TextureView, String> {
        self.of_kind(memory, Kind { size_px, format, samples, is_read: false }, owner)
    }

    /// The same of one that a shader reads.
    pub(crate) fn readable_view(
        &mut self,
        memory: &Memory,
        size_px: [u32; 2],
        format: wgpu::TextureFormat,
        samples: u32,
        owner: u32,
    ) -> Result<wgpu::TextureView, String> {
        self.of_kind(memory, Kind { size_px, format, samples, is_read: true }, owner)
    }

    fn of_kind(&mut self, memory: &Memory, kind: Kind, owner: u32) -> Result<wgpu::TextureView, String> {
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
        let texture = memory.make(what, kind.bytes(), |device| device.create_texture(&descriptor))?;
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        self.all.push(Transient { kind, view: view.clone(), used: frame, owner });
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

    fn bytes(transients: &Transients) -> u64 {
        transients.all.iter().map(|t| t.kind.bytes()).sum()
    }

    /// As while a window's edge is dragged: each size was kept for as long as all others.
    #[test]
    fn sizes_that_never_come_again_do_not_pile_up() {
        let ctx = context();
        let mut transients = Transients::default();
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
        // Once they stand still, what is left of the others goes with time.
        for _ in 0..2 * KEPT_FRAMES {
            transients.start_frame(1);
            transients.view(ctx.memory(), [100, 100], DEPTH_FORMAT, 1, 0).unwrap();
        }
        assert_eq!(transients.all.len(), 1);
    }

    #[test]
    fn sizes_that_take_turns_are_kept() {
        let ctx = context();
        // Of one target, and of three.
        for (targets, widths) in [(1, &[100, 90][..]), (3, &[300, 200, 100])] {
            let mut transients = Transients::default();
            let mut draw = |width: u32| {
                transients.start_frame(targets);
                transients.view(ctx.memory(), [width, 100], DEPTH_FORMAT, 1, 0).unwrap()
            };
            let first: Vec<_> = widths.iter().map(|width| draw(*width)).collect();
            for _ in 0..100 {
                for (width, view) in widths.iter().zip(&first) {
                    assert!(draw(*width) == *view, "{width} of {widths:?} was made anew");
                }
            }
        }
    }
}
