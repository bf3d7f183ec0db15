//! KHR_techniques_webgl: materials that are WebGL shaders with named uniforms. Their diffuse colour or texture is found by the
//! names that exporters use, or by its semantic in 3D Tiles; the shaders themselves are not run.

use serde_json::{Map, Value};

use super::texture_ref::TextureRef;
use crate::math::color::linear_from_srgb;

const EXTENSION: &str = "KHR_techniques_webgl";

/// The techniques of a document.
#[derive(Default)]
pub(super) struct Techniques {
    /// The uniforms of each technique; a uniform has its default in `value`.
    uniforms: Vec<Map<String, Value>>,
}

/// The diffuse part of a material.
pub(super) struct Diffuse {
    /// Linear RGBA.
    pub color: Option<[f32; 4]>,
    pub texture: Option<TextureRef>,
}

impl Techniques {
    pub fn new(document: &gltf::Document) -> Self {
        let techniques = document.extension_value(EXTENSION).and_then(|e| e.get("techniques")?.as_array());
        let uniforms = |technique: &Value| technique.get("uniforms").and_then(Value::as_object).cloned();
        let techniques = techniques.map_or(&[][..], Vec::as_slice);
        Self { uniforms: techniques.iter().map(|technique| uniforms(technique).unwrap_or_default()).collect() }
    }

    /// Returns the diffuse part of a material with a technique. Returns `None` for other materials.
    pub fn diffuse(&self, material: &gltf::Material<'_>) -> Option<Diffuse> {
        let extension = material.extension_value(EXTENSION)?;
        let values = extension.get("values").and_then(Value::as_object);
        let own = values.into_iter().flatten().map(|(name, value)| (name.as_str(), value));
        let technique = extension.get("technique").and_then(Value::as_u64).and_then(|t| usize::try_from(t).ok());
        let uniforms = technique.and_then(|technique| self.uniforms.get(technique));
        let defaults = uniforms.into_iter().flatten();
        let defaults = defaults.filter_map(|(name, uniform)| Some((name.as_str(), uniform.get("value")?)));
        // Values of the material come before defaults, names with "diffuse" before others.
        let mut all: Vec<(&str, &Value)> = own.chain(defaults).collect();
        let is_diffuse = |name: &str| {
            let semantic = uniforms.and_then(|uniforms| uniforms.get(name)?.get("semantic")?.as_str());
            name.to_ascii_lowercase().contains("diffuse") || semantic == Some("_3DTILESDIFFUSE")
        };
        all.sort_by_key(|(name, _)| !is_diffuse(name));
        let texture = all.iter().find_map(|(_, value)| TextureRef::from_json(value));
        let mut color = all.iter().filter(|(name, _)| is_diffuse(name)).find_map(|(_, value)| color(value));
        let transparency = all.iter().find(|(name, _)| name.to_ascii_lowercase().contains("transparency"));
        if let Some(opacity) = transparency.and_then(|(_, value)| value.as_f64()) {
            color.get_or_insert([1.0; 4])[3] *= opacity.clamp(0.0, 1.0) as f32;
        }
        Some(Diffuse { color, texture })
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
