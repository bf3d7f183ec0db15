//! The property tables of EXT_structural_metadata.

use serde::Deserialize;
use serde_json::Value;

use super::binary_column::{BinaryColumn, Element, Offsets, Rows, from_json, numbers};
use super::component::Component;
use super::schema::{ClassProperty, Schema, TableJson, TableProperty};
use crate::formats::lenient::Text;
use crate::scene::{PropertyColumn, PropertyTable, PropertyValue};

/// Reads the `propertyTables` of a metadata object whose schema is `schema`. `view` returns the bytes of a buffer
/// view. A property that cannot be read is left out; `note` gets the reason.
pub(in crate::formats) fn property_tables(
    metadata: &Value,
    schema: &Schema,
    view: &dyn Fn(usize) -> Option<Vec<u8>>,
    note: &dyn Fn(&'static str),
) -> Vec<PropertyTable> {
    let tables = metadata.get("propertyTables").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let read = |table: &Value| match TableJson::deserialize(table) {
        Ok(table) => read_table(table, schema, view, note),
        Err(_) => {
            note("metadata: an invalid property table");
            // The indices of the tables after it stay as they are.
            PropertyTable::new(String::new(), String::new(), 0, Vec::new())
        }
    };
    tables.iter().map(read).collect()
}

fn read_table(
    table: TableJson,
    schema: &Schema,
    view: &dyn Fn(usize) -> Option<Vec<u8>>,
    note: &dyn Fn(&'static str),
) -> PropertyTable {
    let class_name = table.class.0.unwrap_or_default();
    let class = schema.classes.get(&class_name);
    let mut columns: Vec<(String, Box<dyn PropertyColumn>)> = Vec::new();
    for (name, property) in table.properties {
        let column = class.and_then(|class| column(class.properties.get(&name)?, &property, schema, view));
        match column {
            Some(column) => columns.push((name, Box::new(column))),
            None => note("metadata: a property that is invalid"),
        }
    }
    // Properties of the class that the table lacks have their default.
    for (name, property) in class.iter().flat_map(|class| &class.properties) {
        if let Some(default) = &property.default
            && !columns.iter().any(|(known, _)| known == name)
            && let Some(element) = element(property, schema)
        {
            columns.push((name.clone(), Box::new(Constant(from_json(default, &element)))));
        }
    }
    PropertyTable::new(table.name.0.unwrap_or_default(), class_name, table.count, columns)
}

/// A column with the same value in each row.
struct Constant(PropertyValue);

impl PropertyColumn for Constant {
    fn value(&self, _row: usize) -> PropertyValue {
        self.0.clone()
    }

    fn size_bytes(&self) -> usize {
        size_of::<Self>()
    }
}

fn column(
    of: &ClassProperty,
    table: &TableProperty,
    schema: &Schema,
    view: &dyn Fn(usize) -> Option<Vec<u8>>,
) -> Option<BinaryColumn> {
    let element = element(of, schema)?;
    let offsets = |at: Option<usize>, kind: &Text| -> Option<Option<Offsets>> {
        let Some(at) = at else { return Some(None) };
        let component = Component::from_name(kind.0.as_deref().unwrap_or("UINT32"))?;
        Some(Some(Offsets { component, bytes: view(at)? }))
    };
    let rows = match (of.array, of.count) {
        (false, _) => Rows::Single,
        (true, Some(count)) => Rows::Fixed(count),
        (true, None) => Rows::Variable(offsets(table.array_offsets, &table.array_offset_type)??),
    };
    let no_data = of.no_data.as_ref().map(|value| from_json(value, &element));
    let default = of.default.as_ref().map_or(PropertyValue::Null, |value| from_json(value, &element));
    Some(BinaryColumn {
        rows,
        values: view(table.values?)?,
        string_offsets: offsets(table.string_offsets, &table.string_offset_type)?,
        normalized: of.normalized,
        scale: numbers(table.scale.as_ref().or(of.scale.as_ref())),
        offset: numbers(table.offset.as_ref().or(of.offset.as_ref())),
        no_data,
        default,
        element,
    })
}

fn element(of: &ClassProperty, schema: &Schema) -> Option<Element> {
    match of.kind.0.as_deref()? {
        "BOOLEAN" => Some(Element::Bool),
        "STRING" => Some(Element::Text),
        "ENUM" => {
            let values = schema.enums.get(of.enum_type.0.as_deref()?)?;
            let component = Component::from_name(values.value_type.0.as_deref().unwrap_or("UINT16"))?;
            let names = values.values.iter().map(|value| (value.value, value.name.clone())).collect();
            Some(Element::Enum { component, names })
        }
        _ => {
            let component = Component::from_name(of.component_type.0.as_deref()?)?;
            Some(Element::Numbers { component, components: of.components()? })
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use serde_json::json;

    use super::*;

    fn tables(metadata: &Value, views: &[&[u8]]) -> (Vec<PropertyTable>, u32) {
        let notes = Cell::new(0);
        let view = |at: usize| views.get(at).map(|bytes| bytes.to_vec());
        let schema = Schema::deserialize(&metadata["schema"]).unwrap();
        (property_tables(metadata, &schema, &view, &|_| notes.set(notes.get() + 1)), notes.get())
    }

    #[test]
    fn every_type_of_property_is_read() {
        let property = |kind: &str, component: &str| json!({ "type": kind, "componentType": component });
        let metadata = json!({
            "schema": {
                "classes": { "building": { "properties": {
                    "height": property("SCALAR", "FLOAT32"),
                    "scaled": { "type": "SCALAR", "componentType": "FLOAT64", "scale": 2, "offset": 1 },
                    "share": { "type": "VEC2", "componentType": "UINT8", "normalized": true },
                    "big": property("SCALAR", "INT64"),
                    "old": { "type": "BOOLEAN" },
                    "name": { "type": "STRING" },
                    "use": { "type": "ENUM", "enumType": "use" },
                    "years": { "type": "SCALAR", "componentType": "UINT16", "array": true },
                    "pair": { "type": "SCALAR", "componentType": "INT8", "array": true, "count": 2 },
                    "gap": { "type": "SCALAR", "componentType": "INT16", "noData": -1, "default": 7 },
                    "absent": { "type": "STRING", "default": "none" },
                } } },
                "enums": { "use": { "valueType": "UINT8", "values": [{ "name": "flat", "value": 3 }] } },
            },
            "propertyTables": [{ "name": "t", "class": "building", "count": 2, "properties": {
                "height": { "values": 0 }, "scaled": { "values": 1 }, "share": { "values": 2 }, "big": { "values": 3 },
                "old": { "values": 4 }, "name": { "values": 5, "stringOffsets": 6 }, "use": { "values": 7 },
                "years": { "values": 8, "arrayOffsets": 9, "arrayOffsetType": "UINT8" }, "pair": { "values": 10 },
                "gap": { "values": 11 }, "unknown": { "values": 0 },
            } }],
        });
        let floats: Vec<u8> = [1.5f32, -2.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let doubles: Vec<u8> = [3.0f64, 4.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let longs: Vec<u8> = [i64::MIN, 5].iter().flat_map(|x| x.to_le_bytes()).collect();
        let offsets: Vec<u8> = [0u32, 2, 5].iter().flat_map(|x| x.to_le_bytes()).collect();
        let views: [&[u8]; 12] = [
            &floats,
            &doubles,
            &[255, 0, 51, 255],
            &longs,
            &[0b10],
            "aböc".as_bytes(),
            &offsets,
            &[3, 4],
            &[1, 0, 2, 0, 3, 0],
            &[0, 1, 3],
            &[1, 2, 3, 255],
            &[255, 255, 9, 0],
        ];
        let (tables, notes) = tables(&metadata, &views);
        assert_eq!((tables.len(), notes), (1, 1), "one property is unknown");
        let row = |row: usize| -> Vec<String> {
            tables[0].row(row).into_iter().map(|(name, value)| format!("{name} {value}")).collect()
        };
        assert_eq!(
            row(0).join("; "),
            "big -9223372036854775808; gap 7; height 1.5; name ab; old false; pair [1, 2]; scaled 7; share [1, 0]; use flat; years [1]; absent none"
        );
        assert_eq!(
            row(1).join("; "),
            "big 5; gap 9; height -2; name öc; old true; pair [3, -1]; scaled 9; share [0.2, 1]; use 4; years [2, 3]; absent none"
        );
        assert!(row(2).is_empty());
    }

    #[test]
    fn damaged_tables_have_null_values() {
        let metadata = json!({
            "schema": { "classes": { "c": { "properties": {
                "a": { "type": "STRING" },
                "b": { "type": "SCALAR", "componentType": "UINT32", "array": true },
                "d": { "type": "MAT4", "componentType": "FLOAT32" },
            } } } },
            "propertyTables": [7, { "class": "c", "count": 4_000_000_000u32, "properties": {
                "a": { "values": 0, "stringOffsets": 1 }, "b": { "values": 0, "arrayOffsets": 2 }, "d": { "values": 0 },
            } }],
        });
        let huge = [0u32.to_le_bytes(), u32::MAX.to_le_bytes(), 1u32.to_le_bytes()].concat();
        let (tables, notes) = tables(&metadata, &[b"abc", &huge, &huge]);
        assert_eq!((tables.len(), notes, tables[0].row_count), (2, 1, 0));
        for row in [0, 1, 2, 3_999_999_999] {
            assert!(tables[1].row(row).iter().all(|(_, value)| *value == PropertyValue::Null), "{row}");
        }
        assert!(super::property_tables(&json!({}), &Schema::default(), &|_| None, &|_| {}).is_empty());
    }
}
