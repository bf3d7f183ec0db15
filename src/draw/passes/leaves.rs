//! The leaves of a stage: opaque runs first, and after sky and water the runs that these shine through. Draw thread.

use std::ops::Range;
use std::sync::Arc;

use super::shading::{Shaded, name_of, shade};
use super::stage_input::LitStage;
use crate::cull::{DrawnPart, FadeBand, RenderStage};
use crate::draw::batch::state_entry::StateEntry;
use crate::draw::bins::{Bins, draw_bins};
use crate::draw::bound_state::{BoundState, DynamicState};
use crate::draw::callbacks::info::RenderInfo;
use crate::draw::recorder::{DrawSources, PassRecorder};
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::PassTarget;
use crate::scene::CullingMode;
use crate::state::{BlendFactor, BlendFunc, COLOR_LOCATIONS, PolygonMode, ResolvedState, Scissor, Viewport};

/// The runs of a stage in the frame's batch.
#[derive(Clone, Debug, Default)]
pub(in crate::draw) struct Leaves {
    runs: Range<usize>,
    /// Indices of the bins' first runs in the batch, where callbacks draw some of the bins.
    bin_starts: Option<Range<usize>>,
    /// The first run that the background shines through; sky and water are drawn before it.
    see_through: usize,
}

/// The leaves before and after sky and water.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(in crate::draw) enum Part {
    Opaque,
    SeeThrough,
}

impl Leaves {
    /// Prepares the states of a stage and builds its runs. `replaces_sun` means that a light of the stage
    /// replaces the environment's sun.
    pub(in crate::draw) fn prepare(resources: &mut Resources, lit: &LitStage<'_>, replaces_sun: bool) -> Self {
        let stage = lit.input.stage;
        let mut states = resources.batch.take_states();
        let parts = stage.part_of_state.iter().chain(std::iter::repeat(&0));
        let views = stage.view_of_state.iter().enumerate();
        for ((state, (index, view)), part) in stage.state_sets.iter().zip(views).zip(parts) {
            let part = stage.part(*part).unwrap_or(DrawnPart::Band(FadeBand::FULL));
            let context = LeafContext { view: *view, positioned: lit.positioned(index, *view), part };
            states.push(prepare_state(resources, lit, state, context, replaces_sun));
        }
        resources.batch.put_states(states);
        let (first_run, first_leaf) = (resources.batch.runs().len(), resources.batch.leaves().len());
        let room = resources.leaf_buffer.room();
        let built = resources.batch.build(lit.input.ctx, &mut resources.pipelines, stage, room);
        resources.stats.leaves_dropped += built.dropped as u32;
        resources.stats.leaves += (resources.batch.leaves().len() - first_leaf) as u32;
        let has_callbacks = stage.bins.iter().any(|bin| !bin.callbacks.is_empty());
        Self {
            runs: first_run..resources.batch.runs().len(),
            bin_starts: has_callbacks.then_some(built.bin_starts),
            see_through: built.see_through,
        }
    }

    /// Records one part of the leaves. Bins are drawn one by one only where a callback draws some of them.
    pub(in crate::draw) fn record(
        &self,
        recorder: &mut PassRecorder<'_, '_>,
        sources: &DrawSources<'_>,
        stage: &RenderStage,
        info: &RenderInfo<'_>,
        part: Part,
    ) {
        let starts = self.bin_starts.clone().and_then(|range| sources.resources.batch.bin_starts().get(range));
        let bins = starts.map(|starts| Bins { bins: &stage.bins, starts }.split_before(self.see_through));
        match (bins, part) {
            (Some((before_sky, _)), Part::Opaque) => draw_bins(recorder, sources, info, before_sky, 0),
            (Some((_, after_sky)), Part::SeeThrough) => draw_bins(recorder, sources, info, after_sky, 0),
            (None, Part::Opaque) => recorder.draw_runs(sources, self.runs.start..self.see_through),
            (None, Part::SeeThrough) => recorder.draw_runs(sources, self.see_through..self.runs.end),
        }
    }
}

/// The view, lights and drawn part of the leaves of a state.
#[derive(Clone, Copy)]
struct LeafContext {
    view: u32,
    /// Byte offset of the stage uniform.
    positioned: u32,
    part: DrawnPart,
}

