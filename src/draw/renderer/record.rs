//! The second half of a draw: records all passes into one encoder and submits it. Draw thread.
//!
//! ```text
//! mip levels of uploaded textures, air tables
//! for each view, record_stages(stage):
//!     record_stages of the stages before it
//!     initial callback; that of a camera in the graph comes before the stages before it
//!     shadow maps, MSAA restore, the stage's render pass, depth resolve, display
//!     record_stages of the stages after it
//!     mip levels, copy into a texture, copies to be read back
//!     final callback
//! ```

use std::time::Instant;

use super::pass_plan::PassPlan;
use super::{CameraView, Renderer};
use crate::cull::RenderStage;
use crate::draw::callbacks::camera::CameraCallbacks;
use crate::draw::callbacks::info::RenderInfo;
use crate::draw::passes::frame_copy;
use crate::draw::passes::leaves::Part;
use crate::draw::recorder::{DrawSources, PassRecorder};
use crate::draw::targets::pass_target::PassTarget;
use crate::gpu::GraphicsContext;

/// Returns the name of a stage's pass on the timeline.
fn pass_name(stage: &RenderStage, target: &PassTarget) -> &'static str {
    match (&stage.target.camera, target.is_outermost()) {
        (None, true) => "picture",
        (Some(_), true) => "eye",
        (None, false) => "nested picture",
        (Some(_), false) => "camera",
    }
}

/// A frame that is being recorded.
struct Recording<'a> {
    ctx: &'a GraphicsContext,
    encoder: wgpu::CommandEncoder,
    /// The plans of the stages that were not recorded yet, in the order drawn; `None` for refused stages.
    plans: std::slice::Iter<'a, Option<PassPlan>>,
}

impl Renderer {
    /// Records the prepared views and submits them after the uploads of the compile thread.
    pub(super) fn record<'a>(&mut self, ctx: &GraphicsContext, views: impl Iterator<Item = CameraView<'a>>) {
        let plans = std::mem::take(&mut self.plans);
        let encoder = ctx.device().create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("frame") });
        let mut recording = Recording { ctx, encoder, plans: plans.iter() };
        self.passes.mipmaps.record_uploaded(ctx, &mut self.resources, &mut recording.encoder);
        self.passes.air.record(ctx, &mut recording.encoder, self.resources.timer.as_mut());
        for view in views {
            self.record_stages(&mut recording, view.stage, true);
        }
        let mut encoder = recording.encoder;
        self.plans = plans;
        if let Some(timer) = &self.resources.timer {
            timer.resolve(&mut encoder);
        }
        self.passes.queries.resolve(&mut encoder);
        let submitting = Instant::now();
        let submission = ctx.queue().submit(self.uploads.drain(..).chain([encoder.finish()]));
        if let Some(timer) = &mut self.resources.timer {
            timer.submitted(submitting);
        }
        self.passes.queries.submitted();
        self.passes.readback.submitted();
        self.frames_in_flight.push(submission);
    }

    /// Records a stage with the stages before and after it. `is_view` is true for the stage of a view's own camera, whose
    /// callbacks have the order of OSG's SceneView.
    fn record_stages(&mut self, recording: &mut Recording<'_>, stage: &RenderStage, is_view: bool) {
        let ctx = recording.ctx;
        let callbacks = CameraCallbacks::of(&stage.target.callbacks);
        let info = RenderInfo { device: ctx.device(), queue: ctx.queue(), stage, clock: self.clock };
        let initial = callbacks.and_then(|c| c.initial.as_ref());
        if let Some(initial) = initial.filter(|_| !is_view) {
            initial(&info, &mut recording.encoder);
        }
        for before in &stage.pre_render {
            self.record_stages(recording, before, false);
        }
        if let Some(initial) = initial.filter(|_| is_view) {
            initial(&info, &mut recording.encoder);
        }
        let plan = recording.plans.next().and_then(Option::as_ref);
        if let Some(plan) = plan {
            self.record_stage(recording, stage, plan, callbacks, &info);
        }
        for after in &stage.post_render {
            self.record_stages(recording, after, false);
        }
        // The copies contain what the stages after this one draw into the same target.
        if plan.is_some() {
            self.passes.mipmaps.record(ctx, &mut self.resources, &mut recording.encoder, stage);
            frame_copy::record(ctx, &mut self.resources, &mut recording.encoder, stage);
            self.passes.readback.record(ctx, &mut self.resources, &mut recording.encoder, stage);
        }
        if let Some(final_draw) = callbacks.and_then(|c| c.final_draw.as_ref()) {
            final_draw(&info, &mut recording.encoder);
        }
    }

    /// Records the passes of one stage.
    fn record_stage(
        &mut self,
        recording: &mut Recording<'_>,
        stage: &RenderStage,
        plan: &PassPlan,
        callbacks: Option<&CameraCallbacks>,
        info: &RenderInfo<'_>,
    ) {
        let (ctx, encoder) = (recording.ctx, &mut recording.encoder);
        let (passes, resources) = (&self.passes, &mut self.resources);
        let PassPlan { target, base_index, .. } = plan;
        passes.shadows.record(ctx, resources, encoder, plan.shadows.clone());
        if plan.restores_samples {
            passes.msaa_restore.record(ctx, resources, encoder, target);
        }
        let colors = target.color_attachments(plan.background.clear_color);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("stage"),
            color_attachments: &colors[..target.color_count()],
            depth_stencil_attachment: Some(target.depth_attachment(stage)),
            timestamp_writes: resources.timer.as_mut().and_then(|timer| timer.pass(pass_name(stage, target))),
            occlusion_query_set: passes.queries.set(&plan.queries),
            multiview_mask: None,
        });
        let sources = DrawSources {
            ctx,
            resources,
            frame_groups: resources.frame_groups.by_air(),
            pass: resources.pipelines.target_formats(target.index).map(|formats| (info, *formats)),
        };
        let mut recorder = PassRecorder::new(&mut pass, target.dynamics(None));
        passes.background.record(&mut recorder, &sources, target, &plan.background, *base_index);
        if let Some(pre_draw) = callbacks.and_then(|c| c.pre_draw.as_ref()) {
            pre_draw(info, recorder.pass);
            recorder.forget();
        }
        plan.leaves.record(&mut recorder, &sources, stage, info, Part::Opaque);
        passes.queries.record(&mut recorder, &sources, target, plan.queries.clone());
        if plan.has_sky {
            passes.sky.record(&mut recorder, &sources, target, *base_index);
        }
        passes.water.record(&mut recorder, &sources, target, plan.water, *base_index);
        plan.leaves.record(&mut recorder, &sources, stage, info, Part::SeeThrough);
        if let Some(composition) = &plan.composition {
            passes.composition.record(&mut recorder, &sources, target, composition, *base_index);
        }
        if let Some(post_draw) = callbacks.and_then(|c| c.post_draw.as_ref()) {
            post_draw(info, recorder.pass);
        }
        let (stats, errors) = recorder.finish();
        drop(pass);
        passes.depth_resolve.record(ctx, resources, encoder, stage, target);
        passes.display.record(ctx, resources, encoder, target, *base_index);
        resources.stats.add_pass(&stats);
        for error in errors {
            resources.errors.report_once(error);
        }
    }
}
