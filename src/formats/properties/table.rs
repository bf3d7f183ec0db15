//! The property tables of EXT_structural_metadata and of subtrees. Decode threads.

use std::cell::Cell;

use serde::Deserialize;
use serde_json::Value;

use super::binary_column::{BinaryColumn, Offsets};
use super::component::Component;
use super::property_type::{Length, PropertyType};
use super::schema::{ClassProperty, Schema, TableJson, TableProperty, ValueChanges};
use super::shared_bytes::SharedBytes;
use crate::formats::lenient::Text;
use crate::scene::{Column, PropertyColumn, PropertyTable, PropertyValue};

/// The maximum number of columns of all property tables of a file. Each table has the defaults of its class.
const MAX_COLUMNS: usize = 1 << 16;

/// The schema and the buffers of a file with property tables.
pub(in crate::formats) struct TableSource<'a> {
    pub schema: &'a Schema,
    /// Returns the bytes of a buffer view.
    pub view: &'a dyn Fn(usize) -> Option<SharedBytes>,
    /// Gets the reason why something is left out.
    pub note: &'a dyn Fn(&'static str),
    /// The number of columns that may still be read.
    columns_left: Cell<usize>,
}

impl<'a> TableSource<'a> {
    pub fn new(
        schema: &'a Schema,
        view: &'a dyn Fn(usize) -> Option<SharedBytes>,
        note: &'a dyn Fn(&'static str),
    ) -> Self {
        Self { schema, view, note, columns_left: Cell::new(MAX_COLUMNS) }
    }

    /// Reads the `propertyTables` of a metadata object. A property that cannot be read is left out.
    pub fn tables(&self, metadata: &Value) -> Vec<PropertyTable> {
        let tables = metadata.get("propertyTables").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        let read = |table: &Value| match TableJson::deserialize(table) {
            Ok(table) => self.table(&table, &|_| true),
            Err(_) => {
                (self.note)("metadata: an invalid property table");
                // The indices of the tables after it stay as they are.
                PropertyTable::new(String::new(), String::new(), 0, Vec::new())
            }
        };
        tables.iter().map(read).collect()
    }

    /// Reads the properties of a table that `is_wanted`.
    pub fn table(&self, table: &TableJson, is_wanted: &dyn Fn(&ClassProperty) -> bool) -> PropertyTable {
        let class_name = table.class.0.clone().unwrap_or_default();
        let class = self.schema.classes.get(&class_name);
        if class.is_none() {
            (self.note)("metadata: a property table of an unknown class");
            return PropertyTable::new(table.name.0.clone().unwrap_or_default(), class_name, table.count, Vec::new());
        }
        let mut columns: Vec<Column> = Vec::new();
        for (name, property) in &table.properties {
            let of = class.and_then(|class| class.properties.get(name));
            if of.is_some_and(|of| !is_wanted(of)) {
                continue;
            }
            if !self.takes_column() {
                break;
            }
            match of.and_then(|of| self.column(name, of, property, table.count)) {
                Some(column) => columns.push(column),
                None => (self.note)("metadata: a property that is invalid"),
            }
        }
        // Properties of the class that the table lacks have their default.
        for (name, of) in class.iter().flat_map(|class| &class.properties).filter(|(_, of)| is_wanted(of)) {
            let none = ValueChanges::default();
            if of.default.is_some()
                && !table.properties.contains_key(name)
                && let Some(kind) = PropertyType::new(of, self.schema, &none)
            {
                if !self.takes_column() {
                    break;
                }
                columns.push((kind.info(name, of, &none), Box::new(Constant(kind.value(None)))));
            }
        }
        PropertyTable::new(table.name.0.clone().unwrap_or_default(), class_name, table.count, columns)
    }

    /// Counts a column; returns false if there are too many, which is noted.
    fn takes_column(&self) -> bool {
        let left = self.columns_left.get().checked_sub(1);
        match left {
            Some(left) => self.columns_left.set(left),
            None => (self.note)("metadata: properties beyond 65,536 of one file"),
        }
        left.is_some()
    }

    fn column(&self, name: &str, of: &ClassProperty, table: &TableProperty, rows: usize) -> Option<Column> {
        let kind = PropertyType::new(of, self.schema, &table.changes)?;
        let offsets = |at: Option<usize>, kind: &Text| -> Option<Option<Offsets>> {
            let Some(at) = at else { return Some(None) };
            let component = Component::from_name(kind.0.as_deref().unwrap_or("UINT32"))?;
            Some(Some(Offsets { component, bytes: (self.view)(at)? }))
        };
        let array_offsets = match kind.length {
            Length::Variable => Some(offsets(table.array_offsets, &table.array_offset_type)??),
            Length::Single | Length::Fixed(_) => None,
        };
        let info = kind.info(name, of, &table.changes);
        let values = (self.view)(table.values?)?;
        let string_offsets = offsets(table.string_offsets, &table.string_offset_type)?;
        let column = BinaryColumn { kind, values, array_offsets, string_offsets };
        if !column.has_rows(rows) {
            (self.note)("metadata: a property table whose buffer view is too short");
        }
        Some((info, Box::new(column)))
    }
}

impl TableJson {
    /// Returns the properties that the class of the table has, and what class and table say about them.
    pub fn known<'a>(&'a self, schema: &'a Schema) -> impl Iterator<Item = (&'a ClassProperty, &'a TableProperty)> {
        let class = self.class.0.as_deref().and_then(|class| schema.classes.get(class));
        let properties = class.into_iter().flat_map(|class| &class.properties);
        properties.filter_map(|(name, of)| Some((of, self.properties.get(name)?)))
    }
}

