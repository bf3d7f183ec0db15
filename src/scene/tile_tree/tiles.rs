//! The tile trees of a page: bounds, content slots and readiness, as flat arrays.
//!
//! The children of a tile are neighbours, followed by the descendants of the first child, then those of the second, and
//! so on. A walk that stops at some level therefore meets tiles that lie side by side, several in a cache line.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DAffine3, DVec3, Vec3, Vec4};

use super::content_volume::ContentVolume;
use super::external_volume::ExternalVolume;
use super::ground_tiles::GroundTiles;
use super::rare_tiles::RareTiles;
use super::readiness::{ChildCounts, Readiness};
use super::tile_bounds::{BoxAxes, TileBounds, TileEye, TileGrid, TileVolumes};
use super::tile_contents::{TileContents, taken};
use super::tile_record::{TileRecord, flag};
use crate::math::{BoundingSphere, BoundingVolume};
use crate::scene::id::{NONE, PageId};
use crate::scene::nodes::{PagingOptions, ReaderData};
use crate::scene::settings::LodRanges;

/// The tiles of a page.
#[derive(Debug, Default)]
pub(crate) struct Tiles {
    pub(super) records: Vec<TileRecord>,
    pub(super) volumes: TileVolumes,
    pub(super) contents: TileContents,
    /// The frame in which each tile was last wanted, or will be. Culls store it through a shared reference (relaxed,
    /// since a stamp guards no other data), update reads it. Not part of the records, because culls that run at the same
    /// time would take their cache lines from each other.
    pub(super) last_used: Vec<AtomicU32>,
    pub(super) parents: Vec<u32>,
    /// The number of children that are resident or have something resident below them.
    pub(super) busy_children: Vec<u32>,
    pub(super) nodes: Vec<u32>,
    pub(super) rare: Option<Box<RareTiles>>,
    /// The tables of tiles of a globe's surface.
    pub(super) ground: Option<Box<GroundTiles>>,
    pub(super) roots: Vec<TileRoot>,
    /// Declared spheres of the top tiles in their own frames, by root.
    pub(super) root_spheres: Vec<BoundingSphere>,
    /// The number of top tiles that are waited for, as [`TileRecord::not_ready_children`].
    pub(super) not_ready_roots: u32,
}

/// A tile tree inside a page.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileRoot {
    /// The top tile.
    pub tile: u32,
    /// The transform whose frame the tree's bounds are in.
    pub transform: u32,
    /// The page's state path above the tile.
    pub state_path: u32,
}

/// The arrays that culls read. Inlined, so that a walk keeps slices.
impl Tiles {
    #[inline(always)]
    pub fn records(&self) -> &[TileRecord] {
        &self.records
    }

    /// Returns the declared volume of each tile.
    #[inline(always)]
    pub fn bounds(&self) -> &[TileBounds] {
        self.volumes.bounds()
    }

    /// Returns the grid that the bounds' centres are counted on.
    #[inline(always)]
    pub fn grid(&self) -> &TileGrid {
        self.volumes.grid()
    }

    /// Returns the axes of a tile's box.
    #[inline(always)]
    pub fn axes_of(&self, bounds: &TileBounds) -> &BoxAxes {
        self.volumes.axes_of(bounds)
    }

    /// Returns the frame in which each tile was last wanted; 0 for never.
    #[inline(always)]
    pub fn last_used(&self) -> &[AtomicU32] {
        &self.last_used
    }

    /// Returns the parent of each tile, `NONE` for top tiles.
    #[inline(always)]
    pub fn parents(&self) -> &[u32] {
        &self.parents
    }

    /// Returns the node of each tile.
    #[inline(always)]
    pub fn nodes(&self) -> &[u32] {
        &self.nodes
    }

    /// Returns what is known of the tiles of a globe's surface; `None` for other pages.
    #[inline(always)]
    pub fn ground(&self) -> Option<&GroundTiles> {
        self.ground.as_deref()
    }

    /// Returns the tile trees of the page, sorted by tile.
    #[inline(always)]
    pub fn roots(&self) -> &[TileRoot] {
        &self.roots
    }

    /// Returns the slot of the resident page in the scene's page table, or `NONE`.
    #[inline(always)]
    pub fn resident(&self, tile: usize) -> u32 {
        self.contents.resident(tile)
    }

