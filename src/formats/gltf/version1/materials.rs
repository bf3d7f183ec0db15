//! Materials with their techniques, textures, images and samplers.
//!
//! WebGL techniques become those of KHR_techniques_webgl, of which the reader takes the diffuse colour or texture. Materials of
//! KHR_materials_common become rough surfaces without metal. Its colours are sRGB, those of glTF 2.0 linear. CesiumJS converts
//! the base colour too, but leaves emitted light as it is.

use std::collections::BTreeSet;

use serde_json::{Map, Value, json};

use super::Upgrade;
use super::document::{CommonMaterial, Material, Technique};
use crate::fetch::IoError;
use crate::formats::lenient::Text;
use crate::math::color::linear_from_srgb;

/// WebGL's numbers of states.
const BLEND: f64 = 3042.0;
const CULL_FACE: f64 = 2884.0;
/// The semantic of the parameter whose colour or texture the features of a tile may replace.
const DIFFUSE: &str = "_3DTILESDIFFUSE";

impl Upgrade<'_> {
    pub(super) fn materials(&self) -> Vec<Value> {
        // Read once: any number of materials may share a technique.
        let states: Vec<RenderState> = self.document.techniques.list.iter().map(RenderState::new).collect();
        self.document.materials.list.iter().map(|material| self.material(material, &states)).collect()
    }

    fn material(&self, material: &Material, states: &[RenderState]) -> Value {
        if let Some(common) = &material.extensions.common {
            return self.common(common);
        }
        let (technique, values) = match &material.instance_technique {
            Some(instance) => (&instance.technique, &instance.values),
            None => (&material.technique, &material.values),
        };
        let mut upgraded = json!({ "pbrMetallicRoughness": { "metallicFactor": 0 } });
        let Some(index) = self.found(&self.document.techniques.ids, technique, "technique") else { return upgraded };
        let RenderState { is_blended, is_double_sided, is_unlit } = states[index];
        upgraded["doubleSided"] = is_double_sided.into();
        if is_blended {
            upgraded["alphaMode"] = "BLEND".into();
        }
        let values: Map<String, Value> = values.iter().map(|(name, of)| (name.clone(), self.value(of))).collect();
        upgraded["extensions"] = json!({ "KHR_techniques_webgl": { "technique": index, "values": values } });
        if is_unlit {
            upgraded["extensions"]["KHR_materials_unlit"] = json!({});
        }
        upgraded
    }

    /// Returns the extension KHR_techniques_webgl of the document.
    pub(super) fn techniques(&self) -> Value {
        let uniforms = |technique: &Technique| -> Map<String, Value> {
            // The name of a uniform may say what its parameter is.
            let named = technique.uniforms.iter().filter(|(uniform, _)| is_diffuse(uniform));
            let named: BTreeSet<&String> = named.map(|(_, parameter)| parameter).collect();
            let parameters = technique.parameters.iter();
            let upgraded = parameters.map(|(name, parameter)| {
                let mut uniform = json!({ "value": self.value(&parameter.value) });
                if named.contains(name) || parameter.semantic.0.as_deref() == Some(DIFFUSE) {
                    uniform["semantic"] = DIFFUSE.into();
                }
                (name.clone(), uniform)
            });
            upgraded.collect()
        };
        let techniques = self.document.techniques.list.iter();
        json!({ "techniques": techniques.map(|of| json!({ "uniforms": uniforms(of) })).collect::<Vec<_>>() })
    }

    /// Converts a material of KHR_materials_common.
    fn common(&self, common: &CommonMaterial) -> Value {
        let get = |name: &str| common.values.get(name).unwrap_or(&Value::Null);
        let flag = |own: Option<bool>, name: &str| own.or_else(|| get(name).as_bool()).unwrap_or(false);
        let is_constant = common.technique.0.as_deref() == Some("CONSTANT");
        let base = match is_constant {
            false => get("diffuse"),
            true if is_black(get("emission")) && !get("ambient").is_null() => get("ambient"),
            true => get("emission"),
        };
        let mut pbr = json!({ "metallicFactor": 0 });
        // A surface without a diffuse part is black if it emits light.
        let absent = if is_black(get("emission")) { [1.0; 4] } else { [0.0, 0.0, 0.0, 1.0] };
        let mut factor = linear_color(base).unwrap_or(absent);
        if let Some(texture) = self.texture(base) {
            factor = [1.0; 4];
            pbr["baseColorTexture"] = texture;
        }
        factor[3] *= get("transparency").as_f64().unwrap_or(1.0).clamp(0.0, 1.0);
        pbr["baseColorFactor"] = json!(factor);
        let mut upgraded = json!({ "pbrMetallicRoughness": pbr });
        if is_constant {
            upgraded["extensions"] = json!({ "KHR_materials_unlit": {} });
        } else {
            if let Some(texture) = self.texture(get("emission")) {
                upgraded["emissiveTexture"] = texture;
                upgraded["emissiveFactor"] = json!([1, 1, 1]);
            } else if let Some([r, g, b, _]) = linear_color(get("emission")) {
                upgraded["emissiveFactor"] = json!([r, g, b]);
            }
            if !is_black(get("specular")) {
                self.notes.add("glTF 1.0 material: specular colour");
            }
        }
        upgraded["doubleSided"] = flag(common.double_sided, "doubleSided").into();
        if flag(common.transparent, "transparent") {
            upgraded["alphaMode"] = "BLEND".into();
        }
        upgraded
    }

    /// Converts a value of a material. Text is the id of a texture.
    fn value(&self, value: &Value) -> Value {
        if value.is_string() { self.texture(value).unwrap_or_default() } else { value.clone() }
    }

    /// Returns a reference to the texture with an id; `None` for other values.
    fn texture(&self, value: &Value) -> Option<Value> {
        let id = Text(Some(value.as_str()?.to_owned()));
        self.found(&self.document.textures.ids, &id, "texture").map(|index| json!({ "index": index }))
    }

    pub(super) fn textures(&self) -> Vec<Value> {
        let textures = self.document.textures.list.iter();
        let upgraded = textures.map(|texture| {
            let mut upgraded = json!({});
            if let Some(source) = self.found(&self.document.images.ids, &texture.source, "image") {
                upgraded["source"] = source.into();
            }
            if let Some(sampler) = self.found(&self.document.samplers.ids, &texture.sampler, "sampler") {
                upgraded["sampler"] = sampler.into();
            }
            upgraded
        });
        upgraded.collect()
    }

    pub(super) fn images(&self) -> Result<Vec<Value>, IoError> {
        let views = &self.document.buffer_views.ids;
        let images = self.document.images.list.iter();
        let upgraded = images.map(|image| match &image.extensions.binary {
            Some(binary) => {
                let view = self.index(views, &binary.buffer_view, "bufferView", "an image")?;
                let mime_type = binary.mime_type.0.as_deref().unwrap_or("application/octet-stream");
                Ok(json!({ "bufferView": view, "mimeType": mime_type }))
            }
            None => Ok(json!({ "uri": image.uri })),
        });
        upgraded.collect()
    }

    pub(super) fn samplers(&self) -> Vec<Value> {
        let samplers = self.document.samplers.list.iter();
        let upgraded = samplers.map(|sampler| {
            let members = [
                ("magFilter", sampler.mag_filter),
                ("minFilter", sampler.min_filter),
                ("wrapS", sampler.wrap_s),
                ("wrapT", sampler.wrap_t),
            ];
            let given = members.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?.into())));
            Value::Object(given.collect())
        });
        upgraded.collect()
    }
}

