//! Buffers, buffer views, accessors and meshes.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::Upgrade;
use super::document::{Accessor, Primitive};
use crate::fetch::IoError;

const BYTE: u32 = 5120;
const UNSIGNED_BYTE: u32 = 5121;
const SHORT: u32 = 5122;
const UNSIGNED_SHORT: u32 = 5123;
/// glTF's number for triangles.
const TRIANGLES: u32 = 4;

/// A buffer view of glTF 2.0.
struct View {
    buffer: usize,
    offset: u64,
    length: u64,
    stride: Option<u64>,
}

impl Upgrade<'_> {
    pub(super) fn buffers(&self) -> Vec<Value> {
        let buffers = self.document.buffers.list.iter();
        let upgraded = buffers.map(|buffer| {
            let mut upgraded = json!({ "byteLength": buffer.byte_length.unwrap_or(0) });
            if let Some(uri) = &buffer.uri {
                upgraded["uri"] = uri.as_str().into();
            }
            upgraded
        });
        upgraded.collect()
    }

    /// Returns the accessors and the buffer views. The old views keep their indices. Accessors with a stride get views with
    /// that stride, which follow.
    pub(super) fn accessors_and_views(&self) -> Result<(Vec<Value>, Vec<Value>), IoError> {
        let document = self.document;
        let mut views = Vec::new();
        for view in &document.buffer_views.list {
            let buffer = self.index(&document.buffers.ids, &view.buffer, "buffer", "a bufferView")?;
            let (offset, length) = (view.byte_offset.unwrap_or(0), view.byte_length.unwrap_or(0));
            views.push(View { buffer, offset, length, stride: None });
        }
        let is_color = self.color_accessors();
        let mut strided = BTreeMap::new();
        let mut accessors = Vec::new();
        for (accessor, is_color) in document.accessors.list.iter().zip(is_color) {
            let mut at = self.index(&document.buffer_views.ids, &accessor.buffer_view, "bufferView", "an accessor")?;
            let size = element_bytes(accessor);
            let stride = accessor.byte_stride.filter(|stride| *stride != 0).unwrap_or(size);
            if stride != size {
                at = *strided.entry((at, stride)).or_insert_with(|| {
                    views.push(View { stride: Some(stride), ..views[at] });
                    views.len() - 1
                });
            }
            let (offset, count) = (accessor.byte_offset.unwrap_or(0), accessor.count.unwrap_or(0));
            // The length of a view may be absent in glTF 1.0, or too short. The buffer is the limit.
            let length = count.checked_sub(1).map_or(0, |gaps| gaps.saturating_mul(stride).saturating_add(size));
            views[at].length = views[at].length.max(offset.saturating_add(length));
            let mut upgraded = json!({
                "bufferView": at,
                "byteOffset": offset,
                "componentType": accessor.component_type,
                "count": count,
                "type": accessor.r#type.0,
            });
            match &accessor.extensions.quantized {
                Some(quantized) => {
                    upgraded["extensions"] = json!({ "WEB3D_quantized_attributes": quantized });
                }
                // glTF 1.0 cannot say it, and shaders do it.
                None => upgraded["normalized"] = (is_color && is_small_integer(accessor)).into(),
            }
            accessors.push(upgraded);
        }
        let views = views.into_iter().map(|View { buffer, offset, length, stride }| {
            let mut view = json!({ "buffer": buffer, "byteOffset": offset, "byteLength": length });
            if let Some(stride) = stride {
                view["byteStride"] = stride.into();
            }
            view
        });
        Ok((accessors, views.collect()))
    }

    pub(super) fn meshes(&self) -> Result<Vec<Value>, IoError> {
        let mut meshes = Vec::new();
        for mesh in &self.document.meshes.list {
            let primitives = mesh.primitives.iter().map(|primitive| self.primitive(primitive));
            meshes.push(json!({ "primitives": primitives.collect::<Result<Vec<_>, _>>()? }));
        }
        Ok(meshes)
    }

    fn primitive(&self, primitive: &Primitive) -> Result<Value, IoError> {
        let accessors = &self.document.accessors.ids;
        let mut attributes = serde_json::Map::new();
        for (name, id) in &primitive.attributes {
            let accessor = self.index(accessors, id, "accessor", "an attribute of a mesh")?;
            attributes.insert(attribute_name(name), accessor.into());
        }
        let mut upgraded = json!({ "attributes": attributes, "mode": primitive.mode.unwrap_or(TRIANGLES) });
        if primitive.indices.0.is_some() {
            upgraded["indices"] = self.index(accessors, &primitive.indices, "accessor", "a mesh")?.into();
        }
        if let Some(material) = self.found(&self.document.materials.ids, &primitive.material, "material") {
            upgraded["material"] = material.into();
        }
        Ok(upgraded)
    }

    /// Returns, by index of the accessor, whether it holds colours.
    fn color_accessors(&self) -> Vec<bool> {
        let accessors = &self.document.accessors;
        let mut is_color = vec![false; accessors.list.len()];
        for primitive in self.document.meshes.list.iter().flat_map(|mesh| &mesh.primitives) {
            let colors = primitive.attributes.iter().filter(|(name, _)| attribute_name(name).starts_with("COLOR_"));
            colors.filter_map(|(_, id)| accessors.ids.get(id)).for_each(|index| is_color[index] = true);
        }
        is_color
    }
}

