//! Resolves multisampled depth and stencil into the camera's texture, which has one sample a pixel and is sampled and
//! read back. Draw thread.
//!
//! wgpu resolves colours only. A pixel gets its first sample, as with Vulkan's `SAMPLE_ZERO`, the one mode that every
//! adapter has (OpenSceneGraph's blit leaves the choice to the driver). The first sample is the depth of a surface, and of
//! the same surface as the stencil; a mean would lie between surfaces. Shaders cannot write a stencil, so that each of its
//! bits is a draw with a write mask.

use super::fullscreen::{FullscreenPipeline, PipelinesByKind};
use super::stage_input::StageInput;
use crate::cull::RenderStage;
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::{DepthSamples, PassTarget};
use crate::gpu::{FrameTimer, GraphicsContext, catch_errors};

const DEPTH_RESOLVE_WGSL: &str = include_str!("../shaders/passes/depth_resolve.wgsl");

const STENCIL_BITS: u32 = 8;

/// Format and samples a pixel of a depth buffer.
type Kind = (wgpu::TextureFormat, u32);

/// The pipelines for a kind of depth buffer.
struct ResolvePipelines {
    layout: wgpu::BindGroupLayout,
    depth: wgpu::RenderPipeline,
    /// One for each bit; empty without a stencil.
    stencil: Vec<wgpu::RenderPipeline>,
}

impl ResolvePipelines {
    /// Creates the pipelines for a format, without looking for errors of the device.
    fn new(ctx: &GraphicsContext, module: &wgpu::ShaderModule, format: wgpu::TextureFormat) -> Self {
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
        let pipeline = |entry_point, writes_depth, pass_op, write_mask| {
            let face = wgpu::StencilFaceState { pass_op, ..wgpu::StencilFaceState::IGNORE };
            FullscreenPipeline {
                label: "resolve",
                module,
                entry_points: ["vs_resolve", entry_point],
                constants: &[],
                bind_group_layouts: &[Some(&layout)],
                colors: &[],
                depth_stencil: Some(wgpu::DepthStencilState {
                    format,
                    depth_write_enabled: Some(writes_depth),
                    depth_compare: Some(wgpu::CompareFunction::Always),
                    stencil: wgpu::StencilState { front: face, back: face, read_mask: 0xff, write_mask },
                    bias: wgpu::DepthBiasState::default(),
                }),
                samples: 1,
            }
            .create(ctx)
        };
        // The draw of the depth clears the stencil; the others set the bits of each pixel.
        let (zero, all_bits) = (wgpu::StencilOperation::Zero, 0xff);
        let (clears, mask) = if has_stencil { (zero, all_bits) } else { (wgpu::StencilOperation::Keep, 0) };
        let bits = 0..if has_stencil { STENCIL_BITS } else { 0 };
        let stencil_bit = |bit: u32| pipeline("fs_stencil", false, wgpu::StencilOperation::Replace, 1 << bit);
        Self { depth: pipeline("fs_depth", true, clears, mask), stencil: bits.map(stencil_bit).collect(), layout }
    }
}

/// The shader module and the pipelines for each kind of depth buffer.
struct Resolver {
    module: wgpu::ShaderModule,
    by_kind: PipelinesByKind<Kind, ResolvePipelines>,
}

