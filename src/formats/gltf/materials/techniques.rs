//! KHR_techniques_webgl: materials that are WebGL shaders with named uniforms. Their diffuse colour or texture is found by the
//! names that exporters use, or by its semantic in 3D Tiles; the shaders themselves are not run.

use std::collections::HashSet;

use serde_json::Value;

use super::texture_ref::TextureRef;
use crate::math::color::linear_from_srgb;

const EXTENSION: &str = "KHR_techniques_webgl";

/// The techniques of a document.
#[derive(Default)]
pub(super) struct Techniques(Vec<Technique>);

/// The uniforms of a technique.
struct Technique {
    /// The names of uniforms whose semantic says that they are the diffuse part.
    diffuse_names: HashSet<String>,
    /// The diffuse part by the defaults of the uniforms.
    defaults: Found,
}

/// The diffuse part of a material.
pub(super) struct Diffuse {
    /// Linear RGBA.
    pub color: Option<[f32; 4]>,
    pub texture: Option<TextureRef>,
}

/// The diffuse part as a list of named values has it.
#[derive(Clone, Copy, Default)]
struct Found {
    color: Option<[f32; 4]>,
    /// A texture whose name says that it is the diffuse one.
    diffuse_texture: Option<TextureRef>,
    other_texture: Option<TextureRef>,
    opacity: Option<f64>,
}

impl Found {
    /// Searches values by name. The first of each kind counts.
    fn new<'v>(values: impl Iterator<Item = (&'v str, &'v Value)>, is_diffuse: impl Fn(&str) -> bool) -> Self {
        let mut found = Self::default();
        for (name, value) in values {
            let lower = name.to_ascii_lowercase();
            let is_diffuse = lower.contains("diffuse") || is_diffuse(name);
            let texture = if is_diffuse { &mut found.diffuse_texture } else { &mut found.other_texture };
            *texture = texture.or_else(|| TextureRef::from_json(value));
            if is_diffuse {
                found.color = found.color.or_else(|| color(value));
            }
            if lower.contains("transparency") {
                found.opacity = found.opacity.or_else(|| value.as_f64());
            }
        }
        found
    }

    /// Returns the diffuse part; values of the material come before defaults, and diffuse textures before others.
    fn or(self, defaults: Self) -> Diffuse {
        let mut color = self.color.or(defaults.color);
        if let Some(opacity) = self.opacity.or(defaults.opacity) {
            color.get_or_insert([1.0; 4])[3] *= opacity.clamp(0.0, 1.0) as f32;
        }
        let diffuse = self.diffuse_texture.or(defaults.diffuse_texture);
        Diffuse { color, texture: diffuse.or(self.other_texture).or(defaults.other_texture) }
    }
}

impl Techniques {
    pub fn new(document: &gltf::Document) -> Self {
        let techniques = document.extension_value(EXTENSION).and_then(|e| e.get("techniques")?.as_array());
        Self(techniques.into_iter().flatten().map(Technique::new).collect())
    }

    /// Returns the diffuse part of a material with a technique. Returns `None` for other materials.
    pub fn diffuse(&self, material: &gltf::Material<'_>) -> Option<Diffuse> {
        let extension = material.extension_value(EXTENSION)?;
        let technique = extension.get("technique").and_then(Value::as_u64).and_then(|t| usize::try_from(t).ok());
        let technique = technique.and_then(|technique| self.0.get(technique));
        let values = extension.get("values").and_then(Value::as_object);
        let own = values.into_iter().flatten().map(|(name, value)| (name.as_str(), value));
        let own = Found::new(own, |name| technique.is_some_and(|technique| technique.diffuse_names.contains(name)));
        Some(own.or(technique.map(|technique| technique.defaults).unwrap_or_default()))
    }
}

impl Technique {
    fn new(json: &Value) -> Self {
        let uniforms = || json.get("uniforms").and_then(Value::as_object).into_iter().flatten();
        let is_diffuse = |uniform: &Value| uniform.get("semantic").and_then(Value::as_str) == Some("_3DTILESDIFFUSE");
        let diffuse_names = uniforms().filter(|(_, uniform)| is_diffuse(uniform)).map(|(name, _)| name.clone());
        let diffuse_names: HashSet<String> = diffuse_names.collect();
        let defaults = uniforms().filter_map(|(name, uniform)| Some((name.as_str(), uniform.get("value")?)));
        let defaults = Found::new(defaults, |name| diffuse_names.contains(name));
        Self { diffuse_names, defaults }
    }
}

/// Reads three or four numbers. Shaders write them to the screen as they are, so that they are sRGB.
fn color(value: &Value) -> Option<[f32; 4]> {
    let parts: Vec<f32> =
        value.as_array()?.iter().map(|part| part.as_f64().map(|x| x as f32)).collect::<Option<_>>()?;
    let all_finite = parts.iter().all(|part| part.is_finite());
    let linear = |part: f32| linear_from_srgb(f64::from(part)) as f32;
    match *parts.as_slice() {
        [r, g, b] if all_finite => Some([linear(r), linear(g), linear(b), 1.0]),
        [r, g, b, a] if all_finite => Some([linear(r), linear(g), linear(b), a]),
        _ => None,
    }
}
