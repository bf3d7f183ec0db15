//! [`LoadedRoot`]: a root tile set that was read, with the pager that loads the rest of it. Any thread.

use std::sync::Arc;

use crate::fetch::{self, IoError};
use crate::formats;
use crate::math::BoundingVolume;
use crate::pager::{DatabasePager, PagerConfig};
use crate::scene::{BlockFormats, NodeKind, Page};
use crate::viewer::ViewerError;
use crate::viewer::view::set_bounds::{is_globe, whole_body};

/// The name of the root that [`LoadedRoot::ellipsoid`] returns.
const GLOBE: &str = "globe";
/// The depth below the ellipsoid that its coarsest triangles stay above, as a share of its radius.
const GLOBE_DEPTH: f64 = 10_000.0 / 6_378_137.0;

/// A root tile set that was read, and the pager that loads the rest of it. It can be read before a viewer exists, for
/// example while a window opens; see [`Viewer::set_root`](crate::viewer::Viewer::set_root).
pub struct LoadedRoot {
    pub(super) pager: DatabasePager,
    pub(super) page: Page,
    pub(super) uri: Arc<str>,
    /// The geographic region that a local root declares; a page keeps only the box around it.
    pub(super) region: Option<BoundingVolume>,
}

impl LoadedRoot {
    /// Starts a pager, with its threads and caches, and reads the root of a folder, file or URL with it. Blocks until the
    /// root is read. The pager is kept: the viewer loads the tiles below the root with it, over the same connections and
    /// with the same limits and credentials.
    ///
    /// A root that is a model itself holds its KTX2 images as RGBA8, since no adapter is known;
    /// [`Viewer::load`](crate::viewer::Viewer::load) holds them compressed. Tiles below a root are compressed in either case.
    pub fn read(source: &str, config: &PagerConfig) -> Result<Self, ViewerError> {
        Self::read_for(source, config, BlockFormats::NONE)
    }

    /// Returns the surface of the configuration's ellipsoid as a root. Nothing is read: its tiles are computed when they are
    /// wanted, and a pager is started for them.
    pub fn ellipsoid(config: &PagerConfig) -> Result<Self, ViewerError> {
        let uri: Arc<str> = GLOBE.into();
        let ellipsoid = config.ellipsoid;
        // Overlays ask for the position on the earth, which only the contents of a tileset have.
        let options = formats::ReadOptions {
            chain: Arc::new([uri.clone()]),
            ellipsoid,
            ..formats::ReadOptions::for_root(&uri, config.limits)
        };
        let pager = DatabasePager::new(config.clone(), options)?;
        let page = Page::from_node(formats::ellipsoid(ellipsoid));
        let mut page = page.map_err(|error| IoError::Uri { uri: uri.to_string(), reason: error.to_string() })?;
        page.set_ellipsoid(ellipsoid);
        let region = whole_body(ellipsoid, [-GLOBE_DEPTH * ellipsoid.semi_major_m, 0.0]);
        Ok(Self { pager, page, uri, region: Some(region) })
    }

    /// Does the same as [`Self::read`], with the compressed formats that a root's own images may have.
    pub(super) fn read_for(source: &str, config: &PagerConfig, formats: BlockFormats) -> Result<Self, ViewerError> {
        let uri = fetch::root_uri_within(source, config.limits.file_timeout)?;
        let options = formats::ReadOptions {
            block_formats: formats,
            ellipsoid: config.ellipsoid,
            ..formats::ReadOptions::for_root(&uri, config.limits)
        };
        let mut pager = DatabasePager::new(config.clone(), options.clone())?;
        let page = pager.read_root(&uri)?;
        // The second read of the root adds nothing to the list of what is left out.
        let options = formats::ReadOptions { ignored: formats::IgnoredLog::default(), ..options };
        // Several trees together may cover the body.
        let ellipsoid = page.ellipsoid();
        let is_globe = page.tiles().roots().len() > 1 && is_globe(&ellipsoid, &page.bounding_sphere());
        let region = match is_globe {
            true => Some(whole_body(ellipsoid, ellipsoid.ground_m())),
            false if fetch::is_remote(&uri) => None,
            false => declared_region(&uri, &options),
        };
        Ok(Self { pager, page, uri, region })
    }
}

/// Reads a local root once more for the region that it declares. `None` for those without a region.
fn declared_region(uri: &Arc<str>, options: &formats::ReadOptions) -> Option<BoundingVolume> {
    let bytes = fetch::read_file(uri, &options.limits).ok()?;
    let content = formats::Content { uri: Arc::clone(uri), bytes, reader_data: None, companions: Vec::new() };
    match formats::decode_node(content, options).ok()?.kind {
        NodeKind::PagedLod(tile) | NodeKind::MultiContentTile(tile) => {
            Some(tile.bounds).filter(|b| matches!(b, BoundingVolume::Region(_)))
        }
        _ => None,
    }
}