    /// Returns the first tile with resident content from a tile upwards, in this page; `None` without any, and for `NONE`.
    pub fn resident_from(&self, mut tile: u32) -> Option<u32> {
        loop {
            let record = self.records.get(tile as usize)?;
            if record.has(flag::RESIDENT) && !record.has(flag::EXTERNAL) {
                return Some(tile);
            }
            tile = self.parents[tile as usize];
        }
    }

    /// Returns true if some child of a tile has resident content.
    pub fn has_resident_child(&self, record: &TileRecord) -> bool {
        let children = self.records.get(record.first_child as usize..record.end_of_children() as usize);
        children.is_some_and(|children| children.iter().any(|child| child.has(flag::RESIDENT)))
    }

    /// Returns the map from the content's frame to the tile's.
    #[inline]
    pub fn content_transform(&self, tile: usize) -> DAffine3 {
        self.contents.transform(tile)
    }

    /// Returns the tile that follows everything below `tile` in the walk of a tree, or `NONE`.
    #[inline]
    pub fn behind(&self, mut tile: u32) -> u32 {
        loop {
            let parent = self.parents[tile as usize];
            if parent == NONE {
                return NONE;
            }
            if tile + 1 < self.records[parent as usize].end_of_children() {
                return tile + 1;
            }
            tile = parent;
        }
    }
}

/// Properties of single tiles and trees.
impl Tiles {
    pub fn len(&self) -> usize {
        self.records.len()
    }

    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    pub(super) fn rare_mut(&mut self) -> &mut RareTiles {
        self.rare.get_or_insert_default()
    }

    /// Returns true if some tile is only for eyes inside a volume.
    pub fn has_request_volumes(&self) -> bool {
        self.rare.as_ref().is_some_and(|rare| !rare.request_volumes.is_empty())
    }

    /// Returns the volume of a tile's content, if it is declared and smaller than the tile's.
    pub fn content_volume(&self, tile: u32) -> Option<&ContentVolume> {
        self.rare.as_ref()?.content_volumes.get(tile)
    }

    /// Returns the nodes of proxies that are loaded as soon as the page is in a scene.
    pub fn immediate(&self) -> &[u32] {
        self.rare.as_ref().map_or(&[], |rare| &rare.immediate)
    }

    /// Returns the trees with the spheres of their top tiles, in the frames of the trees.
    pub fn roots_with_spheres(&self) -> impl Iterator<Item = (&TileRoot, &BoundingSphere)> {
        self.roots.iter().zip(&self.root_spheres)
    }

    /// Returns the tree of a top tile with its sphere; `None` for all other tiles.
    pub fn root_with_sphere(&self, tile: u32) -> Option<(&TileRoot, &BoundingSphere)> {
        let root = self.roots.binary_search_by_key(&tile, |r| r.tile).ok()?;
        Some((self.roots.get(root)?, self.root_spheres.get(root)?))
    }

    /// Returns the tree that a tile belongs to.
    pub fn root_of(&self, tile: u32) -> Option<&TileRoot> {
        let behind = self.roots.partition_point(|root| root.tile <= tile);
        self.roots.get(behind.checked_sub(1)?)
    }

    /// Returns the page's state path above a tile of a tree.
    pub fn state_path(&self, tile: u32, root: &TileRoot) -> u32 {
        let own = self.rare.as_ref().and_then(|rare| rare.own_paths.get(tile));
        own.copied().unwrap_or(root.state_path)
    }

    /// Returns how the pager treats a tile's content.
    pub fn paging_of(&self, tile: u32) -> PagingOptions {
        self.rare.as_ref().and_then(|rare| rare.paging.get(tile)).copied().unwrap_or_default()
    }

    /// Returns the URI of a tile's content; `None` if it has no slot.
    pub fn uri(&self, tile: usize) -> Option<&Arc<str>> {
        self.contents.uri(tile)
    }

    /// Returns what the reader wants handed back with the URI.
    pub fn reader_data(&self, tile: usize) -> Option<&ReaderData> {
        self.contents.reader_data(tile)
    }

