//! Mip levels of textures that cameras draw into: each is computed from the one above, once the camera has drawn. Draw
//! thread.

use crate::cull::RenderStage;
use crate::draw::resources::Resources;
use crate::gpu::{GraphicsContext, catch_errors};
use crate::scene::Attachment;
use crate::state::TextureDimension;

const MIPMAPS_WGSL: &str = include_str!("../shaders/passes/mipmaps.wgsl");

/// The pipelines that draw a level, one for each format.
struct MipmapPipelines {
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    /// `None` if the device refused the pipeline.
    by_format: Vec<(wgpu::TextureFormat, Option<wgpu::RenderPipeline>)>,
}

impl MipmapPipelines {
    fn new(device: &wgpu::Device) -> Self {
        Self {
            module: device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some("mipmaps"),
                source: wgpu::ShaderSource::Wgsl(MIPMAPS_WGSL.into()),
            }),
            layout: device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some("mipmaps"),
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
            by_format: Vec::new(),
        }
    }

    /// Creates the pipeline of a format if needed. A pipeline that the device refuses is an error the first time only.
    fn ensure(&mut self, ctx: &GraphicsContext, format: wgpu::TextureFormat) -> Result<(), String> {
        if self.by_format.iter().any(|(known, _)| *known == format) {
            return Ok(());
        }
        let (pipeline, error) = catch_errors(ctx.device(), || self.pipeline(ctx, format));
        self.by_format.push((format, error.is_none().then_some(pipeline)));
        error.map_or(Ok(()), |error| Err(format!("mip levels in {format:?} cannot be drawn: {error}")))
    }

    /// Creates the pipeline of a format, without looking for errors of the device.
    fn pipeline(&self, ctx: &GraphicsContext, format: wgpu::TextureFormat) -> wgpu::RenderPipeline {
        let device = ctx.device();
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("mipmaps"),
            bind_group_layouts: &[Some(&self.layout)],
            immediate_size: 0,
        });
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("mipmaps"),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &self.module,
                entry_point: Some("vs_mipmap"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &self.module,
                entry_point: Some("fs_mipmap"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::ALL })],
            }),
            multiview_mask: None,
            cache: ctx.pipeline_cache(),
        })
    }

    /// Records the pass that draws a level from the one above.
    fn record(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        format: wgpu::TextureFormat,
        [above, level]: [&wgpu::TextureView; 2],
    ) {
        let known = self.by_format.iter().find(|(known, _)| *known == format);
        let Some((_, Some(pipeline))) = known else { return };
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("mipmaps"),
            layout: &self.layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(above) }],
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("mipmaps"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: level,
                depth_slice: None,
                resolve_target: None,
                // The draw covers all of it.
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            depth_stencil_attachment: None,
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
    }
}

/// Returns the colour attachments of a stage's camera whose levels are computed.
fn attachments(stage: &RenderStage) -> impl Iterator<Item = &Attachment> {
    let camera = stage.target.camera.as_ref().filter(|_| !stage.target.is_shared);
    camera.into_iter().flat_map(|camera| &camera.colors).filter(|attachment| attachment.generates_mipmaps)
}

/// The computation of mip levels.
#[derive(Default)]
pub(in crate::draw) struct Mipmaps {
    /// Created for the first camera that has levels computed.
    pipelines: Option<MipmapPipelines>,
}

impl Mipmaps {
    /// Returns the number of pipelines created so far.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.pipelines.as_ref().map_or(0, |pipelines| pipelines.by_format.len() as u32)
    }

    /// Records the levels of a stage's textures, once the stage and all that draws into the same target is recorded.
    pub(in crate::draw) fn record(
        &mut self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        encoder: &mut wgpu::CommandEncoder,
        stage: &RenderStage,
    ) {
        let device = ctx.device();
        for Attachment { texture, level, layer, .. } in attachments(stage) {
            if texture.dimension == TextureDimension::D3 {
                resources
                    .errors
                    .report_once(format!("texture {:?} is a volume; its levels are not computed", texture.name));
                continue;
            }
            let textures = &mut resources.state_groups.textures;
            let Some(format) = textures.texture(texture).map(wgpu::Texture::format) else { continue };
            let pipelines =
                self.pipelines.get_or_insert_with(|| catch_errors(device, || MipmapPipelines::new(device)).0);
            if let Err(error) = pipelines.ensure(ctx, format) {
                resources.errors.report_once(error);
                continue;
            }
            for level in *level + 1..texture.levels {
                let views = [level - 1, level].map(|level| textures.attachment(texture, level, *layer));
                if let [Some(above), Some(below)] = &views {
                    pipelines.record(device, encoder, format, [above, below]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_shader_is_valid() {
        let module = naga::front::wgsl::parse_str(super::MIPMAPS_WGSL).unwrap();
        naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
            .validate(&module)
            .unwrap();
    }
}
