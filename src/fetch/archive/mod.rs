//! Archives as folders: 3D Tiles archives (`.3tz`), plain zip, packed sets (`.terrane`) and PMTiles, read without unpacking
//! them.
//!
//! A URI continues inside the archive: `set.3tz/tileset.json`, `imagery.pmtiles/3/1/2.png`. A reader loads the directory
//! of an archive once, or the much smaller index of a 3D Tiles archive, and then each member by one read of a span.
//! `zip`, `packed` and `pmtiles` parse bytes and do no I/O. `local` reads files on the file threads, `remote` sends range
//! requests on the HTTP thread.

mod local;
mod lru;
mod packed;
mod pmtiles;
#[cfg(feature = "http")]
mod remote;
mod span;
mod zip;

pub(crate) use local::LocalArchive;
pub(crate) use lru::{MAX_CACHED_ARCHIVES, MAX_CACHED_DIRECTORY_BYTES, evict_lru};
#[cfg(feature = "testing")]
pub use packed::fuzz_packed;
#[cfg(feature = "testing")]
pub use pmtiles::fuzz_pmtiles;
#[cfg(feature = "http")]
pub(crate) use remote::{MemberUri, RemoteArchives};
#[cfg(feature = "http")]
pub use remote::{RemoteFile, RemoteFiles};
#[cfg(feature = "testing")]
pub use zip::fuzz_index;
