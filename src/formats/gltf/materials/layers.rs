//! [`Layers`]: what KHR_materials_ior, KHR_materials_specular and KHR_materials_clearcoat add to the reflection of a material,
//! before its maps are decoded. Transmission, which is drawn by alpha.

use serde_json::Value;

use super::texture_ref::TextureRef;
use crate::formats::ignored::Notes;
use crate::scene::MapParts;

const IOR: &str = "KHR_materials_ior";
const SPECULAR: &str = "KHR_materials_specular";
const CLEARCOAT: &str = "KHR_materials_clearcoat";
const TRANSMISSION: &str = "KHR_materials_transmission";

/// The opacity that is taken from a surface which transmits all light. The rest shows its reflections and its colour.
const TRANSMITTED: f32 = 0.75;

/// The factors and maps of the extensions. Values are finite and in range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct Layers {
    pub ior: f32,
    pub specular: f32,
    /// Linear.
    pub specular_color: [f32; 3],
    /// The colour in red, green and blue, the strength in alpha.
    pub specular_map: Option<TextureRef>,
    pub specular_parts: MapParts,
    /// The strength of the coat; 0 without one.
    pub coat: f32,
    pub coat_roughness: f32,
    /// The strength in red, the roughness in green.
    pub coat_map: Option<TextureRef>,
    pub coat_parts: MapParts,
    /// The normal map of the coat, whatever its base has.
    pub coat_normal: Option<TextureRef>,
    pub coat_normal_scale: f32,
}

impl Default for Layers {
    /// Returns a reflection that the plain model has too, and no coat.
    fn default() -> Self {
        Self {
            ior: 1.5,
            specular: 1.0,
            specular_color: [1.0; 3],
            specular_map: None,
            specular_parts: MapParts::Both,
            coat: 0.0,
            coat_roughness: 0.0,
            coat_map: None,
            coat_parts: MapParts::Both,
            coat_normal: None,
            coat_normal_scale: 1.0,
        }
    }
}

impl Layers {
    /// Reads the extensions of a material. Values out of range are clamped and noted, and so are parts that are not drawn.
    pub(super) fn new(material: &gltf::Material<'_>, notes: &Notes) -> Self {
        let mut layers = Self::coat_alone(material, notes);
        if let Some(ior) = material.extension_value(IOR) {
            layers.ior = match number(ior, IOR, "ior", 1.5, notes) {
                ior if ior == 0.0 || ior >= 1.0 => ior,
                ior => {
                    note_range(IOR, notes);
                    if ior > 0.0 { 1.0 } else { 1.5 }
                }
            };
        }
        if let Some(of) = material.extension_value(SPECULAR) {
            layers.specular = share(of, SPECULAR, "specularFactor", 1.0, notes);
            layers.specular_color = color(of, SPECULAR, "specularColorFactor", notes);
            let maps = [map(of, "specularColorTexture"), map(of, "specularTexture")];
            (layers.specular_map, layers.specular_parts) = one_map(maps, "specular", notes);
        }
        layers
    }

    /// Reads the coat of a material alone, for models that have another reflection.
    pub(super) fn coat_alone(material: &gltf::Material<'_>, notes: &Notes) -> Self {
        let mut layers = Self::default();
        if let Some(of) = material.extension_value(CLEARCOAT) {
            layers.coat = share(of, CLEARCOAT, "clearcoatFactor", 0.0, notes);
            layers.coat_roughness = share(of, CLEARCOAT, "clearcoatRoughnessFactor", 0.0, notes);
            if layers.coat > 0.0 {
                let maps = [map(of, "clearcoatTexture"), map(of, "clearcoatRoughnessTexture")];
                (layers.coat_map, layers.coat_parts) = one_map(maps, "clearcoat", notes);
                if let Some(normal) = of.get("clearcoatNormalTexture") {
                    layers.coat_normal = TextureRef::from_json(normal);
                    layers.coat_normal_scale = number(normal, CLEARCOAT, "scale", 1.0, notes);
                }
            }
        }
        layers
    }

    /// Returns true if the plain model looks the same.
    pub(super) fn are_plain(&self) -> bool {
        let Self { ior, specular, specular_color, specular_map, coat, .. } = self;
        (*ior, *specular, *specular_color) == (1.5, 1.0, [1.0; 3]) && specular_map.is_none() && *coat <= 0.0
    }
}

/// Returns the opacity of a material by KHR_materials_transmission; `None` if it lets no light through. Transmission by a texture
/// is noted: the opaque parts of such a surface matter more.
pub(super) fn opacity(material: &gltf::Material<'_>, notes: &Notes) -> Option<f32> {
    let of = material.extension_value(TRANSMISSION)?;
    let transmission = share(of, TRANSMISSION, "transmissionFactor", 0.0, notes);
    if transmission > 0.0 && map(of, "transmissionTexture").is_some() {
        notes.add("glTF material: transmission by a texture (drawn opaque)");
        return None;
    }
    (transmission > 0.0).then_some(1.0 - TRANSMITTED * transmission)
}

/// Returns the one map of two that are parts of the same image; the first of them if they are not.
fn one_map(maps: [Option<TextureRef>; 2], kind: &str, notes: &Notes) -> (Option<TextureRef>, MapParts) {
    match maps {
        [Some(first), Some(second)] if first == second => (Some(first), MapParts::Both),
        [Some(first), second] => {
            if second.is_some() {
                notes.add(format!("glTF material: second {kind} map that is not in the image of the first"));
            }
            (Some(first), MapParts::First)
        }
        [None, Some(second)] => (Some(second), MapParts::Second),
        [None, None] => (None, MapParts::Both),
    }
}

fn map(of: &Value, name: &str) -> Option<TextureRef> {
    TextureRef::from_json(of.get(name)?)
}

fn note_range(extension: &str, notes: &Notes) {
    notes.add(format!("glTF material: value out of range in {extension}"));
}

/// Returns a finite number; the default, noted, for another value.
fn number(of: &Value, extension: &str, name: &str, default: f32, notes: &Notes) -> f32 {
    match of.get(name) {
        None | Some(Value::Null) => default,
        Some(value) => finite(value).unwrap_or_else(|| {
            note_range(extension, notes);
            default
        }),
    }
}

fn finite(value: &Value) -> Option<f32> {
    value.as_f64().map(|number| number as f32).filter(|number| number.is_finite())
}

/// Returns a number from 0 to 1.
fn share(of: &Value, extension: &str, name: &str, default: f32, notes: &Notes) -> f32 {
    let value = number(of, extension, name, default, notes);
    if !(0.0..=1.0).contains(&value) {
        note_range(extension, notes);
    }
    value.clamp(0.0, 1.0)
}

/// Returns a linear colour, which may be brighter than white; white, noted, for another value.
fn color(of: &Value, extension: &str, name: &str, notes: &Notes) -> [f32; 3] {
    let Some(value) = of.get(name).filter(|value| !value.is_null()) else { return [1.0; 3] };
    let parts = [0, 1, 2].map(|i| value.get(i).and_then(finite).filter(|part| *part >= 0.0));
    if parts.iter().any(Option::is_none) {
        note_range(extension, notes);
    }
    parts.map(|part| part.unwrap_or(1.0))
}
