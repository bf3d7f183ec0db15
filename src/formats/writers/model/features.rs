//! [`Features`]: feature ids and property tables of a glb: EXT_mesh_features and EXT_structural_metadata. Any thread.

use std::collections::HashMap;
use std::sync::Arc;

use serde_json::{Map, Value, json};

use crate::formats::ignored::Notes;
use crate::formats::writers::buffers::{Accuracy, Buffers, Component, Elements};
use crate::scene::{DrawableFeatures, FeatureIds, PropertyTable, PropertyValue};

pub(super) const MESH_FEATURES: &str = "EXT_mesh_features";
pub(super) const STRUCTURAL_METADATA: &str = "EXT_structural_metadata";

/// The largest whole number from which on floats have gaps.
const MAX_FLOAT_ID: u32 = 1 << 24;

/// The property tables of one glb. One thread.
#[derive(Default)]
pub(super) struct Features {
    classes: Map<String, Value>,
    tables: Vec<Value>,
    /// The indices of tables by the address of theirs.
    known: HashMap<usize, usize>,
    pub has_ids: bool,
}

impl Features {
    /// Adds the attributes of a drawable's feature ids. Returns the object of EXT_mesh_features, if there are any.
    pub fn add(
        &mut self,
        features: &DrawableFeatures,
        vertices: usize,
        attributes: &mut Map<String, Value>,
        buffers: &mut Buffers,
        notes: &Notes,
    ) -> Option<Value> {
        let mut sets = Vec::new();
        for set in &features.sets {
            let mut json = json!({});
            let ids: Arc<[u32]> = match &set.ids {
                FeatureIds::PerVertex(ids) if ids.len() == vertices => ids.clone(),
                FeatureIds::Uniform(id) => vec![*id; vertices].into(),
                FeatureIds::VertexIndex => Arc::default(),
                FeatureIds::PerVertex(_) | FeatureIds::Texture(_) => {
                    notes.add("features: ids in a texture");
                    continue;
                }
            };
            let null_id = set.null_id.map_or(u32::MAX, |id| id);
            let mut distinct: Vec<u32> = ids.iter().copied().filter(|id| *id != null_id).collect();
            distinct.sort_unstable();
            distinct.dedup();
            let is_implicit = matches!(set.ids, FeatureIds::VertexIndex);
            json["featureCount"] = if is_implicit { vertices } else { distinct.len().max(1) }.into();
            if !is_implicit {
                let Some(accessor) = id_accessor(&ids, buffers) else {
                    notes.add("features: ids beyond 2^24");
                    continue;
                };
                let number = (0..).find(|number| !attributes.contains_key(&format!("_FEATURE_ID_{number}")));
                let number: u32 = number.unwrap_or(0);
                attributes.insert(format!("_FEATURE_ID_{number}"), accessor.into());
                json["attribute"] = number.into();
            }
            if let Some(id) = set.null_id {
                json["nullFeatureId"] = id.into();
            }
            if is_label(&set.label) {
                json["label"] = set.label.clone().into();
            }
            if let Some(table) = set.table.and_then(|table| features.tables.get(table))
                && let Some(table) = self.table(table, buffers, notes)
            {
                json["propertyTable"] = table.into();
            }
            sets.push(json);
        }
        for _ in features.surface.iter() {
            notes.add("features: property textures and property attributes");
        }
        self.has_ids |= !sets.is_empty();
        (!sets.is_empty()).then(|| json!({ "featureIds": sets }))
    }

