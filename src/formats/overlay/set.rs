//! [`OverlaySet`]: the overlays of a pager: which images a tile needs, and their composition.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use lru::LruCache;

use super::compose::{Canvas, PlacedImage};
use super::document::{self, ServerTiles, WmtsChoice};
use super::extent::Extent;
use super::grid::{Cover, GeoRectangle, MAX_TILES, TileGrid, TileIndex};
use super::images::{self, ImageCache};
use super::options::{OverlayError, OverlaySource, RasterOverlay};
use super::template::Template;
use crate::fetch::{IoError, Limits, RootScope, is_remote, resolve, server};
use crate::formats::ignored::Notes;
use crate::formats::options::Fetched;
use crate::scene::Texture;

/// The largest level that a template is asked for.
const MAX_LEVEL: u32 = 30;
/// The maximum number of overlays.
const MAX_OVERLAYS: usize = 16;
/// The maximum number of missing images that are named.
const MAX_NAMED: usize = 256;
/// The number of addresses that are known as those of overlays: more than can be in flight.
const MAX_ASKED: NonZeroUsize = NonZeroUsize::new(16_384).expect("not zero");
/// The kind of note for images that are missing.
pub(super) const MISSING: &str = "overlay: image that is missing or invalid";

/// An image, or the document of a server, that is missing.
#[derive(Clone, Debug, PartialEq)]
pub struct MissingImage {
    /// The last error, with the address.
    pub error: IoError,
    /// The number of tiles that wanted it.
    pub count: u64,
}

/// Overlays in order, the lowest first, for [`PagerConfig::overlays`](crate::pager::PagerConfig::overlays).
///
/// They cover height tiles and triangles of tiles on the earth. Loads of tiles include their images, so that changes take a
/// new pager, as changes of a style do. Clones of the `Arc` around it share decoded images. Any thread.
#[derive(Debug)]
pub struct OverlaySet {
    overlays: Vec<Overlay>,
    max_sse_px: Option<f64>,
    max_texture_px: u32,
    images: ImageCache,
    /// By URI. Locked briefly by decode threads.
    missing: Mutex<BTreeMap<String, MissingImage>>,
    missing_count: AtomicU64,
    /// The addresses that tiles needed last. Locked briefly by loading threads.
    asked: Mutex<LruCache<Arc<str>, ()>>,
}

/// An overlay at work.
#[derive(Debug)]
struct Overlay {
    options: RasterOverlay,
    /// The absolute address of the template, of the document or of the image.
    address: Arc<str>,
    /// Known from the beginning for templates and images, otherwise once the document was read.
    tiles: OnceLock<Result<ServerTiles, IoError>>,
    /// True once an image of it was composed onto a tile.
    is_used: AtomicBool,
}

impl OverlaySet {
    /// Creates a set of at most 16 overlays.
    ///
    /// # Errors
    /// [`OverlayError`] if the options of an overlay are invalid.
    pub fn new(overlays: Vec<RasterOverlay>) -> Result<Self, OverlayError> {
        if let Some(one) = overlays.get(MAX_OVERLAYS) {
            let reason = format!("there are more than {MAX_OVERLAYS} overlays");
            return Err(OverlayError { address: one.address().to_owned(), reason });
        }
        let failed = |address: &str, reason| OverlayError { address: address.to_owned(), reason };
        let overlays = overlays.into_iter().map(|options| {
            let address = options.address().to_owned();
            Overlay::new(options).map_err(|reason| failed(&address, reason))
        });
        Ok(Self {
            overlays: overlays.collect::<Result<_, _>>()?,
            max_sse_px: None,
            max_texture_px: 1024,
            images: ImageCache::new(64 << 20),
            missing: Mutex::default(),
            missing_count: AtomicU64::new(0),
            asked: Mutex::new(LruCache::new(MAX_ASKED)),
        })
    }

    /// Sets the screen-space error in pixels at which tiles are refined, if it is not the usual one: 3 for height tiles, 16
    /// for others. Images are chosen by it.
    pub fn with_max_sse_px(mut self, max_sse_px: f64) -> Self {
        self.max_sse_px = Some(max_sse_px).filter(|px| *px > 0.0);
        self
    }

    /// Sets the maximum width and height of a tile's texture, 1,024 by default.
    pub fn with_max_texture_px(mut self, max_texture_px: u32) -> Self {
        self.max_texture_px = max_texture_px.clamp(16, 8192);
        self
    }

