//! EXT_mesh_gpu_instancing: a node that draws its mesh at many positions, given by attributes.

use std::cell::Cell;

use glam::{DAffine3, DQuat, DVec3};
use gltf::accessor::Dimensions;
use serde_json::Value;

use super::accessors::{Buffers, Elements};
use super::context::Context;
use super::features::{FeatureIdJson, FeatureTables};
use crate::fetch::IoError;
use crate::scene::{FeatureIdSet, FeatureIds};

const EXTENSION: &str = "EXT_mesh_gpu_instancing";

/// The instances of a node.
pub(super) struct Instances {
    /// Maps from the instances to their node.
    pub transforms: Vec<DAffine3>,
    /// The ids of EXT_instance_features by set. `None` means that the number of an instance is its id.
    features: Vec<(FeatureIdJson, Option<Vec<u32>>)>,
}

impl Instances {
    /// Reads the instances of a node; `None` if the node lacks the extension. Attributes whose buffer is missing leave no
    /// instance.
    pub fn new(
        context: &Context<'_>,
        document: &gltf::Document,
        buffers: &Buffers<'_>,
        tables: &FeatureTables,
        node: &gltf::Node<'_>,
    ) -> Result<Option<Self>, IoError> {
        read(context, document, buffers, tables, node)
    }

    /// Returns the features of an instance.
    pub fn feature_sets(&self, instance: u32) -> Vec<FeatureIdSet> {
        let set = |(set, ids): &(FeatureIdJson, Option<Vec<u32>>)| {
            let id = ids.as_ref().map_or(Some(instance), |ids| ids.get(instance as usize).copied())?;
            Some(set.with_ids(FeatureIds::Uniform(id)))
        };
        self.features.iter().filter_map(set).collect()
    }
}

fn read(
    context: &Context<'_>,
    document: &gltf::Document,
    buffers: &Buffers<'_>,
    tables: &FeatureTables,
    node: &gltf::Node<'_>,
) -> Result<Option<Instances>, IoError> {
    let Some(extension) = node.extension_value(EXTENSION) else { return Ok(None) };
    let bad = |reason: &str| context.bad(format_args!("{EXTENSION} of node {}: {reason}", node.index()));
    let attributes = extension.get("attributes").and_then(Value::as_object);
    let attributes = attributes.filter(|attributes| !attributes.is_empty()).ok_or_else(|| bad("no attributes"))?;
    let mut count = None;
    for index in attributes.values() {
        let accessor = index.as_u64().and_then(|index| document.accessors().nth(usize::try_from(index).ok()?));
        let accessor = accessor.ok_or_else(|| bad("an accessor that does not exist"))?;
        if count.is_some_and(|count| count != accessor.count()) {
            return Err(bad("attributes of different lengths"));
        }
        count = Some(accessor.count());
    }
    let count = count.unwrap_or_default();
    context.budget.add_primitives(count)?;
    let is_missing = Cell::new(false);
    let elements = |name: &str, dimensions: Dimensions| -> Result<Option<Elements<'_>>, IoError> {
        let index = attributes.get(name).and_then(Value::as_u64).and_then(|index| usize::try_from(index).ok());
        let Some(accessor) = index.and_then(|index| document.accessors().nth(index)) else { return Ok(None) };
        let elements = buffers.elements(&accessor, dimensions)?;
        is_missing.set(is_missing.get() | elements.is_none());
        Ok(elements)
    };
    let translations = elements("TRANSLATION", Dimensions::Vec3)?;
    let rotations = elements("ROTATION", Dimensions::Vec4)?;
    let scales = elements("SCALE", Dimensions::Vec3)?;
    if is_missing.get() {
        context.notes.add("glTF: instances that are not drawn because their buffer is missing");
        return Ok(Some(Instances { transforms: Vec::new(), features: Vec::new() }));
    }
    let vector = |of: &Option<Elements<'_>>, i: usize, default: DVec3| {
        of.as_ref().map_or(default, |elements| DVec3::from_array(elements.vector::<3>(i).map(f64::from)))
    };
    let mut instances = Vec::with_capacity(count);
    for i in 0..count {
        let rotation = rotations.as_ref().map_or(DQuat::IDENTITY, |elements| {
            let rotation = DQuat::from_array(elements.vector::<4>(i).map(f64::from));
            if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY }
        });
        let scale = vector(&scales, i, DVec3::ONE);
        let instance =
            DAffine3::from_scale_rotation_translation(scale, rotation, vector(&translations, i, DVec3::ZERO));
        if !instance.is_finite() {
            return Err(bad(&format!("instance {i} is not finite")));
        }
        instances.push(instance);
    }
    let mut features = Vec::new();
    let sets = match context.options.keep_features {
        true => FeatureIdJson::list(node.extension_value("EXT_instance_features"), context.notes),
        false => Vec::new(),
    };
    for set in sets {
        tables.check_table(&set, context.notes);
        let Some(number) = set.attribute else {
            features.push((set, None));
            continue;
        };
        let ids = elements(&format!("_FEATURE_ID_{number}"), Dimensions::Scalar)?;
        if ids.is_none() {
            context.notes.add("glTF: feature ids whose attribute is missing");
        }
        let ids = ids.map(|elements| (0..count).map(|i| elements.unsigned(i, 0)).collect());
        features.push((set, Some(ids.unwrap_or_default())));
    }
    Ok(Some(Instances { transforms: instances, features }))
}
