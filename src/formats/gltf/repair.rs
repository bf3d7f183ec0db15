//! Repairs the JSON of a glTF that the crate `gltf` refuses, so that one invalid object spoils only itself. `document.rs` calls it
//! after such a refusal alone; nodes with several parents are the matter of `node_tree.rs`.
//!
//! Objects that cannot be read become empty ones, since others refer to objects by their index. References to them, and
//! references beyond a list, are removed: an accessor takes its attribute along, a texture leaves the factor of the material.
//! Decode threads.

use std::fmt::Display;

use gltf::json;
use serde::de::{Deserialize, DeserializeOwned};
use serde_json::{Map, Value, json};

use super::context::Context;
use crate::formats::ignored::Notes;

/// The kinds of what a still scene does not draw.
pub(super) const ANIMATIONS: &str = "glTF: animations (drawn at rest)";
pub(super) const CAMERAS: &str = "glTF: cameras";

/// A glTF whose references are valid.
pub(super) struct Repaired {
    pub json: Vec<u8>,
    /// The first part with geometry that was left out, for the error of a glTF of which nothing else is drawn.
    pub left_out: Option<String>,
    /// The kinds of unused parts that were removed.
    pub unused: Vec<&'static str>,
}

/// Repairs JSON; returns `None` if the text is not JSON. Members that are `null` are removed, integers may be written as
/// floats, a scene may lack nodes, and animations, which may target other things than nodes (KHR_animation_pointer), and
/// cameras are left out.
pub(super) fn repaired(json: &[u8], context: &Context<'_>) -> Option<Repaired> {
    let mut root: Value = serde_json::from_slice(json).ok()?;
    normalize(&mut root);
    let root = root.as_object_mut()?;
    let mut unused = Vec::new();
    for (name, kind) in [("animations", ANIMATIONS), ("cameras", CAMERAS)] {
        if root.remove(name).is_some_and(|list| list.as_array().is_none_or(|list| !list.is_empty())) {
            unused.push(kind);
        }
    }
    let mut repair = Repair { notes: context.notes, left_out: None };
    repair.document(root);
    Some(Repaired { json: serde_json::to_vec(root).ok()?, left_out: repair.left_out, unused })
}

/// Removes members that are `null`, and writes whole numbers as integers.
fn normalize(value: &mut Value) {
    /// Floats below this are exact as integers.
    const MAX_EXACT: f64 = 9_007_199_254_740_992.0;
    match value {
        Value::Object(members) => {
            members.retain(|_, member| !member.is_null());
            members.values_mut().for_each(normalize);
        }
        // NaN becomes null in JavaScript, and null counts as 0 there.
        Value::Array(numbers) if numbers.iter().any(Value::is_number) => {
            numbers.iter_mut().filter(|number| number.is_null()).for_each(|number| *number = 0.into());
            numbers.iter_mut().for_each(normalize);
        }
        Value::Array(elements) => elements.iter_mut().for_each(normalize),
        Value::Number(number) if number.is_f64() => {
            let whole = number.as_f64().filter(|float| float.fract() == 0.0 && float.abs() < MAX_EXACT);
            if let Some(whole) = whole {
                *number = (whole as i64).into();
            }
        }
        _ => {}
    }
}

type Object = Map<String, Value>;

/// The component types of accessors.
const COMPONENT_TYPES: [u64; 6] = [5120, 5121, 5122, 5123, 5125, 5126];
/// The component types of the indices of sparse accessors.
const INDEX_TYPES: [u64; 3] = [5121, 5123, 5125];
/// The types of accessors.
const TYPES: [&str; 7] = ["SCALAR", "VEC2", "VEC3", "VEC4", "MAT2", "MAT3", "MAT4"];
/// The numbers of a sampler, by member.
const SAMPLER_NUMBERS: [(&str, &[u64]); 4] = [
    ("magFilter", &[9728, 9729]),
    ("minFilter", &[9728, 9729, 9984, 9985, 9986, 9987]),
    ("wrapS", &[33071, 33648, 10497]),
    ("wrapT", &[33071, 33648, 10497]),
];

