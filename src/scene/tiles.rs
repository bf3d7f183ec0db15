//! The tile trees of a page: bounds, content slots and readiness, as flat arrays.
//!
//! The children of a tile follow each other, and then comes what is below the first of them: a walk that turns back at
//! some level meets tiles that lie side by side, of which a line of the cache holds several.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicU32;

use glam::{DAffine3, DVec3, Vec3, Vec4};

use super::external_volumes::ExternalVolume;
use super::lod_ranges::LodRanges;
use super::node::{PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, Refine};
use super::page::NONE;
use super::tile_bounds::{ALONG_FRAME, BoxAxes, DeclaredBounds, TileBounds, TileEye, TileGrid};
use crate::math::{BoundingSphere, BoundingVolume, OrientedBox};

/// Flags of a [`TileRecord`].
pub(crate) mod flag {
    pub const CONTENT: u16 = 1;
    pub const PROXY: u16 = 2;
    pub const ADD: u16 = 4;
    /// [`super::RangeMode::PixelSize`], with the flag of a distance: the metric is metres for each pixel.
    pub const PIXEL_SIZE: u16 = 8;
    /// [`super::RangeMode::Distance`]: the distance is to `center` of a separate table.
    pub const DISTANCE: u16 = 16;
    /// A proxy that is loaded only when the application asks.
    pub const NEVER: u16 = 32;
    pub const RESIDENT: u16 = 64;
    pub const FAILED: u16 = 128;
    /// The resident page is a tile tree itself.
    pub const EXTERNAL: u16 = 256;
    /// Only for eyes inside a volume of a separate table.
    pub const REQUEST_VOLUME: u16 = 512;
    /// Another state path than that of the tree's top tile, in a separate table.
    pub const OWN_PATH: u16 = 1024;
    /// Something that takes its place has failed: it is not skipped any more.
    pub const FAILED_BELOW: u16 = 2048;
    /// There is content below it, as far as the page tells.
    pub const CONTENT_BELOW: u16 = 4096;
    /// Some of the children that replace its content, or of the tilesets that hung in them, are only for eyes inside
    /// volumes.
    pub const VOLUMES_BELOW: u16 = 8192;
}

/// What the tile walk reads of every tile it meets, 16 bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileRecord {
    /// The first child tile; the others follow it.
    pub first_child: u32,
    pub child_count: u32,
    /// Child tiles that are not ready; 0 means the children can replace the tile.
    pub not_ready_children: u32,
    pub flags: u16,
    /// Depth below the page's top tiles.
    pub depth: u16,
}

/// What a visit of a tile's content reads.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileContent {
    /// Place of the resident page in the scene's table, or `NONE`.
    pub resident: u32,
    /// Index into [`Tiles::content_transforms`].
    transform: u32,
}

impl TileRecord {
    pub fn has(&self, flags: u16) -> bool {
        self.flags & flags != 0
    }

    pub fn has_children(&self) -> bool {
        self.child_count != 0
    }

    /// The tile behind the last child.
    pub fn end_of_children(&self) -> u32 {
        self.first_child + self.child_count
    }

    pub fn has_slot(&self) -> bool {
        self.has(flag::CONTENT | flag::PROXY)
    }
}

/// Tiles of a page.
#[derive(Debug, Default)]
pub(crate) struct Tiles {
    pub records: Vec<TileRecord>,
    pub bounds: Vec<TileBounds>,
    /// What the bounds are counted by.
    pub grid: TileGrid,
    pub contents: Vec<TileContent>,
    /// Axes of boxes, each once in a row; empty without tiles.
    pub axes: Vec<BoxAxes>,
    /// Frame in which the tile was last wanted, or will be; stored by cull through a shared reference (relaxed: a
    /// stamp carries no other data), read by update. Not in the records, which culls at the same time would take from
    /// each other's cores.
    pub last_used: Vec<AtomicU32>,
    pub parents: Vec<u32>,
    /// Child tiles that are resident or hold something resident below them.
    pub busy_children: Vec<u32>,
    /// Page id of the resident page's generation.
    pub resident_generation: Vec<u32>,
    pub nodes: Vec<u32>,
    pub content_transforms: Vec<DAffine3>,
    pub uris: Vec<Option<Arc<str>>>,
    pub reader_data: Vec<Option<Arc<str>>>,
    rare: Option<Box<RareTiles>>,
    pub roots: Vec<TileRoot>,
    /// Top tiles that are not ready.
    pub not_ready_roots: u32,
    text_bytes: u64,
}

