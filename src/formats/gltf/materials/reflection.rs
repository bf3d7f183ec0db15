//! [`Reflection`]: the metallic-roughness model of a glTF material, before its maps are decoded.

use std::sync::Arc;

use super::surface::emitted;
use super::texture_ref::TextureRef;
use crate::formats::ignored::Notes;
use crate::scene::Texture;

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
}

impl Reflection {
    /// Reads the model of a material whose base colour has the texture `base`. Returns `None` for a matte surface. Maps with
    /// other texture coordinates than the base colour are noted and left out.
    pub(super) fn new(material: &gltf::Material<'_>, base: Option<&TextureRef>, notes: &Notes) -> Option<Self> {
        let pbr = material.pbr_metallic_roughness();
        let map = pbr.metallic_roughness_texture().map(|info| TextureRef::new(&info));
        Self::with_factors(material, (pbr.metallic_factor(), pbr.roughness_factor()), map, base, notes)
    }

    /// Reads the maps of a material as [`Self::new`] does, with other metallic and roughness factors and another map of them.
    pub(super) fn with_factors(
        material: &gltf::Material<'_>,
        (metallic, roughness): (f32, f32),
        metallic_roughness: Option<TextureRef>,
        base: Option<&TextureRef>,
        notes: &Notes,
    ) -> Option<Self> {
        let normal = material.normal_texture();
        let occlusion = material.occlusion_texture();
        let mut reflection = Self {
            metallic,
            roughness,
            metallic_roughness,
            occlusion: occlusion.as_ref().map(|map| TextureRef::plain(map.texture().index(), map.tex_coord())),
            occlusion_strength: occlusion.as_ref().map_or(0.0, gltf::material::OcclusionTexture::strength),
            normal: normal.as_ref().map(|map| TextureRef::plain(map.texture().index(), map.tex_coord())),
            normal_scale: normal.as_ref().map_or(1.0, gltf::material::NormalTexture::scale),
            emissive: emitted(material),
            emissive_map: material.emissive_texture().map(|info| TextureRef::new(&info)),
        };
        reflection.keep_maps_with(base, notes);
        (!reflection.is_matte()).then_some(reflection)
    }

    fn is_matte(&self) -> bool {
        let is_dark = self.emissive.iter().all(|part| *part <= 0.0);
        self.metallic <= 0.0 && self.roughness >= MATTE_ROUGHNESS && is_dark && self.maps().next().is_none()
    }

    /// Returns the maps that there are.
    pub fn maps(&self) -> impl Iterator<Item = &TextureRef> {
        [&self.normal, &self.metallic_roughness, &self.occlusion, &self.emissive_map].into_iter().flatten()
    }

    /// Removes the maps whose texture coordinates differ from those of the base colour or, without it, of the first map.
    fn keep_maps_with(&mut self, base: Option<&TextureRef>, notes: &Notes) {
        let Some(first) = base.or_else(|| self.maps().next()).copied() else { return };
        let Self { normal, metallic_roughness, occlusion, emissive_map, occlusion_strength, .. } = self;
        for map in [normal, metallic_roughness, &mut *occlusion, emissive_map] {
            if map.is_some_and(|map| !map.has_coordinates_of(&first)) {
                notes.add("glTF material: map with other texture coordinates than the base colour");
                *map = None;
            }
        }
        if occlusion.is_none() {
            *occlusion_strength = 0.0;
        }
    }
}

/// Returns a map with occlusion in red, roughness in green and metallic in blue, from separate maps, which are RGBA8 unless
/// they are the same. Returns `None` if both are given and differ in size.
pub(super) fn combined(occlusion: &Arc<Texture>, metallic_roughness: Option<&Arc<Texture>>) -> Option<Arc<Texture>> {
    if metallic_roughness.is_some_and(|other| Arc::ptr_eq(occlusion, other)) {
        return Some(occlusion.clone());
    }
    let mut map = Texture::clone(occlusion);
    match metallic_roughness {
        Some(other) if (other.width, other.height, other.mips.len()) != (map.width, map.height, map.mips.len()) => {
            return None;
        }
        Some(other) => {
            for (own, other) in map.mips.iter_mut().zip(&other.mips) {
                for (texel, other) in own.chunks_exact_mut(4).zip(other.chunks_exact(4)) {
                    texel[1..3].copy_from_slice(&other[1..3]);
                }
            }
        }
        None => {
            // The factors apply as they are.
            map.mips.iter_mut().flat_map(|mip| mip.chunks_exact_mut(4)).for_each(|texel| texel[1..3].fill(255));
        }
    }
    Some(Arc::new(map))
}
