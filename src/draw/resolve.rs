//! Puts multisampled depth and stencil into the camera's texture, which has one sample a pixel: there it is sampled and
//! read back. Draw thread.
//!
//! wgpu resolves colours only. A pixel gets its first sample, as Vulkan's `SAMPLE_ZERO`, the one mode that every adapter
//! has (OpenSceneGraph's blit leaves it to the driver): a depth that something has, where a mean lies between surfaces, and
//! of the same surface as the stencil. Shaders cannot write a stencil; each of its bits is a draw that writes this bit.

use crate::gpu::{FrameTimer, GraphicsContext, watched};

const RESOLVE_WGSL: &str = include_str!("shaders/resolve.wgsl");

const STENCIL_BITS: u32 = 8;

/// Format and samples a pixel of what is resolved.
pub(super) type ResolveKind = (wgpu::TextureFormat, u32);

/// A depth buffer and the texture that gets it.
#[derive(Clone, Copy)]
pub(super) struct Resolving<'a> {
    pub(super) samples: &'a wgpu::TextureView,
    pub(super) texture: &'a wgpu::TextureView,
    /// x, y, width, height: what was drawn.
    pub(super) part_px: [u32; 4],
}

/// For a kind.
struct Passes {
    layout: wgpu::BindGroupLayout,
    depth: wgpu::RenderPipeline,
    /// By bit; none without a stencil.
    stencil: Vec<wgpu::RenderPipeline>,
}

/// Pipelines that resolve depth, for each kind.
pub(super) struct DepthResolve {
    module: wgpu::ShaderModule,
    /// `None` where the device refused.
    passes: Vec<(ResolveKind, Option<Passes>)>,
}

impl DepthResolve {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        Self {
            module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("resolve"),
                source: wgpu::ShaderSource::Wgsl(RESOLVE_WGSL.into()),
            }),
            passes: Vec::new(),
        }
    }

    /// Pipelines made so far.
    pub(super) fn created(&self) -> u32 {
        self.passes.iter().flat_map(|(_, passes)| passes).map(|passes| 1 + passes.stencil.len() as u32).sum()
    }

    /// Makes the pipelines of a kind unless they are there; what the device refuses only the first time.
    pub(super) fn ensure(&mut self, ctx: &GraphicsContext, kind: ResolveKind) -> Result<(), String> {
        if self.passes.iter().any(|(known, _)| *known == kind) {
            return Ok(());
        }
        let (passes, error) = watched(ctx.device(), || self.passes(ctx, kind.0));
        self.passes.push((kind, error.is_none().then_some(passes)));
        error.map_or(Ok(()), |error| Err(format!("depth of several samples cannot be kept in textures: {error}")))
    }

    /// Whatever the device says of them.
    fn passes(&self, ctx: &GraphicsContext, format: wgpu::TextureFormat) -> Passes {
        let device = ctx.device();
        let has_stencil = format.has_stencil_aspect();
        let samples = |(binding, sample_type)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type,
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: true,
            },
            count: None,
        };
        let read = [(0, wgpu::TextureSampleType::Depth), (1, wgpu::TextureSampleType::Uint)].map(samples);
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("resolve"),
            entries: &read[..if has_stencil { 2 } else { 1 }],
        });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("resolve"),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: 0,
        });
        let pipeline = |entry_point, writes_depth, pass_op, write_mask| {
            let face = wgpu::StencilFaceState { pass_op, ..wgpu::StencilFaceState::IGNORE };
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some("resolve"),
                layout: Some(&pipeline_layout),
                vertex: wgpu::VertexState {
                    module: &self.module,
                    entry_point: Some("vs_resolve"),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[],
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format,
                    depth_write_enabled: Some(writes_depth),
                    depth_compare: Some(wgpu::CompareFunction::Always),
                    stencil: wgpu::StencilState { front: face, back: face, read_mask: 0xff, write_mask },
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &self.module,
                    entry_point: Some(entry_point),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[],
                }),
                multiview_mask: None,
                cache: ctx.pipeline_cache(),
            })
        };
        // The depth's draw takes all bits away.
        let (zero, all_bits) = (wgpu::StencilOperation::Zero, 0xff);
        let (clears, mask) = if has_stencil { (zero, all_bits) } else { (wgpu::StencilOperation::Keep, 0) };
        let bits = 0..if has_stencil { STENCIL_BITS } else { 0 };
        let of_bit = |bit: u32| pipeline("fs_stencil", false, wgpu::StencilOperation::Replace, 1 << bit);
        Passes { depth: pipeline("fs_depth", true, clears, mask), stencil: bits.map(of_bit).collect(), layout }
    }

    /// Records what comes after a pass that drew into multisampled depth.
    pub(super) fn record(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        kind: ResolveKind,
        resolving: &Resolving<'_>,
        timer: Option<&mut FrameTimer>,
    ) {
        let known = self.passes.iter().find(|(known, _)| *known == kind);
        let Some((_, Some(Passes { layout, depth, stencil }))) = known else { return };
        let Resolving { samples, texture, part_px: [x, y, width, height] } = *resolving;
        let aspects = [wgpu::TextureAspect::DepthOnly, wgpu::TextureAspect::StencilOnly];
        let views = aspects[..if stencil.is_empty() { 1 } else { 2 }].iter().map(|aspect| {
            let descriptor = wgpu::TextureViewDescriptor { aspect: *aspect, ..Default::default() };
            samples.texture().create_view(&descriptor)
        });
        let views: Vec<_> = views.collect();
        let entry =
            |(binding, view)| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let held = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("resolve"),
            layout,
            entries: &(0..).zip(&views).map(entry).collect::<Vec<_>>(),
        });
        // Beside the part it stays as it is.
        let kept = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
        let kept_stencil = wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("resolve"),
            color_attachments: &[],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: texture,
                depth_ops: Some(kept),
                stencil_ops: (!stencil.is_empty()).then_some(kept_stencil),
            }),
            timestamp_writes: timer.and_then(|timer| timer.pass("resolve")),
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_scissor_rect(x, y, width, height);
        pass.set_bind_group(0, &held, &[]);
        pass.set_pipeline(depth);
        pass.draw(0..3, 0..1);
        pass.set_stencil_reference(0xff);
        for (bit, pipeline) in (0..).zip(stencil) {
            pass.set_pipeline(pipeline);
            pass.draw(0..3, bit..bit + 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits};

    #[test]
    fn a_pipeline_that_is_refused_is_said_once() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut resolve = DepthResolve::new(ctx.device());
        // It holds no depth.
        let kind = (wgpu::TextureFormat::Rgba8Unorm, 4);
        assert!(resolve.ensure(&ctx, kind).unwrap_err().contains("depth of several samples"));
        assert_eq!((resolve.ensure(&ctx, kind), resolve.created()), (Ok(()), 0));
        assert!(ctx.take_device_errors().is_empty());
    }

    #[test]
    fn the_shader_is_valid() {
        let module = naga::front::wgsl::parse_str(super::RESOLVE_WGSL).unwrap();
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .unwrap();
    }
}
