//! Reads terrain services, and the ellipsoid, as their root tiles. Decode threads.

use std::sync::Arc;

use super::availability::Availability;
use super::layer::read_layers;
use super::pages::TerrainPage;
use super::set::TerrainSet;
use super::tiling::Tiling;
use crate::fetch::IoError;
use crate::formats::ignored::Notes;
use crate::formats::implicit::TileCoordinates;
use crate::formats::options::{Fetched, ReadOptions};
use crate::formats::tile::{Tile, node_of};
use crate::math::Ellipsoid;
use crate::scene::Node;

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
    let mut tiles = root_tiles(&set);
    if tiling == Tiling::Mercator {
        tiles.extend(root_tiles(&TerrainSet::bare(options.ellipsoid, Tiling::NorthCap)));
        tiles.extend(root_tiles(&TerrainSet::bare(options.ellipsoid, Tiling::SouthCap)));
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
    node_of(root_tiles(&TerrainSet::bare(ellipsoid, Tiling::Geographic)))
}

/// Returns the root tiles, each with the page of its file and the first levels below it. Until that is read, and if it
/// cannot be, the ellipsoid is drawn.
fn root_tiles(set: &Arc<TerrainSet>) -> Vec<Tile> {
    let columns = 0..set.tiling.root_columns();
    let roots = columns.map(|x| {
        let tile = TileCoordinates { level: 0, x, y: 0, z: 0 };
        let known: Arc<[Availability]> = set.layers.iter().map(|layer| layer.available.within(tile)).collect();
        TerrainPage::root(set.clone(), tile, known).into_root()
    });
    roots.collect()
}