    /// Sets the maximum bytes of decoded images that are kept for further tiles, 64 MiB by default.
    pub fn with_cache_bytes(mut self, cache_bytes: u64) -> Self {
        self.images = ImageCache::new(cache_bytes);
        self
    }

    /// Returns the attributions of the overlays that tiles show so far, in order, each once.
    pub fn credits(&self) -> Vec<Arc<str>> {
        let mut credits: Vec<Arc<str>> = Vec::new();
        for overlay in self.overlays.iter().filter(|overlay| overlay.is_used.load(Ordering::Relaxed)) {
            credits.extend(overlay.credit().filter(|credit| !credits.contains(credit)));
        }
        credits
    }

    /// Returns the images and documents that are missing or invalid, by address, at most 256 of them.
    pub fn missing(&self) -> Vec<MissingImage> {
        self.missing.lock().unwrap_or_else(PoisonError::into_inner).values().cloned().collect()
    }

    /// Returns how often an image or a document was missing or invalid.
    pub fn missing_count(&self) -> u64 {
        self.missing_count.load(Ordering::Relaxed)
    }

    /// Returns the bytes of decoded images that are kept.
    pub fn cache_bytes(&self) -> u64 {
        self.images.bytes()
    }

    /// Returns the addresses of the overlays on servers, one for each subdomain.
    pub(crate) fn remote_addresses(&self) -> impl Iterator<Item = String> {
        let all = self.overlays.iter().flat_map(|overlay| match &overlay.options.source {
            OverlaySource::Template { url, subdomains } if url.contains("{s}") => {
                subdomains.iter().map(|subdomain| overlay.address.replace("{s}", subdomain)).collect()
            }
            _ => vec![overlay.address.to_string()],
        });
        // What follows the host may have placeholders, which are no part of a URL.
        let bare = |address: String| format!("{}/", server(&address));
        all.filter(|address| is_remote(address)).map(bare)
    }

    /// Returns the texel size in metres that a tile's texture should have.
    ///
    /// A tile is refined when its geometric error covers `max_sse_px` pixels. Just before, a texel may cover two pixels, as in
    /// CesiumJS and cesium-native: `texel_m = 2 * geometric_error_m / max_sse_px`.
    fn texel_m(&self, extent: &Extent, is_height: bool) -> f64 {
        let max_sse_px = self.max_sse_px.unwrap_or(if is_height { 3.0 } else { 16.0 });
        2.0 * extent.geometric_error_m / max_sse_px
    }

    /// Returns the addresses that a tile needs next and that are not in `known`: documents, then images, then coarser images in
    /// place of those that are missing.
    pub(super) fn needed(&self, extent: &Extent, is_height: bool, known: &[Fetched], limits: &Limits) -> Vec<Arc<str>> {
        let mut needed: Vec<Arc<str>> = Vec::new();
        self.visit(extent, is_height, known, limits, |uri, known| {
            if known.is_none() && !needed.contains(uri) {
                needed.push(uri.clone());
            }
        });
        let mut asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        for uri in &needed {
            asked.put(uri.clone(), ());
        }
        needed
    }

    /// Returns what was fetched for the overlays of a tile among what was fetched for its content.
    pub(super) fn fetched(&self, extent: &Extent, is_height: bool, all: &[Fetched], limits: &Limits) -> Vec<Fetched> {
        let mut found: Vec<Fetched> = Vec::new();
        self.visit(extent, is_height, all, limits, |uri, known| {
            if let Some(known) = known
                && !found.iter().any(|(found, _)| found == uri)
            {
                found.push((uri.clone(), known.clone()));
            }
        });
        found
    }

