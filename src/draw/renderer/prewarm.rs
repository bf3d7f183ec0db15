//! Pipelines made before they are needed: when a page has arrived and its drawables are about to be uploaded.

use crate::draw::pipelines::key::{AirKind, PipelineKey, Shading, StateKey};
use crate::draw::pipelines::{MOST_COLORS, TargetFormats};
use crate::draw::renderer::Renderer;
use crate::gpu::GraphicsContext;
use crate::scene::{DrawKind, Environment, Topology};

/// What a stage was drawn into, as far as pipelines depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct DrawnInto {
    /// In the pipelines.
    pub(super) target: u8,
    /// A light replaces the sun.
    pub(super) has_own_light: bool,
    pub(super) air: AirKind,
    /// The sun's shadows fall there.
    pub(super) has_shadows: bool,
}

impl Renderer {
    /// Makes the pipelines, those of fades and of shadows too, that drawables of some kinds will need where the last
    /// frame drew; before the first frame, in the context's own target. Between frames, so that no draw has to.
    pub fn prewarm(&mut self, ctx: &mut GraphicsContext, kinds: &[DrawKind]) {
        if self.drawn_into.is_empty()
            && let Some(target) = self.own_target(ctx)
        {
            let air = AirKind::of(&Environment::default());
            self.drawn_into.push(DrawnInto { target, has_own_light: false, air, has_shadows: false });
        }
        let has_shadows = self.drawn_into.iter().any(|drawn| drawn.has_shadows);
        for kind in kinds {
            for place in 0..self.drawn_into.len() {
                let made = self.prewarm_in(ctx, kind, self.drawn_into[place]);
                self.report_problem_of(kind, made);
            }
            if has_shadows {
                let made = self.prewarm_caster(ctx, kind);
                self.report_problem_of(kind, made);
            }
        }
        for error in std::mem::take(&mut self.pipelines.errors) {
            self.complain(error);
        }
    }

    fn report_problem_of(&mut self, kind: &DrawKind, made: Result<(), String>) {
        if let Err(problem) = made {
            let name = &kind.state.name;
            let name = if name.is_empty() { "a state set" } else { name };
            self.complain(format!("{name}: {problem}"));
        }
    }

    fn prewarm_in(&mut self, ctx: &mut GraphicsContext, kind: &DrawKind, drawn: DrawnInto) -> Result<(), String> {
        let found = self.shading_of(ctx, &kind.state, drawn.has_own_light);
        let shading = *found.as_ref().unwrap_or(&Shading::Fallback);
        let whole = self.pipelines.state_key(&kind.state, shading, drawn.target);
        let whole = if drawn.has_shadows { whole.shadowed() } else { whole }.in_air(drawn.air);
        self.prewarm_key(ctx, kind, &whole);
        self.prewarm_key(ctx, kind, &whole.fading());
        found.map(drop)
    }

    /// What it casts its shadow with.
    fn prewarm_caster(&mut self, ctx: &mut GraphicsContext, kind: &DrawKind) -> Result<(), String> {
        if matches!(kind.topology, Some(Topology::Lines | Topology::Points)) {
            return Ok(());
        }
        if let Some(key) = self.caster_key(ctx, &kind.state)? {
            self.prewarm_key(ctx, kind, &key);
        }
        Ok(())
    }

    fn prewarm_key(&mut self, ctx: &mut GraphicsContext, kind: &DrawKind, state: &StateKey) {
        let key = match kind.topology {
            None => PipelineKey::height(state, kind.mirrored),
            Some(topology) => PipelineKey::mesh(state, topology, kind.is_masked, kind.double_sided, kind.mirrored),
        };
        let key = if kind.is_small && state.can_pull && !kind.is_masked {
            key.pulled()
        } else if kind.attributes.is_empty() {
            key.with_vertices(kind.vertex_format)
        } else {
            // Where there is no place for its layout it is not uploaded either.
            let Some(place) = ctx.layout_place(&kind.attributes) else { return };
            self.pipelines.with_layout(key, place, &kind.attributes)
        };
        self.pipelines.ensure_for(ctx, key, &kind.state);
    }

    fn own_target(&mut self, ctx: &GraphicsContext) -> Option<u8> {
        let depth = self.targets.depth_format();
        let mut key = TargetFormats { colors: [None; MOST_COLORS], depth, samples: ctx.samples(), keeps_alpha: false };
        key.colors[0] = Some(ctx.color_format());
        self.pipelines.target(&key)
    }
}
