//! Web tiles in Web Mercator, in folders `z/x/y.png` and in archives: which zoom levels there are, and the bytes of each tile.

#[cfg(feature = "mbtiles")]
mod database;
mod folder;
#[cfg(feature = "mbtiles")]
mod mbtiles;
mod pmtiles;

use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use terrane::math::WGS84;

use crate::GenError;
use crate::georeference::{Crs, GeoTransform, Placement};
use crate::store::{BlockCache, first_bytes, is_remote};
pub(crate) use folder::{is_folder_of_tiles, tile_of};

/// The deepest zoom level that is read.
const MAX_ZOOM: u32 = 24;
/// The largest encoded tile of a database in bytes.
#[cfg(feature = "mbtiles")]
const MAX_TILE_BYTES: usize = 64 << 20;

/// The position of a tile: row 0 is in the north.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct WebTile {
    pub zoom: u32,
    pub x: usize,
    pub y: usize,
}

impl WebTile {
    /// Returns the placement of an image whose north-western tile is this one. `size` is that of a tile in pixels.
    pub fn placement(&self, size: [usize; 2]) -> Placement {
        let half_m = PI * WGS84.semi_major_m;
        let tile_m = 2.0 * half_m / f64::from(1u32 << self.zoom);
        let origin = [self.x as f64 * tile_m - half_m, half_m - self.y as f64 * tile_m];
        let [dx, dy] = size.map(|pixels| tile_m / pixels as f64);
        Placement::new(GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] }, Crs::WebMercator)
    }
}

/// A zoom level, and the first and the last of the columns and rows of its tiles. Not all of them need exist.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Zoom {
    pub zoom: u32,
    pub columns: [usize; 2],
    pub rows: [usize; 2],
}

impl Zoom {
    /// Returns the north-western tile.
    pub fn corner(&self) -> WebTile {
        WebTile { zoom: self.zoom, x: self.columns[0], y: self.rows[0] }
    }

    /// Returns the size of all tiles together in pixels. `tile` is that of one.
    pub fn size(&self, tile: [usize; 2]) -> [usize; 2] {
        let count = [self.columns, self.rows].map(|[first, last]| last - first + 1);
        [0, 1].map(|k| count[k].saturating_mul(tile[k]))
    }
}

/// The tiles of a folder or an archive. Threads read at the same time.
pub(crate) trait WebTiles: Send + Sync {
    /// Returns the zoom levels that have tiles, finest first. An archive without any is an error.
    fn zooms(&self) -> &[Zoom];

    /// Returns a tile of the finest level that exists.
    fn first(&self) -> WebTile;

    /// Reads a tile, `None` if it is missing.
    fn read(&self, tile: WebTile) -> Result<Option<Vec<u8>>, GenError>;

    /// Returns the path of a tile for error messages.
    fn path(&self, tile: WebTile) -> PathBuf;

    /// Returns true if a tile is missing, as far as this is known without reading it.
    fn is_missing(&self, _tile: WebTile) -> bool {
        false
    }
}

/// The content of tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TileContent {
    /// PNGs, whose colours are heights.
    Heights,
    /// PNG, JPEG or WebP.
    Colors,
}

impl TileContent {
    /// Returns the extensions of tiles in folders.
    fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Heights => &["png"],
            Self::Colors => &["png", "jpg", "jpeg", "webp"],
        }
    }
}

/// Opens a folder of tiles or an archive.
pub(crate) fn open(path: &Path, content: TileContent, cache: &Arc<BlockCache>) -> Result<Arc<dyn WebTiles>, GenError> {
    if !is_remote(path) && path.is_dir() {
        return folder::open(path, content);
    }
    if is_mbtiles(&first_bytes(path, cache)?) {
        #[cfg(feature = "mbtiles")]
        return mbtiles::open(path, content);
        #[cfg(not(feature = "mbtiles"))]
        return Err(GenError::invalid(path, "MBTiles, which this program is built without (feature mbtiles)"));
    }
    pmtiles::open(path, content, cache)
}

/// Returns true for a folder of tiles and for an archive of tiles.
pub(crate) fn is_archive(path: &Path, cache: &Arc<BlockCache>) -> Result<bool, GenError> {
    if !is_remote(path) && path.is_dir() {
        return Ok(is_folder_of_tiles(path));
    }
    let magic = first_bytes(path, cache)?;
    Ok(magic.starts_with(b"PMTiles") || !is_remote(path) && is_mbtiles(&magic))
}

/// Returns true for the first bytes of a SQLite database.
fn is_mbtiles(magic: &[u8]) -> bool {
    magic.starts_with(b"SQLite f")
}
