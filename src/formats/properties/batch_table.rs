//! Batch tables of 3D Tiles 1.0: properties by batch id, as JSON arrays or in a binary part.

use serde::Deserialize;
use serde_json::{Map, Value};

use super::binary_column::BinaryColumn;
use super::component::Component;
use super::feature_table;
use super::property_type::{Element, PropertyType, from_json};
use crate::fetch::Limits;
use crate::scene::{Column, PropertyColumn, PropertyTable, PropertyValue};

/// A reference to the binary part.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct BinaryReference {
    byte_offset: usize,
    component_type: String,
    #[serde(rename = "type")]
    kind: String,
}

/// Reads a batch table with `rows` rows. Properties that are invalid are left out; `note` gets the reason. Returns `None` for an
/// empty table.
pub(in crate::formats) fn batch_table(
    json: &[u8],
    binary: &[u8],
    rows: usize,
    limits: &Limits,
    note: &dyn Fn(&'static str),
) -> Option<PropertyTable> {
    if json.iter().all(|byte| byte.is_ascii_whitespace() || *byte == 0) {
        return None;
    }
    if limits.check_json("", json).is_err() {
        note("batch table that is too large");
        return None;
    }
    let Ok(properties) = feature_table::parse::<Map<String, Value>>(json) else {
        note("batch table that is invalid");
        return None;
    };
    let mut columns: Vec<Column> = Vec::new();
    for (name, property) in properties {
        match property {
            Value::Array(values) => {
                if values.len() < rows {
                    note("batch table: a property with fewer values than features");
                }
                columns.push((name.into(), Box::new(JsonColumn(values))));
            }
            Value::Object(_) if name == "extensions" || name == "HIERARCHY" => {
                note("batch table: hierarchy or extensions")
            }
            Value::Object(_) if name != "extras" => match binary_column(&property, binary, rows) {
                Some(column) => columns.push((name.into(), Box::new(column))),
                None => note("batch table: a property that is invalid"),
            },
            _ => {}
        }
    }
    Some(PropertyTable::new("batch table".to_owned(), String::new(), rows, columns))
}

fn binary_column(property: &Value, binary: &[u8], rows: usize) -> Option<BinaryColumn> {
    let reference = BinaryReference::deserialize(property).ok()?;
    let component = Component::from_name(&reference.component_type)?;
    let components = ["SCALAR", "VEC2", "VEC3", "VEC4"].iter().position(|kind| *kind == reference.kind)? + 1;
    let size = rows.checked_mul(components)?.checked_mul(component.size_bytes())?;
    let values = binary.get(reference.byte_offset..reference.byte_offset.checked_add(size)?)?;
    Some(BinaryColumn {
        kind: PropertyType::plain(Element::Numbers { component, components }),
        values: values.to_vec().into(),
        array_offsets: None,
        string_offsets: None,
    })
}

/// A column of JSON values.
struct JsonColumn(Vec<Value>);

impl PropertyColumn for JsonColumn {
    fn value(&self, row: usize) -> PropertyValue {
        self.0.get(row).map_or(PropertyValue::Null, |value| from_json(value, &Element::Text))
    }

    fn size_bytes(&self) -> usize {
        self.0.len() * size_of::<Value>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_and_binary_properties_are_read() {
        let json = br#"{"name":["a","b"],"level":[1,-2],"height":{"byteOffset":4,"componentType":"FLOAT","type":"SCALAR"},"size":{"byteOffset":12,"componentType":"UNSIGNED_BYTE","type":"VEC2"},"extras":{"x":1},"beyond":{"byteOffset":14,"componentType":"INT","type":"SCALAR"}}"#;
        let mut binary = vec![0; 4];
        binary.extend([1.5f32, 2.5].iter().flat_map(|x| x.to_le_bytes()));
        binary.extend([1, 2, 3, 4]);
        let notes = std::cell::Cell::new(0);
        let table = batch_table(json, &binary, 2, &Limits::default(), &|_| notes.set(notes.get() + 1)).unwrap();
        let row: Vec<String> = table.row(1).into_iter().map(|(name, value)| format!("{name} {value}")).collect();
        assert_eq!((row.join("; ").as_str(), notes.get()), ("height 2.5; level -2; name b; size [3, 4]", 1));
        // The list is shorter than the table: the values that it lacks are absent.
        let short = br#"{"name":["a"]}"#;
        let table = batch_table(short, &[], 2, &Limits::default(), &|_| notes.set(notes.get() + 1)).unwrap();
        assert_eq!((&table.row(1)[0].1, notes.get()), (&PropertyValue::Null, 2));
        assert!(batch_table(b"   \0", &[], 0, &Limits::default(), &|_| {}).is_none());
        assert!(batch_table(b"{", &[], 0, &Limits::default(), &|_| notes.set(9)).is_none() && notes.get() == 9);
    }
}
