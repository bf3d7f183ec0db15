//! Height tiles: squares of heights that one shared grid draws. Plain CPU data.

use std::sync::Arc;

use super::texture::Texture;
use crate::math::Aabb;

/// The largest number of coarser levels that the vertices of a height tile morph to.
pub const MORPH_LEVELS: usize = 6;

/// A square of heights, drawn from one shared grid by the vertex shader.
///
/// Frame: origin at the tile's centre on the ellipsoid (or plane), axes east, "radial", "polar"; the page's
/// transform rotates that frame into the world. Vertex (i, j), i east, j north, with height h lies at
/// ```text
/// east   = (p0 + row.dp + h * row.cos) * col.sin
/// radial =  row.dp + h * row.cos - (p0 + row.dp + h * row.cos) * col.one_minus_cos
/// polar  =  row.dz + h * row.sin
/// ```
/// which is the exact ellipsoid in small differences (p: distance from the earth's axis, z: along it). A plane is the
/// same at the pole of an endless earth: `p0` vast, `row = [-north, 0, 0, 1]`, `col = [east / p0, 0]`.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightTile {
    /// Vertices along a side, 2^k + 1 (65).
    pub side: u32,
    /// `(side + 2)^2` heights in metres above the ellipsoid or plane, one border sample around, row-major,
    /// **south-west first**, east fastest.
    pub heights: Vec<f32>,
    /// Per row, south to north, `side` entries: `[dp, dz, cos, sin]`.
    pub rows: Vec<[f32; 4]>,
    /// Per column, west to east, `side` entries: `[sin, one_minus_cos]`.
    pub columns: Vec<[f32; 2]>,
    /// Distance of the origin from the earth's axis, metres.
    pub p0_m: f32,
    /// Level of the tile, root 0.
    pub level: u32,
    /// Geometric errors in metres of the levels `level-1, level-2, ...` (at most [`MORPH_LEVELS`]), each at the corners of this
    /// tile: south-west, south-east, north-west, north-east. Between the corners they are interpolated. Where a vertex morphs
    /// into the coarser grid depends on the level's error there and on the distance. So neighbours agree if they have the same
    /// errors at common corners.
    pub coarser_errors_m: Vec<[f32; 4]>,
    /// Depth of the skirt in metres.
    pub skirt_m: f32,
    /// Size of a cell at the tile's centre, metres east and north (for normals).
    pub cell_m: [f32; 2],
    /// The colour, north up (row 0 is the northern edge); white if absent.
    pub texture: Option<Arc<Texture>>,
    /// Box around the tile in its frame, skirt included.
    pub bounds: Aabb,
}
