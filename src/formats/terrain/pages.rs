//! Parts of a terrain tree as pages of tiles. Decode threads.
//!
//! A page begins with a tile and has the levels below it. It is made from the file of that tile if more must be known: the
//! tiles below if the file names them, or their heights if those of the page above are too rough for tiles of this size. One
//! fetch serves both: the mesh of the tile is a content in memory. Other pages are made at once, so that all tiles down to
//! the next file are requested together. A tile has all four children or none. Where no layer has a child, it is cut out of
//! the mesh of the page's first tile; so a tile with such a child begins a page with its file.

use std::sync::Arc;

use glam::DAffine3;
use serde::Deserialize;

use super::availability::{Availability, RangeJson};
use super::quantized;
use super::set::TerrainSet;
use super::tile::{HeldMesh, TerrainTile, TileMesh, unpacked};
use crate::fetch::IoError;
use crate::formats::ignored::Notes;
use crate::formats::implicit::TileCoordinates;
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::tile::{ALWAYS_REFINED_M, Continuation, Tile, TileContent};
use crate::math::BoundingVolume;
use crate::scene::{ReaderData, ReaderValue, Refine};

/// A page begins at each level that this number divides. Five levels are up to 341 tiles.
const PAGE_LEVELS: u32 = 5;
/// The finest level of the ellipsoid. Its tiles are 5 m high.
const MAX_ELLIPSOID_LEVEL: u32 = 22;
/// Heights are known well enough for a level if their range is at most this multiple of the level's error. A tile is refined
/// at some 470 times its error (2 pixels, 60 degrees over 1080 rows), which the range makes uncertain.
const MAX_ROUGHNESS: f64 = 150.0;

/// A page that is not made yet. The reader data of a tile whose content it is.
#[derive(Clone, Debug)]
pub(in crate::formats) struct TerrainPage {
    set: Arc<TerrainSet>,
    /// The first tile.
    tile: TileCoordinates,
    /// The tiles that are known to exist, that tile and those below it, for each layer.
    known: Arc<[Availability]>,
    /// The nearest mesh above, for tiles that no layer has.
    above: TileMesh,
    heights_m: [f64; 2],
    /// The layer that the file of the first tile is fetched from; `None` if the page is made without it.
    file_layer: Option<usize>,
}

/// The extension `metadata` of a tile.
#[derive(Deserialize)]
struct MetadataJson {
    available: Option<Vec<Vec<RangeJson>>>,
}

impl TerrainPage {
    /// Returns the page of a root tile.
    pub(super) fn root(set: Arc<TerrainSet>, tile: TileCoordinates, known: Arc<[Availability]>) -> Self {
        let heights_m = if set.layers.is_empty() { [0.0; 2] } else { set.ellipsoid.ground_m() };
        Self::new(set, tile, known, TileMesh::Ellipsoid, heights_m)
    }

    fn new(
        set: Arc<TerrainSet>,
        tile: TileCoordinates,
        known: Arc<[Availability]>,
        above: TileMesh,
        heights_m: [f64; 2],
    ) -> Self {
        let [low, high] = heights_m;
        let needs_file = high - low > MAX_ROUGHNESS * set.level_error_m(tile.level)
            || set.layers_with_metadata(&known, tile).next().is_some()
            || (known.iter().any(|layer| layer.has_below(tile)) && TerrainSet::lacks_child(&known, tile));
        let file_layer = TerrainSet::layer_of(&known, tile).filter(|_| needs_file);
        Self { set, tile, known, above, heights_m, file_layer }
    }

    /// Returns true if there is nothing but the ellipsoid in the page and below.
    pub fn is_ellipsoid(&self) -> bool {
        matches!(self.above, TileMesh::Ellipsoid)
            && TerrainSet::layer_of(&self.known, self.tile).is_none()
            && !self.known.iter().any(|layer| layer.has_below(self.tile))
    }

    /// Returns the root tile above the page: a part of the ellipsoid that the page replaces. Where there is nothing but the
    /// ellipsoid, the tile stands for the page.
    pub(super) fn into_root(self) -> Tile {
        let bounds = bounds(&self.set, self.tile, self.heights_m);
        let mut geometric_error_m = self.set.geometric_error_m(self.tile);
        let (mut contents, mut continuations) = (Vec::new(), Vec::new());
        if self.is_ellipsoid() {
            contents.push(self.content());
        } else {
            geometric_error_m = ALWAYS_REFINED_M;
            contents.push(TerrainTile::new(self.set.clone(), self.tile, TileMesh::Ellipsoid).content(None));
            continuations.push(Continuation { bounds, content: self.content() });
        }
        Tile {
            bounds,
            request_volume: None,
            refine: Refine::Replace,
            geometric_error_m,
            content_transform: DAffine3::IDENTITY,
            contents,
            external_tilesets: Vec::new(),
            continuations,
            metadata: None,
            children: Vec::new(),
        }
    }