impl Resolver {
    fn new(device: &wgpu::Device) -> Self {
        Self {
            module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("resolve"),
                source: wgpu::ShaderSource::Wgsl(DEPTH_RESOLVE_WGSL.into()),
            }),
            by_kind: PipelinesByKind::new(),
        }
    }

    /// Returns the number of pipelines created so far.
    fn created(&self) -> u32 {
        self.by_kind.iter().map(|p| 1 + p.stencil.len() as u32).sum()
    }

    /// Creates the pipelines of a kind if needed. Pipelines that the device refuses are an error the first time only.
    fn ensure(&mut self, ctx: &GraphicsContext, kind: Kind) -> Result<(), String> {
        let Self { module, by_kind } = self;
        by_kind
            .ensure(ctx.device(), kind, || ResolvePipelines::new(ctx, module, kind.0))
            .map_err(|error| format!("multisampled depth cannot be resolved into textures: {error}"))
    }

    /// Records the render pass that resolves a depth buffer.
    fn record(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        kind: Kind,
        resolving: &DepthSamples<'_>,
        timer: Option<&mut FrameTimer>,
    ) {
        let Some(ResolvePipelines { layout, depth, stencil }) = self.by_kind.get(&kind) else { return };
        let DepthSamples { samples, texture, part_px: [x, y, width, height] } = *resolving;
        let aspects = [wgpu::TextureAspect::DepthOnly, wgpu::TextureAspect::StencilOnly];
        let views = aspects[..if stencil.is_empty() { 1 } else { 2 }].iter().map(|aspect| {
            let descriptor = wgpu::TextureViewDescriptor { aspect: *aspect, ..Default::default() };
            samples.texture().create_view(&descriptor)
        });
        let views: Vec<_> = views.collect();
        let entry =
            |(binding, view)| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("resolve"),
            layout,
            entries: &(0..).zip(&views).map(entry).collect::<Vec<_>>(),
        });
        // Outside the part that was drawn, the texture keeps its contents.
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
            timestamp_writes: timer.and_then(|timer| timer.pass("depth resolve")),
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_scissor_rect(x, y, width, height);
        pass.set_bind_group(0, &group, &[]);
        pass.set_pipeline(depth);
        pass.draw(0..3, 0..1);
        pass.set_stencil_reference(0xff);
        for (bit, pipeline) in (0..).zip(stencil) {
            pass.set_pipeline(pipeline);
            pass.draw(0..3, bit..bit + 1);
        }
    }
}

/// The resolution of multisampled depth.
#[derive(Default)]
pub(in crate::draw) struct DepthResolve {
    /// Created for the first camera that keeps multisampled depth.
    resolver: Option<Resolver>,
}

impl DepthResolve {
    /// Returns the number of pipelines created so far.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.resolver.as_ref().map_or(0, Resolver::created)
    }

    /// Creates the pipelines for a stage whose depth is resolved.
    pub(in crate::draw) fn prepare(&mut self, resources: &mut Resources, input: &StageInput<'_>) {
        if input.target.resolved_depth(input.stage).is_some()
            && let Some(formats) = resources.pipelines.target_formats(input.target.index)
        {
            let device = input.ctx.device();
            let resolver = self.resolver.get_or_insert_with(|| catch_errors(device, || Resolver::new(device)).0);
            if let Err(error) = resolver.ensure(input.ctx, (formats.depth, formats.samples)) {
                resources.errors.report_once(error);
            }
        }
    }

    /// Records the resolution after the render pass of a stage, if its depth is resolved.
    pub(in crate::draw) fn record(
        &self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        encoder: &mut wgpu::CommandEncoder,
        stage: &RenderStage,
        target: &PassTarget,
    ) {
        if let (Some(resolving), Some(resolver), Some(formats)) =
            (target.resolved_depth(stage), &self.resolver, resources.pipelines.target_formats(target.index))
        {
            let kind = (formats.depth, formats.samples);
            resolver.record(ctx.device(), encoder, kind, &resolving, resources.timer.as_mut());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits};

    #[test]
    fn refused_pipeline_is_reported_once() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut resolver = Resolver::new(ctx.device());
        // A colour format cannot be resolved as depth.
        let kind = (wgpu::TextureFormat::Rgba8Unorm, 4);
        assert!(resolver.ensure(&ctx, kind).unwrap_err().contains("multisampled depth"));
        assert_eq!((resolver.ensure(&ctx, kind), resolver.created()), (Ok(()), 0));
        assert!(ctx.take_device_errors().is_empty());
    }

    #[test]
    fn the_shader_is_valid() {
        let module = naga::front::wgsl::parse_str(DEPTH_RESOLVE_WGSL).unwrap();
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .unwrap();
    }
}
