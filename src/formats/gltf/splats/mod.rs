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

use super::accessors::{BUFFER_MISSING, Buffers};
use super::context::Context;
use crate::fetch::IoError;
use crate::math::color;
use crate::scene::{AlphaMode, Drawable, Geometry, Material, Splat, SplatHarmonics, Splats};

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
#[derive(Debug)]
struct Found {
    splats: Vec<Splat>,
    harmonics: SplatHarmonics,
    /// The number of splats with invalid values.
    invalid: u64,
    /// The notes on features of the source that are not drawn.
    ignored: Vec<&'static str>,
}

/// A splat as a source has it.
#[derive(Clone, Copy, Debug)]
struct SourceSplat {
    position: [f32; 3],
    scale: [f32; 3],
    rotation: [f32; 4],
    /// The colour of degree 0, in the colour space of the source.
    color: [f32; 3],
    opacity: f32,
}

impl Found {
    /// Returns a list with room for a number of splats with harmonics up to a degree.
    fn new(count: usize, degree: u8, is_linear: bool) -> Self {
        let mut harmonics = SplatHarmonics::new(degree, is_linear);
        harmonics.reserve(count);
        Self { splats: Vec::with_capacity(count), harmonics, invalid: 0, ignored: Vec::new() }
    }

    /// Adds a splat with its coefficients above degree 0.
    fn add(&mut self, splat: &SourceSplat, coefficients: &[[f32; 3]]) {
        let SourceSplat { position, scale, rotation, color, opacity } = *splat;
        let [r, g, b] = match self.harmonics.is_linear() {
            true => color.map(|c| color::srgb_from_linear(f64::from(c.clamp(0.0, 1.0))) as f32),
            false => color,
        };
        let splat = Splat::new(position, scale, rotation, [r, g, b, opacity]);
        let splat = splat.filter(|_| coefficients.as_flattened().iter().all(|c| c.is_finite()));
        match splat {
            Some(splat) => {
                self.splats.push(splat);
                self.harmonics.push(color, coefficients);
            }
            None => self.invalid += 1,
        }
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

/// Reads the splats of a primitive. Returns `None` if the primitive is none of splats, and no drawables if it draws nothing: it
/// has no splats, or a buffer is missing. Clouds that are too large for a buffer are several drawables.
pub(super) fn read(
    context: &Context<'_>,
    buffers: &Buffers<'_>,
    document: &Document,
    primitive: &gltf::Primitive<'_>,
) -> Result<Option<Vec<Drawable>>, IoError> {
    let base = primitive.extension_value(EXTENSION);
    let nested = base.and_then(|base| base.get("extensions"));
    let compressed = SPZ_EXTENSIONS
        .iter()
        .find_map(|name| nested.and_then(|nested| nested.get(name)).or_else(|| primitive.extension_value(name)));
    let is_linear = base.is_some_and(|base| is_linear(context, base));
    let found = match (compressed, base) {
        (Some(extension), _) => spz_file(context, buffers, document, extension, is_linear)?,
        (None, Some(_)) => accessors::read(context, buffers, primitive, is_linear)?,
        (None, None) => return Ok(None),
    };
    let Some(Found { splats, harmonics, invalid, ignored }) = found else {
        context.notes.add(BUFFER_MISSING);
        return Ok(Some(Vec::new()));
    };
    for kind in ignored {
        context.notes.add(kind);
    }
    context.notes.add_count("glTF: Gaussian splat with invalid values", invalid);
    if splats.is_empty() {
        let is_invalid = invalid > 0;
        return if is_invalid { Err(context.bad("no Gaussian splat has finite values")) } else { Ok(Some(Vec::new())) };
    }
    let splats = Splats::new(splats).with_harmonics(harmonics).expect("each splat was added with its harmonics");
    let drawable = |splats| {
        let material = Material { alpha: AlphaMode::Blend, unlit: true, ..Material::default() };
        Drawable::new(Geometry::Splats(Arc::new(splats)), material)
    };
    Ok(Some(splats.cut_to_buffers().into_iter().map(drawable).collect()))
}

/// Reads an SPZ file in a buffer view.
fn spz_file(
    context: &Context<'_>,
    buffers: &Buffers<'_>,
    document: &Document,
    extension: &Value,
    is_linear: bool,
) -> Result<Option<Found>, IoError> {
    let index = extension.get("bufferView").and_then(Value::as_u64).and_then(|index| usize::try_from(index).ok());
    let view = index.and_then(|index| document.views().nth(index));
    let view = view.ok_or_else(|| context.bad("SPZ: bufferView is missing or leads nowhere"))?;
    let Some(bytes) = buffers.view(&view)? else { return Ok(None) };
    spz::read(bytes, is_linear, |count, bytes| {
        context.budget.add_vertices(count)?;
        // The values, and those of all streams one after the other.
        context.budget.ask(bytes)?;
        context.budget.add_decoded(bytes)
    })
    .map_err(|error| match error {
        spz::SpzError::Refused(error) => error,
        other => context.bad(other),
    })
    .map(Some)
}

/// Returns true if colours are linear. Notes kernels and colour spaces that are drawn like others.
fn is_linear(context: &Context<'_>, base: &Value) -> bool {
    let text = |name: &str| base.get(name).and_then(Value::as_str);
    if let Some(other) = text("kernel").filter(|kernel| *kernel != "ellipse") {
        context.notes.add(format!("glTF: kernel {other} of Gaussian splats"));
    }
    match text("colorSpace") {
        None | Some("srgb_rec709_display" | "BT.709" | "BT.709-sRGB") => false,
        Some("lin_rec709_display" | "BT.709-linear" | "linear") => true,
        Some(other) => {
            context.notes.add(format!("glTF: colour space {other} of Gaussian splats"));
            false
        }
    }
}
