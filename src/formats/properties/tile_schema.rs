//! [`TileSchema`]: the part of a tileset's schema that its tile tree depends on. Members that are invalid spoil only
//! themselves. Immutable; decode threads.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use super::component::component_count;
use crate::formats::lenient::{Text, or_default};

/// The classes of a schema.
#[derive(Clone, Debug, Default, Deserialize)]
pub(in crate::formats) struct TileSchema {
    #[serde(default, deserialize_with = "or_default")]
    pub classes: BTreeMap<String, TileClass>,
}

#[derive(Clone, Debug, Default, Deserialize)]
pub(in crate::formats) struct TileClass {
    #[serde(default, deserialize_with = "or_default")]
    pub properties: BTreeMap<String, TileProperty>,
}

/// A property of a class.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(in crate::formats) struct TileProperty {
    #[serde(rename = "type", default)]
    pub kind: Text,
    #[serde(default)]
    pub component_type: Text,
    #[serde(default, deserialize_with = "or_default")]
    pub array: bool,
    /// The number of elements of an array; `None` for arrays of any length.
    pub count: Option<usize>,
    #[serde(default, deserialize_with = "or_default")]
    pub normalized: bool,
    pub offset: Option<Value>,
    pub scale: Option<Value>,
    #[serde(default)]
    pub semantic: Text,
}

impl TileProperty {
    /// Returns the number of components of an element; `None` if the elements are no numbers.
    pub(super) fn components(&self) -> Option<usize> {
        component_count(self.kind.0.as_deref()?)
    }
}
