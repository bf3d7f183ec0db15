//! Property tables of features: EXT_structural_metadata of glTF, which has the binary layout of 3D Tiles Metadata, and batch
//! tables of 3D Tiles 1.0; and columns of numbers in the tables of subtrees. Decode threads.

mod batch_table;
mod binary_column;
mod component;
mod number_column;
mod schema;
mod table;

pub(super) use batch_table::batch_table;
pub(super) use number_column::NumberColumn;
pub(super) use schema::{ClassProperty, Schema, TableJson, read_schema};
pub(super) use table::property_tables;
