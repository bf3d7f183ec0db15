//! The sky: one triangle behind all opaque runs, coloured by the air tables. Draw thread.

use super::stage_input::LitStage;
use crate::draw::pipelines::builtin_pipelines::{Builtin, BuiltinPipelines};
use crate::draw::recorder::{DrawSources, PassRecorder};
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::PassTarget;
use crate::gpu::GraphicsContext;
use crate::scene::Sky;

/// The pipelines of the sky.
pub(in crate::draw) struct SkyPass {
    pipelines: BuiltinPipelines,
}

impl Default for SkyPass {
    fn default() -> Self {
        Self { pipelines: BuiltinPipelines::new(Builtin::Sky) }
    }
}

impl SkyPass {
    /// Creates the pipeline if the stage has a sky; returns whether it has one.
    pub(in crate::draw) fn prepare(&mut self, resources: &mut Resources, lit: &LitStage<'_>) -> bool {
        let has_sky = lit.has_surroundings()
            && lit.input.stage.clear_node.is_none()
            && lit.around.environment.sky == Sky::Atmosphere;
        if has_sky {
            self.pipelines.ensure(lit.input.ctx, &mut resources.pipelines, lit.input.target.index);
        }
        has_sky
    }

    /// Creates the pipeline for a target before a stage needs it.
    pub(in crate::draw) fn prewarm(&mut self, ctx: &GraphicsContext, resources: &mut Resources, target: u16) {
        self.pipelines.ensure(ctx, &mut resources.pipelines, target);
    }

    /// Records the sky of a stage that has one.
    pub(in crate::draw) fn record(
        &self,
        recorder: &mut PassRecorder<'_, '_>,
        sources: &DrawSources<'_>,
        target: &PassTarget,
        base_index: u32,
    ) {
        if let Some(pipeline) = self.pipelines.get(target.index) {
            recorder.apply(sources, base_index);
            recorder.draw_builtin(pipeline, 3, 0..1);
        }
    }
}
