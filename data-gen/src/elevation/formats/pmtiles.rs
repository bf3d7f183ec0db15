//! PMTiles archives of Terrain-RGB or Terrarium PNGs, read tile by tile. The library reads the tiles; the header's zoom levels
//! and bounds are read here (PMTiles version 3).

use std::io::Read as _;
use std::path::{Path, PathBuf};

use terrane::fetch::{FileReader, IoError, Limits};

use super::web_tiles::{TileBytes, image};
use super::{Opened, RasterOptions};
use crate::GenError;
use crate::store::FileState;

const HEADER_BYTES: usize = 127;
/// The code of PNG among the types of tiles.
const PNG: u8 = 2;
/// The deepest zoom level that is read.
const MAX_ZOOM: u8 = 24;
/// Steps of the bounds in the header: ten-millionths of a degree.
const DEGREE: f64 = 1e7;

/// The tiles of the finest zoom level of an archive.
struct Archive {
    path: PathBuf,
    /// The path as text, which the library continues by the name of a tile.
    text: String,
    zoom: u8,
    reader: FileReader,
    state: FileState,
}

/// Opens the tiles of the finest zoom level of an archive as one image.
pub(super) fn open(path: &Path, options: &RasterOptions) -> Result<Opened, GenError> {
    let bad = |reason: String| GenError::invalid(path, format!("PMTiles: {reason}"));
    let state = FileState::of(path)?;
    let mut header = [0; HEADER_BYTES];
    let mut file = std::fs::File::open(path).map_err(GenError::file(path))?;
    file.read_exact(&mut header).map_err(|_| bad("shorter than its header".to_owned()))?;
    let text = path.to_str().filter(|text| text.to_ascii_lowercase().ends_with(".pmtiles"));
    let text = text.ok_or_else(|| bad("the name of an archive ends with .pmtiles, in UTF-8".to_owned()))?.to_owned();
    if header[99] != PNG {
        return Err(bad(format!("tiles of type {}; elevation is read from PNGs, type 2", header[99])));
    }
    let zoom = header[101];
    if zoom > MAX_ZOOM {
        return Err(bad(format!("zoom level {zoom}; 0 to {MAX_ZOOM} are supported")));
    }
    let [columns, rows] = tile_range(&header, zoom);
    let archive = Archive { path: path.to_owned(), text, zoom, reader: FileReader::new(Limits::default()), state };
    // Bounds may be larger than the tiles.
    let mut tiles = (rows[0]..=rows[1]).flat_map(|y| (columns[0]..=columns[1]).map(move |x| [x, y]));
    let first = tiles.find_map(|tile| archive.read(tile).map(|found| found.map(|_| tile)).transpose()).transpose()?;
    let first = first.ok_or_else(|| bad(format!("no tile of zoom level {zoom} within the bounds of the header")))?;
    image(Box::new(archive), zoom.into(), [columns, rows], first, options)
}

/// Returns the first and the last column and row of the tiles that the bounds in a header touch. Bounds that are not valid stand
/// for the whole earth.
fn tile_range(header: &[u8; HEADER_BYTES], zoom: u8) -> [[usize; 2]; 2] {
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

impl TileBytes for Archive {
    fn read(&self, [x, y]: [usize; 2]) -> Result<Option<Vec<u8>>, GenError> {
        self.state.check(&self.path)?;
        match self.reader.read(&format!("{}/{}/{x}/{y}.png", self.text, self.zoom)) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(IoError::NotFound { .. }) => Ok(None),
            Err(e) => Err(GenError::invalid(&self.path, e.to_string())),
        }
    }

    fn path(&self, [x, y]: [usize; 2]) -> PathBuf {
        self.path.join(self.zoom.to_string()).join(x.to_string()).join(format!("{y}.png"))
    }

    fn is_missing(&self, _tile: [usize; 2]) -> bool {
        false
    }
}
