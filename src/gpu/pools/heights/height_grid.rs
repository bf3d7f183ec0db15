//! [`HeightGrid`]: the index buffer that all height tiles of one side share. Draw thread.

use crate::gpu::memory::Memory;

/// The indices of the grid for tiles of one side.
pub(crate) struct HeightGrid {
    pub(crate) indices: wgpu::Buffer,
    pub(crate) index_count: u32,
}

impl HeightGrid {
    /// Creates the grid for tiles of `side` by `side` vertices.
    pub(super) fn new(memory: &Memory, side: u32) -> Result<Self, String> {
        let indices = grid_indices(side);
        let index_count = indices.len() as u32;
        let indices = memory.allocate_filled("grid", wgpu::BufferUsages::INDEX, bytemuck::cast_slice(&indices))?;
        Ok(Self { indices, index_count })
    }
}

/// The width of the strips in which cells are drawn, south to north: a row's vertices are still in the adapter's vertex
/// cache when the next row needs them.
const STRIP_CELLS: usize = 16;

/// Returns the indices of the grid and its skirt.
///
/// Vertices `0..side^2` are the grid, row-major from the south-west. Then follows a ring of `4 (side - 1)` skirt vertices,
/// counter-clockwise from the south-west corner, each below its edge vertex; the shader relies on this order. Cells are
/// cut from south-west to north-east, so that a cell whose vertices have all morphed collapses into its parent's two
/// triangles.
fn grid_indices(side: u32) -> Vec<u32> {
    let cells = side - 1;
    let mut indices = Vec::with_capacity((cells * cells * 6 + 4 * cells * 6) as usize);
    for west in (0..cells).step_by(STRIP_CELLS) {
        let east = cells.min(west + STRIP_CELLS as u32);
        for j in 0..cells {
            for i in west..east {
                let sw = j * side + i;
                let (se, nw, ne) = (sw + 1, sw + side, sw + side + 1);
                indices.extend([sw, se, ne, sw, ne, nw]);
            }
        }
    }
    let ring = 4 * cells;
    let edge = |k: u32| {
        let k = k % ring;
        let (along, leg) = (k % cells, k / cells);
        match leg {
            0 => along,
            1 => along * side + cells,
            2 => cells * side + cells - along,
            _ => (cells - along) * side,
        }
    };
    for k in 0..ring {
        let (a, b) = (edge(k), edge(k + 1));
        let (a_low, b_low) = (side * side + k, side * side + (k + 1) % ring);
        indices.extend([a, a_low, b_low, a, b_low, b]);
    }
    indices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grid_covers_every_cell_and_has_a_closed_skirt() {
        let side = 5;
        let indices = grid_indices(side);
        assert_eq!(indices.len(), 4 * 4 * 6 + 16 * 6);
        let mut used: Vec<_> = indices.clone();
        used.sort_unstable();
        used.dedup();
        assert_eq!(used, (0..25 + 16).collect::<Vec<_>>());
        // The ring starts at the south-west corner and walks the border once.
        let first_of = |k: usize| indices[96 + 6 * k];
        assert_eq!([first_of(0), first_of(4), first_of(8), first_of(12)], [0, 4, 24, 20]);
    }
}
