//! The JSON of a metadata schema and of property tables (3D Tiles Metadata, EXT_structural_metadata).

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

/// Classes of features with their properties.
#[derive(Default, Deserialize)]
pub(super) struct Schema {
    #[serde(default)]
    pub classes: BTreeMap<String, Class>,
    #[serde(default)]
    pub enums: BTreeMap<String, Enum>,
}

#[derive(Deserialize)]
pub(super) struct Class {
    #[serde(default)]
    pub properties: BTreeMap<String, ClassProperty>,
}

/// The type of a property.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct ClassProperty {
    #[serde(rename = "type")]
    pub kind: String,
    pub component_type: Option<String>,
    pub enum_type: Option<String>,
    #[serde(default)]
    pub array: bool,
    /// The number of elements of an array of fixed length.
    pub count: Option<usize>,
    #[serde(default)]
    pub normalized: bool,
    pub offset: Option<Value>,
    pub scale: Option<Value>,
    pub no_data: Option<Value>,
    pub default: Option<Value>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Enum {
    pub value_type: Option<String>,
    pub values: Vec<EnumValue>,
}

#[derive(Deserialize)]
pub(super) struct EnumValue {
    pub name: String,
    pub value: i64,
}

/// A property table; its columns are buffer views.
#[derive(Deserialize)]
pub(super) struct TableJson {
    pub name: Option<String>,
    pub class: String,
    pub count: usize,
    #[serde(default)]
    pub properties: BTreeMap<String, TableProperty>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TableProperty {
    pub values: usize,
    pub array_offsets: Option<usize>,
    pub string_offsets: Option<usize>,
    pub array_offset_type: Option<String>,
    pub string_offset_type: Option<String>,
    pub offset: Option<Value>,
    pub scale: Option<Value>,
}
