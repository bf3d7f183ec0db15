//! Web tiles in the scheme of XYZ: `z/x/y.png` in Web Mercator, row 0 in the north.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use super::super::raster::Raster;
use super::{MAX_SAMPLES, RasterOptions, png};
use crate::GenError;
use crate::georeference::{Crs, GeoTransform, Placement};
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

/// Reads the tiles of the finest zoom level of a folder as one raster. Missing tiles have no data.
pub(super) fn read(folder: &Path, options: &RasterOptions) -> Result<Raster, GenError> {
    let mut zooms = numbered(folder, 25);
    zooms.sort_by_key(|(zoom, _)| std::cmp::Reverse(*zoom));
    let tiles = zooms.iter().map(|(_, path)| tiles(path)).find(|tiles| !tiles.is_empty()).unwrap_or_default();
    let range = |of: fn(&WebTile) -> u32| {
        let all = || tiles.iter().map(|(tile, _)| of(tile));
        Some([all().min()?, all().max()?])
    };
    let (Some([west, east]), Some([north, south]), Some((first, path))) =
        (range(|tile| tile.x), range(|tile| tile.y), tiles.first())
    else {
        return Err(GenError::invalid(folder, "no tiles z/x/y.png in it"));
    };
    let (size, _) = png::heights(path, options)?;
    let width = ((east - west + 1) as usize).checked_mul(size[0]);
    let height = ((south - north + 1) as usize).checked_mul(size[1]);
    let count = width.zip(height).and_then(|(w, h)| w.checked_mul(h)).filter(|count| *count <= MAX_SAMPLES);
    let (Some(width), Some(height), Some(count)) = (width, height, count) else {
        let reason = format!("tiles from {west}, {north} to {east}, {south} are more than 2^30 samples");
        return Err(GenError::invalid(folder, reason));
    };
    let mut samples = vec![f32::NAN; count];
    for (tile, path) in &tiles {
        let (own, heights) = png::heights(path, options)?;
        if own != size {
            let reason = format!("{} x {} pixels, but other tiles have {} x {}", own[0], own[1], size[0], size[1]);
            return Err(GenError::invalid(path, reason));
        }
        let (left, top) = ((tile.x - west) as usize * size[0], (tile.y - north) as usize * size[1]);
        for (row, heights) in heights.chunks_exact(size[0]).enumerate() {
            let at = (top + row) * width + left;
            samples[at..at + size[0]].copy_from_slice(heights);
        }
    }
    let corner = WebTile { zoom: first.zoom, x: west, y: north };
    Ok(Raster::new([width, height], samples, corner.placement(size)))
}
