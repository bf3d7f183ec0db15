//! Web tiles of colours, PNG, JPEG or WebP: each zoom level is an image that is read tile by tile.

use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use image::ImageReader;

use super::levels::{Level, Opened};
use crate::GenError;
use crate::store::{BlockCache, BlockGrid, BlockReader, PixelImage, Rect};
use crate::web_tiles::{self, TileContent, WebTile, WebTiles, Zoom};

/// The largest side of a tile in pixels.
const MAX_SIDE: u32 = 4096;

/// The tiles of a zoom level. Missing ones are transparent.
struct Tiles {
    tiles: Arc<dyn WebTiles>,
    corner: WebTile,
    /// The size of a tile in pixels.
    size: [usize; 2],
}

/// Opens the zoom levels of a folder or an archive.
pub(super) fn open(path: &Path, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let tiles = web_tiles::open(path, TileContent::Colors, cache)?;
    let first = tiles.first();
    let path = tiles.path(first);
    let bytes = tiles.read(first)?.ok_or_else(|| GenError::invalid(&path, "the tile is missing"))?;
    let size = size(&bytes, &path)?;
    let finest = tiles.zooms()[0];
    let levels = tiles.zooms().iter().filter_map(|zoom| {
        let origin = origin(&finest, zoom)?;
        let grid = BlockGrid::new(zoom.size(size), size);
        let reader = Tiles { tiles: Arc::clone(&tiles), corner: zoom.corner(), size };
        let image = Arc::new(PixelImage::new(grid, Box::new(reader), cache));
        let scale = 1.0 / f64::from(1u32 << (finest.zoom - zoom.zoom));
        Some(Level { image, scale: [scale; 2], origin: [0, 1].map(|k| origin[k] * size[k] as f64) })
    });
    Ok(Opened { levels: levels.collect(), placement: finest.corner().placement(size) })
}

/// Returns the north-western corner of a zoom level in tiles of a coarser one, from the corner of that. `None` if the coarser
/// level does not cover the finer one.
fn origin(finest: &Zoom, coarser: &Zoom) -> Option<[f64; 2]> {
    let depth = finest.zoom - coarser.zoom;
    let (fine, coarse) = ([finest.columns, finest.rows], [coarser.columns, coarser.rows]);
    let covers = (0..2).all(|k| coarse[k][0] <= fine[k][0] >> depth && fine[k][1] >> depth <= coarse[k][1]);
    let scale = 1.0 / f64::from(1u32 << depth);
    covers.then(|| [0, 1].map(|k| fine[k][0] as f64 * scale - coarse[k][0] as f64))
}

fn reader<'a>(bytes: &'a [u8], path: &Path) -> Result<ImageReader<Cursor<&'a [u8]>>, GenError> {
    ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(GenError::file(path))
}

/// Reads the size of a tile.
fn size(bytes: &[u8], path: &Path) -> Result<[usize; 2], GenError> {
    let (width, height) = reader(bytes, path)?.into_dimensions().map_err(|e| GenError::invalid(path, e.to_string()))?;
    match (1..=MAX_SIDE).contains(&width) && (1..=MAX_SIDE).contains(&height) {
        true => Ok([width as usize, height as usize]),
        false => Err(GenError::invalid(path, format!("{width} x {height} pixels; a tile has 1 to {MAX_SIDE} a side"))),
    }
}

impl BlockReader for Tiles {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let WebTile { zoom, x, y } = self.corner;
        let tile = WebTile { zoom, x: x + block.column / self.size[0], y: y + block.row / self.size[1] };
        let Some(bytes) = self.tiles.read(tile)? else { return Ok(vec![0; block.pixels()]) };
        let path = self.tiles.path(tile);
        let own = size(&bytes, &path)?;
        if own != self.size {
            let [width, height] = self.size;
            let reason = format!("{} x {} pixels, but other tiles have {width} x {height}", own[0], own[1]);
            return Err(GenError::invalid(path, reason));
        }
        let image = reader(&bytes, &path)?.decode().map_err(|e| GenError::invalid(&path, e.to_string()))?.into_rgba8();
        Ok(image.as_raw().as_chunks().0.iter().map(|pixel| u32::from_ne_bytes(*pixel)).collect())
    }
}
