//! Occlusion queries: boxes drawn against the depth of a stage's opaque runs, whose visible samples are read back some
//! frames later. Draw thread; nothing waits for the results.

use std::ops::Range;
use std::sync::Arc;

use super::stage_input::LitStage;
use crate::cull::OcclusionQuery;
use crate::draw::bound_state::BoundState;
use crate::draw::mapping::{Mapping, MappingState};
use crate::draw::pipelines::builtin_pipelines::{Builtin, BuiltinPipelines};
use crate::draw::recorder::{DrawSources, PassRecorder};
use crate::draw::resources::Resources;
use crate::draw::targets::pass_target::PassTarget;
use crate::draw::uniforms::frame::LeafUniform;
use crate::gpu::{GraphicsContext, Memory};
use crate::scene::OcclusionResults;

/// Queries of a draw; further ones wait for another frame.
const MAX_QUERIES: u32 = 1024;
/// Draws whose results may be in flight. A frame has one draw for each target of the device.
const MAX_DRAWS_IN_FLIGHT: usize = 8;

/// A query that was made, for the hand-over of its result.
struct Pending {
    results: Arc<OcclusionResults>,
    /// The box counts as visible from this number of samples on.
    threshold: u32,
    frame: u32,
}

/// The results of one draw on their way back.
struct QuerySlot {
    buffer: wgpu::Buffer,
    pending: Vec<Pending>,
    mapping: Mapping,
}

/// The query set of a renderer and the buffers that its results come back in.
struct Queries {
    set: wgpu::QuerySet,
    resolve: wgpu::Buffer,
    slots: Vec<QuerySlot>,
    /// The slot of the current draw; `None` while all are in flight.
    current: Option<usize>,
}

impl Queries {
    /// The size of a draw's results in bytes.
    const DRAW_BYTES: u64 = 8 * MAX_QUERIES as u64;

    /// Creates the query set and its buffers; returns an error if there is no memory for them.
    fn new(memory: &Memory) -> Result<Self, String> {
        memory.allocate("occlusion queries", Self::DRAW_BYTES * (1 + MAX_DRAWS_IN_FLIGHT as u64), Self::of_device)
    }

    fn of_device(device: &wgpu::Device) -> Self {
        let buffer = |label, usage| {
            let size = Self::DRAW_BYTES;
            device.create_buffer(&wgpu::BufferDescriptor { label: Some(label), size, usage, mapped_at_creation: false })
        };
        Self {
            set: device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("occlusion"),
                ty: wgpu::QueryType::Occlusion,
                count: MAX_QUERIES,
            }),
            resolve: buffer("occlusion", wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC),
            slots: (0..MAX_DRAWS_IN_FLIGHT)
                .map(|_| QuerySlot {
                    buffer: buffer("occlusion results", wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ),
                    pending: Vec::new(),
                    mapping: Mapping::default(),
                })
                .collect(),
            current: None,
        }
    }

    fn start_frame(&mut self) {
        self.current = self.slots.iter().position(|slot| slot.mapping.state() == MappingState::Idle);
        if let Some(slot) = self.current_slot() {
            slot.pending.clear();
        }
    }

    fn current_slot(&mut self) -> Option<&mut QuerySlot> {
        self.slots.get_mut(self.current?)
    }

    /// Returns the index of a query in the set. Returns `None` if it has to wait for another frame; it counts as visible
    /// until then if the set was full, since other queries may take its room in each frame.
    fn add(&mut self, query: &OcclusionQuery, threshold: u32) -> Option<u32> {
        let Some(slot) = self.current_slot() else {
            query.results.was_not_asked(false, query.frame);
            return None;
        };
        if slot.pending.len() >= MAX_QUERIES as usize {
            query.results.was_not_asked(true, query.frame);
            return None;
        }
        slot.pending.push(Pending { results: query.results.clone(), threshold, frame: query.frame });
        Some(slot.pending.len() as u32 - 1)
    }

    /// Takes back the queries of a frame that is not drawn: their boxes count as visible.
    fn discard(&mut self) {
        if let Some(slot) = self.current.take().and_then(|current| self.slots.get_mut(current)) {
            slot.pending.drain(..).for_each(|query| query.results.was_not_asked(true, query.frame));
        }
    }

    fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        if let Some(slot) = self.current.and_then(|i| self.slots.get(i)).filter(|s| !s.pending.is_empty()) {
            let count = slot.pending.len() as u32;
            encoder.resolve_query_set(&self.set, 0..count, &self.resolve, 0);
            encoder.copy_buffer_to_buffer(&self.resolve, 0, &slot.buffer, 0, 8 * u64::from(count));
        }
    }

    fn submitted(&mut self) {
        if let Some(slot) = self.current.take().and_then(|i| self.slots.get(i)).filter(|s| !s.pending.is_empty()) {
            slot.mapping.start(&slot.buffer);
        }
    }

    /// Hands over the results that have arrived.
    fn deliver(&mut self) {
        for slot in &mut self.slots {
            match slot.mapping.state() {
                MappingState::Ready => {
                    if let Ok(view) = slot.buffer.get_mapped_range(..) {
                        for (query, samples) in slot.pending.iter().zip(view.chunks_exact(8)) {
                            let samples = bytemuck::pod_read_unaligned(samples);
                            query.results.answered(samples, query.threshold, query.frame);
                        }
                    }
                    slot.buffer.unmap();
                    slot.pending.clear();
                    slot.mapping.reset();
                }
                MappingState::Failed => slot.mapping.reset(),
                MappingState::Idle | MappingState::InFlight => {}
            }
        }
    }
}

