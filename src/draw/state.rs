//! The state of a pass, set lazily: from run to run only what differs. Counts what is set and what is not.

use super::DrawStats;
use crate::draw::batch::{Batch, Bucket, NO_STATE, Run};
use crate::draw::callbacks::RenderInfo;
use crate::draw::pipelines::Pipelines;
use crate::draw::pipelines::key::Kind;
use crate::draw::uniforms::groups::Groups;
use crate::draw::uniforms::pulls::Pulls;
use crate::gpu::{GraphicsContext, TargetFormats};

/// What is set on the pass besides pipelines and what they bind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Dynamics {
    /// x, y, width, height, least and greatest depth.
    pub(super) viewport: [f32; 6],
    pub(super) scissor: [u32; 4],
    pub(super) stencil_reference: u32,
    /// Where blending has a constant.
    pub(super) blend_color: Option<[f32; 4]>,
}

/// State of a run that no pipeline holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Statics {
    pub(super) dynamics: Dynamics,
    /// Places of the frame's and the stage's uniforms.
    pub(super) frame: [u32; 2],
    /// Set of the air's tables.
    pub(super) air: u8,
    /// Bind group 2, and the place of its uniforms where it has some.
    pub(super) group: Option<(u32, Option<u32>)>,
}

/// Sets state only where it changes, and counts both.
pub(super) struct State<'p, 'e> {
    pub(super) pass: &'p mut wgpu::RenderPass<'e>,
    pipeline: Option<u32>,
    statics: Option<u32>,
    dynamics: Option<Dynamics>,
    frame: Option<([u32; 2], u8)>,
    group: Option<(u32, Option<u32>)>,
    /// Block, and whether it is one of height tiles.
    block: Option<(bool, u32)>,
    vertex_chunk: Option<u32>,
    /// The color of packed meshes.
    has_white: bool,
    /// Chunk of meshes, or the grid of a side.
    indices: Option<(bool, u32)>,
    /// Chunks of group 3.
    pulled: Option<(u32, u32)>,
    pub(super) stats: DrawStats,
    /// What the application's drawables complained about.
    pub(super) errors: Vec<String>,
}

/// What a pass draws from.
pub(super) struct Sources<'a> {
    pub(super) ctx: &'a GraphicsContext,
    pub(super) pipelines: &'a Pipelines,
    pub(super) groups: &'a Groups,
    pub(super) batch: &'a Batch,
    pub(super) statics: &'a [Statics],
    /// By set of the air's tables.
    pub(super) frame_groups: &'a [wgpu::BindGroup],
    pub(super) pulls: &'a Pulls,
    /// Arguments of all runs, where several may be drawn by one call.
    pub(super) indirect: Option<&'a wgpu::Buffer>,
    /// For what the application draws; `None` where shadows are cast.
    pub(super) pass: Option<(&'a RenderInfo<'a>, TargetFormats)>,
}

/// Bytes of one run's arguments.
pub(super) const INDIRECT_BYTES: u64 = size_of::<wgpu::util::DrawIndexedIndirectArgs>() as u64;
/// Fewer runs are drawn one by one.
pub(super) const LEAST_MULTI_DRAW: usize = 4;

/// True when the value has to be set.
fn changes<T: PartialEq>(stats: &mut DrawStats, current: &mut Option<T>, wanted: T) -> bool {
    if current.as_ref() == Some(&wanted) {
        stats.state_changes_skipped += 1;
        return false;
    }
    *current = Some(wanted);
    stats.state_changes += 1;
    true
}

impl<'p, 'e> State<'p, 'e> {
    /// For a pass that has just begun, with what passes begin with.
    pub(super) fn new(pass: &'p mut wgpu::RenderPass<'e>, initial: Dynamics) -> Self {
        Self {
            pass,
            pipeline: None,
            statics: None,
            dynamics: Some(initial),
            frame: None,
            group: None,
            block: None,
            vertex_chunk: None,
            has_white: false,
            indices: None,
            pulled: None,
            stats: DrawStats::default(),
            errors: Vec::new(),
        }
    }

