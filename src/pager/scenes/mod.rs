//! The scenes that a pager serves: the set that each call borrows, and the read scope of each. Update thread; the scopes are
//! read by the loading threads too.

pub(super) mod read_scope;
pub(super) mod registry;
pub(super) mod scene_set;
#[cfg(feature = "http")]
pub(super) mod shared_files;