/// A box to be drawn: indices of its leaf, of its query in the set, and of its bound state.
#[derive(Clone, Copy)]
struct QueryBox {
    leaf: u32,
    query: u32,
    bound: u32,
}

/// The occlusion queries of a renderer.
pub(in crate::draw) struct QueryPass {
    pipelines: BuiltinPipelines,
    /// Created for the first query.
    queries: Option<Queries>,
    /// The boxes of all stages of the frame.
    boxes: Vec<QueryBox>,
}

impl Default for QueryPass {
    fn default() -> Self {
        Self { pipelines: BuiltinPipelines::new(Builtin::Query), queries: None, boxes: Vec::new() }
    }
}

impl QueryPass {
    pub(in crate::draw) fn start_frame(&mut self) {
        self.boxes.clear();
        if let Some(queries) = &mut self.queries {
            queries.start_frame();
        }
    }

    /// Appends the leaves of a stage's query boxes; returns the range of the boxes. A query that cannot be made counts as
    /// visible.
    pub(in crate::draw) fn prepare(&mut self, resources: &mut Resources, lit: &LitStage<'_>) -> Range<usize> {
        let first = self.boxes.len();
        let (ctx, stage) = (lit.input.ctx, lit.input.stage);
        if stage.queries.is_empty() {
            return first..first;
        }
        if self.queries.is_none() {
            self.queries = Queries::new(ctx.memory()).map_err(|error| resources.errors.report_once(error)).ok();
            self.queries.iter_mut().for_each(Queries::start_frame);
        }
        let Some(queries) = &mut self.queries else {
            stage.queries.iter().for_each(|query| query.results.was_not_asked(true, query.frame));
            return first..first;
        };
        self.pipelines.ensure(ctx, &mut resources.pipelines, lit.input.target.index);
        for query in &stage.queries {
            let Some(rows) = stage.eye_from_drawable.get(query.matrix as usize) else { continue };
            let leaf = resources.batch.leaves().len();
            if leaf >= resources.leaf_buffer.room() {
                query.results.was_not_asked(true, query.frame);
                continue;
            }
            let threshold = threshold_on(query.visibility_threshold, ctx.counts_samples());
            if threshold < query.visibility_threshold {
                resources.errors.report_once(format!(
                    "an OcclusionQueryNode hides its children below {} samples, but {} tells only whether any is visible: \
                     it shows them if one is",
                    query.visibility_threshold,
                    ctx.adapter_name()
                ));
            }
            let Some(index) = queries.add(query, threshold) else { continue };
            let frame = lit.view(query.view);
            let mut bound = BoundState { frame: [frame.uniform, frame.positioned], air: frame.air, ..lit.base };
            if let Some(rect) = lit.viewport_px(query.view) {
                bound.dynamics.viewport[..4].copy_from_slice(&lit.input.target.viewport(rect.map(|v| v as f32)));
            }
            let bound = resources.bound_states.find_or_push(bound);
            self.boxes.push(QueryBox { leaf: leaf as u32, query: index, bound });
            resources.batch.push_leaf(LeafUniform { eye_from_drawable: *rows, ..LeafUniform::EMPTY });
        }
        first..self.boxes.len()
    }