    /// Nothing is known to be set: somebody else had the pass.
    pub(super) fn forget(&mut self) {
        self.pipeline = None;
        self.statics = None;
        self.dynamics = None;
        self.frame = None;
        self.group = None;
        self.block = None;
        self.vertex_chunk = None;
        self.has_white = false;
        self.indices = None;
        self.pulled = None;
    }

    /// Sets viewport, scissor, references and uniforms.
    pub(super) fn apply(&mut self, from: &Sources<'_>, index: u32) {
        if self.statics == Some(index) {
            return;
        }
        self.statics = Some(index);
        let Some(statics) = from.statics.get(index as usize) else { return };
        let Dynamics { viewport, scissor, stencil_reference, blend_color } = statics.dynamics;
        let before = self.dynamics;
        let differs = |same: fn(&Dynamics, &Dynamics) -> bool| before.is_none_or(|b| !same(&b, &statics.dynamics));
        if differs(|a, b| a.viewport == b.viewport) {
            let [x, y, width, height, near, far] = viewport;
            self.pass.set_viewport(x, y, width, height, near, far);
            self.stats.state_changes += 1;
        }
        if differs(|a, b| a.scissor == b.scissor) {
            let [x, y, width, height] = scissor;
            self.pass.set_scissor_rect(x, y, width, height);
            self.stats.state_changes += 1;
        }
        if differs(|a, b| a.stencil_reference == b.stencil_reference) {
            self.pass.set_stencil_reference(stencil_reference);
            self.stats.state_changes += 1;
        }
        let constant = before.and_then(|b| b.blend_color);
        if let Some(color) = blend_color.filter(|c| Some(*c) != constant) {
            let [r, g, b, a] = color.map(f64::from);
            self.pass.set_blend_constant(wgpu::Color { r, g, b, a });
            self.stats.state_changes += 1;
        }
        self.dynamics = Some(Dynamics { blend_color: blend_color.or(constant), ..statics.dynamics });
        if let Some(group) = from.frame_groups.get(usize::from(statics.air))
            && changes(&mut self.stats, &mut self.frame, (statics.frame, statics.air))
        {
            self.pass.set_bind_group(0, group, &statics.frame);
        }
        if let Some((group, at)) = statics.group
            && let Some(bind_group) = from.groups.bind_group(group)
            && changes(&mut self.stats, &mut self.group, (group, at))
        {
            self.pass.set_bind_group(2, bind_group, at.as_slice());
        }
    }

    /// Draws runs in their order.
    pub(super) fn draw_runs(&mut self, from: &Sources<'_>, runs: std::ops::Range<usize>) {
        let all = &from.batch.runs;
        let mut at = runs.start;
        while at < runs.end {
            let bucket = all[at].bucket;
            let same = all[at..runs.end].iter().take_while(|r| r.bucket == bucket).count();
            let is_custom = from.batch.buckets[bucket as usize].0.custom != NO_STATE;
            if is_custom {
                for run in &all[at..at + same] {
                    self.draw_custom(from, &from.batch.buckets[bucket as usize].0, run);
                }
            } else if self.bind(from, bucket) {
                let (bucket, _) = &from.batch.buckets[bucket as usize];
                match from.indirect {
                    _ if bucket.stride > 0 => {
                        for run in &all[at..at + same] {
                            let vertices =
                                run.first_leaf * bucket.stride..(run.first_leaf + run.leaf_count) * bucket.stride;
                            self.pass.draw(vertices, bucket.stride..bucket.stride + 1);
                            self.stats.draw_calls += 1;
                        }
                    }
                    Some(indirect) if same >= LEAST_MULTI_DRAW => {
                        self.pass.multi_draw_indexed_indirect(indirect, at as u64 * INDIRECT_BYTES, same as u32);
                        self.stats.draw_calls += 1;
                    }
                    _ => {
                        for run in &all[at..at + same] {
                            self.draw(run);
                        }
                    }
                }
                for run in &all[at..at + same] {
                    self.count(bucket.pipeline.kind(), run);
                }
            }
            at += same;
        }
    }

