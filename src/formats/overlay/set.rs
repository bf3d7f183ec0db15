//! [`OverlaySet`]: the overlays of a pager: which images a tile needs, and their composition.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use lru::LruCache;

use super::compose::{Canvas, PlacedImage};
use super::document::ServerTiles;
use super::extent::Extent;
use super::grid::{Area, Cover, GeoRectangle, MAX_TILES, TileIndex};
use super::images::{self, ImageCache};
#[cfg(feature = "http")]
use super::options::OverlaySource;
use super::options::{OverlayError, RasterOverlay};
use super::source::{Overlay, is_no_answer};
use crate::fetch::{Fetched, IoError, Limits};
#[cfg(feature = "http")]
use crate::fetch::{is_remote, server};
use crate::formats::ignored::Notes;
use crate::scene::Texture;

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
/// They cover height tiles and triangles of tiles on the earth. Loads of tiles include their images, so that tiles are loaded again
/// after a change ([`Viewer::set_overlays`](crate::viewer::Viewer::set_overlays)). Clones of the `Arc` around it share decoded
/// images. Any thread.
#[derive(Debug)]
pub struct OverlaySet {
    overlays: Vec<Overlay>,
    max_sse_px: Option<f64>,
    max_texture_px: u32,
    images: Arc<ImageCache>,
    /// By URI. Locked briefly by decode threads.
    missing: Mutex<BTreeMap<String, MissingImage>>,
    missing_count: AtomicU64,
    /// The addresses that tiles needed last. Locked briefly by loading threads.
    asked: Mutex<LruCache<Arc<str>, ()>>,
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
            images: Arc::new(ImageCache::new(64 << 20)),
            missing: Mutex::default(),
            missing_count: AtomicU64::new(0),
            asked: Mutex::new(LruCache::new(MAX_ASKED)),
        })
    }

    /// Returns a set of other overlays with the settings of this one, which shares its decoded images. What is known of the tiles of
    /// a server stays known, if only opacity or credit of its overlay differ.
    ///
    /// # Errors
    /// Those of [`Self::new`].
    pub fn with_overlays(&self, overlays: Vec<RasterOverlay>) -> Result<Self, OverlayError> {
        let new = Self::new(overlays)?;
        for overlay in &new.overlays {
            if let Some(tiles) = self.overlays.iter().find_map(|known| known.tiles_of(&overlay.options)) {
                // Templates and images know theirs already.
                let _ = overlay.tiles.set(Ok(tiles.clone()));
            }
        }
        let (max_sse_px, max_texture_px) = (self.max_sse_px, self.max_texture_px);
        Ok(Self { images: self.images.clone(), max_sse_px, max_texture_px, ..new })
    }

    /// Returns the overlays, the lowest first.
    pub fn overlays(&self) -> impl ExactSizeIterator<Item = &RasterOverlay> {
        self.overlays.iter().map(|overlay| &overlay.options)
    }

    /// Tells the overlays at which screen-space error in pixels the viewer refines tiles, if it is not the usual one: 3 for
    /// height tiles, 16 for others. Twice the value takes images one level coarser; refinement does not change.
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
        self.images = Arc::new(ImageCache::new(cache_bytes));
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
    #[cfg(feature = "http")]
    pub(crate) fn remote_addresses(&self) -> impl Iterator<Item = String> {
        let all = self.overlays.iter().flat_map(|overlay| match &overlay.options.source {
            OverlaySource::Template { url, subdomains } if url.contains("{s}") => {
                subdomains.iter().map(|subdomain| overlay.address.replace("{s}", subdomain)).collect()
            }
            _ => vec![overlay.address.to_string()],
        });
        // Placeholders may follow the host. They are no part of a URL.
        let bare = |address: String| format!("{}/", server(&address));
        all.filter(|address| is_remote(address)).map(bare)
    }

    /// Returns the texel size in metres that a tile's texture should have.
    ///
    /// A tile is refined when its geometric error covers `max_sse_px` pixels. Just before, a texel may cover two pixels, as in
    /// CesiumJS and cesium-native: `texel_m = 2 * geometric_error_m / max_sse_px`.
    fn texel_m(&self, extent: &Extent) -> f64 {
        let max_sse_px = self.max_sse_px.unwrap_or(if extent.is_height { 3.0 } else { 16.0 });
        2.0 * extent.geometric_error_m / max_sse_px
    }

    /// Returns the addresses that a tile needs next and that are not in `known`: documents, then images, then coarser images in
    /// place of those that are missing.
    pub(in crate::formats) fn needed(&self, extent: &Extent, known: &[Fetched], limits: &Limits) -> Vec<Arc<str>> {
        let mut needed: Vec<Arc<str>> = Vec::new();
        self.visit(extent, known, limits, |overlay, uri, known| {
            if known.is_none() && !needed.contains(uri) && !overlay.is_unreachable() {
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
    pub(in crate::formats) fn fetched(&self, extent: &Extent, all: &[Fetched], limits: &Limits) -> Vec<Fetched> {
        let mut found: Vec<Fetched> = Vec::new();
        self.visit(extent, all, limits, |_, uri, known| {
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
        known: &[Fetched],
        limits: &Limits,
        mut visit: impl FnMut(&Overlay, &Arc<str>, Option<&Result<Vec<u8>, IoError>>),
    ) {
        let texel_m = self.texel_m(extent);
        let known_of = |uri: &str| known.iter().find(|(known, _)| **known == *uri).map(|(_, bytes)| bytes);
        for overlay in &self.overlays {
            if overlay.has_document() {
                let document = known_of(&overlay.address);
                if overlay.tiles.get().is_none() || document.is_some() {
                    visit(overlay, &overlay.address, document);
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
                    visit(overlay, &uri, known);
                    next = match known {
                        None => None,
                        Some(Ok(bytes)) if images::check(&uri, bytes, tiles.tile_px(tile), limits).is_ok() => None,
                        Some(_) if self.images.contains(&uri) => None,
                        // It would not answer for coarser images either.
                        Some(Err(error)) if is_no_answer(error) => None,
                        Some(_) => tiles.grid.coarser(tile),
                    };
                }
            }
        }
    }

    /// Returns true if an address is one that a tile needed lately.
    #[cfg(any(test, feature = "http"))]
    pub(crate) fn has_asked(&self, uri: &str) -> bool {
        self.asked.lock().unwrap_or_else(PoisonError::into_inner).contains(uri)
    }

    /// Composes the overlays of a tile onto a texture of the rectangle `area`, over `own`. Returns `None` if there is no image.
    /// `extent` is that which the images were asked for with.
    pub(super) fn compose(
        &self,
        extent: &Extent,
        area: GeoRectangle,
        own: Option<&Texture>,
        fetched: &[Fetched],
        limits: &Limits,
        notes: &Notes,
    ) -> Option<Canvas> {
        let texel_m = self.texel_m(extent);
        let mut layers = Vec::new();
        let mut size = own.map_or([0.0; 2], |own| [f64::from(own.width), f64::from(own.height)]);
        for overlay in &self.overlays {
            let Some(tiles) = self.known_tiles(overlay, fetched, notes) else { continue };
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

    /// Returns the tiles of an overlay if they are known; counts and names a document that is missing or invalid.
    fn known_tiles<'a>(&self, overlay: &'a Overlay, fetched: &[Fetched], notes: &Notes) -> Option<&'a ServerTiles> {
        match overlay.tiles.get() {
            Some(Ok(tiles)) => return Some(tiles),
            Some(Err(error)) => self.note_missing(error.clone(), notes),
            None => {
                let document = fetched.iter().find(|(uri, _)| *uri == overlay.address);
                if let Some((_, Err(error))) = document {
                    overlay.note_answer(error);
                    self.note_missing(error.clone(), notes);
                }
            }
        }
        None
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
    ) -> Vec<Option<(Arc<Texture>, Area)>> {
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
                        return Some((image, Area { left: area.left + shift, right: area.right + shift, ..area }));
                    }
                    // It was not asked for. A coarser one may be decoded.
                    Ok(None) => {}
                    Err(error) => {
                        overlay.note_answer(&error);
                        self.note_missing(error, notes);
                    }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn set(url: &str) -> OverlaySet {
        OverlaySet::new(vec![RasterOverlay { max_level: 10, ..RasterOverlay::template(url) }]).unwrap()
    }

    fn extent(edges: [f64; 4], geometric_error_m: f64) -> Extent {
        Extent { rectangle: GeoRectangle::from_degrees(edges).unwrap(), geometric_error_m, is_height: false }
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
        let needed = set.needed(&tile, &[], &Limits::default());
        assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), ["http://h/5/16/15.png"]);
        let finer = extent([0.0, 0.0, 11.25, 10.0], 4892.0 * 4.0);
        assert_eq!(set.needed(&finer, &[], &Limits::default()).len(), 4);
        // Height tiles are refined at an error of three pixels.
        let height = Extent { is_height: true, ..extent([0.0, 0.0, 11.25, 10.0], 4892.0 * 1.5) };
        assert_eq!(set.needed(&height, &[], &Limits::default()).len(), 1);
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
            let needed = set.needed(&tile, &known, &Limits::default());
            assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), [expected]);
            known.push((expected.into(), answer));
        }
        assert!(set.needed(&tile, &known, &Limits::default()).is_empty());
        let notes = Notes::default();
        let area = tile.rectangle;
        let canvas = set.compose(&tile, area, None, &known, &Limits::default(), &notes).unwrap();
        assert!(canvas.is_opaque());
        assert_eq!((set.missing_count(), set.missing().len()), (4, 4));
        assert_eq!(notes.into_ignored().count(MISSING), 4);
        known.push(("http://h/tile.bin".into(), Ok(Vec::new())));
        assert_eq!(set.fetched(&tile, &known, &Limits::default()).len(), 5);
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
        let needed = set.needed(&tile, &known, &Limits::default());
        assert_eq!(&*needed[0], "http://h/a/tilemapresource.xml?key=1");
        known.push((needed[0].clone(), Ok(tms.as_bytes().to_vec())));
        let needed = set.needed(&tile, &known, &Limits::default());
        assert_eq!(needed.iter().map(|uri| &**uri).collect::<Vec<_>>(), ["http://h/a/0/0/0.jpg"]);
    }
}
