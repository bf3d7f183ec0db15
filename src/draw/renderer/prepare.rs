//! The first half of a draw: prepares the passes of all stages, then uploads what they read. Nothing is recorded yet, and
//! nothing waits for the adapter. Draw thread.

use super::pass_plan::PassPlan;
use super::views::surroundings_of_stage;
use super::{CameraView, Renderer};
use crate::cull::RenderStage;
use crate::draw::bound_state::BoundState;
use crate::draw::passes::frame_copy;
use crate::draw::passes::leaves::Leaves;
use crate::draw::passes::stage_input::{LitStage, StageInput, Surroundings};
use crate::draw::targets::error::TargetError;
use crate::draw::targets::pass_target::PassTarget;
use crate::draw::uniforms::frame_groups::FrameResources;
use crate::draw::uniforms::stage::{position_of, replaces_sun};
use crate::gpu::GraphicsContext;
use crate::state::Mode;

impl Renderer {
    /// Prepares all passes of a frame's views.
    pub(super) fn prepare<'a>(&mut self, ctx: &GraphicsContext, views: impl Iterator<Item = CameraView<'a>> + Clone) {
        self.start_frame(ctx, views.clone().map(|view| view.stage));
        let own: usize = views.clone().map(|view| sum_stages(view.stage, &own_leaves)).sum();
        let casters: usize = views.clone().map(|view| sum_stages(view.stage, &caster_leaves)).sum();
        match self.resources.leaf_buffer.reserve(ctx, own, casters) {
            Ok(true) => self.resources.frame_groups.invalidate(),
            Ok(false) => {}
            Err(error) => self.resources.errors.report_once(error),
        }
        let settings = views.clone().map(|view| (view.stage, view.environment));
        if self.passes.shadows.prepare_maps(ctx, &mut self.resources, settings) {
            self.resources.frame_groups.invalidate();
        }
        views.clone().for_each(|view| frame_copy::prepare(ctx, &mut self.resources, view.stage));
        for CameraView { stage, environment } in views {
            let mut environment = *environment;
            self.targets.start_view(stage, environment.tone_mapping);
            let air = self.passes.air.prepare(ctx, &mut self.resources, &stage.camera, &mut environment);
            let shadows = environment.shadows;
            let around = Surroundings { environment, shadows, air, is_outermost: true, is_whole: true };
            self.prepare_stages(ctx, stage, &around);
        }
        let resources = &mut self.resources;
        for chunks in resources.batch.pulled_chunks() {
            resources.vertex_pulling.ensure(ctx, resources.pipelines.pull_layout(), chunks);
        }
        self.report_dropped_leaves();
        self.resources.report_pipeline_errors();
    }

    /// Forgets the last frame.
    fn start_frame<'a>(&mut self, ctx: &GraphicsContext, stages: impl Iterator<Item = &'a RenderStage> + Clone) {
        self.resources.start_frame();
        ctx.pools().start_draw();
        if ctx.is_first_target_selected() {
            self.drawn_into.clear();
        }
        self.plans.clear();
        if let Some(timer) = &mut self.resources.timer {
            timer.start_frame(ctx.device(), self.timed.0, self.timed.1);
        }
        if let Some(problem) = self.targets.start_frame(ctx, stages) {
            self.resources.errors.report_once(problem);
        }
        self.passes.shadows.start_frame();
        self.passes.queries.start_frame();
        self.passes.composition.start_frame();
        if self.passes.air.start_draw(ctx.target_count()) {
            self.resources.frame_groups.invalidate();
        }
    }

    /// Reports leaves that the adapter's largest buffer has no room for. Their number is left out, since it differs in each
    /// frame. A smaller buffer, for lack of memory, was reported when it was created.
    fn report_dropped_leaves(&mut self) {
        let resources = &mut self.resources;
        if !resources.leaf_buffer.is_largest() {
            return;
        }
        if resources.stats.shadow_leaves_dropped > 0 {
            resources
                .errors
                .report_once("there are more leaves than the adapter's largest buffer holds; some cast no shadow");
        }
        if resources.stats.leaves_dropped > 0 {
            resources
                .errors
                .report_once("there are more leaves than the adapter's largest buffer holds; some are not drawn");
        }
    }

    /// Prepares a stage and the stages before and after it, in the order drawn.
    fn prepare_stages(&mut self, ctx: &GraphicsContext, stage: &RenderStage, around: &Surroundings) {
        for before in &stage.pre_render {
            // The image of an eye is a whole view with its own sky.
            let is_eye = stage.stereo.is_some() && around.is_outermost;
            let around = if is_eye { *around } else { self.surroundings(ctx, before, around) };
            self.prepare_stages(ctx, before, &around);
        }
        let plan = match self.find_target(ctx, stage, around) {
            Ok(target) => Some(self.prepare_stage(ctx, stage, around, target)),
            Err(error) => {
                if error != TargetError::Reported {
                    self.resources.errors.report_once(error);
                }
                self.resources.stats.stages_refused += 1;
                None
            }
        };
        self.plans.push(plan);
        for after in &stage.post_render {
            let around = self.surroundings(ctx, after, around);
            self.prepare_stages(ctx, after, &around);
        }
    }

    /// Returns the surroundings of a stage before or after another one.
    fn surroundings(&mut self, ctx: &GraphicsContext, stage: &RenderStage, above: &Surroundings) -> Surroundings {
        surroundings_of_stage(ctx, &mut self.passes, &mut self.resources, stage, above)
    }

    fn find_target(
        &mut self,
        ctx: &GraphicsContext,
        stage: &RenderStage,
        around: &Surroundings,
    ) -> Result<PassTarget, TargetError> {
        let (textures, pipelines) = (&mut self.resources.state_groups.textures, &mut self.resources.pipelines);
        self.targets.find(ctx, textures, pipelines, &stage.target, around.is_outermost)
    }

    /// Prepares the passes of one stage.
    fn prepare_stage(
        &mut self,
        ctx: &GraphicsContext,
        stage: &RenderStage,
        around: &Surroundings,
        target: PassTarget,
    ) -> PassPlan {
        let input = StageInput { ctx, stage, target: &target, clock: self.clock };
        let first_shadow = self.passes.shadows.view_count();
        let (passes, resources) = (&mut self.passes, &mut self.resources);
        let hides_casters = self.hides_unready && self.drawn_into.had_shadows(target.index);
        let sky_color = self.views.prepare(passes, resources, &input, around, hides_casters);
        let shadows = first_shadow..passes.shadows.view_count();
        let views = self.views.frames();
        let base = BoundState {
            dynamics: target.dynamics(stage.target.viewport_px),
            frame: [views[0].uniform, views[0].positioned],
            air: around.air.set,
            group: None,
            attribute: None,
        };
        let base_index = resources.bound_states.push(base);
        let positioned_of_state = self.views.positioned_of_state();
        let lit = LitStage { input, around, views, positioned_of_state, base, base_index };
        invalid_parts(stage).for_each(|problem| resources.errors.report_once(problem));
        let has_own_light = replaces_sun(stage);
        let kind = self.drawn_into.add(&lit, has_own_light, !shadows.is_empty());

        let hides = self.hides_unready && self.drawn_into.was_drawn(&kind);
        let leaves = resources.hide_unready(hides, |resources| Leaves::prepare(resources, &lit, has_own_light));
        let queries = passes.queries.prepare(resources, &lit);
        let has_sky = passes.sky.prepare(resources, &lit);
        let water = passes.water.prepare(resources, &lit);
        let composition = passes.composition.prepare(resources, &lit);
        let background = passes.background.prepare(resources, &lit, sky_color, has_sky);
        let keeps_colors = background.clear_color.is_none();
        let restores_samples = passes.msaa_restore.prepare(resources, &input, keeps_colors);
        passes.depth_resolve.prepare(resources, &input);
        passes.display.prepare(resources, &input);
        PassPlan {
            base_index,
            shadows,
            restores_samples,
            background,
            leaves,
            queries,
            has_sky,
            water,
            composition,
            target,
        }
    }

    /// Uploads leaves, uniforms and arguments of indirect calls, and creates the bind groups whose resources were replaced.
    /// If there is no memory for the uniforms or the leaves, nothing is drawn.
    pub(super) fn upload(&mut self, ctx: &GraphicsContext) {
        let (resources, passes) = (&mut self.resources, &self.passes);
        match resources.state_groups.finish(ctx, &resources.pipelines) {
            Ok(finished) => {
                if finished.is_new_buffer {
                    resources.frame_groups.invalidate();
                }
                resources.stats.state_groups_created = finished.groups_created;
            }
            Err(error) => {
                resources.errors.report_once(error);
                return self.discard_frame();
            }
        }
        let (Some(uniforms), Some(leaves)) = (resources.state_groups.buffer(), resources.leaf_buffer.buffer()) else {
            // The missing buffer was reported when it was created.
            return self.discard_frame();
        };
        let frame = FrameResources { layout: resources.pipelines.frame_layout(), uniforms, leaves };
        let (air, shadows) = (|set| passes.air.entries(set), |is_target| passes.shadows.entries(is_target));
        resources.frame_groups.ensure(ctx.device(), &frame, passes.air.index_count(), air, shadows);
        resources.leaf_buffer.upload(ctx.queue(), resources.batch.leaves());
        if let Err(error) = resources.indirect.upload(ctx, resources.batch.runs()) {
            resources.errors.report_once(error);
        }
    }

    /// Draws nothing in a frame that was prepared.
    pub(super) fn discard_frame(&mut self) {
        self.plans.fill_with(|| None);
        self.resources.batch.start_frame();
        self.passes.queries.discard();
        let stats = &mut self.resources.stats;
        stats.stages_refused = self.plans.len() as u32;
        (stats.leaves, stats.leaves_dropped) = (0, 0);
        (stats.shadow_leaves, stats.shadow_leaves_dropped) = (0, 0);
    }
}

