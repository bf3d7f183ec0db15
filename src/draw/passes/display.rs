//! The display pass: shows an image of light on the context's target, with its tones mapped; and encodes the image of targets
//! without an sRGB format. Draw thread.

use super::fullscreen::FullscreenPipeline;
use super::stage_input::StageInput;
use crate::draw::pipelines::sources::DISPLAY_WGSL;
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::{DisplayedImage, PassTarget};
use crate::gpu::{GraphicsContext, catch_errors, is_encoded_by_shader};

/// The shader, the layout of its image, and a pipeline for each format of a target.
struct Display {
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    /// `None` if the device refused the pipeline.
    pipelines: Vec<(wgpu::TextureFormat, Option<wgpu::RenderPipeline>)>,
}

impl Display {
    fn new(device: &wgpu::Device) -> Self {
        Self {
            module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("display"),
                source: wgpu::ShaderSource::Wgsl(DISPLAY_WGSL.into()),
            }),
            layout: device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("display"),
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
            }),
            pipelines: Vec::new(),
        }
    }

    /// Creates the pipeline of a format, without looking for errors of the device.
    fn pipeline(
        &self,
        ctx: &GraphicsContext,
        frame_layout: &wgpu::BindGroupLayout,
        format: wgpu::TextureFormat,
    ) -> wgpu::RenderPipeline {
        FullscreenPipeline {
            label: "display",
            module: &self.module,
            entry_points: ["vs_display", "fs_display"],
            constants: &[("ENCODES", f64::from(u8::from(is_encoded_by_shader(format))))],
            bind_group_layouts: &[Some(frame_layout), Some(&self.layout)],
            colors: &[Some(format.into())],
            depth_stencil: None,
            samples: 1,
        }
        .create(ctx)
    }
}

/// The display pass of a renderer.
#[derive(Default)]
pub(in crate::draw) struct DisplayPass {
    /// Created for the first stage that needs the pass.
    display: Option<Display>,
}

impl DisplayPass {
    /// Returns the number of pipelines created so far.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.display.as_ref().map_or(0, |display| display.pipelines.len() as u32)
    }

    /// Creates the pipeline for the image of a stage, if it has one. A pipeline that the device refuses is reported once.
    pub(in crate::draw) fn prepare(&mut self, resources: &mut Resources, input: &StageInput<'_>) {
        let Some(DisplayedImage { format, .. }) = input.target.display else { return };
        let device = input.ctx.device();
        // Errors of its module come up again when its pipelines are created.
        let display = self.display.get_or_insert_with(|| catch_errors(device, || Display::new(device)).0);
        if display.pipelines.iter().any(|(known, _)| *known == format) {
            return;
        }
        let layout = resources.pipelines.frame_layout();
        let (pipeline, error) = catch_errors(device, || display.pipeline(input.ctx, layout, format));
        display.pipelines.push((format, error.is_none().then_some(pipeline)));
        if let Some(error) = error {
            resources.errors.report_once(format!("images cannot be shown in {format:?}: {error}"));
        }
    }

    /// Records the pass of a stage that has an image, over the stage's viewport.
    pub(in crate::draw) fn record(
        &self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        encoder: &mut wgpu::CommandEncoder,
        target: &PassTarget,
        base_index: u32,
    ) {
        let (Some(display), Some(shown)) = (&self.display, &target.display) else { return };
        let known = display.pipelines.iter().find(|(known, _)| *known == shown.format);
        let (Some((_, Some(pipeline))), Some(base)) = (known, resources.bound_states.get(base_index)) else { return };
        let Some(frame) = resources.frame_groups.by_air().get(usize::from(base.air)) else { return };
        let image = ctx.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("display"),
            layout: &display.layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(&shown.image) }],
        });
        let is_first = target.is_outermost() && !target.is_begun;
        let load = if is_first { wgpu::LoadOp::Clear(wgpu::Color::BLACK) } else { wgpu::LoadOp::Load };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("display"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: &shown.target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
            })],
            timestamp_writes: resources.timer.as_mut().and_then(|timer| timer.pass("display")),
            ..wgpu::RenderPassDescriptor::default()
        });
        let [x, y, width, height, near, far] = base.dynamics.viewport;
        pass.set_viewport(x, y, width, height, near, far);
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, frame, &base.frame);
        pass.set_bind_group(1, &image, &[]);
        pass.draw(0..3, 0..1);
    }
}
