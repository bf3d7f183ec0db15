//! Records draws into a render pass and sets state only where it differs from the state that is set. Draw thread.

use std::ops::Range;

use glam::DMat4;

use crate::cull::RenderStage;
use crate::draw::batch::bucket::{Bucket, Content};
use crate::draw::batch::indirect::{INDIRECT_BYTES, MIN_MULTI_DRAW};
use crate::draw::batch::run::Run;
use crate::draw::bound_state::DynamicState;
use crate::draw::callbacks::drawables::{self, DrawableInfo};
use crate::draw::callbacks::info::RenderInfo;
use crate::draw::pipelines::PipelineId;
use crate::draw::pipelines::key::{Kind, PipelineKey};
use crate::draw::resources::Resources;
use crate::draw::stats::DrawStats;
use crate::gpu::{CompileInfo, GraphicsContext, Pools, TargetFormats, Viewpoint};
use crate::scene::has_parallel_rays;

/// The pipelines, buffers and runs that a pass draws from.
pub(in crate::draw) struct DrawSources<'a> {
    pub(in crate::draw) ctx: &'a GraphicsContext,
    pub(in crate::draw) resources: &'a Resources,
    /// Bind groups 0 by index of the set of air tables.
    pub(in crate::draw) frame_groups: &'a [wgpu::BindGroup],
    /// The data for what the application draws; `None` in passes into shadow maps.
    pub(in crate::draw) pass: Option<(&'a RenderInfo<'a>, TargetFormats)>,
}

/// The pool that a bind group or an index buffer belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pool {
    Meshes,
    /// Sets of metallic-roughness surfaces.
    Surfaces,
    Heights,
}

/// Bind group 3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ThirdGroup {
    /// The chunks of vertices and indices of pulled meshes.
    Pulled((u32, u32)),
    /// An attribute of the application's own.
    Attribute(u32),
}

/// State that is known to be set on the pass.
#[derive(Default)]
struct Known {
    pipeline: Option<PipelineId>,
    /// Index of the bound state that was applied last.
    bound: Option<u32>,
    dynamics: Option<DynamicState>,
    /// Bind group 0: offsets of its uniforms, and the set of air tables.
    frame: Option<([u32; 2], u8)>,
    /// Bind group 1: block of a pool.
    block: Option<(Pool, u32)>,
    /// Bind group 2, and the offset of its uniforms.
    group: Option<(u32, Option<u32>)>,
    third: Option<ThirdGroup>,
    vertex_chunk: Option<u32>,
    /// True if vertex buffer 1 holds the colour that packed meshes share.
    has_white: bool,
    /// Chunk of a mesh's indices, or side of a height grid.
    indices: Option<(Pool, u32)>,
}

/// A render pass that is being recorded.
pub(in crate::draw) struct PassRecorder<'p, 'e> {
    pub(in crate::draw) pass: &'p mut wgpu::RenderPass<'e>,
    known: Known,
    stats: DrawStats,
    /// Errors of the application's drawables.
    errors: Vec<String>,
}

/// Returns true if a value has to be set, and counts whether it has.
fn changes<T: PartialEq>(stats: &mut DrawStats, current: &mut Option<T>, wanted: T) -> bool {
    if current.as_ref() == Some(&wanted) {
        stats.state_changes_skipped += 1;
        return false;
    }
    *current = Some(wanted);
    stats.state_changes += 1;
    true
}

/// Returns the projection of the leaves of a state.
fn clip_from_eye(stage: &RenderStage, state: u32) -> DMat4 {
    let index = stage.view_of_state.get(state as usize).copied().unwrap_or(0);
    let view = stage.views.get((index as usize).wrapping_sub(1));
    view.map_or(stage.camera.clip_from_eye, |view| view.clip_from_eye)
}

/// Returns bind group 1 of a bucket of meshes, with the pool that it belongs to.
fn mesh_block<'a>(pools: &'a Pools, bucket: &Bucket) -> (Pool, Option<&'a wgpu::BindGroup>) {
    match bucket.pipeline.has_surface() {
        true => (Pool::Surfaces, pools.surfaces().bind_group(bucket.block)),
        false => (Pool::Meshes, pools.textures().bind_group(bucket.block)),
    }
}

impl<'p, 'e> PassRecorder<'p, 'e> {
    /// Starts to record a pass that has just begun, with the dynamic state that passes begin with.
    pub(in crate::draw) fn new(pass: &'p mut wgpu::RenderPass<'e>, initial: DynamicState) -> Self {
        let known = Known { dynamics: Some(initial), ..Known::default() };
        Self { pass, known, stats: DrawStats::default(), errors: Vec::new() }
    }