/// Returns what is wrong with the lights, clip planes and texture units of a stage: numbers out of range, and lights that do
/// not shine.
fn invalid_parts(stage: &RenderStage) -> impl Iterator<Item = String> {
    let lights = stage.lights.iter().map(|l| ("a LightSource", Mode::Light(l.light.number)));
    let planes = stage.clip_planes.iter().map(|p| ("a ClipNode", Mode::ClipPlane(p.number)));
    let texgens = stage.texgens.iter().map(|t| ("a TexGenNode", Mode::TexGen(t.unit)));
    let numbers = lights.chain(planes).chain(texgens);
    let numbers = numbers.filter_map(|(node, mode)| mode.check().err().map(|error| format!("{node}: {error}")));
    let lights = stage.lights.iter().map(|l| ("a LightSource", &l.light));
    let of_states = stage.state_sets.iter().flat_map(|state| state.lights());
    let of_states = of_states.map(|light| ("a light of a state set", light));
    let local = stage.local_lights.iter().map(|l| ("a LocalLights", &l.light));
    let all = lights.chain(of_states).chain(local);
    let positions = all.filter_map(|(node, light)| position_of(light).err().map(|error| format!("{node}: {error}")));
    numbers.chain(positions)
}

/// Returns the sum of a count over a stage and the stages before and after it.
fn sum_stages(stage: &RenderStage, count: &impl Fn(&RenderStage) -> usize) -> usize {
    let around = stage.pre_render.iter().chain(&stage.post_render);
    count(stage) + around.map(|other| sum_stages(other, count)).sum::<usize>()
}

/// Returns the room that a stage needs in the leaf buffer: its leaves, its query boxes and its background.
fn own_leaves(stage: &RenderStage) -> usize {
    stage.leaf_count() + stage.queries.len() + 1
}

/// Returns the room that the casters of a stage need, counted once for each cascade.
fn caster_leaves(stage: &RenderStage) -> usize {
    let all = std::iter::once(&stage.shadows).chain(stage.views.iter().map(|view| &view.shadows));
    all.flat_map(|shadows| &shadows.cascades).map(|cascade| cascade.stage.leaf_count()).sum()
}
