//! Parses and checks the JSON of a glTF with the crate `gltf`.

use std::borrow::Cow;

use gltf::json;
use gltf::json::validation::{Checked, Error, Validate as _};
use serde_json::Value;

use super::context::Context;
use super::double_precision::{DoublePrecision, extensions_required};
use super::extensions;
use super::glb::Chunks;
use super::{splats, version1};
use crate::fetch::IoError;

/// Parses a document; a glTF 1.0 is upgraded. Its references between objects are valid afterwards, so that the crate's
/// accessors do not panic.
pub(super) fn parse(context: &Context<'_>, chunks: &Chunks<'_>) -> Result<(gltf::Document, DoublePrecision), IoError> {
    let (uri, limits) = (context.uri, &context.options.limits);
    let refused = |required: &[String]| {
        let unknown = required.iter().find(|name| !extensions::may_be_required(name));
        unknown.map(|name| IoError::unsupported(uri, format!("required glTF extension {name}")))
    };
    limits.check_json(uri, &chunks.json)?;
    if matches!(chunks.json, Cow::Owned(_)) {
        context.notes.add("glTF: text that is not UTF-8, such as names");
    }
    let mut json = splats::with_kept_names(Cow::Borrowed(&chunks.json));
    let mut parsed = json::Root::from_slice(&json);
    // The objects of older versions have ids instead of indices, so that they are not parsed.
    if parsed.is_err()
        && let Some(upgraded) = version1::upgraded(uri, chunks, limits, context.notes)?
    {
        limits.check_json(uri, &upgraded)?;
        json = upgraded.into();
        parsed = json::Root::from_slice(&json);
    }
    if parsed.is_err()
        && let Some(repaired) = repaired(&json, context)
        && let Ok(root) = json::Root::from_slice(&repaired)
    {
        (parsed, json) = (Ok(root), repaired.into());
    }
    let mut root = parsed.map_err(|e| {
        // An unsupported extension may replace required properties. It is the better error.
        let required = extensions_required(&json);
        refused(&required).unwrap_or_else(|| IoError::invalid(uri, format!("glTF JSON: {e}")))
    })?;
    if let Some(error) = refused(&root.extensions_required) {
        return Err(error);
    }
    if let Some(copyright) = &root.asset.copyright {
        context.notes.add_credit(copyright);
    }
    root.extensions_required.clear();
    for name in root.extensions_used.iter().filter(|name| !extensions::is_supported(name)) {
        context.notes.add(format!("glTF extension {name}"));
    }
    // The crate panics or misbehaves unless the next two conditions hold.
    let accessors = root.accessors.len();
    for primitive in root.meshes.iter().flat_map(|m| &m.primitives) {
        if let Some(index) = primitive.attributes.values().map(|a| a.value()).find(|index| *index >= accessors) {
            return Err(context.bad(format_args!("accessor {index} of {accessors}")));
        }
    }
    for image in &mut root.images {
        if image.buffer_view.is_some() {
            // The bytes say what they are.
            image.mime_type.get_or_insert_with(|| json::image::MimeType("application/octet-stream".to_owned()));
        } else {
            // An image without a source cannot be read; the mesh is drawn without it.
            image.uri.get_or_insert_with(|| "data:,".to_owned());
        }
    }
    remove_unused(context, &mut root);
    if root.scene.is_some_and(|scene| scene.value() >= root.scenes.len()) {
        context.notes.add("glTF: default scene that does not exist");
        root.scene = None;
    }
    // Attributes with unknown names are ignored, valid or not.
    for primitive in root.meshes.iter_mut().flat_map(|m| m.primitives.iter_mut()) {
        primitive.attributes.retain(|semantic, _| matches!(semantic, Checked::Valid(_)));
    }
    let double = DoublePrecision::read(&json, &root).map_err(|e| IoError::invalid(uri, format!("glTF JSON: {e}")))?;
    let mut errors = Vec::new();
    root.validate(&root, json::Path::new, &mut |path, error| {
        let path = path();
        if !is_harmless(path.as_str(), error) {
            errors.push((path, error));
        }
    });
    if !errors.is_empty() {
        return Err(context.bad(gltf::Error::Validation(errors)));
    }
    Ok((gltf::Document::from_json_without_validation(root), double))
}

