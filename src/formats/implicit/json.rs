//! The JSON of implicit tiling and of subtrees as serde reads it, with the names of 1.1 and of the 1.0 extensions.

use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::Value;

use crate::formats::lenient::{Text, list, optional_object, or_default, valid_or_default};
use crate::formats::properties::TableJson;

/// `implicitTiling` of a tile, or its extension `3DTILES_implicit_tiling`.
#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(in crate::formats) struct ImplicitTilingJson {
    #[serde(default)]
    pub subdivision_scheme: Text,
    #[serde(default, deserialize_with = "valid_or_default")]
    pub subtree_levels: Option<u32>,
    #[serde(default, deserialize_with = "valid_or_default")]
    pub available_levels: Option<u32>,
    /// The extension's name in older drafts: the number of levels less one.
    #[serde(default, deserialize_with = "valid_or_default")]
    pub maximum_level: Option<u32>,
    #[serde(default, deserialize_with = "optional_object")]
    pub subtrees: Option<SubtreesJson>,
}

#[derive(Debug, Default, Deserialize)]
pub(in crate::formats) struct SubtreesJson {
    #[serde(default)]
    pub uri: Text,
}

/// The JSON of a subtree.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SubtreeJson {
    #[serde(default, deserialize_with = "or_default")]
    pub buffers: Vec<BufferJson>,
    #[serde(default, deserialize_with = "or_default")]
    pub buffer_views: Vec<BufferViewJson>,
    pub tile_availability: Option<AvailabilityJson>,
    pub content_availability: Option<OneOrMany>,
    pub child_subtree_availability: Option<AvailabilityJson>,
    #[serde(default, deserialize_with = "or_default")]
    pub property_tables: Vec<TableJson>,
    /// The property table of the tiles that are available.
    #[serde(default, deserialize_with = "valid_or_default")]
    tile_metadata: Option<usize>,
    /// The property tables of the contents that are available, by the number of the content.
    #[serde(default, deserialize_with = "valid_or_default")]
    content_metadata: Vec<usize>,
    /// The metadata of the subtree itself.
    pub subtree_metadata: Option<Value>,
    pub extensions: Option<SubtreeExtensions>,
}

impl SubtreeJson {
    /// Returns the property table of the tiles.
    pub fn tile_table(&self) -> Option<&TableJson> {
        self.property_tables.get(self.tile_metadata?)
    }

    /// Returns the property table of a content of the tiles.
    pub fn content_table(&self, content: usize) -> Option<&TableJson> {
        self.property_tables.get(*self.content_metadata.get(content)?)
    }

    /// Returns true if the extension `3DTILES_metadata` of 1.0 is there, whose tables have another form.
    pub fn has_metadata_of_1_0(&self) -> bool {
        self.extensions.as_ref().is_some_and(|extensions| extensions.metadata.is_some())
    }

    /// Returns the availability of each content of a tile.
    pub fn content_availability(&self) -> &[AvailabilityJson] {
        let several = self.extensions.as_ref().and_then(|extensions| extensions.multiple_contents.as_ref());
        match (several, &self.content_availability) {
            (Some(several), _) => &several.content_availability,
            (None, Some(OneOrMany::Many(many))) => many,
            (None, Some(OneOrMany::One(one))) => std::slice::from_ref(one),
            (None, None) => &[],
        }
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct SubtreeExtensions {
    #[serde(rename = "3DTILES_multiple_contents")]
    multiple_contents: Option<MultipleContentsJson>,
    #[serde(rename = "3DTILES_metadata")]
    metadata: Option<IgnoredAny>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
struct MultipleContentsJson {
    #[serde(default, deserialize_with = "list")]
    content_availability: Vec<AvailabilityJson>,
}

/// A list in 1.1, one object in 1.0.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum OneOrMany {
    Many(Vec<AvailabilityJson>),
    One(AvailabilityJson),
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferJson {
    #[serde(default)]
    pub uri: Text,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferViewJson {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct AvailabilityJson {
    bitstream: Option<usize>,
    /// The name of `bitstream` in 1.0.
    buffer_view: Option<usize>,
    constant: Option<u32>,
}

impl AvailabilityJson {
    /// Returns the buffer view of the bits; `None` for a constant.
    pub fn view(&self) -> Option<usize> {
        self.bitstream.or(self.buffer_view)
    }

    /// Returns the value that all elements have; `None` if they have their own bits.
    pub fn constant(&self) -> Option<bool> {
        self.constant.map(|constant| constant != 0)
    }
}