    fn draw(&mut self, run: &Run) {
        let indices = run.first_index..run.first_index + run.index_count;
        self.pass.draw_indexed(indices, run.base_vertex, run.first_leaf..run.first_leaf + run.leaf_count);
        self.stats.draw_calls += 1;
    }

    fn count(&mut self, kind: Kind, run: &Run) {
        match kind {
            Kind::Points => self.stats.points += run.all_indices,
            Kind::Lines => {}
            Kind::Height => self.stats.triangles += u64::from(run.index_count) * u64::from(run.leaf_count) / 3,
            Kind::Triangles => self.stats.triangles += run.all_indices / 3,
        }
    }

    /// Binds what a bucket's runs need; false, and nothing changed, where something is not there.
    fn bind(&mut self, from: &Sources<'_>, bucket: u32) -> bool {
        let (bucket, pipeline_index) = &from.batch.buckets[bucket as usize];
        let pools = from.ctx.pools();
        if bucket.stride > 0 {
            return self.bind_pulled(from, bucket, *pipeline_index);
        }
        let (block, vertices, indices) = if bucket.is_height {
            let grid = pools.heights.grid(bucket.index_chunk).map(|g| (&g.indices, wgpu::IndexFormat::Uint32));
            (pools.heights.bind_group(bucket.block), None, grid)
        } else {
            let vertices = pools.meshes.vertex_buffer(bucket.vertex_chunk);
            (pools.textures.bind_group(bucket.block), vertices, pools.meshes.index_buffer(bucket.index_chunk))
        };
        let pipeline = from.pipelines.pipeline(*pipeline_index);
        let (Some(pipeline), Some(block), Some((indices, format))) = (pipeline, block, indices) else { return false };
        self.apply(from, bucket.statics);
        if changes(&mut self.stats, &mut self.pipeline, *pipeline_index) {
            self.pass.set_pipeline(pipeline);
        }
        if changes(&mut self.stats, &mut self.block, (bucket.is_height, bucket.block)) {
            self.pass.set_bind_group(1, block, &[]);
        }
        if let Some(vertices) = vertices
            && changes(&mut self.stats, &mut self.vertex_chunk, bucket.vertex_chunk)
        {
            self.pass.set_vertex_buffer(0, vertices.slice(..));
        }
        if bucket.pipeline.is_white()
            && !self.has_white
            && let Some(white) = pools.meshes.white()
        {
            self.pass.set_vertex_buffer(1, white.slice(..));
            self.has_white = true;
            self.stats.state_changes += 1;
        }
        if changes(&mut self.stats, &mut self.indices, (bucket.is_height, bucket.index_chunk)) {
            self.pass.set_index_buffer(indices.slice(..), format);
        }
        true
    }

    /// As [`Self::bind`], for meshes that fetch their vertices themselves.
    fn bind_pulled(&mut self, from: &Sources<'_>, bucket: &Bucket, pipeline_index: u32) -> bool {
        let chunks = (bucket.vertex_chunk, bucket.index_chunk);
        let block = from.ctx.pools().textures.bind_group(bucket.block);
        let pipeline = from.pipelines.pipeline(pipeline_index);
        let (Some(pipeline), Some(block), Some(pull)) = (pipeline, block, from.pulls.get(chunks)) else { return false };
        self.apply(from, bucket.statics);
        if changes(&mut self.stats, &mut self.pipeline, pipeline_index) {
            self.pass.set_pipeline(pipeline);
        }
        if changes(&mut self.stats, &mut self.block, (false, bucket.block)) {
            self.pass.set_bind_group(1, block, &[]);
        }
        if changes(&mut self.stats, &mut self.pulled, chunks) {
            self.pass.set_bind_group(3, pull, &[]);
        }
        true
    }

    /// Draws without vertices: the sky, boxes of queries.
    pub(super) fn draw_bare(
        &mut self,
        pipeline: &wgpu::RenderPipeline,
        vertices: u32,
        instances: std::ops::Range<u32>,
    ) {
        self.pass.set_pipeline(pipeline);
        self.pipeline = None;
        self.stats.state_changes += 1;
        self.pass.draw(0..vertices, instances);
        self.stats.draw_calls += 1;
    }
}
