//! From leaves to runs: which leaves are one instanced draw, in which order.
//!
//! Draw thread. Leaves are counted into runs and then written to their places in one storage buffer, so that nothing
//! but runs is ever sorted. Reuses its memory; allocates nothing once as large a stage was drawn before.

mod lookup;
mod sample_grid;

use std::collections::HashMap;

use glam::{DMat4, Vec3A, Vec4};

use crate::cull::{FadeBand, RenderLeaf, RenderStage};
use crate::draw::batch::lookup::Lookup;
use crate::draw::batch::sample_grid::SampleGrid;
use crate::draw::pipelines::Pipelines;
use crate::draw::pipelines::key::{PipelineKey, StateKey};
use crate::draw::uniforms::frame::{BAND_SHIFT, FLAG_UNLIT, FLAG_UNTEXTURED, INDEX_COUNT_SHIFT, LeafUniform};
use crate::gpu::{BindClass, DrawableEntry, GraphicsContext, Shape};
use crate::scene::{AlphaMode, Topology};
use crate::state::{ResolvedState, SortMode};

/// What has to be bound for a run: leaves with one bucket differ in geometry alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) struct Bucket {
    pub(in crate::draw) pipeline: PipelineKey,
    pub(in crate::draw) is_height: bool,
    /// Block of group 1.
    pub(in crate::draw) block: u32,
    pub(in crate::draw) vertex_chunk: u32,
    /// Chunk of meshes, side of height tiles.
    pub(in crate::draw) index_chunk: u32,
    /// Index of the dynamic state and the uniforms. Last: mostly one call, where other buffers are two.
    pub(in crate::draw) statics: u32,
    /// Vertices of each mesh where one call draws many small ones; 0 elsewhere.
    pub(in crate::draw) stride: u32,
    /// Index of the stage's state where the application draws; [`NO_STATE`] elsewhere.
    pub(in crate::draw) custom: u32,
}

/// Of buckets that the renderer draws.
pub(in crate::draw) const NO_STATE: u32 = u32::MAX;

impl Bucket {
    /// Sorts so that dear changes are rare.
    fn order(&self) -> (u64, u64, u32) {
        // The largest pools have thousands of blocks and chunks; beyond, the order is only less good.
        let binds = u64::from(self.block) << 40 | u64::from(self.vertex_chunk & 0xf_ffff) << 20;
        (self.pipeline.order(), binds | u64::from(self.index_chunk & 0xf_ffff), self.statics)
    }
}

/// An instanced draw.
#[derive(Clone, Copy, Debug)]
pub(in crate::draw) struct Run {
    pub(in crate::draw) bucket: u32,
    pub(in crate::draw) base_vertex: i32,
    pub(in crate::draw) first_index: u32,
    pub(in crate::draw) index_count: u32,
    /// Range of instances, which is that of leaves in the buffer.
    pub(in crate::draw) first_leaf: u32,
    pub(in crate::draw) leaf_count: u32,
    /// Indices of all its leaves, of meshes.
    pub(in crate::draw) all_indices: u64,
}

/// What a state of the stage comes to.
#[derive(Clone, Copy, Debug)]
pub(in crate::draw) struct StateEntry {
    pub(in crate::draw) key: StateKey,
    pub(in crate::draw) statics: u32,
    /// Equal for states that draw alike.
    class: u32,
    color: [f32; 4],
    /// Flags of leaves with a lit and with an unlit material.
    flags: [u32; 2],
    /// Not drawn: what cannot fade changes in the middle of the fade.
    is_hidden: bool,
    /// Whatever has the state is drawn; mostly so.
    shows_all: bool,
    /// Index of the grid of its pixels where what lies between them is left out; [`NO_GRID`] elsewhere.
    grid: u32,
}

const NO_GRID: u32 = u32::MAX;

impl StateEntry {
    pub(in crate::draw) fn new(key: StateKey, statics: u32, state: &ResolvedState, band: FadeBand) -> Self {
        let is_whole = band.is_full() || !key.can_fade;
        let hides_customs = !(band.from..band.to).contains(&(u8::MAX / 2));
        let is_hidden = !key.can_fade && hides_customs;
        let key = if is_whole { key } else { key.fading() };
        let shows_all = !is_hidden && !hides_customs && !key.casts;
        let band = if is_whole { 0 } else { (u32::from(band.from) | u32::from(band.to) << 8) << BAND_SHIFT };
        let of_all = band | if state.has_own_textures() { 0 } else { FLAG_UNTEXTURED };
        let flags = [false, true].map(|unlit| if state.is_lit(unlit) { of_all } else { of_all | FLAG_UNLIT });
        Self { key, statics, class: 0, color: state.color, flags, is_hidden, shows_all, grid: NO_GRID }
    }