impl TableProperty {
    /// Returns the buffer views that the property needs.
    pub fn views(&self) -> impl Iterator<Item = usize> + use<> {
        [self.values, self.array_offsets, self.string_offsets].into_iter().flatten()
    }
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

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn tables(metadata: &Value, views: &[&[u8]]) -> (Vec<PropertyTable>, u32) {
        let notes = Cell::new(0);
        let view = |at: usize| views.get(at).map(|bytes| bytes.to_vec().into());
        let schema = Schema::deserialize(&metadata["schema"]).unwrap();
        let note = |_: &'static str| notes.set(notes.get() + 1);
        let tables = TableSource::new(&schema, &view, &note).tables(metadata);
        (tables, notes.get())
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
        assert_eq!(
            (tables.len(), notes, tables[0].row_count),
            (2, 4, 0),
            "an invalid table, and three columns are too short"
        );
        for row in [0, 1, 2, 3_999_999_999] {
            assert!(tables[1].row(row).iter().all(|(_, value)| *value == PropertyValue::Null), "{row}");
        }
        let schema = Schema::default();
        assert!(TableSource::new(&schema, &|_| None, &|_| {}).tables(&json!({})).is_empty());
    }

    /// Regression: a few bytes of a table had all defaults of its class.
    #[test]
    fn columns_of_many_tables_are_bounded() {
        let properties: serde_json::Map<String, Value> =
            (0..1000).map(|i| (format!("p{i}"), json!({ "type": "STRING", "default": "none" }))).collect();
        let metadata = json!({
            "schema": { "classes": { "c": { "properties": properties } } },
            "propertyTables": vec![json!({ "class": "c", "count": 1 }); 100],
        });
        let (tables, notes) = tables(&metadata, &[]);
        let columns: usize = tables.iter().map(|table| table.properties().count()).sum();
        assert_eq!((tables.len(), columns, notes), (100, MAX_COLUMNS, 35));
        // Rows of any length may not be longer than a value may be.
        let metadata = json!({
            "schema": { "classes": { "c": { "properties": { "a": { "type": "BOOLEAN", "array": true } } } } },
            "propertyTables": [{ "class": "c", "count": 2, "properties": { "a": { "values": 0, "arrayOffsets": 1 } } }],
        });
        let bits = vec![0; 1 << 18];
        let offsets = [0u32, 1 << 20, 1 << 21].iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>();
        let row = |table: &PropertyTable, row: usize| matches!(table.value("a", row), Some(PropertyValue::List(_)));
        let (table, _) = self::tables(&metadata, &[&bits, &offsets]);
        assert!(row(&table[0], 0) && row(&table[0], 1));
        let offsets = [0u32, (1 << 20) + 1, 1 << 21].iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>();
        let (table, _) = self::tables(&metadata, &[&bits, &offsets]);
        assert!(!row(&table[0], 0) && row(&table[0], 1));
    }

    /// A table's own offset, scale, minimum and maximum replace those of the class. The stored value is compared with noData.
    #[test]
    fn tables_replace_what_the_class_says() {
        let metadata = json!({
            "schema": {
                "classes": { "c": { "properties": {
                    "plain": { "type": "SCALAR", "componentType": "UINT8", "scale": 2 },
                    "scaled": { "type": "VEC2", "componentType": "UINT8", "normalized": true, "scale": [255, 510],
                        "offset": [1, 2], "noData": [255.0, 0], "default": [0.5, 1.5], "min": [0, 0], "max": [9, 9] },
                    "use": { "type": "ENUM", "enumType": "use", "noData": "none", "semantic": "USE" },
                    "years": { "type": "SCALAR", "componentType": "UINT8", "array": true, "count": 2, "noData": [2, 3] },
                    "name": { "type": "STRING", "required": true, "default": "anon" },
                    "missing": { "type": "STRING", "required": true },
                } } },
                "enums": { "use": { "values": [{ "name": "none", "value": 0 }, { "name": "flat", "value": 300 }] } },
            },
            "propertyTables": [
                { "class": "c", "count": 2, "properties": {
                    "plain": { "values": 0 }, "scaled": { "values": 0 }, "use": { "values": 1 }, "years": { "values": 2 },
                } },
                { "class": "c", "count": 2, "properties": {
                    "plain": { "values": 0, "offset": 7 },
                    "scaled": { "values": 0, "offset": 10, "scale": [510, 255], "max": [20, 20] },
                } },
            ],
        });
        let (tables, notes) = tables(&metadata, &[&[255, 0, 51, 255], &[0, 0, 44, 1], &[1, 2, 2, 3]]);
        let row = |table: &PropertyTable, row: usize| -> String {
            let values = table.row(row).into_iter().map(|(name, value)| format!("{name} {value}"));
            values.collect::<Vec<_>>().join("; ")
        };
        assert_eq!(notes, 0);
        assert_eq!(row(&tables[0], 0), "plain 255; scaled [0.5, 1.5]; use null; years [1, 2]; name anon");
        assert_eq!(row(&tables[0], 1), "plain 0; scaled [52, 512]; use flat; years null; name anon");
        assert_eq!(row(&tables[1], 1), "plain 0; scaled [112, 265]; name anon");
        assert_eq!(tables[0].value_by_semantic("USE", 1).unwrap().as_str(), Some("flat"));
        let max = |table: &PropertyTable| table.properties().find(|p| p.name == "scaled").unwrap().max.to_string();
        assert_eq!((max(&tables[0]).as_str(), max(&tables[1]).as_str()), ("[9, 9]", "[20, 20]"));
    }
}
