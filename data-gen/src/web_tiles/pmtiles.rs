//! PMTiles archives, on disks and on servers, read tile by tile. The library reads the tiles; the header's zoom levels and
//! bounds are read here (PMTiles version 3).

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use terrane::fetch::{FileReader, IoError, Limits};

use super::{MAX_ZOOM, TileContent, WebTile, WebTiles, Zoom};
use crate::GenError;
use crate::store::{BlockCache, FileState, RemoteBytes, is_remote};

const HEADER_BYTES: usize = 127;
/// The codes of types of tiles.
const PNG: u8 = 2;
const JPEG: u8 = 3;
const WEBP: u8 = 4;
/// The most places of the finest zoom level that are tried to find a tile: 256 columns and rows.
const MAX_TRIES: usize = 1 << 16;
/// Steps of the bounds in the header: ten-millionths of a degree.
const DEGREE: f64 = 1e7;

/// An archive.
struct Archive {
    path: PathBuf,
    /// The path as text, which the library continues by the name of a tile, and the query of an address.
    text: [String; 2],
    extension: &'static str,
    zooms: Vec<Zoom>,
    first: WebTile,
    bytes: Bytes,
}

/// The place of an archive: on a disk or on a server.
enum Bytes {
    File(FileReader, FileState),
    Server(Arc<BlockCache>),
}

/// Opens an archive and reads its header.
pub(super) fn open(path: &Path, content: TileContent, cache: &Arc<BlockCache>) -> Result<Arc<dyn WebTiles>, GenError> {
    let bad = |reason: String| GenError::invalid(path, format!("PMTiles: {reason}"));
    let short = || bad("shorter than its header".to_owned());
    let (bytes, header) = match is_remote(path) {
        true => {
            let head = RemoteBytes::open(path, cache)?;
            (Bytes::Server(Arc::clone(cache)), head.head().first_chunk::<HEADER_BYTES>().copied().ok_or_else(short)?)
        }
        false => {
            let state = FileState::of(path)?;
            let mut header = [0; HEADER_BYTES];
            let mut file = std::fs::File::open(path).map_err(GenError::file(path))?;
            file.read_exact(&mut header).map_err(|_| short())?;
            (Bytes::File(FileReader::new(Limits::default()), state), header)
        }
    };
    let text = path.to_str().unwrap_or_default();
    let at = if is_remote(path) { text.find(['?', '#']).unwrap_or(text.len()) } else { text.len() };
    let text = [&text[..at], &text[at..]].map(str::to_owned);
    if !text[0].to_ascii_lowercase().ends_with(".pmtiles") {
        return Err(bad("the name of an archive ends with .pmtiles, in UTF-8".to_owned()));
    }
    let extension = match (content, header[99]) {
        (_, PNG) => "png",
        (TileContent::Colors, JPEG) => "jpg",
        (TileContent::Colors, WEBP) => "webp",
        (TileContent::Heights, kind) => {
            return Err(bad(format!("tiles of type {kind}; elevation is read from PNGs, type {PNG}")));
        }
        (TileContent::Colors, kind) => {
            let reason =
                format!("tiles of type {kind}; imagery is read from PNG, JPEG and WebP, types {PNG} to {WEBP}");
            return Err(bad(reason));
        }
    };
    let [coarsest, finest] = [header[100], header[101]].map(u32::from);
    if finest > MAX_ZOOM {
        return Err(bad(format!("zoom level {finest}; 0 to {MAX_ZOOM} are supported")));
    }
    let zooms = (coarsest.min(finest)..=finest).rev().map(|zoom| {
        let [columns, rows] = tile_range(&header, zoom);
        Zoom { zoom, columns, rows }
    });
    let first = WebTile { zoom: finest, x: 0, y: 0 };
    let mut archive = Archive { path: path.to_owned(), text, extension, zooms: zooms.collect(), first, bytes };
    let Zoom { columns, rows, .. } = archive.zooms[0];
    // Bounds may be larger than the tiles.
    let first = spread(columns, rows).take(MAX_TRIES).find_map(|[x, y]| {
        let tile = WebTile { zoom: finest, x, y };
        archive.read(tile).map(|found| found.map(|_| tile)).transpose()
    });
    let none = || bad(format!("no tile of zoom level {finest} within the bounds of the header"));
    archive.first = first.transpose()?.ok_or_else(none)?;
    Ok(Arc::new(archive))
}