    /// The same where small meshes are left out that lie between the pixels of a grid of [`Batch::grid`].
    pub(in crate::draw) fn without_unsampled(self, grid: u32) -> Self {
        Self { grid, ..self }
    }
}

/// The draws of a frame's stages, one behind the other.
#[derive(Default)]
pub(in crate::draw) struct Batch {
    /// Longer than what is used of it, so that nothing is written twice.
    leaves: Vec<LeafUniform>,
    leaf_count: usize,
    pub(in crate::draw) runs: Vec<Run>,
    /// Of all stages, the first run of each bin; behind a stage's last bin, the run behind its last.
    pub(in crate::draw) bin_starts: Vec<u32>,
    /// Of all stages, each with the index of its pipeline.
    pub(in crate::draw) buckets: Vec<(Bucket, u32)>,
    /// By state of the current stage.
    pub(in crate::draw) states: Vec<StateEntry>,
    /// Of all stages, with what they are of.
    grids: Vec<(SampleGrid, DMat4, [f32; 4])>,
    /// Leaves left out because they lie between pixels.
    pub(in crate::draw) unsampled: u32,
    class_of: HashMap<(StateKey, u32), u32>,
    /// From state class and bind class to bucket.
    bucket_of: Lookup,
    /// The key looked up last, and what was found.
    last_bucket: (u64, u32),
    /// The pipeline looked up last in this frame.
    last_pipeline: Option<(PipelineKey, u32)>,
    /// From bucket and geometry to run of the current group.
    run_of: Lookup,
    group_runs: Vec<Run>,
    /// By leaf of the current group.
    run_of_leaf: Vec<u32>,
    order: Vec<u32>,
    /// First bucket of the current stage.
    first_bucket: usize,
    ranked: Vec<((u64, u64, u32), u32)>,
    places: Vec<u32>,
}

/// How many vertices of a small mesh one call has for each: 0 for meshes that are not small, in strides of 3, 6, 12, 24
/// and 48, so that meshes of like sizes share a call.
#[inline]
fn stride_code(entry: &DrawableEntry, state: &StateEntry) -> u32 {
    match &entry.shape {
        Shape::Mesh { place, is_small: true, .. }
            if state.key.can_pull && !matches!(entry.alpha, AlphaMode::Mask(_)) =>
        {
            1 + (place.index_count.div_ceil(3).next_power_of_two()).trailing_zeros()
        }
        Shape::Custom(_) => CUSTOM_CODE,
        _ => 0,
    }
}

/// In the place of a stride's: what the application draws.
const CUSTOM_CODE: u32 = 7;
const NO_RUN: u32 = u32::MAX;

#[inline]
fn is_mirrored(rows: &[[f32; 4]; 3]) -> bool {
    let [a, b, c] = rows.map(|row| Vec3A::from_vec4(Vec4::from_array(row)));
    a.dot(b.cross(c)) < 0.0
}

impl Batch {
    pub(in crate::draw) fn start_frame(&mut self) {
        self.leaf_count = 0;
        self.last_pipeline = None;
        self.runs.clear();
        self.bin_starts.clear();
        self.buckets.clear();
        self.grids.clear();
        self.unsampled = 0;
    }

    /// The index of the grid of a viewport's pixels: x, y, width, height.
    pub(in crate::draw) fn grid(&mut self, clip_from_eye: &DMat4, viewport_px: [f32; 4]) -> u32 {
        let is_known = |(_, of, px): &(SampleGrid, DMat4, [f32; 4])| of == clip_from_eye && *px == viewport_px;
        if !self.grids.last().is_some_and(is_known) {
            self.grids.push((SampleGrid::new(clip_from_eye, viewport_px), *clip_from_eye, viewport_px));
        }
        self.grids.len() as u32 - 1
    }

