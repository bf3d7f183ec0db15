//! Puts what a texture holds into the multisampled buffer that is resolved into it: a camera that does not clear its
//! colours goes on with them, though the buffer was another's since. Draw thread.

use crate::gpu::{FrameTimer, GraphicsContext, watched};

const SPREAD_WGSL: &str = include_str!("shaders/spread.wgsl");

/// A colour of a pass that begins with what its texture holds.
#[derive(Clone, Copy)]
pub(super) struct Spreading<'a> {
    pub(super) texture: &'a wgpu::TextureView,
    pub(super) samples: &'a wgpu::TextureView,
    pub(super) kind: SpreadKind,
}

/// Format and samples a pixel.
pub(super) type SpreadKind = (wgpu::TextureFormat, u32);

/// Pipelines that draw a texture over a multisampled buffer of its size, one for each kind.
pub(super) struct Spread {
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    /// `None` where the device refused.
    pipelines: Vec<(SpreadKind, Option<wgpu::RenderPipeline>)>,
}

impl Spread {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        Self {
            module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("spread"),
                source: wgpu::ShaderSource::Wgsl(SPREAD_WGSL.into()),
            }),
            layout: device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("spread"),
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

    /// Pipelines made so far.
    pub(super) fn created(&self) -> u32 {
        self.pipelines.len() as u32
    }

    /// Makes the pipeline of a kind unless it is there; what the device refuses only the first time.
    pub(super) fn ensure(&mut self, ctx: &GraphicsContext, kind: SpreadKind) -> Result<(), String> {
        if self.pipelines.iter().any(|(known, _)| *known == kind) {
            return Ok(());
        }
        let (pipeline, error) = watched(ctx.device(), || self.pipeline(ctx, kind));
        self.pipelines.push((kind, error.is_none().then_some(pipeline)));
        error.map_or(Ok(()), |error| Err(format!("cameras cannot go on with multisampled colours: {error}")))
    }

    /// Whatever the device says of it.
    fn pipeline(&self, ctx: &GraphicsContext, (format, count): SpreadKind) -> wgpu::RenderPipeline {
        let device = ctx.device();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("spread"),
            bind_group_layouts: &[Some(&self.layout)],
            immediate_size: 0,
        });
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("spread"),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: Some("vs_spread"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState { count, ..Default::default() },
            fragment: Some(wgpu::FragmentState {
                module: &self.module,
                entry_point: Some("fs_spread"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::ALL })],
            }),
            multiview_mask: None,
            cache: ctx.pipeline_cache(),
        })
    }

    /// Records the passes before one that goes on with its colours.
    pub(super) fn record<'a>(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        all: impl Iterator<Item = Spreading<'a>>,
        mut timer: Option<&mut FrameTimer>,
    ) {
        for Spreading { texture, samples, kind } in all {
            let known = self.pipelines.iter().find(|(known, _)| *known == kind);
            let Some((_, Some(pipeline))) = known else { continue };
            let held = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("spread"),
                layout: &self.layout,
                entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(texture) }],
            });
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("spread"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: samples,
                    depth_slice: None,
                    resolve_target: None,
                    // All of it is drawn over.
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: None,
                timestamp_writes: timer.as_mut().and_then(|timer| timer.pass("spread")),
                occlusion_query_set: None,
                multiview_mask: None,
            });
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &held, &[]);
            pass.draw(0..3, 0..1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits};

    /// The device's handler had it, and the frame was lost.
    #[test]
    fn a_pipeline_that_is_refused_is_said_once() {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut spread = Spread::new(ctx.device());
        // No adapter has as many samples.
        let kind = (wgpu::TextureFormat::Rgba8Unorm, 7);
        assert!(spread.ensure(&ctx, kind).unwrap_err().contains("multisampled colours"));
        assert_eq!(spread.ensure(&ctx, kind), Ok(()));
        assert!(ctx.take_device_errors().is_empty());
    }

    #[test]
    fn the_shader_is_valid() {
        let module = naga::front::wgsl::parse_str(super::SPREAD_WGSL).unwrap();
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .unwrap();
    }
}
