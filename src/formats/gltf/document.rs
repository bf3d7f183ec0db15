//! Parses and checks the JSON of a glTF with the crate `gltf`.

use std::borrow::Cow;

use gltf::json;
use gltf::json::validation::{Checked, Error, Validate as _};

use super::context::Context;
use super::double_precision::{DoublePrecision, extensions_required};
use super::extensions;
use super::glb::Chunks;
use super::repair::{ANIMATIONS, CAMERAS, repaired};
use super::{node_tree, splats, version1};
use crate::fetch::IoError;

/// A document whose references between objects are valid, so that the crate's accessors do not panic.
pub(super) struct Parsed {
    pub document: gltf::Document,
    pub double: DoublePrecision,
    /// The error of the first part with geometry that was left out.
    pub left_out: Option<IoError>,
}

/// Parses a document; a glTF 1.0 is upgraded. Objects that are invalid are left out and noted.
pub(super) fn parse(context: &Context<'_>, chunks: &Chunks<'_>) -> Result<Parsed, IoError> {
    let (uri, limits) = (context.uri, &context.options.limits);
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
    // An unsupported extension may replace required properties. It is the better error.
    let required = match &parsed {
        Ok(root) => root.extensions_required.clone(),
        Err(_) => extensions_required(&json),
    };
    if let Some(name) = required.iter().find(|name| !extensions::may_be_required(name)) {
        return Err(IoError::unsupported(uri, format!("required glTF extension {name}")));
    }
    let bad_json = |e: serde_json::Error| IoError::invalid(uri, format!("glTF JSON: {e}"));
    let ready = parsed.map_err(bad_json).and_then(|root| prepared(context, root));
    let ((mut root, unused), left_out) = match ready {
        Ok(ready) => (ready, None),
        Err(error) => {
            let Some(repaired) = repaired(&json, context) else { return Err(error) };
            let root = json::Root::from_slice(&repaired.json).map_err(bad_json)?;
            let (root, mut unused) = prepared(context, root)?;
            unused.extend(repaired.unused);
            json = repaired.json.into();
            ((root, unused), repaired.left_out.map(|reason| context.bad(reason)))
        }
    };
    if let Some(copyright) = &root.asset.copyright {
        context.notes.add_credit(copyright);
    }
    for name in root.extensions_used.iter().filter(|name| !extensions::is_supported(name)) {
        context.notes.add(format!("glTF extension {name}"));
    }
    unused.into_iter().for_each(|kind| context.notes.add(kind));
    let removed = node_tree::keep_one_parent(&mut root);
    context.notes.add_count("glTF: node with several parents (drawn below one of them)", removed);
    let double = DoublePrecision::read(&json, &root).map_err(bad_json)?;
    Ok(Parsed { document: gltf::Document::from_json_without_validation(root), double, left_out })
}

/// Removes what the crate misreads and what a still scene does not draw, valid or not. Returns the kinds of the latter, or
/// an error if a reference is invalid.
fn prepared(context: &Context<'_>, mut root: json::Root) -> Result<(json::Root, Vec<&'static str>), IoError> {
    let mut unused = Vec::new();
    for (is_used, kind) in [
        (!root.animations.is_empty(), ANIMATIONS),
        (!root.cameras.is_empty(), CAMERAS),
        (root.scenes.len() > 1, "glTF: scenes besides the default one"),
    ] {
        if is_used {
            unused.push(kind);
        }
    }
    root.animations.clear();
    root.cameras.clear();
    root.nodes.iter_mut().for_each(|node| node.camera = None);
    root.extensions_required.clear();
    for image in &mut root.images {
        if image.buffer_view.is_some() {
            // The bytes say what they are.
            image.mime_type.get_or_insert_with(|| json::image::MimeType("application/octet-stream".to_owned()));
        } else {
            // An image without a source cannot be read; the mesh is drawn without it.
            image.uri.get_or_insert_with(|| "data:,".to_owned());
        }
    }
    // The crate panics or misbehaves unless these indices are valid.
    let accessors = root.accessors.len();
    for primitive in root.meshes.iter_mut().flat_map(|m| m.primitives.iter_mut()) {
        if let Some(index) = primitive.attributes.values().map(|a| a.value()).find(|index| *index >= accessors) {
            return Err(context.bad(format_args!("accessor {index} of {accessors}")));
        }
        // Attributes with unknown names are ignored, valid or not.
        primitive.attributes.retain(|semantic, _| matches!(semantic, Checked::Valid(_)));
    }
    let mut errors = Vec::new();
    root.validate(&root, json::Path::new, &mut |path, error| {
        let path = path();
        if !is_harmless(path.as_str(), error) {
            errors.push((path, error));
        }
    });
    match errors.is_empty() {
        true => Ok((root, unused)),
        false => Err(context.bad(gltf::Error::Validation(errors))),
    }
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
