//! [`FullscreenPipeline`]: the description of pipelines that draw one triangle over the whole of a viewport. Draw thread.

use crate::gpu::GraphicsContext;

/// A pipeline that draws a triangle without vertex buffers, whose vertex shader makes it cover the viewport. Passes use it for
/// images and depth that they draw into targets.
pub(in crate::draw) struct FullscreenPipeline<'a> {
    pub label: &'static str,
    pub module: &'a wgpu::ShaderModule,
    /// The names of the vertex shader and of the fragment shader.
    pub entry_points: [&'static str; 2],
    /// The overridable constants of the fragment shader.
    pub constants: &'a [(&'a str, f64)],
    pub bind_group_layouts: &'a [Option<&'a wgpu::BindGroupLayout>],
    pub colors: &'a [Option<wgpu::ColorTargetState>],
    pub depth_stencil: Option<wgpu::DepthStencilState>,
    pub samples: u32,
}

impl FullscreenPipeline<'_> {
    /// Creates the pipeline, without looking for errors of the device.
    pub fn create(self, ctx: &GraphicsContext) -> wgpu::RenderPipeline {
        let Self { label, module, entry_points, constants, bind_group_layouts, colors, depth_stencil, samples } = self;
        let (device, label) = (ctx.device(), Some(label));
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts,
            immediate_size: 0,
        });
        let [vertex, fragment] = entry_points.map(Some);
        let options = wgpu::PipelineCompilationOptions::default();
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label,
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module,
                entry_point: vertex,
                compilation_options: options.clone(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil,
            multisample: wgpu::MultisampleState { count: samples, ..wgpu::MultisampleState::default() },
            fragment: Some(wgpu::FragmentState {
                module,
                entry_point: fragment,
                compilation_options: wgpu::PipelineCompilationOptions { constants, ..options },
                targets: colors,
            }),
            multiview_mask: None,
            cache: ctx.pipeline_cache(),
        })
    }
}
