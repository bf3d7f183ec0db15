//! [`Surfaces`]: the materials of a glTF with their decoded textures.

use std::collections::HashMap;
use std::sync::Arc;

use super::reflection::Reflection;
use super::specular_glossiness::{self, SpecularGlossiness};
use super::surface::Surface;
use super::techniques::Techniques;
use super::texture_ref::TextureRef;
use super::textures::{TexelReader, Textures};
use crate::fetch::IoError;
use crate::formats::gltf::accessors::Buffers;
use crate::formats::gltf::context::Context;
use crate::formats::image::SharedTexture;
use crate::scene::{Clearcoat, Dielectric, MetallicRoughness, SharedContent, Texture};

/// The metallic-roughness model of a material with the shared contents of its maps, which are in the order of
/// [`MetallicRoughness::maps`].
pub(in super::super) type DecodedReflection =
    (MetallicRoughness, [Option<Arc<SharedContent>>; MetallicRoughness::MAPS]);

/// The materials read so far. Primitives share them.
pub(in super::super) struct Surfaces<'a> {
    context: &'a Context<'a>,
    techniques: Techniques,
    textures: Textures<'a>,
    /// By the index of the material; `None` is the default material.
    read: HashMap<Option<usize>, Surface>,
    /// Base colour, and metallic and roughness, of materials that were converted.
    converted: HashMap<specular_glossiness::Key, [Arc<Texture>; 2]>,
}

impl<'a> Surfaces<'a> {
    pub fn new(context: &'a Context<'a>, document: &'a gltf::Document) -> Self {
        let techniques = Techniques::new(document);
        let textures = Textures::new(context, document);
        Self { context, techniques, textures, read: HashMap::new(), converted: HashMap::new() }
    }

    /// Returns a material, without its texture.
    pub fn get(&mut self, material: &gltf::Material<'_>) -> Surface {
        let read = || Surface::new(material, &self.techniques, self.context.notes);
        *self.read.entry(material.index()).or_insert_with(read)
    }

    /// Returns the decoded texture of a surface; `None` if it has none or if its image is missing.
    pub fn texture(&mut self, surface: &Surface, buffers: &Buffers<'_>) -> Result<Option<SharedTexture>, IoError> {
        if let Some(material) = &surface.converted {
            let [base_color, _] = self.converted_maps(material, buffers)?;
            return Ok(Some((base_color, None)));
        }
        match surface.texture {
            Some(of) => self.textures.get(of.texture, TexelReader::Colors, buffers),
            None => Ok(None),
        }
    }

    /// Returns an image that holds ids or values in RGBA8; `None` if it is missing or invalid.
    pub fn data_image(&mut self, texture: usize, buffers: &Buffers<'_>) -> Result<Option<Arc<Texture>>, IoError> {
        self.textures.data_image(texture, buffers)
    }

    /// Returns the base colour map, and the map of metallic and roughness, that a material is converted to.
    fn converted_maps(
        &mut self,
        material: &SpecularGlossiness,
        buffers: &Buffers<'_>,
    ) -> Result<[Arc<Texture>; 2], IoError> {
        if let Some(known) = self.converted.get(&material.key()) {
            return Ok(known.clone());
        }
        let mut get = |map: Option<TextureRef>| match map {
            Some(map) => self.textures.get(map.texture, TexelReader::Cpu, buffers).map(|found| Some(found?.0)),
            None => Ok(None),
        };
        let (diffuse, map) = (get(material.diffuse_map)?, get(material.map)?);
        let [width, height] = specular_glossiness::converted_size(diffuse.as_deref(), map.as_deref());
        self.context.budget.check_image(width, height)?;
        self.context.budget.check_images()?;
        let maps = material.converted_maps(diffuse.as_deref(), map.as_deref()).map(Arc::new);
        maps.iter().for_each(|map| self.context.budget.add_image(map.size_bytes()));
        self.converted.insert(material.key(), maps.clone());
        Ok(maps)
    }

    /// Decodes the maps of the reflection of a surface. A map whose image is missing is left out.
    pub fn reflection(
        &mut self,
        surface: &Surface,
        of: &Reflection,
        buffers: &Buffers<'_>,
    ) -> Result<DecodedReflection, IoError> {
        let converted =
            surface.converted.as_ref().map(|material| self.converted_maps(material, buffers)).transpose()?;
        let mut read = |map: Option<TextureRef>, reader: TexelReader| match map {
            Some(map) => self.textures.get(map.texture, reader, buffers).map(Option::unzip),
            None => Ok((None, None)),
        };
        let (emissive_map, shared_emissive) = read(of.emissive_map, TexelReader::Colors)?;
        let (specular_map, shared_specular) = read(of.layers.specular_map, TexelReader::Colors)?;
        let mut get = |map| read(map, TexelReader::Values);
        let (normal_map, shared_normal) = get(of.normal)?;
        // Without its image the whole surface would glow.
        let emissive = if of.emissive_map.is_some() && emissive_map.is_none() { [0.0; 3] } else { of.emissive };
        let (metallic_map, shared_metallic) = match converted {
            Some([_, map]) => (Some(map), None),
            None => get(of.metallic_roughness)?,
        };
        let (mut occlusion_map, mut shared_occlusion) = get(of.occlusion)?;
        let occlusion_strength = if occlusion_map.is_some() { of.occlusion_strength } else { 0.0 };
        // One image for both is one map, unless their texture coordinates differ.
        let has_one_uv = of.second_uv.occlusion == of.second_uv.occlusion_roughness_metallic;
        if has_one_uv
            && let (Some(occlusion), Some(metallic)) = (&occlusion_map, &metallic_map)
            && Arc::ptr_eq(occlusion, metallic)
        {
            (occlusion_map, shared_occlusion) = (None, None);
        }
        let layers = &of.layers;
        let (coat_map, shared_coat) = get(layers.coat_map)?;
        let (coat_normal, shared_coat_normal) = get(layers.coat_normal)?;
        let model = MetallicRoughness {
            metallic: of.metallic,
            roughness: of.roughness,
            occlusion_roughness_metallic: metallic_map,
            occlusion_map,
            occlusion_strength,
            normal_map,
            normal_scale: of.normal_scale,
            emissive,
            emissive_map,
            second_uv: of.second_uv,
            dielectric: Dielectric {
                ior: layers.ior,
                specular: layers.specular,
                specular_color: layers.specular_color,
                map: specular_map,
                map_parts: layers.specular_parts,
            },
            clearcoat: Clearcoat {
                strength: layers.coat,
                roughness: layers.coat_roughness,
                map: coat_map,
                map_parts: layers.coat_parts,
                normal_map: coat_normal,
                normal_scale: layers.coat_normal_scale,
            },
            ..MetallicRoughness::default()
        };
        let shared = [
            shared_normal,
            shared_metallic,
            shared_emissive,
            shared_occlusion,
            None,
            shared_specular,
            shared_coat,
            shared_coat_normal,
        ];
        Ok((model, shared.map(Option::flatten)))
    }
}
