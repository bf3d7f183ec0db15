//! From URIs to bytes and from bytes to pages: files, archives and servers; 3D Tiles, glTF, EXR height tiles, images.
//!
//! Used by the pager's file, HTTP and decode threads; never on the frame's threads. Nothing here trusts its input:
//! every failure is one [`IoError`] that names the URI and the reason.

mod archive;
mod b3dm;
mod cache;
mod database_path;
mod encoding;
mod error;
mod extras;
mod feature_table;
mod file;
#[cfg(feature = "http")]
mod fill;
mod gltf;
mod gltf_elements;
mod gltf_json;
mod height;
#[cfg(feature = "http")]
mod http;
mod image;
mod index_lists;
mod info;
mod occluder;
mod pnts;
mod read;
mod source;
mod tileset;
mod uri;
mod verify;
pub mod write;

#[doc(hidden)]
pub use archive::fuzz_index;
#[doc(hidden)]
pub use archive::pmtiles::fuzz_pmtiles;
pub use cache::CacheStats;
#[cfg(feature = "http")]
#[doc(hidden)]
pub use cache::fuzz_cache_entry;
#[cfg(feature = "http")]
pub use cache::{CacheConfig, CacheInfo, CacheVerified, DiskCache};
pub use database_path::set_database_path;
#[cfg(feature = "http")]
#[doc(hidden)]
pub use encoding::fuzz_encoding;
pub use error::{IoError, Limits};
#[cfg(test)]
pub(crate) use file::PANICS;
pub use file::{FileReader, read_file};
#[cfg(feature = "http")]
pub use fill::{FillOptions, Filled, fill};
#[cfg(feature = "http")]
#[doc(hidden)]
pub use http::fuzz_headers;
#[cfg(feature = "http")]
pub use http::{Credential, HttpBody, HttpClient, HttpConfig, StoreOption};
#[cfg(feature = "http")]
pub(crate) use http::{HttpHere, runtime};
pub(crate) use image::decode_file as decode_image;
#[cfg(feature = "http")]
pub use info::inspect_with;
pub use info::{BoundsInfo, Info, InfoError, LevelInfo, inspect};
pub use read::{Content, DECODER_PANICKED, Fetched, ReadOptions, companions, decode, decode_node};
pub(crate) use source::Source;
#[cfg(feature = "http")]
#[doc(hidden)]
pub use uri::fuzz_url;
pub use uri::{RootScope, is_http, is_remote, is_store, resolve, root_uri, shown};
#[cfg(feature = "http")]
pub(crate) use uri::{is_at, server};
#[cfg(feature = "http")]
pub use verify::verify_with;
pub use verify::{Verified, verify};
