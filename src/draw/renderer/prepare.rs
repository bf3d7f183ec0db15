//! The first half of a draw: what the stages come to. Nothing is recorded yet; nothing waits for the adapter.

use std::sync::Arc;

use super::prewarm::DrawnInto;
use super::views::{Surroundings, ViewFrame, clip_of_view};
use super::{FrameClock, Picture, Renderer};
use crate::cull::{CullCamera, FadeBand, RenderStage};
use crate::draw::answers::Queries;
use crate::draw::batch::StateEntry;
use crate::draw::composite::Composite;
use crate::draw::pipelines::Bare;
use crate::draw::pipelines::key::Shading;
use crate::draw::pipelines::programs::Builtins;
use crate::draw::plan::{PassTarget, StagePlan, color};
use crate::draw::resolve::DepthResolve;
use crate::draw::spread::Spread;
use crate::draw::state::{Dynamics, Statics};
use crate::draw::uniforms::fixed::{FixedUniform, position_of, replaces_sun};
use crate::draw::uniforms::frame::LeafUniform;
use crate::gpu::{GraphicsContext, watched};
use crate::scene::{CullingMode, Sky};
use crate::state::{Mode, NumberError, PolygonMode, ResolvedState, Scissor, TEXTURE_UNITS, TextureObject, Viewport};

