//! Shadows of the sun: what the cascades of a stage come to, and their passes, which come right before the stage's. Draw
//! thread.

use super::Picture;
use super::Renderer;
use crate::cull::{CullCamera, FadeBand, MAX_CASCADES, RenderStage, StageShadows};
use crate::draw::DrawStats;
use crate::draw::atmosphere::Air;
use crate::draw::batch::StateEntry;
use crate::draw::pipelines::key::{Shading, StateKey};
use crate::draw::pipelines::{MOST_COLORS, TargetFormats};
use crate::draw::plan::{PassTarget, StagePlan};
use crate::draw::shadow_maps::{FORMAT, Wanted};
use crate::draw::state::{Dynamics, State, Statics};
use crate::draw::uniforms::frame::FrameUniform;
use crate::gpu::GraphicsContext;
use crate::scene::{CameraEnvironment, CameraShadows, Environment, SunShadows, has_parallel_rays};
use crate::state::{CLIP_PLANES, Mode, ResolvedState, TEXTURE_UNITS};

/// What the cascades of a stage come to.
#[derive(Clone, Default)]
pub(in crate::draw) struct CasterPlan {
    /// Of the batch, by cascade.
    runs: [std::ops::Range<usize>; MAX_CASCADES],
    count: usize,
    first_layer: usize,
    size_px: u32,
}

/// What casts shadows, and what it is drawn with.
#[derive(Clone, Copy)]
pub(super) struct Casting<'a> {
    pub(super) shadows: &'a StageShadows,
    /// In whose eye space it is.
    pub(super) camera: &'a CullCamera,
    pub(super) environment: &'a Environment,
    pub(super) air: &'a Air,
    /// Of the maps.
    pub(super) first_layer: usize,
    /// The view of the stage that it casts into.
    pub(super) view: u32,
    /// Where the uniform of what is positioned there lies.
    pub(super) positioned: u32,
}

