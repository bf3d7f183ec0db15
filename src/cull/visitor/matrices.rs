//! Eye-from-drawable matrices as rows of f32, computed in f64. Culling thread.

use std::ops::Range;

use glam::{DAffine3, DVec3, Vec4};

use super::page_context::PageContext;
use crate::scene::NONE;

/// Computes the matrices of a page's transforms.
///
/// Many transforms of a page have the same linear part (instances that are only moved): the product of the last one is
/// kept, so that each further transform costs only its translation.
#[derive(Debug)]
pub(in crate::cull) struct TransformMatrices {
    /// Index of the linear part that was multiplied last; `NONE` when it is unknown.
    linear: u32,
    /// Rows of the product, with 0 for the translation.
    rows: [Vec4; 3],
}

impl TransformMatrices {
    /// Creates an empty cache.
    pub const fn new() -> Self {
        Self { linear: NONE, rows: [Vec4::ZERO; 3] }
    }

    /// Forgets the product; to be called before another page or another `eye_from_page`.
    pub fn forget(&mut self) {
        self.linear = NONE;
    }

    /// Appends the matrix of one transform and returns its index.
    #[inline(always)]
    pub fn push(&mut self, context: &PageContext, transform: usize, matrices: &mut Vec<[[f32; 4]; 3]>) -> u32 {
        let matrix = self.rows_of(context, transform);
        let index = matrices.len() as u32;
        matrices.push(matrix);
        index
    }

    /// Appends the matrices of a range of transforms and returns the index of the first.
    #[inline(always)]
    pub fn push_range(
        &mut self,
        context: &PageContext,
        transforms: Range<usize>,
        matrices: &mut Vec<[[f32; 4]; 3]>,
    ) -> u32 {
        let first = matrices.len() as u32;
        matrices.extend(transforms.map(|transform| self.rows_of(context, transform)));
        first
    }

    #[inline(always)]
    fn rows_of(&mut self, context: &PageContext, transform: usize) -> [[f32; 4]; 3] {
        let all = context.page.transforms();
        let linear = all.linear_of()[transform];
        if linear != self.linear {
            self.multiply_linear(context, linear);
        }
        let [px, py, pz] = all.translations()[transform];
        let at = &context.visit.eye_from_page.translation;
        let along = |row: &DVec3, at: f64| Vec4::W * (row.x * px + row.y * py + row.z * pz + at) as f32;
        let ([x, y, z], rows) = (&context.eye_rows, &self.rows);
        [rows[0] + along(x, at.x), rows[1] + along(y, at.y), rows[2] + along(z, at.z)].map(|row| row.to_array())
    }

    #[inline(never)]
    fn multiply_linear(&mut self, context: &PageContext, linear: u32) {
        let page_from_node = context.page.transforms().linears()[linear as usize].page_from_node;
        let matrix3 = context.visit.eye_from_page.matrix3 * page_from_node;
        self.rows = matrix_rows(&DAffine3 { matrix3, translation: DVec3::ZERO }).map(Vec4::from_array);
        self.linear = linear;
    }
}

/// Returns the rows of an affine map, rounded to f32.
pub(in crate::cull) fn matrix_rows(map: &DAffine3) -> [[f32; 4]; 3] {
    let (m, t) = (&map.matrix3, map.translation);
    let row = |x: f64, y: f64, z: f64, w: f64| [x as f32, y as f32, z as f32, w as f32];
    [
        row(m.x_axis.x, m.y_axis.x, m.z_axis.x, t.x),
        row(m.x_axis.y, m.y_axis.y, m.z_axis.y, t.y),
        row(m.x_axis.z, m.y_axis.z, m.z_axis.z, t.z),
    ]
}
