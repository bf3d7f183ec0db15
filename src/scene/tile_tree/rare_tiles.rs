//! Properties that few tiles have, in tables apart from the tile records.

use std::collections::BTreeMap;

use glam::DVec3;

use super::content_volume::ContentVolume;
use super::external_volume::ExternalVolume;
use super::readiness::ChildCounts;
use crate::math::BoundingVolume;
use crate::scene::nodes::PagingOptions;
use crate::scene::sparse_list::SparseList;

/// Tables by tile. A page without such tiles has none of them.
#[derive(Debug, Default)]
pub(super) struct RareTiles {
    /// The centres from which tiles with [`flag::DISTANCE`](super::flag::DISTANCE) measure.
    pub distance_centers: SparseList<DVec3>,
    /// The volumes of tiles with [`flag::REQUEST_VOLUME`](super::flag::REQUEST_VOLUME).
    pub request_volumes: SparseList<BoundingVolume>,
    /// The volumes of the contents of tiles with [`flag::CONTENT_VOLUME`](super::flag::CONTENT_VOLUME).
    pub content_volumes: SparseList<ContentVolume>,
    /// Copies of the volumes of tilesets that are or were attached to a tile.
    pub external_volumes: BTreeMap<u32, Vec<ExternalVolume>>,
    /// The counts of children, by parent (`NONE` for top tiles), where some child is unavailable.
    pub unavailable_children: BTreeMap<u32, ChildCounts>,
    /// The state paths of tiles with [`flag::OWN_PATH`](super::flag::OWN_PATH).
    pub own_paths: SparseList<u32>,
    /// Paging options other than the default.
    pub paging: SparseList<PagingOptions>,
    /// The nodes of proxies that are loaded immediately.
    pub immediate: Vec<u32>,
}

impl RareTiles {
    /// Replaces every tile index by another, after the tiles were reordered.
    pub fn renumber(&mut self, new_index: &[u32]) {
        self.distance_centers.renumber(new_index);
        self.request_volumes.renumber(new_index);
        self.content_volumes.renumber(new_index);
        self.own_paths.renumber(new_index);
        self.paging.renumber(new_index);
    }
}