    /// A leaf that lies between pixels, and no pixel shows.
    #[inline]
    fn is_unsampled(&self, state: &StateEntry, entry: &DrawableEntry, rows: &[[f32; 4]; 3]) -> bool {
        match &entry.shape {
            Shape::Mesh { extent: Some(extent), .. } if state.key.can_pull => {
                self.grids.get(state.grid as usize).is_some_and(|(grid, ..)| grid.misses(rows, extent))
            }
            _ => false,
        }
    }

    /// The leaves so far.
    pub(in crate::draw) fn leaves(&self) -> &[LeafUniform] {
        &self.leaves[..self.leaf_count]
    }

    /// Appends a leaf that belongs to no run.
    pub(in crate::draw) fn push_leaf(&mut self, leaf: LeafUniform) {
        let place = self.leaf_count;
        self.make_room(place + 1);
        self.leaves[place] = leaf;
    }

    fn make_room(&mut self, count: usize) {
        self.leaf_count = count;
        if self.leaves.len() < count {
            self.leaves.resize(count.next_power_of_two(), LeafUniform::EMPTY);
        }
    }

    /// Appends the runs of a stage, whose states are in [`Self::states`]. Returns how many leaves were more than the
    /// buffer takes, and before which run the first one comes that what lies behind shines through.
    pub(in crate::draw) fn build(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        stage: &RenderStage,
        most_leaves: usize,
    ) -> (usize, usize) {
        self.class_of.clear();
        for state in &mut self.states {
            let next = self.class_of.len() as u32;
            state.class = *self.class_of.entry((state.key, state.statics)).or_insert(next);
        }
        self.bucket_of.clear();
        self.first_bucket = self.buckets.len();
        self.last_bucket = (u64::MAX, 0);
        let (mut dropped, mut see_through) = (0, None);
        for bin in &stage.bins {
            let first_of_bin = self.runs.len();
            self.bin_starts.push(first_of_bin as u32);
            let mut rest = &bin.leaves[..];
            while !rest.is_empty() {
                let room = most_leaves.saturating_sub(self.leaf_count);
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
            // Leaves that blend in any order are rather ground: of those with depth, the sorted ones are not.
            let is_sorted = bin.sort == SortMode::BackToFront;
            let is_see_through = |run: &Run| {
                let pipeline = self.buckets[run.bucket as usize].0.pipeline;
                !pipeline.writes_depth() || is_sorted && pipeline.blend() != 0
            };
            let in_bin = || self.runs[first_of_bin..].iter().position(is_see_through).map(|at| first_of_bin + at);
            see_through = see_through.or_else(in_bin);
        }
        self.bin_starts.push(self.runs.len() as u32);
        (dropped, see_through.unwrap_or(self.runs.len()))
    }

    /// Leaves that may change places: those with one bucket and geometry become one run, runs are sorted by bucket.
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
            let found = drawable(ctx, stage, leaf).filter(|(entry, _)| is_drawn(state, entry));
            let Some((entry, rows)) = found else {
                self.run_of_leaf.push(NO_RUN);
                continue;
            };
            if self.is_unsampled(state, entry, rows) {
                self.unsampled += 1;
                self.run_of_leaf.push(NO_RUN);
                continue;
            }
            let bucket = self.bucket(ctx, pipelines, stage, leaf, entry, rows);
            let key = u64::from(bucket) << 32 | u64::from(self.geometry(bucket, entry));
            if key != last.0 {
                let next = self.group_runs.len() as u32;
                let run = self.run_of.get_or_insert(key, next);
                if run == next {
                    self.group_runs.push(new_run(ctx, bucket, entry));
                }
                last = (key, run);
            }
            self.group_runs[last.1 as usize].add(entry);
            self.run_of_leaf.push(last.1);
        }
        self.order_runs();
        let mut place = self.leaf_count as u32;
        for run in &self.order {
            let run = &mut self.group_runs[*run as usize];
            run.first_leaf = place;
            place += run.leaf_count;
            self.runs.push(*run);
        }
        self.make_room(place as usize);
        let (buckets, states) = (&self.buckets[..], &self.states[..]);
        let (uniforms, runs) = (&mut self.leaves[..], &mut self.group_runs[..]);
        for (leaf, run) in leaves.iter().zip(&self.run_of_leaf) {
            let Some(run) = runs.get_mut(*run as usize) else { continue };
            if let Some((entry, rows)) = drawable(ctx, stage, leaf) {
                let state = &states[leaf.state as usize];
                uniforms[run.first_leaf as usize] =
                    uniform(entry, rows, state, || buckets[run.bucket as usize].0.stride);
                run.first_leaf += 1;
            }
        }
    }

    /// Leaves in `order` the runs of the group by the order of their buckets; those of one bucket as first met.
    fn order_runs(&mut self) {
        self.order.clear();
        self.order.extend(0..self.group_runs.len() as u32);
        if self.group_runs.windows(2).all(|w| w[0].bucket == w[1].bucket) {
            return;
        }
        // Buckets are few: they are sorted, runs only counted.
        let first = self.first_bucket;
        self.ranked.clear();
        self.ranked.extend(self.buckets[first..].iter().zip(0..).map(|((bucket, _), place)| (bucket.order(), place)));
        self.ranked.sort_unstable();
        self.places.clear();
        self.places.resize(self.ranked.len(), 0);
        for run in &self.group_runs {
            self.places[run.bucket as usize - first] += 1;
        }
        let mut place = 0;
        for (_, bucket) in &self.ranked {
            place += std::mem::replace(&mut self.places[*bucket as usize], place);
        }
        for (index, run) in (0..).zip(&self.group_runs) {
            let place = &mut self.places[run.bucket as usize - first];
            self.order[*place as usize] = index;
            *place += 1;
        }
    }

    /// Leaves that stay in their order: only neighbours become one run.
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
            let found = drawable(ctx, stage, leaf).filter(|(entry, _)| is_drawn(state, entry));
            let Some((entry, rows)) = found else { continue };
            if self.is_unsampled(state, entry, rows) {
                self.unsampled += 1;
                continue;
            }
            let bucket = self.bucket(ctx, pipelines, stage, leaf, entry, rows);
            let key = u64::from(bucket) << 32 | u64::from(self.geometry(bucket, entry));
            if key != last {
                let first_leaf = self.leaf_count as u32;
                self.runs.push(Run { first_leaf, ..new_run(ctx, bucket, entry) });
                last = key;
            }
            if let Some(run) = self.runs.last_mut() {
                run.add(entry);
            }
            let stride = || self.buckets[bucket as usize].0.stride;
            self.push_leaf(uniform(entry, rows, &self.states[leaf.state as usize], stride));
        }
    }

    /// Equal for leaves of a bucket that one run draws.
    #[inline]
    fn geometry(&self, bucket: u32, entry: &DrawableEntry) -> u32 {
        match &entry.shape {
            Shape::Height(place) => place.side,
            Shape::Mesh { place, .. } => match self.buckets[bucket as usize].0.stride {
                0 => place.mesh,
                _ => 0,
            },
            Shape::Custom(place) => *place,
        }
    }

    /// The bucket of a leaf; made, with its pipeline, when it is the first.
    #[inline(always)]
    fn bucket(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        stage: &RenderStage,
        leaf: &RenderLeaf,
        entry: &DrawableEntry,
        rows: &[[f32; 4]; 3],
    ) -> u32 {
        let state = &self.states[leaf.state as usize];
        let (code, mirrored) = (stride_code(entry, state), is_mirrored(rows));
        // The application may ask a state for anything: states that draw alike are not one.
        let class = if code == CUSTOM_CODE { leaf.state } else { state.class };
        let key = u64::from(class) << 44 | u64::from(entry.class) << 8 | u64::from(code) << 1 | u64::from(mirrored);
        // Mostly that of the leaf before.
        if key == self.last_bucket.0 {
            self.last_bucket.1
        } else {
            self.find_bucket(ctx, pipelines, stage, key, leaf.state, entry)
        }
    }

    #[inline(never)]
    fn find_bucket(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        stage: &RenderStage,
        key: u64,
        state_index: u32,
        entry: &DrawableEntry,
    ) -> u32 {
        let state = &self.states[state_index as usize];
        let (code, mirrored) = ((key >> 1) as u32 & 0x7f, key & 1 != 0);
        let next = self.buckets.len() as u32;
        let bucket = self.bucket_of.get_or_insert(key, next);
        self.last_bucket = (key, bucket);
        if bucket == next {
            let class = ctx.bind_classes()[entry.class as usize];
            let BindClass { topology, is_masked, double_sided, is_custom, block, vertex_chunk, index_chunk } = class;
            let pipeline = match topology {
                None => PipelineKey::height(&state.key, mirrored),
                Some(topology) => PipelineKey::mesh(&state.key, topology, is_masked, double_sided, mirrored),
            };
            let is_height = topology.is_none();
            let stride = if code == 0 || is_custom { 0 } else { 3 << (code - 1) };
            let is_mesh = !is_height && !is_custom;
            let pipeline = match () {
                _ if stride > 0 => pipeline.pulled(),
                _ if is_mesh => pipelines.with_vertices(pipeline, &ctx.pools().meshes, vertex_chunk),
                _ => pipeline,
            };
            let statics = state.statics;
            let custom = if is_custom { state_index } else { NO_STATE };
            let new = Bucket { pipeline, statics, is_height, block, vertex_chunk, index_chunk, stride, custom };
            let index = match self.last_pipeline {
                // It has its own.
                _ if is_custom => u32::MAX,
                Some((known, index)) if known == pipeline => index,
                _ => match stage.state_sets.get(state_index as usize) {
                    Some(state) => pipelines.ensure_for(ctx, pipeline, state),
                    None => pipelines.ensure(ctx, pipeline),
                },
            };
            if !is_custom {
                self.last_pipeline = Some((pipeline, index));
            }
            self.buckets.push((new, index));
        }
        bucket
    }
}

