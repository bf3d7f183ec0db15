//! [`SharedStateManager`]: equal images, geometry, textures and state sets of paged contents become one.
//!
//! Works in the decode workers, before anything is uploaded or merged; a lock is held for the look-up of one key.
//! What is equal is found by a [`ContentKey`], and what shares a key has one place in each context: a payload need not
//! stay in memory to be shared with what comes later. State sets and their textures, which stay, are compared.

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
