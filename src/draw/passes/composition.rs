//! The stereo composition: draws the images of two eyes as one, in a stereo mode. Draw thread.

use std::sync::Arc;

use super::fullscreen::{FullscreenPipeline, PipelinesByKind};
use super::stage_input::LitStage;
use crate::cull::{RenderStage, StereoMode};
use crate::draw::pipelines::TargetFormats;
use crate::draw::recorder::{DrawSources, PassRecorder};
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::PassTarget;
use crate::gpu::{GraphicsContext, catch_errors};
use crate::state::TextureObject;

const COMPOSITE_WGSL: &str = include_str!("../shaders/passes/composition.wgsl");

/// The pipelines that draw two textures over a viewport, one for each kind of target.
struct Composite {
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    /// One buffer for each stage of the frame that has two eyes.
    uniforms: Vec<wgpu::Buffer>,
    /// The number of buffers used in this frame.
    used: usize,
    pipelines: PipelinesByKind<TargetFormats>,
}

/// Returns the number of a mode in composition.wgsl.
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
    fn new(device: &wgpu::Device) -> Self {
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
            pipelines: PipelinesByKind::new(),
        }
    }

    fn start_frame(&mut self) {
        self.used = 0;
    }

    /// Creates the pipeline for a target if needed, and uploads the mode for a viewport that begins at x and y. Returns
    /// the index of the uniforms for [`Self::draw`]. A pipeline that the device refuses is an error the first time only.
    fn prepare(
        &mut self,
        ctx: &GraphicsContext,
        target: &TargetFormats,
        mode: StereoMode,
        gap_px: u32,
        [x, y]: [u32; 2],
    ) -> Result<usize, String> {
        let index = self.used;
        if index == self.uniforms.len() {
            let descriptor = wgpu::BufferDescriptor {
                label: Some("composite"),
                size: 16,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            };
            let buffer =
                ctx.memory().allocate("composite", descriptor.size, |device| device.create_buffer(&descriptor))?;
            self.uniforms.push(buffer);
        }
        self.used += 1;
        ctx.queue().write_buffer(&self.uniforms[index], 0, bytemuck::cast_slice(&[code(mode), gap_px, x, y]));
        let Self { module, layout, pipelines, .. } = self;
        let colors = target.colors.map(|format| {
            format.map(|format| wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::COLOR })
        });
        let create = || {
            FullscreenPipeline {
                label: "composite",
                module,
                entry_points: ["vs_composite", "fs_composite"],
                constants: &[],
                bind_group_layouts: &[Some(layout)],
                colors: &colors[..1],
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: target.depth,
                    depth_write_enabled: Some(false),
                    depth_compare: Some(wgpu::CompareFunction::Always),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                samples: target.samples,
            }
            .create(ctx)
        };
        pipelines
            .ensure(ctx.device(), *target, create)
            .map_err(|error| format!("the images of two eyes cannot be composed: {error}"))?;
        Ok(index)
    }

    /// Records the draw of two images over the pass's viewport.
    fn draw(
        &self,
        device: &wgpu::Device,
        pass: &mut wgpu::RenderPass<'_>,
        target: &TargetFormats,
        [left, right]: [&wgpu::TextureView; 2],
        index: usize,
    ) {
        let Some(pipeline) = self.pipelines.get(target) else { return };
        let Some(uniforms) = self.uniforms.get(index) else { return };
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

/// The composition of a stage: the textures of its eyes and the index of its uniforms.
pub(in crate::draw) struct Composition {
    eyes: [Arc<TextureObject>; 2],
    uniforms: usize,
}

/// The stereo composition of a renderer.
#[derive(Default)]
pub(in crate::draw) struct StereoComposition {
    /// Created for the first stage with two eyes.
    composite: Option<Composite>,
}

impl StereoComposition {
    pub(in crate::draw) fn start_frame(&mut self) {
        if let Some(composite) = &mut self.composite {
            composite.start_frame();
        }
    }

    /// Prepares the composition of a stage; `None` if the stage has no stereo mode or its target cannot be drawn into.
    pub(in crate::draw) fn prepare(&mut self, resources: &mut Resources, lit: &LitStage<'_>) -> Option<Composition> {
        let (ctx, stage) = (lit.input.ctx, lit.input.stage);
        let mode = stage.stereo?;
        let formats = *resources.pipelines.target_formats(lit.input.target.index)?;
        // Errors of its module come up again when its pipelines are created.
        let composite =
            self.composite.get_or_insert_with(|| catch_errors(ctx.device(), || Composite::new(ctx.device())).0);
        let [x, y, ..] = lit.base.dynamics.viewport;
        let prepared = composite.prepare(ctx, &formats, mode, stage.stereo_gap_px, [x as u32, y as u32]);
        let uniforms = prepared.map_err(|error| resources.errors.report_once(error)).ok()?;
        let eye = |stage: &RenderStage| Some(stage.target.camera.as_ref()?.colors.first()?.texture.clone());
        let eyes = [eye(stage.pre_render.first()?)?, eye(stage.pre_render.get(1)?)?];
        Some(Composition { eyes, uniforms })
    }

    /// Records a composition over the stage's viewport.
    pub(in crate::draw) fn record(
        &self,
        recorder: &mut PassRecorder<'_, '_>,
        sources: &DrawSources<'_>,
        target: &PassTarget,
        composition: &Composition,
        base_index: u32,
    ) {
        let resources = sources.resources;
        let [left, right] = &composition.eyes;
        let textures = &resources.state_groups.textures;
        if let (Some(composite), Some(formats)) = (&self.composite, resources.pipelines.target_formats(target.index))
            && let (Some(left), Some(right)) = (textures.view(left), textures.view(right))
        {
            recorder.apply(sources, base_index);
            composite.draw(sources.ctx.device(), recorder.pass, formats, [left, right], composition.uniforms);
            // A pipeline and a bind group.
            recorder.count_foreign_draw(2);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, DEPTH_FORMAT, MAX_COLOR_ATTACHMENTS};

    /// Regression test: the device's own error handler got the failure, and the frame was lost.
    #[test]
    fn refused_pipeline_is_reported_once() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut colors = [None; MAX_COLOR_ATTACHMENTS];
        colors[0] = Some(wgpu::TextureFormat::Rgba8Unorm);
        let good = TargetFormats { colors, depth: DEPTH_FORMAT, samples: 1, keeps_alpha: false };
        // No adapter supports 7 samples a pixel.
        let bad = TargetFormats { samples: 7, ..good };
        let mut composite = Composite::new(ctx.device());
        let mut prepare = |target| {
            composite.start_frame();
            composite.prepare(&ctx, target, StereoMode::Anaglyphic, 0, [0; 2])
        };
        assert!(prepare(&bad).unwrap_err().contains("two eyes cannot be composed"));
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
