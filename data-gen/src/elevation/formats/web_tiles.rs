//! Web tiles with heights in the colours of PNGs: the finest zoom level as one image.

use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use super::{Opened, RasterOptions, png};
use crate::GenError;
use crate::store::{BlockCache, BlockGrid, BlockReader, Rect};
use crate::web_tiles::{self, TileContent, WebTile, WebTiles};

/// The tiles of one zoom level as one image, read tile by tile. Missing tiles have no data.
struct Tiles {
    tiles: Arc<dyn WebTiles>,
    /// The north-western tile.
    corner: WebTile,
    /// The size of a tile in pixels.
    size: [usize; 2],
    options: RasterOptions,
}

/// Opens the tiles of the finest zoom level of a folder or an archive as one image.
pub(super) fn open(path: &Path, options: &RasterOptions, cache: &Arc<BlockCache>) -> Result<Opened, GenError> {
    let tiles = web_tiles::open(path, TileContent::Heights, cache)?;
    let first = tiles.first();
    let path = tiles.path(first);
    let tile = tiles.read(first)?.ok_or_else(|| GenError::invalid(&path, "the tile is missing"))?;
    let size = png::size(Cursor::new(&tile), &path, options, tile.len() as u64)?;
    let finest = tiles.zooms()[0];
    let corner = finest.corner();
    let grid = BlockGrid::new(finest.size(size), size);
    let reader = Box::new(Tiles { tiles, corner, size, options: options.clone() });
    Ok(Opened { grid, reader, placement: corner.placement(size) })
}

impl Tiles {
    /// Returns the tile that a block is.
    fn tile(&self, block: Rect) -> WebTile {
        let WebTile { zoom, x, y } = self.corner;
        WebTile { zoom, x: x + block.column / self.size[0], y: y + block.row / self.size[1] }
    }
}

impl BlockReader for Tiles {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let tile = self.tile(block);
        let Some(bytes) = self.tiles.read(tile)? else { return Ok(vec![f32::NAN.to_bits(); block.pixels()]) };
        let path = self.tiles.path(tile);
        let own = png::size(Cursor::new(&bytes), &path, &self.options, bytes.len() as u64)?;
        if own != self.size {
            let [width, height] = self.size;
            let reason = format!("{} x {} pixels, but other tiles have {width} x {height}", own[0], own[1]);
            return Err(GenError::invalid(path, reason));
        }
        let mut heights = Vec::with_capacity(block.pixels());
        png::heights(Cursor::new(&bytes), &path, &self.options, &mut |row| {
            heights.extend_from_slice(row);
            Ok(())
        })?;
        match heights.len() == block.pixels() {
            true => Ok(heights),
            false => Err(GenError::invalid(path, format!("{} pixels, expected {}", heights.len(), block.pixels()))),
        }
    }

    fn is_known_empty(&self, block: Rect) -> bool {
        self.tiles.is_missing(self.tile(block))
    }
}
