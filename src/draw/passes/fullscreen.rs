//! Pipelines that draw one triangle over the whole of a viewport: their description ([`FullscreenPipeline`]), and a pass's
//! table of them ([`PipelinesByKind`]). Draw thread.

use crate::gpu::{GraphicsContext, catch_errors};

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
    /// Creates the pipeline on the draw thread, without looking for errors of the device.
    pub fn create(self, ctx: &GraphicsContext) -> wgpu::RenderPipeline {
        self.create_on(ctx.device(), ctx.pipeline_cache())
    }

    /// Does the same on any thread.
    pub fn create_on(self, device: &wgpu::Device, cache: Option<&wgpu::PipelineCache>) -> wgpu::RenderPipeline {
        let Self { label, module, entry_points, constants, bind_group_layouts, colors, depth_stencil, samples } = self;
        let label = Some(label);
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
            cache,
        })
    }
}

/// Creates the layout of a bind group with one image at binding 0, which fragment shaders load texels of.
pub(in crate::draw) fn image_layout(device: &wgpu::Device, label: &str) -> wgpu::BindGroupLayout {
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some(label),
        entries: &[wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable: false },
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            },
            count: None,
        }],
    })
}

/// The pipelines of a pass, one `P` for each kind `K` of target that it has met. The pass leaves out a kind whose pipeline the
/// device has refused.
pub(in crate::draw) struct PipelinesByKind<K, P = wgpu::RenderPipeline> {
    /// `None` if the device refused the pipeline.
    all: Vec<(K, Option<P>)>,
    /// The number of pipelines that the draw thread has created, or tried to.
    created: u32,
}

impl<K: PartialEq, P> PipelinesByKind<K, P> {
    pub const fn new() -> Self {
        Self { all: Vec::new(), created: 0 }
    }

    /// Creates the pipeline of a kind if needed. An error of the device is returned the first time only.
    pub fn ensure(&mut self, device: &wgpu::Device, kind: K, create: impl FnOnce() -> P) -> Result<(), wgpu::Error> {
        if self.has_tried(&kind) {
            return Ok(());
        }
        let (pipeline, error) = catch_errors(device, create);
        self.created += 1;
        self.all.push((kind, error.is_none().then_some(pipeline)));
        error.map_or(Ok(()), Err)
    }

    /// Takes the pipeline of a kind that the pipeline thread has created, or has failed to.
    pub fn insert(&mut self, kind: K, created: Result<P, String>) -> Result<(), String> {
        let (pipeline, result) = created.map_or_else(|error| (None, Err(error)), |pipeline| (Some(pipeline), Ok(())));
        self.all.push((kind, pipeline));
        result
    }

    /// Returns true if the pipeline of a kind was created, or refused.
    pub fn has_tried(&self, kind: &K) -> bool {
        self.all.iter().any(|(known, _)| known == kind)
    }

    /// Returns the pipeline of a kind; `None` if it was not created, or refused.
    pub fn get(&self, kind: &K) -> Option<&P> {
        self.all.iter().find(|(known, _)| known == kind)?.1.as_ref()
    }

    /// Returns the pipelines that the device has accepted.
    pub fn iter(&self) -> impl Iterator<Item = &P> {
        self.all.iter().filter_map(|(_, pipeline)| pipeline.as_ref())
    }

    /// Returns the number of pipelines that the draw thread has created so far, refused ones included.
    pub fn created(&self) -> u32 {
        self.created
    }
}