/// What few pages have; each by tile, in their order.
#[derive(Debug, Default)]
struct RareTiles {
    /// Centres of tiles with `RangeMode::Distance`.
    distance_centers: Vec<(u32, DVec3)>,
    /// Of tiles with [`flag::REQUEST_VOLUME`].
    request_volumes: Vec<(u32, BoundingVolume)>,
    /// Of tilesets that hang in tiles, or did; by tile.
    external_volumes: BTreeMap<u32, Vec<ExternalVolume>>,
    /// Of tiles with [`flag::OWN_PATH`].
    own_paths: Vec<(u32, u32)>,
    /// Where they are not the default.
    paging: Vec<(u32, PagingOptions)>,
    /// Nodes of proxies that are loaded at once.
    immediate: Vec<u32>,
}

/// A tile tree inside a page.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileRoot {
    pub tile: u32,
    pub transform: u32,
    /// The page's state path above the tile.
    pub state_path: u32,
}

impl Tiles {
    pub fn len(&self) -> usize {
        self.records.len()
    }

    fn rare_mut(&mut self) -> &mut RareTiles {
        self.rare.get_or_insert_default()
    }

    /// Of what few pages have, a part.
    fn rare<T>(&self, part: impl Fn(&RareTiles) -> &Vec<T>) -> &[T] {
        self.rare.as_deref().map_or(&[], |rare| part(rare))
    }

    /// Some tile is only for eyes inside a volume.
    pub fn has_request_volumes(&self) -> bool {
        !self.rare(|rare| &rare.request_volumes).is_empty()
    }

    /// Nodes of proxies that are loaded at once.
    pub fn immediate(&self) -> &[u32] {
        self.rare(|rare| &rare.immediate)
    }

    /// Takes up a tile; its declared bounds, which come on the page's grid once all are known, and the sphere around them.
    pub(super) fn push_paged_lod(
        &mut self,
        parent: u32,
        node: u32,
        state_path: u32,
        tile: PagedLod,
    ) -> (DeclaredBounds, BoundingSphere) {
        let mut flags = 0;
        if tile.content.is_some() {
            flags |= flag::CONTENT;
        }
        if tile.refine == Refine::Add {
            flags |= flag::ADD;
        }
        let metric = match tile.range_mode {
            RangeMode::ScreenSpaceError { geometric_error_m } => geometric_error_m,
            RangeMode::Distance { center, range_m } => {
                flags |= flag::DISTANCE;
                let center = if center.is_finite() { center } else { DVec3::ZERO };
                let tile = self.records.len() as u32;
                self.rare_mut().distance_centers.push((tile, center));
                range_m
            }
            RangeMode::PixelSize { center, radius_m, size_px } => {
                flags |= flag::DISTANCE | flag::PIXEL_SIZE;
                let center = if center.is_finite() { center } else { DVec3::ZERO };
                let tile = self.records.len() as u32;
                self.rare_mut().distance_centers.push((tile, center));
                if size_px > 0.0 { 2.0 * radius_m / size_px } else { f64::MAX }
            }
        };
        if let Some(volume) = tile.request_volume {
            flags |= flag::REQUEST_VOLUME;
            let tile = self.records.len() as u32;
            self.rare_mut().request_volumes.push((tile, volume));
        }
        if tile.paging != PagingOptions::default() {
            let number = self.records.len() as u32;
            self.rare_mut().paging.push((number, tile.paging));
        }
        let sphere = tile.bounds.bounding_sphere();
        let oriented_box = tile.bounds.oriented_box();
        let bounds = self.declare(&sphere, oriented_box.as_ref(), metric);
        self.push(parent, node, state_path, flags, tile.content_transform, tile.content, tile.reader_data);
        (bounds, sphere)
    }

