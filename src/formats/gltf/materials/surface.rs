//! [`Surface`]: a material of a glTF reduced to what [`Material`](crate::scene::Material) holds.

use super::layers::{self, Layers};
use super::reflection::{Reflection, emitted};
use super::specular_glossiness::{Converted, SpecularGlossiness};
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
    /// The metallic-roughness model; `None` for a matte or unlit surface.
    pub reflection: Option<Reflection>,
    /// The material whose maps are converted to a base colour map and a metallic-roughness map. The factors of the surface
    /// multiply the converted maps.
    pub converted: Option<SpecularGlossiness>,
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
            reflection: None,
            converted: None,
        };
        if let Some(specular) = material.pbr_specular_glossiness().filter(|_| !surface.unlit) {
            surface.convert(material, SpecularGlossiness::new(&specular, notes), notes);
        } else if let Some(diffuse) = techniques.diffuse(material) {
            notes.add("glTF material: WebGL shaders (drawn with their diffuse colour)");
            note_unused_maps(material, notes);
            surface.base_color = diffuse.color.unwrap_or([1.0; 4]);
            surface.texture = diffuse.texture;
        } else if !surface.unlit && material.index().is_some() {
            surface.reflection = Reflection::new(material, surface.texture.as_ref(), notes);
        }
        if !surface.unlit {
            surface.add_emission(material, notes);
        }
        if let Some(opacity) = layers::opacity(material, notes) {
            surface.transmit(opacity);
        }
        surface
    }

    /// Blends a surface that lets light through. The alpha of an opaque one has no meaning before.
    fn transmit(&mut self, opacity: f32) {
        let alpha = &mut self.base_color[3];
        match self.alpha {
            AlphaMode::Opaque => (self.alpha, *alpha) = (AlphaMode::Blend, opacity),
            AlphaMode::Blend => *alpha *= opacity,
            AlphaMode::Mask(_) => {}
        }
    }

    /// Sets a material of KHR_materials_pbrSpecularGlossiness.
    fn convert(&mut self, material: &gltf::Material<'_>, model: SpecularGlossiness, notes: &Notes) {
        let (base_color, factors) = match model.needs_converted_maps() {
            true => ([1.0, 1.0, 1.0, model.alpha()], (1.0, 1.0)),
            false => {
                let Converted { base_color, metallic, roughness } = model.converted();
                (base_color, (metallic, roughness))
            }
        };
        self.base_color = base_color;
        self.texture = model.texture();
        let coat = Layers::coat_alone(material, notes);
        self.reflection = Reflection::with_factors(material, factors, None, (self.texture.as_ref(), coat), notes);
        self.converted = model.needs_converted_maps().then_some(model);
    }

    /// Returns the texture whose coordinates the vertices get.
    pub fn texture_coordinates(&self) -> Option<&TextureRef> {
        self.texture.as_ref().or_else(|| self.reflection.as_ref()?.maps().next())
    }

    /// Draws a black surface that emits light as an unlit surface of that colour. Notes emission that is not drawn.
    fn add_emission(&mut self, material: &gltf::Material<'_>, notes: &Notes) {
        let emitted = emitted(material);
        if emitted.iter().all(|part| *part <= BLACK) {
            return;
        }
        if self.base_color[..3].iter().any(|part| *part > BLACK) {
            if self.reflection.is_none() {
                notes.add("glTF material: emitted light");
            }
            return;
        }
        self.reflection = None;
        // Light beyond 1 is brighter than the screen; the ratio of the components is kept.
        let most = emitted.iter().copied().fold(1.0, f32::max);
        let [r, g, b] = emitted.map(|part| part / most);
        self.base_color = [r, g, b, self.base_color[3]];
        self.texture = material.emissive_texture().map(|info| TextureRef::new(&info));
        self.unlit = true;
    }
}

/// Notes the maps of a material that is drawn without its reflection.
fn note_unused_maps(material: &gltf::Material<'_>, notes: &Notes) {
    if material.normal_texture().is_some() {
        notes.add("glTF material: normal map of a surface that is drawn without reflection");
    }
    if material.occlusion_texture().is_some() {
        notes.add("glTF material: occlusion map of a surface that is drawn without reflection");
    }
}
