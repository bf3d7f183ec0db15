//! [`Metadata`] of tilesets, subtrees, tiles, contents and groups of contents. Plain CPU data, any thread.

use std::collections::HashSet;
use std::sync::Arc;

use super::property_table::PropertyInfo;
use super::property_value::PropertyValue;

/// A class of metadata with its properties.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MetadataClass {
    /// The name in the schema.
    pub name: String,
    /// The properties, sorted by name.
    pub properties: Vec<PropertyInfo>,
}

/// The values of one tileset, tile, content or group for the properties of its class.
#[derive(Clone, Debug, PartialEq)]
pub struct Metadata {
    class: Arc<MetadataClass>,
    /// A value for each property of the class.
    values: Box<[PropertyValue]>,
}

impl Metadata {
    /// Creates metadata. Properties beyond the end of `values` are [`PropertyValue::Null`].
    pub fn new(class: Arc<MetadataClass>, mut values: Vec<PropertyValue>) -> Self {
        values.resize(class.properties.len(), PropertyValue::Null);
        Self { class, values: values.into_boxed_slice() }
    }

    /// Returns the class.
    pub fn class(&self) -> &MetadataClass {
        &self.class
    }

    /// Returns the value of the property with a name; `None` if the class lacks it.
    pub fn value(&self, name: &str) -> Option<&PropertyValue> {
        self.find(|property| property.name == name)
    }

    /// Returns the value of the property with a meaning, such as `TILE_BOUNDING_SPHERE` or `NAME`; `None` if the class lacks
    /// it.
    pub fn value_by_semantic(&self, semantic: &str) -> Option<&PropertyValue> {
        self.find(|property| property.semantic == semantic)
    }

    /// Returns the properties of the class with their values.
    pub fn properties(&self) -> impl Iterator<Item = (&PropertyInfo, &PropertyValue)> {
        self.class.properties.iter().zip(&self.values)
    }

    fn find(&self, is_wanted: impl Fn(&PropertyInfo) -> bool) -> Option<&PropertyValue> {
        self.properties().find(|(property, _)| is_wanted(property)).map(|(_, value)| value)
    }

    /// Returns the bytes of memory without the class.
    pub(crate) fn size_bytes(&self) -> usize {
        size_of::<Self>() + self.values.iter().map(PropertyValue::size_bytes).sum::<usize>()
    }
}

/// The metadata of a node of a tile tree, or of a content; [`Scene::metadata`](crate::scene::Scene::metadata) returns it.
/// Each part is `None` if the tile set has none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TileMetadata {
    /// The metadata of the tileset; only at its root tile.
    pub tileset: Option<Arc<Metadata>>,
    /// The metadata of the subtree of implicit tiling; only at its root tile.
    pub subtree: Option<Arc<Metadata>>,
    /// The metadata of the tile.
    pub tile: Option<Arc<Metadata>>,
    /// The metadata of the content.
    pub content: Option<Arc<Metadata>>,
    /// The metadata of the group that the content belongs to.
    pub group: Option<Arc<Metadata>>,
}

impl TileMetadata {
    /// Returns these parts; `None` if there is none.
    pub(crate) fn shared(self) -> Option<Arc<Self>> {
        let is_some = self.parts().next().is_some();
        is_some.then(|| Arc::new(self))
    }

    /// Returns all parts of a tile, and the parts of its content.
    pub(crate) fn with_content(of_tile: Option<Arc<Self>>, of_content: Option<Arc<Self>>) -> Option<Arc<Self>> {
        match (of_tile, of_content) {
            (Some(tile), Some(content)) => {
                let (content, group) = (content.content.clone(), content.group.clone());
                Some(Arc::new(Self { content, group, ..(*tile).clone() }))
            }
            (one, other) => one.or(other),
        }
    }

    fn parts(&self) -> impl Iterator<Item = &Arc<Metadata>> {
        let Self { tileset, subtree, tile, content, group } = self;
        [tileset, subtree, tile, content, group].into_iter().flatten()
    }

    /// Returns the bytes of CPU memory beside metadata and classes whose addresses are in `counted`, and adds theirs.
    pub(crate) fn size_bytes_beside(&self, counted: &mut HashSet<usize>) -> usize {
        let mut bytes = size_of::<Self>();
        for part in self.parts() {
            if counted.insert(Arc::as_ptr(part).addr()) {
                bytes += part.size_bytes();
            }
            if counted.insert(Arc::as_ptr(&part.class).addr()) {
                bytes += part.class.properties.iter().map(PropertyInfo::size_bytes).sum::<usize>();
            }
        }
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_found_by_name_and_by_semantic() {
        let property =
            |name: &str, semantic: &str| PropertyInfo { semantic: semantic.into(), ..name.to_owned().into() };
        let properties = vec![property("height", "TILE_MAXIMUM_HEIGHT"), property("label", "NAME")];
        let class = Arc::new(MetadataClass { name: "tile".into(), properties });
        let metadata = Metadata::new(class, vec![PropertyValue::Float(2.0)]);
        assert_eq!(metadata.value("height"), Some(&PropertyValue::Float(2.0)));
        assert_eq!(metadata.value_by_semantic("NAME"), Some(&PropertyValue::Null));
        assert_eq!((metadata.value("NAME"), metadata.class().name.as_str()), (None, "tile"));
        let tile = TileMetadata { tile: Some(metadata.clone().into()), ..TileMetadata::default() };
        let content = TileMetadata { group: Some(metadata.into()), ..TileMetadata::default() };
        let both = TileMetadata::with_content(tile.clone().shared(), content.clone().shared()).unwrap();
        assert!(both.tile == tile.tile && both.group == content.group);
        assert_eq!(TileMetadata::default().shared(), None);
        // Parts that several tiles share are counted once.
        let mut counted = HashSet::new();
        let bytes = [0; 2].map(|_| tile.size_bytes_beside(&mut counted));
        assert!(bytes[0] > bytes[1] && bytes[1] == size_of::<TileMetadata>(), "{bytes:?}");
    }
}
