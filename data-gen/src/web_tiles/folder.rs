//! Folders of tiles in the scheme of XYZ, `z/x/y.png`, or of TMS, whose rows count from the south: a folder with the file
//! `tilemapresource.xml` (`gdal2tiles`), or with the scheme `tms` in its `metadata.json` (`mb-util`) or `tiles.json`. Tiles of twice
//! the usual size may be named `z/x/y@2x.png`.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{MAX_ZOOM, TileContent, WebTile, WebTiles, Zoom};
use crate::GenError;

/// The extensions of tiles of any content.
const EXTENSIONS: &[&str] = &["png", "jpg", "jpeg", "webp"];

/// The file that describes a folder of TMS.
const TMS: &str = "tilemapresource.xml";
/// The files whose `scheme` says from where rows count, and the largest one that is read.
const SCHEMES: [&str; 2] = ["metadata.json", "tiles.json"];
const MAX_SCHEME_BYTES: u64 = 1 << 20;
/// The end of the names of tiles of twice the usual size.
const TWICE: &str = "@2x";

/// A folder of tiles.
struct Folder {
    path: PathBuf,
    /// True if the rows of files count from the south.
    is_tms: bool,
    zooms: Vec<Zoom>,
    first: WebTile,
    /// The extension of most tiles.
    extension: String,
    /// The files of tiles whose names are not plain numbers and that extension, such as `07.PNG`.
    unusual: HashMap<(u32, usize, usize), PathBuf>,
}

/// Returns the tile that a path names by its last three parts, `None` if they are not the numbers of a tile.
pub(crate) fn tile_of(path: &Path) -> Option<WebTile> {
    let stem = |path: &Path| Some(path.file_stem()?.to_str()?.to_owned());
    let number = |name: &str| Some(name).filter(|name| !name.starts_with('+'))?.parse().ok();
    let (column, zoom, row) = (path.parent()?, path.parent()?.parent()?, stem(path)?);
    let row = row.strip_suffix(TWICE).unwrap_or(&row);
    let [zoom, x, y]: [u32; 3] = [number(&stem(zoom)?)?, number(&stem(column)?)?, number(row)?];
    let is_valid = zoom <= MAX_ZOOM && x.max(y) < 1 << zoom;
    is_valid.then_some(WebTile { zoom, x: x as usize, y: y as usize })
}

/// Returns the folders in a folder whose names are numbers below `end`.
fn numbered(folder: &Path, end: u32) -> Vec<(u32, PathBuf)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let number = |path: &PathBuf| path.file_name()?.to_str()?.parse().ok().filter(|number| *number < end);
    entries.filter(|path| path.is_dir()).filter_map(|path| Some((number(&path)?, path))).collect()
}

/// Returns true if a folder has a folder for a zoom level with tiles.
pub(crate) fn is_folder_of_tiles(folder: &Path) -> bool {
    numbered(folder, MAX_ZOOM + 1).into_iter().any(|(_, zoom)| !tiles(&zoom, EXTENSIONS).is_empty())
}

/// Returns whether a folder is one of TMS. Other tiles than those of Web Mercator are an error.
fn is_tms(folder: &Path) -> Result<bool, GenError> {
    let path = folder.join(TMS);
    let Ok(text) = std::fs::read_to_string(&path) else {
        return Ok(SCHEMES.iter().any(|name| names_tms(&folder.join(name))));
    };
    let is_mercator =
        ["EPSG:3857", "EPSG:900913", "OSGEO:41001", "profile=\"mercator\"", "profile=\"global-mercator\""];
    match is_mercator.iter().any(|name| text.contains(name)) {
        true => Ok(true),
        false => Err(GenError::invalid(path, "tiles of another system than Web Mercator, which are not supported")),
    }
}

/// Returns true for a file of JSON with the scheme `tms`.
fn names_tms(path: &Path) -> bool {
    let is_small = path.metadata().is_ok_and(|found| found.is_file() && found.len() <= MAX_SCHEME_BYTES);
    let read = || serde_json::from_slice::<serde_json::Value>(&std::fs::read(path).ok()?).ok();
    let found = if is_small { read() } else { None };
    found.is_some_and(|found| found["scheme"].as_str().is_some_and(|scheme| scheme.eq_ignore_ascii_case("tms")))
}

