//! [`Materials`]: the materials of a glb, each written once, with the extensions that they need. Any thread.

use std::collections::HashMap;
use std::sync::Arc;

use glam::Affine2;
use serde_json::{Value, json};

use super::images::{Images, Texels};
use crate::formats::writers::buffers::Buffers;
use crate::scene::{AlphaMode, Dielectric, MapParts, Material, MetallicRoughness, Texture};

/// The materials of one glb. One thread.
#[derive(Default)]
pub(super) struct Materials {
    list: Vec<Value>,
    /// The indices of materials by their text.
    known: HashMap<String, usize>,
    /// The extensions that materials use.
    pub extensions: Vec<&'static str>,
    /// The number of drawables with a property that glTF lacks.
    pub overlays: u64,
}

impl Materials {
    /// Returns the index of a material. The error says why a texture cannot be written.
    pub fn index(&mut self, material: &Material, images: &mut Images, buffers: &mut Buffers) -> Result<usize, String> {
        let json = self.json(material, images, buffers)?;
        let text = json.to_string();
        if let Some(known) = self.known.get(&text) {
            return Ok(*known);
        }
        self.list.push(json);
        self.known.insert(text, self.list.len() - 1);
        Ok(self.list.len() - 1)
    }

    fn uses(&mut self, extension: &'static str) {
        if !self.extensions.contains(&extension) {
            self.extensions.push(extension);
        }
    }

    fn json(&mut self, material: &Material, images: &mut Images, buffers: &mut Buffers) -> Result<Value, String> {
        let surface = material.metallic_roughness.as_ref();
        // A matte surface is a rough one without metal.
        let (metallic, roughness) = surface.map_or((0.0, 1.0), |surface| (surface.metallic, surface.roughness));
        let mut pbr = json!({
            "baseColorFactor": material.base_color, "metallicFactor": metallic, "roughnessFactor": roughness,
        });
        if let Some(texture) = &material.texture {
            pbr["baseColorTexture"] = json!({ "index": images.texture(texture, Texels::Color, buffers)? });
        }
        let mut json = json!({});
        if let Some(surface) = surface {
            self.overlays += u64::from(surface.overlay.is_some());
            self.add_maps(surface, &mut json, &mut pbr, images, buffers)?;
            self.add_layers(surface, &mut json, images, buffers)?;
        }
        json["pbrMetallicRoughness"] = pbr;
        match material.alpha {
            AlphaMode::Opaque => {}
            AlphaMode::Mask(cutoff) => (json["alphaMode"], json["alphaCutoff"]) = ("MASK".into(), json!(cutoff)),
            AlphaMode::Blend => json["alphaMode"] = "BLEND".into(),
        }
        if material.double_sided {
            json["doubleSided"] = true.into();
        }
        if material.unlit {
            self.uses("KHR_materials_unlit");
            json["extensions"]["KHR_materials_unlit"] = json!({});
        }
        Ok(json)
    }

    fn add_maps(
        &mut self,
        surface: &MetallicRoughness,
        json: &mut Value,
        pbr: &mut Value,
        images: &mut Images,
        buffers: &mut Buffers,
    ) -> Result<(), String> {
        let second = &surface.second_uv;
        let mut map = |texture: &Arc<Texture>, uv: Option<Affine2>, texels: Texels| {
            self.map(texture, uv, texels, images, buffers)
        };
        if let Some(texture) = &surface.occlusion_roughness_metallic {
            let info = map(texture, second.occlusion_roughness_metallic, Texels::Values)?;
            if surface.occlusion_map.is_none() && surface.occlusion_strength > 0.0 {
                json["occlusionTexture"] = info.clone();
            }
            pbr["metallicRoughnessTexture"] = info;
        }
        if let Some(texture) = &surface.occlusion_map {
            json["occlusionTexture"] = map(texture, second.occlusion, Texels::Values)?;
        }
        if json.get("occlusionTexture").is_some() {
            json["occlusionTexture"]["strength"] = json!(surface.occlusion_strength.clamp(0.0, 1.0));
        }
        if let Some(texture) = &surface.normal_map {
            json["normalTexture"] = map(texture, second.normal, Texels::Values)?;
            json["normalTexture"]["scale"] = json!(surface.normal_scale);
        }
        if let Some(texture) = &surface.emissive_map {
            json["emissiveTexture"] = map(texture, second.emissive, Texels::Color)?;
        }
        if surface.emissive != [0.0; 3] {
            let strength = surface.emissive.iter().copied().fold(1.0, f32::max);
            json["emissiveFactor"] = json!(surface.emissive.map(|part| (part / strength).clamp(0.0, 1.0)));
            if strength > 1.0 {
                self.uses("KHR_materials_emissive_strength");
                json["extensions"]["KHR_materials_emissive_strength"] = json!({ "emissiveStrength": strength });
            }
        }
        Ok(())
    }

