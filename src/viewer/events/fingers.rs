//! [`Fingers`]: the fingers on a touch screen, and which of them acts as the pointer.

use glam::DVec2;

/// The most fingers tracked at once; further ones are ignored.
pub(super) const MAX_FINGERS: usize = 32;

/// The fingers that are down.
#[derive(Clone, Debug, Default)]
pub(super) struct Fingers {
    /// Ids and positions in pixels, in the order they came down.
    pub down: Vec<(u64, DVec2)>,
    /// The finger that acts as the pointer.
    pub pointer: Option<u64>,
    /// The position of the last of several fingers when the others were lifted, pixels.
    pub last_remaining_px: Option<DVec2>,
}
