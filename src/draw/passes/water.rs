//! The sea: one triangle whose pixels find the water surface along their rays, and write its depth. Draw thread.

use super::stage_input::LitStage;
use crate::draw::pipelines::builtin_pipelines::{Builtin, BuiltinPipelines};
use crate::draw::recorder::{DrawSources, PassRecorder};
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::PassTarget;
use crate::gpu::GraphicsContext;

/// How the water of a stage is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::draw) enum Water {
    #[default]
    None,
    Plain,
    /// The sun's shadows fall on it.
    Shadowed,
}

/// The pipelines of water.
pub(in crate::draw) struct WaterPass {
    plain: BuiltinPipelines,
    shadowed: BuiltinPipelines,
}

impl Default for WaterPass {
    fn default() -> Self {
        let [plain, shadowed] = [Builtin::Water, Builtin::ShadowedWater].map(BuiltinPipelines::new);
        Self { plain, shadowed }
    }
}

impl WaterPass {
    /// Creates the pipeline if the stage has water; returns how it is drawn.
    pub(in crate::draw) fn prepare(&mut self, resources: &mut Resources, lit: &LitStage<'_>) -> Water {
        if !lit.has_surroundings() || lit.around.environment.water.is_none() {
            return Water::None;
        }
        let (water, pipelines) = match lit.view(0).has_shadows {
            true => (Water::Shadowed, &mut self.shadowed),
            false => (Water::Plain, &mut self.plain),
        };
        pipelines.ensure(lit.input.ctx, &mut resources.pipelines, lit.input.target.index);
        water
    }

    /// Creates the pipeline for a target before a stage needs it.
    pub(in crate::draw) fn prewarm(
        &mut self,
        ctx: &GraphicsContext,
        resources: &mut Resources,
        target: u16,
        has_shadows: bool,
    ) {
        let pipelines = if has_shadows { &mut self.shadowed } else { &mut self.plain };
        pipelines.ensure(ctx, &mut resources.pipelines, target);
    }

    /// Records the water of a stage, if it has any.
    pub(in crate::draw) fn record(
        &self,
        recorder: &mut PassRecorder<'_, '_>,
        sources: &DrawSources<'_>,
        target: &PassTarget,
        water: Water,
        base_index: u32,
    ) {
        let pipelines = match water {
            Water::None => return,
            Water::Plain => &self.plain,
            Water::Shadowed => &self.shadowed,
        };
        if let Some(pipeline) = pipelines.get(target.index) {
            recorder.apply(sources, base_index);
            recorder.draw_builtin(pipeline, 3, 0..1);
        }
    }
}
