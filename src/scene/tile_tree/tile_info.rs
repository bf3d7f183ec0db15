//! Tiles as debug views see them. Main thread, not frame-time code.

use std::sync::atomic::Ordering;

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::slots::SlotState;
use super::tile_record::flag;
use crate::math::OrientedBox;
use crate::scene::graph::Scene;
use crate::scene::id::{NodeId, PageId};
use crate::scene::pages::{Page, UNBOUNDED};

/// Geometric errors from here on are those of tiles that are always refined.
const MAX_ERROR_M: f64 = 1e9;

/// A tile as debug views see it.
#[derive(Clone, Debug)]
pub struct TileInfo {
    /// The tile's node.
    pub node: NodeId,
    /// The declared volume in the world; for a sphere the box around it.
    pub bounds: OrientedBox,
    /// The number of tiles above, over all pages.
    pub depth: u32,
    /// The state of its slot; `None` for a tile without content.
    pub state: Option<SlotState>,
    /// The frame in which a cull last wanted it, or a later one that a prefetch wants it in; 0 for never.
    pub last_used_frame: u32,
}

impl Scene {
    /// Returns the known tiles, page after page: root pages first, then the pages attached to them.
    pub fn tiles(&self) -> impl Iterator<Item = TileInfo> + '_ {
        let mut pages = self.roots().to_vec();
        let mut at = 0;
        std::iter::from_fn(move || {
            let id = *pages.get(at)?;
            at += 1;
            let tiles: Vec<TileInfo> = self
                .page(id)
                .map_or(0..0, |p| 0..p.tiles().len())
                .filter_map(|tile| self.tile_info(id, tile))
                .collect();
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
        let node = NodeId { page: page_id, index: *page.tiles().nodes().get(tile)? };
        Some(TileInfo {
            node,
            bounds: self.tile_box(page_id, tile)?,
            depth: self.base_depth(page_id) + u32::from(page.tiles().records().get(tile)?.depth),
            state: self.slot(node).map(|s| s.state),
            last_used_frame: page.tiles().last_used().get(tile)?.load(Ordering::Relaxed),
        })
    }

    /// Returns the declared volume of a tile in the world; `None` if it is unbounded.
    pub(in crate::scene) fn tile_box(&self, page_id: PageId, tile: usize) -> Option<OrientedBox> {
        let in_page = self.page(page_id)?.tile_box(tile)?;
        Some(in_page.transformed(&self.world_from_page(page_id)?))
    }

    /// Returns the declared volume of the tile of a slot in the frame of its page, and its geometric error in metres. A tile
    /// without an error has half of the error of the tile above, or 0 if no tile above has one.
    pub(crate) fn slot_volume(&self, slot: NodeId) -> Option<(OrientedBox, f64)> {
        let page = self.page(slot.page)?;
        let first = page.tile_of(slot.index)?;
        let (mut tile, mut scale, mut error_m) = (first, 1.0, 0.0);
        while error_m == 0.0 {
            let metric_m = f64::from(page.tiles().bounds().get(tile)?.metric_m());
            let has_error = !page.tiles().records().get(tile)?.has(flag::DISTANCE);
            // Tiles that are always refined have an error that says nothing.
            if has_error && metric_m > 0.0 && metric_m < MAX_ERROR_M {
                error_m = scale * metric_m;
            }
            scale *= 0.5;
            match page.tiles().parents().get(tile) {
                Some(parent) if (*parent as usize) < page.tiles().len() => tile = *parent as usize,
                _ => break,
            }
        }
        Some((page.tile_box(first)?, error_m))
    }
}

impl Page {
    /// Returns the declared volume of a tile in the frame of the page; `None` if it is unbounded.
    fn tile_box(&self, tile: usize) -> Option<OrientedBox> {
        let page = self;
        let bounds = page.tiles().bounds().get(tile)?;
        let half_axes = if bounds.is_sphere() {
            if bounds.radius_m() >= UNBOUNDED {
                return None;
            }
            DMat3::from_diagonal(DVec3::splat(bounds.radius_m().into()))
        } else {
            let [x, y, z] = page.tiles().axes_of(bounds).map(|axis| Vec3::from_array(axis).as_dvec3());
            let half = Vec3::from_array(bounds.half_m()).as_dvec3();
            DMat3::from_cols(x * half.x, y * half.y, z * half.z)
        };
        let in_tile = OrientedBox { center: page.tiles().grid().center(bounds), half_axes };
        Some(in_tile.transformed(&page.page_from_tile(tile)?))
    }

    /// Maps the frame of a tile tree's bounds to the page's.
    pub(in crate::scene) fn page_from_tile(&self, tile: usize) -> Option<DAffine3> {
        Some(self.transforms().page_from_node(self.tiles().root_of(tile as u32)?.transform))
    }
}