/// Prepares a state of the stage for its leaves: its pipeline key, bound state and drawn part.
fn prepare_state(
    resources: &mut Resources,
    lit: &LitStage<'_>,
    state: &Arc<ResolvedState>,
    LeafContext { view, positioned, part }: LeafContext,
    replaces_sun: bool,
) -> StateEntry {
    let (stage, target) = (lit.input.stage, lit.input.target);
    let Shaded { shading, group, attribute } = shade(resources, &lit.input, view, state, replaces_sun);
    if state.stencil().is_some()
        && let Some(depth) = target.depth_without_stencil(stage)
    {
        let (name, depth) = (name_of(state), &depth.name);
        resources
            .errors
            .report_once(format!("{name}: texture {depth:?} has no stencil; the stencil test passes everywhere"));
    }
    if state.blends() && constants_of_colors(state) == (true, true) {
        let name = name_of(state);
        resources.errors.report_once(format!(
            "{name}: colours are weighted with ConstantColor and ConstantAlpha; wgpu has one constant, the colour"
        ));
    }
    let frame = lit.view(view);
    let mut bound = BoundState { frame: [frame.uniform, positioned], air: frame.air, group, attribute, ..lit.base };
    apply_state(&mut bound.dynamics, state, lit.viewport_px(view), target);
    let index = resources.bound_states.find_recent_or_push(bound, lit.base_index);
    let key = resources.pipelines.state_key(state, shading, target.index);
    let key = if frame.has_shadows { key.shadowed() } else { key }.in_air(frame.air_kind);
    let entry = StateEntry::new(key, index, state, part);
    // With several samples a pixel, a mesh between the pixel centres may still cover a sample.
    let skips_unsampled = target.samples == 1 && stage.camera.settings.culling.contains(CullingMode::SAMPLES);
    if skips_unsampled && state.polygon_mode() == PolygonMode::Fill {
        let [x, y, width, height, ..] = bound.dynamics.viewport;
        let inner = (view as usize).checked_sub(1).and_then(|inner| stage.views.get(inner));
        let clip_from_eye = inner.map_or(&stage.camera.clip_from_eye, |view| &view.clip_from_eye);
        return entry.without_unsampled(resources.batch.grid(clip_from_eye, [x, y, width, height]));
    }
    entry
}

/// Puts a state's viewport, depth range, scissor and constants over those of its stage.
fn apply_state(dynamics: &mut DynamicState, state: &ResolvedState, view: Option<[u32; 4]>, target: &PassTarget) {
    let [width, height] = target.size_px;
    if let Some(rect) = view {
        dynamics.viewport[..4].copy_from_slice(&target.viewport(rect.map(|v| v as f32)));
    }
    if let Some(Viewport { x, y, width, height }) = state.viewport() {
        dynamics.viewport[..4].copy_from_slice(&target.viewport([x, y, width, height]));
    }
    if let Some(depth) = state.depth() {
        // Depths are stored reversed, with 1 at the near plane. A range may have no extent.
        let [near, far] = depth.range.map(|v| v.clamp(0.0, 1.0));
        let (near, far) = if near <= far { (near, far) } else { (0.0, 1.0) };
        (dynamics.viewport[4], dynamics.viewport[5]) = (1.0 - far, 1.0 - near);
    }
    if let Some(Scissor { x, y, width: w, height: h }) = state.scissor() {
        let (x, y) = (x.min(width), y.min(height));
        dynamics.scissor = [x, y, w.min(width - x), h.min(height - y)];
    }
    dynamics.stencil_reference = state.stencil().map_or(0, |s| u32::from(s.reference));
    dynamics.blend_color = blend_constant(state);
}

/// Returns true if some attachment of a state has blend factors of a kind.
fn some_blend_func(state: &ResolvedState, is_kind: impl Fn(&BlendFunc) -> bool) -> bool {
    (0..COLOR_LOCATIONS).any(|location| is_kind(&state.blending_of(location).0))
}

/// Returns true if colours of a state are weighted with the colour of the constant, and true if they are with its alpha.
fn constants_of_colors(state: &ResolvedState) -> (bool, bool) {
    let has = |is_kind| some_blend_func(state, |func| func.weights(is_kind));
    (has(BlendFactor::is_constant_color), has(BlendFactor::is_constant_alpha))
}

/// Returns the blend constant if factors use it: the colour of a state, or its alpha in all components where colours are
/// weighted with that alone.
fn blend_constant(state: &ResolvedState) -> Option<[f32; 4]> {
    let [r, g, b, a] = state.blend_color();
    let is_used = state.blends() && some_blend_func(state, BlendFunc::has_constant);
    is_used.then(|| if constants_of_colors(state) == (false, true) { [a; 4] } else { [r, g, b, a] })
}
