//! The shapes that a drawable can have. Plain CPU data.

use std::sync::Arc;

use super::height_tile::HeightTile;
use super::mesh::Mesh;
use super::splats::Splats;
use crate::math::Aabb;
use crate::state::OpaqueDrawData;

/// Geometry that the application draws itself, created by `draw::custom_geometry`. It is culled, sorted and faded like any
/// other, casts no shadow and is ignored by intersections.
#[derive(Clone, Debug)]
pub struct CustomGeometry {
    /// A box around it in its own frame; anything outside may be culled.
    pub bounds: Aabb,
    /// The CPU memory that it holds, bytes.
    pub size_bytes: u64,
    /// The application's draw function, created by and handed back to `draw`.
    pub hook: OpaqueDrawData,
}

/// The geometry of a [`Drawable`](super::Drawable).
#[derive(Clone, Debug)]
pub enum Geometry {
    /// Indexed primitives.
    Mesh(Arc<Mesh>),
    /// Heights on the shared grid mesh.
    Height(Arc<HeightTile>),
    /// Gaussian splats.
    Splats(Arc<Splats>),
    /// Geometry that the application draws.
    Custom(CustomGeometry),
}

impl Geometry {
    /// Returns the box around the geometry in its own frame.
    pub fn bounds(&self) -> Aabb {
        match self {
            Self::Mesh(mesh) => mesh.bounds,
            Self::Height(tile) => tile.bounds,
            Self::Splats(splats) => splats.bounds(),
            Self::Custom(custom) => custom.bounds,
        }
    }
}
