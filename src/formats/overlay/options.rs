//! [`RasterOverlay`]: what an application says about an overlay.

use std::sync::Arc;

use super::grid::{GeoRectangle, Tiling};

/// The source of an overlay's images. Addresses are http(s) URLs or paths of files.
#[derive(Clone, Debug, PartialEq)]
pub enum OverlaySource {
    /// Tiles with addresses that follow a template. Its placeholders are `{z}`, `{x}` and `{y}` for level, column and row
    /// from the north, `{-y}` or `{reverseY}` for the row from the south, and `{s}` for one of the subdomains. Those of
    /// RESTful WMTS are known too: `{TileMatrix}`, `{TileCol}` and `{TileRow}`.
    Template {
        /// The template.
        url: String,
        /// The texts that replace `{s}` in turn, such as `a`, `b` and `c`.
        subdomains: Vec<String>,
    },
    /// A Tile Map Service, by its tilemapresource.xml.
    Tms {
        /// The address of the document.
        document: String,
    },
    /// A Web Map Tile Service, by its capabilities.
    Wmts {
        /// The address of the document.
        document: String,
        /// The layer; the first if `None`.
        layer: Option<String>,
        /// The style; the default of the layer if `None`.
        style: Option<String>,
        /// The tile matrix set; the first of the layer with a projection that is supported if `None`.
        matrix_set: Option<String>,
    },
    /// One image.
    Image {
        /// The address of a PNG, JPEG or WebP, north up.
        address: String,
        /// The longitudes and latitudes of its edges.
        rectangle: GeoRectangle,
    },
}

/// Images that are draped over tile sets.
#[derive(Clone, Debug, PartialEq)]
pub struct RasterOverlay {
    /// The source of the images.
    pub source: OverlaySource,
    /// The projection of a template or of an image. The documents of TMS and WMTS name their own.
    pub tiling: Tiling,
    /// The coarsest level that is requested, at most 30. Documents: the number of levels that are left out at the coarse end.
    pub min_level: u32,
    /// The finest level that is requested, at most 30.
    pub max_level: u32,
    /// Width and height of a template's tiles in pixels. With a level's extent they give the size of a pixel on the ground,
    /// which is compared with the texels that a tile needs. Images may be two or four times as large or as small.
    pub tile_px: u32,
    /// The rectangle that has images; `None` for all of the earth, or for the bounds in a document.
    pub rectangle: Option<GeoRectangle>,
    /// The opacity, 0 to 1.
    pub opacity: f32,
    /// The attribution that is shown while the overlay is visible; `None` for that of a document.
    pub credit: Option<Arc<str>>,
}

impl RasterOverlay {
    /// Creates an opaque overlay of Web Mercator tiles of 256 pixels, levels 0 to 18.
    pub fn new(source: OverlaySource) -> Self {
        Self {
            source,
            tiling: Tiling::WebMercator,
            min_level: 0,
            max_level: 18,
            tile_px: 256,
            rectangle: None,
            opacity: 1.0,
            credit: None,
        }
    }

    /// Creates an overlay of tiles whose addresses follow a template; see [`OverlaySource::Template`].
    pub fn template(url: &str) -> Self {
        Self::new(OverlaySource::Template { url: url.to_owned(), subdomains: Vec::new() })
    }

    /// Returns the address of the overlay: its template, its document or its image.
    pub fn address(&self) -> &str {
        match &self.source {
            OverlaySource::Template { url, .. } => url,
            OverlaySource::Tms { document } | OverlaySource::Wmts { document, .. } => document,
            OverlaySource::Image { address, .. } => address,
        }
    }
}

/// An overlay that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("overlay {address}: {reason}")]
pub struct OverlayError {
    /// The address of the overlay.
    pub address: String,
    /// The reason.
    pub reason: String,
}