    /// Calls `visit` with the address of each document and image that a tile needs, as far as `known` tells, and with what was
    /// fetched for it.
    fn visit(
        &self,
        extent: &Extent,
        is_height: bool,
        known: &[Fetched],
        limits: &Limits,
        mut visit: impl FnMut(&Arc<str>, Option<&Result<Vec<u8>, IoError>>),
    ) {
        let texel_m = self.texel_m(extent, is_height);
        let known_of = |uri: &str| known.iter().find(|(known, _)| **known == *uri).map(|(_, bytes)| bytes);
        for overlay in &self.overlays {
            if overlay.has_document() {
                let document = known_of(&overlay.address);
                if overlay.tiles.get().is_none() || document.is_some() {
                    visit(&overlay.address, document);
                }
                if let Some(Ok(bytes)) = document {
                    overlay.tiles.get_or_init(|| overlay.read_document(bytes));
                }
            }
            let Some(Ok(tiles)) = overlay.tiles.get() else { continue };
            let Some(cover) = tiles.grid.cover_for(texel_m, &extent.rectangle, self.max_texture_px) else { continue };
            for (column, row) in tiles_of(&cover) {
                let mut next = Some(tiles.grid.tile_at(&cover, column, row));
                while let Some(tile) = next {
                    let Ok(uri) = overlay.uri(tiles, tile) else { break };
                    let known = known_of(&uri);
                    visit(&uri, known);
                    next = match known {
                        None => None,
                        Some(Ok(bytes)) if images::check(&uri, bytes, tiles.tile_px(tile), limits).is_ok() => None,
                        Some(_) if self.images.contains(&uri) => None,
                        Some(_) => tiles.grid.coarser(tile),
                    };
                }
            }
        }
    }

    /// Returns true if an address is one that a tile needed lately.
    pub(crate) fn has_asked(&self, uri: &str) -> bool {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner).contains(uri)
    }

    /// Composes the overlays of a tile onto a texture of the rectangle `area`, over `own`. Returns `None` if there is no image.
    /// `extent` and `is_height` are those that the images were asked for with.
    pub(super) fn compose(
        &self,
        extent: &Extent,
        is_height: bool,
        area: GeoRectangle,
        own: Option<&Texture>,
        fetched: &[Fetched],
        limits: &Limits,
        notes: &Notes,
    ) -> Option<Canvas> {
        let texel_m = self.texel_m(extent, is_height);
        let mut layers = Vec::new();
        let mut size = own.map_or([0.0; 2], |own| [f64::from(own.width), f64::from(own.height)]);
        for overlay in &self.overlays {
            let Some(tiles) = overlay.known_tiles(fetched, self, notes) else { continue };
            let Some(cover) = tiles.grid.cover_for(texel_m, &extent.rectangle, self.max_texture_px) else { continue };
            let images = self.images_of(overlay, tiles, &cover, fetched, limits, notes);
            if images.iter().all(Option::is_none) {
                continue;
            }
            let [width, height] = tiles.grid.size_px(&cover, &area, texel_m);
            size = [size[0].max(width), size[1].max(height)];
            layers.push((overlay, tiles, cover, images));
        }
        if layers.is_empty() {
            return None;
        }
        let side = |px: f64| 1u32 << (px.max(4.0).log2().round() as u32).min(self.max_texture_px.ilog2());
        let mut canvas = Canvas::new(area, size.map(side));
        if let Some(own) = own {
            canvas.fill(own);
        }
        for (overlay, tiles, cover, images) in &layers {
            let sources: Vec<Option<PlacedImage<'_>>> = images
                .iter()
                .map(|found| found.as_ref().map(|(image, area)| PlacedImage { image, area: *area }))
                .collect();
            let Some(all) = tiles.grid.area_of_cover(cover) else { continue };
            canvas.draw(tiles.grid.tiling, cover, all, overlay.options.opacity, &sources);
            overlay.is_used.store(true, Ordering::Relaxed);
            overlay.credit().iter().for_each(|credit| notes.add_credit(credit));
        }
        Some(canvas)
    }

    /// Returns the image of each tile of a cover with its area, or that of a coarser tile.
    fn images_of(
        &self,
        overlay: &Overlay,
        tiles: &ServerTiles,
        cover: &Cover,
        fetched: &[Fetched],
        limits: &Limits,
        notes: &Notes,
    ) -> Vec<Option<(Arc<Texture>, super::grid::Area)>> {
        let of_tile = |(column, row)| {
            let first = tiles.grid.tile_at(cover, column, row);
            let mut next = Some(first);
            while let Some(tile) = next {
                match self.image(overlay, tiles, tile, fetched, limits) {
                    Ok(Some(image)) => {
                        // Coarser tiles across the antimeridian are moved with the finer ones.
                        let shift =
                            tiles.grid.continuous_area(cover, column, row)?.left - tiles.grid.area_of(first)?.left;
                        let area = tiles.grid.area_of(tile)?;
                        return Some((
                            image,
                            super::grid::Area { left: area.left + shift, right: area.right + shift, ..area },
                        ));
                    }
                    // It was not asked for.
                    Ok(None) => return None,
                    Err(error) => self.note_missing(error, notes),
                }
                next = tiles.grid.coarser(tile);
            }
            None
        };
        tiles_of(cover).map(of_tile).collect()
    }

    /// Returns an image: decoded before, or decoded now. `None` if it was not fetched.
    fn image(
        &self,
        overlay: &Overlay,
        tiles: &ServerTiles,
        tile: TileIndex,
        fetched: &[Fetched],
        limits: &Limits,
    ) -> Result<Option<Arc<Texture>>, IoError> {
        let uri = overlay.uri(tiles, tile)?;
        if let Some(image) = self.images.get(&uri) {
            return Ok(Some(image));
        }
        let Some((_, bytes)) = fetched.iter().find(|(known, _)| *known == uri) else { return Ok(None) };
        let bytes = bytes.as_ref().map_err(IoError::clone)?;
        images::check(&uri, bytes, tiles.tile_px(tile), limits)?;
        self.images.decode(&uri, bytes, limits).map(Some)
    }

    /// Counts and names what is missing.
    fn note_missing(&self, error: IoError, notes: &Notes) {
        notes.add_missing(MISSING, &error);
        self.missing_count.fetch_add(1, Ordering::Relaxed);
        let mut missing = self.missing.lock().unwrap_or_else(PoisonError::into_inner);
        if missing.is_empty() {
            log::warn!("overlay: {error}; further missing images are counted");
        }
        if missing.len() < MAX_NAMED || missing.contains_key(error.uri()) {
            let known =
                missing.entry(error.uri().to_owned()).or_insert(MissingImage { error: error.clone(), count: 0 });
            *known = MissingImage { error, count: known.count + 1 };
        }
    }
}

