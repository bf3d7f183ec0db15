//! [`SharedStateManager`]: equal images, geometry, textures and state sets of paged contents become one.
//!
//! Works in the decode workers, before anything is uploaded or merged; a lock is held for the look-up of one key.
//! What is equal is found by a [`ContentKey`], and what shares a key has one place in each context: a payload need not
//! stay in memory to be shared with what comes later. State sets and their textures, which stay, are compared.

mod key;
mod manager;
mod states;

pub use key::ContentKey;
pub use manager::{ShareModes, SharedStateManager, SharingStats};

pub(crate) use manager::{SharedContent, SharedParts};
