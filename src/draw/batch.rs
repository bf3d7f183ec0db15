//! From leaves to runs: which leaves are one instanced draw, in which order.
//!
//! Draw thread. Reuses its memory; allocates nothing once as large a stage was drawn before.

use super::frame::{FLAG_UNLIT, LeafUniform};
use super::key::{PipelineKey, StateKey};
use super::pipelines::Pipelines;
use crate::cull::{RenderLeaf, RenderStage};
use crate::gpu::{DrawableEntry, GraphicsContext, Shape};
use crate::scene::AlphaMode;
use crate::state::{ResolvedState, SortMode};

/// Everything that must be equal for two leaves to be one draw; sorted so that dear changes are rare.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RunKey {
    pub(super) pipeline: PipelineKey,
    /// Block of group 1.
    pub(super) block: u32,
    pub(super) vertex_chunk: u32,
    pub(super) index_chunk: u32,
    /// Mesh, or side of a height tile.
    pub(super) geometry: u32,
}

/// An instanced draw.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    pub(super) key: RunKey,
    /// Index of the pipeline, once it was made.
    pub(super) pipeline: u32,
    pub(super) base_vertex: i32,
    pub(super) first_index: u32,
    pub(super) index_count: u32,
    /// Range of instances, which is that of leaves in the buffer.
    pub(super) first_leaf: u32,
    pub(super) leaf_count: u32,
}

struct Item {
    key: RunKey,
    /// Keeps the order of equal keys.
    sequence: u32,
    base_vertex: i32,
    first_index: u32,
    index_count: u32,
    leaf: LeafUniform,
}

/// The draws of a stage.
#[derive(Default)]
pub(super) struct Batch {
    items: Vec<Item>,
    /// By state of the stage.
    state_keys: Vec<StateKey>,
    pub(super) leaves: Vec<LeafUniform>,
    pub(super) runs: Vec<Run>,
    /// Index of the run before which the sky belongs.
    pub(super) sky_before: usize,
}

fn is_mirrored(rows: &[[f32; 4]; 3]) -> bool {
    let [a, b, c] = rows.map(|r| glam::Vec3::new(r[0], r[1], r[2]));
    a.dot(b.cross(c)) < 0.0
}

fn item(
    ctx: &GraphicsContext,
    entry: &DrawableEntry,
    rows: &[[f32; 4]; 3],
    state: &ResolvedState,
    state_key: &StateKey,
) -> Option<Item> {
    let mut leaf = LeafUniform {
        eye_from_drawable: *rows,
        color: [0, 1, 2, 3].map(|i| entry.base_color[i] * state.color[i]),
        layer: 0,
        flags: if entry.unlit { FLAG_UNLIT } else { 0 },
        alpha_cutoff: if let AlphaMode::Mask(cutoff) = entry.alpha { cutoff } else { 0.0 },
        side: 0,
    };
    match &entry.shape {
        Shape::Height(place) => {
            leaf.layer = place.layer;
            leaf.side = place.side;
            let key = RunKey {
                pipeline: PipelineKey::height(state_key, is_mirrored(rows)),
                block: place.block,
                vertex_chunk: 0,
                index_chunk: 0,
                geometry: place.side,
            };
            let index_count = ctx.pools().heights.grid(place.side)?.index_count;
            Some(Item { key, sequence: 0, base_vertex: 0, first_index: 0, index_count, leaf })
        }
        Shape::Mesh { place, topology, texture } => {
            leaf.layer = texture.layer;
            let pipeline = PipelineKey::mesh(state_key, *topology, entry.alpha, entry.double_sided, is_mirrored(rows));
            let key = RunKey {
                pipeline,
                block: texture.block,
                vertex_chunk: place.vertex_chunk,
                index_chunk: place.index_chunk,
                geometry: place.mesh,
            };
            Some(Item {
                key,
                sequence: 0,
                base_vertex: place.base_vertex,
                first_index: place.first_index,
                index_count: place.index_count,
                leaf,
            })
        }
    }
}

impl Batch {
    /// Fills the batch from a stage; at most `most_leaves`, the rest is dropped (and the count returned).
    pub(super) fn build(
        &mut self,
        ctx: &GraphicsContext,
        pipelines: &mut Pipelines,
        stage: &RenderStage,
        most_leaves: usize,
    ) -> usize {
        self.leaves.clear();
        self.runs.clear();
        self.state_keys.clear();
        self.state_keys.extend(stage.state_sets.iter().map(|state| pipelines.state_key(state)));
        let mut dropped = 0;
        for bin in &stage.bins {
            let mut rest = &bin.leaves[..];
            while let Some(first) = rest.first() {
                let (group, after) = rest.split_at(regroupable(bin.sort, &self.state_keys, rest, first));
                rest = after;
                self.gather(ctx, stage, group);
                if bin.sort == SortMode::ByState {
                    self.items.sort_unstable_by_key(|i| (i.key, i.sequence));
                }
                dropped += self.append(most_leaves);
            }
        }
        let is_see_through = |r: &Run| !r.key.pipeline.writes_depth();
        self.sky_before = self.runs.iter().position(is_see_through).unwrap_or(self.runs.len());
        dropped
    }

