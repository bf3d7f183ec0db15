//! The JSON of a metadata schema and of property tables (3D Tiles Metadata, EXT_structural_metadata). Members that are
//! invalid spoil only themselves. Immutable; decode threads.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use crate::fetch::IoError;
use crate::fetch::markup::refuse_markup;
use crate::formats::embedded::{self, is_data_uri};
use crate::formats::external_files::ExternalFiles;
use crate::formats::lenient::{Text, or_default, valid_entries, valid_or_default};

/// Reads the schema of a tileset or glTF: `json` in the file `uri` itself, or else the file that `reference` leads to. Returns
/// `None` if there is neither.
pub(in crate::formats) fn read_schema(
    uri: &str,
    json: Option<&Value>,
    reference: Option<&str>,
    files: &ExternalFiles<'_>,
) -> Result<Option<Schema>, IoError> {
    let invalid = |uri: &str, e: serde_json::Error| IoError::invalid(uri, format!("metadata schema: {e}"));
    match (json, reference) {
        (Some(json), _) => Schema::deserialize(json).map(Some).map_err(|e| invalid(uri, e)),
        (None, Some(reference)) => {
            let (uri, bytes) = match is_data_uri(reference) {
                true => (uri.into(), embedded::data_uri(uri, reference)?.into()),
                false => files.get(reference)?,
            };
            let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
            refuse_markup(&uri, text)?;
            files.limits().check_json(&uri, text)?;
            serde_json::from_slice(text).map(Some).map_err(|e| invalid(&uri, e))
        }
        (None, None) => Ok(None),
    }
}

/// Metadata of one object: its class, and the values of its properties.
#[derive(Debug, Deserialize)]
pub(in crate::formats) struct EntityJson {
    #[serde(default)]
    pub class: Text,
    #[serde(default, deserialize_with = "valid_or_default")]
    pub properties: BTreeMap<String, Value>,
}

/// The classes of tiles and features with their properties.
#[derive(Clone, Debug, Default, Deserialize)]
pub(in crate::formats) struct Schema {
    #[serde(default, deserialize_with = "valid_entries")]
    pub classes: BTreeMap<String, Class>,
    #[serde(default, deserialize_with = "valid_entries")]
    pub enums: BTreeMap<String, Enum>,
}

#[derive(Clone, Debug, Default, Deserialize)]
pub(in crate::formats) struct Class {
    #[serde(default, deserialize_with = "valid_entries")]
    pub properties: BTreeMap<String, ClassProperty>,
}

/// The type of a property.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(in crate::formats) struct ClassProperty {
    #[serde(rename = "type", default)]
    pub kind: Text,
    #[serde(default)]
    pub component_type: Text,
    #[serde(default)]
    pub enum_type: Text,
    #[serde(default, deserialize_with = "or_default")]
    pub array: bool,
    /// The number of elements of an array; `None` for arrays of any length.
    pub count: Option<usize>,
    #[serde(default, deserialize_with = "or_default")]
    pub normalized: bool,
    #[serde(flatten)]
    pub values: ValueChanges,
    /// The stored value that stands for none.
    pub no_data: Option<Value>,
    /// The value where there is none.
    pub default: Option<Value>,
    /// The meaning of the property, such as `TILE_GEOMETRIC_ERROR`.
    #[serde(default)]
    pub semantic: Text,
}

impl ClassProperty {
    /// Returns the number of components of an element; `None` if the elements are no numbers.
    pub(super) fn components(&self) -> Option<usize> {
        Some(match self.kind.0.as_deref()? {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" | "MAT2" => 4,
            "MAT3" => 9,
            "MAT4" => 16,
            _ => return None,
        })
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(in crate::formats) struct Enum {
    #[serde(default)]
    pub value_type: Text,
    pub values: Vec<EnumValue>,
}

#[derive(Clone, Debug, Deserialize)]
pub(in crate::formats) struct EnumValue {
    pub name: String,
    pub value: i64,
}

/// A property table: the properties of a class as columns, which are buffer views.
#[derive(Debug, Deserialize)]
pub(in crate::formats) struct TableJson {
    #[serde(default)]
    pub name: Text,
    #[serde(default)]
    pub class: Text,
    #[serde(default, deserialize_with = "valid_or_default")]
    pub count: usize,
    #[serde(default, deserialize_with = "valid_entries")]
    pub properties: BTreeMap<String, TableProperty>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(in crate::formats) struct TableProperty {
    /// The buffer view of the values.
    #[serde(default, deserialize_with = "valid_or_default")]
    pub values: Option<usize>,
    #[serde(default, deserialize_with = "valid_or_default")]
    pub array_offsets: Option<usize>,
    #[serde(default, deserialize_with = "valid_or_default")]
    pub string_offsets: Option<usize>,
    #[serde(default)]
    pub array_offset_type: Text,
    #[serde(default)]
    pub string_offset_type: Text,
    #[serde(flatten)]
    pub changes: ValueChanges,
}

/// How stored numbers are changed, and the range of the results. A table's own members replace those of the class.
#[derive(Clone, Debug, Default, Deserialize)]
pub(in crate::formats) struct ValueChanges {
    pub offset: Option<Value>,
    pub scale: Option<Value>,
    pub min: Option<Value>,
    pub max: Option<Value>,
}
