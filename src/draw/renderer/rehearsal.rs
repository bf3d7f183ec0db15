//! Rehearsals: a view is prepared as a later frame will draw it, and the pipelines that it lacks are ordered from the pipeline
//! thread. Draw thread, before the frame is prepared; nothing of a rehearsal is drawn.

use super::drawn_stages::DrawnStage;
use super::{CameraView, Renderer};
use crate::cull::RenderStage;
use crate::draw::passes::shadows::casters::map_target;
use crate::draw::pipelines::TargetFormats;
use crate::draw::pipelines::key::AirKind;
use crate::gpu::GraphicsContext;
use crate::scene::Environment;

/// The views that the next draw rehearses, and the result of the last one that did.
#[derive(Default)]
pub(super) struct Rehearsals {
    next: Vec<(RenderStage, Environment)>,
    /// The number of pipelines that were not there.
    missing: Option<u32>,
}

/// Returns true if views under two environments are drawn with the same pipelines.
pub(crate) fn draws_alike(a: &Environment, b: &Environment) -> bool {
    let kind = |e: &Environment| (AirKind::of(e), e.shadows.is_some(), e.water.is_some(), e.tone_mapping);
    kind(a) == kind(b)
}

impl Renderer {
    /// Has the next draw prepare a view, given by its stage, as a later frame will draw it. The pipeline thread
    /// creates what it lacks, also for content that was drawn earlier and is out of view now.
    pub(crate) fn rehearse_next(&mut self, stage: RenderStage, environment: Environment) {
        self.rehearsals.next.push((stage, environment));
    }

    /// Returns how many pipelines the views lacked that the last draw has rehearsed; `None` if it has rehearsed none, as a
    /// window without an image does.
    pub(crate) fn take_rehearsed(&mut self) -> Option<u32> {
        self.rehearsals.next.clear();
        self.rehearsals.missing.take()
    }

    /// Returns the number of pipelines that the pipeline thread is creating.
    pub(crate) fn pipelines_in_creation(&self) -> u32 {
        self.resources.pipelines.pipeline_thread.open()
    }

    /// Rehearses the views of [`Self::rehearse_next`].
    pub(super) fn rehearse(&mut self, ctx: &GraphicsContext) {
        if self.rehearsals.next.is_empty() {
            return;
        }
        let _span = crate::trace::span("rehearse");
        let drawn = std::mem::take(&mut self.drawn_into);
        self.resources.pipelines.pipeline_thread.begin();
        let next = std::mem::take(&mut self.rehearsals.next);
        self.prepare(ctx, next.iter().map(|(stage, environment)| CameraView { stage, environment }));
        self.discard_frame();
        let rehearsed = std::mem::replace(&mut self.drawn_into, drawn);
        let changed: Vec<DrawnStage> = rehearsed.iter().filter(|to| !self.drawn_into.has_drawn(to)).copied().collect();
        for to in changed {
            self.passes.queries.prewarm(ctx, &mut self.resources, to.target);
            for index in 0..self.drawn_into.drawn_count() {
                let from = self.drawn_into.drawn(index);
                if !rehearsed.has_drawn(&from) && self.are_views_alike(from.target, to.target) {
                    self.ensure_changed(ctx, from, to);
                }
            }
            // Pages that are loaded meanwhile get both kinds of pipelines.
            self.drawn_into.expect(to);
        }
        self.resources.report_pipeline_errors();
        self.rehearsals.missing = Some(self.resources.pipelines.pipeline_thread.end());
    }

    /// Returns true if a view can change from one target to another: they differ in the format of colours at most.
    fn are_views_alike(&self, from: u16, to: u16) -> bool {
        let shape = |target| {
            self.resources.pipelines.target_formats(target).map(|formats: &TargetFormats| {
                (formats.colors.map(|color| color.is_some()), formats.depth, formats.samples, formats.keeps_alpha)
            })
        };
        shape(from) == shape(to)
    }

    /// Creates or orders the pipelines of what was drawn in a kind of stage, casters included, for another kind.
    pub(super) fn ensure_changed(&mut self, ctx: &GraphicsContext, from: DrawnStage, to: DrawnStage) {
        let is_lit_anew = to.has_own_light && !from.has_own_light;
        let pipelines = &mut self.resources.pipelines;
        pipelines.ensure_derived(ctx, |key| {
            let is_drawn = key.target() == from.target && !key.is_caster();
            is_drawn.then(|| key.in_view(to.target, to.air, to.has_shadows, is_lit_anew))
        });
        if to.has_shadows
            && let Some(map) = map_target(pipelines)
        {
            pipelines.ensure_derived(
                ctx,
                |key| {
                    if key.target() == from.target { key.in_shadow_map(map) } else { None }
                },
            );
        }
    }
}
