//! Groups the leaves of stages into runs, and runs into buckets. Draw thread.
//!
//! A **run** is one instanced draw of leaves with the same geometry. A **bucket** is the pipeline, buffers and bind groups
//! that runs share. Leaves are counted into runs and then written to their positions in one storage buffer, so that only
//! runs are sorted. The memory is reused: nothing is allocated once a stage of the same size was drawn.

pub(in crate::draw) mod bucket;
pub(in crate::draw) mod indirect;
mod lookup;
pub(in crate::draw) mod run;
mod sample_grid;
pub(in crate::draw) mod state_entry;

use std::collections::HashMap;
use std::ops::Range;

use glam::{DMat4, Vec3A, Vec4};

use crate::cull::{RenderLeaf, RenderStage};
use crate::draw::pipelines::key::{PipelineKey, StateKey};
use crate::draw::pipelines::{PipelineId, Pipelines};
use crate::draw::uniforms::frame::{INDEX_COUNT_SHIFT, LeafUniform};
use crate::gpu::{BindClass, DrawableEntry, GraphicsContext, Shape};
use crate::scene::{AlphaMode, Topology};
use crate::state::SortMode;
use bucket::{Bucket, BucketKey, BucketRank, Content, VertexFetch};
use lookup::Lookup;
use run::Run;
use sample_grid::SampleGrid;
use state_entry::StateEntry;

/// The pixel centres of a viewport, with the projection and the viewport that they follow from.
type Grid = (SampleGrid, DMat4, [f32; 4]);

/// The leaves, runs and buckets of a frame's stages, one stage after the other.
///
/// It has more than 16 fields because its scratch buffers are kept for the next stage.
#[derive(Default)]
pub(in crate::draw) struct Batch {
    /// Longer than `leaf_count`, so that no element is written twice.
    leaves: Vec<LeafUniform>,
    leaf_count: usize,
    runs: Vec<Run>,
    /// The first run of each bin of all stages; after a stage's last bin, the end of its runs.
    bin_starts: Vec<u32>,
    /// The buckets of all stages, each with its pipeline; `None` if that could not be created.
    buckets: Vec<(Bucket, Option<PipelineId>)>,
    /// The states of the current stage.
    states: Vec<StateEntry>,
    grids: Vec<Grid>,
    /// The number of leaves skipped because they lie between pixel centres.
    unsampled: u32,
    class_of: HashMap<(StateKey, u32), u32>,
    /// From [`BucketKey`] to the index of the bucket.
    bucket_of: Lookup,
    /// The key that was looked up last, and its bucket.
    last_bucket: (u64, u32),
    /// The pipeline that was looked up last in this frame.
    last_pipeline: Option<(PipelineKey, Option<PipelineId>)>,
    /// From bucket and geometry to the run of the current group.
    run_of: Lookup,
    group_runs: Vec<Run>,
    /// The run of each leaf of the current group.
    run_of_leaf: Vec<u32>,
    order: Vec<u32>,
    /// The first bucket of the current stage.
    first_bucket: usize,
    ranked: Vec<(BucketRank, u32)>,
    next_in_bucket: Vec<u32>,
}

/// The result of building a stage.
pub(in crate::draw) struct Built {
    /// The number of leaves that the buffer had no room for.
    pub(in crate::draw) dropped: usize,
    /// The first run that the background shines through; the end of the runs if there is none.
    pub(in crate::draw) see_through: usize,
    /// The range of the stage's bins in [`Batch::bin_starts`], with the end of the last one.
    pub(in crate::draw) bin_starts: Range<usize>,
}

/// Marks leaves that belong to no run.
const NO_RUN: u32 = u32::MAX;

/// Returns how the vertices of a drawable get to the shader. Small meshes without an alpha mask are
/// pulled.
#[inline]
fn vertex_fetch(entry: &DrawableEntry, state: &StateEntry) -> VertexFetch {
    match &entry.shape {
        Shape::Mesh { slot, is_small: true, .. }
            if state.key.can_pull && !matches!(entry.alpha, AlphaMode::Mask(_)) =>
        {
            let triangles = slot.index_count.div_ceil(3).next_power_of_two();
            VertexFetch::Pulled { log2_triangles: triangles.trailing_zeros() as u8 }
        }
        Shape::Custom(_) => VertexFetch::Custom,
        _ => VertexFetch::Buffers,
    }
}

