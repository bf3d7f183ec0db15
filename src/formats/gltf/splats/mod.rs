//! KHR_gaussian_splatting: points that are Gaussian splats, by accessors or as an SPZ file
//! (KHR_gaussian_splatting_compression_spz_2). Decode threads.
//!
//! Drafts of the extensions are read too, since tile sets have them: attributes with other names, and SPZ files below names
//! that the extension had before.

mod accessors;
mod spz;

use std::borrow::Cow;
use std::sync::Arc;

use gltf::Document;
use serde_json::Value;

use super::accessors::Buffers;
use super::context::Context;
use super::mesh::BUFFER_MISSING;
use crate::fetch::IoError;
use crate::math::color;
use crate::scene::{AlphaMode, Drawable, Geometry, Material, Splat, Splats};

/// The extension of the primitive.
const EXTENSION: &str = "KHR_gaussian_splatting";
/// Extensions of the extension, or in older files of the primitive, whose buffer view is an SPZ file.
const SPZ_EXTENSIONS: [&str; 4] = [
    "KHR_gaussian_splatting_compression_spz_2",
    "KHR_gaussian_splatting_compression_spz",
    "KHR_spz_gaussian_splats_compression",
    "KHR_spz_compression",
];
/// The first spherical harmonic.
const HARMONIC_0: f32 = 0.282_094_8;

/// The splats of a source, with what was left out of it.
#[derive(Debug, Default)]
struct Found {
    splats: Vec<Splat>,
    /// The number of splats with invalid values.
    invalid: u64,
    /// The degree of the spherical harmonics.
    degree: u8,
}

impl Found {
    fn add(&mut self, splat: Option<Splat>) {
        self.invalid += u64::from(splat.is_none());
        self.splats.extend(splat);
    }
}

/// Returns the JSON of a glTF with names of attributes that the crate `gltf` keeps: it drops those that begin with the name of
/// an extension, and keeps those that begin with an underscore.
pub(super) fn with_kept_names(json: Cow<'_, [u8]>) -> Cow<'_, [u8]> {
    const NAME: &[u8] = b"\"KHR_gaussian_splatting:";
    if !json.windows(NAME.len()).any(|bytes| bytes == NAME) {
        return json;
    }
    let mut kept = Vec::with_capacity(json.len() + 64);
    let mut rest = &json[..];
    while let Some(byte) = rest.first() {
        kept.push(*byte);
        if rest.starts_with(NAME) {
            kept.push(b'_');
        }
        rest = &rest[1..];
    }
    kept.into()
}

/// Reads the splats of a primitive. Returns `None` if the primitive is none of splats, and `Some(None)` if it draws nothing: it
/// has no splats, or a buffer is missing.
pub(super) fn read(
    context: &Context<'_>,
    buffers: &Buffers<'_>,
    document: &Document,
    primitive: &gltf::Primitive<'_>,
) -> Result<Option<Option<Drawable>>, IoError> {
    let base = primitive.extension_value(EXTENSION);
    let nested = base.and_then(|base| base.get("extensions"));
    let compressed = SPZ_EXTENSIONS
        .iter()
        .find_map(|name| nested.and_then(|nested| nested.get(name)).or_else(|| primitive.extension_value(name)));
    let found = match (compressed, base) {
        (Some(extension), _) => spz_file(context, buffers, document, extension)?,
        (None, Some(_)) => accessors::read(context, buffers, primitive)?,
        (None, None) => return Ok(None),
    };
    let Some(mut found) = found else {
        context.notes.add(BUFFER_MISSING);
        return Ok(Some(None));
    };
    if let Some(base) = base {
        apply_properties(context, base, &mut found);
    }
    context.notes.add_count("glTF: Gaussian splat with invalid values", found.invalid);
    if found.degree > 0 {
        context.notes.add("glTF: spherical harmonics of Gaussian splats above degree 0");
    }
    if found.splats.is_empty() {
        let is_invalid = found.invalid > 0;
        return if is_invalid { Err(context.bad("no Gaussian splat has finite values")) } else { Ok(Some(None)) };
    }
    let geometry = Geometry::Splats(Arc::new(Splats::new(found.splats, found.degree)));
    let material = Material { alpha: AlphaMode::Blend, unlit: true, ..Material::default() };
    Ok(Some(Some(Drawable::new(geometry, material))))
}

/// Reads an SPZ file in a buffer view.
fn spz_file(
    context: &Context<'_>,
    buffers: &Buffers<'_>,
    document: &Document,
    extension: &Value,
) -> Result<Option<Found>, IoError> {
    let index = extension.get("bufferView").and_then(Value::as_u64).and_then(|index| usize::try_from(index).ok());
    let view = index.and_then(|index| document.views().nth(index));
    let view = view.ok_or_else(|| context.bad("SPZ: bufferView is missing or leads nowhere"))?;
    let Some(bytes) = buffers.view(&view)? else { return Ok(None) };
    spz::read(bytes, |count, bytes| {
        context.budget.add_vertices(count)?;
        context.budget.add_decoded(bytes)
    })
    .map_err(|error| match error {
        spz::SpzError::Refused(error) => error,
        other => context.bad(other),
    })
    .map(Some)
}

/// Converts linear colours, and notes kernels and colour spaces that are drawn like others.
fn apply_properties(context: &Context<'_>, base: &Value, found: &mut Found) {
    let text = |name: &str| base.get(name).and_then(Value::as_str);
    match text("colorSpace") {
        None | Some("srgb_rec709_display" | "BT.709" | "BT.709-sRGB") => {}
        Some("lin_rec709_display" | "BT.709-linear" | "linear") => {
            for channel in found.splats.iter_mut().flat_map(|splat| &mut splat.color[..3]) {
                *channel = (color::srgb_from_linear(f64::from(*channel) / 255.0) * 255.0).round() as u8;
            }
        }
        Some(other) => context.notes.add(format!("glTF: colour space {other} of Gaussian splats")),
    }
    if let Some(other) = text("kernel").filter(|kernel| *kernel != "ellipse") {
        context.notes.add(format!("glTF: kernel {other} of Gaussian splats"));
    }
}
