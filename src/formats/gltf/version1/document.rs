//! [`Document`]: the JSON of a glTF 1.0, as far as it is upgraded.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::{Map, Value};

use super::objects::Objects;
use crate::formats::lenient::{Numbers, Text, list, or_default, valid_entries, valid_or_default};

/// The names of the buffer that is the body of a binary glTF, the second in old files.
const BINARY_BODY: [&str; 2] = ["binary_glTF", "KHR_binary_glTF"];

/// The JSON of a glTF 1.0 file. More than 16 fields: one for each of its top members.
#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Document {
    #[serde(alias = "allExtensions", deserialize_with = "valid_or_default")]
    pub extensions_used: Vec<String>,
    pub scene: Text,
    pub accessors: Objects<Accessor>,
    pub buffer_views: Objects<BufferView>,
    pub buffers: Objects<Buffer>,
    pub images: Objects<Image>,
    pub materials: Objects<Material>,
    pub meshes: Objects<Mesh>,
    pub nodes: Objects<Node>,
    pub samplers: Objects<Sampler>,
    pub scenes: Objects<Scene>,
    pub techniques: Objects<Technique>,
    pub textures: Objects<Texture>,
    pub animations: Objects<IgnoredAny>,
    pub cameras: Objects<IgnoredAny>,
    pub skins: Objects<IgnoredAny>,
    /// The lights of glTF 0.8.
    pub lights: Objects<IgnoredAny>,
    #[serde(deserialize_with = "or_default")]
    pub extensions: Extensions,
}

impl Document {
    /// Makes the buffer that is the body of the binary glTF the first one, as glTF 2.0 requires. Some writers do not list
    /// it (assimp).
    pub fn use_binary_body(&mut self, body_bytes: usize) {
        let is_listed = |name: &&str| self.buffers.ids.get(&Text(Some((**name).to_owned()))).is_some();
        if !BINARY_BODY.iter().any(is_listed) {
            self.buffers.push(BINARY_BODY[0], Buffer { uri: None, byte_length: Some(body_bytes as u64) });
        }
        let body = BINARY_BODY.iter().find(|name| self.buffers.ids.get(&Text(Some((**name).to_owned()))).is_some());
        if let Some(buffer) = body.and_then(|name| self.buffers.move_to_front(name)) {
            // Writers give it a URI without data.
            buffer.uri = None;
        }
    }
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Extensions {
    #[serde(rename = "CESIUM_RTC")]
    pub cesium_rtc: Option<Value>,
    #[serde(rename = "KHR_materials_common", deserialize_with = "or_default")]
    pub materials_common: CommonLights,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct CommonLights {
    pub lights: Objects<IgnoredAny>,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: Text,
    pub byte_offset: Option<u64>,
    /// Absent or 0 if the elements lie without gaps.
    pub byte_stride: Option<u64>,
    pub component_type: Option<u32>,
    pub count: Option<u64>,
    pub r#type: Text,
    #[serde(deserialize_with = "or_default")]
    pub extensions: AccessorExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct AccessorExtensions {
    #[serde(rename = "WEB3D_quantized_attributes")]
    pub quantized: Option<Value>,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: Text,
    pub byte_offset: Option<u64>,
    pub byte_length: Option<u64>,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Buffer {
    pub uri: Option<String>,
    pub byte_length: Option<u64>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Mesh {
    #[serde(deserialize_with = "list")]
    pub primitives: Vec<Primitive>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    #[serde(deserialize_with = "or_default")]
    pub attributes: BTreeMap<String, Text>,
    pub indices: Text,
    pub material: Text,
    /// `primitive` is its name in glTF 0.8.
    #[serde(alias = "primitive")]
    pub mode: Option<u32>,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Node {
    #[serde(deserialize_with = "list")]
    pub children: Vec<Text>,
    #[serde(deserialize_with = "list")]
    pub meshes: Vec<Text>,
    pub matrix: Value,
    pub translation: Value,
    pub rotation: Value,
    pub scale: Value,
    pub extras: Value,
    /// The meshes of a skinned node in glTF 0.8.
    pub instance_skin: Option<InstanceSkin>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct InstanceSkin {
    #[serde(deserialize_with = "list")]
    pub meshes: Vec<Text>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Scene {
    #[serde(deserialize_with = "list")]
    pub nodes: Vec<Text>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Image {
    pub uri: Option<String>,
    #[serde(deserialize_with = "or_default")]
    pub extensions: ImageExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct ImageExtensions {
    #[serde(rename = "KHR_binary_glTF")]
    pub binary: Option<BinaryImage>,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct BinaryImage {
    pub buffer_view: Text,
    pub mime_type: Text,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Texture {
    pub sampler: Text,
    pub source: Text,
}

/// The members have the same names and values in glTF 2.0.
#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Sampler {
    pub mag_filter: Option<u32>,
    pub min_filter: Option<u32>,
    pub wrap_s: Option<u32>,
    pub wrap_t: Option<u32>,
}

#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Material {
    pub technique: Text,
    /// By the name of the technique's parameter. Text is the id of a texture.
    #[serde(deserialize_with = "valid_or_default")]
    pub values: Map<String, Value>,
    /// Technique and values as glTF 0.8 has them, and some files of 1.0.
    #[serde(deserialize_with = "valid_or_default")]
    pub instance_technique: Option<TechniqueInstance>,
    #[serde(deserialize_with = "valid_or_default")]
    pub extensions: MaterialExtensions,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct TechniqueInstance {
    pub technique: Text,
    #[serde(deserialize_with = "valid_or_default")]
    pub values: Map<String, Value>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_common")]
    pub common: Option<CommonMaterial>,
}

/// A material of KHR_materials_common.
#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct CommonMaterial {
    /// BLINN, PHONG, LAMBERT or CONSTANT.
    pub technique: Text,
    #[serde(deserialize_with = "valid_or_default")]
    pub values: Map<String, Value>,
    #[serde(deserialize_with = "valid_or_default")]
    pub double_sided: Option<bool>,
    #[serde(deserialize_with = "valid_or_default")]
    pub transparent: Option<bool>,
}

/// A WebGL shader with its parameters and states.
#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Technique {
    #[serde(deserialize_with = "valid_entries")]
    pub parameters: BTreeMap<String, Parameter>,
    /// The parameter of each uniform.
    #[serde(deserialize_with = "valid_entries")]
    pub uniforms: BTreeMap<String, String>,
    #[serde(deserialize_with = "valid_or_default")]
    pub states: States,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct Parameter {
    pub semantic: Text,
    /// The default.
    pub value: Value,
}

#[derive(Default, Deserialize)]
#[serde(default)]
pub(super) struct States {
    /// WebGL's numbers of states.
    pub enable: Numbers,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fetch::JSON_OBJECT_BYTES;

    #[test]
    fn objects_are_no_larger_than_the_limit_of_parsed_json_counts() {
        let geometry = [size_of::<Accessor>(), size_of::<BufferView>(), size_of::<Primitive>(), size_of::<Node>()];
        let others = [size_of::<Material>(), size_of::<Technique>(), size_of::<Image>(), size_of::<Sampler>()];
        let largest = geometry.into_iter().chain(others).max().unwrap() as u64;
        assert!(2 * largest <= JSON_OBJECT_BYTES, "{geometry:?} {others:?}");
    }
}
