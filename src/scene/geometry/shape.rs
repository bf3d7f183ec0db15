//! The shapes that a drawable can have. Plain CPU data.

use std::sync::Arc;

use super::height_tile::HeightTile;
use super::mesh::Mesh;
use crate::math::Aabb;
use crate::state::DrawHook;

/// What the application draws itself, made by `draw::custom_geometry`. It is culled, sorted and faded like any
/// other, casts no shadow and is not met by intersections.
#[derive(Clone, Debug)]
pub struct CustomGeometry {
    /// Box around it in its own frame; what lies outside may be culled.
    pub bounds: Aabb,
    /// CPU memory that it holds.
    pub size_bytes: u64,
    /// Made by and given back to `draw`.
    pub hook: DrawHook,
}

/// Geometry of a [`Drawable`].
#[derive(Clone, Debug)]
pub enum Geometry {
    /// Indexed primitives.
    Mesh(Arc<Mesh>),
    /// Heights on the shared grid.
    Height(Arc<HeightTile>),
    /// Drawn by the application.
    Custom(CustomGeometry),
}

impl Geometry {
    /// Box around it in its own frame.
    pub fn bounds(&self) -> Aabb {
        match self {
            Self::Mesh(mesh) => mesh.bounds,
            Self::Height(tile) => tile.bounds,
            Self::Custom(custom) => custom.bounds,
        }
    }
}
