//! [`Reflection`]: the metallic-roughness model of a glTF material, before its maps are decoded.

use super::layers::Layers;
use super::texture_ref::{TRANSFORM, TextureRef};
use crate::formats::ignored::Notes;
use crate::scene::SecondUv;

/// Surfaces rougher than this, without metal, maps and emission, look matte and are drawn as matte ones.
const MATTE_ROUGHNESS: f32 = 0.95;

/// The factors and maps of glTF's metallic-roughness model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct Reflection {
    pub metallic: f32,
    pub roughness: f32,
    /// Roughness in green, metallic in blue.
    pub metallic_roughness: Option<TextureRef>,
    /// Occlusion in red.
    pub occlusion: Option<TextureRef>,
    pub occlusion_strength: f32,
    pub normal: Option<TextureRef>,
    pub normal_scale: f32,
    /// Linear.
    pub emissive: [f32; 3],
    pub emissive_map: Option<TextureRef>,
    /// The reflection of what is no metal, and the coat.
    pub layers: Layers,
    /// The set of texture coordinates that maps use which differ from the base colour's; `None` if no map does.
    pub second_set: Option<u32>,
    /// The transforms of these maps.
    pub second_uv: SecondUv,
}

impl Reflection {
    /// Reads the model of a material whose base colour has the texture `base`. Returns `None` for a matte surface.
    pub(super) fn new(material: &gltf::Material<'_>, base: Option<&TextureRef>, notes: &Notes) -> Option<Self> {
        let pbr = material.pbr_metallic_roughness();
        let map = pbr.metallic_roughness_texture().map(|info| TextureRef::new(&info));
        let layers = Layers::new(material, notes);
        Self::with_factors(material, (pbr.metallic_factor(), pbr.roughness_factor()), map, (base, layers), notes)
    }

    /// Reads the maps of a material as [`Self::new`] does, with other metallic and roughness factors, another map of them and
    /// other layers.
    pub(super) fn with_factors(
        material: &gltf::Material<'_>,
        (metallic, roughness): (f32, f32),
        metallic_roughness: Option<TextureRef>,
        (base, layers): (Option<&TextureRef>, Layers),
        notes: &Notes,
    ) -> Option<Self> {
        let normal = material.normal_texture();
        let occlusion = material.occlusion_texture();
        let mut reflection = Self {
            metallic,
            roughness,
            metallic_roughness,
            occlusion: occlusion.as_ref().map(|map| {
                let extension = map.extension_value(TRANSFORM);
                TextureRef::with_extension(map.texture().index(), map.tex_coord(), extension)
            }),
            occlusion_strength: occlusion.as_ref().map_or(0.0, gltf::material::OcclusionTexture::strength),
            normal: normal.as_ref().map(|map| {
                let extension = map.extension_value(TRANSFORM);
                TextureRef::with_extension(map.texture().index(), map.tex_coord(), extension)
            }),
            normal_scale: normal.as_ref().map_or(1.0, gltf::material::NormalTexture::scale),
            emissive: emitted(material),
            emissive_map: material.emissive_texture().map(|info| TextureRef::new(&info)),
            layers,
            second_set: None,
            second_uv: SecondUv::default(),
        };
        reflection.find_second_uv(base, notes);
        (!reflection.is_matte()).then_some(reflection)
    }

    fn is_matte(&self) -> bool {
        let is_dark = self.emissive.iter().all(|part| *part <= 0.0);
        self.metallic <= 0.0
            && self.roughness >= MATTE_ROUGHNESS
            && is_dark
            && self.maps().next().is_none()
            && self.layers.are_plain()
    }

    /// Returns the maps that there are.
    pub fn maps(&self) -> impl Iterator<Item = &TextureRef> {
        let Layers { specular_map, coat_map, coat_normal, .. } = &self.layers;
        [
            &self.normal,
            &self.metallic_roughness,
            &self.occlusion,
            &self.emissive_map,
            specular_map,
            coat_map,
            coat_normal,
        ]
        .into_iter()
        .flatten()
    }

    /// Finds the maps whose texture coordinates differ from those of the base colour or, without it, of the first map. All
    /// of them use one set, each with its transform; maps with a third set are noted and left out.
    fn find_second_uv(&mut self, base: Option<&TextureRef>, notes: &Notes) {
        let Some(first) = base.or_else(|| self.maps().next()).copied() else { return };
        let Self { normal, metallic_roughness, occlusion, emissive_map, layers, second_set, second_uv, .. } = self;
        for (map, transform) in [
            (normal, &mut second_uv.normal),
            (metallic_roughness, &mut second_uv.occlusion_roughness_metallic),
            (emissive_map, &mut second_uv.emissive),
            (&mut *occlusion, &mut second_uv.occlusion),
            (&mut layers.specular_map, &mut second_uv.dielectric),
            (&mut layers.coat_map, &mut second_uv.clearcoat),
            (&mut layers.coat_normal, &mut second_uv.clearcoat_normal),
        ] {
            let Some(own) = map.filter(|map| !map.has_coordinates_of(&first)) else { continue };
            if *second_set.get_or_insert(own.uv_set) == own.uv_set {
                *transform = Some(own.affine());
            } else {
                notes.add("glTF material: map with a third set of texture coordinates");
                *map = None;
            }
        }
        if occlusion.is_none() {
            self.occlusion_strength = 0.0;
        }
    }
}

/// Returns the light that a material emits, linear, before its texture.
pub(super) fn emitted(material: &gltf::Material<'_>) -> [f32; 3] {
    let strength = material.emissive_strength().unwrap_or(1.0);
    material.emissive_factor().map(|part| part * strength)
}