/// Returns true if a transform mirrors.
#[inline]
fn is_mirrored(rows: &[[f32; 4]; 3]) -> bool {
    let [a, b, c] = rows.map(|row| Vec3A::from_vec4(Vec4::from_array(row)));
    a.dot(b.cross(c)) < 0.0
}

impl Batch {
    /// Removes the leaves and runs of the last frame.
    pub(in crate::draw) fn start_frame(&mut self) {
        self.leaf_count = 0;
        self.last_pipeline = None;
        self.runs.clear();
        self.bin_starts.clear();
        self.buckets.clear();
        self.grids.clear();
        self.unsampled = 0;
    }

    /// Returns the index of the grid of a viewport's pixels. The viewport is x, y, width, height in pixels.
    pub(in crate::draw) fn grid(&mut self, clip_from_eye: &DMat4, viewport_px: [f32; 4]) -> u32 {
        let is_known = |(_, clip, px): &Grid| clip == clip_from_eye && *px == viewport_px;
        if !self.grids.last().is_some_and(is_known) {
            self.grids.push((SampleGrid::new(clip_from_eye, viewport_px), *clip_from_eye, viewport_px));
        }
        self.grids.len() as u32 - 1
    }

    /// Returns true for a leaf that covers no pixel centre.
    #[inline]
    fn is_unsampled(&self, state: &StateEntry, entry: &DrawableEntry, rows: &[[f32; 4]; 3]) -> bool {
        match &entry.shape {
            Shape::Mesh { extent: Some(extent), .. } if state.key.can_pull => {
                let grid = state.grid.and_then(|grid| self.grids.get(grid as usize));
                grid.is_some_and(|(grid, ..)| grid.misses(rows, extent))
            }
            _ => false,
        }
    }

    /// Returns the leaves so far.
    pub(in crate::draw) fn leaves(&self) -> &[LeafUniform] {
        &self.leaves[..self.leaf_count]
    }

    /// Returns the runs of all stages so far.
    pub(in crate::draw) fn runs(&self) -> &[Run] {
        &self.runs
    }

    /// Returns the first run of each bin of all stages so far.
    pub(in crate::draw) fn bin_starts(&self) -> &[u32] {
        &self.bin_starts
    }

    /// Returns a bucket of a run, and its pipeline.
    pub(in crate::draw) fn bucket(&self, index: u32) -> &(Bucket, Option<PipelineId>) {
        &self.buckets[index as usize]
    }

    /// Returns the vertex and index chunks of all pulled meshes.
    pub(in crate::draw) fn pulled_chunks(&self) -> impl Iterator<Item = (u32, u32)> {
        let pulled = self.buckets.iter().filter(|(bucket, _)| bucket.stride() > 0);
        pulled.map(|(bucket, _)| (bucket.vertex_chunk, bucket.index_chunk))
    }

    /// Returns the number of leaves skipped because they cover no pixel centre.
    pub(in crate::draw) fn unsampled(&self) -> u32 {
        self.unsampled
    }

    /// Lends out the empty list of states, to be filled for the next stage and returned by [`Self::put_states`].
    pub(in crate::draw) fn take_states(&mut self) -> Vec<StateEntry> {
        let mut states = std::mem::take(&mut self.states);
        states.clear();
        states
    }

    /// Sets the states of the next stage, by index.
    pub(in crate::draw) fn put_states(&mut self, states: Vec<StateEntry>) {
        self.states = states;
    }

    /// Appends a leaf that belongs to no run.
    pub(in crate::draw) fn push_leaf(&mut self, leaf: LeafUniform) {
        let index = self.leaf_count;
        self.make_room(index + 1);
        self.leaves[index] = leaf;
    }

    fn make_room(&mut self, count: usize) {
        self.leaf_count = count;
        if self.leaves.len() < count {
            self.leaves.resize(count.next_power_of_two(), LeafUniform::EMPTY);
        }
    }