/// False for what its state hides, which may be all, or what the application draws; and where shadows are cast for what
/// casts none: lines, points, and what the application draws.
#[inline]
fn is_drawn(state: &StateEntry, entry: &DrawableEntry) -> bool {
    if state.shows_all || state.is_hidden {
        return state.shows_all;
    }
    match &entry.shape {
        Shape::Custom(_) => false,
        Shape::Mesh { topology: Topology::Lines | Topology::Points, .. } => !state.key.casts,
        _ => true,
    }
}

#[inline]
fn drawable<'a>(
    ctx: &'a GraphicsContext,
    stage: &'a RenderStage,
    leaf: &RenderLeaf,
) -> Option<(&'a DrawableEntry, &'a [[f32; 4]; 3])> {
    Some((ctx.drawable(leaf.slot)?, stage.eye_from_drawable.get(leaf.matrix as usize)?))
}

fn new_run(ctx: &GraphicsContext, bucket: u32, entry: &DrawableEntry) -> Run {
    let (base_vertex, first_index, index_count) = match &entry.shape {
        Shape::Height(place) => (0, 0, ctx.pools().heights.grid(place.side).map_or(0, |g| g.index_count)),
        Shape::Mesh { place, .. } => (place.base_vertex, place.first_index, place.index_count),
        Shape::Custom(place) => (0, *place, 0),
    };
    Run { bucket, base_vertex, first_index, index_count, first_leaf: 0, leaf_count: 0, all_indices: 0 }
}

