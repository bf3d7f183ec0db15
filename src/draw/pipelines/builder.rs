//! Creates shader modules and render pipelines on the device, and catches its errors. Draw thread; [`PipelineMaker`] runs on
//! the pipeline thread too.

use std::sync::{Arc, Mutex, PoisonError};

use crate::gpu::{GraphicsContext, MAX_COLOR_ATTACHMENTS, TargetFormats, catch_errors};

/// The shader of a pipeline.
pub(super) enum ShaderSource {
    /// A source of the renderer, with its label. Its module is created once.
    Own(&'static str, &'static str),
    /// The module of a program.
    Module(wgpu::ShaderModule),
}

/// A vertex buffer of a pipeline.
pub(super) struct VertexBuffer {
    pub(super) stride: u64,
    pub(super) attributes: Vec<wgpu::VertexAttribute>,
}

impl VertexBuffer {
    fn layout(&self) -> Option<wgpu::VertexBufferLayout<'_>> {
        let Self { stride, attributes } = self;
        let step_mode = wgpu::VertexStepMode::Vertex;
        Some(wgpu::VertexBufferLayout { array_stride: *stride, step_mode, attributes })
    }
}

/// The properties in which pipelines differ, in wgpu's terms. It has as many fields as wgpu's descriptors need, and owns what
/// they borrow, so that another thread can create the pipeline.
pub(super) struct Variant {
    pub(super) label: String,
    pub(super) shader: ShaderSource,
    pub(super) vertex: &'static str,
    pub(super) fragment: &'static str,
    /// Layout of bind group 1.
    pub(super) block_layout: Option<wgpu::BindGroupLayout>,
    /// Layout of bind group 2.
    pub(super) state_layout: Option<wgpu::BindGroupLayout>,
    /// Layout of bind group 3.
    pub(super) third_layout: Option<wgpu::BindGroupLayout>,
    /// Values of overrides.
    pub(super) constants: Vec<(String, f64)>,
    pub(super) buffers: Vec<VertexBuffer>,
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

impl Variant {
    /// Returns the variant of a pipeline without vertex buffers, blocks and states: it writes no depth and colours the
    /// first attachment.
    pub(super) fn new(
        label: String,
        shader: ShaderSource,
        [vertex, fragment]: [&'static str; 2],
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
            constants: Vec::new(),
            buffers: Vec::new(),
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

/// Creates pipelines on a device, on any thread.
#[derive(Clone)]
pub(super) struct PipelineMaker {
    /// Layout of bind group 0.
    frame_layout: wgpu::BindGroupLayout,
    cache: Option<wgpu::PipelineCache>,
    /// Modules by the address of their source; the draw thread and the pipeline thread add to them. A module that both need
    /// at once is created twice.
    modules: Arc<Mutex<Vec<(&'static str, wgpu::ShaderModule)>>>,
}

impl PipelineMaker {
    /// Returns the module of a source, which is created at the first call.
    fn module(&self, device: &wgpu::Device, label: &str, source: &'static str) -> wgpu::ShaderModule {
        let known = || self.modules.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, module)) = known().iter().find(|(known, _)| std::ptr::eq(*known, source)) {
            return module.clone();
        }
        let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(label),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        known().push((source, module.clone()));
        module
    }

    /// Creates a pipeline without looking for errors of the device.
    pub(super) fn create(&self, device: &wgpu::Device, variant: &Variant) -> wgpu::RenderPipeline {
        let layouts = [
            Some(&self.frame_layout),
            variant.block_layout.as_ref(),
            variant.state_layout.as_ref(),
            variant.third_layout.as_ref(),
        ];
        let used = layouts.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(&variant.label),
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
        let own;
        let module = match &variant.shader {
            ShaderSource::Module(module) => module,
            ShaderSource::Own(label, source) => {
                own = self.module(device, label, source);
                &own
            }
        };
        let constants: Vec<(&str, f64)> = variant.constants.iter().map(|(name, value)| (&**name, *value)).collect();
        let buffers: Vec<_> = variant.buffers.iter().map(VertexBuffer::layout).collect();
        let options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(&variant.label),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module,
                entry_point: Some(variant.vertex),
                compilation_options: options.clone(),
                buffers: &buffers,
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
                module,
                entry_point: Some(variant.fragment),
                compilation_options: options,
                targets: &states[..colors],
            }),
            multiview_mask: None,
            cache: self.cache.as_ref(),
        })
    }
}

/// Creates the pipelines of a renderer at once, and keeps the errors.
pub(super) struct PipelineBuilder {
    maker: PipelineMaker,
    created: u32,
    errors: Vec<String>,
}

impl PipelineBuilder {
    pub(super) fn new(frame_layout: wgpu::BindGroupLayout) -> Self {
        let maker = PipelineMaker { frame_layout, cache: None, modules: Arc::default() };
        Self { maker, created: 0, errors: Vec::new() }
    }

    pub(super) fn frame_layout(&self) -> &wgpu::BindGroupLayout {
        &self.maker.frame_layout
    }

    /// Returns the number of pipelines created so far, those that the device refused included.
    pub(super) fn created(&self) -> u32 {
        self.created
    }

    /// Returns the errors that were not taken yet.
    pub(super) fn errors(&mut self) -> &mut Vec<String> {
        &mut self.errors
    }

    /// Returns the errors since the last call.
    pub(super) fn take_errors(&mut self) -> Vec<String> {
        std::mem::take(&mut self.errors)
    }

    /// Returns what creates pipelines on another thread.
    pub(super) fn maker(&self, ctx: &GraphicsContext) -> PipelineMaker {
        PipelineMaker { cache: ctx.pipeline_cache().cloned(), ..self.maker.clone() }
    }

    /// Creates a pipeline. Returns `None` and keeps an error if the device refuses it.
    pub(super) fn create(&mut self, ctx: &GraphicsContext, variant: &Variant) -> Option<wgpu::RenderPipeline> {
        self.created += 1;
        let maker = self.maker(ctx);
        let (pipeline, error) = catch_errors(ctx.device(), || maker.create(ctx.device(), variant));
        self.accept(error.map_or(Ok(pipeline), |error| Err(format!("pipeline {}: {error}", variant.label))))
    }

    /// Returns a pipeline that was created. Returns `None` and keeps the error if the device has refused it.
    pub(super) fn accept(&mut self, created: Result<wgpu::RenderPipeline, String>) -> Option<wgpu::RenderPipeline> {
        created.map_err(|error| self.errors.push(error)).ok()
    }
}