/// Returns the tile of a file in a folder, or that of the file with another row.
fn turned(tile: WebTile, is_tms: bool) -> WebTile {
    WebTile { y: if is_tms { (1 << tile.zoom) - 1 - tile.y } else { tile.y }, ..tile }
}

/// Returns the tiles of a zoom level's folder, in the order of their columns and rows.
fn tiles(zoom: &Path, extensions: &[&str]) -> Vec<(WebTile, PathBuf)> {
    let columns = numbered(zoom, 1 << MAX_ZOOM).into_iter();
    let files = columns.flat_map(|(_, column)| std::fs::read_dir(column).into_iter().flatten().flatten());
    let is_tile =
        |path: &PathBuf| path.extension().is_some_and(|e| extensions.iter().any(|known| e.eq_ignore_ascii_case(known)));
    let paths = files.map(|entry| entry.path()).filter(is_tile);
    let mut tiles: Vec<_> = paths.filter_map(|path| Some((tile_of(&path)?, path))).collect();
    // A tile of twice the size comes after the one of the usual size, and is read in its place.
    tiles.sort_by(|(a, path), (b, other)| (a.x, a.y, path).cmp(&(b.x, b.y, other)));
    tiles
}

/// Opens a folder. Tiles may be missing.
pub(super) fn open(path: &Path, content: TileContent) -> Result<Arc<dyn WebTiles>, GenError> {
    let mut zooms = numbered(path, MAX_ZOOM + 1);
    zooms.sort_by_key(|(zoom, _)| std::cmp::Reverse(*zoom));
    let mut folder = Folder {
        path: path.to_owned(),
        is_tms: is_tms(path)?,
        zooms: Vec::new(),
        first: WebTile { zoom: 0, x: 0, y: 0 },
        extension: String::new(),
        unusual: HashMap::new(),
    };
    for (zoom, below) in zooms {
        let mut tiles = tiles(&below, content.extensions());
        tiles.iter_mut().for_each(|(tile, _)| *tile = turned(*tile, folder.is_tms));
        let Some((first, name)) = tiles.first() else { continue };
        if folder.zooms.is_empty() {
            folder.first = *first;
            folder.extension = name.extension().and_then(|e| e.to_str()).unwrap_or_default().to_owned();
        }
        let range = |of: fn(&WebTile) -> usize| {
            let all = tiles.iter().map(|(tile, _)| of(tile));
            all.fold([usize::MAX, 0], |[low, high], n| [low.min(n), high.max(n)])
        };
        folder.zooms.push(Zoom { zoom, columns: range(|tile| tile.x), rows: range(|tile| tile.y) });
        for (tile, path) in &tiles {
            if *path != folder.usual(*tile) {
                folder.unusual.insert((tile.zoom, tile.x, tile.y), path.clone());
            }
        }
    }
    match folder.zooms.is_empty() {
        true => Err(GenError::invalid(path, format!("no tiles z/x/y.{} in it", content.extensions().join("|")))),
        false => Ok(Arc::new(folder)),
    }
}

impl Folder {
    fn usual(&self, tile: WebTile) -> PathBuf {
        let WebTile { zoom, x, y } = turned(tile, self.is_tms);
        self.path.join(zoom.to_string()).join(x.to_string()).join(format!("{y}.{}", self.extension))
    }
}

impl WebTiles for Folder {
    fn zooms(&self) -> &[Zoom] {
        &self.zooms
    }

    fn first(&self) -> WebTile {
        self.first
    }

    fn read(&self, tile: WebTile) -> Result<Option<Vec<u8>>, GenError> {
        let path = self.path(tile);
        match std::fs::read(&path) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(e) => Err(GenError::file(path)(e)),
        }
    }

    fn path(&self, tile: WebTile) -> PathBuf {
        self.unusual.get(&(tile.zoom, tile.x, tile.y)).cloned().unwrap_or_else(|| self.usual(tile))
    }

    fn is_missing(&self, tile: WebTile) -> bool {
        !self.path(tile).exists()
    }
}