/// The states that a technique gives to all its materials.
#[derive(Clone, Copy)]
struct RenderState {
    is_blended: bool,
    is_double_sided: bool,
    /// The shader reads no normals, as those of photogrammetry do.
    is_unlit: bool,
}

impl RenderState {
    fn new(technique: &Technique) -> Self {
        let enabled = &technique.states.enable.0;
        let reads = |semantic: &str| technique.parameters.values().any(|of| of.semantic.0.as_deref() == Some(semantic));
        Self {
            is_blended: enabled.contains(&BLEND),
            is_double_sided: !enabled.contains(&CULL_FACE),
            is_unlit: reads("POSITION") && !reads("NORMAL"),
        }
    }
}

fn is_diffuse(name: &str) -> bool {
    name.to_ascii_lowercase().contains("diffuse")
}

/// Returns the linear colour of three or four sRGB components; `None` for other values.
fn linear_color(value: &Value) -> Option<[f64; 4]> {
    let part = |i: usize| value.get(i).and_then(Value::as_f64).map(|part| part.clamp(0.0, 1.0));
    let alpha = part(3).unwrap_or(1.0);
    Some([linear_from_srgb(part(0)?), linear_from_srgb(part(1)?), linear_from_srgb(part(2)?), alpha])
}

/// Returns true for a black colour and for no colour; false for textures.
fn is_black(value: &Value) -> bool {
    !value.is_string() && linear_color(value).is_none_or(|color| color[..3].iter().all(|part| *part <= 0.0))
}
