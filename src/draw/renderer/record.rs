//! The commands of a frame: pictures in their order, for each stage those before it, its shadows, its pass, what is read
//! back, those after it. Draw thread.

use std::time::Instant;

use super::{DrawStats, Picture, Renderer};
use crate::cull::RenderStage;
use crate::draw::callbacks::bins::{Bins, draw_bins};
use crate::draw::callbacks::{CameraCallbacks, RenderInfo};
use crate::draw::pipelines::Bare;
use crate::draw::plan::{PassTarget, StagePlan};
use crate::draw::state::{Sources, State};
use crate::gpu::GraphicsContext;

/// A pass's name on the timeline.
fn name_of(stage: &RenderStage, target: &PassTarget) -> &'static str {
    match (&stage.target.camera, target.is_outermost()) {
        (None, true) => "picture",
        (Some(_), true) => "eye",
        (None, false) => "nested picture",
        (Some(_), false) => "camera",
    }
}

impl Renderer {
    pub(super) fn record<'a>(
        &mut self,
        ctx: &GraphicsContext,
        pictures: impl Iterator<Item = Picture<'a>>,
    ) -> DrawStats {
        let mut encoder = ctx.device().create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        let mut stats = DrawStats::default();
        let mut next = 0;
        let plans = std::mem::take(&mut self.plans);
        self.atmosphere.record(ctx, &mut encoder, self.timer.as_mut());
        for picture in pictures {
            self.record_all(ctx, &mut encoder, picture.stage, &plans, &mut next, &mut stats);
        }
        self.plans = plans;
        if let Some(timer) = &self.timer {
            timer.resolve(&mut encoder);
        }
        if let Some(queries) = &self.queries {
            queries.resolve(&mut encoder);
        }
        let submitting = Instant::now();
        let submission = ctx.queue().submit(self.uploads.drain(..).chain([encoder.finish()]));
        if let Some(timer) = &mut self.timer {
            timer.submitted(submitting);
        }
        if let Some(queries) = &mut self.queries {
            queries.submitted();
        }
        self.pictures.submitted();
        self.in_flight.push_back(submission);
        stats
    }

    #[allow(clippy::too_many_arguments, reason = "the walk over the stages carries what every pass needs")]
    fn record_all(
        &mut self,
        ctx: &GraphicsContext,
        encoder: &mut wgpu::CommandEncoder,
        stage: &RenderStage,
        plans: &[StagePlan],
        next: &mut usize,
        stats: &mut DrawStats,
    ) {
        let callbacks = CameraCallbacks::of(&stage.target.callbacks);
        let info = RenderInfo { device: ctx.device(), queue: ctx.queue(), stage, clock: self.clock };
        if let Some(initial) = callbacks.and_then(|c| c.initial.as_ref()) {
            initial(&info, encoder);
        }
        for before in &stage.pre_render {
            self.record_all(ctx, encoder, before, plans, next, stats);
        }
        let mut is_drawn = false;
        if let Some(plan) = plans.get(*next)
            && let Some(target) = &plan.target
        {
            self.record_casters(ctx, encoder, plan, stats);
            let of_pass = self.record_pass(ctx, encoder, stage, plan, target, callbacks, &info);
            stats.add(&of_pass);
            is_drawn = true;
        }
        *next += 1;
        for after in &stage.post_render {
            self.record_all(ctx, encoder, after, plans, next, stats);
        }
        // With what others draw into the same target.
        if is_drawn {
            self.copy_picture(ctx, encoder, stage);
        }
        if let Some(final_draw) = callbacks.and_then(|c| c.final_draw.as_ref()) {
            final_draw(&info, encoder);
        }
    }

    #[allow(clippy::too_many_arguments, reason = "see record_all")]
    fn record_pass(
        &mut self,
        ctx: &GraphicsContext,
        encoder: &mut wgpu::CommandEncoder,
        stage: &RenderStage,
        plan: &StagePlan,
        target: &PassTarget,
        callbacks: Option<&CameraCallbacks>,
        info: &RenderInfo<'_>,
    ) -> DrawStats {
        if let (true, Some(spread), Some(formats)) =
            (plan.spreads, &self.spread, self.pipelines.target_key(target.index))
        {
            spread.record(ctx.device(), encoder, target.spreading(formats), self.timer.as_mut());
        }
        let colors = target.color_attachments(stage, plan);
        let count = target.color_count();
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("stage"),
            color_attachments: &colors[..count],
            depth_stencil_attachment: Some(target.depth_attachment(stage)),
            timestamp_writes: self.timer.as_mut().and_then(|timer| timer.pass(name_of(stage, target))),
            occlusion_query_set: if plan.queries.is_empty() { None } else { self.queries.as_ref().map(|q| &q.set) },
            multiview_mask: None,
        });
        let mut from = self.sources(ctx, &self.frame_bind_groups);
        from.pass = self.pipelines.target_key(target.index).map(|formats| (info, *formats));
        let mut state = State::new(&mut pass, target.dynamics(None));
        if let Some((leaf, bare)) = plan.fill
            && let Some(fill) = self.pipelines.bare(bare, target.index)
        {
            state.apply(&from, plan.statics);
            state.draw_bare(fill, 3, leaf..leaf + 1);
        }
        if let Some(pre_draw) = callbacks.and_then(|c| c.pre_draw.as_ref()) {
            pre_draw(info, state.pass);
            state.forget();
        }
        let starts = plan.bin_starts.clone().and_then(|range| self.batch.bin_starts.get(range));
        let bins = starts.map(|starts| Bins { bins: &stage.bins, starts }.split_before(plan.see_through));
        match bins {
            Some((before_sky, _)) => draw_bins(&mut state, &from, info, before_sky, 0),
            None => state.draw_runs(&from, plan.runs.start..plan.see_through),
        }
        if let (false, Some(pipeline)) = (plan.queries.is_empty(), self.pipelines.bare(Bare::Query, target.index)) {
            for (leaf, query, statics) in self.query_boxes.get(plan.queries.clone()).unwrap_or_default() {
                state.apply(&from, *statics);
                state.pass.begin_occlusion_query(*query);
                state.draw_bare(pipeline, 36, *leaf..leaf + 1);
                state.pass.end_occlusion_query();
            }
        }
        if let (true, Some(sky)) = (plan.has_sky, self.pipelines.bare(Bare::Sky, target.index)) {
            state.apply(&from, plan.statics);
            state.draw_bare(sky, 3, 0..1);
        }
        if let Some(water) = plan.water.and_then(|water| self.pipelines.bare(water, target.index)) {
            state.apply(&from, plan.statics);
            state.draw_bare(water, 3, 0..1);
        }
        match bins {
            Some((_, after_sky)) => draw_bins(&mut state, &from, info, after_sky, 0),
            None => state.draw_runs(&from, plan.see_through..plan.runs.end),
        }
        if let (Some(([left, right], place)), Some(composite), Some(key)) =
            (&plan.eyes, &self.composite, self.pipelines.target_key(target.index))
            && let (Some(left), Some(right)) = (self.groups.textures.view(left), self.groups.textures.view(right))
        {
            // The viewport is the stage's.
            state.apply(&from, plan.statics);
            composite.draw(ctx.device(), state.pass, key, [left, right], *place);
            state.stats.draw_calls += 1;
            state.stats.state_changes += 2;
            state.forget();
        }
        if let Some(post_draw) = callbacks.and_then(|c| c.post_draw.as_ref()) {
            post_draw(info, state.pass);
        }
        let State { stats, errors, .. } = state;
        drop(pass);
        if let (Some(resolving), Some(resolve), Some(formats)) =
            (target.resolving(stage), &self.resolve, self.pipelines.target_key(target.index))
        {
            let kind = (formats.depth, formats.samples);
            resolve.record(ctx.device(), encoder, kind, &resolving, self.timer.as_mut());
        }
        for error in errors {
            self.complain(error);
        }
        stats
    }

    /// What a pass is drawn from.
    pub(super) fn sources<'a>(&'a self, ctx: &'a GraphicsContext, frame_groups: &'a [wgpu::BindGroup]) -> Sources<'a> {
        Sources {
            ctx,
            pipelines: &self.pipelines,
            groups: &self.groups,
            batch: &self.batch,
            statics: &self.statics,
            frame_groups,
            pulls: &self.pulls,
            indirect: self.indirect.as_ref(),
            pass: None,
        }
    }
}
