//! [`Surfaces`]: the materials of a glTF with their decoded textures.

use std::collections::HashMap;

use super::surface::Surface;
use super::techniques::Techniques;
use super::textures::Textures;
use crate::fetch::IoError;
use crate::formats::gltf::accessors::Buffers;
use crate::formats::gltf::context::Context;
use crate::formats::image::SharedTexture;

/// The materials read so far. Primitives share them.
pub(in super::super) struct Surfaces<'a> {
    context: &'a Context<'a>,
    techniques: Techniques,
    textures: Textures<'a>,
    /// By the index of the material; `None` is the default material.
    read: HashMap<Option<usize>, Surface>,
}

impl<'a> Surfaces<'a> {
    pub fn new(context: &'a Context<'a>, document: &'a gltf::Document) -> Self {
        let techniques = Techniques::new(document);
        Self { context, techniques, textures: Textures::new(context, document), read: HashMap::new() }
    }

    /// Returns a material, without its texture.
    pub fn get(&mut self, material: &gltf::Material<'_>) -> Surface {
        let read = || Surface::new(material, &self.techniques, self.context.notes);
        *self.read.entry(material.index()).or_insert_with(read)
    }

    /// Returns the decoded texture of a surface; `None` if it has none or if its image is missing.
    pub fn texture(&mut self, surface: &Surface, buffers: &Buffers<'_>) -> Result<Option<SharedTexture>, IoError> {
        match surface.texture {
            Some(of) => self.textures.get(of.texture, buffers),
            None => Ok(None),
        }
    }
}
