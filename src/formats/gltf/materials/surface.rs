//! [`Surface`]: a material of a glTF reduced to a colour, a texture and how both are drawn.

use super::techniques::Techniques;
use super::texture_ref::TextureRef;
use crate::formats::ignored::Notes;
use crate::scene::AlphaMode;

/// A material before its texture is decoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct Surface {
    /// Linear RGBA.
    pub base_color: [f32; 4],
    pub texture: Option<TextureRef>,
    pub alpha: AlphaMode,
    pub double_sided: bool,
    pub unlit: bool,
}

/// Components of a colour below this one are black in 8 bits.
const BLACK: f32 = 0.5 / 255.0;

impl Surface {
    /// Reduces a material. Notes every property that is not drawn.
    pub(super) fn new(material: &gltf::Material<'_>, techniques: &Techniques, notes: &Notes) -> Self {
        let pbr = material.pbr_metallic_roughness();
        let mut surface = Self {
            base_color: pbr.base_color_factor(),
            texture: pbr.base_color_texture().map(|info| TextureRef::new(&info)),
            alpha: match material.alpha_mode() {
                gltf::material::AlphaMode::Opaque => AlphaMode::Opaque,
                gltf::material::AlphaMode::Mask => AlphaMode::Mask(material.alpha_cutoff().unwrap_or(0.5)),
                gltf::material::AlphaMode::Blend => AlphaMode::Blend,
            },
            double_sided: material.double_sided(),
            unlit: material.unlit(),
        };
        if let Some(specular) = material.pbr_specular_glossiness().filter(|_| !surface.unlit) {
            notes.add("glTF material: specular colour and glossiness");
            surface.base_color = specular.diffuse_factor();
            surface.texture = specular.diffuse_texture().map(|info| TextureRef::new(&info));
        } else if let Some(diffuse) = techniques.diffuse(material) {
            notes.add("glTF material: shaders of KHR_techniques_webgl (drawn with their diffuse colour)");
            surface.base_color = diffuse.color.unwrap_or([1.0; 4]);
            surface.texture = diffuse.texture;
        } else if !surface.unlit && material.index().is_some() {
            let is_metal = pbr.metallic_factor() > 0.0 || pbr.metallic_roughness_texture().is_some();
            note_if(notes, is_metal, "glTF material: metallic and glossy reflections");
        }
        if !surface.unlit {
            note_if(notes, material.normal_texture().is_some(), "glTF material: normal texture");
            note_if(notes, material.occlusion_texture().is_some(), "glTF material: occlusion texture");
            surface.add_emission(material, notes);
        }
        surface
    }

    /// Draws a black surface that emits light as an unlit surface of that colour. Other emission is noted.
    fn add_emission(&mut self, material: &gltf::Material<'_>, notes: &Notes) {
        let strength = material.emissive_strength().unwrap_or(1.0);
        let emitted = material.emissive_factor().map(|part| part * strength);
        if emitted.iter().all(|part| *part <= BLACK) {
            return;
        }
        if self.base_color[..3].iter().any(|part| *part > BLACK) {
            notes.add("glTF material: emitted light");
            return;
        }
        // Light beyond 1 is brighter than the screen; the ratio of the components is kept.
        let most = emitted.iter().copied().fold(1.0, f32::max);
        let [r, g, b] = emitted.map(|part| part / most);
        self.base_color = [r, g, b, self.base_color[3]];
        self.texture = material.emissive_texture().map(|info| TextureRef::new(&info));
        self.unlit = true;
    }
}

fn note_if(notes: &Notes, is_used: bool, kind: &'static str) {
    if is_used {
        notes.add(kind);
    }
}
