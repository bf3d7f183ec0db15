//! EXT_mesh_features, EXT_instance_features, EXT_structural_metadata and `_BATCHID`: the features that drawables show.
//!
//! Only read with [`ReadOptions::keep_features`](crate::formats::ReadOptions::keep_features).

use std::sync::Arc;

use serde::Deserialize;
use serde_json::Value;

use super::surface_properties::{Attribute, PrimitiveImages, SurfaceProperties, channels};
use crate::fetch::IoError;
use crate::formats::gltf::accessors::{Buffers, Elements};
use crate::formats::gltf::context::Context;
use crate::formats::gltf::materials::TextureRef;
use crate::formats::ignored::Notes;
use crate::formats::properties::{self, SharedBytes, TableSource};
use crate::scene::{Drawable, DrawableFeatures, FeatureIdSet, FeatureIds, PropertyTable};

/// A set of feature ids in the JSON.
#[derive(Clone, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(in crate::formats::gltf) struct FeatureIdJson {
    pub null_feature_id: Option<u32>,
    pub label: Option<String>,
    /// The number of an attribute `_FEATURE_ID_n`.
    pub attribute: Option<u32>,
    pub texture: Option<Value>,
    pub property_table: Option<usize>,
}

impl FeatureIdJson {
    /// Reads the list `featureIds` of an extension. Sets that are invalid are left out and noted.
    pub fn list(extension: Option<&Value>, notes: &Notes) -> Vec<Self> {
        let list = extension.and_then(|extension| extension.get("featureIds")?.as_array());
        let read = |set: &Value| {
            let set = Self::deserialize(set);
            set.inspect_err(|_| notes.add("glTF: an invalid set of feature ids")).ok()
        };
        list.into_iter().flatten().filter_map(read).collect()
    }

    /// Returns the set with its ids.
    pub fn with_ids(&self, ids: FeatureIds) -> FeatureIdSet {
        let label = self.label.clone().unwrap_or_default();
        FeatureIdSet { label, null_id: self.null_feature_id, ids, table: self.property_table }
    }
}

/// The properties of a glTF: the tables of EXT_structural_metadata, then the batch table of its b3dm, and the properties of
/// surfaces.
pub(in crate::formats::gltf) struct FeatureTables {
    tables: Arc<[Arc<PropertyTable>]>,
    surface: SurfaceProperties,
    /// The index of the batch table.
    batch_table: Option<usize>,
    is_kept: bool,
}

impl FeatureTables {
    pub fn new(
        context: &Context<'_>,
        document: &gltf::Document,
        buffers: &Buffers<'_>,
        batch_table: Option<Arc<PropertyTable>>,
    ) -> Result<Self, IoError> {
        let is_kept = context.options.keep_features;
        let (mut tables, mut surface) = (Vec::new(), SurfaceProperties::default());
        if let Some(metadata) = document.extension_value("EXT_structural_metadata").filter(|_| is_kept) {
            let view = |view: usize| {
                let bytes = buffers.view(&document.views().nth(view)?).ok().flatten()?;
                context.budget.add_decoded(bytes.len() as u64).ok()?;
                Some(SharedBytes::from(bytes.to_vec()))
            };
            let reference = metadata.get("schemaUri").and_then(Value::as_str);
            let schema = properties::read_schema(context.uri, metadata.get("schema"), reference, &context.files);
            if matches!(schema, Ok(None)) {
                context.notes.add("metadata: a schema that is missing");
            }
            let schema = schema
                .or_else(|error| context.missing("metadata: a schema that cannot be read", &error).map(|()| None))?;
            if let Some(schema) = schema {
                let note = |kind: &'static str| context.notes.add(kind);
                let source = TableSource::new(&schema, &view, &note);
                tables.extend(source.tables(metadata).into_iter().map(Arc::new));
                surface = SurfaceProperties::new(context, metadata, &schema);
            }
        }
        let batch_index = batch_table.is_some().then_some(tables.len());
        tables.extend(batch_table);
        Ok(Self { tables: tables.into(), surface, batch_table: batch_index, is_kept })
    }

    /// Reads the features of a primitive. `attribute` returns the elements of an attribute with a name.
    pub fn of_primitive(
        &self,
        primitive: &gltf::Primitive<'_>,
        mut images: PrimitiveImages<'_, '_, '_>,
        attribute: &Attribute<'_, '_>,
    ) -> Result<Option<Arc<DrawableFeatures>>, IoError> {
        if !self.is_kept {
            return Ok(None);
        }
        let context = images.context;
        let per_vertex = |elements: &Elements<'_>| -> Result<FeatureIds, IoError> {
            context.budget.add_decoded(4 * elements.count as u64)?;
            Ok(FeatureIds::PerVertex((0..elements.count).map(|i| elements.unsigned(i, 0)).collect()))
        };
        let mut sets = Vec::new();
        for set in FeatureIdJson::list(primitive.extension_value("EXT_mesh_features"), context.notes) {
            self.check_table(&set, context.notes);
            match (set.attribute, &set.texture) {
                (Some(number), _) => match attribute(&format!("_FEATURE_ID_{number}"))? {
                    Some(elements) => sets.push(set.with_ids(per_vertex(&elements)?)),
                    None => context.notes.add("glTF: feature ids whose attribute is missing"),
                },
                (None, Some(json)) => {
                    let texture = match TextureRef::from_json(json).zip(channels(json)) {
                        Some((texture, channels)) => images.texture(&texture, channels, attribute)?,
                        None => None,
                    };
                    match texture {
                        Some(texture) => sets.push(set.with_ids(FeatureIds::Texture(texture))),
                        None => context.notes.add("glTF: feature ids whose texture is missing or invalid"),
                    }
                }
                (None, None) => sets.push(set.with_ids(FeatureIds::VertexIndex)),
            }
        }
        for name in ["_BATCHID", "_BATCH_ID"] {
            if let Some(elements) = attribute(name)? {
                let ids = per_vertex(&elements)?;
                sets.push(FeatureIdSet { label: String::new(), null_id: None, ids, table: self.batch_table });
            }
        }
        let surface = self.surface.of_primitive(primitive, &mut images, attribute)?;
        let is_any = !sets.is_empty() || !surface.is_empty();
        Ok(is_any.then(|| Arc::new(DrawableFeatures { sets, tables: self.tables.clone(), surface })))
    }

    /// Notes a set whose property table is missing: its ids are kept.
    pub fn check_table(&self, set: &FeatureIdJson, notes: &Notes) {
        if set.property_table.is_some_and(|table| table >= self.tables.len()) {
            notes.add("glTF: feature ids whose property table is missing");
        }
    }

    /// Adds the sets of an instance to a drawable.
    pub fn add_instance(&self, drawable: &mut Drawable, sets: &[FeatureIdSet]) {
        if !self.is_kept {
            return;
        }
        let own = DrawableFeatures { tables: self.tables.clone(), ..DrawableFeatures::default() };
        let features = drawable.features.as_deref().unwrap_or(&own).with_instance(sets.iter().cloned());
        drawable.features = Some(Arc::new(features));
    }
}