/// The kinds of what a still scene does not draw.
const ANIMATIONS: &str = "glTF: animations (drawn at rest)";
const CAMERAS: &str = "glTF: cameras";

/// Returns JSON that the crate can read, from JSON of which it refuses valid or harmless parts: members that are `null` are
/// removed, integers may be written as floats, a scene may lack nodes, and animations, which may target other things than
/// nodes (KHR_animation_pointer), and cameras are left out. Returns `None` if the text is not JSON.
fn repaired(json: &[u8], context: &Context<'_>) -> Option<Vec<u8>> {
    /// Floats below this are exact as integers.
    const MAX_EXACT: f64 = 9_007_199_254_740_992.0;
    fn repair(value: &mut Value) {
        match value {
            Value::Object(members) => {
                members.retain(|_, member| !member.is_null());
                members.values_mut().for_each(repair);
            }
            // NaN becomes null in JavaScript, and null counts as 0 there.
            Value::Array(numbers) if numbers.iter().any(Value::is_number) => {
                numbers.iter_mut().filter(|number| number.is_null()).for_each(|number| *number = 0.into());
                numbers.iter_mut().for_each(repair);
            }
            Value::Array(elements) => elements.iter_mut().for_each(repair),
            Value::Number(number) if number.is_f64() => {
                let whole = number.as_f64().filter(|float| float.fract() == 0.0 && float.abs() < MAX_EXACT);
                if let Some(whole) = whole {
                    *number = (whole as i64).into();
                }
            }
            _ => {}
        }
    }
    let mut root: Value = serde_json::from_slice(json).ok()?;
    repair(&mut root);
    let members = root.as_object_mut()?;
    for (name, kind) in [("animations", ANIMATIONS), ("cameras", CAMERAS)] {
        if members.remove(name).is_some_and(|list| list.as_array().is_none_or(|list| !list.is_empty())) {
            context.notes.add(kind);
        }
    }
    let nodes = root.get_mut("nodes").and_then(Value::as_array_mut);
    for node in nodes.into_iter().flatten().filter_map(Value::as_object_mut) {
        node.remove("camera");
    }
    let scenes = root.get_mut("scenes").and_then(Value::as_array_mut);
    for scene in scenes.into_iter().flatten().filter_map(Value::as_object_mut) {
        scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
    }
    serde_json::to_vec(&root).ok()
}

/// Returns true for violations that do not matter to this reader. Old exporters omit bounds; compressed accessors have no
/// bufferView; a primitive without positions is not drawn; strides are checked where elements are read.
fn is_harmless(path: &str, error: Error) -> bool {
    let is_bound = path.ends_with(".min") || path.ends_with(".max");
    let is_missing_view = path.starts_with("accessors[") && path.ends_with("].bufferView");
    match error {
        Error::Missing => is_bound || is_missing_view || path.ends_with(".attributes[\"POSITION\"]"),
        Error::Invalid => is_bound || path.ends_with(".byteStride"),
        _ => false,
    }
}

/// Removes and notes the parts of a document that a still scene does not draw, valid or not.
fn remove_unused(context: &Context<'_>, root: &mut json::Root) {
    for (is_used, kind) in [
        (!root.animations.is_empty(), ANIMATIONS),
        (!root.cameras.is_empty(), CAMERAS),
        (root.scenes.len() > 1, "glTF: scenes besides the default one"),
    ] {
        if is_used {
            context.notes.add(kind);
        }
    }
    root.animations.clear();
    root.cameras.clear();
    root.nodes.iter_mut().for_each(|node| node.camera = None);
}
