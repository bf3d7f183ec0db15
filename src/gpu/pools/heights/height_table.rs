//! The tables of height tiles: each tile's parameters, rows and columns, as the vertex shader reads them.

use crate::scene::{HeightTile, MORPH_LEVELS};

/// The number of four-float vectors before a tile's rows.
pub(crate) const HEADER_VECTORS: u32 = 2 + MORPH_LEVELS as u32;

/// Returns the number of four-float vectors of a tile's table: the header, one per row, one per two columns.
fn table_vectors(side: u32) -> u32 {
    HEADER_VECTORS + side + side.div_ceil(2)
}

/// Returns the size of a tile's table in bytes.
pub(in crate::gpu) fn table_bytes(side: u32) -> u64 {
    u64::from(table_vectors(side)) * 16
}

/// Returns a tile's table.
pub(in crate::gpu) fn table_words(tile: &HeightTile) -> Vec<f32> {
    let mut errors = [[0.0f32; 4]; MORPH_LEVELS];
    let count = tile.coarser_errors_m.len().min(MORPH_LEVELS);
    errors[..count].copy_from_slice(&tile.coarser_errors_m[..count]);
    let length = table_vectors(tile.side) as usize * 4;
    let mut words = Vec::with_capacity(length);
    words.extend([tile.p0_m, tile.skirt_m, tile.cell_m[0], tile.cell_m[1]]);
    words.extend([count as f32, 0.0, 0.0, 0.0]);
    words.extend(errors.as_flattened());
    words.extend(tile.rows.iter().flatten());
    words.extend(tile.columns.iter().flatten());
    words.resize(length, 0.0);
    words
}