    /// Appends the runs of a stage, whose states were set by [`Self::put_states`]. Leaves beyond `max_leaves` in the whole
    /// frame are dropped.
    pub(in crate::draw) fn build(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        stage: &RenderStage,
        max_leaves: usize,
    ) -> Built {
        self.class_of.clear();
        for state in &mut self.states {
            let next = self.class_of.len() as u32;
            state.class = *self.class_of.entry((state.key, state.bound)).or_insert(next);
        }
        self.bucket_of.clear();
        self.first_bucket = self.buckets.len();
        self.last_bucket = (u64::MAX, 0);
        let first_bin = self.bin_starts.len();
        let (mut dropped, mut see_through) = (0, None);
        for bin in &stage.bins {
            let first_of_bin = self.runs.len();
            self.bin_starts.push(first_of_bin as u32);
            let mut rest = &bin.leaves[..];
            while !rest.is_empty() {
                let room = max_leaves.saturating_sub(self.leaf_count);
                let (count, in_any_order) = alike(bin.sort, &self.states, rest);
                let (group, after) = rest.split_at(count);
                rest = after;
                dropped += group.len().saturating_sub(room);
                let group = &group[..group.len().min(room)];
                if in_any_order {
                    self.regroup(ctx, pipelines, stage, group);
                } else {
                    self.in_order(ctx, pipelines, stage, group);
                }
            }
            // Blended leaves that write depth count as ground, unless their bin is sorted from back to front.
            let is_sorted = bin.sort == SortMode::BackToFront;
            let is_see_through = |run: &Run| {
                let pipeline = self.buckets[run.bucket as usize].0.pipeline;
                !pipeline.writes_depth() || is_sorted && pipeline.is_blended()
            };
            let in_bin = || self.runs[first_of_bin..].iter().position(is_see_through).map(|at| first_of_bin + at);
            see_through = see_through.or_else(in_bin);
        }
        self.bin_starts.push(self.runs.len() as u32);
        let bin_starts = first_bin..self.bin_starts.len();
        Built { dropped, see_through: see_through.unwrap_or(self.runs.len()), bin_starts }
    }

    /// Appends leaves whose order is free: those with the same bucket and geometry become one run, and runs are sorted by
    /// bucket.
    fn regroup(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        stage: &RenderStage,
        leaves: &[RenderLeaf],
    ) {
        self.group_runs.clear();
        self.run_of_leaf.clear();
        self.run_of.clear();
        let mut last = (u64::MAX, NO_RUN);
        for leaf in leaves {
            let state = &self.states[leaf.state as usize];
            let found = drawable(ctx, stage, leaf).filter(|(entry, _)| state.draws(entry));
            let Some((entry, rows)) = found else {
                self.run_of_leaf.push(NO_RUN);
                continue;
            };
            if self.is_unsampled(state, entry, rows) {
                self.unsampled += 1;
                self.run_of_leaf.push(NO_RUN);
                continue;
            }
            let bucket = self.bucket_index(ctx, pipelines, stage, leaf, entry, rows);
            let key = u64::from(bucket) << 32 | u64::from(self.geometry(bucket, entry));
            if key != last.0 {
                let next = self.group_runs.len() as u32;
                let run = self.run_of.get_or_insert(key, next);
                if run == next {
                    self.group_runs.push(Run::new(ctx, bucket, entry));
                }
                last = (key, run);
            }
            self.group_runs[last.1 as usize].add(entry);
            self.run_of_leaf.push(last.1);
        }
        self.order_runs();
        let mut next_leaf = self.leaf_count as u32;
        for run in &self.order {
            let run = &mut self.group_runs[*run as usize];
            run.first_leaf = next_leaf;
            next_leaf += run.leaf_count;
            self.runs.push(*run);
        }
        self.make_room(next_leaf as usize);
        let (buckets, states) = (&self.buckets[..], &self.states[..]);
        let (uniforms, runs) = (&mut self.leaves[..], &mut self.group_runs[..]);
        for (leaf, run) in leaves.iter().zip(&self.run_of_leaf) {
            let Some(run) = runs.get_mut(*run as usize) else { continue };
            if let Some((entry, rows)) = drawable(ctx, stage, leaf) {
                let state = &states[leaf.state as usize];
                uniforms[run.first_leaf as usize] = uniform(entry, rows, state, || &buckets[run.bucket as usize].0);
                run.first_leaf += 1;
            }
        }
    }

    /// Sets `order` to the runs of the group, sorted by the rank of their buckets. Runs of one bucket keep their order.
    fn order_runs(&mut self) {
        self.order.clear();
        self.order.extend(0..self.group_runs.len() as u32);
        if self.group_runs.windows(2).all(|w| w[0].bucket == w[1].bucket) {
            return;
        }
        // Buckets are few and are sorted; runs are only counted into them.
        let first = self.first_bucket;
        self.ranked.clear();
        self.ranked.extend(self.buckets[first..].iter().zip(0..).map(|((bucket, _), index)| (bucket.rank(), index)));
        self.ranked.sort_unstable();
        self.next_in_bucket.clear();
        self.next_in_bucket.resize(self.ranked.len(), 0);
        for run in &self.group_runs {
            self.next_in_bucket[run.bucket as usize - first] += 1;
        }
        let mut next = 0;
        for (_, bucket) in &self.ranked {
            next += std::mem::replace(&mut self.next_in_bucket[*bucket as usize], next);
        }
        for (index, run) in (0..).zip(&self.group_runs) {
            let next = &mut self.next_in_bucket[run.bucket as usize - first];
            self.order[*next as usize] = index;
            *next += 1;
        }
    }