/// Returns the name of an attribute in glTF 2.0. Names of the application begin with an underscore there.
fn attribute_name(name: &str) -> String {
    let (base, set) = match name.rsplit_once('_') {
        Some((base, set)) if !set.is_empty() && set.bytes().all(|byte| byte.is_ascii_digit()) => (base, set),
        _ => (name, "0"),
    };
    match base {
        "COLOR" | "TEXCOORD" => format!("{base}_{set}"),
        "JOINT" | "JOINTS" => format!("JOINTS_{set}"),
        "WEIGHT" | "WEIGHTS" => format!("WEIGHTS_{set}"),
        _ if name.starts_with('_') || ["POSITION", "NORMAL", "TANGENT"].contains(&name) => name.to_owned(),
        _ => format!("_{name}"),
    }
}

/// Returns the bytes of an element without gaps; 0 if its type is invalid, which the reader refuses.
fn element_bytes(accessor: &Accessor) -> u64 {
    let component = match accessor.component_type {
        Some(BYTE | UNSIGNED_BYTE) => 1,
        Some(SHORT | UNSIGNED_SHORT) => 2,
        _ => 4,
    };
    let components = match accessor.r#type.0.as_deref() {
        Some("SCALAR") => 1,
        Some("VEC2") => 2,
        Some("VEC3") => 3,
        Some("VEC4" | "MAT2") => 4,
        Some("MAT3") => 9,
        Some("MAT4") => 16,
        _ => 0,
    };
    component * components
}

fn is_small_integer(accessor: &Accessor) -> bool {
    matches!(accessor.component_type, Some(BYTE | UNSIGNED_BYTE | SHORT | UNSIGNED_SHORT))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_have_the_names_of_version_2() {
        for (old, new) in [
            ("POSITION", "POSITION"),
            ("TEXCOORD", "TEXCOORD_0"),
            ("TEXCOORD_1", "TEXCOORD_1"),
            ("COLOR", "COLOR_0"),
            ("JOINT", "JOINTS_0"),
            ("WEIGHT_2", "WEIGHTS_2"),
            ("BATCHID", "_BATCHID"),
            ("_BATCHID", "_BATCHID"),
            ("HEAT_1", "_HEAT_1"),
            ("POSITION_1", "_POSITION_1"),
            ("COLOR_", "_COLOR_"),
            ("", "_"),
        ] {
            assert_eq!(attribute_name(old), new);
        }
    }
}