impl Run {
    #[inline]
    fn add(&mut self, entry: &DrawableEntry) {
        self.leaf_count += 1;
        if let Shape::Mesh { place, .. } = &entry.shape {
            self.all_indices += u64::from(place.index_count);
        }
    }
}

/// What the shader reads of a leaf; `stride` is that of its bucket, where it is a mesh.
#[inline]
fn uniform(entry: &DrawableEntry, rows: &[[f32; 4]; 3], state: &StateEntry, stride: impl Fn() -> u32) -> LeafUniform {
    let mut flags = state.flags[usize::from(entry.unlit)];
    let mut alpha_cutoff = if let AlphaMode::Mask(cutoff) = entry.alpha { cutoff.to_bits() } else { 0 };
    let (layer, side) = match &entry.shape {
        Shape::Height(place) => (place.layer, place.side),
        Shape::Mesh { texture, place, .. } if stride() > 0 => {
            flags |= place.index_count << INDEX_COUNT_SHIFT;
            alpha_cutoff = place.base_vertex as u32;
            (texture.layer, place.first_index)
        }
        Shape::Mesh { texture, .. } => (texture.layer, 0),
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

/// How many of the next leaves are drawn alike: in any order, in a bin sorted by state, as leaves of which the nearer hides
/// the farther may be, or else in cull's.
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