    /// The same of a proxy.
    pub(super) fn push_proxy(
        &mut self,
        parent: u32,
        node: u32,
        state_path: u32,
        proxy: ProxyNode,
    ) -> (DeclaredBounds, BoundingSphere) {
        let mut flags = flag::PROXY | flag::ADD;
        match proxy.loading {
            ProxyLoading::DeferToPager => {}
            ProxyLoading::Never => flags |= flag::NEVER,
            ProxyLoading::Immediately => {
                self.rare_mut().immediate.push(node);
                let stays = PagingOptions { cannot_expire: true, ..PagingOptions::default() };
                let tile = self.records.len() as u32;
                self.rare_mut().paging.push((tile, stays));
            }
        }
        let bounds = self.declare(&proxy.bounds, None, 0.0);
        let sphere = proxy.bounds;
        self.push(parent, node, state_path, flags, proxy.content_transform, Some(proxy.uri), None);
        (bounds, sphere)
    }

    #[allow(clippy::too_many_arguments, reason = "one row of the tables; called from the two functions above")]
    fn push(
        &mut self,
        parent: u32,
        node: u32,
        state_path: u32,
        mut flags: u16,
        content_transform: DAffine3,
        uri: Option<Arc<str>>,
        reader_data: Option<Arc<str>>,
    ) {
        // Of the tree that is being pushed; a top tile comes before its root.
        if parent != NONE && self.roots.last().is_some_and(|root| root.state_path != state_path) {
            flags |= flag::OWN_PATH;
            let tile = self.records.len() as u32;
            self.rare_mut().own_paths.push((tile, state_path));
        }
        let depth = if parent == NONE { 0 } else { self.records[parent as usize].depth.saturating_add(1) };
        let transform = if content_transform.is_finite() { content_transform } else { DAffine3::IDENTITY };
        if self.content_transforms.last() != Some(&transform) {
            self.content_transforms.push(transform);
        }
        self.records.push(TileRecord { first_child: 0, child_count: 0, not_ready_children: 0, flags, depth });
        let transform = self.content_transforms.len() as u32 - 1;
        self.contents.push(TileContent { resident: NONE, transform });
        self.last_used.push(AtomicU32::new(0));
        self.parents.push(parent);
        self.busy_children.push(0);
        self.resident_generation.push(0);
        self.nodes.push(node);
        self.text_bytes +=
            uri.as_ref().map_or(0, |u| u.len() as u64) + reader_data.as_ref().map_or(0, |d| d.len() as u64);
        self.uris.push(uri);
        self.reader_data.push(reader_data);
    }

    fn declare(
        &mut self,
        sphere: &BoundingSphere,
        oriented_box: Option<&OrientedBox>,
        metric_m: f64,
    ) -> DeclaredBounds {
        DeclaredBounds::new(sphere, oriented_box, metric_m, |axes| self.index_of(axes))
    }

    /// The index of a box's axes; those of the tile before and of the frame are found again.
    fn index_of(&mut self, axes: BoxAxes) -> u32 {
        if self.axes.is_empty() {
            self.axes.push(ALONG_FRAME);
        }
        // A box has no direction along an axis.
        if axes.iter().zip(&ALONG_FRAME).all(|(axis, own)| axis.map(f32::abs) == *own) {
            return 0;
        }
        if self.axes.last() != Some(&axes) {
            self.axes.push(axes);
        }
        self.axes.len() as u32 - 1
    }

    /// The tile that follows everything below `tile` in the walk of a tree, or `NONE`.
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

    /// The axes of a tile's box.
    #[inline(always)]
    pub fn axes_of(&self, bounds: &TileBounds) -> &BoxAxes {
        self.axes.get(bounds.axes()).unwrap_or(&ALONG_FRAME)
    }