    /// Stores the frame in which a tile was last wanted.
    pub fn note_use(&self, tile: usize, frame: u32) {
        if let Some(last) = self.last_used.get(tile) {
            last.store(frame, Ordering::Relaxed);
        }
    }

    /// Returns the bytes of CPU memory of all arrays.
    pub fn size_bytes(&self) -> u64 {
        let of_ground = self.ground().map_or(0, GroundTiles::size_bytes);
        let per_tile = size_of::<TileRecord>() + size_of::<TileBounds>() + TileContents::BYTES_PER_TILE + 4 * 4;
        let of_tiles = self.records.len() * per_tile + of_ground;
        of_tiles as u64 + self.volumes.shared_bytes() + self.contents.shared_bytes()
    }
}

/// Residency and readiness. Update thread.
impl Tiles {
    /// Returns the readiness of the page as a whole: of its top tiles.
    pub fn readiness(&self) -> Readiness {
        self.children_of(NONE).readiness()
    }

    /// Returns the generation of the resident page's id.
    pub fn generation(&self, tile: usize) -> u32 {
        self.contents.generation(tile)
    }

    /// Stores that a page is in the slot of a tile. `is_tile_tree` tells whether that page holds tiles.
    pub fn set_resident(&mut self, tile: usize, page: PageId, is_tile_tree: bool) {
        let record = &mut self.records[tile];
        record.set(flag::FAILED | flag::UNAVAILABLE, false);
        record.set(flag::RESIDENT | if is_tile_tree { flag::EXTERNAL } else { 0 }, true);
        self.contents.set_resident(tile, page.slot, page.generation);
    }

    /// Stores that the slot of a tile is empty.
    pub fn clear_resident(&mut self, tile: usize) {
        self.records[tile].set(flag::RESIDENT | flag::EXTERNAL, false);
        self.contents.clear_resident(tile);
    }

    /// Sets flags of a tile other than those of residency.
    pub(super) fn set_flags(&mut self, tile: usize, flags: u16, is_set: bool) {
        self.records[tile].set(flags, is_set);
    }

    /// Returns true if something is resident below a tile of this page.
    pub fn is_busy(&self, tile: usize) -> bool {
        self.busy_children[tile] > 0
    }

    /// Updates the counts of busy children above a tile that became resident or was emptied. Returns the number of counts
    /// that were changed.
    pub(super) fn spread_busy(&mut self, tile: usize, is_resident: bool) -> u64 {
        let mut touched = 0;
        // A tile that is busy apart from its own slot stays busy.
        let mut changes = self.busy_children[tile] == 0;
        let mut parent = self.parents[tile];
        while changes && parent != NONE {
            let p = parent as usize;
            count(&mut self.busy_children[p], is_resident);
            touched += 1;
            changes = self.busy_children[p] == u32::from(is_resident) && !self.records[p].has(flag::RESIDENT);
            parent = self.parents[p];
        }
        touched
    }

    /// Returns the readiness of a tile with an empty slot, or without one. Children that replace its content can stand in
    /// for it.
    pub fn readiness_without_page(&self, tile: usize) -> Readiness {
        let record = &self.records[tile];
        let failed = if record.has(flag::UNAVAILABLE) { Readiness::Unavailable } else { Readiness::Missing };
        if record.has(flag::PROXY) {
            return if record.has(flag::NEVER) && !record.has(flag::FAILED) { Readiness::Ready } else { failed };
        }
        let has_content = record.has(flag::CONTENT);
        let children_can = !has_content || (record.has(flag::CONTENT_BELOW) && !record.has(flag::ADD));
        match record.not_ready_children {
            0 if children_can => Readiness::Ready,
            _ if has_content => failed,
            _ => self.children_of(tile as u32).readiness(),
        }
    }

    /// Returns the counts of a tile's children, or with `NONE` of the top tiles.
    pub(super) fn children_of(&self, parent: u32) -> ChildCounts {
        let (total, not_ready) = match self.records.get(parent as usize) {
            Some(record) => (record.child_count, record.not_ready_children),
            None => (self.roots.len() as u32, self.not_ready_roots),
        };
        let known = self.rare.as_ref().and_then(|rare| rare.unavailable_children.get(&parent));
        known.copied().unwrap_or(ChildCounts { total, missing: not_ready, unavailable: 0 })
    }