/// A repair that is going on: what it left out.
struct Repair<'a> {
    notes: &'a Notes,
    left_out: Option<String>,
}

impl Repair<'_> {
    /// Notes a part with geometry that is left out.
    fn leave_out(&mut self, kind: &'static str, what: impl Display) {
        self.notes.add(kind);
        self.left_out.get_or_insert_with(|| what.to_string());
    }

    /// Repairs all lists, each after those that it refers to.
    fn document(&mut self, root: &mut Object) {
        if root.get("bufferViews").is_some_and(|list| list.as_array().is_some_and(|list| !list.is_empty())) {
            // An invalid view becomes an empty one of some buffer.
            let buffers = root.entry("buffers").or_insert_with(|| json!([]));
            if let Some(buffers) = buffers.as_array_mut().filter(|buffers| buffers.is_empty()) {
                buffers.push(json!({ "byteLength": 0 }));
            }
        }
        let buffers = self.each::<json::Buffer>(root, "buffers", json!({ "byteLength": 0 }), |repair, buffer| {
            // A length that is missing is that of the bytes.
            if buffer.get("byteLength").and_then(Value::as_u64).is_none() {
                repair.notes.add("glTF: buffer without its byteLength");
                buffer.insert("byteLength".to_owned(), 0.into());
            }
            true
        });
        let empty_view = json!({ "buffer": 0, "byteLength": 0 });
        let views = self.each::<json::buffer::View>(root, "bufferViews", empty_view, |_, view| {
            // Its use follows from what refers to the view.
            view.remove("target");
            is_valid(view.get("buffer"), &buffers)
        });
        let empty_accessor = json!({ "componentType": 5126, "count": 0, "type": "SCALAR" });
        let accessors = self.each::<json::Accessor>(root, "accessors", empty_accessor, |_, accessor| {
            is_valid_accessor(accessor, &views)
        });
        self.materials(root, &views);
        let materials = list_of(root, "materials");
        self.each::<json::Mesh>(root, "meshes", json!({ "primitives": [] }), |repair, mesh| {
            if mesh.get("weights").is_some_and(|weights| Vec::<f32>::deserialize(weights).is_err()) {
                repair.notes.add("glTF: weights of morph targets that are invalid");
                mesh.remove("weights");
            }
            let primitives = mesh.get_mut("primitives").and_then(Value::as_array_mut);
            primitives.is_some_and(|primitives| {
                primitives.retain_mut(|primitive| repair.primitive(primitive, &accessors, &materials));
                true
            })
        });
        let (meshes, nodes) = (list_of(root, "meshes"), list_of(root, "nodes"));
        let skins = self.each::<json::Skin>(root, "skins", json!({ "joints": [] }), |_, skin| {
            if !is_valid_or_absent(skin.get("skeleton"), &nodes) {
                // It moves nothing.
                skin.remove("skeleton");
            }
            let joints = skin.get("joints").and_then(Value::as_array);
            joints.is_some_and(|joints| joints.iter().all(|joint| is_valid(Some(joint), &nodes)))
                && is_valid_or_absent(skin.get("inverseBindMatrices"), &accessors)
        });
        self.each::<json::Node>(root, "nodes", json!({}), |repair, node| repair.node(node, &meshes, &skins, &nodes));
        self.each::<json::Scene>(root, "scenes", json!({ "nodes": [] }), |repair, scene| {
            scene.entry("nodes").or_insert_with(|| json!([]));
            repair.nodes_of(scene, "nodes", &nodes);
            true
        });
        if !is_valid_or_absent(root.get("scene"), &list_of(root, "scenes")) {
            self.notes.add("glTF: default scene that does not exist");
            root.remove("scene");
        }
        self.rest(root);
    }

    /// Repairs images, samplers, textures and materials.
    fn materials(&mut self, root: &mut Object, views: &[bool]) {
        let images = self.each::<json::Image>(root, "images", json!({ "uri": "data:," }), |repair, image| {
            if !is_valid_or_absent(image.get("bufferView"), views) {
                repair.notes.add("glTF: image whose bufferView does not exist or is invalid");
                image.remove("bufferView");
            }
            true
        });
        let samplers = self.each::<json::texture::Sampler>(root, "samplers", json!({}), |repair, sampler| {
            for (member, known) in SAMPLER_NUMBERS {
                if sampler.get(member).is_some_and(|number| !number.as_u64().is_some_and(|n| known.contains(&n))) {
                    repair.notes.add("glTF: unknown filter or wrap mode of a sampler");
                    sampler.remove(member);
                }
            }
            true
        });
        let textures = self.each::<json::Texture>(root, "textures", json!({}), |repair, texture| {
            for (member, list, kind) in [
                ("source", &images, "glTF: image that does not exist or is invalid"),
                ("sampler", &samplers, "glTF: sampler that does not exist or is invalid"),
            ] {
                if !is_valid_or_absent(texture.get(member), list) {
                    repair.notes.add(kind);
                    texture.remove(member);
                }
            }
            true
        });
        self.each::<json::Material>(root, "materials", json!({}), |repair, material| {
            if material.get("alphaMode").is_some_and(|mode| !matches!(mode.as_str(), Some("OPAQUE" | "MASK" | "BLEND")))
            {
                repair.notes.add("glTF material: unknown alphaMode (drawn as opaque)");
                material.remove("alphaMode");
            }
            repair.textures_of(material, &["normalTexture", "occlusionTexture", "emissiveTexture"], &textures);
            if let Some(model) = material.get_mut("pbrMetallicRoughness").and_then(Value::as_object_mut) {
                repair.textures_of(model, &["baseColorTexture", "metallicRoughnessTexture"], &textures);
                repair.members_of::<json::material::PbrMetallicRoughness>(model);
            }
            let model = material.get_mut("extensions").and_then(|of| of.get_mut("KHR_materials_pbrSpecularGlossiness"));
            if let Some(model) = model.and_then(Value::as_object_mut) {
                repair.textures_of(model, &["diffuseTexture", "specularGlossinessTexture"], &textures);
            }
            repair.members_of::<json::Material>(material);
            true
        });
    }

    /// Removes the members of a material that are no valid references to textures.
    fn textures_of(&mut self, owner: &mut Object, members: &[&str], textures: &[bool]) {
        for member in members {
            if owner.get(*member).is_some_and(|reference| !is_valid(reference.get("index"), textures)) {
                self.notes.add("glTF material: texture that does not exist");
                owner.remove(*member);
            }
        }
    }

    /// Removes the members of a material that have an invalid value. All members of `T` are optional.
    fn members_of<T: DeserializeOwned>(&mut self, owner: &mut Object) {
        owner.retain(|name, value| {
            let is_valid = T::deserialize(json!({ name.as_str(): value })).is_ok();
            if !is_valid {
                self.notes.add("glTF material: property that is invalid (drawn with its default)");
            }
            is_valid
        });
    }

    /// Repairs a primitive. Returns false if it is not drawn.
    fn primitive(&mut self, primitive: &mut Value, accessors: &[bool], materials: &[bool]) -> bool {
        const INVALID: &str = "glTF: invalid primitive that is not drawn";
        const ATTRIBUTE: &str = "glTF: attribute whose accessor does not exist or is invalid";
        let Some(members) = primitive.as_object_mut() else {
            self.leave_out(INVALID, "a primitive is no object");
            return false;
        };
        if let Some(mode) = members.get("mode").filter(|mode| mode.as_u64().is_none_or(|mode| mode > 6)) {
            self.leave_out(
                "glTF: primitive of an unknown mode that is not drawn",
                format_args!("primitive of mode {mode}"),
            );
            return false;
        }
        if let Some(indices) = members.get("indices").filter(|indices| !is_valid(Some(*indices), accessors)) {
            let kind = "glTF: primitive that is not drawn because its indices do not exist or are invalid";
            self.leave_out(kind, format_args!("accessor {indices} of {}, the indices of a primitive", accessors.len()));
            return false;
        }
        if !is_valid_or_absent(members.get("material"), materials) {
            self.notes.add("glTF: material that does not exist (drawn with the default one)");
            members.remove("material");
        }
        let targets = members.get_mut("targets").and_then(Value::as_array_mut).into_iter().flatten();
        for target in targets.filter_map(Value::as_object_mut) {
            target.retain(|_, accessor| {
                let is_valid = is_valid(Some(&*accessor), accessors);
                if !is_valid {
                    self.notes.add(ATTRIBUTE);
                }
                is_valid
            });
        }
        if let Some(attributes) = members.get_mut("attributes").and_then(Value::as_object_mut) {
            attributes.retain(|name, accessor| {
                let is_valid = is_valid(Some(&*accessor), accessors);
                if !is_valid {
                    self.leave_out(ATTRIBUTE, format_args!("{name} is accessor {accessor} of {}", accessors.len()));
                }
                is_valid
            });
        }
        match json::mesh::Primitive::deserialize(&*primitive) {
            Ok(_) => true,
            Err(error) => {
                self.leave_out(INVALID, format_args!("a primitive: {error}"));
                false
            }
        }
    }

    /// Repairs a node. Returns false if its transform is lost, without which it is not drawn.
    fn node(&mut self, node: &mut Object, meshes: &[bool], skins: &[bool], nodes: &[bool]) -> bool {
        const PLACE: [&str; 4] = ["matrix", "translation", "rotation", "scale"];
        if let Some(mesh) = node.get("mesh").filter(|mesh| !is_valid(Some(*mesh), meshes)) {
            self.leave_out("glTF: mesh that does not exist", format_args!("mesh {mesh} of {}", meshes.len()));
            node.remove("mesh");
        }
        if !is_valid_or_absent(node.get("skin"), skins) {
            self.notes.add("glTF: skin that does not exist or is invalid (drawn without it)");
            node.remove("skin");
        }
        self.nodes_of(node, "children", nodes);
        node.remove("camera");
        let is_placed = node.iter().all(|(name, value)| {
            !PLACE.contains(&name.as_str()) || json::Node::deserialize(json!({ name.as_str(): value })).is_ok()
        });
        is_placed && {
            node.retain(|name, value| {
                let is_valid = json::Node::deserialize(json!({ name.as_str(): value })).is_ok();
                if !is_valid {
                    self.notes.add("glTF: property of a node that is invalid");
                }
                is_valid
            });
            true
        }
    }

    /// Removes references to nodes that do not exist from a list.
    fn nodes_of(&mut self, owner: &mut Object, member: &str, nodes: &[bool]) {
        let Some(list) = owner.get_mut(member) else { return };
        let Some(list) = list.as_array_mut() else {
            self.leave_out("glTF: list of nodes that is invalid", format_args!("{member} is no list of nodes"));
            *list = json!([]);
            return;
        };
        list.retain(|node| {
            let is_valid = is_valid(Some(node), nodes);
            if !is_valid {
                self.leave_out("glTF: node that does not exist", format_args!("node {node} of {}", nodes.len()));
            }
            is_valid
        });
    }

    /// Repairs the objects of a list with `repair`, which returns false for one that is lost, and replaces those that the
    /// crate cannot read. Returns which objects are valid.
    fn each<T: DeserializeOwned>(
        &mut self,
        root: &mut Object,
        list: &str,
        empty: Value,
        mut repair: impl FnMut(&mut Self, &mut Object) -> bool,
    ) -> Vec<bool> {
        let Some(Value::Array(objects)) = root.get_mut(list) else { return Vec::new() };
        let mut are_valid = Vec::with_capacity(objects.len());
        for (i, object) in objects.iter_mut().enumerate() {
            let is_kept = object.as_object_mut().is_some_and(|members| repair(self, members));
            let read = T::deserialize(&*object);
            let is_valid = is_kept && read.is_ok();
            if !is_valid {
                let kind = match list {
                    "buffers" | "bufferViews" => "glTF: buffer or bufferView that is invalid",
                    "accessors" => "glTF: accessor that is invalid",
                    "meshes" => "glTF: mesh that is invalid and not drawn",
                    "nodes" => "glTF: node that is invalid and not drawn",
                    "skins" => "glTF: skin that is invalid",
                    "scenes" => "glTF: scene that is invalid",
                    "materials" => "glTF: material that is invalid (drawn with the default one)",
                    _ => "glTF: image, sampler or texture that is invalid",
                };
                let reason = read.err().map_or(String::new(), |error| format!(": {error}"));
                self.leave_out(kind, format_args!("{list}[{i}] is invalid{reason}"));
                *object = empty.clone();
            }
            are_valid.push(is_valid);
        }
        are_valid
    }

    /// Removes the members of the document that have an invalid value, such as a list that is none.
    fn rest(&mut self, root: &mut Object) {
        let asset = json!({ "version": "2.0" });
        // Another document may be JSON too.
        let is_gltf = ["nodes", "meshes", "scenes"].iter().any(|name| root.contains_key(*name));
        if is_gltf && root.get("asset").is_none_or(|asset| json::Asset::deserialize(asset).is_err()) {
            self.notes.add("glTF: asset without a valid version (read as 2.0)");
            root.insert("asset".to_owned(), asset.clone());
        }
        root.retain(|name, value| {
            let alone = match name.as_str() {
                "asset" => return true,
                name => json!({ "asset": asset, name: value }),
            };
            let read = json::Root::deserialize(alone);
            if let Err(error) = &read {
                self.leave_out("glTF: member of the document that is invalid", format_args!("{name}: {error}"));
            }
            read.is_ok()
        });
    }
}

