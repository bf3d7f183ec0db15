//! Transforms of tiles as the numbers of a file.

use glam::{DAffine3, DMat4, DVec4};

/// Returns the transform with the 16 numbers of a matrix, column by column; `None` if it is not affine and finite.
pub(in crate::formats) fn tile_transform(columns: &[f64; 16]) -> Option<DAffine3> {
    let matrix = DMat4::from_cols_array(columns);
    (matrix.is_finite() && matrix.row(3) == DVec4::W).then(|| DAffine3::from_mat4(matrix))
}
