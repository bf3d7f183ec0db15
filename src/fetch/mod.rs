//! Bytes by URI: local files, archives, HTTP servers and object stores, with a disk cache.
//!
//! Called by the pager's file and HTTP threads, never by the threads of the frame. This folder knows URIs and bytes; it
//! knows neither formats nor the scene. No input is trusted: every failure is one [`IoError`] that names the URI and the
//! reason.

mod archive;
mod archive_names;
mod cache;
pub(crate) mod encoding;
mod error;
mod file;
#[cfg(feature = "http")]
mod http;
#[cfg(feature = "testing")]
mod hung_reads;
mod limits;
pub(crate) mod markup;
mod memory;
#[cfg(feature = "object-store")]
mod object_store;
mod panic_guard;
mod scope;
#[cfg(feature = "http")]
pub mod services;
mod source;
mod time_limit;
mod uri;

#[cfg(feature = "http")]
pub use archive::{RemoteFile, RemoteFiles};
#[cfg(feature = "testing")]
pub use archive::{fuzz_index, fuzz_packed, fuzz_pmtiles};
#[cfg(all(feature = "http", feature = "testing"))]
pub use archive_names::fuzz_url;
pub use cache::CacheStats;
#[cfg(all(feature = "http", feature = "testing"))]
pub use cache::fuzz_cache_entry;
#[cfg(feature = "http")]
pub use cache::{CacheConfig, CacheInfo, CacheVerified, DiskCache};
#[cfg(all(feature = "http", feature = "testing"))]
pub use encoding::fuzz_encoding;
pub use error::IoError;
#[cfg(test)]
pub(crate) use file::PANICS;
pub use file::{FileReader, read_file};
#[cfg(all(feature = "http", feature = "testing"))]
pub use http::fuzz_headers;
#[cfg(feature = "http")]
pub(crate) use http::runtime;
#[cfg(feature = "http")]
pub use http::{AllowedHost, Credential, HttpBody, HttpClient, HttpConfig, StoreOption};
#[cfg(feature = "testing")]
pub use hung_reads::HungReads;
pub(crate) use limits::JSON_OBJECT_BYTES;
pub use limits::Limits;
pub(crate) use memory::{
    BudgetUse, ByteBudget, ContentMemory, ContentTooLarge, LargeContents, LoadRoom, Permit, about_to_allocate,
    content_bytes_left, gated, limited,
};
#[cfg(feature = "http")]
pub(crate) use memory::{Claim, NoRoom};
#[cfg(feature = "object-store")]
pub use object_store::{ObjectFolder, ObjectHeaders, ObjectList};
pub use panic_guard::DECODER_PANICKED;
pub(crate) use panic_guard::guarded;
pub(crate) use scope::root_uri_within;
pub use scope::{RootScope, resolve, root_uri};
pub(crate) use source::{Fetched, Loaded, Source};
#[cfg(feature = "http")]
pub(crate) use time_limit::run_within;
#[cfg(feature = "http")]
pub(crate) use uri::server;
pub use uri::{is_http, is_remote, is_store, printable, shown};
pub(crate) use uri::{path_of, percent_decode};
