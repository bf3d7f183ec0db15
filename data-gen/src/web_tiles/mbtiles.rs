//! MBTiles archives: a SQLite database with a row for each tile. Rows of tiles count from the south.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use rusqlite::OptionalExtension as _;

use super::database::Database;
use super::{MAX_TILE_BYTES, MAX_ZOOM, TileContent, WebTile, WebTiles, Zoom};
use crate::GenError;
use crate::store::FileState;

/// An archive.
struct Archive {
    path: PathBuf,
    state: FileState,
    extension: String,
    zooms: Vec<Zoom>,
    first: WebTile,
    /// Locked while the bytes of a tile are read.
    database: Mutex<Database>,
}

/// Opens an archive and finds its zoom levels.
pub(super) fn open(path: &Path, content: TileContent) -> Result<Arc<dyn WebTiles>, GenError> {
    let bad = |reason: String| GenError::invalid(path, format!("MBTiles: {reason}"));
    let state = FileState::of(path)?;
    let database = Database::open(path, state.bytes()).map_err(bad)?;
    let format = database.query(|database| {
        let query = "SELECT value FROM metadata WHERE name = 'format'";
        database.query_row(query, [], |row| row.get::<_, String>(0)).optional()
    });
    let format = format.unwrap_or_default();
    let extension = format.unwrap_or_else(|| "png".to_owned()).to_ascii_lowercase();
    if !content.extensions().contains(&extension.as_str()) {
        let known = content.extensions().join(", ");
        return Err(bad(format!("tiles of format {extension}; {known} are read")));
    }
    let (zooms, first) = zooms(&database).map_err(bad)?;
    let (path, database) = (path.to_owned(), Mutex::new(database));
    Ok(Arc::new(Archive { path, state, extension, zooms, first, database }))
}

/// Returns the zoom levels, finest first, and a tile of the finest one. The error is the reason.
fn zooms(database: &Database) -> Result<(Vec<Zoom>, WebTile), String> {
    // One pass over all tiles, in which SQLite sorts nothing.
    let tiles = database.query(|database| {
        let mut statement = database.prepare("SELECT zoom_level, tile_column, tile_row FROM tiles")?;
        let mut rows = statement.query([])?;
        let mut found: [Option<Zoom>; MAX_ZOOM as usize + 1] = [None; MAX_ZOOM as usize + 1];
        let mut first: Option<WebTile> = None;
        while let Some(row) = rows.next()? {
            let [zoom, x, row]: [i64; 3] = [row.get(0)?, row.get(1)?, row.get(2)?];
            let tile = match tile(zoom, x, row) {
                Ok(tile) => tile,
                Err(reason) => return Ok(Err(reason)),
            };
            let one = Zoom { zoom: tile.zoom, columns: [tile.x; 2], rows: [tile.y; 2] };
            let level = found[tile.zoom as usize].get_or_insert(one);
            let larger = |[low, high]: [usize; 2], n: usize| [low.min(n), high.max(n)];
            (level.columns, level.rows) = (larger(level.columns, tile.x), larger(level.rows, tile.y));
            if first.is_none_or(|first| tile.zoom > first.zoom) {
                first = Some(tile);
            }
        }
        Ok(Ok((found, first)))
    });
    let tiles = tiles.map_err(|reason| match reason.contains("no such table") {
        true => "a database without a table of tiles; a GeoPackage is not read, gdal_translate writes it as GeoTIFF"
            .to_owned(),
        false => reason,
    });
    let (found, first) = tiles??;
    Ok((found.into_iter().rev().flatten().collect(), first.ok_or("no tiles in it")?))
}

/// Returns the tile of a row of the table. The error is the reason.
fn tile(zoom: i64, x: i64, row: i64) -> Result<WebTile, String> {
    let level = u32::try_from(zoom).ok().filter(|zoom| *zoom <= MAX_ZOOM);
    let level = level.ok_or_else(|| format!("zoom level {zoom}; 0 to {MAX_ZOOM} are supported"))?;
    let side = 1i64 << level;
    match (0..side).contains(&x) && (0..side).contains(&row) {
        true => Ok(WebTile { zoom: level, x: x as usize, y: (side - 1 - row) as usize }),
        false => Err(format!("a tile of zoom level {zoom} outside of its {side} columns and rows")),
    }
}

impl WebTiles for Archive {
    fn zooms(&self) -> &[Zoom] {
        &self.zooms
    }

    fn first(&self) -> WebTile {
        self.first
    }

    fn read(&self, WebTile { zoom, x, y }: WebTile) -> Result<Option<Vec<u8>>, GenError> {
        self.state.check(&self.path)?;
        let row = (1u64 << zoom) - 1 - y as u64;
        let database = self.database.lock().unwrap_or_else(PoisonError::into_inner);
        let query = "SELECT tile_data FROM tiles WHERE zoom_level = ?1 AND tile_column = ?2 AND tile_row = ?3";
        let found = database.query(|database| {
            let mut statement = database.prepare_cached(query)?;
            let bytes = |row: &rusqlite::Row<'_>| {
                let bytes = row.get_ref(0)?.as_blob()?;
                Ok((bytes.len() <= MAX_TILE_BYTES).then(|| bytes.to_vec()))
            };
            statement.query_row((zoom, x as i64, row as i64), bytes).optional()
        });
        match found.map_err(|e| GenError::invalid(&self.path, format!("MBTiles: {e}")))? {
            Some(None) => Err(GenError::invalid(self.path(WebTile { zoom, x, y }), "a tile of more than 64 MiB")),
            found => Ok(found.flatten()),
        }
    }

    fn path(&self, WebTile { zoom, x, y }: WebTile) -> PathBuf {
        self.path.join(zoom.to_string()).join(x.to_string()).join(format!("{y}.{}", self.extension))
    }
}
