//! [`Textures`]: the decoded images of a glTF.

use std::collections::HashMap;

use gltf::json;

use crate::fetch::IoError;
use crate::formats::gltf::accessors::Buffers;
use crate::formats::gltf::context::Context;
use crate::formats::gltf::external::data_uri;
use crate::formats::image::{SharedTexture, decode_shared};
use crate::state::WrapMode;

/// Extensions that name another image of a texture, the best first. The plain source comes after them.
const SOURCE_EXTENSIONS: [&str; 2] = ["KHR_texture_basisu", "EXT_texture_webp"];

/// The textures decoded so far. Primitives share them.
pub(super) struct Textures<'a> {
    context: &'a Context<'a>,
    document: &'a gltf::Document,
    /// By the index of the image and the wrap modes; `None` if the image is missing.
    decoded: HashMap<(usize, [WrapMode; 2]), Option<SharedTexture>>,
}

impl<'a> Textures<'a> {
    pub fn new(context: &'a Context<'a>, document: &'a gltf::Document) -> Self {
        Self { context, document, decoded: HashMap::new() }
    }

    /// Returns a texture; decodes its image on first use. Returns `None` if the texture has no image that can be decoded.
    pub fn get(&mut self, texture: usize, buffers: &Buffers<'_>) -> Result<Option<SharedTexture>, IoError> {
        let Some(texture) = self.document.textures().nth(texture) else {
            return Err(self.context.bad(format_args!("texture {texture} of {}", self.document.textures().len())));
        };
        let wrap = self.wrap(&texture.sampler());
        let images = self.document.as_json().images.len();
        let named = SOURCE_EXTENSIONS.iter().filter_map(|name| texture.extension_value(name)?.get("source")?.as_u64());
        let named = named.filter_map(|source| usize::try_from(source).ok());
        let sources: Vec<usize> = named.chain(texture.source().map(|image| image.index())).collect();
        if let Some(source) = sources.iter().find(|source| **source >= images) {
            return Err(self.context.bad(format_args!("image {source} of {images}")));
        }
        for source in sources {
            let key = (source, wrap);
            let found = match self.decoded.get(&key) {
                Some(known) => known.clone(),
                None => {
                    let decoded = self.decode(source, wrap, buffers)?;
                    self.decoded.insert(key, decoded.clone());
                    decoded
                }
            };
            if found.is_some() {
                return Ok(found);
            }
        }
        Ok(None)
    }

    /// Returns the wrap modes of a sampler.
    fn wrap(&self, sampler: &gltf::texture::Sampler<'_>) -> [WrapMode; 2] {
        use gltf::texture::MagFilter;
        use gltf::texture::WrappingMode::{ClampToEdge, MirroredRepeat, Repeat};
        if sampler.mag_filter() == Some(MagFilter::Nearest) {
            self.context.notes.add("glTF sampler: magFilter NEAREST (drawn with linear filtering)");
        }
        [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
            ClampToEdge => WrapMode::ClampToEdge,
            MirroredRepeat => WrapMode::Mirror,
            Repeat => WrapMode::Repeat,
        })
    }

    /// Decodes an image. Returns `None` if its file is missing or has a format that is not read.
    fn decode(
        &self,
        image: usize,
        wrap: [WrapMode; 2],
        buffers: &Buffers<'_>,
    ) -> Result<Option<SharedTexture>, IoError> {
        self.context.budget.check_images()?;
        let json::Image { buffer_view, uri, .. } = &self.document.as_json().images[image];
        let view = buffer_view.and_then(|view| self.document.views().nth(view.value()));
        let decoded = match (view, uri) {
            (Some(view), _) => {
                let Some(bytes) = buffers.view(&view)? else { return Ok(None) };
                self.decode_bytes(self.context.uri, bytes, wrap)
            }
            (None, Some(reference)) => match data_uri(self.context.uri, reference) {
                Some(bytes) => self.decode_bytes(self.context.uri, &bytes?, wrap),
                None => match self.context.files.get(reference) {
                    Ok((uri, bytes)) => self.decode_bytes(&uri, &bytes, wrap),
                    Err(error) => {
                        self.context.missing("glTF: external image that is missing", &error)?;
                        return Ok(None);
                    }
                },
            },
            (None, None) => Err(self.context.bad(format_args!("image {image} has no source"))),
        };
        match decoded {
            Ok(texture) => {
                self.context.budget.add_image(texture.0.mips.iter().map(|mip| mip.len() as u64).sum());
                Ok(Some(texture))
            }
            Err(IoError::Unsupported { what, .. }) => {
                self.context.notes.add(format!("glTF: {what}"));
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    fn decode_bytes(&self, uri: &str, bytes: &[u8], wrap: [WrapMode; 2]) -> Result<SharedTexture, IoError> {
        let options = self.context.options;
        decode_shared(uri, bytes, wrap, &options.limits, options.sharing.as_deref())
    }
}
