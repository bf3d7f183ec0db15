//! The metadata of a tileset as JSON, for `terrane info` and applications.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The metadata that a tileset.json has, by the properties of 3D Tiles 1.1 or by the extension `3DTILES_metadata` of 1.0.
/// The values are kept as they are in the file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all(deserialize = "camelCase"))]
pub struct MetadataInfo {
    /// The schema: the classes with their properties, and the enums.
    pub schema: Option<Value>,
    /// The reference to a schema in another file.
    pub schema_uri: Option<Value>,
    /// The metadata of the tileset itself: its class and the values of its properties.
    #[serde(rename(deserialize = "metadata"))]
    pub tileset: Option<Value>,
    /// The groups that contents may belong to, with their metadata.
    pub groups: Option<Value>,
    /// Statistics of the properties of classes.
    pub statistics: Option<Value>,
    /// The ranges of per-feature properties, in sets of 1.0.
    pub properties: Option<Value>,
}

impl MetadataInfo {
    /// Reads the metadata from the JSON of a tileset; `None` if it has none or is invalid.
    pub(super) fn read(json: &[u8]) -> Option<Self> {
        // The file is read twice: one struct for both would have to keep all tiles.
        #[derive(Deserialize)]
        struct Tileset {
            extensions: Option<Extensions>,
        }
        #[derive(Deserialize)]
        struct Extensions {
            #[serde(rename = "3DTILES_metadata")]
            metadata: Option<MetadataInfo>,
        }
        let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
        let own: Self = serde_json::from_slice(json).ok()?;
        let Tileset { extensions } = serde_json::from_slice(json).ok()?;
        let by_extension = extensions.and_then(|extensions| extensions.metadata).unwrap_or_default();
        let all = Self {
            schema: own.schema.or(by_extension.schema),
            schema_uri: own.schema_uri.or(by_extension.schema_uri),
            tileset: own.tileset.or(by_extension.tileset),
            groups: own.groups.or(by_extension.groups),
            statistics: own.statistics.or(by_extension.statistics),
            properties: own.properties,
        };
        (all != Self::default()).then_some(all)
    }

    /// Returns the lowest and the highest sample of terrain, as `terrane gen` writes them, in metres; `None` for other sets.
    pub(super) fn terrain_heights_m(&self) -> Option<[f64; 2]> {
        if self.schema.as_ref()?.get("id")? != "terrane" {
            return None;
        }
        let properties = self.tileset.as_ref()?.get("properties")?;
        let number = |name: &str| properties.get(name)?.as_f64();
        Some([number("minimumHeight")?, number("maximumHeight")?])
    }

    /// Returns the names of the schema's classes.
    pub fn class_names(&self) -> Vec<&str> {
        let classes = self.schema.as_ref().and_then(|schema| schema.get("classes")?.as_object());
        classes.into_iter().flat_map(|classes| classes.keys()).map(String::as_str).collect()
    }

    /// Returns the groups with their names, or with their indices if they have no names.
    pub fn groups(&self) -> Vec<(String, &Value)> {
        match &self.groups {
            Some(Value::Array(groups)) => groups.iter().enumerate().map(|(i, group)| (i.to_string(), group)).collect(),
            // The extension of 1.0 names its groups.
            Some(Value::Object(groups)) => groups.iter().map(|(name, group)| (name.clone(), group)).collect(),
            _ => Vec::new(),
        }
    }

    /// Returns the number of groups.
    pub fn group_count(&self) -> usize {
        self.groups().len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metadata_is_kept_as_it_is_in_the_file() {
        let schema = r#"{"id":"s","classes":{"tile":{"properties":{"a":{"type":"STRING"}}},"group":{}}}"#;
        let of_1_1 = format!(
            r#"{{"asset":{{}},"schema":{schema},"metadata":{{"class":"tile","properties":{{"a":"x"}}}},
            "groups":[{{"class":"group"}},{{"class":"group"}}],"root":{{"children":[1,2]}},"statistics":null}}"#
        );
        let found = MetadataInfo::read(of_1_1.as_bytes()).unwrap();
        assert_eq!((found.class_names(), found.group_count()), (vec!["group", "tile"], 2));
        assert_eq!(found.groups()[1].0, "1");
        assert_eq!(found.tileset.as_ref().unwrap()["properties"]["a"], "x");
        assert_eq!(found.statistics, None);
        let of_1_0 = format!(
            r#"{{"extensions":{{"3DTILES_metadata":{{"schema":{schema},"groups":{{"a":{{}}}}}}}},"properties":{{"h":{{"minimum":1}}}}}}"#
        );
        let found = MetadataInfo::read(of_1_0.as_bytes()).unwrap();
        assert_eq!((found.class_names().len(), found.groups()[0].0.as_str()), (2, "a"));
        assert_eq!(found.terrain_heights_m(), None);
        assert_eq!(found.properties.unwrap()["h"]["minimum"], 1);
        let own = r#"{"schema":{"id":"terrane"},"metadata":{"properties":{"minimumHeight":-3.5,"maximumHeight":9}}}"#;
        assert_eq!(MetadataInfo::read(own.as_bytes()).unwrap().terrain_heights_m(), Some([-3.5, 9.0]));
        assert_eq!(MetadataInfo::read(br#"{"asset":{},"root":{}}"#), None);
        assert_eq!(MetadataInfo::read(b"["), None);
    }
}
