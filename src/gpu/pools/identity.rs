//! [`Identity`]: the key under which equal payloads share a slot. Draw thread; plain values.

use crate::scene::ContentKey;

/// The key by which the slot of a payload is found again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Identity {
    /// The content. Payloads of equal content share a slot, even after the first of them was dropped.
    Content(ContentKey),
    /// The address of the payload.
    Address(usize),
}

impl Identity {
    pub(super) fn new<T: ?Sized>(content: Option<&ContentKey>, payload: *const T) -> Self {
        content.map_or(Self::Address(payload as *const () as usize), |key| Self::Content(*key))
    }
}
