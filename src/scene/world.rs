//! Where nodes and tiles are in the world: for trackers and debug views, not frame time.

use std::sync::atomic::Ordering;

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::graph::Scene;
use super::page::{NONE, Page, UNBOUNDED, kind};
use super::slots::SlotState;
use super::{NodeId, PageId};
use crate::math::{BoundingSphere, OrientedBox};

/// A tile as debug views see it.
#[derive(Clone, Debug)]
pub struct TileInfo {
    /// The tile's node.
    pub node: NodeId,
    /// Declared volume in the world; a sphere as the box around it.
    pub bounds: OrientedBox,
    /// Tiles above it, over all pages.
    pub depth: u32,
    /// What is in its slot; `None` for a tile without content.
    pub state: Option<SlotState>,
    /// Frame in which a cull last wanted it; a later one, where a look ahead did; 0 for never.
    pub last_used_frame: u32,
}

impl Scene {
    /// Maps a page's frame to the world.
    pub fn world_from_page(&self, page: PageId) -> Option<DAffine3> {
        let mut world_from_page = DAffine3::IDENTITY;
        self.page(page)?;
        let mut at = page;
        while let Some(slot) = self.slot_of(at) {
            let holder = self.page(slot.page)?;
            let tile = holder.tile_of(slot.index)?;
            let page_from_content = holder.page_from_tile(tile)? * holder.tiles.content_transform(tile);
            world_from_page = page_from_content * world_from_page;
            at = slot.page;
        }
        Some(world_from_page)
    }

    /// Maps the frame of what hangs in a slot, or would, to the world.
    pub(super) fn world_from_slot(&self, slot: NodeId) -> Option<DAffine3> {
        let holder = self.page(slot.page)?;
        let tile = holder.tile_of(slot.index)?;
        let tile_from_content = holder.tiles.content_transform(tile);
        Some(self.world_from_page(slot.page)? * holder.page_from_tile(tile)? * tile_from_content)
    }

    /// Maps the frame of a node's children (of a Transform: below its own map) to the world.
    pub fn world_from_node(&self, node: NodeId) -> Option<DAffine3> {
        let page = self.page(node.page)?;
        let mut at = node.index;
        if at as usize >= page.node_count() {
            return None;
        }
        let transform = loop {
            let record = page.nodes.get(at as usize)?;
            if record.kind == kind::TRANSFORM {
                break record.first_transform;
            }
            at = *page.parents.get(at as usize)?;
            if at == NONE {
                break 0;
            }
        };
        Some(self.world_from_page(node.page)? * page.transforms.page_from_node(transform))
    }

    /// The sphere around a node in the world; `None` where it has none.
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

    /// The tiles that are known, page after page: roots first, then what hangs in them.
    pub fn tiles(&self) -> impl Iterator<Item = TileInfo> + '_ {
        let mut pages = self.roots().to_vec();
        let mut at = 0;
        std::iter::from_fn(move || {
            let id = *pages.get(at)?;
            at += 1;
            let tiles: Vec<TileInfo> =
                self.page(id).map_or(0..0, |p| 0..p.tiles.len()).filter_map(|tile| self.tile_info(id, tile)).collect();
            pages.extend(tiles.iter().filter_map(|t| match t.state {
                Some(SlotState::Resident(page)) => Some(page),
                _ => None,
            }));
            Some(tiles)
        })
        .flatten()
    }

    fn tile_info(&self, page_id: PageId, tile: usize) -> Option<TileInfo> {
        let page = self.page(page_id)?;
        let node = NodeId { page: page_id, index: *page.tiles.nodes.get(tile)? };
        Some(TileInfo {
            node,
            bounds: self.tile_box(page_id, tile)?,
            depth: self.base_depth(page_id) + u32::from(page.tiles.records.get(tile)?.depth),
            state: self.slot(node).map(|s| s.state),
            last_used_frame: page.tiles.last_used.get(tile)?.load(Ordering::Relaxed),
        })
    }

    fn tile_box(&self, page_id: PageId, tile: usize) -> Option<OrientedBox> {
        let page = self.page(page_id)?;
        let bounds = page.tiles.bounds.get(tile)?;
        let half_axes = if bounds.is_sphere() {
            if bounds.radius_m() >= UNBOUNDED {
                return None;
            }
            DMat3::from_diagonal(DVec3::splat(bounds.radius_m().into()))
        } else {
            let [x, y, z] = page.tiles.axes_of(bounds).map(|axis| Vec3::from_array(axis).as_dvec3());
            let half = Vec3::from_array(bounds.half_m()).as_dvec3();
            DMat3::from_cols(x * half.x, y * half.y, z * half.z)
        };
        let in_tile = OrientedBox { center: page.tiles.grid.center(bounds), half_axes };
        Some(in_tile.transformed(&(self.world_from_page(page_id)? * page.page_from_tile(tile)?)))
    }
}

impl Page {
    /// Maps the frame of a tile tree's bounds to the page's.
    fn page_from_tile(&self, tile: usize) -> Option<DAffine3> {
        Some(self.transforms.page_from_node(self.tiles.root_of(tile as u32)?.transform))
    }
}
