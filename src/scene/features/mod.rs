//! Features of tile contents: ids of the parts of a mesh, and tables of their properties. Metadata of tiles.
//!
//! Readers attach [`DrawableFeatures`] to drawables if the options say so. They stay with the page when the payloads are
//! uploaded, so that a picked point leads to its feature and to the properties of that feature. Plain CPU data, any thread.

mod data_texture;
mod drawable_features;
mod metadata;
mod property_table;
mod property_value;
mod surface_property;

pub use data_texture::{DataTexture, SurfacePoint};
pub use drawable_features::{DrawableFeatures, Feature, FeatureIdSet, FeatureIds};
pub use metadata::{Metadata, MetadataClass, TileMetadata};
pub(crate) use property_table::Column;
pub use property_table::{PropertyColumn, PropertyInfo, PropertyTable};
pub use property_value::PropertyValue;
pub use surface_property::SurfaceProperty;
pub(crate) use surface_property::{SurfaceValues, ValueDecoder};
