//! [`SetMetadata`]: the metadata of a tileset, of its groups, tiles and contents, if it is kept. Decode threads.

use std::sync::Arc;

use serde_json::Value;

use super::json::{ContentJson, TileJson, TilesetJson};
use crate::formats::ignored::Notes;
use crate::formats::properties::{Entities, Schema};
use crate::scene::{Metadata, TileMetadata};

/// The metadata of a tileset, and the reader for that of its parts.
pub(super) struct SetMetadata<'a> {
    entities: Entities<'a>,
    notes: &'a Notes,
    tileset: Option<Arc<Metadata>>,
    /// The groups with their names in sets of 1.0. Invalid ones keep their index.
    groups: Vec<(Option<String>, Option<Arc<Metadata>>)>,
}

impl<'a> SetMetadata<'a> {
    /// Reads the metadata of a tileset and of its groups.
    pub fn new(json: &TilesetJson, schema: &'a Schema, notes: &'a Notes) -> Self {
        let mut set = Self { entities: Entities::new(schema), notes, tileset: None, groups: Vec::new() };
        set.tileset = set.read(json.metadata());
        set.groups = json.groups().into_iter().map(|(name, group)| (name, set.read(Some(group)))).collect();
        set
    }

    /// Reads the metadata of a tile. That of the root has that of the tileset.
    pub fn of_tile(&mut self, json: &TileJson, is_root: bool) -> Option<Arc<TileMetadata>> {
        let tileset = self.tileset.clone().filter(|_| is_root);
        TileMetadata { tileset, tile: self.read(json.metadata()), ..TileMetadata::default() }.shared()
    }

    /// Reads the metadata of a content, with that of its group.
    pub fn of_content(&mut self, json: &ContentJson) -> Option<Arc<TileMetadata>> {
        let (content, group) = (self.read(json.metadata()), self.group(json));
        TileMetadata { content, group, ..TileMetadata::default() }.shared()
    }

    /// Returns the metadata of the group of a content.
    pub fn group(&self, json: &ContentJson) -> Option<Arc<Metadata>> {
        let group = json.group()?;
        let found = match group {
            Value::String(name) => self.groups.iter().find(|(known, _)| known.as_ref() == Some(name)),
            index => index.as_u64().and_then(|index| self.groups.get(usize::try_from(index).ok()?)),
        };
        if found.is_none() {
            self.notes.add("metadata: a group that the tileset lacks");
        }
        found?.1.clone()
    }

    /// Returns the metadata of all groups.
    pub fn groups(&self) -> Arc<[Option<Arc<Metadata>>]> {
        self.groups.iter().map(|(_, group)| group.clone()).collect()
    }

    fn read(&mut self, json: Option<&Value>) -> Option<Arc<Metadata>> {
        self.entities.read(json?, &|kind| self.notes.add(kind))
    }
}
