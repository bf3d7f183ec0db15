//! Virtual rasters of GDAL (VRT): an XML file that puts parts of other files side by side. `gdalbuildvrt` makes them of many
//! files, `gdal_translate -of VRT` of a part of one.
//!
//! ```text
//! document  the XML: the size, the georeference, and for each band the sources with their rectangles
//! warp      the part of the XML about a file that is resampled into another reference system
//! xml       what both read: elements, numbers and paths
//! image     the pixels: the blocks of the sources' images, copied or resampled; later sources lie on top
//! warped    the pixels of a file that is resampled into another reference system
//! ```
//!
//! Elevation and imagery open the sources as they open other files, so that all formats may be in a virtual raster.

mod document;
mod image;
mod warp;
mod warped;
mod xml;

use std::path::Path;

use crate::store::is_remote;
pub(crate) use document::{VirtualRaster, VirtualSource};
pub(crate) use image::{Piece, VirtualImage, VirtualPixels};
pub(crate) use warp::Warp;
pub(crate) use warped::{WarpedImage, WarpedPixels};

/// The maximum number of virtual rasters that may be nested, the outermost included. Rasters that name one another in a loop are
/// refused at this depth.
pub(crate) const MAX_DEPTH: usize = 4;

/// Returns true for a virtual raster. `magic` are its first bytes.
pub(crate) fn is_virtual(path: &Path, magic: &[u8]) -> bool {
    let has_name = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("vrt"));
    !is_remote(path) && (magic.starts_with(b"<VRTData") || has_name && magic.trim_ascii_start().starts_with(b"<"))
}
