//! Archives on servers: directories and members by HTTP range requests. HTTP thread. Parts of other files, for threads that
//! may block.
//!
//! ```text
//! RemoteArchives   which archives are open; the disk cache for their members
//!   RemoteZip, RemotePacked, RemotePmtiles   which span holds a member
//!     RemoteIdentity          is the archive still the one whose directory was read?
//!       PartReader             one range request
//! ```

mod archives;
mod file;
mod identity;
mod packed;
mod part;
mod pmtiles;
mod reread_limit;
mod zip;

pub(crate) use archives::{MemberUri, RemoteArchives};
pub use file::{RemoteFile, RemoteFiles};