impl Renderer {
    pub(super) fn prepare<'a>(&mut self, ctx: &GraphicsContext, pictures: impl Iterator<Item = Picture<'a>> + Clone) {
        self.batch.start_frame();
        self.groups.start_frame(self.pipelines.start_frame());
        self.statics.clear();
        if ctx.is_first_face() {
            self.drawn_into.clear();
        }
        self.plans.clear();
        self.casters.clear();
        self.query_boxes.clear();
        self.pulls.start_frame();
        if let Some(timer) = &mut self.timer {
            timer.start_frame(ctx.device(), self.timed.0, self.timed.1);
        }
        if let Some(queries) = &mut self.queries {
            queries.start_frame();
        }
        if let Some(problem) = self.targets.start_frame(ctx, pictures.clone().map(|p| p.stage)) {
            self.complain(problem);
        }
        if let Some(composite) = &mut self.composite {
            composite.start_frame();
        }
        (self.shadow_leaves, self.shadow_leaves_dropped) = (0, 0);
        (self.airs_refused, self.stages_refused) = (0, 0);
        let own: usize = pictures.clone().map(|picture| leaves_of(picture.stage, &own_leaves)).sum();
        let casters: usize = pictures.clone().map(|picture| leaves_of(picture.stage, &casters_of)).sum();
        self.reserve_leaves(ctx, own + casters);
        self.caster_room = self.leaf_room.saturating_sub(own);
        self.binds_anew |= self.atmosphere.start_draw(ctx.face_count());
        self.prepare_shadow_maps(ctx, pictures.clone());
        let mut dropped = 0;
        for Picture { stage, environment } in pictures {
            let mut environment = *environment;
            let air = self.air_of(ctx, &stage.camera, &mut environment);
            let shadows = environment.shadows;
            let around = Surroundings { environment, shadows, air, is_outermost: true, is_whole: true };
            dropped += self.prepare_all(ctx, stage, &around);
        }
        for (bucket, _) in self.batch.buckets.iter().filter(|(b, _)| b.stride > 0) {
            self.pulls.ensure(ctx, &self.pipelines.pull_layout, (bucket.vertex_chunk, bucket.index_chunk));
        }
        self.leaves_dropped = dropped as u32;
        // Without their number, which is another one in each frame. Where memory is short that has been said.
        let is_full = self.leaf_room == self.most_leaves;
        if is_full && self.shadow_leaves_dropped > 0 {
            self.complain(
                "there are more leaves than the adapter's largest buffer holds; some cast no shadow".to_owned(),
            );
        }
        if is_full && dropped > 0 {
            self.complain(
                "there are more leaves than the adapter's largest buffer holds; some are not drawn".to_owned(),
            );
        }
        let refused = std::mem::take(&mut self.atmosphere.errors);
        for error in std::mem::take(&mut self.pipelines.errors).into_iter().chain(refused) {
            self.complain(error);
        }
    }

    /// Prepares a stage and those around it, in the order drawn; how many leaves there was no room for.
    fn prepare_all(&mut self, ctx: &GraphicsContext, stage: &RenderStage, around: &Surroundings) -> usize {
        let mut dropped = 0;
        for before in &stage.pre_render {
            // An eye's picture is a whole one, with its sky.
            let of_eye = stage.stereo.is_some() && around.is_outermost;
            let around = if of_eye { *around } else { self.surroundings_of_stage(ctx, before, around) };
            dropped += self.prepare_all(ctx, before, &around);
        }
        dropped += self.prepare_stage(ctx, stage, around);
        for after in &stage.post_render {
            let around = self.surroundings_of_stage(ctx, after, around);
            dropped += self.prepare_all(ctx, after, &around);
        }
        dropped
    }

    fn prepare_stage(&mut self, ctx: &GraphicsContext, stage: &RenderStage, around: &Surroundings) -> usize {
        let Surroundings { environment, is_whole, .. } = around;
        let is_outermost = around.is_outermost;
        let found = self.targets.of(ctx, &mut self.groups.textures, &mut self.pipelines, &stage.target, is_outermost);
        let target = match found {
            Ok(target) => target,
            Err(problem) => {
                self.complain(problem);
                self.stages_refused += 1;
                self.plans.push(StagePlan::default());
                return 0;
            }
        };
        let first_caster = self.casters.len();
        let mut frames = std::mem::take(&mut self.view_frames);
        let background = self.prepare_views(ctx, stage, around, &target, &mut frames);
        let ViewFrame { uniform, positioned, air_kind, has_shadows, .. } = frames[0];
        let casters = first_caster..self.casters.len();
        let base = Statics {
            dynamics: target.dynamics(stage.target.viewport_px),
            frame: [uniform, positioned],
            air: around.air.place,
            group: None,
        };
        let first_statics = self.statics.len() as u32;
        self.statics.push(base);
        for (node, error) in wrong_numbers(stage) {
            self.complain(format!("{node}: {error}"));
        }
        for error in stage.lights.iter().filter_map(|l| position_of(&l.light).err()) {
            self.complain(format!("a LightSource: {error}"));
        }
        let has_own_light = replaces_sun(stage);
        // An empty stage has none; what comes will.
        let will_have = around.shadows.is_some() && stage.leaf_count() == 0;
        let has_casters = !casters.is_empty() || will_have;
        let drawn = DrawnInto { target: target.index, has_own_light, air: air_kind, has_shadows: has_casters };
        if !self.drawn_into.contains(&drawn) {
            self.drawn_into.push(drawn);
        }
        let mut states = std::mem::take(&mut self.batch.states);
        states.clear();
        let leaves_out = target.samples == 1 && stage.camera.settings.culling.contains(CullingMode::SAMPLES);
        let fades = stage.fade_of_state.iter().chain(std::iter::repeat(&0));
        for ((state, view), fade) in stage.state_sets.iter().zip(&stage.view_of_state).zip(fades) {
            let (shading, group) = self.shading(ctx, stage, *view, state, has_own_light, &target);
            if state.stencil().is_some()
                && let Some(depth) = target.depth_without_stencil(stage)
            {
                let (name, depth) = (name_of(state), &depth.name);
                self.complain(format!("{name}: texture {depth:?} has no stencil; the stencil test passes everywhere"));
            }
            let mut statics = Statics { group, ..base };
            let of_view = frames.get(*view as usize).unwrap_or(&frames[0]);
            (statics.frame, statics.air) = ([of_view.uniform, of_view.positioned], of_view.air);
            let viewport = stage.views.get((*view as usize).wrapping_sub(1)).and_then(|v| v.viewport_px);
            apply_state(&mut statics.dynamics, state, viewport, &target);
            let recent = self.statics.len().saturating_sub(STATICS_COMPARED).max(first_statics as usize);
            let known = self.statics[recent..].iter().rposition(|s| *s == statics).map(|at| recent + at);
            let index = known.unwrap_or_else(|| {
                self.statics.push(statics);
                self.statics.len() - 1
            });
            let key = self.pipelines.state_key(state, shading, target.index);
            let key = if of_view.has_shadows { key.shadowed() } else { key }.in_air(of_view.air_kind);
            let band = stage.fades.get((*fade as usize).wrapping_sub(1)).copied().unwrap_or(FadeBand::FULL);
            let entry = StateEntry::new(key, index as u32, state, band);
            states.push(if leaves_out && state.polygon_mode() == PolygonMode::Fill {
                let [x, y, width, height, ..] = statics.dynamics.viewport;
                entry.without_unsampled(self.batch.grid(clip_of_view(stage, *view), [x, y, width, height]))
            } else {
                entry
            });
        }
        self.batch.states = states;
        let (first_run, first_bin) = (self.batch.runs.len(), self.batch.bin_starts.len());
        let (dropped, see_through) = self.batch.build(ctx, &mut self.pipelines, stage, self.leaf_room);
        let runs = first_run..self.batch.runs.len();
        let is_called = stage.bins.iter().any(|bin| !bin.callbacks.is_empty());
        let bin_starts = is_called.then_some(first_bin..self.batch.bin_starts.len());
        let queries = self.prepare_queries(ctx, stage, &target, &frames, base);
        self.view_frames = frames;
        let has_sky =
            *is_whole && stage.stereo.is_none() && stage.clear_node.is_none() && environment.sky == Sky::Atmosphere;
        if has_sky {
            self.pipelines.ensure_bare(ctx, Bare::Sky, target.index);
        }
        let has_water = *is_whole && stage.stereo.is_none() && environment.water.is_some();
        let water = has_water.then_some(if has_shadows { Bare::ShadowedWater } else { Bare::Water });
        if let Some(water) = water {
            self.pipelines.ensure_bare(ctx, water, target.index);
        }
        let eyes = self.prepare_eyes(ctx, stage, &target, &base.dynamics);
        let has_part = target.is_part(stage);
        let clear = if *is_whole { Some(background) } else { stage.target.clear_color.map(color) };
        let is_part = clear.is_some() && (has_part || *is_whole && is_outermost && target.is_begun);
        let fill = match stage.clear_node {
            _ if !is_part || has_sky => None,
            Some(said) => said.map(color),
            None => clear,
        };
        let fills_depth = has_part && !is_outermost && stage.target.clear_depth;
        let bare = match (fill, fills_depth) {
            (Some(_), true) => Some(Bare::Fill),
            (Some(_), false) => Some(Bare::FillColor),
            (None, true) => Some(Bare::FillDepth),
            (None, false) => None,
        };
        let fill = bare.and_then(|bare| self.prepare_fill(ctx, &target, fill.unwrap_or_default(), bare));
        let mut plan = StagePlan {
            eyes,
            target: None,
            runs,
            bin_starts,
            see_through,
            statics: first_statics,
            queries,
            has_sky,
            water,
            casters,
            clear,
            fill,
            is_part,
            spreads: false,
        };
        if target.clear_color(stage, &plan).is_none()
            && let Some(formats) = self.pipelines.target_key(target.index).copied()
        {
            let mut refused = Vec::new();
            for spreading in target.spreading(&formats) {
                let spread = self.spread.get_or_insert_with(|| watched(ctx.device(), || Spread::new(ctx.device())).0);
                refused.extend(spread.ensure(ctx, spreading.kind).err());
                plan.spreads = true;
            }
            refused.into_iter().for_each(|error| self.complain(error));
        }
        if target.resolving(stage).is_some()
            && let Some(formats) = self.pipelines.target_key(target.index).copied()
        {
            let resolve =
                self.resolve.get_or_insert_with(|| watched(ctx.device(), || DepthResolve::new(ctx.device())).0);
            if let Err(error) = resolve.ensure(ctx, (formats.depth, formats.samples)) {
                self.complain(error);
            }
        }
        self.plans.push(StagePlan { target: Some(target), ..plan });
        dropped
    }

    /// Who shades the leaves of a state; what is wrong with its program, only once.
    pub(super) fn shading_of(
        &mut self,
        ctx: &GraphicsContext,
        state: &ResolvedState,
        has_own_light: bool,
    ) -> Result<Shading, String> {
        Ok(match state.program() {
            Some(program) => match self.pipelines.programs.ensure(ctx.device(), program)? {
                Some(place) => Shading::Program(place),
                None => Shading::Fallback,
            },
            None if (0..TEXTURE_UNITS).any(|unit| state.texture(unit).is_some()) => Shading::FixedTextured,
            None if has_own_light || state.is_fixed_function() => Shading::FixedFunction,
            None => Shading::Plain,
        })
    }

    /// Who shades the leaves of a state, and with what.
    pub(super) fn shading(
        &mut self,
        ctx: &GraphicsContext,
        stage: &RenderStage,
        view: u32,
        state: &Arc<ResolvedState>,
        has_own_light: bool,
        target: &PassTarget,
    ) -> (Shading, Option<(u32, Option<u32>)>) {
        for (name, error) in state.wrong_numbers() {
            let name = if name.is_empty() { "a state set" } else { name };
            self.complain(format!("{name}: {error}"));
        }
        let mut wrong: Vec<String> = Vec::new();
        let shading = self.shading_of(ctx, state, has_own_light).unwrap_or_else(|problem| {
            wrong.push(problem);
            Shading::Fallback
        });
        let group = match shading {
            Shading::Plain | Shading::Fallback => None,
            Shading::FixedFunction | Shading::FixedTextured => {
                Some(self.groups.push(&FixedUniform::new(state, stage, view)))
            }
            Shading::Program(place) => {
                let program = self.pipelines.programs.get(place);
                let size = program.map_or(0, |p| p.uniform_bytes);
                (size > 0).then(|| {
                    let at = self.groups.reserve(size);
                    let builtins = builtins(stage.camera_of(view), &self.clock);
                    let bytes = &mut self.groups.bytes[at as usize..][..size];
                    if let Some(Err(problem)) = program.map(|p| p.fill(state, &builtins, bytes)) {
                        wrong.push(problem);
                    }
                    at
                })
            }
        };
        let group = match shading {
            Shading::Plain | Shading::Fallback => None,
            _ => {
                let attached = |binding: &crate::state::TextureBinding| target.draws_into(stage, &binding.texture);
                let found =
                    self.groups.group(ctx, &self.pipelines, shading, state, attached, |problem| wrong.push(problem));
                Some((found, group))
            }
        };
        for problem in wrong {
            self.complain(format!("{}: {problem}", name_of(state)));
        }
        (shading, group)
    }

    /// A leaf for the background of a part of a target, and what draws it.
    fn prepare_fill(
        &mut self,
        ctx: &GraphicsContext,
        target: &PassTarget,
        color: wgpu::Color,
        bare: Bare,
    ) -> Option<(u32, Bare)> {
        let leaf = self.batch.leaves().len();
        if leaf >= self.leaf_room {
            return None;
        }
        self.pipelines.ensure_bare(ctx, bare, target.index);
        let color = [color.r, color.g, color.b, color.a].map(|c| c as f32);
        self.batch.push_leaf(LeafUniform { color, ..LeafUniform::EMPTY });
        Some((leaf as u32, bare))
    }

    /// The textures of the eyes that a stage puts together.
    fn prepare_eyes(
        &mut self,
        ctx: &GraphicsContext,
        stage: &RenderStage,
        target: &PassTarget,
        dynamics: &Dynamics,
    ) -> Option<([Arc<TextureObject>; 2], usize)> {
        let mode = stage.stereo?;
        let key = *self.pipelines.target_key(target.index)?;
        // What is wrong with it its pipelines say.
        let composite = self.composite.get_or_insert_with(|| watched(ctx.device(), || Composite::new(ctx.device())).0);
        let origin = [dynamics.viewport[0] as u32, dynamics.viewport[1] as u32];
        let place = match composite.prepare(ctx, &key, mode, stage.stereo_gap_px, origin) {
            Ok(place) => place,
            Err(error) => {
                self.complain(error);
                return None;
            }
        };
        let eye = |of: &RenderStage| Some(of.target.camera.as_ref()?.colors.first()?.texture.clone());
        Some(([eye(stage.pre_render.first()?)?, eye(stage.pre_render.get(1)?)?], place))
    }

    /// Leaves for the boxes of a stage's occlusion queries: where they lie in the renderer's list.
    fn prepare_queries(
        &mut self,
        ctx: &GraphicsContext,
        stage: &RenderStage,
        target: &PassTarget,
        frames: &[ViewFrame],
        base: Statics,
    ) -> std::ops::Range<usize> {
        let first = self.query_boxes.len();
        if stage.queries.is_empty() {
            return first..first;
        }
        if self.queries.is_none() {
            let made = Queries::new(ctx.memory());
            self.queries = made.map_err(|error| self.complain(error)).ok();
            self.queries.iter_mut().for_each(Queries::start_frame);
        }
        let Some(queries) = &mut self.queries else {
            // What nobody can ask for counts as seen.
            stage.queries.iter().for_each(|query| query.results.was_not_asked(true, query.frame));
            return first..first;
        };
        self.pipelines.ensure_bare(ctx, Bare::Query, target.index);
        for query in &stage.queries {
            let Some(rows) = stage.eye_from_drawable.get(query.matrix as usize) else { continue };
            if self.batch.leaves().len() >= self.leaf_room {
                query.results.was_not_asked(true, query.frame);
                continue;
            }
            let Some(index) = queries.ask(query) else { continue };
            let ViewFrame { uniform, positioned, air, .. } = *frames.get(query.view as usize).unwrap_or(&frames[0]);
            let mut statics = Statics { frame: [uniform, positioned], air, ..base };
            let view = stage.views.get((query.view as usize).wrapping_sub(1));
            if let Some(rect) = view.and_then(|view| view.viewport_px) {
                statics.dynamics.viewport[..4].copy_from_slice(&target.viewport(rect.map(|v| v as f32)));
            }
            let place = match self.statics.iter().rposition(|s| *s == statics) {
                Some(place) => place,
                None => {
                    self.statics.push(statics);
                    self.statics.len() - 1
                }
            };
            self.query_boxes.push((self.batch.leaves().len() as u32, index, place as u32));
            self.batch.push_leaf(LeafUniform { eye_from_drawable: *rows, ..LeafUniform::EMPTY });
        }
        first..self.query_boxes.len()
    }
}

