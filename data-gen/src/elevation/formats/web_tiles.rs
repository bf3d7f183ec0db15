//! Web tiles in the scheme of XYZ: `z/x/y.png` in Web Mercator, row 0 in the north.

use std::collections::HashMap;
use std::f64::consts::PI;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use super::{Opened, RasterOptions, png};
use crate::GenError;
use crate::georeference::{Crs, GeoTransform, Placement};
use crate::store::{BlockGrid, BlockReader, Rect};
use terrane::math::WGS84;

/// The position of a tile.
#[derive(Clone, Copy)]
pub(super) struct WebTile {
    zoom: u32,
    x: u32,
    y: u32,
}

impl WebTile {
    /// Returns the placement of an image whose north-western tile is this one. `size` is that of a tile in pixels.
    pub fn placement(&self, size: [usize; 2]) -> Placement {
        let half_m = PI * WGS84.semi_major_m;
        let tile_m = 2.0 * half_m / f64::from(1u32 << self.zoom);
        let origin = [f64::from(self.x) * tile_m - half_m, half_m - f64::from(self.y) * tile_m];
        let [dx, dy] = size.map(|pixels| tile_m / pixels as f64);
        Placement::new(GeoTransform { origin, dx: [dx, 0.0], dy: [0.0, -dy] }, Crs::WebMercator)
    }
}

/// Returns the tile that a path names by its last three parts, `None` if they are not the numbers of a tile.
pub(super) fn tile_of(path: &Path) -> Option<WebTile> {
    let number = |path: &Path| path.file_stem()?.to_str().filter(|name| !name.starts_with('+'))?.parse().ok();
    let (column, zoom) = (path.parent()?, path.parent()?.parent()?);
    let tile = WebTile { zoom: number(zoom)?, x: number(column)?, y: number(path)? };
    let is_valid = tile.zoom <= 24 && tile.x.max(tile.y) < 1 << tile.zoom;
    is_valid.then_some(tile)
}

/// Returns the folders in a folder whose names are numbers below `end`.
fn numbered(folder: &Path, end: u32) -> Vec<(u32, PathBuf)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let number = |path: &PathBuf| path.file_name()?.to_str()?.parse().ok().filter(|number| *number < end);
    entries.filter(|path| path.is_dir()).filter_map(|path| Some((number(&path)?, path))).collect()
}

/// Returns true if a folder has a folder for a zoom level with tiles.
pub(crate) fn is_folder_of_tiles(folder: &Path) -> bool {
    numbered(folder, 25).into_iter().any(|(_, zoom)| !tiles(&zoom).is_empty())
}

/// Returns the PNGs of a zoom level's folder, in the order of their columns and rows.
fn tiles(zoom: &Path) -> Vec<(WebTile, PathBuf)> {
    let columns = numbered(zoom, 1 << 24).into_iter();
    let files = columns.flat_map(|(_, column)| std::fs::read_dir(column).into_iter().flatten().flatten());
    let is_png = |path: &PathBuf| path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"));
    let paths = files.map(|entry| entry.path()).filter(is_png);
    let mut tiles: Vec<_> = paths.filter_map(|path| Some((tile_of(&path)?, path))).collect();
    tiles.sort_by_key(|(tile, _)| (tile.x, tile.y));
    tiles
}

/// The encoded tiles of one zoom level.
pub(super) trait TileBytes: Send + Sync {
    /// Reads a tile, `None` if it is missing.
    fn read(&self, tile: [usize; 2]) -> Result<Option<Vec<u8>>, GenError>;

    /// Returns the path of a tile for error messages.
    fn path(&self, tile: [usize; 2]) -> PathBuf;

    /// Returns true if a tile is missing, as far as this is known without reading it.
    fn is_missing(&self, tile: [usize; 2]) -> bool;
}

/// The tiles of one zoom level as one image, read tile by tile. Missing tiles have no data.
struct Tiles {
    bytes: Box<dyn TileBytes>,
    /// The column and row of the north-western tile.
    corner: [usize; 2],
    /// The size of a tile in pixels.
    size: [usize; 2],
    options: RasterOptions,
}