/// Returns the list of valid objects of a list that was repaired: all of them.
fn list_of(root: &Object, list: &str) -> Vec<bool> {
    vec![true; root.get(list).and_then(Value::as_array).map_or(0, Vec::len)]
}

/// Returns true if a value is the index of a valid object.
fn is_valid(index: Option<&Value>, objects: &[bool]) -> bool {
    let index = index.and_then(Value::as_u64).and_then(|index| usize::try_from(index).ok());
    index.and_then(|index| objects.get(index)).is_some_and(|is_valid| *is_valid)
}

/// Returns true if a member is absent, or the index of a valid object.
fn is_valid_or_absent(index: Option<&Value>, objects: &[bool]) -> bool {
    index.is_none() || is_valid(index, objects)
}

/// Returns true if an accessor has known types and refers to valid views.
fn is_valid_accessor(accessor: &Object, views: &[bool]) -> bool {
    let is_component = |of: &Value, known: &[u64]| {
        let component = of.get("componentType").and_then(Value::as_u64);
        component.is_some_and(|component| known.contains(&component))
    };
    let component = accessor.get("componentType").and_then(Value::as_u64);
    let is_sparse_valid = accessor.get("sparse").is_none_or(|sparse| {
        let [indices, values] = ["indices", "values"].map(|part| sparse.get(part));
        let is_view = |part: Option<&Value>| part.is_some_and(|part| is_valid(part.get("bufferView"), views));
        is_view(indices) && is_view(values) && indices.is_some_and(|indices| is_component(indices, &INDEX_TYPES))
    });
    component.is_some_and(|component| COMPONENT_TYPES.contains(&component))
        && accessor.get("type").and_then(Value::as_str).is_some_and(|kind| TYPES.contains(&kind))
        && is_valid_or_absent(accessor.get("bufferView"), views)
        && is_sparse_valid
}
