//! The features of a glTF document: their ids, and properties in tables, textures and attributes.

mod feature_ids;
mod surface_properties;

pub(super) use feature_ids::{FeatureIdJson, FeatureTables};
pub(super) use surface_properties::PrimitiveImages;