    /// Lays siblings side by side; tiles were pushed depth-first, with these bounds. Every tree keeps its range. The new
    /// places of tiles by their old ones.
    pub(super) fn lay_siblings_together(&mut self, declared: &[DeclaredBounds]) -> Vec<u32> {
        let count = self.len();
        for parent in self.parents.iter().filter(|p| **p != NONE) {
            self.records[*parent as usize].child_count += 1;
        }
        // Where the next child of a tile goes, by the tile's old place.
        let mut next_child = vec![0_u32; count];
        let mut places = Vec::with_capacity(count);
        let mut free = 0;
        for (tile, parent) in self.parents.iter().enumerate() {
            let place = if *parent == NONE { &mut free } else { &mut next_child[*parent as usize] };
            places.push(*place);
            *place += 1;
            let record = &mut self.records[tile];
            (record.first_child, next_child[tile]) = (free, free);
            free += record.child_count;
        }
        for parent in self.parents.iter_mut().filter(|p| **p != NONE) {
            *parent = places[*parent as usize];
        }
        let mut order = vec![0_u32; count];
        for (tile, place) in places.iter().enumerate() {
            order[*place as usize] = tile as u32;
        }
        self.records = taken(&self.records, &order);
        self.contents = taken(&self.contents, &order);
        self.grid = TileGrid::around(declared);
        self.bounds = order.iter().map(|tile| self.grid.fit(&declared[*tile as usize])).collect();
        self.parents = taken(&self.parents, &order);
        self.nodes = taken(&self.nodes, &order);
        self.uris = taken(&self.uris, &order);
        self.reader_data = taken(&self.reader_data, &order);
        if let Some(rare) = &mut self.rare {
            let RareTiles { distance_centers, request_volumes, own_paths, paging, .. } = &mut **rare;
            let place_of = |tile: &mut u32| *tile = places[*tile as usize];
            distance_centers.iter_mut().for_each(|(tile, _)| place_of(tile));
            distance_centers.sort_unstable_by_key(|(tile, _)| *tile);
            request_volumes.iter_mut().for_each(|(tile, _)| place_of(tile));
            request_volumes.sort_unstable_by_key(|(tile, _)| *tile);
            own_paths.iter_mut().for_each(|(tile, _)| place_of(tile));
            own_paths.sort_unstable_by_key(|(tile, _)| *tile);
            paging.iter_mut().for_each(|(tile, _)| place_of(tile));
            paging.sort_unstable_by_key(|(tile, _)| *tile);
        }
        places
    }

    /// Counts what is not ready, leaves first. Called once, when nothing is resident.
    pub fn count_readiness(&mut self) {
        for i in (0..self.records.len()).rev() {
            let record = self.records[i];
            let has_content = record.has(flag::CONTENT | flag::PROXY) && !record.has(flag::NEVER);
            if has_content || record.has(flag::CONTENT_BELOW) {
                match self.parents[i] {
                    NONE => {}
                    parent => self.records[parent as usize].flags |= flag::CONTENT_BELOW,
                }
            }
            if record.has(flag::REQUEST_VOLUME) {
                self.note_volume_below(self.parents[i]);
            }
            if !self.is_ready_without_page(i) {
                match self.parents[i] {
                    NONE => self.not_ready_roots += 1,
                    parent => self.records[parent as usize].not_ready_children += 1,
                }
            }
        }
    }

    /// Readiness of a tile whose slot is empty, or that has none. What its children replace, they can stand for.
    pub fn is_ready_without_page(&self, tile: usize) -> bool {
        let record = &self.records[tile];
        if record.has(flag::PROXY) {
            return record.has(flag::NEVER) && !record.has(flag::FAILED);
        }
        let children_can = !record.has(flag::CONTENT) || (record.has(flag::CONTENT_BELOW) && !record.has(flag::ADD));
        children_can && record.not_ready_children == 0
    }

    /// Maps a tile's content to the tile's frame.
    pub fn content_transform(&self, tile: usize) -> DAffine3 {
        let place = self.contents.get(tile).map(|content| content.transform as usize);
        place.and_then(|place| self.content_transforms.get(place)).copied().unwrap_or_default()
    }

    /// The tree that a tile is in.
    pub fn root_of(&self, tile: u32) -> Option<&TileRoot> {
        let behind = self.roots.partition_point(|root| root.tile <= tile);
        self.roots.get(behind.checked_sub(1)?)
    }

    /// The page's state path above a tile of a tree.
    pub fn state_path(&self, tile: u32, root: &TileRoot) -> u32 {
        found(self.rare(|rare| &rare.own_paths), tile).map_or(root.state_path, |path| *path)
    }

