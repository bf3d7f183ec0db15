//! [`Entities`]: metadata that a tileset has as JSON: of itself, of tiles, contents and groups. Decode threads.

use std::collections::HashMap;
use std::sync::Arc;

use serde::Deserialize;
use serde_json::Value;

use super::metadata_budget::MetadataBudget;
use super::property_type::PropertyType;
use super::schema::{EntityJson, Schema, ValueChanges};
use crate::scene::{Metadata, MetadataClass, PropertyInfo};

/// A class with the types of its properties.
struct EntityClass {
    class: Arc<MetadataClass>,
    types: Vec<PropertyType>,
}

/// Reads metadata with the classes of a schema, which all entities of a class share.
pub(in crate::formats) struct Entities<'a> {
    schema: &'a Schema,
    /// By name; `None` for names that the schema lacks.
    classes: HashMap<String, Option<EntityClass>>,
    budget: MetadataBudget,
}

impl<'a> Entities<'a> {
    pub fn new(schema: &'a Schema) -> Self {
        Self { schema, classes: HashMap::new(), budget: MetadataBudget::default() }
    }

    /// Reads metadata. Properties without a value have the default of their class. Returns `None` if the class is unknown;
    /// `note` gets the reason why something is left out.
    pub fn read(&mut self, json: &Value, note: &dyn Fn(&'static str)) -> Option<Arc<Metadata>> {
        let Ok(EntityJson { class, properties }) = EntityJson::deserialize(json) else {
            note("metadata that is invalid");
            return None;
        };
        let name = class.0.unwrap_or_default();
        let schema = self.schema;
        let known = self.classes.entry(name).or_insert_with_key(|name| read_class(schema, name, note));
        let Some(EntityClass { class, types }) = known else {
            note("metadata of an unknown class");
            return None;
        };
        // The properties of a class are sorted by name.
        let is_known = |name: &String| class.properties.binary_search_by(|known| known.name.cmp(name)).is_ok();
        let unknown = properties.keys().filter(|name| !is_known(name));
        unknown.for_each(|_| note("metadata: a property that is invalid"));
        let value = |(of, kind): (&PropertyInfo, &PropertyType)| kind.value_of_json(properties.get(&of.name));
        let values = class.properties.iter().zip(&*types).map(value).collect();
        self.budget.keep(Arc::new(Metadata::new(class.clone(), values)), note)
    }
}

fn read_class(schema: &Schema, name: &str, note: &dyn Fn(&'static str)) -> Option<EntityClass> {
    let none = ValueChanges::default();
    let (mut properties, mut types) = (Vec::new(), Vec::new());
    for (id, property) in &schema.classes.get(name)?.properties {
        match PropertyType::new(property, schema, &none) {
            Some(kind) => {
                properties.push(kind.info(id, property, &none));
                types.push(kind);
            }
            None => note("metadata: a property that is invalid"),
        }
    }
    Some(EntityClass { class: Arc::new(MetadataClass { name: name.to_owned(), properties }), types })
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use serde_json::json;

    use super::*;

    /// Regression: a tile of a few bytes had copies of all defaults of its class.
    #[test]
    fn memory_of_metadata_is_bounded() {
        let text = "x".repeat(3900);
        let properties: serde_json::Map<String, Value> =
            (0..4000).map(|i| (format!("p{i}"), json!({ "type": "STRING", "default": text }))).collect();
        let schema = Schema::deserialize(&json!({ "classes": { "c": { "properties": properties } } })).unwrap();
        let notes = Cell::new(0);
        let mut entities = Entities::new(&schema);
        let tile = json!({ "class": "c" });
        let kept = (0..12).filter_map(|_| entities.read(&tile, &|_| notes.set(notes.get() + 1))).count();
        assert_eq!((kept, notes.get()), (8, 4), "16 MB each");
    }

    #[test]
    fn json_has_the_types_of_its_class() {
        let schema = json!({
            "classes": { "tile": { "properties": {
                "share": { "type": "SCALAR", "componentType": "UINT8", "normalized": true },
                "height": { "type": "SCALAR", "componentType": "FLOAT32", "semantic": "TILE_MAXIMUM_HEIGHT", "scale": 2 },
                "use": { "type": "ENUM", "enumType": "use", "array": true },
                "gap": { "type": "SCALAR", "componentType": "INT16", "noData": -1, "default": 7 },
                "name": { "type": "STRING", "default": "anon" },
                "rest": { "type": "STRING" },
                "strange": { "type": "SCALAR", "componentType": "FLOAT16" },
            } } },
            "enums": { "use": { "values": [{ "name": "flat", "value": 3 }] } },
        });
        let schema = Schema::deserialize(&schema).unwrap();
        let notes = Cell::new(0);
        let note = |_: &'static str| notes.set(notes.get() + 1);
        let mut entities = Entities::new(&schema);
        let json = json!({ "class": "tile", "properties": {
            "share": 51, "height": 1.5, "use": ["flat"], "gap": -1, "other": 1,
        } });
        let read = entities.read(&json, &note).unwrap();
        let values = read.properties().map(|(of, value)| format!("{} {value}", of.name)).collect::<Vec<_>>();
        assert_eq!(values.join("; "), "gap 7; height 3; name anon; rest null; share 0.2; use [flat]");
        assert_eq!(read.value_by_semantic("TILE_MAXIMUM_HEIGHT").unwrap().as_f64(), Some(3.0));
        assert_eq!(notes.get(), 2, "a type and a property that are unknown");
        let again = entities.read(&json!({ "class": "tile", "properties": 7 }), &note).unwrap();
        assert!(std::ptr::eq(again.class(), read.class()) && again.value("name").unwrap().as_str() == Some("anon"));
        for (invalid, count) in [(json!({ "class": "no" }), 3), (json!({}), 4), (json!([1]), 5), (json!("tile"), 6)] {
            assert!(entities.read(&invalid, &note).is_none());
            assert_eq!(notes.get(), count, "{invalid}");
        }
    }
}
