//! Bytes to pages and back: 3D Tiles, glTF, OpenSceneGraph's files, quantized-mesh terrain, EXR height tiles, point clouds,
//! images.
//!
//! Called by the pager's decode threads, never by the threads of the frame. The decoders do no I/O; only the functions
//! about whole tile sets ([`inspect`], [`verify`], `fill`) ask [`fetch`](crate::fetch) for bytes. No input is trusted:
//! every failure is one [`IoError`](crate::fetch::IoError) that names the URI and the reason.

mod b3dm;
mod cmpt;
mod convert;
mod database_path;
mod draping;
mod embedded;
mod external_files;
mod gltf;
mod height;
mod i3dm;
mod ignored;
mod image;
mod implicit;
mod lenient;
mod model_files;
mod options;
mod osg;
mod overlay;
mod point_cloud;
mod properties;
mod read;
mod style;
mod subset;
mod terrain;
mod tile;
mod tileset;
mod whole_set;
pub mod writers;

pub use convert::{ConvertError, ConvertOptions, Converted, Counts, convert, crop};
pub use database_path::set_database_path;
pub use ignored::{Ignored, IgnoredLog};
pub use image::ImageFiles;
pub(crate) use image::decode_file as decode_image;
pub(crate) use options::MAX_DEPENDENCY_ROUNDS;
pub use options::{Content, ContentReader, Fetched, ReadOptions};
pub use osg::ReadAhead;
pub use overlay::{GeoRectangle, MissingImage, OverlayError, OverlaySet, OverlaySource, RasterOverlay, Tiling};
#[cfg(feature = "http")]
pub(crate) use read::has_slow_dependencies;
pub use read::{companion_fallback, companions, decode, decode_node, decode_noting, dependencies};
pub use style::{Style, StyleError};
pub use terrain::{ellipsoid, terrain_extent};
pub use tile::{Body, TileVolume, UpAxis};
pub use whole_set::{
    BoundsInfo, Info, InfoError, LevelInfo, LevelMeasures, MapFrame, MetadataInfo, ModelInfo, Problem, Spread,
    SurveyEvent, SurveyOptions, SurveyedTile, Verified, inspect, survey, verify,
};
#[cfg(feature = "http")]
pub use whole_set::{FillOptions, Filled, fill, inspect_root_with, inspect_with, verify_with};
