//! Instanced draws. Draw thread; plain values.

use crate::gpu::{DrawableEntry, GraphicsContext, Shape};

/// One instanced draw: leaves of one bucket with the same geometry.
#[derive(Clone, Copy, Debug)]
pub(in crate::draw) struct Run {
    pub(in crate::draw) bucket: u32,
    pub(in crate::draw) base_vertex: i32,
    /// The first index; for splats and custom drawables, the index of the shape.
    pub(in crate::draw) first_index: u32,
    /// The number of indices, or of splats.
    pub(in crate::draw) index_count: u32,
    /// The first instance, which is the index of its first leaf in the leaf buffer.
    pub(in crate::draw) first_leaf: u32,
    pub(in crate::draw) leaf_count: u32,
    /// The number of indices or splats of all its leaves; 0 for others than meshes and splats.
    pub(in crate::draw) all_indices: u64,
}

impl Run {
    /// Returns a run without leaves for the geometry of a drawable.
    pub(super) fn new(ctx: &GraphicsContext, bucket: u32, entry: &DrawableEntry) -> Self {
        let (base_vertex, first_index, index_count) = match &entry.shape {
            Shape::Height(slot) => (0, 0, ctx.pools().heights().grid(slot.side).map_or(0, |g| g.index_count)),
            Shape::Mesh { slot, .. } => (slot.base_vertex, slot.first_index, slot.index_count),
            Shape::Splats { number, count, .. } => (0, *number, *count),
            Shape::Custom(shape) => (0, *shape, 0),
        };
        Self { bucket, base_vertex, first_index, index_count, first_leaf: 0, leaf_count: 0, all_indices: 0 }
    }

    /// Counts one more leaf.
    #[inline]
    pub(super) fn add(&mut self, entry: &DrawableEntry) {
        self.leaf_count += 1;
        self.all_indices += u64::from(match &entry.shape {
            Shape::Mesh { slot, .. } => slot.index_count,
            Shape::Splats { count, .. } => *count,
            Shape::Height(_) | Shape::Custom(_) => 0,
        });
    }
}
