//! Positions of pages, slots and nodes in the world: for trackers and debug views, not for frame-time code.

use glam::DAffine3;

use super::graph::Scene;
use super::id::{NONE, NodeId, PageId};
use super::pages::kind;
use crate::math::BoundingSphere;

impl Scene {
    /// Maps a page's frame to the world.
    pub fn world_from_page(&self, page: PageId) -> Option<DAffine3> {
        let mut world_from_page = DAffine3::IDENTITY;
        self.page(page)?;
        let mut at = page;
        while let Some(slot) = self.slot_of(at) {
            let holder = self.page(slot.page)?;
            let tile = holder.tile_of(slot.index)?;
            let page_from_content = holder.page_from_tile(tile)? * holder.tiles().content_transform(tile);
            world_from_page = page_from_content * world_from_page;
            at = slot.page;
        }
        Some(world_from_page)
    }

    /// Maps the frame of a slot's content, attached or not, to the world.
    pub(super) fn world_from_slot(&self, slot: NodeId) -> Option<DAffine3> {
        let holder = self.page(slot.page)?;
        let tile = holder.tile_of(slot.index)?;
        let tile_from_content = holder.tiles().content_transform(tile);
        Some(self.world_from_page(slot.page)? * holder.page_from_tile(tile)? * tile_from_content)
    }

    /// Maps the frame of a node's children to the world: for a Transform, the frame below its own map.
    pub fn world_from_node(&self, node: NodeId) -> Option<DAffine3> {
        let page = self.page(node.page)?;
        let mut at = node.index;
        if at as usize >= page.node_count() {
            return None;
        }
        let transform = loop {
            let record = page.nodes().get(at as usize)?;
            if record.kind == kind::TRANSFORM {
                break record.first_transform;
            }
            at = *page.parents().get(at as usize)?;
            if at == NONE {
                break 0;
            }
        };
        Some(self.world_from_page(node.page)? * page.transforms().page_from_node(transform))
    }

    /// Returns the sphere around a node in the world; `None` if it has none.
    pub fn node_sphere(&self, node: NodeId) -> Option<BoundingSphere> {
        let page = self.page(node.page)?;
        if let Some(tile) = page.tile_of(node.index) {
            let bounds = self.tile_box(node.page, tile)?;
            let reach = bounds.half_axes;
            let radius_m =
                (reach.x_axis.length_squared() + reach.y_axis.length_squared() + reach.z_axis.length_squared()).sqrt();
            return Some(BoundingSphere::new(bounds.center, radius_m));
        }
        Some(page.node_sphere(node.index)?.transformed(&self.world_from_page(node.page)?))
    }
}