    /// How the pager treats a tile.
    pub fn paging_of(&self, tile: u32) -> PagingOptions {
        found(self.rare(|rare| &rare.paging), tile).copied().unwrap_or_default()
    }

    /// The volume in which a tile is asked for, if it has one.
    pub(super) fn request_volume(&self, tile: u32) -> Option<&BoundingVolume> {
        found(self.rare(|rare| &rare.request_volumes), tile)
    }

    /// The volumes of the roots of what hangs in a tile, or did last.
    pub(super) fn external_volumes(&self, tile: u32) -> &[ExternalVolume] {
        let volumes = self.rare.as_deref().and_then(|rare| rare.external_volumes.get(&tile));
        volumes.map_or(&[], Vec::as_slice)
    }

    pub(super) fn set_external_volumes(&mut self, tile: u32, volumes: Vec<ExternalVolume>) {
        let known = &mut self.rare_mut().external_volumes;
        match volumes.is_empty() {
            true => known.remove(&tile),
            false => known.insert(tile, volumes),
        };
    }

    /// A child of a tile is only for eyes inside a volume, or what hangs in the child.
    pub(super) fn note_volume_below(&mut self, parent: u32) {
        if let Some(parent) = self.records.get_mut(parent as usize)
            && parent.flags & (flag::CONTENT | flag::ADD) == flag::CONTENT
        {
            parent.flags |= flag::VOLUMES_BELOW;
        }
    }

    /// True when a tile has no request volume, or the eye is in it.
    pub fn may_be_requested(&self, tile: u32, eye: DVec3) -> bool {
        self.request_volume(tile).is_none_or(|volume| volume.contains(eye))
    }

    /// True when children may replace their tile's content: the eye is in the volumes of all of them, and of the roots of
    /// the tilesets in them. From outside of one there would be a hole.
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

    /// Squared distance at which a tile wants its children, and squared distance now; metres of the tile frame.
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
        (range * range, distance2.max(ranges.least_distance2))
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
            return (range * range, (distance * distance).max(ranges.least_distance2));
        }
        let range = bounds.metric_m() * ranges.per_metre;
        (range * range, distance * distance)
    }

    /// Squared distance to a sphere, or to a box that is turned.
    #[inline(never)]
    fn distance2_to(&self, bounds: &TileBounds, offset: Vec4) -> f32 {
        if bounds.is_sphere() {
            let outside = (offset.truncate().length() - bounds.radius_m()).max(0.0);
            return outside * outside;
        }
        let [x, y, z] = self.axes_of(bounds).map(|axis| offset.truncate().dot(Vec3::from_array(axis)));
        outside2(Vec4::new(x, y, z, 0.0), bounds)
    }

    pub fn distance_center(&self, tile: u32) -> DVec3 {
        found(self.rare(|rare| &rare.distance_centers), tile).copied().unwrap_or_default()
    }

    pub fn size_bytes(&self) -> u64 {
        let row = size_of::<TileRecord>()
            + size_of::<TileContent>()
            + size_of::<TileBounds>()
            + 5 * 4
            + 2 * size_of::<Option<Arc<str>>>();
        let shared = self.content_transforms.len() * size_of::<DAffine3>() + self.axes.len() * size_of::<BoxAxes>();
        (self.records.len() * row + shared) as u64 + self.text_bytes
    }
}

/// What a list in the order of tiles has for one.
fn found<T>(list: &[(u32, T)], tile: u32) -> Option<&T> {
    let place = list.binary_search_by_key(&tile, |(of, _)| *of).ok()?;
    list.get(place).map(|(_, found)| found)
}

/// The elements in another order.
fn taken<T: Clone>(elements: &[T], order: &[u32]) -> Vec<T> {
    order.iter().map(|place| elements[*place as usize].clone()).collect()
}

/// Squared distance to a box from a point that is so far from its centre along each of its axes, and 0 behind.
#[inline(always)]
fn outside2(along: Vec4, bounds: &TileBounds) -> f32 {
    let outside = along.abs() - bounds.extent();
    // What lies behind is less than nothing.
    outside.max(Vec4::ZERO).length_squared()
}