    /// Returns true if some tile below is unavailable, as far as this page knows.
    pub(super) fn has_unavailable_below(&self, tile: u32) -> bool {
        let is_below = |mut parent: u32| {
            while parent != NONE && parent != tile {
                parent = self.parents[parent as usize];
            }
            parent == tile
        };
        let parents = self.rare.iter().flat_map(|rare| rare.unavailable_children.keys());
        parents.copied().any(is_below)
    }

    /// Counts a change of a child (or, with `NONE`, of a top tile).
    pub(super) fn count_child(&mut self, parent: u32, was: Readiness, is: Readiness) {
        let mut counts = self.children_of(parent);
        for (state, up) in [(was, false), (is, true)] {
            match state {
                Readiness::Ready => {}
                Readiness::Missing => count(&mut counts.missing, up),
                Readiness::Unavailable => count(&mut counts.unavailable, up),
            }
        }
        if counts.unavailable > 0 {
            self.rare_mut().unavailable_children.insert(parent, counts);
        } else if let Some(rare) = &mut self.rare {
            rare.unavailable_children.remove(&parent);
        }
        let not_ready = match self.records.get_mut(parent as usize) {
            Some(record) => &mut record.not_ready_children,
            None => &mut self.not_ready_roots,
        };
        *not_ready = counts.not_ready();
    }
}

/// Request volumes.
impl Tiles {
    /// Returns the volume inside which a tile is requested, if it has one.
    fn request_volume(&self, tile: u32) -> Option<&BoundingVolume> {
        self.rare.as_ref()?.request_volumes.get(tile)
    }

    /// Returns the volumes of the roots of the tileset that is or was attached to a tile.
    pub(super) fn external_volumes(&self, tile: u32) -> &[ExternalVolume] {
        let volumes = self.rare.as_ref().and_then(|rare| rare.external_volumes.get(&tile));
        volumes.map_or(&[], Vec::as_slice)
    }

    /// Returns the volumes of a tile and of the tileset attached to it.
    pub(super) fn volumes_of(&self, tile: u32) -> impl Iterator<Item = ExternalVolume> {
        let own = self.request_volume(tile).map(|volume| ExternalVolume::new(*volume));
        own.into_iter().chain(self.external_volumes(tile).iter().copied())
    }

    /// Replaces the volumes of the tileset attached to a tile.
    pub(super) fn set_external_volumes(&mut self, tile: u32, volumes: Vec<ExternalVolume>) {
        let known = &mut self.rare_mut().external_volumes;
        match volumes.is_empty() {
            true => known.remove(&tile),
            false => known.insert(tile, volumes),
        };
    }

    /// Notes for a parent that a child, or the tileset attached to it, is only for eyes inside a volume.
    pub(super) fn note_volume_below(&mut self, parent: u32) {
        if let Some(parent) = self.records.get_mut(parent as usize)
            && parent.flags & (flag::CONTENT | flag::ADD) == flag::CONTENT
        {
            parent.flags |= flag::VOLUMES_BELOW;
        }
    }

    /// Returns true if a tile has no request volume, or the eye is inside it.
    #[inline]
    pub fn may_be_requested(&self, tile: u32, eye: DVec3) -> bool {
        self.request_volume(tile).is_none_or(|volume| volume.contains(eye))
    }

    /// Returns true if children may replace their tile's content: the eye is inside the volumes of all of them, and of
    /// the roots of the tilesets attached to them. From outside of one there would be a hole.
    #[inline(always)]
    pub fn may_be_replaced(&self, record: &TileRecord, eye: DVec3) -> bool {
        !record.has(flag::VOLUMES_BELOW) || self.may_all_be_requested(record.first_child..record.end_of_children(), eye)
    }

    #[cold]
    fn may_all_be_requested(&self, mut tiles: std::ops::Range<u32>, eye: DVec3) -> bool {
        tiles.all(|tile| {
            self.may_be_requested(tile, eye) && self.external_volumes(tile).iter().all(|volume| volume.contains(eye))
        })
    }
}

