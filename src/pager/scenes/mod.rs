//! The scenes that a pager serves: the set that each call gets, and what the contents of each may read.

pub(super) mod read_scope;
pub(super) mod registry;
pub(super) mod scene_set;
