//! [`TileVolume`]: the volume of the tile that a content is for. Decode threads.

use crate::math::OrientedBox;

/// The declared volume of the tile that a content is for, as the scene knows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileVolume {
    /// The volume, or the box around it, in the frame of the whole set.
    pub bounds: OrientedBox,
    /// The geometric error of the tile in metres, or what follows from those above if it has none; 0 if it is unknown.
    pub geometric_error_m: f64,
}