    /// Returns the index of a table; `None` for one without rows or properties.
    fn table(&mut self, table: &Arc<PropertyTable>, buffers: &mut Buffers, notes: &Notes) -> Option<usize> {
        let key = Arc::as_ptr(table).addr();
        if let Some(known) = self.known.get(&key) {
            return Some(*known);
        }
        let (mut of_class, mut of_table) = (Map::new(), Map::new());
        for (column, info) in table.properties().enumerate() {
            let values = (0..table.row_count).map(|row| table.value_at(column, row).unwrap_or_default()).collect();
            let Some(written) = Column::of(values, notes) else { continue };
            let id = identifier(&info.name, |id| of_class.contains_key(id));
            let mut property = written.class;
            if id != info.name {
                property["name"] = info.name.clone().into();
            }
            if !info.semantic.is_empty() {
                property["semantic"] = info.semantic.clone().into();
            }
            let mut values = json!({ "values": buffers.view(&written.values) });
            if let Some(offsets) = &written.offsets {
                values["stringOffsets"] = buffers.view(bytemuck::cast_slice(offsets)).into();
            }
            of_class.insert(id.clone(), property);
            of_table.insert(id, values);
        }
        if of_class.is_empty() || table.row_count == 0 {
            return None;
        }
        let class = identifier(&table.class, |id| self.classes.contains_key(id));
        self.classes.insert(class.clone(), json!({ "properties": of_class }));
        let mut json = json!({ "class": class, "count": table.row_count, "properties": of_table });
        if !table.name.is_empty() {
            json["name"] = table.name.clone().into();
        }
        self.tables.push(json);
        self.known.insert(key, self.tables.len() - 1);
        Some(self.tables.len() - 1)
    }

    /// Returns the object of EXT_structural_metadata; `None` without tables.
    pub fn metadata(self) -> Option<Value> {
        let schema = json!({ "id": "converted", "classes": self.classes });
        (!self.tables.is_empty()).then(|| json!({ "schema": schema, "propertyTables": self.tables }))
    }
}

/// Adds an attribute of ids: glTF has no 32-bit whole numbers for vertices. Returns `None` if a float cannot hold one.
fn id_accessor(ids: &[u32], buffers: &mut Buffers) -> Option<usize> {
    let largest = ids.iter().copied().max().unwrap_or(0);
    let (component, bytes): (_, Vec<u8>) = match largest {
        0..=0xff => (Component::U8, ids.iter().flat_map(|id| [*id as u8, 0, 0, 0]).collect()),
        0x100..=0xffff => {
            let padded: Vec<[u16; 2]> = ids.iter().map(|id| [*id as u16, 0]).collect();
            (Component::U16, bytemuck::cast_slice(&padded).to_vec())
        }
        0x1_0000..=MAX_FLOAT_ID => {
            let floats: Vec<f32> = ids.iter().map(|id| *id as f32).collect();
            (Component::F32, bytemuck::cast_slice(&floats).to_vec())
        }
        _ => return None,
    };
    let (is_normalized, accuracy) = (false, Accuracy::Exact);
    let elements = Elements { kind: "SCALAR", component, is_normalized, stride: 4, bytes: &bytes, accuracy };
    Some(buffers.attribute(&elements))
}

/// Returns true for a label that the extension allows: an identifier.
fn is_label(label: &str) -> bool {
    !label.is_empty() && identifier(label, |_| false) == label
}

/// Returns an identifier for a name: letters, digits and underscores, not beginning with a digit, and not taken.
fn identifier(name: &str, is_taken: impl Fn(&str) -> bool) -> String {
    let mut id: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if id.is_empty() || id.starts_with(|c: char| c.is_ascii_digit()) {
        id.insert(0, '_');
    }
    let numbered = |number: u32| format!("{id}_{number}");
    if is_taken(&id) { (2..).map(numbered).find(|id| !is_taken(id)).unwrap_or(id) } else { id }
}

/// The values of a property as a table holds them.
struct Column {
    /// The property in the class.
    class: Value,
    values: Vec<u8>,
    /// The offsets of texts, one more than there are rows.
    offsets: Option<Vec<u32>>,
}

