//! Prewarms pipelines: creates them when a page has arrived and its drawables are about to be uploaded, so that no draw
//! has to. Draw thread, before the uploads of a frame and between frames. The caller limits how many it creates at once.

use super::Renderer;
use super::drawn_stages::DrawnStage;
use crate::draw::passes::shading::{choose_shading, name_of};
use crate::draw::passes::shadows::casters::caster_key;
use crate::draw::pipelines::key::{AirKind, PipelineKey, Shading, StateKey};
use crate::draw::pipelines::{MAX_COLOR_ATTACHMENTS, TargetFormats};
use crate::draw::targets::pass_target::Tones;
use crate::draw::targets::table::Targets;
use crate::gpu::{DEPTH_FORMAT, GraphicsContext};
use crate::scene::{DrawKind, Environment, Sky, Topology};
use crate::state::TEXTURE_UNITS;

/// A change of views that later frames will draw; for [`Renderer::prewarm_change`].
#[derive(Clone, Copy, Debug)]
pub struct ViewChange {
    /// The light and air that the views will have.
    pub environment: Environment,
    /// True if a light of number 0 will replace the sun.
    pub has_own_light: bool,
    /// True if some state will use the stencil, so that depth buffers have one.
    pub uses_stencil: bool,
}

/// Kinds of stages, each a target with an air, lights and shadows, in which drawables will be drawn.
pub(crate) struct StageKinds(Vec<DrawnStage>);

impl Renderer {
    /// Creates the pipelines that drawables of some kinds will need where the last frame drew, those of fades and shadows
    /// included. Before the first frame, pipelines are created for the context's own target. Returns how many did not exist
    /// before.
    ///
    /// Queues the textures of the kinds' states to be uploaded before the drawables that are queued next.
    pub fn prewarm(&mut self, ctx: &mut GraphicsContext, kinds: &[DrawKind]) -> u32 {
        let stages = self.stage_kinds(ctx);
        self.prewarm_for(ctx, kinds, &stages)
    }

    /// Returns the kinds of stages that the last frame has drawn and that are expected.
    pub(crate) fn stage_kinds(&mut self, ctx: &GraphicsContext) -> StageKinds {
        if self.drawn_into.drawn_count() == 0
            && let Some(target) = self.own_target(ctx)
        {
            let air = AirKind::of(&Environment::default());
            self.drawn_into.add_expected(target, air);
        }
        StageKinds(self.drawn_into.iter().copied().collect())
    }

    /// Orders the pipelines of [`Self::prewarm`] for given kinds of stages from the pipeline thread. Returns how many are not
    /// there.
    pub(crate) fn order_prewarm(&mut self, ctx: &mut GraphicsContext, kinds: &[DrawKind], stages: &StageKinds) -> u32 {
        self.resources.pipelines.pipeline_thread.begin();
        self.create_pipelines(ctx, kinds, stages);
        self.resources.pipelines.pipeline_thread.end()
    }

    /// Keeps the pipeline thread from creating anything until the returned sender is dropped.
    #[cfg(test)]
    pub(crate) fn hold_pipelines(&mut self, ctx: &GraphicsContext) -> crate::sync::primitives::channel::Sender<()> {
        let (hold, held) = crate::sync::primitives::channel::bounded::<()>(1);
        let thread = &mut self.resources.pipelines.pipeline_thread;
        let wait = move |_: &wgpu::Device| held.recv().is_ok();
        drop(thread.order(ctx.device(), "hold".to_owned(), wait));
        hold
    }

    /// Does the same as [`Self::prewarm`] for given kinds of stages. Returns the number of pipelines that it created.
    pub(crate) fn prewarm_for(&mut self, ctx: &mut GraphicsContext, kinds: &[DrawKind], stages: &StageKinds) -> u32 {
        self.announce_textures(ctx, kinds);
        self.create_pipelines(ctx, kinds, stages)
    }