/// Returns tiles as one image. `columns` and `rows` are the first and the last ones that exist, `first` is a tile that exists.
pub(super) fn image(
    bytes: Box<dyn TileBytes>,
    zoom: u32,
    [columns, rows]: [[usize; 2]; 2],
    first: [usize; 2],
    options: &RasterOptions,
) -> Result<Opened, GenError> {
    let path = bytes.path(first);
    let tile = bytes.read(first)?.ok_or_else(|| GenError::invalid(&path, "the tile is missing"))?;
    let size = png::size(Cursor::new(&tile), &path, options, tile.len() as u64)?;
    let whole = [columns, rows].map(|[first, last]| last - first + 1);
    let whole = [0, 1].map(|k| whole[k].saturating_mul(size[k]));
    let corner = [columns[0], rows[0]];
    let placement = WebTile { zoom, x: corner[0] as u32, y: corner[1] as u32 }.placement(size);
    let reader = Box::new(Tiles { bytes, corner, size, options: options.clone() });
    Ok(Opened { grid: BlockGrid::new(whole, size), reader, placement })
}

impl Tiles {
    /// Returns the column and row of the tile that a block is.
    fn tile(&self, block: Rect) -> [usize; 2] {
        [block.column / self.size[0] + self.corner[0], block.row / self.size[1] + self.corner[1]]
    }
}

impl BlockReader for Tiles {
    fn read(&self, block: Rect) -> Result<Vec<u32>, GenError> {
        let tile = self.tile(block);
        let Some(bytes) = self.bytes.read(tile)? else { return Ok(vec![f32::NAN.to_bits(); block.pixels()]) };
        let path = self.bytes.path(tile);
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
        self.bytes.is_missing(self.tile(block))
    }
}

/// The tiles of one zoom level of a folder.
struct Folder {
    /// The folder of the zoom level.
    zoom: PathBuf,
    /// The files of tiles, by column and row, whose names are not plain numbers and `png`, such as `07.PNG`.
    unusual: HashMap<[usize; 2], PathBuf>,
}

/// Opens the tiles of the finest zoom level of a folder as one image. Missing tiles have no data.
pub(super) fn open(folder: &Path, options: &RasterOptions) -> Result<Opened, GenError> {
    let mut zooms = numbered(folder, 25);
    zooms.sort_by_key(|(zoom, _)| std::cmp::Reverse(*zoom));
    let finest = zooms.into_iter().map(|(_, zoom)| (tiles(&zoom), zoom)).find(|(tiles, _)| !tiles.is_empty());
    let (tiles, zoom) = finest.unwrap_or_default();
    let range = |of: fn(&WebTile) -> u32| {
        let all = || tiles.iter().map(|(tile, _)| of(tile));
        Some([all().min()?, all().max()?])
    };
    let (Some([west, east]), Some([north, south]), Some((first, _))) =
        (range(|tile| tile.x), range(|tile| tile.y), tiles.first())
    else {
        return Err(GenError::invalid(folder, "no tiles z/x/y.png in it"));
    };
    let mut folder = Folder { zoom, unusual: HashMap::new() };
    for (tile, path) in &tiles {
        let at = [tile.x as usize, tile.y as usize];
        if *path != folder.path(at) {
            folder.unusual.insert(at, path.clone());
        }
    }
    let range = [[west, east], [north, south]].map(|range| range.map(|tile| tile as usize));
    image(Box::new(folder), first.zoom, range, [first.x as usize, first.y as usize], options)
}

impl TileBytes for Folder {
    fn read(&self, tile: [usize; 2]) -> Result<Option<Vec<u8>>, GenError> {
        let path = self.path(tile);
        match std::fs::read(&path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(GenError::file(path)(e)),
        }
    }

    fn path(&self, [x, y]: [usize; 2]) -> PathBuf {
        let usual = || self.zoom.join(x.to_string()).join(format!("{y}.png"));
        self.unusual.get(&[x, y]).cloned().unwrap_or_else(usual)
    }

    fn is_missing(&self, tile: [usize; 2]) -> bool {
        !self.path(tile).exists()
    }
}
