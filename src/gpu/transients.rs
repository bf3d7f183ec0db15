//! Depth buffers and multisampled colour that live for a pass: kept by size and format, freed when long unused, or when
//! they are many: a window whose edge is dragged has another size in each frame. Draw thread only.

/// Frames after which an unused one is freed.
const KEPT_FRAMES: u32 = 120;
/// Unused ones may have so many times the bytes that the last frame used, for cameras that are not drawn in each frame.
const UNUSED_TIMES: u64 = 3;
/// And so many in any case.
const UNUSED_BYTES: u64 = 32 << 20;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Kind {
    size_px: [u32; 2],
    format: wgpu::TextureFormat,
    samples: u32,
}

impl Kind {
    fn bytes(&self) -> u64 {
        // Depth with stencil has no size of its own.
        let pixel = self.format.block_copy_size(None).unwrap_or(8);
        self.size_px.iter().map(|side| u64::from(*side)).product::<u64>() * u64::from(pixel * self.samples)
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
}

impl Transients {
    /// Frees what was not used for long, and of too many the longest unused.
    pub(crate) fn start_frame(&mut self) {
        let last = self.frame;
        self.frame = last.wrapping_add(1);
        let unused_for = |t: &Transient| last.wrapping_sub(t.used);
        self.all.retain(|t| unused_for(t) < KEPT_FRAMES);
        self.all.sort_by_key(unused_for);
        let used: u64 = self.all.iter().filter(|t| t.used == last).map(|t| t.kind.bytes()).sum();
        let mut room = used + UNUSED_BYTES.max(UNUSED_TIMES * used);
        self.all.retain(|t| {
            let left = room.checked_sub(t.kind.bytes());
            room = left.unwrap_or(0);
            left.is_some()
        });
    }

    /// A buffer for a target: passes with the same `owner` get the same one.
    pub(crate) fn view(
        &mut self,
        device: &wgpu::Device,
        size_px: [u32; 2],
        format: wgpu::TextureFormat,
        samples: u32,
        owner: u32,
    ) -> wgpu::TextureView {
        let kind = Kind { size_px, format, samples };
        let frame = self.frame;
        let found = self.all.iter_mut().find(|t| t.kind == kind && (t.used != frame || t.owner == owner));
        if let Some(found) = found {
            (found.used, found.owner) = (frame, owner);
            return found.view.clone();
        }
        let texture = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("transient"),
            size: wgpu::Extent3d { width: size_px[0], height: size_px[1], depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: samples,
            dimension: wgpu::TextureDimension::D2,
            format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        self.all.push(Transient { kind, view: view.clone(), used: frame, owner });
        view
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

    fn context() -> GraphicsContext {
        let traits = ContextTraits { adapter: AdapterChoice::Noop, validation: false, ..ContextTraits::default() };
        GraphicsContext::new_offscreen(&traits).unwrap()
    }

    impl Transients {
        fn bytes(&self) -> u64 {
            self.all.iter().map(|t| t.kind.bytes()).sum()
        }
    }

    /// 120 sizes were kept.
    #[test]
    fn a_dragged_edge_leaves_few_behind() {
        let (context, mut transients) = (context(), Transients::default());
        let mut most = 0;
        for frame in 0..200 {
            transients.start_frame();
            let size_px = [1000 + frame, 1000];
            transients.view(context.device(), size_px, DEPTH, 4, 0);
            transients.view(context.device(), size_px, wgpu::TextureFormat::Rgba8UnormSrgb, 4, 0);
            most = most.max(transients.bytes());
        }
        // Those in use, three times as much beside them, and those of the frame before.
        assert!(most <= 5 * 2 * 16 * 1200 * 1000, "{most}");
        // Small ones are kept, for their time.
        let mut small = Transients::default();
        for frame in 0..200 {
            small.start_frame();
            small.view(context.device(), [10 + frame, 10], DEPTH, 1, 0);
        }
        assert_eq!(small.all.len(), KEPT_FRAMES as usize + 1);
    }

    #[test]
    fn what_is_used_in_turns_is_made_once() {
        let (context, mut transients) = (context(), Transients::default());
        let sizes = [[1000, 800], [900, 700], [800, 900]];
        for frame in 0..30 {
            transients.start_frame();
            transients.view(context.device(), sizes[frame % 3], DEPTH, 4, 0);
            assert_eq!(transients.all.len(), sizes.len().min(frame + 1));
        }
        // Passes that must not share one have one each.
        transients.start_frame();
        let before = transients.all.len();
        for owner in [1, 2, 1] {
            transients.view(context.device(), sizes[0], DEPTH, 4, owner);
        }
        assert_eq!(transients.all.len(), before + 1);
    }
}