    /// Does the same as [`Self::prewarm_for`] without the textures.
    pub(crate) fn create_pipelines(
        &mut self,
        ctx: &mut GraphicsContext,
        kinds: &[DrawKind],
        stages: &StageKinds,
    ) -> u32 {
        let before = self.resources.pipelines.created();
        let has_shadows = stages.0.iter().any(|drawn| drawn.has_shadows);
        for kind in kinds {
            for stage in &stages.0 {
                let result = self.prewarm_stage(ctx, kind, *stage);
                self.report(kind, result);
            }
            if has_shadows {
                let result = self.prewarm_caster(ctx, kind);
                self.report(kind, result);
            }
        }
        self.resources.report_pipeline_errors();
        self.resources.pipelines.created() - before
    }

    /// Creates the pipelines that what was drawn and prewarmed so far needs once its views change, and expects the change:
    /// kinds that are prewarmed later get the pipelines of both.
    ///
    /// Three kinds are not covered:
    ///
    /// - drawables in new shadow maps whose state has a program, the fixed function or blending
    /// - states that a light has lit, once the sun lights them again
    /// - custom drawables
    ///
    /// Their pipelines follow from states that earlier pipelines do not name. Keeping all states that were ever drawn would
    /// keep their textures too. Frames create these pipelines when they need them, and
    /// [`DrawStats::pipelines_created`](crate::draw::DrawStats::pipelines_created) counts them.
    pub fn prewarm_change(&mut self, ctx: &mut GraphicsContext, change: &ViewChange) {
        let ViewChange { environment, has_own_light, uses_stencil } = change;
        let (air, has_shadows) = (AirKind::of(environment), environment.shadows.is_some());
        for index in 0..self.drawn_into.drawn_count() {
            let from = self.drawn_into.drawn(index);
            let target = if *uses_stencil { self.with_stencil(from.target) } else { Some(from.target) };
            let Some(target) = target else { continue };
            let has_own_light = *has_own_light || from.has_own_light;
            let to = DrawnStage { target, has_own_light, air, has_shadows };
            if to == from {
                continue;
            }
            self.drawn_into.expect(to);
            self.ensure_changed(ctx, from, to);
            if environment.sky == Sky::Atmosphere {
                self.passes.air.prewarm(ctx, &mut self.resources);
                self.passes.sky.prewarm(ctx, &mut self.resources, target);
            }
            if environment.water.is_some() {
                self.passes.water.prewarm(ctx, &mut self.resources, target, has_shadows);
            }
        }
        self.resources.report_pipeline_errors();
    }

    /// Returns the target of the same formats with a stencil beside its depth; `None` if the adapter lacks it.
    fn with_stencil(&mut self, target: u16) -> Option<u16> {
        let mut formats = *self.resources.pipelines.target_formats(target)?;
        if formats.depth == DEPTH_FORMAT {
            formats.depth = self.targets.stencil_format()?;
        }
        self.resources.pipelines.target(&formats)
    }

    /// Has the compile queue upload the textures of state sets, before the drawables that are queued next.
    pub(crate) fn announce_textures(&mut self, ctx: &mut GraphicsContext, kinds: &[DrawKind]) {
        let textures = &mut self.resources.state_groups.textures;
        for kind in kinds {
            for binding in (0..TEXTURE_UNITS).filter_map(|unit| kind.state.texture(unit)) {
                if let Some(texture) = textures.announce(ctx.device(), &binding.texture) {
                    ctx.compile_texture(binding.texture.clone(), texture);
                }
            }
        }
        ctx.set_texture_bytes(textures.bytes());
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
        if kind.is_splats || matches!(kind.topology, Some(Topology::Lines | Topology::Points | Topology::Squares)) {
            return Ok(());
        }
        if let Some(key) = caster_key(&mut self.resources.pipelines, ctx.device(), &kind.state)? {
            self.prewarm_key(ctx, kind, &key);
        }
        Ok(())
    }

    fn prewarm_key(&mut self, ctx: &mut GraphicsContext, kind: &DrawKind, state: &StateKey) {
        let key = match kind.topology {
            None if kind.is_splats => PipelineKey::splats(state),
            None => PipelineKey::height(state, kind.mirrored),
            Some(topology) => PipelineKey::mesh(state, topology, kind.is_masked, kind.double_sided, kind.mirrored),
        };
        let key = if kind.has_surface { key.with_surface(kind.is_layered) } else { key };
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
        formats.colors[0] = Some(Targets::drawn_format(ctx, Tones::Displayed));
        self.resources.pipelines.target(&formats)
    }
}