/// Returns all columns and rows of a range, those that lie far apart first.
fn spread([west, east]: [usize; 2], [north, south]: [usize; 2]) -> impl Iterator<Item = [usize; 2]> {
    let coarsest = ((east - west).max(south - north) + 1).next_power_of_two().ilog2();
    (0..=coarsest).rev().flat_map(move |level| {
        let step = 1 << level;
        let rows = (north..=south).step_by(step);
        let all = rows.flat_map(move |y| (west..=east).step_by(step).map(move |x| [x, y]));
        // The coarser steps had every second column and row.
        all.filter(move |[x, y]| level == coarsest || [x - west, y - north].iter().any(|n| n / step % 2 == 1))
    })
}

/// Returns the first and the last column and row of the tiles that the bounds in a header touch. Bounds that are not valid stand
/// for the whole earth.
fn tile_range(header: &[u8; HEADER_BYTES], zoom: u32) -> [[usize; 2]; 2] {
    let degrees = |at: usize| {
        let bytes = [header[at], header[at + 1], header[at + 2], header[at + 3]];
        f64::from(i32::from_le_bytes(bytes)) / DEGREE
    };
    let [west, south, east, north] = [102, 106, 110, 114].map(degrees);
    let side = f64::from(1u32 << zoom);
    let row = |latitude: f64| {
        let latitude = latitude.clamp(-85.06, 85.06).to_radians();
        side * (0.5 - latitude.tan().asinh() / std::f64::consts::TAU)
    };
    let column = |longitude: f64| side * (longitude + 180.0) / 360.0;
    // An edge of the bounds may lie on an edge of tiles, but for rounding.
    let tiles = |low: f64, high: f64| {
        let tolerance = 1e-6 * side.clamp(1.0, 1e3);
        let first = (low + tolerance).floor().clamp(0.0, side - 1.0);
        let last = ((high - tolerance).ceil() - 1.0).clamp(first, side - 1.0);
        [first as usize, last as usize]
    };
    let is_valid = west < east && south < north;
    match is_valid {
        true => [tiles(column(west), column(east)), tiles(row(north), row(south))],
        false => [[0, side as usize - 1]; 2],
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
        let [archive, query] = &self.text;
        let uri = format!("{archive}/{zoom}/{x}/{y}.{}{query}", self.extension);
        match &self.bytes {
            Bytes::Server(cache) => cache.servers().member(&self.path, &uri),
            Bytes::File(reader, state) => {
                state.check(&self.path)?;
                match reader.read(&uri) {
                    Ok(bytes) => Ok(Some(bytes)),
                    Err(IoError::NotFound { .. }) => Ok(None),
                    Err(e) => Err(GenError::invalid(&self.path, e.reason())),
                }
            }
        }
    }

    fn path(&self, WebTile { zoom, x, y }: WebTile) -> PathBuf {
        self.path.join(zoom.to_string()).join(x.to_string()).join(format!("{y}.{}", self.extension))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_places_are_tried_once() {
        for (columns, rows) in [([0, 0], [0, 0]), ([3, 9], [5, 6]), ([0, 15], [0, 15]), ([7, 7], [0, 20])] {
            let mut tried: Vec<_> = spread(columns, rows).collect();
            assert_eq!(tried[0], [columns[0], rows[0]]);
            tried.sort_unstable();
            let all = (columns[0]..=columns[1]).flat_map(|x| (rows[0]..=rows[1]).map(move |y| [x, y]));
            assert!(tried.into_iter().eq(all), "{columns:?} {rows:?}");
        }
    }
}
