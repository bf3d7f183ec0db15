//! Depth buffers and multisampled colour that live for a pass: kept by size and format, freed when long unused.
//! Draw thread only.

/// Frames after which an unused one is freed.
const KEPT_FRAMES: u32 = 120;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Kind {
    size_px: [u32; 2],
    format: wgpu::TextureFormat,
    samples: u32,
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
    /// Frees what was not used for long.
    pub(crate) fn start_frame(&mut self) {
        self.frame = self.frame.wrapping_add(1);
        let frame = self.frame;
        self.all.retain(|t| frame.wrapping_sub(t.used) <= KEPT_FRAMES);
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
