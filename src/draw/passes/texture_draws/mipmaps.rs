//! Mip levels of textures that cameras draw into, and of textures of state sets that have texels of the first level alone:
//! each is computed from the one above, once that is complete. Draw thread.

use std::sync::Arc;

use super::{TextureDraw, covering};
use crate::cull::RenderStage;
use crate::draw::resources::Resources;
use crate::gpu::GraphicsContext;
use crate::scene::Attachment;
use crate::state::{TextureDimension, TextureObject};

pub(super) const WGSL: &str = covering!("../../shaders/passes/mipmaps.wgsl");

/// Returns the colour attachments of a stage's camera whose levels are computed.
fn attachments(stage: &RenderStage) -> impl Iterator<Item = &Attachment> {
    let camera = stage.target.camera.as_ref().filter(|_| !stage.target.is_shared);
    camera.into_iter().flat_map(|camera| &camera.colors).filter(|attachment| attachment.generates_mipmaps)
}

/// The computation of mip levels.
#[derive(Default)]
pub(in crate::draw) struct Mipmaps {
    /// Created for the first camera that has levels computed.
    draw: Option<TextureDraw>,
}

impl Mipmaps {
    /// Returns the number of pipelines created so far.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.draw.as_ref().map_or(0, TextureDraw::created)
    }

    /// Records the levels of textures whose first level was uploaded, before the frame's stages.
    pub(in crate::draw) fn record_uploaded(
        &mut self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        for texture in resources.state_groups.textures.take_without_levels() {
            for layer in 0..texture.size[2] {
                self.record_levels(ctx, resources, encoder, &texture, (0, layer));
            }
        }
    }

    /// Records the levels of a stage's textures, once the stage and all that draws into the same target is recorded.
    pub(in crate::draw) fn record(
        &mut self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        encoder: &mut wgpu::CommandEncoder,
        stage: &RenderStage,
    ) {
        for Attachment { texture, level, layer, .. } in attachments(stage) {
            if texture.dimension == TextureDimension::D3 {
                resources
                    .errors
                    .report_once(format!("texture {:?} is a volume; its levels are not computed", texture.name));
                continue;
            }
            self.record_levels(ctx, resources, encoder, texture, (*level, *layer));
        }
    }

    /// Records the levels of a layer below a level.
    fn record_levels(
        &mut self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        encoder: &mut wgpu::CommandEncoder,
        texture: &Arc<TextureObject>,
        (first, layer): (u32, u32),
    ) {
        let device = ctx.device();
        let textures = &mut resources.state_groups.textures;
        let Some(format) = textures.texture(texture).map(wgpu::Texture::format) else { return };
        let draw = self.draw.get_or_insert_with(|| TextureDraw::new(device, "mipmaps", WGSL));
        if let Err(error) = draw.ensure(ctx, (format, 1)) {
            resources.errors.report_once(format!("mip levels in {format:?} cannot be drawn: {error}"));
            return;
        }
        for level in first + 1..texture.levels {
            let views = [level - 1, level].map(|level| textures.attachment(texture, level, layer));
            if let [Some(above), Some(below)] = &views {
                draw.record(device, encoder, (format, 1), [above, below], None);
            }
        }
    }
}
