//! [`Overlay`]: an overlay at work: its tiles, once they are known, and the addresses of its images.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use super::document::{self, ServerTiles, WmtsChoice};
use super::grid::{GeoRectangle, TileGrid, TileIndex};
use super::options::{OverlaySource, RasterOverlay};
use super::template::Template;
use crate::fetch::{IoError, RootScope, is_remote, resolve};

/// The largest level that a template is asked for.
const MAX_LEVEL: u32 = 30;
/// How long a server is not asked again after it did not answer.
const MAX_UNREACHABLE: Duration = Duration::from_secs(30);

/// An overlay at work.
#[derive(Debug)]
pub(super) struct Overlay {
    pub options: RasterOverlay,
    /// The absolute address of the template, of the document or of the image.
    pub address: Arc<str>,
    /// Known from the beginning for templates and images, otherwise once the document was read.
    pub tiles: OnceLock<Result<ServerTiles, IoError>>,
    /// True once an image of it was composed onto a tile.
    pub is_used: AtomicBool,
    /// When its server last did not answer. Locked briefly by decode and loading threads.
    unreachable_since: Mutex<Option<Instant>>,
}

impl ServerTiles {
    pub fn tile_px(&self, tile: TileIndex) -> Option<[u32; 2]> {
        self.grid.levels.get(tile.level)?.tile_px
    }
}

/// The images that a document of a map server leads to.
pub(in crate::formats) struct DocumentImages {
    overlay: Overlay,
    tiles: ServerTiles,
}

impl DocumentImages {
    /// Reads a document.
    pub fn new(uri: &str, bytes: &[u8], is_wmts: bool) -> Result<Self, IoError> {
        let document = uri.to_owned();
        let source = match is_wmts {
            true => OverlaySource::Wmts { document, layer: None, style: None, matrix_set: None },
            false => OverlaySource::Tms { document },
        };
        let options = RasterOverlay { max_level: MAX_LEVEL, ..RasterOverlay::new(source) };
        let overlay = Overlay::new(options).map_err(|reason| IoError::invalid(uri, reason))?;
        let tiles = overlay.read_document(bytes)?;
        Ok(Self { overlay, tiles })
    }

    /// Returns the number of images.
    pub fn count(&self) -> u64 {
        self.tiles.level_counts().iter().fold(0, |all, count| all.saturating_add(*count))
    }

    /// Returns the addresses of the images, the coarsest first, with their size in pixels.
    pub fn uris(&self) -> impl Iterator<Item = (Result<Arc<str>, IoError>, Option<[u32; 2]>)> + '_ {
        let grid = &self.tiles.grid;
        let rectangle = grid.rectangle.unwrap_or(GeoRectangle::WORLD);
        let covers = (0..grid.levels.len()).filter_map(move |level| grid.cover(level, &rectangle));
        covers.flat_map(move |cover| {
            let level = &grid.levels[cover.level];
            (0..cover.rows).flat_map(move |row| {
                (0..cover.columns).map(move |column| {
                    let column = (cover.first_column + i64::from(column)).rem_euclid(i64::from(level.columns)) as u32;
                    let tile = TileIndex { level: cover.level, column, row: cover.first_row + row };
                    (self.overlay.uri(&self.tiles, tile), level.tile_px)
                })
            })
        })
    }
}

/// Returns true if a server did not answer at all.
pub(super) fn is_no_answer(error: &IoError) -> bool {
    matches!(error, IoError::Timeout { .. } | IoError::Network { .. })
}

impl Overlay {
    /// Checks the options.
    pub fn new(options: RasterOverlay) -> Result<Self, String> {
        let RasterOverlay { min_level, max_level, tile_px, opacity, rectangle, tiling, .. } = options;
        if min_level > max_level || max_level > MAX_LEVEL {
            return Err(format!("levels {min_level} to {max_level} are not in order, or beyond {MAX_LEVEL}"));
        }
        if !(1..=8192).contains(&tile_px) {
            return Err(format!("tiles of {tile_px} pixels, expected 1 to 8192"));
        }
        if !(0.0..=1.0).contains(&opacity) {
            return Err(format!("opacity {opacity} is not from 0 to 1"));
        }
        let absolute = |address: &str| match is_remote(address) {
            true => Ok(address.to_owned()),
            false => {
                let path = std::path::absolute(address).map_err(|error| error.to_string())?;
                path.to_str().map(str::to_owned).ok_or_else(|| "the path is not UTF-8".to_owned())
            }
        };
        let address = absolute(options.address())?;
        let tiles = OnceLock::new();
        let known = match &options.source {
            OverlaySource::Template { subdomains, .. } => {
                let template = Template::new(&address, subdomains)?;
                let grid = TileGrid { rectangle, ..TileGrid::world(tiling, min_level..=max_level, tile_px) };
                Some(ServerTiles { grid, template, credit: None })
            }
            OverlaySource::Image { rectangle, .. } => {
                let is_valid = rectangle.width() > 0.0 && rectangle.height() > 0.0;
                if !is_valid {
                    return Err("the rectangle of the image is empty".to_owned());
                }
                let grid = TileGrid::image(tiling, *rectangle);
                Some(ServerTiles { grid, template: Template::one(&address), credit: None })
            }
            OverlaySource::Tms { .. } | OverlaySource::Wmts { .. } => None,
        };
        if let Some(known) = known {
            // The cell is empty.
            let _ = tiles.set(Ok(known));
        }
        let (is_used, unreachable_since) = (AtomicBool::new(false), Mutex::default());
        Ok(Self { address: address.into(), options, tiles, is_used, unreachable_since })
    }

