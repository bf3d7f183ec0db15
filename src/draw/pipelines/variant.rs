//! A pipeline by the parts in which pipelines differ, and how the device makes it. Draw thread.

use super::{MOST_COLORS, Pipelines, TargetFormats};
use crate::gpu::{GraphicsContext, watched};

/// The parts in which pipelines differ.
pub(super) struct Variant<'a> {
    pub(super) label: &'a str,
    pub(super) shader: &'a wgpu::ShaderModule,
    pub(super) vertex: &'a str,
    pub(super) fragment: &'a str,
    pub(super) block_layout: Option<&'a wgpu::BindGroupLayout>,
    pub(super) state_layout: Option<&'a wgpu::BindGroupLayout>,
    pub(super) pull_layout: Option<&'a wgpu::BindGroupLayout>,
    pub(super) constants: &'a [(&'a str, f64)],
    pub(super) buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    pub(super) topology: wgpu::PrimitiveTopology,
    pub(super) culled: Option<wgpu::Face>,
    pub(super) front_face: wgpu::FrontFace,
    pub(super) polygon_mode: wgpu::PolygonMode,
    pub(super) depth_write: bool,
    pub(super) depth_compare: wgpu::CompareFunction,
    pub(super) stencil: wgpu::StencilState,
    pub(super) bias: wgpu::DepthBiasState,
    pub(super) blend: Option<wgpu::BlendState>,
    pub(super) write_mask: wgpu::ColorWrites,
    /// Bits of the attachments that the fragment shader writes.
    pub(super) outputs: u32,
    pub(super) alpha_to_coverage: bool,
    /// Without colours: there is a fragment shader all the same, which drops some.
    pub(super) discards: bool,
    /// What is before the near plane has its depth.
    pub(super) unclipped_depth: bool,
    pub(super) target: TargetFormats,
}

impl Pipelines {
    /// A pipeline without vertices or block.
    pub(super) fn variant<'a>(
        label: &'a str,
        shader: &'a wgpu::ShaderModule,
        [vertex, fragment]: [&'a str; 2],
        target: TargetFormats,
    ) -> Variant<'a> {
        Variant {
            label,
            shader,
            vertex,
            fragment,
            block_layout: None,
            state_layout: None,
            pull_layout: None,
            constants: &[],
            buffers: &[],
            topology: wgpu::PrimitiveTopology::TriangleList,
            culled: None,
            front_face: wgpu::FrontFace::Ccw,
            polygon_mode: wgpu::PolygonMode::Fill,
            depth_write: false,
            // Equal: where nothing was drawn, the depth is still the cleared 0.
            depth_compare: wgpu::CompareFunction::GreaterEqual,
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
            blend: None,
            write_mask: wgpu::ColorWrites::COLOR,
            outputs: 1,
            alpha_to_coverage: false,
            discards: false,
            unclipped_depth: false,
            target,
        }
    }

    /// `None`, and an error kept, where the device refuses.
    pub(super) fn create(&mut self, ctx: &GraphicsContext, variant: &Variant<'_>) -> Option<wgpu::RenderPipeline> {
        let (pipeline, error) = watched(ctx.device(), || self.of_variant(ctx, variant));
        let Some(error) = error else { return Some(pipeline) };
        self.errors.push(format!("pipeline {}: {error}", variant.label));
        None
    }

    /// Whatever the device says of it.
    fn of_variant(&self, ctx: &GraphicsContext, variant: &Variant<'_>) -> wgpu::RenderPipeline {
        let device = ctx.device();
        let layouts = [Some(&self.frame_layout), variant.block_layout, variant.state_layout, variant.pull_layout];
        let used = layouts.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(variant.label),
            bind_group_layouts: &layouts[..used],
            immediate_size: 0,
        });
        let target = &variant.target;
        let colors = target.colors.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        let mut states = [const { None }; MOST_COLORS];
        for (location, (state, format)) in states.iter_mut().zip(target.colors).enumerate() {
            let is_written = variant.outputs >> location & 1 == 1;
            *state = format.map(|format| wgpu::ColorTargetState {
                format,
                blend: variant.blend.filter(|_| is_written),
                write_mask: if is_written { variant.write_mask } else { wgpu::ColorWrites::empty() },
            });
        }
        let options = wgpu::PipelineCompilationOptions { constants: variant.constants, ..Default::default() };
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(variant.label),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: variant.shader,
                entry_point: Some(variant.vertex),
                compilation_options: options.clone(),
                buffers: variant.buffers,
            },
            primitive: wgpu::PrimitiveState {
                topology: variant.topology,
                front_face: variant.front_face,
                cull_mode: variant.culled,
                polygon_mode: variant.polygon_mode,
                unclipped_depth: variant.unclipped_depth,
                ..Default::default()
            },
            depth_stencil: Some(wgpu::DepthStencilState {
                format: target.depth,
                depth_write_enabled: Some(variant.depth_write),
                depth_compare: Some(variant.depth_compare),
                stencil: variant.stencil.clone(),
                bias: variant.bias,
            }),
            multisample: wgpu::MultisampleState {
                count: target.samples,
                alpha_to_coverage_enabled: variant.alpha_to_coverage,
                ..Default::default()
            },
            fragment: (colors > 0 || variant.discards).then(|| wgpu::FragmentState {
                module: variant.shader,
                entry_point: Some(variant.fragment),
                compilation_options: options,
                targets: &states[..colors],
            }),
            multiview_mask: None,
            cache: ctx.pipeline_cache(),
        })
    }
}