/// Returns the columns and rows of a cover, row by row.
fn tiles_of(cover: &Cover) -> impl Iterator<Item = (u32, u32)> + use<> {
    let (columns, rows) = (cover.columns, cover.rows);
    (0..rows).flat_map(move |row| (0..columns).map(move |column| (column, row))).take(MAX_TILES as usize)
}

impl ServerTiles {
    fn tile_px(&self, tile: TileIndex) -> Option<[u32; 2]> {
        self.grid.levels.get(tile.level)?.tile_px
    }
}

impl Overlay {
    /// Checks the options.
    fn new(options: RasterOverlay) -> Result<Self, String> {
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
        Ok(Self { address: address.into(), options, tiles, is_used: AtomicBool::new(false) })
    }

    /// Returns the attribution of the application, or that of the document.
    fn credit(&self) -> Option<Arc<str>> {
        let of_document = || self.tiles.get()?.as_ref().ok()?.credit.clone();
        self.options.credit.clone().or_else(of_document)
    }

    /// Returns true if a document says what tiles there are.
    fn has_document(&self) -> bool {
        matches!(self.options.source, OverlaySource::Tms { .. } | OverlaySource::Wmts { .. })
    }

    /// Returns the tiles if they are known; counts and names a document that is missing or invalid.
    fn known_tiles(&self, fetched: &[Fetched], set: &OverlaySet, notes: &Notes) -> Option<&ServerTiles> {
        match self.tiles.get() {
            Some(Ok(tiles)) => return Some(tiles),
            Some(Err(error)) => set.note_missing(error.clone(), notes),
            None => {
                let document = fetched.iter().find(|(uri, _)| *uri == self.address);
                if let Some((_, Err(error))) = document {
                    set.note_missing(error.clone(), notes);
                }
            }
        }
        None
    }