    fn gather(&mut self, ctx: &GraphicsContext, stage: &RenderStage, leaves: &[RenderLeaf]) {
        self.items.clear();
        for leaf in leaves {
            let Some(entry) = ctx.drawable(leaf.slot) else { continue };
            let (Some(rows), Some(state), Some(state_key)) = (
                stage.eye_from_drawable.get(leaf.matrix as usize),
                stage.state_sets.get(leaf.state as usize),
                self.state_keys.get(leaf.state as usize),
            ) else {
                continue;
            };
            if let Some(mut item) = item(ctx, entry, rows, state, state_key) {
                item.sequence = self.items.len() as u32;
                self.items.push(item);
            }
        }
    }

    fn append(&mut self, most_leaves: usize) -> usize {
        let room = most_leaves.saturating_sub(self.leaves.len());
        for item in self.items.iter().take(room) {
            let first_leaf = self.leaves.len() as u32;
            self.leaves.push(item.leaf);
            match self.runs.last_mut() {
                Some(run) if run.key == item.key => run.leaf_count += 1,
                _ => self.runs.push(Run {
                    key: item.key,
                    pipeline: 0,
                    base_vertex: item.base_vertex,
                    first_index: item.first_index,
                    index_count: item.index_count,
                    first_leaf,
                    leaf_count: 1,
                }),
            }
        }
        self.items.len().saturating_sub(room)
    }
}

/// How many of the next leaves may change places with each other. In a bin sorted by state, leaves of which the
/// nearer hides the farther may, whatever their state; others may inside one state. Other bins keep cull's order.
fn regroupable(sort: SortMode, states: &[StateKey], leaves: &[RenderLeaf], first: &RenderLeaf) -> usize {
    if sort != SortMode::ByState {
        return leaves.len();
    }
    let is_free = |l: &RenderLeaf| states.get(l.state as usize).is_none_or(|s| s.order_is_free);
    let fits = |l: &RenderLeaf| if is_free(first) { is_free(l) } else { l.state == first.state };
    leaves.iter().position(|l| !fits(l)).unwrap_or(leaves.len())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::cull::{CullCamera, CullVisitor};
    use crate::gpu::{AdapterChoice, CompileBudget, CompileOperation, ContextTraits};
    use crate::math::Aabb;
    use crate::scene::{Drawable, Geometry, Material, Mesh, MeshVertex, Node, Page, Scene, Topology};

    #[test]
    fn a_steady_batch_keeps_its_memory() {
        let traits = ContextTraits { size_px: [64, 64], adapter: AdapterChoice::Noop, validation: false };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let drawable = |z: f64| {
            let vertices = vec![MeshVertex { position: [0.0, 0.0, z as f32], ..MeshVertex::default() }; 3];
            let bounds = Aabb { min: glam::DVec3::new(-1.0, -1.0, z), max: glam::DVec3::new(1.0, 1.0, z) };
            let mesh = Mesh { vertices, indices: [0, 1, 2].into(), topology: Topology::Triangles, bounds };
            Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default())
        };
        let nodes = (0..200).map(|i| Node::geode(vec![drawable(-5.0 - f64::from(i))])).collect();
        let mut page = Page::from_node(Node::group(nodes)).unwrap();
        ctx.compile(CompileOperation { ticket: 0, drawables: page.take_drawables() });
        ctx.run_compiles(&CompileBudget::UNLIMITED);
        page.set_draw_slots(0, ctx.take_compiled().remove(0).slots);
        let mut scene = Scene::new();
        scene.add_root(page);
        let mut stage = RenderStage::new();
        CullVisitor::new().cull(&scene, &CullCamera::default(), &mut stage);

        let mut batch = Batch::default();
        let mut pipelines = Pipelines::new(ctx.device());
        let memory = |b: &Batch| {
            let places = (b.items.as_ptr() as usize, b.leaves.as_ptr() as usize, b.runs.as_ptr() as usize);
            (places, b.items.capacity(), b.leaves.capacity(), b.runs.capacity())
        };
        assert_eq!(batch.build(&ctx, &mut pipelines, &stage, usize::MAX), 0);
        assert_eq!(batch.leaves.len(), 200);
        let warm = memory(&batch);
        for _ in 0..10 {
            batch.build(&ctx, &mut pipelines, &stage, usize::MAX);
            assert_eq!(memory(&batch), warm);
        }
        // What does not fit into the adapter's buffer is dropped and counted.
        assert_eq!(batch.build(&ctx, &mut pipelines, &stage, 150), 50);
        assert_eq!(batch.leaves.len(), 150);
    }
}
