//! Properties of features and tiles: property tables of 3D Tiles Metadata, which EXT_structural_metadata of glTF shares, batch
//! tables of 3D Tiles 1.0, and metadata as JSON. Decode threads.
//!
//! | file | contents |
//! |---|---|
//! | `schema` | the JSON of schemas, tables and metadata |
//! | `property_type`, `component` | stored values to values: normalization, scale, noData, defaults, names of enums |
//! | `table`, `binary_column`, `shared_bytes` | tables whose columns are buffer views |
//! | `batch_table`, `feature_table` | tables of 3D Tiles 1.0 |
//! | `entities`, `metadata_budget` | metadata of tilesets, tiles, contents and groups, and its maximum size |

mod batch_table;
mod binary_column;
mod component;
mod entities;
pub(super) mod feature_table;
mod metadata_budget;
mod property_type;
mod schema;
mod shared_bytes;
mod table;

pub(super) use batch_table::batch_table;
pub(super) use entities::Entities;
pub(super) use metadata_budget::MetadataBudget;
pub(super) use property_type::PropertyType;
pub(super) use schema::{ClassProperty, Schema, TableJson, ValueChanges, read_schema};
pub(super) use shared_bytes::SharedBytes;
pub(super) use table::TableSource;
