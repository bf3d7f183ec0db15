//! MBTiles archives: a SQLite database with a row for each tile. Rows of tiles count from the south.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use rusqlite::{Connection, OpenFlags, OptionalExtension as _};

use super::{MAX_ZOOM, TileContent, WebTile, WebTiles, Zoom};
use crate::GenError;
use crate::store::FileState;

/// The largest encoded tile in bytes.
const MAX_TILE_BYTES: usize = 64 << 20;

/// An archive.
struct Archive {
    path: PathBuf,
    state: FileState,
    extension: String,
    zooms: Vec<Zoom>,
    first: WebTile,
    /// Locked while the bytes of a tile are read.
    database: Mutex<Connection>,
}

/// Opens an archive and finds its zoom levels.
pub(super) fn open(path: &Path, content: TileContent) -> Result<Arc<dyn WebTiles>, GenError> {
    let bad = |reason: String| GenError::invalid(path, format!("MBTiles: {reason}"));
    let failed = |e: rusqlite::Error| bad(e.to_string());
    let state = FileState::of(path)?;
    let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let database = Connection::open_with_flags(path, flags).map_err(failed)?;
    let format = database.query_row("SELECT value FROM metadata WHERE name = 'format'", [], |row| row.get(0));
    let format: Option<String> = format.optional().unwrap_or_default();
    let extension = format.unwrap_or_else(|| "png".to_owned()).to_ascii_lowercase();
    if !content.extensions().contains(&extension.as_str()) {
        let known = content.extensions().join(", ");
        return Err(bad(format!("tiles of format {extension}; {known} are read")));
    }
    let mut zooms = Vec::new();
    {
        let ranges = "SELECT zoom_level, min(tile_column), max(tile_column), min(tile_row), max(tile_row) FROM tiles \
                      GROUP BY zoom_level ORDER BY zoom_level DESC";
        let mut statement = database.prepare(ranges).map_err(failed)?;
        let mut rows = statement.query([]).map_err(failed)?;
        while let Some(row) = rows.next().map_err(failed)? {
            let number = |k: usize| row.get::<_, i64>(k);
            let found = (|| Ok([number(0)?, number(1)?, number(2)?, number(3)?, number(4)?]))().map_err(failed)?;
            let [zoom, first_column, last_column, southern, northern] = found;
            let zoom = u32::try_from(zoom).ok().filter(|zoom| *zoom <= MAX_ZOOM);
            let zoom = zoom.ok_or_else(|| bad(format!("zoom level {}; 0 to {MAX_ZOOM} are supported", found[0])))?;
            let side = 1i64 << zoom;
            if first_column < 0 || last_column >= side || southern < 0 || northern >= side {
                return Err(bad(format!("a tile of zoom level {zoom} outside of its {side} columns and rows")));
            }
            let columns = [first_column as usize, last_column as usize];
            let rows = [(side - 1 - northern) as usize, (side - 1 - southern) as usize];
            zooms.push(Zoom { zoom, columns, rows });
        }
    }
    let Some(finest) = zooms.first() else { return Err(bad("no tiles in it".to_owned())) };
    let first = "SELECT tile_column, tile_row FROM tiles WHERE zoom_level = ?1 LIMIT 1";
    let first = database.query_row(first, [finest.zoom], |row| Ok([row.get::<_, i64>(0)?, row.get(1)?]));
    let [x, row] = first.map_err(failed)?;
    let first = WebTile { zoom: finest.zoom, x: x as usize, y: ((1i64 << finest.zoom) - 1 - row) as usize };
    let (path, database) = (path.to_owned(), Mutex::new(database));
    Ok(Arc::new(Archive { path, state, extension, zooms, first, database }))
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
        let found = database.prepare_cached(query).and_then(|mut statement| {
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