impl Renderer {
    /// Makes room for the maps of a frame's pictures.
    pub(super) fn prepare_shadow_maps<'a>(
        &mut self,
        ctx: &GraphicsContext,
        pictures: impl Iterator<Item = Picture<'a>> + Clone,
    ) {
        let most_px = self.shadow_maps.most_px;
        let mut wanted = Wanted::default();
        for Picture { stage, environment } in pictures {
            let mut look = |stage: &RenderStage, said: Option<SunShadows>| match said.map_or(Ok(()), |s| s.check()) {
                Err(problem) => self.complain(problem.to_string()),
                Ok(()) if said.is_some_and(|s| s.resolution_px > most_px) => {
                    self.complain(format!("the adapter has no shadow maps of more than {most_px} texels a side"));
                }
                Ok(()) => wanted.add(stage, most_px),
            };
            look(stage, environment.shadows);
            look_around(stage, &mut look);
        }
        match self.shadow_maps.ensure(ctx.memory(), wanted) {
            Ok(is_new) => self.binds_anew |= is_new,
            Err(error) => self.complain(error),
        }
    }

    /// Prepares what casts shadows into a stage, or into a view inside it: in the room that the pictures' own
    /// leaves leave.
    pub(super) fn prepare_casters(
        &mut self,
        ctx: &GraphicsContext,
        stage: &RenderStage,
        casting: &Casting<'_>,
        target: &PassTarget,
    ) {
        let Some(into) = self.caster_target() else { return };
        let Casting { shadows, camera, environment, air, first_layer, view, positioned } = *casting;
        let size_px = shadows.settings.resolution_px;
        let count = shadows.cascades.len().min(MAX_CASCADES);
        let mut plan = CasterPlan { count, first_layer, size_px, ..Default::default() };
        for (runs, cascade) in plan.runs.iter_mut().zip(&shadows.cascades) {
            // The picture's own eye and levels of detail, seen along the sun's rays.
            let mut uniform = FrameUniform::new(camera, &cascade.clip_from_eye, environment, air);
            // Heights morph as they do in the picture: the sun's own rays are parallel.
            uniform.air[3] = if has_parallel_rays(&camera.clip_from_eye) { 1.0 } else { 0.0 };
            let frame = self.groups.push(&uniform);
            let base = Statics { dynamics: of_map(size_px), frame: [frame, positioned], air: 0, group: None };
            let plain = self.statics.len() as u32;
            self.statics.push(base);
            let mut states = std::mem::take(&mut self.batch.states);
            states.clear();
            for state in &cascade.stage.state_sets {
                let drops = drops_parts(state);
                let (shading, group) = if drops || has_own_shader(state) {
                    self.shading(ctx, stage, view, state, drops, target)
                } else {
                    (Shading::Plain, None)
                };
                let index = match group {
                    None => plain,
                    Some(_) => {
                        self.statics.push(Statics { group, ..base });
                        self.statics.len() as u32 - 1
                    }
                };
                states.push(StateEntry::new(
                    StateKey::caster(state, shading, drops, into),
                    index,
                    state,
                    FadeBand::FULL,
                ));
            }
            self.batch.states = states;
            let (first_run, before) = (self.batch.runs.len(), self.batch.leaves().len());
            let most_leaves = before + self.caster_room;
            let (dropped, _) = self.batch.build(ctx, &mut self.pipelines, &cascade.stage, most_leaves);
            let taken = self.batch.leaves().len() - before;
            self.caster_room -= taken;
            self.shadow_leaves += taken as u32;
            self.shadow_leaves_dropped += dropped as u32;
            *runs = first_run..self.batch.runs.len();
        }
        self.casters.push(plan);
    }

    /// What pipelines must know of the shadow maps.
    fn caster_target(&mut self) -> Option<u8> {
        self.pipelines.target(&TargetFormats {
            colors: [None; MOST_COLORS],
            depth: FORMAT,
            samples: 1,
            keeps_alpha: false,
        })
    }

    /// The pipeline part of what casts shadows under a state, before it is drawn; why there is none.
    pub(super) fn caster_key(
        &mut self,
        ctx: &GraphicsContext,
        state: &ResolvedState,
    ) -> Result<Option<StateKey>, String> {
        let Some(into) = self.caster_target().filter(|_| state.casts_shadow()) else { return Ok(None) };
        let drops = drops_parts(state);
        let needs_shader = drops || has_own_shader(state);
        let shading = if needs_shader { self.shading_of(ctx, state, drops)? } else { Shading::Plain };
        Ok(Some(StateKey::caster(state, shading, drops, into)))
    }

    /// Draws the casters of a stage's cascades, a pass each.
    pub(super) fn record_casters(
        &mut self,
        ctx: &GraphicsContext,
        encoder: &mut wgpu::CommandEncoder,
        plan: &StagePlan,
        stats: &mut DrawStats,
    ) {
        let casters = self.casters.get(plan.casters.clone()).unwrap_or_default().iter();
        let passes = casters
            .flat_map(|c| (c.first_layer..).zip(&c.runs[..c.count]).map(|(layer, runs)| (layer, runs, c.size_px)));
        for (layer, runs, size_px) in passes {
            debug_assert!(size_px <= self.shadow_maps.size_px());
            let Some(layer) = self.shadow_maps.layer(layer) else { return };
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("shadows"),
                color_attachments: &[],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: layer,
                    // Reversed-Z: nothing is in the sun's way.
                    depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store }),
                    stencil_ops: None,
                }),
                timestamp_writes: self.timer.as_mut().and_then(|timer| timer.pass("shadows")),
                occlusion_query_set: None,
                multiview_mask: None,
            });
            let from = self.sources(ctx, self.caster_bind_group.as_slice());
            let mut state = State::new(&mut pass, of_map(self.shadow_maps.size_px()));
            state.draw_runs(&from, runs.clone());
            stats.shadow_draw_calls += state.stats.draw_calls;
            stats.draw_calls += state.stats.draw_calls;
            stats.state_changes += state.stats.state_changes;
            stats.state_changes_skipped += state.stats.state_changes_skipped;
            stats.passes += 1;
        }
    }
}

/// Looks at the stages before and after one, with the shadows that cameras say themselves.
fn look_around(stage: &RenderStage, look: &mut impl FnMut(&RenderStage, Option<SunShadows>)) {
    for other in stage.pre_render.iter().chain(&stage.post_render) {
        let environment = match &other.target.environment {
            CameraEnvironment::Own(own) => own.shadows,
            _ => None,
        };
        let said = match other.target.shadows {
            CameraShadows::None => None,
            CameraShadows::Environment => environment,
            CameraShadows::Own(own) => Some(own),
        };
        look(other, said);
        look_around(other, look);
    }
}

/// All of a map.
fn of_map(size_px: u32) -> Dynamics {
    let side = size_px as f32;
    Dynamics {
        viewport: [0.0, 0.0, side, side, 0.0, 1.0],
        scissor: [0, 0, size_px, size_px],
        stencil_reference: 0,
        blend_color: None,
    }
}

/// True where an alpha test or clip planes drop parts of what casts.
fn drops_parts(state: &ResolvedState) -> bool {
    state.alpha_func().is_some() || state.mode_bits(Mode::ClipPlane(0), CLIP_PLANES) != 0
}

/// True where a state's own vertices or alphas decide what casts.
fn has_own_shader(state: &ResolvedState) -> bool {
    state.program().is_some() || (0..TEXTURE_UNITS).any(|unit| state.texture(unit).is_some())
}
