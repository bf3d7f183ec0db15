//! [`TerrainSet`]: a terrain service, or the ellipsoid alone, and its root tiles. Immutable; decode threads.

use std::sync::Arc;

use super::availability::Availability;
use super::layer::{Layer, read_layers};
use super::pages::TerrainPage;
use super::tiling::Tiling;
use crate::fetch::IoError;
use crate::formats::ignored::Notes;
use crate::formats::implicit::TileCoordinates;
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::tile::{Tile, node_of};
use crate::math::Ellipsoid;
use crate::scene::Node;

/// The name of the ellipsoid in the names of its tiles.
const ELLIPSOID: &str = "ellipsoid";

/// The layers of a terrain service.
#[derive(Debug)]
pub(super) struct TerrainSet {
    /// The layer.json, or another name.
    pub uri: Arc<str>,
    pub tiling: Tiling,
    pub ellipsoid: Ellipsoid,
    /// The upper ones first; none for the ellipsoid.
    pub layers: Vec<Layer>,
}

impl TerrainSet {
    /// Returns the ellipsoid without terrain, or a part of it.
    fn bare(ellipsoid: Ellipsoid, tiling: Tiling) -> Arc<Self> {
        let part = match tiling {
            Tiling::Geographic | Tiling::Mercator => "",
            Tiling::NorthCap => "-north",
            Tiling::SouthCap => "-south",
        };
        Arc::new(Self { uri: format!("{ELLIPSOID}{part}").into(), tiling, ellipsoid, layers: Vec::new() })
    }

    /// Returns the root tiles, each with the page of its file and the first levels below it. Until that is read, and if it
    /// cannot be, the ellipsoid is drawn.
    fn root_tiles(self: &Arc<Self>) -> Vec<Tile> {
        let columns = 0..self.tiling.root_columns();
        let roots = columns.map(|x| {
            let tile = TileCoordinates { level: 0, x, y: 0, z: 0 };
            let known: Arc<[Availability]> = self.layers.iter().map(|layer| layer.available.within(tile)).collect();
            TerrainPage::root(self.clone(), tile, known).into_root()
        });
        roots.collect()
    }

    /// Returns the error of a level, metres.
    pub fn level_error_m(&self, level: u32) -> f64 {
        self.tiling.level_error_m(&self.ellipsoid, level)
    }

    /// Returns the geometric error of a tile, metres.
    pub fn geometric_error_m(&self, tile: TileCoordinates) -> f64 {
        self.tiling.geometric_error_m(&self.ellipsoid, tile)
    }

    /// Returns the layer that a tile is fetched from; `None` if no layer has it.
    pub fn layer_of(known: &[Availability], tile: TileCoordinates) -> Option<usize> {
        known.iter().position(|layer| layer.has(tile))
    }

    /// Returns true if no layer has some child of a tile.
    pub fn lacks_child(known: &[Availability], tile: TileCoordinates) -> bool {
        (0..4).any(|child| Self::layer_of(known, tile.child(child)).is_none())
    }

    /// Returns the layers whose tile names the tiles below it in its metadata.
    pub fn layers_with_metadata<'a>(
        &'a self,
        known: &'a [Availability],
        tile: TileCoordinates,
    ) -> impl Iterator<Item = usize> + 'a {
        let layers = self.layers.iter().zip(known).enumerate();
        layers.filter_map(move |(i, (layer, known))| {
            let is_named = layer.metadata_levels.is_some_and(|levels| tile.level.is_multiple_of(levels));
            (is_named && known.has(tile)).then_some(i)
        })
    }

    /// Returns the bytes of memory.
    pub fn size_bytes(&self) -> u64 {
        self.layers.iter().map(Layer::size_bytes).sum()
    }
}

/// Reads a layer.json as root tiles. `companions` are the files that [`parent_files`](super::parent_files) returned. Around
/// the poles, which Web Mercator does not reach, the ellipsoid is drawn.
pub(in crate::formats) fn read_tiles(
    uri: &Arc<str>,
    text: &[u8],
    companions: &[Fetched],
    options: &ReadOptions,
) -> Result<Vec<Tile>, IoError> {
    let notes = Notes::default();
    let layers = read_layers(uri, text, companions, options, &notes);
    options.ignored.add(&notes.into_ignored());
    let layers = layers?;
    let tiling = layers.first().map_or(Tiling::Geographic, |layer| layer.tiling);
    let set = Arc::new(TerrainSet { uri: uri.clone(), tiling, ellipsoid: options.ellipsoid, layers });
    let mut tiles = set.root_tiles();
    if tiling == Tiling::Mercator {
        tiles.extend(TerrainSet::bare(options.ellipsoid, Tiling::NorthCap).root_tiles());
        tiles.extend(TerrainSet::bare(options.ellipsoid, Tiling::SouthCap).root_tiles());
    }
    Ok(tiles)
}

/// Reads a layer.json as nodes.
pub(in crate::formats) fn read(
    uri: &Arc<str>,
    text: &[u8],
    companions: &[Fetched],
    options: &ReadOptions,
) -> Result<Node, IoError> {
    read_tiles(uri, text, companions, options).map(node_of)
}

/// Returns the surface of an ellipsoid as a tile tree in ECEF metres. Its tiles are made when they are wanted; nothing is
/// fetched.
pub fn ellipsoid(ellipsoid: Ellipsoid) -> Node {
    node_of(TerrainSet::bare(ellipsoid, Tiling::Geographic).root_tiles())
}
