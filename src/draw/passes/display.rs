//! The display pass: shows an image of light on the context's target, with its tones mapped; and encodes the image of targets
//! without an sRGB format. Draw thread.

use super::fullscreen::{FullscreenPipeline, PipelinesByKind, image_layout};
use super::stage_input::StageInput;
use crate::draw::pipelines::Pipelines;
use crate::draw::pipelines::pipeline_thread::Order;
use crate::draw::pipelines::sources::DISPLAY_WGSL;
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::{DisplayedImage, PassTarget};
use crate::gpu::{GraphicsContext, catch_errors, is_encoded_by_shader};

/// The shader, the layout of its image, and a pipeline for each format of a target.
struct Display {
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    pipelines: PipelinesByKind<wgpu::TextureFormat>,
    /// The pipelines that the pipeline thread creates, by format.
    ordered: Vec<(wgpu::TextureFormat, Order<wgpu::RenderPipeline>)>,
}

impl Display {
    fn new(device: &wgpu::Device) -> Self {
        Self {
            module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("display"),
                source: wgpu::ShaderSource::Wgsl(DISPLAY_WGSL.into()),
            }),
            layout: image_layout(device, "display"),
            pipelines: PipelinesByKind::new(),
            ordered: Vec::new(),
        }
    }

    /// Creates or orders the pipeline of a format if needed. A pipeline that the device refuses is an error the first time
    /// only.
    fn ensure(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        format: wgpu::TextureFormat,
    ) -> Result<(), String> {
        if self.pipelines.has_tried(&format) {
            return Ok(());
        }
        let (module, layout) = (self.module.clone(), self.layout.clone());
        let (frame_layout, cache) = (pipelines.frame_layout().clone(), ctx.pipeline_cache().cloned());
        let create = move |device: &wgpu::Device| {
            FullscreenPipeline {
                label: "display",
                module: &module,
                entry_points: ["vs_display", "fs_display"],
                constants: &[("ENCODES", f64::from(u8::from(is_encoded_by_shader(format))))],
                bind_group_layouts: &[Some(&frame_layout), Some(&layout)],
                colors: &[Some(format.into())],
                depth_stencil: None,
                samples: 1,
            }
            .create_on(device, cache.as_ref())
        };
        let thread = &mut pipelines.pipeline_thread;
        let known = self.ordered.iter().position(|(of, _)| *of == format);
        let known = known.map(|index| self.ordered.swap_remove(index).1);
        let order = match known.filter(|order| !order.is_abandoned()) {
            Some(order) => order,
            None if thread.is_ordering() => thread.order(ctx.device(), "display".to_owned(), create),
            None => {
                let created = self.pipelines.ensure(ctx.device(), format, || create(ctx.device()));
                return created.map_err(|error| error.to_string());
            }
        };
        match thread.take(&order) {
            Some(created) => self.pipelines.insert(format, created),
            None if thread.is_ordering() => {
                self.ordered.push((format, order));
                Ok(())
            }
            // A frame that cannot wait creates the pipeline itself.
            None => self.ensure(ctx, pipelines, format),
        }
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
        self.display.as_ref().map_or(0, |display| display.pipelines.created())
    }

    /// Creates the pipeline for the image of a stage, if it has one. A pipeline that the device refuses is reported once.
    pub(in crate::draw) fn prepare(&mut self, resources: &mut Resources, input: &StageInput<'_>) {
        let Some(DisplayedImage { format, .. }) = input.target.display else { return };
        let device = input.ctx.device();
        // Errors of its module come up again when its pipelines are created.
        let display = self.display.get_or_insert_with(|| catch_errors(device, || Display::new(device)).0);
        if let Err(error) = display.ensure(input.ctx, &mut resources.pipelines, format) {
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
        let pipeline = display.pipelines.get(&shown.format);
        let (Some(pipeline), Some(base)) = (pipeline, resources.bound_states.get(base_index)) else { return };
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
