//! Prewarms pipelines: creates them when a page has arrived and its drawables are about to be uploaded, so that no draw
//! has to. Draw thread, between frames.

use super::Renderer;
use super::drawn_stages::DrawnStage;
use crate::draw::passes::shading::{choose_shading, name_of};
use crate::draw::passes::shadows::casters::caster_key;
use crate::draw::pipelines::key::{AirKind, PipelineKey, Shading, StateKey};
use crate::draw::pipelines::{MAX_COLOR_ATTACHMENTS, TargetFormats};
use crate::gpu::GraphicsContext;
use crate::scene::{DrawKind, Environment, Topology};

impl Renderer {
    /// Creates the pipelines that drawables of some kinds will need where the last frame drew, those of fades and shadows
    /// included. Before the first frame, pipelines are created for the context's own target.
    pub fn prewarm(&mut self, ctx: &mut GraphicsContext, kinds: &[DrawKind]) {
        if self.drawn_into.len() == 0
            && let Some(target) = self.own_target(ctx)
        {
            let air = AirKind::of(&Environment::default());
            self.drawn_into.add_expected(target, air);
        }
        let has_shadows = self.drawn_into.iter().any(|drawn| drawn.has_shadows);
        for kind in kinds {
            for index in 0..self.drawn_into.len() {
                let result = self.prewarm_stage(ctx, kind, self.drawn_into.get(index));
                self.report(kind, result);
            }
            if has_shadows {
                let result = self.prewarm_caster(ctx, kind);
                self.report(kind, result);
            }
        }
        self.resources.report_pipeline_errors();
    }

    fn report(&mut self, kind: &DrawKind, result: Result<(), String>) {
        if let Err(problem) = result {
            self.resources.errors.report_once(format!("{}: {problem}", name_of(&kind.state)));
        }
    }

    fn prewarm_stage(&mut self, ctx: &mut GraphicsContext, kind: &DrawKind, drawn: DrawnStage) -> Result<(), String> {
        let pipelines = &mut self.resources.pipelines;
        let found = choose_shading(&mut pipelines.programs, ctx.device(), &kind.state, drawn.has_own_light);
        let shading = *found.as_ref().unwrap_or(&Shading::Fallback);
        let whole = pipelines.state_key(&kind.state, shading, drawn.target);
        let whole = if drawn.has_shadows { whole.shadowed() } else { whole }.in_air(drawn.air);
        self.prewarm_key(ctx, kind, &whole);
        self.prewarm_key(ctx, kind, &whole.fading());
        found.map(drop)
    }

    fn prewarm_caster(&mut self, ctx: &mut GraphicsContext, kind: &DrawKind) -> Result<(), String> {
        if matches!(kind.topology, Some(Topology::Lines | Topology::Points | Topology::Squares)) {
            return Ok(());
        }
        if let Some(key) = caster_key(&mut self.resources.pipelines, ctx.device(), &kind.state)? {
            self.prewarm_key(ctx, kind, &key);
        }
        Ok(())
    }

    fn prewarm_key(&mut self, ctx: &mut GraphicsContext, kind: &DrawKind, state: &StateKey) {
        let key = match kind.topology {
            None => PipelineKey::height(state, kind.mirrored),
            Some(topology) => PipelineKey::mesh(state, topology, kind.is_masked, kind.double_sided, kind.mirrored),
        };
        let key = if kind.has_surface { key.with_surface() } else { key };
        let key = if kind.is_small && state.can_pull && !kind.is_masked {
            key.pulled()
        } else if kind.attributes.is_empty() {
            key.with_vertices(kind.vertex_format)
        } else {
            // A mesh whose layout finds no index is not uploaded either.
            let Some(index) = ctx.attribute_layout_index(&kind.attributes) else { return };
            self.resources.pipelines.with_layout(key, index, &kind.attributes)
        };
        self.resources.pipelines.ensure(ctx, key, Some(&kind.state));
    }

    fn own_target(&mut self, ctx: &GraphicsContext) -> Option<u16> {
        let depth = self.targets.depth_format();
        let samples = ctx.samples();
        let mut formats = TargetFormats { colors: [None; MAX_COLOR_ATTACHMENTS], depth, samples, keeps_alpha: false };
        formats.colors[0] = Some(ctx.color_format());
        self.resources.pipelines.target(&formats)
    }
}
