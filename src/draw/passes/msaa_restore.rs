//! Restores multisampled colours from the textures that they are resolved into. A camera that does not clear its colours
//! needs this, since other cameras have used the multisampled buffer in the meantime. Draw thread.

use super::stage_input::StageInput;
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::{ColorSamples, PassTarget};
use crate::gpu::{FrameTimer, GraphicsContext, catch_errors};

const MSAA_RESTORE_WGSL: &str = include_str!("../shaders/passes/msaa_restore.wgsl");

/// Format and samples a pixel of a buffer.
type Kind = (wgpu::TextureFormat, u32);

/// The pipelines that draw a texture over a multisampled buffer of its size, one for each kind of buffer.
struct RestorePipelines {
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    /// `None` if the device refused the pipeline.
    pipelines: Vec<(Kind, Option<wgpu::RenderPipeline>)>,
}

impl RestorePipelines {
    fn new(device: &wgpu::Device) -> Self {
        Self {
            module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("msaa restore"),
                source: wgpu::ShaderSource::Wgsl(MSAA_RESTORE_WGSL.into()),
            }),
            layout: device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("msaa restore"),
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

    /// Creates the pipeline of a kind if needed. A pipeline that the device refuses is an error the first time only.
    fn ensure(&mut self, ctx: &GraphicsContext, kind: Kind) -> Result<(), String> {
        if self.pipelines.iter().any(|(known, _)| *known == kind) {
            return Ok(());
        }
        let (pipeline, error) = catch_errors(ctx.device(), || self.pipeline(ctx, kind));
        self.pipelines.push((kind, error.is_none().then_some(pipeline)));
        error.map_or(Ok(()), |error| {
            Err(format!("multisampled colours that a camera does not clear cannot be restored: {error}"))
        })
    }

    /// Creates the pipeline of a kind, without looking for errors of the device.
    fn pipeline(&self, ctx: &GraphicsContext, (format, count): Kind) -> wgpu::RenderPipeline {
        let device = ctx.device();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("msaa restore"),
            bind_group_layouts: &[Some(&self.layout)],
            immediate_size: 0,
        });
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("msaa restore"),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: Some("vs_restore"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState { count, ..Default::default() },
            fragment: Some(wgpu::FragmentState {
                module: &self.module,
                entry_point: Some("fs_restore"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::ALL })],
            }),
            multiview_mask: None,
            cache: ctx.pipeline_cache(),
        })
    }

    /// Records a render pass for each buffer.
    fn record<'a>(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        buffers: impl Iterator<Item = ColorSamples<'a>>,
        mut timer: Option<&mut FrameTimer>,
    ) {
        for ColorSamples { texture, samples, format, sample_count } in buffers {
            let kind = (format, sample_count);
            let known = self.pipelines.iter().find(|(known, _)| *known == kind);
            let Some((_, Some(pipeline))) = known else { continue };
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("msaa restore"),
                layout: &self.layout,
                entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(texture) }],
            });
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("msaa restore"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: samples,
                    depth_slice: None,
                    resolve_target: None,
                    // The draw covers all of it.
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: None,
                timestamp_writes: timer.as_mut().and_then(|timer| timer.pass("msaa restore")),
                occlusion_query_set: None,
                multiview_mask: None,
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}

/// The restoration of multisampled colours.
#[derive(Default)]
pub(in crate::draw) struct MsaaRestore {
    /// Created for the first camera that keeps multisampled colours.
    pipelines: Option<RestorePipelines>,
}

impl MsaaRestore {
    /// Returns the number of pipelines created so far.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.pipelines.as_ref().map_or(0, |restore| restore.pipelines.len() as u32)
    }

    /// Creates the pipelines for the colours of a stage that keeps them; returns true if some have to be restored.
    pub(in crate::draw) fn prepare(
        &mut self,
        resources: &mut Resources,
        input: &StageInput<'_>,
        keeps_colors: bool,
    ) -> bool {
        let Some(formats) = resources.pipelines.target_formats(input.target.index).filter(|_| keeps_colors) else {
            return false;
        };
        let device = input.ctx.device();
        let mut restores = false;
        for ColorSamples { format, sample_count, .. } in input.target.stale_colors(formats) {
            let pipelines =
                self.pipelines.get_or_insert_with(|| catch_errors(device, || RestorePipelines::new(device)).0);
            if let Err(error) = pipelines.ensure(input.ctx, (format, sample_count)) {
                resources.errors.report_once(error);
            }
            restores = true;
        }
        restores
    }

    /// Records the render passes before that of a stage whose colours have to be restored.
    pub(in crate::draw) fn record(
        &self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        encoder: &mut wgpu::CommandEncoder,
        target: &PassTarget,
    ) {
        if let (Some(pipelines), Some(formats)) = (&self.pipelines, resources.pipelines.target_formats(target.index)) {
            let colors = target.stale_colors(formats);
            pipelines.record(ctx.device(), encoder, colors, resources.timer.as_mut());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits};

    /// Regression test: the device's own error handler got the failure, and the frame was lost.
    #[test]
    fn refused_pipeline_is_reported_once() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut pipelines = RestorePipelines::new(ctx.device());
        // No adapter supports 7 samples a pixel.
        let kind = (wgpu::TextureFormat::Rgba8Unorm, 7);
        assert!(pipelines.ensure(&ctx, kind).unwrap_err().contains("multisampled colours"));
        assert_eq!(pipelines.ensure(&ctx, kind), Ok(()));
        assert!(ctx.take_device_errors().is_empty());
    }

    #[test]
    fn the_shader_is_valid() {
        let module = naga::front::wgsl::parse_str(super::MSAA_RESTORE_WGSL).unwrap();
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .unwrap();
    }
}