    /// Appends leaves that keep their order: only neighbours become one run.
    fn in_order(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        stage: &RenderStage,
        leaves: &[RenderLeaf],
    ) {
        let mut last = u64::MAX;
        for leaf in leaves {
            let state = &self.states[leaf.state as usize];
            let found = drawable(ctx, stage, leaf).filter(|(entry, _)| state.draws(entry));
            let Some((entry, rows)) = found else { continue };
            if self.is_unsampled(state, entry, rows) {
                self.unsampled += 1;
                continue;
            }
            let bucket = self.bucket_index(ctx, pipelines, stage, leaf, entry, rows);
            let key = u64::from(bucket) << 32 | u64::from(self.geometry(bucket, entry));
            if key != last {
                let first_leaf = self.leaf_count as u32;
                self.runs.push(Run { first_leaf, ..Run::new(ctx, bucket, entry) });
                last = key;
            }
            if let Some(run) = self.runs.last_mut() {
                run.add(entry);
            }
            let bucket = || &self.buckets[bucket as usize].0;
            self.push_leaf(uniform(entry, rows, &self.states[leaf.state as usize], bucket));
        }
    }

    /// Returns a number that is equal for leaves of a bucket that one run draws.
    #[inline]
    fn geometry(&self, bucket: u32, entry: &DrawableEntry) -> u32 {
        match &entry.shape {
            Shape::Height(slot) => slot.side,
            Shape::Splats { number, .. } => *number,
            Shape::Mesh { slot, .. } => match self.buckets[bucket as usize].0.stride() {
                0 => slot.mesh,
                _ => 0,
            },
            Shape::Custom(shape) => *shape,
        }
    }

    /// Returns the bucket of a leaf. The first leaf of a bucket creates it and its pipeline.
    #[inline(always)]
    fn bucket_index(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        stage: &RenderStage,
        leaf: &RenderLeaf,
        entry: &DrawableEntry,
        rows: &[[f32; 4]; 3],
    ) -> u32 {
        let state = &self.states[leaf.state as usize];
        let fetch = vertex_fetch(entry, state);
        let state_class = if fetch == VertexFetch::Custom { leaf.state } else { state.class };
        let key = BucketKey { state_class, bind_class: entry.class, fetch, is_mirrored: is_mirrored(rows) };
        // Mostly the bucket of the leaf before.
        if key.packed() == self.last_bucket.0 {
            self.last_bucket.1
        } else {
            self.find_bucket(ctx, pipelines, stage, key, leaf.state)
        }
    }

    #[inline(never)]
    fn find_bucket(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        stage: &RenderStage,
        key: BucketKey,
        state_index: u32,
    ) -> u32 {
        let next = self.buckets.len() as u32;
        let index = self.bucket_of.get_or_insert(key.packed(), next);
        self.last_bucket = (key.packed(), index);
        if index == next {
            let bucket = self.new_bucket(ctx, pipelines, key, state_index);
            let pipeline = match (bucket.content, self.last_pipeline) {
                // The application has its own pipelines.
                (Content::Custom { .. }, _) => None,
                (_, Some((known, pipeline))) if known == bucket.pipeline => pipeline,
                _ => {
                    let state = stage.state_sets.get(state_index as usize);
                    let pipeline = pipelines.ensure(ctx, bucket.pipeline, state.map(|state| &**state));
                    self.last_pipeline = Some((bucket.pipeline, pipeline));
                    pipeline
                }
            };
            self.buckets.push((bucket, pipeline));
        }
        index
    }

