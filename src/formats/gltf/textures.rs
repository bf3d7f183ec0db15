//! [`Textures`]: the decoded images of a glTF.

use std::collections::HashMap;

use super::budget::Budget;
use super::buffers::{Buffers, data_uri};
use crate::fetch::{IoError, Limits};
use crate::formats::image::{SharedTexture, decode_shared};
use crate::scene::SharedStateManager;
use crate::state::WrapMode;

/// The textures decoded so far. Primitives share them.
pub(super) struct Textures<'a> {
    uri: &'a str,
    limits: &'a Limits,
    sharing: Option<&'a SharedStateManager>,
    /// By the index of the image and the wrap modes.
    decoded: HashMap<(usize, [WrapMode; 2]), SharedTexture>,
}

impl<'a> Textures<'a> {
    pub fn new(uri: &'a str, limits: &'a Limits, sharing: Option<&'a SharedStateManager>) -> Self {
        Self { uri, limits, sharing, decoded: HashMap::new() }
    }

    /// Returns a texture; decodes its image on first use.
    pub fn get(
        &mut self,
        texture: &gltf::Texture<'_>,
        buffers: &Buffers<'_>,
        budget: &mut Budget<'_>,
    ) -> Result<SharedTexture, IoError> {
        use gltf::texture::WrappingMode::{ClampToEdge, MirroredRepeat, Repeat};
        let sampler = texture.sampler();
        let wrap = [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
            ClampToEdge => WrapMode::ClampToEdge,
            MirroredRepeat => WrapMode::Mirror,
            Repeat => WrapMode::Repeat,
        });
        let source = texture.source();
        let key = (source.index(), wrap);
        if let Some(known) = self.decoded.get(&key) {
            return Ok(known.clone());
        }
        budget.check_images()?;
        let decode = |bytes: &[u8]| decode_shared(self.uri, bytes, wrap, self.limits, self.sharing);
        let decoded = match source.source() {
            gltf::image::Source::View { view, .. } => decode(buffers.view(&view)?)?,
            gltf::image::Source::Uri { uri, .. } => decode(&data_uri(self.uri, uri)?)?,
        };
        budget.add_image(decoded.0.mips.iter().map(|mip| mip.len() as u64).sum());
        self.decoded.insert(key, decoded.clone());
        Ok(decoded)
    }
}
