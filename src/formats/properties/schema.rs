//! The JSON of a metadata schema and of property tables (3D Tiles Metadata, EXT_structural_metadata). Members that are
//! invalid spoil only themselves. Immutable; decode threads.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Deserializer};
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
        (Some(json), _) => {
            let schema = Schema::deserialize(json).map_err(|e| invalid(uri, e))?;
            schema.check(uri).map(|()| Some(schema))
        }
        (None, Some(reference)) => {
            let (uri, bytes) = match is_data_uri(reference) {
                true => (uri.into(), embedded::data_uri(uri, reference)?.into()),
                false => files.get(reference)?,
            };
            let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
            refuse_markup(&uri, text)?;
            files.limits().check_json(&uri, text)?;
            let schema: Schema = serde_json::from_slice(text).map_err(|e| invalid(&uri, e))?;
            schema.check(&uri).map(|()| Some(schema))
        }
        (None, None) => Ok(None),
    }
}

/// The maximum number of properties of a class.
const MAX_PROPERTIES: usize = 4096;
/// The maximum bytes of memory of the values in a property, such as its default: tables and tiles have copies of them.
const MAX_VALUE_BYTES: usize = 4096;

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

impl Schema {
    /// Fails if the number of properties of a class, or the size of a property's values, exceeds its limit: small files with
    /// this schema would take much memory.
    fn check(&self, uri: &str) -> Result<(), IoError> {
        let too_large = |what: &'static str, got: usize, limit: usize| {
            Err(IoError::TooLarge { uri: uri.to_owned(), what, got: got as u64, limit: limit as u64 })
        };
        for class in self.classes.values() {
            if class.properties.len() > MAX_PROPERTIES {
                return too_large("number of properties in a metadata class", class.properties.len(), MAX_PROPERTIES);
            }
            for of in class.properties.values() {
                let ValueChanges { offset, scale, min, max } = &of.values;
                let values = [offset, scale, min, max, &of.no_data, &of.default].into_iter().flatten();
                let bytes = values.map(bytes_of_json).sum();
                if bytes > MAX_VALUE_BYTES {
                    return too_large("size of the values in a metadata property", bytes, MAX_VALUE_BYTES);
                }
            }
        }
        Ok(())
    }
}

/// Returns about the bytes of memory of a value.
fn bytes_of_json(value: &Value) -> usize {
    size_of::<Value>()
        + match value {
            Value::String(text) => text.len(),
            Value::Array(parts) => parts.iter().map(bytes_of_json).sum(),
            Value::Object(members) => members.iter().map(|(name, value)| name.len() + bytes_of_json(value)).sum(),
            Value::Null | Value::Bool(_) | Value::Number(_) => 0,
        }
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
    /// The names by their numbers, which all properties of the type share.
    #[serde(deserialize_with = "names_by_number")]
    pub values: Arc<BTreeMap<i64, String>>,
}

fn names_by_number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Arc<BTreeMap<i64, String>>, D::Error> {
    #[derive(Deserialize)]
    struct EnumValue {
        name: String,
        value: i64,
    }
    let values = Vec::<EnumValue>::deserialize(deserializer)?;
    Ok(Arc::new(values.into_iter().map(|EnumValue { name, value }| (value, name)).collect()))
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::fetch::{Limits, RootScope};

    #[test]
    fn schemas_of_which_small_files_would_be_large_are_refused() {
        let (scope, limits) = (RootScope::of("/set/tileset.json"), Limits::default());
        let files = ExternalFiles::new("/set/tileset.json", &scope, &limits, &[]);
        let read = |count: usize, default: Value| {
            let property = json!({ "type": "SCALAR", "componentType": "UINT8", "array": true, "default": default });
            let properties: serde_json::Map<_, _> = (0..count).map(|i| (format!("p{i}"), property.clone())).collect();
            let schema = json!({ "classes": { "c": { "properties": properties } } });
            read_schema("a", Some(&schema), None, &files)
        };
        assert!(read(MAX_PROPERTIES, json!(7)).is_ok_and(|schema| schema.is_some()));
        for refused in [read(MAX_PROPERTIES + 1, json!(7)), read(1, json!(vec![7; 1000]))] {
            assert!(matches!(refused, Err(IoError::TooLarge { limit: 4096, .. })));
        }
    }
}