/// For errors.
fn name_of(state: &ResolvedState) -> &str {
    if state.name.is_empty() { "a state set" } else { &state.name }
}

/// Lights, planes and units of a stage's nodes that there are not.
fn wrong_numbers(stage: &RenderStage) -> impl Iterator<Item = (&'static str, NumberError)> {
    let lights = stage.lights.iter().map(|l| ("a LightSource", Mode::Light(l.light.number)));
    let planes = stage.clip_planes.iter().map(|p| ("a ClipNode", Mode::ClipPlane(p.number)));
    let texgens = stage.texgens.iter().map(|t| ("a TexGenNode", Mode::TexGen(t.unit)));
    let all = lights.chain(planes).chain(texgens);
    all.filter_map(|(node, mode)| mode.check().err().map(|error| (node, error)))
}

/// Statics compared with a new one, newest first.
const STATICS_COMPARED: usize = 4;

fn builtins(camera: &CullCamera, clock: &FrameClock) -> Builtins {
    let view = glam::DMat4::from(camera.eye_from_world);
    Builtins {
        frame: camera.frame,
        frame_time_s: clock.reference_time_s as f32,
        delta_frame_time_s: clock.delta_s as f32,
        simulation_time_s: clock.simulation_time_s as f32,
        view: view.as_mat4(),
        view_inverse: view.inverse().as_mat4(),
    }
}

