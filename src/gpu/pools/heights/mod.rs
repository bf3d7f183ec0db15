//! Height tiles: blocks of a height array, a colour array and a table buffer, and the grids that tiles share. Used by the
//! thread of its device.

mod height_grid;
mod height_pool;
mod height_table;

pub(in crate::gpu) use height_pool::HeightPool;
pub(crate) use height_pool::HeightSlot;
#[cfg(test)]
pub(crate) use height_table::HEADER_VECTORS;
pub(in crate::gpu) use height_table::{table_bytes, table_words};
