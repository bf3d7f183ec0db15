//! Archives on servers: directories and members by HTTP range requests. HTTP thread.
//!
//! ```text
//! RemoteArchives   which archives are open; the disk cache for their members
//!   RemoteZip, RemotePmtiles   which span holds a member
//!     ArchiveIdentity          is the archive still the one whose directory was read?
//!       PartReader             one range request
//! ```

mod archives;
mod identity;
mod part;
mod pmtiles;
mod reread_limit;
mod zip;

pub(crate) use archives::{MemberUri, RemoteArchives};
#[cfg(feature = "testing")]
pub(crate) use part::parse_content_range;