    fn content(self) -> TileContent {
        let TileCoordinates { level, x, y, .. } = self.tile;
        let uri = match self.file_layer {
            Some(layer) => self.set.layers[layer].tile_uri(self.tile).0,
            // Only a name: nothing is fetched.
            None => format!("{}#page-{level}/{x}/{y}", self.set.uri).into(),
        };
        TileContent::new(uri, Some(ReaderData::of(self)))
    }

    /// Returns the files of the first tile in further layers, which name the tiles below it too.
    pub fn companions(&self) -> Vec<Arc<str>> {
        let own = self.file_layer;
        let others = self.set.layers_with_metadata(&self.known, self.tile).filter(|layer| Some(*layer) != own);
        others.map(|layer| self.set.layers[layer].tile_uri(self.tile).0).collect()
    }

    /// Returns the tiles of the page: its first one with the levels below it.
    pub fn read(
        &self,
        uri: &Arc<str>,
        bytes: Vec<u8>,
        companions: &[Fetched],
        options: &ReadOptions,
    ) -> Result<Vec<Tile>, IoError> {
        let notes = Notes::default();
        let mut reader = PageReader { page: self, mesh: self.above.clone(), heights_m: self.heights_m };
        let mut known = self.known.to_vec();
        if let Some(own) = self.file_layer {
            let bytes = unpacked(uri, bytes, options)?;
            let [low, high] = quantized::header_heights_m(&bytes).map_err(|reason| IoError::invalid(uri, reason))?;
            let error_m = self.set.level_error_m(self.tile.level);
            // The tiles below are finer, and may be higher or lower by the error of this one.
            let [lowest, highest] = self.set.ellipsoid.ground_m();
            reader.heights_m = [(low - error_m).max(lowest).min(low), (high + error_m).min(highest).max(high)];
            for layer in self.set.layers_with_metadata(&self.known, self.tile) {
                let file = self.set.layers[layer].tile_uri(self.tile).0;
                let other = || {
                    let found = companions.iter().find(|(fetched, _)| *fetched == file);
                    found.map_or_else(|| Err(IoError::NotFound { uri: file.to_string() }), |(_, read)| read.clone())
                };
                let below = if layer == own {
                    self.named_below(uri, &bytes, options, &notes)?
                } else {
                    let read = other().and_then(|bytes| unpacked(&file, bytes, options));
                    // Another layer is drawn without it.
                    let below = read.and_then(|bytes| self.named_below(&file, &bytes, options, &notes));
                    below.unwrap_or_else(|error| {
                        notes.add_missing("terrain: a tile of another layer that cannot be read", &error);
                        Availability::default()
                    })
                };
                known[layer] = below;
            }
            reader.mesh = TileMesh::Held(Arc::new(HeldMesh { tile: self.tile, uri: uri.clone(), bytes }));
        }
        options.ignored.add(&notes.into_ignored());
        Ok(vec![reader.tile(self.tile, &known, self.file_layer.is_some())])
    }

    /// Returns the tiles that the metadata in a file of the first tile names below it.
    fn named_below(
        &self,
        uri: &str,
        bytes: &[u8],
        options: &ReadOptions,
        notes: &Notes,
    ) -> Result<Availability, IoError> {
        let bad = |reason: String| IoError::invalid(uri, format!("quantized-mesh: {reason}"));
        let mesh = quantized::parse(bytes, options.limits.max_elements).map_err(bad)?;
        let Some(json) = mesh.metadata else {
            notes.add("terrain: a tile without the metadata that layer.json announces");
            return Ok(Availability::default());
        };
        options.limits.check_json(uri, json)?;
        let json: MetadataJson = serde_json::from_slice(json).map_err(|e| bad(format!("metadata: {e}")))?;
        let ranges = json.available.unwrap_or_default();
        let (below, faults) = Availability::of_ranges(&ranges, self.tile.level + 1, self.set.tiling)
            .map_err(|reason| bad(format!("metadata: available: {reason}")))?;
        if faults.is_outside || faults.is_orphaned {
            notes.add("terrain: metadata with tiles that a level lacks, or without a parent");
        }
        Ok(below.within(self.tile))
    }
}