impl Column {
    /// Encodes values by the type that all of them have. Others become texts. `None` for a column without any value.
    fn of(values: Vec<PropertyValue>, notes: &Notes) -> Option<Self> {
        use PropertyValue::{Bool, Float, Int, Null, Text, UInt};
        if values.iter().all(|value| *value == Null) {
            return None;
        }
        let all = |is: fn(&PropertyValue) -> bool| values.iter().all(is);
        let numbers = |component: &str, encode: fn(&PropertyValue) -> [u8; 8]| Self {
            class: json!({ "type": "SCALAR", "componentType": component }),
            values: values.iter().flat_map(encode).collect(),
            offsets: None,
        };
        if all(|value| matches!(value, Bool(_))) {
            let mut bits = vec![0; values.len().div_ceil(8)];
            for (row, _) in values.iter().enumerate().filter(|(_, value)| **value == Bool(true)) {
                bits[row / 8] |= 1 << (row % 8);
            }
            return Some(Self { class: json!({ "type": "BOOLEAN" }), values: bits, offsets: None });
        }
        if all(|value| matches!(value, Int(_))) {
            return Some(numbers("INT64", |value| if let Int(n) = value { n.to_le_bytes() } else { [0; 8] }));
        }
        if all(|value| matches!(value, UInt(_))) {
            return Some(numbers("UINT64", |value| if let UInt(n) = value { n.to_le_bytes() } else { [0; 8] }));
        }
        if all(|value| matches!(value, Float(_) | Int(_) | UInt(_) | Null)) {
            // NaN stands for rows without a value.
            return Some(numbers("FLOAT64", |value| value.as_f64().unwrap_or(f64::NAN).to_le_bytes()));
        }
        if let Some(lists) = Self::of_lists(&values) {
            return Some(lists);
        }
        if !all(|value| matches!(value, Text(_) | Null)) {
            notes.add("features: properties of several types, which become texts");
        }
        let (mut bytes, mut offsets) = (Vec::new(), vec![0]);
        for value in &values {
            if *value != Null {
                bytes.extend_from_slice(value.to_string().as_bytes());
            }
            offsets.push(u32::try_from(bytes.len()).ok()?);
        }
        let is_any_null = values.contains(&Null);
        let mut class = json!({ "type": "STRING" });
        if is_any_null {
            class["noData"] = "".into();
        }
        // A view has at least one byte.
        bytes.resize(bytes.len().max(1), 0);
        Some(Self { class, values: bytes, offsets: Some(offsets) })
    }

    /// Encodes lists of the same number of numbers.
    fn of_lists(values: &[PropertyValue]) -> Option<Self> {
        let PropertyValue::List(first) = values.first()? else { return None };
        let count = first.len();
        let mut bytes = Vec::new();
        for value in values {
            let PropertyValue::List(list) = value else { return None };
            if list.len() != count || count < 2 {
                return None;
            }
            for number in list {
                bytes.extend(number.as_f64()?.to_le_bytes());
            }
        }
        let class = json!({ "type": "SCALAR", "componentType": "FLOAT64", "array": true, "count": count });
        Some(Self { class, values: bytes, offsets: None })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(values: Vec<PropertyValue>) -> Column {
        Column::of(values, &Notes::default()).unwrap()
    }

    #[test]
    fn columns_have_the_type_of_their_values() {
        use PropertyValue::{Bool, Float, Int, List, Null, Text, UInt};
        let bits = column(vec![Bool(true), Bool(false), Bool(true)]);
        assert_eq!((bits.class["type"].as_str(), bits.values), (Some("BOOLEAN"), vec![0b101]));
        assert_eq!(column(vec![Int(-2)]).values, (-2i64).to_le_bytes());
        assert_eq!(column(vec![UInt(2)]).class["componentType"], "UINT64");
        assert_eq!(column(vec![Int(1), Float(0.5), Null]).class["componentType"], "FLOAT64");
        let text = column(vec![Text("ab".into()), Null, Text("c".into())]);
        assert_eq!((text.values.as_slice(), text.offsets), (&b"abc"[..], Some(vec![0, 2, 2, 3])));
        let mixed = column(vec![Text("a".into()), Int(7)]);
        assert_eq!(mixed.values, b"a7");
        let list = column(vec![List(vec![Float(1.0), Float(2.0)]), List(vec![Int(3), Int(4)])]);
        assert_eq!((list.class["count"].as_u64(), list.values.len()), (Some(2), 32));
        assert!(Column::of(vec![Null, Null], &Notes::default()).is_none());
    }

    #[test]
    fn names_become_identifiers() {
        assert_eq!(identifier("roof height", |_| false), "roof_height");
        assert_eq!(identifier("1st", |_| false), "_1st");
        assert_eq!(identifier("a", |id| id == "a" || id == "a_2"), "a_3");
        assert!(is_label("rooms") && !is_label("my rooms") && !is_label(""));
    }
}