/// Puts a state's viewport, depth range, scissor and constants over those of its stage.
fn apply_state(dynamics: &mut Dynamics, state: &ResolvedState, view: Option<[u32; 4]>, target: &PassTarget) {
    let [width, height] = target.size_px;
    if let Some(rect) = view {
        dynamics.viewport[..4].copy_from_slice(&target.viewport(rect.map(|v| v as f32)));
    }
    if let Some(Viewport { x, y, width, height }) = state.viewport() {
        dynamics.viewport[..4].copy_from_slice(&target.viewport([x, y, width, height]));
    }
    if let Some(depth) = state.depth() {
        // Stored reversed: the near plane has 1. All may lie at one depth.
        let [near, far] = depth.range.map(|v| v.clamp(0.0, 1.0));
        let (near, far) = if near <= far { (near, far) } else { (0.0, 1.0) };
        (dynamics.viewport[4], dynamics.viewport[5]) = (1.0 - far, 1.0 - near);
    }
    if let Some(Scissor { x, y, width: w, height: h }) = state.scissor() {
        let (x, y) = (x.min(width), y.min(height));
        dynamics.scissor = [x, y, w.min(width - x), h.min(height - y)];
    }
    dynamics.stencil_reference = state.stencil().map_or(0, |s| u32::from(s.reference));
    if state.blends() && state.blend_func().has_constant() {
        dynamics.blend_color = Some(state.blend_color());
    }
}

/// Leaves of a stage and of those before and after it.
fn leaves_of(stage: &RenderStage, of_one: &impl Fn(&RenderStage) -> usize) -> usize {
    let around = stage.pre_render.iter().chain(&stage.post_render);
    of_one(stage) + around.map(|other| leaves_of(other, of_one)).sum::<usize>()
}

/// With boxes and a background: what may go into the buffer.
fn own_leaves(stage: &RenderStage) -> usize {
    stage.leaf_count() + stage.queries.len() + 1
}

/// The same of what casts shadows, once for each cascade.
fn casters_of(stage: &RenderStage) -> usize {
    let all = std::iter::once(&stage.shadows).chain(stage.views.iter().map(|view| &view.shadows));
    all.flat_map(|shadows| &shadows.cascades).map(|cascade| cascade.stage.leaf_count()).sum()
}