    /// Returns the counts of the pass and the errors of the application's drawables.
    pub(in crate::draw) fn finish(self) -> (DrawStats, Vec<String>) {
        (self.stats, self.errors)
    }

    /// Forgets which state is set, because other code has used the pass.
    pub(in crate::draw) fn forget(&mut self) {
        self.known = Known::default();
    }

    /// Counts a draw call by other code that has set some state, and forgets which state is set.
    pub(in crate::draw) fn count_foreign_draw(&mut self, state_changes: u32) {
        self.stats.draw_calls += 1;
        self.stats.state_changes += state_changes;
        self.forget();
    }

    /// Sets the viewport, scissor, references, uniforms and textures of a bound state.
    pub(in crate::draw) fn apply(&mut self, sources: &DrawSources<'_>, index: u32) {
        if self.known.bound == Some(index) {
            return;
        }
        self.known.bound = Some(index);
        let Some(bound) = sources.resources.bound_states.get(index) else { return };
        self.set_dynamics(&bound.dynamics);
        if let Some(group) = sources.frame_groups.get(usize::from(bound.air))
            && changes(&mut self.stats, &mut self.known.frame, (bound.frame, bound.air))
        {
            self.pass.set_bind_group(0, group, &bound.frame);
        }
        if let Some((group, offset)) = bound.group
            && let Some(bind_group) = sources.resources.state_groups.bind_group(group)
            && changes(&mut self.stats, &mut self.known.group, (group, offset))
        {
            self.pass.set_bind_group(2, bind_group, offset.as_slice());
        }
        if let Some(attribute) = bound.attribute
            && let Some(bind_group) = sources.resources.attribute_groups.get(attribute)
            && changes(&mut self.stats, &mut self.known.third, ThirdGroup::Attribute(attribute))
        {
            self.pass.set_bind_group(3, bind_group, &[]);
        }
    }

    fn set_dynamics(&mut self, wanted: &DynamicState) {
        let before = self.known.dynamics;
        let differs = |same: fn(&DynamicState, &DynamicState) -> bool| before.is_none_or(|b| !same(&b, wanted));
        if differs(|a, b| a.viewport == b.viewport) {
            let [x, y, width, height, near, far] = wanted.viewport;
            self.pass.set_viewport(x, y, width, height, near, far);
            self.stats.state_changes += 1;
        }
        if differs(|a, b| a.scissor == b.scissor) {
            let [x, y, width, height] = wanted.scissor;
            self.pass.set_scissor_rect(x, y, width, height);
            self.stats.state_changes += 1;
        }
        if differs(|a, b| a.stencil_reference == b.stencil_reference) {
            self.pass.set_stencil_reference(wanted.stencil_reference);
            self.stats.state_changes += 1;
        }
        let constant = before.and_then(|b| b.blend_color);
        if let Some(color) = wanted.blend_color.filter(|c| Some(*c) != constant) {
            let [r, g, b, a] = color.map(f64::from);
            self.pass.set_blend_constant(wgpu::Color { r, g, b, a });
            self.stats.state_changes += 1;
        }
        self.known.dynamics = Some(DynamicState { blend_color: wanted.blend_color.or(constant), ..*wanted });
    }

    /// Draws runs in their order. Runs of one bucket are one indirect call if there are enough of them.
    pub(in crate::draw) fn draw_runs(&mut self, sources: &DrawSources<'_>, runs: Range<usize>) {
        let batch = &sources.resources.batch;
        let all = batch.runs();
        let mut at = runs.start;
        while at < runs.end {
            let index = all[at].bucket;
            let same = all[at..runs.end].iter().take_while(|run| run.bucket == index).count();
            let same_runs = &all[at..at + same];
            let (bucket, pipeline) = batch.bucket(index);
            match bucket.content {
                Content::Splats { state } => {
                    same_runs.iter().for_each(|run| self.draw_splats(sources, bucket, *pipeline, state, run));
                }
                Content::Custom { state } => {
                    same_runs.iter().for_each(|run| self.draw_custom(sources, bucket, state, run));
                }
                Content::PulledMesh { stride } => {
                    if self.bind_pulled(sources, bucket, *pipeline) {
                        for run in same_runs {
                            let vertices = run.first_leaf * stride..(run.first_leaf + run.leaf_count) * stride;
                            self.pass.draw(vertices, stride..stride + 1);
                            self.stats.draw_calls += 1;
                            self.count(bucket.pipeline, run);
                        }
                    }
                }
                Content::Mesh | Content::Height => {
                    if self.bind(sources, bucket, *pipeline) {
                        self.draw_indexed(sources, at, same_runs);
                        same_runs.iter().for_each(|run| self.count(bucket.pipeline, run));
                    }
                }
            }
            at += same;
        }
    }

