//! [`TerrainSet`]: a terrain service, or the ellipsoid alone. Immutable; decode threads.

use std::sync::Arc;

use super::availability::Availability;
use super::layer::Layer;
use super::tiling::Tiling;
use crate::formats::implicit::TileCoordinates;
use crate::math::Ellipsoid;

/// The beginning of the names of the ellipsoid's tiles.
const BARE: &str = "ellipsoid";

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
    pub fn bare(ellipsoid: Ellipsoid, tiling: Tiling) -> Arc<Self> {
        let part = match tiling {
            Tiling::Geographic | Tiling::Mercator => "",
            Tiling::NorthCap => "-north",
            Tiling::SouthCap => "-south",
        };
        Arc::new(Self { uri: format!("{BARE}{part}").into(), tiling, ellipsoid, layers: Vec::new() })
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
