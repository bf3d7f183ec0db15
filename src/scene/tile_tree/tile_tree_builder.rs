//! Builds the tile trees of a page from tiles that arrive depth-first. Decode workers (any thread).

use std::sync::Arc;
use std::sync::atomic::AtomicU32;

use glam::{DAffine3, DVec3};

use super::content_volume::ContentVolume;
use super::ground_tiles::{GroundTile, GroundTiles};
use super::readiness::Readiness;
use super::tile_bounds::DeclaredBounds;
use super::tile_record::{TileRecord, flag};
use super::tiles::{TileRoot, Tiles};
use crate::math::{BoundingSphere, BoundingVolume, OrientedBox};
use crate::scene::id::NONE;
use crate::scene::nodes::{PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, ReaderData, Refine};

/// Tiles in the order in which they were added. Their bounds come onto the page's grid when all are known.
#[derive(Debug, Default)]
pub(crate) struct TileTreeBuilder {
    tiles: Tiles,
    declared: Vec<DeclaredBounds>,
    ground: Vec<GroundTile>,
}

/// The position of a tile in the graph of its page.
struct TilePosition {
    /// The tile above, `NONE` for a top tile.
    parent: u32,
    node: u32,
    transform: u32,
    state_path: u32,
}

/// How the content of a tile is loaded and placed.
struct Content {
    uri: Option<Arc<str>>,
    reader_data: Option<ReaderData>,
    tile_from_content: DAffine3,
}

impl TileTreeBuilder {
    /// Adds a tile and returns its index.
    pub fn push_paged_lod(&mut self, parent: u32, node: u32, transform: u32, state_path: u32, tile: PagedLod) -> u32 {
        let index = self.tiles.len() as u32;
        let mut flags = 0;
        if tile.content.is_some() {
            flags |= flag::CONTENT;
        }
        if tile.refine == Refine::Add {
            flags |= flag::ADD;
        }
        let metric_m = match tile.range_mode {
            RangeMode::ScreenSpaceError { geometric_error_m } => geometric_error_m,
            RangeMode::Distance { center, range_m } => {
                flags |= flag::DISTANCE;
                self.push_distance_center(index, center);
                range_m
            }
            RangeMode::PixelSize { center, radius_m, size_px } => {
                flags |= flag::DISTANCE | flag::PIXEL_SIZE;
                self.push_distance_center(index, center);
                if size_px > 0.0 { 2.0 * radius_m / size_px } else { f64::MAX }
            }
        };
        if let Some(volume) = tile.request_volume {
            flags |= flag::REQUEST_VOLUME;
            self.tiles.rare_mut().request_volumes.push(index, volume);
        }
        if let Some(volume) = tile.reader_data.as_ref().and_then(ReaderData::content_bounds) {
            flags |= flag::CONTENT_VOLUME;
            self.tiles.rare_mut().content_volumes.push(index, ContentVolume::new(volume));
        }
        if let (true, BoundingVolume::Region(region)) =
            (tile.reader_data.as_ref().is_some_and(ReaderData::is_ground_of_globe), &tile.bounds)
        {
            self.ground.push(GroundTile { tile: index, region: *region });
        }
        if tile.paging != PagingOptions::default() {
            self.tiles.rare_mut().paging.push(index, tile.paging);
        }
        // The box around a region is expensive.
        let oriented_box = tile.bounds.oriented_box();
        let sphere = oriented_box.map_or_else(|| tile.bounds.bounding_sphere(), |b| b.bounding_sphere());
        self.declare(&sphere, oriented_box.as_ref(), metric_m);
        let at = TilePosition { parent, node, transform, state_path };
        let content =
            Content { uri: tile.content, reader_data: tile.reader_data, tile_from_content: tile.content_transform };
        self.push(at, flags, content, sphere)
    }

    /// Adds a proxy and returns its index.
    pub fn push_proxy(&mut self, parent: u32, node: u32, transform: u32, state_path: u32, proxy: ProxyNode) -> u32 {
        let index = self.tiles.len() as u32;
        let mut flags = flag::PROXY | flag::ADD;
        match proxy.loading {
            ProxyLoading::DeferToPager => {}
            ProxyLoading::Never => flags |= flag::NEVER,
            ProxyLoading::Immediately => {
                let rare = self.tiles.rare_mut();
                rare.immediate.push(node);
                rare.paging.push(index, PagingOptions { cannot_expire: true, ..PagingOptions::default() });
            }
        }
        self.declare(&proxy.bounds, None, 0.0);
        let at = TilePosition { parent, node, transform, state_path };
        let content = Content { uri: Some(proxy.uri), reader_data: None, tile_from_content: proxy.content_transform };
        self.push(at, flags, content, proxy.bounds)
    }

    fn push_distance_center(&mut self, tile: u32, center: DVec3) {
        let center = if center.is_finite() { center } else { DVec3::ZERO };
        self.tiles.rare_mut().distance_centers.push(tile, center);
    }

    fn declare(&mut self, sphere: &BoundingSphere, oriented_box: Option<&OrientedBox>, metric_m: f64) {
        let volumes = &mut self.tiles.volumes;
        self.declared.push(DeclaredBounds::new(sphere, oriented_box, metric_m, |axes| volumes.index_of_axes(axes)));
    }

    fn push(&mut self, at: TilePosition, mut flags: u16, content: Content, sphere: BoundingSphere) -> u32 {
        let tiles = &mut self.tiles;
        let index = tiles.len() as u32;
        let TilePosition { parent, node, transform, state_path } = at;
        let depth = if parent == NONE {
            tiles.roots.push(TileRoot { tile: index, transform, state_path });
            tiles.root_spheres.push(sphere);
            0
        } else {
            // The last root is that of the tree which is being pushed.
            if tiles.roots.last().is_some_and(|root| root.state_path != state_path) {
                flags |= flag::OWN_PATH;
                tiles.rare_mut().own_paths.push(index, state_path);
            }
            tiles.records[parent as usize].depth.saturating_add(1)
        };
        tiles.records.push(TileRecord { first_child: 0, child_count: 0, not_ready_children: 0, flags, depth });
        tiles.contents.push(content.tile_from_content, content.uri, content.reader_data);
        tiles.last_used.push(AtomicU32::new(0));
        tiles.parents.push(parent);
        tiles.busy_children.push(0);
        tiles.nodes.push(node);
        index
    }

    /// Finishes the trees: order of the tiles, bounds and readiness. Returns the new index of each tile.
    pub fn finish(mut self) -> (Tiles, Vec<u32>) {
        self.tiles.volumes.fit(&self.declared);
        let new_index = self.tiles.lay_siblings_together();
        if !self.ground.is_empty() {
            self.tiles.ground = Some(Box::new(GroundTiles::new(&self.ground, &new_index)));
        }
        count_readiness(&mut self.tiles);
        (self.tiles, new_index)
    }
}

/// Counts the tiles that are not ready, leaves first. All slots are empty.
fn count_readiness(tiles: &mut Tiles) {
    for tile in (0..tiles.len()).rev() {
        let (record, parent) = (tiles.records[tile], tiles.parents[tile]);
        let has_content = record.has(flag::CONTENT | flag::PROXY) && !record.has(flag::NEVER);
        if (has_content || record.has(flag::CONTENT_BELOW)) && parent != NONE {
            tiles.set_flags(parent as usize, flag::CONTENT_BELOW, true);
        }
        if record.has(flag::REQUEST_VOLUME) {
            tiles.note_volume_below(parent);
        }
        tiles.count_child(parent, Readiness::Ready, tiles.readiness_without_page(tile));
    }
}
