//! Copies of what cameras show into textures; OSG's `RenderStage::copyTexture`. Draw thread.

use std::sync::Arc;

use crate::cull::RenderStage;
use crate::draw::resources::Resources;
use crate::gpu::{GraphicsContext, texture_format};
use crate::state::TextureObject;

/// The image that a stage is drawn into, and the part of it that is copied.
struct CopySource<'a> {
    /// The first colour of a camera: texture, level and layer. `None` is the context's own image.
    color: Option<(&'a Arc<TextureObject>, u32, u32)>,
    format: wgpu::TextureFormat,
    /// x, y, width and height in pixels.
    part_px: [u32; 4],
}

impl<'a> CopySource<'a> {
    /// Returns the source of a stage; `None` for a camera without colours, or whose viewport is outside of its target.
    fn of(ctx: &GraphicsContext, stage: &'a RenderStage) -> Option<Self> {
        let (color, format, [width, height]) = match &stage.target.camera {
            None => (None, ctx.color_format(), ctx.size_px()),
            Some(camera) => {
                let first = camera.colors.first()?;
                let [width, height, _] = first.texture.level_size(first.level);
                let color = (&first.texture, first.level, first.layer);
                (Some(color), texture_format(first.texture.format), [width, height])
            }
        };
        let [left, top, across, down] = stage.target.viewport_px.unwrap_or([0, 0, width, height]);
        let (x, y) = (left.min(width), top.min(height));
        let part_px = [x, y, across.min(width - x), down.min(height - y)];
        (part_px[2] > 0 && part_px[3] > 0).then_some(Self { color, format, part_px })
    }
}

/// Gives the textures of a frame's copies their sizes and formats, before bind groups refer to them.
pub(in crate::draw) fn prepare(ctx: &GraphicsContext, resources: &mut Resources, stage: &RenderStage) {
    if let Some(texture) = &stage.target.copy_to
        && let Some(CopySource { format, part_px: [.., width, height], .. }) = CopySource::of(ctx, stage)
        && let Err(error) = resources.state_groups.ensure_copy(ctx, texture, [width, height], format)
    {
        resources.errors.report_once(error);
    }
    for other in stage.pre_render.iter().chain(&stage.post_render) {
        prepare(ctx, resources, other);
    }
}

/// Records the copy that a stage's camera asks for, once the stage and those after it are recorded.
pub(in crate::draw) fn record(
    ctx: &GraphicsContext,
    resources: &mut Resources,
    encoder: &mut wgpu::CommandEncoder,
    stage: &RenderStage,
) {
    let Some(texture) = &stage.target.copy_to else { return };
    let Some(CopySource { color, part_px: [x, y, width, height], .. }) = CopySource::of(ctx, stage) else { return };
    let textures = &resources.state_groups.textures;
    let (source, mip_level, z) = match color {
        None => (ctx.color_texture(), 0, 0),
        Some((color, level, layer)) => (textures.texture(color), level, layer),
    };
    let (Some(source), Some(copy)) = (source, textures.texture(texture)) else { return };
    if !source.usage().contains(wgpu::TextureUsages::COPY_SRC) || copy.size().width != width {
        let name = &texture.name;
        resources.errors.report_once(format!("texture {name:?}: the platform does not let this image be copied"));
        return;
    }
    encoder.copy_texture_to_texture(
        wgpu::TexelCopyTextureInfo {
            texture: source,
            mip_level,
            origin: wgpu::Origin3d { x, y, z },
            aspect: wgpu::TextureAspect::All,
        },
        copy.as_image_copy(),
        wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
    );
}
