//! Passes that draw one texture over the whole of another: mip levels, and the restoration of multisampled colours. Draw
//! thread.

mod mipmaps;
mod msaa_restore;

pub(in crate::draw) use mipmaps::Mipmaps;
pub(in crate::draw) use msaa_restore::MsaaRestore;

use super::fullscreen::{FullscreenPipeline, PipelinesByKind, image_layout};
use crate::gpu::{GraphicsContext, catch_errors};

/// Format and samples a pixel of a target.
type Kind = (wgpu::TextureFormat, u32);

/// Joins the shader that covers a target with a fragment shader `fs_main`, which reads the texture at binding 0.
macro_rules! covering {
    ($fragment:literal) => {
        concat!(include_str!("../../shaders/passes/cover.wgsl"), include_str!($fragment))
    };
}
use covering;

/// A shader that draws a texture over a target, and its pipelines, one for each kind of target.
struct TextureDraw {
    label: &'static str,
    module: wgpu::ShaderModule,
    layout: wgpu::BindGroupLayout,
    pipelines: PipelinesByKind<Kind>,
}

impl TextureDraw {
    /// Creates the shader and the layout, from the result of [`covering`]. Errors of the device are dropped: the pipelines have
    /// them too.
    fn new(device: &wgpu::Device, label: &'static str, wgsl: &str) -> Self {
        let create = || {
            let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(label),
                source: wgpu::ShaderSource::Wgsl(wgsl.into()),
            });
            Self { label, module, layout: image_layout(device, label), pipelines: PipelinesByKind::new() }
        };
        catch_errors(device, create).0
    }

    /// Returns the number of pipelines created so far.
    fn created(&self) -> u32 {
        self.pipelines.created()
    }

    /// Creates the pipeline of a kind if needed. A pipeline that the device refuses is an error the first time only.
    fn ensure(&mut self, ctx: &GraphicsContext, kind: Kind) -> Result<(), String> {
        let Self { label, module, layout, pipelines } = self;
        let (format, samples) = kind;
        let create = || {
            FullscreenPipeline {
                label,
                module,
                entry_points: ["vs_cover", "fs_main"],
                constants: &[],
                bind_group_layouts: &[Some(layout)],
                colors: &[Some(format.into())],
                depth_stencil: None,
                samples,
            }
            .create(ctx)
        };
        pipelines.ensure(ctx.device(), kind, create).map_err(|error| error.to_string())
    }

    /// Records the pass that draws a texture over a target of a kind. Does nothing if there is no pipeline of the kind.
    fn record(
        &self,
        device: &wgpu::Device,
        encoder: &mut wgpu::CommandEncoder,
        kind: Kind,
        [texture, target]: [&wgpu::TextureView; 2],
        timestamp_writes: Option<wgpu::RenderPassTimestampWrites<'_>>,
    ) {
        let Some(pipeline) = self.pipelines.get(&kind) else { return };
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.label),
            layout: &self.layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::TextureView(texture) }],
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(self.label),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                // The draw covers all of it.
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                    store: wgpu::StoreOp::Store,
                },
            })],
            timestamp_writes,
            ..wgpu::RenderPassDescriptor::default()
        });
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.draw(0..3, 0..1);
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
        let mut draw = TextureDraw::new(ctx.device(), "restore", msaa_restore::WGSL);
        // No adapter supports 7 samples a pixel.
        let kind = (wgpu::TextureFormat::Rgba8Unorm, 7);
        assert!(draw.ensure(&ctx, kind).is_err());
        assert_eq!((draw.ensure(&ctx, kind), draw.created()), (Ok(()), 1));
        assert!(ctx.take_device_errors().is_empty());
    }

    #[test]
    fn the_shaders_are_valid() {
        for wgsl in [mipmaps::WGSL, msaa_restore::WGSL] {
            let module = naga::front::wgsl::parse_str(wgsl).unwrap();
            naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
                .validate(&module)
                .unwrap();
        }
    }
}
