//! [`Surfaces`]: the materials of a glTF with their decoded textures.

use std::collections::HashMap;
use std::sync::Arc;

use super::reflection::{Reflection, combined};
use super::specular_glossiness::{self, SpecularGlossiness};
use super::surface::Surface;
use super::techniques::Techniques;
use super::texture_ref::TextureRef;
use super::textures::{TexelReader, Textures};
use crate::fetch::IoError;
use crate::formats::gltf::accessors::Buffers;
use crate::formats::gltf::context::Context;
use crate::formats::image::SharedTexture;
use crate::scene::{MetallicRoughness, SharedContent, Texture};

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
    /// Maps combined from occlusion and from metallic and roughness, by the addresses of both, which are kept.
    combined: HashMap<(usize, Option<usize>), Option<Arc<Texture>>>,
    /// Base colour, and metallic and roughness, of materials that were converted.
    converted: HashMap<specular_glossiness::Key, [Arc<Texture>; 2]>,
}

impl<'a> Surfaces<'a> {
    pub fn new(context: &'a Context<'a>, document: &'a gltf::Document) -> Self {
        let techniques = Techniques::new(document);
        let textures = Textures::new(context, document);
        Self {
            context,
            techniques,
            textures,
            read: HashMap::new(),
            combined: HashMap::new(),
            converted: HashMap::new(),
        }
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
            Some(of) => self.textures.get(of.texture, TexelReader::Adapter, buffers),
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
        // Occlusion in a separate image is combined with the other map.
        let is_combined = match (&of.occlusion, &of.metallic_roughness) {
            (Some(occlusion), Some(other)) => !self.textures.are_equal(occlusion.texture, other.texture)?,
            (occlusion, _) => occlusion.is_some(),
        };
        let reader = if is_combined { TexelReader::Cpu } else { TexelReader::Adapter };
        let mut get = |map: Option<TextureRef>, reader| match map {
            Some(map) => self.textures.get(map.texture, reader, buffers).map(Option::unzip),
            None => Ok((None, None)),
        };
        let (normal_map, shared_normal) = get(of.normal, TexelReader::Adapter)?;
        let (emissive_map, shared_emissive) = get(of.emissive_map, TexelReader::Adapter)?;
        // Without its image the whole surface would glow.
        let emissive = if of.emissive_map.is_some() && emissive_map.is_none() { [0.0; 3] } else { of.emissive };
        let (mut map, mut shared_map) = get(of.metallic_roughness, reader)?;
        if let Some([_, metallic_roughness]) = converted {
            map = Some(metallic_roughness);
        }
        let mut occlusion_strength = of.occlusion_strength;
        if let Some(occlusion) = of.occlusion {
            let (image, _) = get(Some(occlusion), reader)?;
            let address = |of: &Arc<Texture>| Arc::as_ptr(of).addr();
            let joined = image.as_ref().and_then(|image| {
                let key = (address(image), map.as_ref().map(address));
                self.combined.entry(key).or_insert_with(|| combined(image, map.as_ref())).clone()
            });
            match joined {
                Some(joined) if map.as_ref().is_some_and(|map| Arc::ptr_eq(map, &joined)) => {}
                Some(joined) => {
                    self.context.budget.add_image(joined.size_bytes());
                    (map, shared_map) = (Some(joined), None);
                }
                None => {
                    if image.is_some() {
                        let kind =
                            "glTF material: occlusion texture of another size than that of metallic and roughness";
                        self.context.notes.add(kind);
                    }
                    occlusion_strength = 0.0;
                }
            }
        }
        let model = MetallicRoughness {
            metallic: of.metallic,
            roughness: of.roughness,
            occlusion_roughness_metallic: map,
            occlusion_strength,
            normal_map,
            normal_scale: of.normal_scale,
            emissive,
            emissive_map,
        };
        Ok((model, [shared_normal.flatten(), shared_map.flatten(), shared_emissive.flatten()]))
    }
}