    /// Creates or orders the pipeline for a target if any query was made so far.
    pub(in crate::draw) fn prewarm(&mut self, ctx: &GraphicsContext, resources: &mut Resources, target: u16) {
        if self.queries.is_some() {
            self.pipelines.ensure(ctx, &mut resources.pipelines, target);
        }
    }

    /// Takes back the queries of a frame that is not drawn.
    pub(in crate::draw) fn discard(&mut self) {
        self.boxes.clear();
        if let Some(queries) = &mut self.queries {
            queries.discard();
        }
    }

    /// Returns the query set of a pass that records some boxes.
    pub(in crate::draw) fn set(&self, boxes: &Range<usize>) -> Option<&wgpu::QuerySet> {
        self.queries.as_ref().filter(|_| !boxes.is_empty()).map(|queries| &queries.set)
    }

    /// Records the boxes of a stage.
    pub(in crate::draw) fn record(
        &self,
        recorder: &mut PassRecorder<'_, '_>,
        sources: &DrawSources<'_>,
        target: &PassTarget,
        boxes: Range<usize>,
    ) {
        let Some(pipeline) = self.pipelines.get(target.index) else { return };
        for QueryBox { leaf, query, bound } in self.boxes.get(boxes).unwrap_or_default() {
            recorder.apply(sources, *bound);
            recorder.pass.begin_occlusion_query(*query);
            recorder.draw_builtin(pipeline, 36, *leaf..leaf + 1);
            recorder.pass.end_occlusion_query();
        }
    }

    /// Records the copy of the results, after all passes.
    pub(in crate::draw) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        if let Some(queries) = &self.queries {
            queries.resolve(encoder);
        }
    }

    /// Starts to read the results of a submitted draw back.
    pub(in crate::draw) fn submitted(&mut self) {
        if let Some(queries) = &mut self.queries {
            queries.submitted();
        }
    }

    /// Hands over the results that have arrived.
    pub(in crate::draw) fn deliver(&mut self) {
        if let Some(queries) = &mut self.queries {
            queries.deliver();
        }
    }
}

/// Returns the number of samples from which on a box counts as visible, on an adapter that counts samples or tells only whether
/// any is visible.
fn threshold_on(wanted: u32, counts_samples: bool) -> u32 {
    if counts_samples { wanted } else { wanted.min(1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: where a query answers 0 or 1, a threshold of more samples hid visible nodes for good.
    #[test]
    fn adapters_that_do_not_count_show_what_is_visible() {
        let is_hidden = |threshold: u32, counts_samples: bool, samples: u64| {
            let results = OcclusionResults::default();
            results.answered(samples, threshold_on(threshold, counts_samples), 1);
            results.failures() > 0
        };
        assert!(!is_hidden(50, false, 1) && is_hidden(50, false, 0));
        assert!(is_hidden(50, true, 49) && !is_hidden(50, true, 50));
        assert!(!is_hidden(0, false, 0), "always shown");
    }
}
