//! Request volumes of external tilesets, as the tiles know them in which those hang.
//!
//! Children replace a tile's content only for eyes in the volumes of all of them ([`Tiles::may_be_replaced`]), and a child
//! may be another tileset, whose root has the volume. The child takes it up when that tileset is merged, on the update
//! thread; cull reads it. It stays when the tileset expires: from outside the volume the tileset is not wanted, and were
//! the volume forgotten, it would be loaded again only to be found again.

use glam::{DAffine3, DVec3};

use super::graph::Scene;
use super::page::{NONE, Page};
use super::tiles::Tiles;
use crate::math::BoundingVolume;

/// A volume of another tileset's root.
#[derive(Clone, Copy, Debug)]
pub(super) struct ExternalVolume {
    /// Maps the frame of the tile in which the tileset hangs to that of the root.
    root_from_tile: DAffine3,
    volume: BoundingVolume,
}

impl ExternalVolume {
    /// True for an eye in it; the frame is that of the tile in which the tileset hangs.
    pub fn contains(&self, eye: DVec3) -> bool {
        self.volume.contains(self.root_from_tile.transform_point3(eye))
    }
}

impl Scene {
    /// After a page was merged into a tile: the tile takes up the volumes of its roots, and so does each tile above in
    /// which this tile is a root. One step, as a rule.
    pub(super) fn note_external_volumes(&mut self, mut place: u32, mut tile: usize) {
        loop {
            let Some(holder) = self.page_at(place) else { return };
            let content = self.page_at(holder.tiles.contents[tile].resident);
            let volumes =
                content.map_or_else(Vec::new, |page| page.root_volumes(&holder.tiles.content_transform(tile)));
            if volumes.is_empty() && holder.tiles.external_volumes(tile as u32).is_empty() {
                return;
            }
            let parent = holder.tiles.parents[tile];
            let above = self.slot_at(place);
            self.touched_records += 1;
            let Some(holder) = self.page_at_mut(place) else { return };
            if parent != NONE && !volumes.is_empty() {
                holder.tiles.note_volume_below(parent);
            }
            holder.tiles.set_external_volumes(tile as u32, volumes);
            if parent != NONE {
                return;
            }
            let above = above.and_then(|slot| Some((slot.page.slot, self.page(slot.page)?.tile_of(slot.index)?)));
            let Some(above) = above else { return };
            (place, tile) = above;
        }
    }
}

impl Page {
    /// The volumes that an eye must be in for all of the page's tile trees, seen from a tile whose content it is.
    fn root_volumes(&self, tile_from_page: &DAffine3) -> Vec<ExternalVolume> {
        let mut volumes = Vec::new();
        for root in &self.tiles.roots {
            let root_from_tile = (*tile_from_page * self.transforms.page_from_node(root.transform)).inverse();
            // What has no inverse is not drawn.
            if root_from_tile.is_finite() {
                let of_root = self.tiles.volumes_of(root.tile);
                volumes
                    .extend(of_root.map(|v| ExternalVolume { root_from_tile: v.root_from_tile * root_from_tile, ..v }));
            }
        }
        volumes
    }
}

impl Tiles {
    /// The volumes of a tile and of what hangs in it.
    fn volumes_of(&self, tile: u32) -> impl Iterator<Item = ExternalVolume> {
        let own = |volume: &BoundingVolume| ExternalVolume { root_from_tile: DAffine3::IDENTITY, volume: *volume };
        let own = self.request_volume(tile).map(own);
        own.into_iter().chain(self.external_volumes(tile).iter().copied())
    }
}