    /// Draws successive runs of a bound bucket; `first` is the index of the first one.
    fn draw_indexed(&mut self, sources: &DrawSources<'_>, first: usize, runs: &[Run]) {
        if runs.len() >= MIN_MULTI_DRAW
            && let Some(indirect) = sources.resources.indirect.buffer()
        {
            self.pass.multi_draw_indexed_indirect(indirect, first as u64 * INDIRECT_BYTES, runs.len() as u32);
            self.stats.draw_calls += 1;
            return;
        }
        for run in runs {
            let indices = run.first_index..run.first_index + run.index_count;
            self.pass.draw_indexed(indices, run.base_vertex, run.first_leaf..run.first_leaf + run.leaf_count);
            self.stats.draw_calls += 1;
        }
    }

    fn count(&mut self, pipeline: PipelineKey, run: &Run) {
        match pipeline.kind() {
            Kind::Points if pipeline.is_square() => self.stats.points += run.all_indices / 6,
            Kind::Points => self.stats.points += run.all_indices,
            Kind::Lines => {}
            Kind::Height => self.stats.triangles += u64::from(run.index_count) * u64::from(run.leaf_count) / 3,
            Kind::Triangles => self.stats.triangles += run.all_indices / 3,
        }
    }

    /// Sets the pipeline, buffers and bind groups of a bucket. Returns false, with nothing changed, if its pipeline
    /// could not be created or its buffers were freed.
    fn bind(&mut self, sources: &DrawSources<'_>, bucket: &Bucket, pipeline_id: Option<PipelineId>) -> bool {
        let pools = sources.ctx.pools();
        let (pool, block, vertices, indices) = match bucket.content {
            Content::Height => {
                let grid = pools.heights().grid(bucket.index_chunk).map(|g| (&g.indices, wgpu::IndexFormat::Uint32));
                (Pool::Heights, pools.heights().bind_group(bucket.block), None, grid)
            }
            _ => {
                let vertices = pools.meshes().vertex_buffer(bucket.vertex_chunk);
                let indices = pools.meshes().index_buffer(bucket.index_chunk);
                let (pool, block) = mesh_block(pools, bucket);
                (pool, block, vertices, indices)
            }
        };
        let pipeline = pipeline_id.and_then(|id| Some((id, sources.resources.pipelines.pipeline(id)?)));
        let (Some((id, pipeline)), Some(block), Some((indices, format))) = (pipeline, block, indices) else {
            return false;
        };
        self.apply(sources, bucket.bound);
        self.set_pipeline_and_block((id, pipeline), (pool, bucket.block), block);
        let pool = if pool == Pool::Heights { pool } else { Pool::Meshes };
        if let Some(vertices) = vertices
            && changes(&mut self.stats, &mut self.known.vertex_chunk, bucket.vertex_chunk)
        {
            self.pass.set_vertex_buffer(0, vertices.slice(..));
        }
        if bucket.pipeline.is_white()
            && !self.known.has_white
            && let Some(white) = pools.meshes().white()
        {
            self.pass.set_vertex_buffer(1, white.slice(..));
            self.known.has_white = true;
            self.stats.state_changes += 1;
        }
        if changes(&mut self.stats, &mut self.known.indices, (pool, bucket.index_chunk)) {
            self.pass.set_index_buffer(indices.slice(..), format);
        }
        true
    }

    /// Sets a pipeline and the bind group of a pool's block where they change.
    fn set_pipeline_and_block(
        &mut self,
        (id, pipeline): (PipelineId, &wgpu::RenderPipeline),
        key: (Pool, u32),
        block: &wgpu::BindGroup,
    ) {
        if changes(&mut self.stats, &mut self.known.pipeline, id) {
            self.pass.set_pipeline(pipeline);
        }
        if changes(&mut self.stats, &mut self.known.block, key) {
            self.pass.set_bind_group(1, block, &[]);
        }
    }