    fn read_document(&self, bytes: &[u8]) -> Result<ServerTiles, IoError> {
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
    fn uri(&self, tiles: &ServerTiles, tile: TileIndex) -> Result<Arc<str>, IoError> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn set(url: &str) -> OverlaySet {
        OverlaySet::new(vec![RasterOverlay { max_level: 10, ..RasterOverlay::template(url) }]).unwrap()
    }

    fn extent(edges: [f64; 4], geometric_error_m: f64) -> Extent {
        Extent { rectangle: GeoRectangle::from_degrees(edges).unwrap(), geometric_error_m }
    }

    fn png(side: u32) -> Vec<u8> {
        let mut bytes = std::io::Cursor::new(Vec::new());
        ::image::RgbImage::new(side, side).write_to(&mut bytes, ::image::ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn level_follows_the_error_of_the_tile() {
        let set = set("http://h/{z}/{x}/{y}.png");
        // At level 5, a pixel at the equator is 4,892 m; texels may be two of 16 pixels of error.
        let tile = extent([0.0, 0.0, 11.25, 10.0], 4892.0 * 8.0);
        let needed = set.needed(&tile, false, &[], &Limits::default());
        assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), ["http://h/5/16/15.png"]);
        let finer = extent([0.0, 0.0, 11.25, 10.0], 4892.0 * 4.0);
        assert_eq!(set.needed(&finer, false, &[], &Limits::default()).len(), 4);
        // Height tiles are refined at an error of three pixels.
        let height = extent([0.0, 0.0, 11.25, 10.0], 4892.0 * 1.5);
        assert_eq!(set.needed(&height, true, &[], &Limits::default()).len(), 1);
    }

    #[test]
    fn missing_images_are_replaced_by_coarser_ones() {
        let set = set("http://h/{z}/{x}/{y}.png");
        let tile = extent([0.0, 0.0, 11.25, 10.0], 4892.0 * 8.0);
        let mut known: Vec<Fetched> = Vec::new();
        for (expected, answer) in [
            ("http://h/5/16/15.png", Err(IoError::NotFound { uri: "x".to_owned() })),
            ("http://h/4/8/7.png", Ok(b"<html></html>".to_vec())),
            ("http://h/3/4/3.png", Ok(png(1))),
            ("http://h/2/2/1.png", Ok(Vec::new())),
            ("http://h/1/1/0.png", Ok(png(256))),
        ] {
            let needed = set.needed(&tile, false, &known, &Limits::default());
            assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), [expected]);
            known.push((expected.into(), answer));
        }
        assert!(set.needed(&tile, false, &known, &Limits::default()).is_empty());
        let notes = Notes::default();
        let area = tile.rectangle;
        let canvas = set.compose(&tile, false, area, None, &known, &Limits::default(), &notes).unwrap();
        assert!(canvas.is_opaque());
        assert_eq!((set.missing_count(), set.missing().len()), (4, 4));
        assert_eq!(notes.into_ignored().count(MISSING), 4);
        known.push(("http://h/tile.bin".into(), Ok(Vec::new())));
        assert_eq!(set.fetched(&tile, false, &known, &Limits::default()).len(), 5);
        assert!(set.has_asked("http://h/4/8/7.png") && !set.has_asked("http://h/tile.bin"));
    }

    #[test]
    fn invalid_options_are_named() {
        let error = |overlay| OverlaySet::new(vec![overlay]).unwrap_err().to_string();
        let good = RasterOverlay::template("http://h/{z}/{x}/{y}.png");
        for (overlay, part) in [
            (RasterOverlay { opacity: 1.5, ..good.clone() }, "opacity 1.5"),
            (RasterOverlay { min_level: 9, max_level: 3, ..good.clone() }, "levels 9 to 3"),
            (RasterOverlay { max_level: 31, ..good.clone() }, "beyond 30"),
            (RasterOverlay { tile_px: 0, ..good.clone() }, "tiles of 0 pixels"),
            (RasterOverlay::template("http://h/{z}.png"), "no placeholder for the column"),
        ] {
            let text = error(overlay);
            assert!(text.starts_with("overlay http://h/") && text.contains(part), "{text}");
        }
        assert!(OverlaySet::new(vec![good; 17]).is_err());
    }

    #[test]
    fn documents_come_first_and_lead_to_images() {
        let tms = r#"<TileMap><SRS>EPSG:3857</SRS><TileFormat width="256" height="256" extension="jpg"/><TileSets>
            <TileSet href="0" units-per-pixel="156543.03392804096" order="0"/></TileSets></TileMap>"#;
        let source = OverlaySource::Tms { document: "http://h/a/tilemapresource.xml?key=1".to_owned() };
        let set = OverlaySet::new(vec![RasterOverlay::new(source)]).unwrap();
        let tile = extent([0.0, 0.0, 11.25, 10.0], 1e6);
        let mut known = Vec::new();
        let needed = set.needed(&tile, false, &known, &Limits::default());
        assert_eq!(&*needed[0], "http://h/a/tilemapresource.xml?key=1");
        known.push((needed[0].clone(), Ok(tms.as_bytes().to_vec())));
        let needed = set.needed(&tile, false, &known, &Limits::default());
        assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), ["http://h/a/0/0/0.jpg"]);
    }
}
