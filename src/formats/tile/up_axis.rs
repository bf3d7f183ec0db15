//! [`UpAxis`]: the axis of a glTF that points up. Plain values.

use glam::{DMat3, DVec3};

/// The axis of a glTF that points up: y by its specification. Tilesets of old converters name another one
/// (`asset.gltfUpAxis`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UpAxis {
    /// The x axis.
    X,
    /// The y axis, as the specification of glTF says.
    #[default]
    Y,
    /// The z axis, as in 3D Tiles.
    Z,
}

impl UpAxis {
    /// Returns the rotation that turns this axis to the z axis of 3D Tiles.
    pub fn z_up(self) -> DMat3 {
        match self {
            // (x, y, z) becomes (-z, y, x).
            Self::X => DMat3::from_cols(DVec3::Z, DVec3::Y, DVec3::NEG_X),
            // (x, y, z) becomes (x, -z, y).
            Self::Y => DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
            Self::Z => DMat3::IDENTITY,
        }
    }

    /// Returns the axis that a tileset names; `None` for an unknown name.
    pub(in crate::formats) fn named(name: &str) -> Option<Self> {
        match name.trim() {
            "X" | "x" => Some(Self::X),
            "Y" | "y" => Some(Self::Y),
            "Z" | "z" => Some(Self::Z),
            _ => None,
        }
    }
}