impl ReaderValue for TerrainPage {
    fn is_whole_content(&self) -> bool {
        self.file_layer.is_none()
    }

    fn continues_tileset(&self) -> bool {
        true
    }

    fn needs_content(&self) -> bool {
        true
    }

    fn is_ground_of_globe(&self) -> bool {
        true
    }

    fn fallback_uri(&self) -> Option<Arc<str>> {
        self.set.layers[self.file_layer?].tile_uri(self.tile).1
    }

    fn size_bytes(&self) -> u64 {
        let known: u64 = self.known.iter().map(Availability::size_bytes).sum();
        size_of::<Self>() as u64 + known + if self.tile.level == 0 { self.set.size_bytes() } else { 0 }
    }
}

/// Makes the tiles of a page.
struct PageReader<'a> {
    page: &'a TerrainPage,
    /// The mesh of the first tile, or the nearest above it.
    mesh: TileMesh,
    heights_m: [f64; 2],
}

impl PageReader<'_> {
    /// Returns a tile with the levels below it. `known` are the tiles that exist there. `is_held` tells that its file is
    /// the mesh of the page.
    fn tile(&self, tile: TileCoordinates, known: &[Availability], is_held: bool) -> Tile {
        let set = &self.page.set;
        let layer = TerrainSet::layer_of(known, tile);
        let (mut children, mut continuations) = (Vec::new(), Vec::new());
        if self.is_divided(tile, known, is_held || layer.is_some()) {
            for child in (0..4).map(|child| tile.child(child)) {
                let below: Vec<Availability> = known.iter().map(|known| known.within(child)).collect();
                if self.begins_page(child, &below) {
                    continuations.push(self.continuation(child, below));
                } else {
                    children.push(self.tile(child, &below, false));
                }
            }
        }
        let is_finest = children.is_empty() && continuations.is_empty();
        let geometric_error_m = if is_finest { 0.0 } else { set.geometric_error_m(tile) };
        let mesh = if layer.is_some() && !is_held { TileMesh::File } else { self.mesh.clone() };
        let fetched = layer.filter(|_| !is_held).map(|layer| set.layers[layer].tile_uri(tile));
        Tile {
            bounds: self.bounds(tile, known),
            request_volume: None,
            refine: Refine::Replace,
            geometric_error_m,
            content_transform: DAffine3::IDENTITY,
            contents: vec![TerrainTile::new(set.clone(), tile, mesh).content(fetched)],
            external_tilesets: Vec::new(),
            continuations,
            metadata: None,
            children,
        }
    }

    /// Returns the page that begins with a tile.
    fn continuation(&self, tile: TileCoordinates, known: Vec<Availability>) -> Continuation {
        let (set, above) = (self.page.set.clone(), self.mesh.clone());
        let page = TerrainPage::new(set, tile, known.into(), above, self.heights_m);
        Continuation { bounds: self.bounds(tile, &page.known), content: page.content() }
    }

    /// Returns true if a tile has children. A part of the ellipsoid is divided down to its finest level.
    fn is_divided(&self, tile: TileCoordinates, known: &[Availability], has_file: bool) -> bool {
        let is_ellipsoid = !has_file && matches!(self.mesh, TileMesh::Ellipsoid);
        (is_ellipsoid && tile.level < MAX_ELLIPSOID_LEVEL) || known.iter().any(|known| known.has_below(tile))
    }

    /// Returns true if a tile begins another page.
    fn begins_page(&self, tile: TileCoordinates, known: &[Availability]) -> bool {
        let has_file = TerrainSet::layer_of(known, tile).is_some();
        if self.page.set.layers_with_metadata(known, tile).next().is_some() {
            return true;
        }
        self.is_divided(tile, known, has_file)
            && (tile.level.is_multiple_of(PAGE_LEVELS) || (has_file && TerrainSet::lacks_child(known, tile)))
    }

    fn bounds(&self, tile: TileCoordinates, known: &[Availability]) -> BoundingVolume {
        let is_ellipsoid = matches!(self.mesh, TileMesh::Ellipsoid)
            && !known.iter().any(|known| known.has(tile) || known.has_below(tile));
        bounds(&self.page.set, tile, if is_ellipsoid { [0.0; 2] } else { self.heights_m })
    }
}

fn bounds(set: &TerrainSet, tile: TileCoordinates, heights_m: [f64; 2]) -> BoundingVolume {
    BoundingVolume::Region(set.tiling.rectangle(tile).region(set.ellipsoid, heights_m))
}
