//! Creates shader modules and render pipelines on the device, and catches its errors. Draw thread.

use crate::gpu::{GraphicsContext, MAX_COLOR_ATTACHMENTS, TargetFormats, catch_errors};

/// The properties in which pipelines differ, in wgpu's terms. It has as many fields as wgpu's descriptors need.
pub(super) struct Variant<'a> {
    pub(super) label: &'a str,
    pub(super) shader: &'a wgpu::ShaderModule,
    pub(super) vertex: &'a str,
    pub(super) fragment: &'a str,
    /// Layout of bind group 1.
    pub(super) block_layout: Option<&'a wgpu::BindGroupLayout>,
    /// Layout of bind group 2.
    pub(super) state_layout: Option<&'a wgpu::BindGroupLayout>,
    /// Layout of bind group 3.
    pub(super) third_layout: Option<&'a wgpu::BindGroupLayout>,
    /// Values of overrides.
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
    /// By location.
    pub(super) blends: [Option<wgpu::BlendState>; MAX_COLOR_ATTACHMENTS],
    /// By location.
    pub(super) write_masks: [wgpu::ColorWrites; MAX_COLOR_ATTACHMENTS],
    /// The bits of the samples that are drawn.
    pub(super) sample_mask: u64,
    /// Bits of the attachments that the fragment shader writes.
    pub(super) outputs: u32,
    pub(super) alpha_to_coverage: bool,
    /// True if the fragment shader may discard, so that it is needed without colours too.
    pub(super) discards: bool,
    /// True if depths before the near plane are clamped to it instead of clipped.
    pub(super) unclipped_depth: bool,
    pub(super) target: TargetFormats,
}

impl<'a> Variant<'a> {
    /// Returns the variant of a pipeline without vertex buffers, blocks and states: it writes no depth and colours the
    /// first attachment.
    pub(super) fn new(
        label: &'a str,
        shader: &'a wgpu::ShaderModule,
        [vertex, fragment]: [&'a str; 2],
        target: TargetFormats,
    ) -> Self {
        Self {
            label,
            shader,
            vertex,
            fragment,
            block_layout: None,
            state_layout: None,
            third_layout: None,
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
            blends: [None; MAX_COLOR_ATTACHMENTS],
            write_masks: [wgpu::ColorWrites::COLOR; MAX_COLOR_ATTACHMENTS],
            sample_mask: !0,
            outputs: 1,
            alpha_to_coverage: false,
            discards: false,
            unclipped_depth: false,
            target,
        }
    }
}

/// Creates the modules and pipelines of a renderer and keeps the errors.
pub(super) struct PipelineBuilder {
    /// Layout of bind group 0.
    frame_layout: wgpu::BindGroupLayout,
    /// Modules by the address of their source.
    modules: Vec<(&'static str, wgpu::ShaderModule)>,
    created: u32,
    errors: Vec<String>,
}

impl PipelineBuilder {
    pub(super) fn new(frame_layout: wgpu::BindGroupLayout) -> Self {
        Self { frame_layout, modules: Vec::new(), created: 0, errors: Vec::new() }
    }

    pub(super) fn frame_layout(&self) -> &wgpu::BindGroupLayout {
        &self.frame_layout
    }

    /// Returns the number of pipelines counted so far.
    pub(super) fn created(&self) -> u32 {
        self.created
    }

    /// Counts a pipeline, also one that the device refused.
    pub(super) fn count(&mut self) {
        self.created += 1;
    }

    /// Returns the errors that were not taken yet.
    pub(super) fn errors(&mut self) -> &mut Vec<String> {
        &mut self.errors
    }

    /// Returns the errors since the last call.
    pub(super) fn take_errors(&mut self) -> Vec<String> {
        std::mem::take(&mut self.errors)
    }

    /// Returns the module of a source, which is created at the first call.
    pub(super) fn module(&mut self, ctx: &GraphicsContext, label: &str, source: &'static str) -> wgpu::ShaderModule {
        if let Some((_, module)) = self.modules.iter().find(|(known, _)| std::ptr::eq(*known, source)) {
            return module.clone();
        }
        let module = ctx.device().create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(label),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        self.modules.push((source, module.clone()));
        module
    }

    /// Creates a pipeline. Returns `None` and keeps an error if the device refuses it.
    pub(super) fn create(&mut self, ctx: &GraphicsContext, variant: &Variant<'_>) -> Option<wgpu::RenderPipeline> {
        let (pipeline, error) = catch_errors(ctx.device(), || self.create_unchecked(ctx, variant));
        let Some(error) = error else { return Some(pipeline) };
        self.errors.push(format!("pipeline {}: {error}", variant.label));
        None
    }

    /// Creates a pipeline without looking for errors of the device.
    fn create_unchecked(&self, ctx: &GraphicsContext, variant: &Variant<'_>) -> wgpu::RenderPipeline {
        let device = ctx.device();
        let layouts = [Some(&self.frame_layout), variant.block_layout, variant.state_layout, variant.third_layout];
        let used = layouts.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(variant.label),
            bind_group_layouts: &layouts[..used],
            immediate_size: 0,
        });
        let target = &variant.target;
        let colors = target.colors.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        let mut states = [const { None }; MAX_COLOR_ATTACHMENTS];
        for (location, (state, format)) in states.iter_mut().zip(target.colors).enumerate() {
            let is_written = variant.outputs >> location & 1 == 1;
            *state = format.map(|format| wgpu::ColorTargetState {
                format,
                blend: variant.blends[location].filter(|_| is_written),
                write_mask: if is_written { variant.write_masks[location] } else { wgpu::ColorWrites::empty() },
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
                mask: variant.sample_mask,
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
