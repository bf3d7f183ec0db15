//! Zip files and 3D Tiles archives (`.3tz`): central directory, index and members. Parses bytes, does no I/O.

mod directory;
mod index;
mod member;

pub(super) use directory::{DAMAGED_NAMES, DirectoryEnd, Member, TAIL_BYTES, ZipDirectory};
#[cfg(feature = "testing")]
pub use index::fuzz_index;
pub(super) use index::{ZipIndex, local_header};
pub(super) use member::{MAX_HEADER_BYTES, check_member, content_range, member_span, unpack};