    fn new_bucket(&self, ctx: &GraphicsContext, pipelines: &mut Pipelines, key: BucketKey, state_index: u32) -> Bucket {
        let state = &self.states[state_index as usize];
        let bound = state.bound;
        match ctx.bind_classes()[key.bind_class as usize] {
            BindClass::Height { block, side } => {
                let pipeline = PipelineKey::height(&state.key, key.is_mirrored);
                Bucket { pipeline, content: Content::Height, block, vertex_chunk: 0, index_chunk: side, bound }
            }
            BindClass::Mesh {
                topology,
                is_masked,
                double_sided,
                block,
                surface_set,
                is_layered,
                vertex_chunk,
                index_chunk,
            } => {
                let pipeline = PipelineKey::mesh(&state.key, topology, is_masked, double_sided, key.is_mirrored);
                let (pipeline, block) = match surface_set.map(|set| (pipeline.with_surface(is_layered), set)) {
                    Some((pipeline, set)) if pipeline.has_surface() => (pipeline, set),
                    _ => (pipeline, block),
                };
                let (content, pipeline) = match key.fetch {
                    VertexFetch::Pulled { log2_triangles } => {
                        (Content::PulledMesh { stride: 3 << log2_triangles }, pipeline.pulled())
                    }
                    _ => (Content::Mesh, pipelines.with_vertices(pipeline, ctx.pools().meshes(), vertex_chunk)),
                };
                Bucket { pipeline, content, block, vertex_chunk, index_chunk, bound }
            }
            BindClass::Splats => {
                let pipeline = PipelineKey::splats(&state.key);
                Bucket {
                    pipeline,
                    content: Content::Splats { state: state_index },
                    block: 0,
                    vertex_chunk: 0,
                    index_chunk: 0,
                    bound,
                }
            }
            BindClass::Custom => {
                let pipeline = PipelineKey::mesh(&state.key, Topology::Triangles, false, false, key.is_mirrored);
                let content = Content::Custom { state: state_index };
                Bucket { pipeline, content, block: 0, vertex_chunk: 0, index_chunk: 0, bound }
            }
        }
    }
}

/// Returns the drawable of a leaf and the rows of its transform to the eye; `None` if its slot was freed.
#[inline]
fn drawable<'a>(
    ctx: &'a GraphicsContext,
    stage: &'a RenderStage,
    leaf: &RenderLeaf,
) -> Option<(&'a DrawableEntry, &'a [[f32; 4]; 3])> {
    Some((ctx.drawable(leaf.slot)?, stage.eye_from_drawable.get(leaf.matrix as usize)?))
}

/// Returns the leaf that shaders read. `bucket` returns the bucket of a mesh.
#[inline]
fn uniform<'a>(
    entry: &DrawableEntry,
    rows: &[[f32; 4]; 3],
    state: &StateEntry,
    bucket: impl Fn() -> &'a Bucket,
) -> LeafUniform {
    let mut flags = state.flags(entry.unlit);
    let mut alpha_cutoff = match entry.alpha {
        AlphaMode::Mask(cutoff) => cutoff.to_bits(),
        _ if state.key.drops_invisible => f32::MIN_POSITIVE.to_bits(),
        _ => 0,
    };
    let (layer, side) = match &entry.shape {
        Shape::Height(slot) => (slot.layer, slot.side),
        Shape::Mesh { texture, surface, slot, .. } => {
            let bucket = bucket();
            // Shaders find the texture of a surface in its record.
            let layer = match surface {
                Some(surface) if bucket.pipeline.has_surface() => surface.record,
                _ => texture.layer,
            };
            if bucket.stride() > 0 {
                flags |= slot.index_count << INDEX_COUNT_SHIFT;
                alpha_cutoff = slot.base_vertex as u32;
                (layer, slot.first_index)
            } else {
                (layer, 0)
            }
        }
        Shape::Splats { harmonics, .. } => (0, *harmonics),
        Shape::Custom(_) => (0, 0),
    };
    LeafUniform {
        eye_from_drawable: *rows,
        color: [0, 1, 2, 3].map(|i| entry.base_color[i] * state.color[i]),
        layer,
        flags,
        alpha_cutoff,
        side,
    }
}

/// Returns how many of the next leaves are drawn alike, and whether their order is free. It is free in bins sorted by state,
/// for leaves that hide each other correctly in any order.
fn alike(sort: SortMode, states: &[StateEntry], leaves: &[RenderLeaf]) -> (usize, bool) {
    let is_free = |state: u32| states.get(state as usize).is_none_or(|s| s.key.order_is_free);
    let Some(first) = leaves.first().filter(|_| sort == SortMode::ByState) else { return (leaves.len(), false) };
    let first_is_free = is_free(first.state);
    if states.iter().all(|s| s.key.order_is_free == first_is_free) {
        return (leaves.len(), first_is_free);
    }
    let mut last = first.state;
    let other = leaves.iter().position(|leaf| {
        let is_other = leaf.state != last && is_free(leaf.state) != first_is_free;
        last = leaf.state;
        is_other
    });
    (other.unwrap_or(leaves.len()), first_is_free)
}