/// Distances of the eye.
impl Tiles {
    /// Returns the squared distance at which a tile is refined, and the squared distance of the eye; square metres of the
    /// tile frame.
    #[inline(always)]
    pub fn range_and_distance(
        &self,
        tile: u32,
        record: &TileRecord,
        bounds: &TileBounds,
        eye: &TileEye,
        ranges: &LodRanges,
    ) -> (f32, f32) {
        if record.has(flag::DISTANCE) {
            return self.range_and_distance_to_center(tile, record, bounds, eye, ranges);
        }
        let offset = eye.offset_to(bounds);
        let distance2 =
            if bounds.is_along_frame() { outside2(offset, bounds) } else { self.distance2_to(bounds, offset) };
        let range = bounds.metric_m() * ranges.per_error;
        (range * range, distance2.max(ranges.min_distance2))
    }

    #[inline(never)]
    fn range_and_distance_to_center(
        &self,
        tile: u32,
        record: &TileRecord,
        bounds: &TileBounds,
        eye: &TileEye,
        ranges: &LodRanges,
    ) -> (f32, f32) {
        let distance = self.distance_center(tile).distance(eye.position) as f32;
        if record.has(flag::PIXEL_SIZE) {
            let range = bounds.metric_m() * ranges.per_pixel;
            return (range * range, (distance * distance).max(ranges.min_distance2));
        }
        let range = bounds.metric_m() * ranges.per_metre;
        (range * range, distance * distance)
    }

    /// Returns the squared distance to a sphere, or to a box that is not along the frame's axes.
    #[inline(never)]
    fn distance2_to(&self, bounds: &TileBounds, offset: Vec4) -> f32 {
        if bounds.is_sphere() {
            let outside = (offset.truncate().length() - bounds.radius_m()).max(0.0);
            return outside * outside;
        }
        let [x, y, z] = self.axes_of(bounds).map(|axis| offset.truncate().dot(Vec3::from_array(axis)));
        outside2(Vec4::new(x, y, z, 0.0), bounds)
    }

    /// Returns the point from which the range of a tile with [`flag::DISTANCE`] is measured.
    pub fn distance_center(&self, tile: u32) -> DVec3 {
        self.rare.as_ref().and_then(|rare| rare.distance_centers.get(tile)).copied().unwrap_or_default()
    }
}

/// The order of tiles. Decode workers, while the page is built.
impl Tiles {
    /// Lays siblings side by side, for tiles that were pushed depth-first. Every tree keeps its range. Returns the new
    /// index of each tile.
    pub(super) fn lay_siblings_together(&mut self) -> Vec<u32> {
        let count = self.len();
        for parent in self.parents.iter().filter(|p| **p != NONE) {
            self.records[*parent as usize].child_count += 1;
        }
        // The new index of the next child of each tile.
        let mut next_child = vec![0_u32; count];
        let mut new_index = Vec::with_capacity(count);
        let mut free = 0;
        for (tile, parent) in self.parents.iter().enumerate() {
            let index = if *parent == NONE { &mut free } else { &mut next_child[*parent as usize] };
            new_index.push(*index);
            *index += 1;
            let record = &mut self.records[tile];
            (record.first_child, next_child[tile]) = (free, free);
            free += record.child_count;
        }
        for parent in self.parents.iter_mut().filter(|p| **p != NONE) {
            *parent = new_index[*parent as usize];
        }
        let mut order = vec![0_u32; count];
        for (tile, index) in new_index.iter().enumerate() {
            order[*index as usize] = tile as u32;
        }
        self.records = taken(&self.records, &order);
        self.contents.reorder(&order);
        self.volumes.reorder(&order);
        self.parents = taken(&self.parents, &order);
        self.nodes = taken(&self.nodes, &order);
        if let Some(rare) = &mut self.rare {
            rare.renumber(&new_index);
        }
        new_index
    }
}

/// Counts up or down.
fn count(counter: &mut u32, up: bool) {
    if up {
        *counter += 1;
    } else {
        *counter -= 1;
    }
}

/// Returns the squared distance to a box of a point, given its offset from the box's centre along the box's axes; 0 inside.
#[inline(always)]
fn outside2(along: Vec4, bounds: &TileBounds) -> f32 {
    let outside = along.abs() - bounds.extent();
    // The fourth component, which is no length, is negative here.
    outside.max(Vec4::ZERO).length_squared()
}