    /// Does the same as [`Self::bind`] for meshes whose shader fetches the vertices.
    fn bind_pulled(&mut self, sources: &DrawSources<'_>, bucket: &Bucket, pipeline_id: Option<PipelineId>) -> bool {
        let resources = sources.resources;
        let chunks = (bucket.vertex_chunk, bucket.index_chunk);
        let (pool, block) = mesh_block(sources.ctx.pools(), bucket);
        let pipeline = pipeline_id.and_then(|id| Some((id, resources.pipelines.pipeline(id)?)));
        let (Some((id, pipeline)), Some(block), Some(pulled)) = (pipeline, block, resources.vertex_pulling.get(chunks))
        else {
            return false;
        };
        self.apply(sources, bucket.bound);
        self.set_pipeline_and_block((id, pipeline), (pool, bucket.block), block);
        if changes(&mut self.stats, &mut self.known.third, ThirdGroup::Pulled(chunks)) {
            self.pass.set_bind_group(3, pulled, &[]);
        }
        true
    }

    /// Draws with a built-in pipeline, which has no vertex buffer.
    pub(in crate::draw) fn draw_builtin(
        &mut self,
        pipeline: &wgpu::RenderPipeline,
        vertices: u32,
        instances: Range<u32>,
    ) {
        self.pass.set_pipeline(pipeline);
        self.known.pipeline = None;
        self.stats.state_changes += 1;
        self.pass.draw(0..vertices, instances);
        self.stats.draw_calls += 1;
    }

    /// Draws the splats of a run from back to front, for each of its leaves. `state` is the index of their state in the stage.
    fn draw_splats(
        &mut self,
        sources: &DrawSources<'_>,
        bucket: &Bucket,
        pipeline: Option<PipelineId>,
        state: u32,
        run: &Run,
    ) {
        let Some((info, _)) = sources.pass else { return };
        let resources = sources.resources;
        let Some(id) = pipeline else { return };
        let Some(pipeline) = resources.pipelines.pipeline(id) else { return };
        let has_parallel_rays = has_parallel_rays(&clip_from_eye(info.stage, state));
        let leaves = resources.batch.leaves().iter().zip(0u32..).skip(run.first_leaf as usize);
        for (leaf, index) in leaves.take(run.leaf_count as usize) {
            let viewpoint = Viewpoint::new(&leaf.eye_from_drawable, has_parallel_rays);
            let sorted = sources.ctx.pools().sorted_splats(info.queue, run.first_index, viewpoint);
            let Some(group) = sorted else { continue };
            self.apply(sources, bucket.bound);
            if changes(&mut self.stats, &mut self.known.pipeline, id) {
                self.pass.set_pipeline(pipeline);
            }
            self.pass.set_bind_group(1, &group, &[]);
            self.known.block = None;
            self.stats.state_changes += 1;
            self.pass.draw(0..6 * run.index_count, index..index + 1);
            self.stats.draw_calls += 1;
        }
        self.count(bucket.pipeline, run);
    }

    /// Calls the application's drawable for a run. `state` is the index of its state in the stage.
    fn draw_custom(&mut self, sources: &DrawSources<'_>, bucket: &Bucket, state: u32, run: &Run) {
        let Some((info, target)) = sources.pass else { return };
        let resources = sources.resources;
        // A custom run holds the index of its shape there.
        let Some(mut shape) = sources.ctx.pools().customs().borrow(run.first_index) else { return };
        let compile = CompileInfo {
            device: info.device,
            queue: info.queue,
            frame_layout: resources.pipelines.frame_layout(),
            pipeline_cache: sources.ctx.pipeline_cache(),
        };
        match drawables::ensure_ready(&mut **shape, &compile, &target, &mut self.stats.pipelines_created) {
            Ok(true) => {}
            Ok(false) => return,
            Err(error) => return self.errors.push(error),
        }
        let stage = info.stage;
        let instances = run.first_leaf..run.first_leaf + run.leaf_count;
        let range = instances.start as usize..instances.end as usize;
        let (Some(resolved), Some(leaves)) =
            (stage.state_sets.get(state as usize), resources.batch.leaves().get(range))
        else {
            return;
        };
        self.apply(sources, bucket.bound);
        let index = stage.view_of_state.get(state as usize).copied().unwrap_or(0);
        let viewport = resources.bound_states.get(bucket.bound).map_or([0.0; 6], |bound| bound.dynamics.viewport);
        let drawing = DrawableInfo {
            render: info,
            target,
            viewport_px: [0, 1, 2, 3].map(|i| viewport[i]),
            camera: stage.camera_of(index),
            clip_from_eye: clip_from_eye(stage, state),
            state: resolved,
            instances,
            leaves,
        };
        self.errors.extend(drawables::draw(&mut **shape, &drawing, self.pass).err());
        self.stats.draw_calls += 1;
        self.forget();
    }
}