    /// Notes whether the server did not answer.
    pub fn note_answer(&self, error: &IoError) {
        if is_no_answer(error) {
            *self.unreachable_since.lock().unwrap_or_else(PoisonError::into_inner) = Some(Instant::now());
        }
    }

    /// Returns true for [`MAX_UNREACHABLE`] after the server did not answer: tiles do not wait for it one after the other.
    pub fn is_unreachable(&self) -> bool {
        let since = *self.unreachable_since.lock().unwrap_or_else(PoisonError::into_inner);
        since.is_some_and(|since| since.elapsed() < MAX_UNREACHABLE)
    }

    /// Returns the attribution of the application, or that of the document.
    pub fn credit(&self) -> Option<Arc<str>> {
        let of_document = || self.tiles.get()?.as_ref().ok()?.credit.clone();
        self.options.credit.clone().or_else(of_document)
    }

    /// Returns the tiles if they are known and are those of `other`.
    pub fn tiles_of(&self, other: &RasterOverlay) -> Option<&ServerTiles> {
        let RasterOverlay { opacity, credit, .. } = self.options.clone();
        let is_same = RasterOverlay { opacity, credit, ..other.clone() } == self.options;
        self.tiles.get()?.as_ref().ok().filter(|_| is_same)
    }

    /// Returns true if a document says what tiles there are.
    pub fn has_document(&self) -> bool {
        matches!(self.options.source, OverlaySource::Tms { .. } | OverlaySource::Wmts { .. })
    }

    pub fn read_document(&self, bytes: &[u8]) -> Result<ServerTiles, IoError> {
        let read = match &self.options.source {
            OverlaySource::Wmts { layer, style, matrix_set, .. } => {
                let choice =
                    WmtsChoice { layer: layer.as_deref(), style: style.as_deref(), matrix_set: matrix_set.as_deref() };
                document::read_wmts(bytes, choice)
            }
            _ => document::read_tms(bytes),
        };
        let mut tiles = read.map_err(|reason| IoError::invalid(&self.address, reason))?;
        let RasterOverlay { min_level, max_level, rectangle, .. } = self.options;
        let last = tiles.grid.levels.len().saturating_sub(1);
        tiles.grid.levels.truncate((max_level as usize).min(last) + 1);
        tiles.grid.levels.drain(..(min_level as usize).min(tiles.grid.levels.len() - 1));
        tiles.grid.rectangle = rectangle.or(tiles.grid.rectangle);
        // A reference that leads nowhere is an error of the document.
        self.uri(&tiles, TileIndex { level: 0, column: 0, row: 0 })?;
        Ok(tiles)
    }

    /// Returns the address of a tile. References of a document on a server lead to servers, those of a file to its folder
    /// or to servers.
    pub fn uri(&self, tiles: &ServerTiles, tile: TileIndex) -> Result<Arc<str>, IoError> {
        let reference = tiles.template.url(&tiles.grid, tile);
        if !self.has_document() {
            return Ok(reference.into());
        }
        if !is_remote(&self.address) {
            return match is_remote(&reference) {
                true => Ok(reference.into()),
                false => resolve(&self.address, &reference, &RootScope::of(&self.address)),
            };
        }
        let bad = |reason: String| IoError::Uri { uri: reference.clone(), reason };
        let base = url::Url::parse(&self.address).map_err(|error| bad(error.to_string()))?;
        let url = base.join(&reference).map_err(|error| bad(error.to_string()))?;
        match url.scheme() {
            "https" => Ok(url.as_str().into()),
            "http" if base.scheme() == "http" => Ok(url.as_str().into()),
            scheme => Err(bad(format!("scheme {scheme} is not allowed in the overlay {}", self.address))),
        }
    }
}