    /// Adds the reflection of what is no metal, and the coat, if they are not those of the plain model.
    fn add_layers(
        &mut self,
        surface: &MetallicRoughness,
        json: &mut Value,
        images: &mut Images,
        buffers: &mut Buffers,
    ) -> Result<(), String> {
        let MetallicRoughness { dielectric, clearcoat, second_uv, .. } = surface;
        let plain = Dielectric::default();
        if dielectric.valid_ior() != plain.ior {
            self.uses("KHR_materials_ior");
            json["extensions"]["KHR_materials_ior"] = json!({ "ior": dielectric.valid_ior() });
        }
        let Dielectric { specular, specular_color, map, map_parts, .. } = dielectric;
        if (*specular, *specular_color) != (1.0, [1.0; 3]) || map.is_some() {
            self.uses("KHR_materials_specular");
            let mut of = json!({ "specularFactor": specular, "specularColorFactor": specular_color });
            if let Some(texture) = map {
                let info = self.map(texture, second_uv.dielectric, Texels::Color, images, buffers)?;
                add_parts(&mut of, info, *map_parts, ["specularColorTexture", "specularTexture"]);
            }
            json["extensions"]["KHR_materials_specular"] = of;
        }
        let [strength, roughness] = clearcoat.factors();
        if strength > 0.0 {
            self.uses("KHR_materials_clearcoat");
            let mut of = json!({ "clearcoatFactor": strength, "clearcoatRoughnessFactor": roughness });
            if let Some(texture) = &clearcoat.map {
                let info = self.map(texture, second_uv.clearcoat, Texels::Values, images, buffers)?;
                add_parts(&mut of, info, clearcoat.map_parts, ["clearcoatTexture", "clearcoatRoughnessTexture"]);
            }
            if let Some(texture) = &clearcoat.normal_map {
                let uv = second_uv.clearcoat_normal;
                of["clearcoatNormalTexture"] = self.map(texture, uv, Texels::Values, images, buffers)?;
                of["clearcoatNormalTexture"]["scale"] = json!(clearcoat.normal_scale);
            }
            json["extensions"]["KHR_materials_clearcoat"] = of;
        }
        Ok(())
    }

    /// Returns the reference to the texture of a map, with the transform of its second texture coordinates.
    fn map(
        &mut self,
        texture: &Arc<Texture>,
        uv: Option<Affine2>,
        texels: Texels,
        images: &mut Images,
        buffers: &mut Buffers,
    ) -> Result<Value, String> {
        let mut info = json!({ "index": images.texture(texture, texels, buffers)? });
        if let Some(uv) = uv {
            info["texCoord"] = 1.into();
            if uv != Affine2::IDENTITY {
                self.uses("KHR_texture_transform");
                info["extensions"] = json!({ "KHR_texture_transform": transform(&uv) });
            }
        }
        Ok(info)
    }

    /// Adds the list to a document.
    pub fn add_to(self, document: &mut Value) {
        if !self.list.is_empty() {
            document["materials"] = self.list.into();
        }
    }
}

/// Adds the parts of a map that count, by their names.
fn add_parts(of: &mut Value, map: Value, parts: MapParts, [first, second]: [&str; 2]) {
    if parts.has_first() {
        of[first] = map.clone();
    }
    if parts.has_second() {
        of[second] = map;
    }
}

/// Returns the object of KHR_texture_transform: scale, then rotation, then offset.
fn transform(uv: &Affine2) -> Value {
    let (x, y) = (uv.matrix2.x_axis, uv.matrix2.y_axis);
    let rotation = (-x.y).atan2(x.x);
    let (sin, cos) = rotation.sin_cos();
    json!({
        "offset": uv.translation.to_array(), "rotation": rotation,
        "scale": [x.length(), y.x * sin + y.y * cos],
    })
}

#[cfg(test)]
mod tests {
    use glam::{Mat2, Vec2};

    use super::*;

    #[test]
    fn transforms_of_texture_coordinates_have_scale_rotation_and_offset() {
        let (sin, cos) = 0.7f32.sin_cos();
        let matrix2 = Mat2::from_cols_array(&[cos, -sin, sin, cos]) * Mat2::from_diagonal(Vec2::new(2.0, -3.0));
        let json = transform(&Affine2 { matrix2, translation: Vec2::new(0.25, 0.5) });
        let number = |value: &Value| value.as_f64().unwrap();
        assert!((number(&json["rotation"]) - 0.7).abs() < 1e-6);
        assert!((number(&json["scale"][0]) - 2.0).abs() < 1e-5 && (number(&json["scale"][1]) + 3.0).abs() < 1e-5);
        assert_eq!(json["offset"], json!([0.25, 0.5]));
    }
}
