//! Raster overlays: images of map servers, draped over the contents of any tile set. Decode threads, except where a type says
//! otherwise.
//!
//! ```text
//! tile's volume and error -> cover of each overlay -> images, loaded with the content -> one texture of the tile
//!        extent                 grid, document             set, images                     compose, drape
//! ```
//!
//! The images of a content are its dependencies, as the external images of a glTF are: the pager's own threads load them, and
//! the content is decoded when they have arrived or failed. What has failed is replaced by the next coarser level, and never
//! fails a content. `OverlaySet::texel_m` sets the size of a
//! tile's texels and `TileGrid::cover_for` the level of its images. See docs/decisions/0051.

mod compose;
mod document;
mod drape;
mod extent;
mod grid;
mod images;
mod options;
mod set;
mod source;
mod template;
mod xml;

pub(super) use document::{DocumentInfo, describe};
pub(super) use drape::{Draped, drape_images, note_regions};
pub(super) use extent::Extent;
pub use grid::{GeoRectangle, Tiling};
pub(super) use images::check as check_image;
pub use options::{OverlayError, OverlaySource, RasterOverlay};
pub use set::{MissingImage, OverlaySet};
pub(super) use source::DocumentImages;
