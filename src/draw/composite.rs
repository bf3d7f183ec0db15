//! Puts the pictures of two eyes together. Draw thread.

use crate::cull::StereoMode;
use crate::draw::pipelines::TargetFormats;
use crate::gpu::{GraphicsContext, watched};

const COMPOSITE_WGSL: &str = include_str!("shaders/composite.wgsl");

/// Pipelines that draw two textures over a whole target.
pub(super) struct Composite {
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    /// One for each stage of the frame that has two eyes.
    uniforms: Vec<wgpu::Buffer>,
    used: usize,
    /// `None` where the device refused.
    pipelines: Vec<(TargetFormats, Option<wgpu::RenderPipeline>)>,
}

/// The number of a mode in composite.wgsl.
fn code(mode: StereoMode) -> u32 {
    match mode {
        StereoMode::Anaglyphic => 0,
        StereoMode::HorizontalSplit => 1,
        StereoMode::VerticalSplit => 2,
        StereoMode::LeftEye => 3,
        StereoMode::RightEye => 4,
        StereoMode::HorizontalInterlace => 5,
        StereoMode::VerticalInterlace => 6,
        StereoMode::Checkerboard => 7,
    }
}

impl Composite {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        let entry = |binding, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty,
            count: None,
        };
        let texture = wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let uniform = wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        };
        Self {
            module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("composite"),
                source: wgpu::ShaderSource::Wgsl(COMPOSITE_WGSL.into()),
            }),
            layout: device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("composite"),
                entries: &[entry(0, texture), entry(1, texture), entry(2, uniform)],
            }),
            uniforms: Vec::new(),
            used: 0,
            pipelines: Vec::new(),
        }
    }

    pub(super) fn start_frame(&mut self) {
        self.used = 0;
    }

    /// Makes the pipeline for a target unless it is there, and says what to do in a part of it that begins at an origin;
    /// where [`Self::draw`] finds that. What the device refuses, of a pipeline only the first time.
    pub(super) fn prepare(
        &mut self,
        ctx: &GraphicsContext,
        target: &TargetFormats,
        mode: StereoMode,
        gap_px: u32,
        [x, y]: [u32; 2],
    ) -> Result<usize, String> {
        let place = self.used;
        if place == self.uniforms.len() {
            let descriptor = wgpu::BufferDescriptor {
                label: Some("composite"),
                size: 16,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            };
            let buffer = ctx.memory().make("composite", descriptor.size, |device| device.create_buffer(&descriptor))?;
            self.uniforms.push(buffer);
        }
        self.used += 1;
        ctx.queue().write_buffer(&self.uniforms[place], 0, bytemuck::cast_slice(&[code(mode), gap_px, x, y]));
        if self.pipelines.iter().any(|(key, _)| key == target) {
            return Ok(place);
        }
        let (pipeline, error) = watched(ctx.device(), || self.pipeline(ctx, target));
        self.pipelines.push((*target, error.is_none().then_some(pipeline)));
        error.map_or(Ok(place), |error| Err(format!("the pictures of two eyes cannot be put together: {error}")))
    }

    /// Whatever the device says of it.
    fn pipeline(&self, ctx: &GraphicsContext, target: &TargetFormats) -> wgpu::RenderPipeline {
        let device = ctx.device();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("composite"),
            bind_group_layouts: &[Some(&self.layout)],
            immediate_size: 0,
        });
        let states = target.colors.map(|format| {
            format.map(|format| wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::COLOR })
        });
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("composite"),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: Some("vs_composite"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                format: target.depth,
                depth_write_enabled: Some(false),
                depth_compare: Some(wgpu::CompareFunction::Always),
                stencil: wgpu::StencilState::default(),
                bias: wgpu::DepthBiasState::default(),
            }),
            multisample: wgpu::MultisampleState { count: target.samples, ..Default::default() },
            fragment: Some(wgpu::FragmentState {
                module: &self.module,
                entry_point: Some("fs_composite"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &states[..1],
            }),
            multiview_mask: None,
            cache: ctx.pipeline_cache(),
        })
    }

    /// Draws the eyes' pictures over the pass's viewport.
    pub(super) fn draw(
        &self,
        device: &wgpu::Device,
        pass: &mut wgpu::RenderPass<'_>,
        target: &TargetFormats,
        [left, right]: [&wgpu::TextureView; 2],
        place: usize,
    ) {
        let Some((_, Some(pipeline))) = self.pipelines.iter().find(|(key, _)| key == target) else { return };
        let Some(uniforms) = self.uniforms.get(place) else { return };
        let view = |binding, view| wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::TextureView(view) };
        let eyes = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("composite"),
            layout: &self.layout,
            entries: &[
                view(0, left),
                view(1, right),
                wgpu::BindGroupEntry { binding: 2, resource: uniforms.as_entire_binding() },
            ],
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &eyes, &[]);
        pass.draw(0..3, 0..1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, DEPTH_FORMAT, MOST_COLORS};

    /// The device's handler had it, and the frame was lost.
    #[test]
    fn a_pipeline_that_is_refused_is_said_once() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut colors = [None; MOST_COLORS];
        colors[0] = Some(wgpu::TextureFormat::Rgba8Unorm);
        let good = TargetFormats { colors, depth: DEPTH_FORMAT, samples: 1, keeps_alpha: false };
        // No adapter has as many.
        let bad = TargetFormats { samples: 7, ..good };
        let mut composite = Composite::new(ctx.device());
        let mut prepare = |target| {
            composite.start_frame();
            composite.prepare(&ctx, target, StereoMode::Anaglyphic, 0, [0; 2])
        };
        assert!(prepare(&bad).unwrap_err().contains("two eyes cannot be put together"));
        assert_eq!([prepare(&bad), prepare(&good)], [Ok(0), Ok(0)]);
        ctx.pretend_frame_memory(Some(0));
        let second = composite.prepare(&ctx, &good, StereoMode::Anaglyphic, 0, [0; 2]);
        assert!(second.unwrap_err().starts_with("out of graphics memory: composite of 16 bytes"));
        assert!(ctx.take_device_errors().is_empty());
    }

    #[test]
    fn the_shader_is_valid() {
        let module = naga::front::wgsl::parse_str(super::COMPOSITE_WGSL).unwrap();
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .unwrap();
    }
}
