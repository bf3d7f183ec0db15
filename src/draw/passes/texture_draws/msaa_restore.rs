//! Restores multisampled colours from the textures that they are resolved into. A camera that does not clear its colours
//! needs this, since other cameras have used the multisampled buffer in the meantime. Draw thread.

use super::{TextureDraw, covering};
use crate::draw::passes::stage_input::StageInput;
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::{ColorSamples, PassTarget};
use crate::gpu::GraphicsContext;

pub(super) const WGSL: &str = covering!("../../shaders/passes/msaa_restore.wgsl");

/// The restoration of multisampled colours.
#[derive(Default)]
pub(in crate::draw) struct MsaaRestore {
    /// Created for the first camera that keeps multisampled colours.
    draw: Option<TextureDraw>,
}

impl MsaaRestore {
    /// Returns the number of pipelines created so far.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.draw.as_ref().map_or(0, TextureDraw::created)
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
        let mut restores = false;
        for ColorSamples { format, sample_count, .. } in input.target.stale_colors(formats) {
            let draw = self.draw.get_or_insert_with(|| TextureDraw::new(input.ctx.device(), "msaa restore", WGSL));
            if let Err(error) = draw.ensure(input.ctx, (format, sample_count)) {
                let what = "multisampled colours that a camera does not clear cannot be restored";
                resources.errors.report_once(format!("{what}: {error}"));
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
        let (Some(draw), Some(formats)) = (&self.draw, resources.pipelines.target_formats(target.index)) else {
            return;
        };
        for ColorSamples { texture, samples, format, sample_count } in target.stale_colors(formats) {
            let times = resources.timer.as_mut().and_then(|timer| timer.pass("msaa restore"));
            draw.record(ctx.device(), encoder, (format, sample_count), [texture, samples], times);
        }
    }
}
