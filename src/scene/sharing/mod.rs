//! Sharing: equal images, geometry, textures and state sets of paged contents are stored once.
//!
//! Decode workers share contents before they are uploaded and merged; a lock is held for the look-up of one key. Equal
//! contents have equal [`ContentKey`]s, and each key has one slot in each context. A payload therefore need not stay in
//! memory to be shared with later contents. State sets and their textures, which stay in memory, are compared.

mod content_key;
mod content_table;
mod manager;
mod modes;
mod shared_content;
mod state_sets;

pub use content_key::ContentKey;
pub use manager::SharedStateManager;
pub use modes::{ShareModes, SharingStats};

pub(crate) use shared_content::{SharedContent, SharedParts};
