//! [`Textures`]: the decoded images of a glTF.

use std::collections::HashMap;
use std::sync::Arc;

use gltf::json;

use crate::fetch::{IoError, Limits};
use crate::formats::gltf::accessors::Buffers;
use crate::formats::gltf::context::Context;
use crate::formats::gltf::external::data_uri;
use crate::formats::image::{ImageUse, MipFilter, SharedTexture, decode_shared};
use crate::formats::options::ReadOptions;
use crate::scene::{BlockFormats, Sampling, Texture};
use crate::state::{FilterMode, WrapMode};

/// Extensions that name another image of a texture, the best first. The plain source comes after them.
const SOURCE_EXTENSIONS: [&str; 3] = ["KHR_texture_basisu", "EXT_texture_webp", "MSFT_texture_dds"];

/// The textures decoded so far. Primitives share them.
pub(super) struct Textures<'a> {
    context: &'a Context<'a>,
    document: &'a gltf::Document,
    /// `None` if the image is missing.
    decoded: HashMap<ImageKey, Option<SharedTexture>>,
}

/// An image as it is used.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
struct ImageKey {
    /// The index of the image.
    image: usize,
    sampling: Sampling,
    reader: TexelReader,
}

/// The reader of an image's texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum TexelReader {
    /// The adapter, which samples compressed formats of sRGB colours.
    Colors,
    /// The adapter, which samples compressed formats of linear values, such as normals.
    Values,
    /// The CPU, which converts RGBA8.
    Cpu,
    /// The CPU, which reads ids or values from the texels of level 0.
    Data,
}

impl<'a> Textures<'a> {
    pub fn new(context: &'a Context<'a>, document: &'a gltf::Document) -> Self {
        Self { context, document, decoded: HashMap::new() }
    }

    /// Returns a texture; decodes its image on first use. Returns `None` if the texture has no image that can be decoded.
    pub fn get(
        &mut self,
        texture: usize,
        reader: TexelReader,
        buffers: &Buffers<'_>,
    ) -> Result<Option<SharedTexture>, IoError> {
        let (sources, mut sampling) = self.sources(texture);
        if reader == TexelReader::Data {
            // No filter may change a texel.
            sampling = Sampling { wrap: sampling.wrap, mag: FilterMode::Nearest, min: FilterMode::Nearest, mip: None };
        }
        for image in sources {
            let key = ImageKey { image, sampling, reader };
            let found = match self.decoded.get(&key) {
                Some(known) => known.clone(),
                None => {
                    let decoded = self.decode(&key, buffers)?;
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

    /// Returns an image that holds ids or values; `None` if it is missing or invalid, which is noted: the mesh is drawn without
    /// them.
    pub fn data_image(&mut self, texture: usize, buffers: &Buffers<'_>) -> Result<Option<Arc<Texture>>, IoError> {
        match self.get(texture, TexelReader::Data, buffers) {
            Ok(found) => Ok(found.map(|(image, _)| image)),
            Err(error @ IoError::TooLarge { .. }) => Err(error),
            Err(error) => {
                self.context.missing("glTF: an image of ids or properties that cannot be read", &error).map(|()| None)
            }
        }
    }

    /// Returns the images of a texture, the best first, and its sampling. Notes a texture or an image that does not exist.
    fn sources(&self, texture: usize) -> (Vec<usize>, Sampling) {
        let Some(texture) = self.document.textures().nth(texture) else {
            self.context.notes.add("glTF material: texture that does not exist");
            return (Vec::new(), Sampling::default());
        };
        let images = self.document.as_json().images.len();
        let named = SOURCE_EXTENSIONS.iter().filter_map(|name| texture.extension_value(name)?.get("source")?.as_u64());
        let named = named.map(|source| usize::try_from(source).unwrap_or(usize::MAX));
        let mut sources: Vec<usize> = named.chain(texture.source().map(|image| image.index())).collect();
        sources.retain(|source| {
            let is_valid = *source < images;
            if !is_valid {
                self.context.notes.add("glTF: image that does not exist or is invalid");
            }
            is_valid
        });
        (sources, sampling(&texture.sampler()))
    }

    /// Decodes an image. Returns `None` if its file is missing or has a format that is not read.
    fn decode(&self, key: &ImageKey, buffers: &Buffers<'_>) -> Result<Option<SharedTexture>, IoError> {
        let image = key.image;
        self.context.budget.check_images()?;
        let json::Image { buffer_view, uri, .. } = &self.document.as_json().images[image];
        let view = buffer_view.and_then(|view| self.document.views().nth(view.value()));
        let decoded = match (view, uri) {
            (Some(view), _) => {
                let Some(bytes) = buffers.view(&view)? else { return Ok(None) };
                self.decode_bytes(self.context.uri, bytes, key)
            }
            (None, Some(reference)) => match data_uri(self.context.uri, reference) {
                Some(bytes) => bytes.and_then(|bytes| self.decode_bytes(self.context.uri, &bytes, key)),
                None => match self.context.files.get(reference) {
                    Ok((uri, bytes)) => self.decode_bytes(&uri, &bytes, key),
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
                self.context.budget.add_image(texture.0.size_bytes());
                Ok(Some(texture))
            }
            Err(IoError::Unsupported { what, .. }) => {
                self.context.notes.add(format!("glTF: {what}"));
                Ok(None)
            }
            // The mesh is drawn without it, as without a file that is missing.
            Err(IoError::Invalid { .. }) if key.reader != TexelReader::Data => {
                self.context.notes.add("glTF: image that cannot be read");
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    fn decode_bytes(&self, uri: &str, bytes: &[u8], key: &ImageKey) -> Result<SharedTexture, IoError> {
        let Context { options, notes, .. } = self.context;
        let of = |formats| ImageUse::colors(key.sampling, formats);
        match key.reader {
            TexelReader::Colors => decode_shared(uri, bytes, of(options.block_formats), options, notes),
            TexelReader::Values => {
                let of = ImageUse { filter: MipFilter::Linear, ..of(options.block_formats) };
                decode_shared(uri, bytes, of, options, notes)
            }
            TexelReader::Cpu => decode_shared(uri, bytes, of(BlockFormats::NONE), options, notes),
            TexelReader::Data => {
                // A smaller image would have means of ids.
                let limits = Limits { max_image_side_px: u32::MAX, ..options.limits };
                let options = ReadOptions { limits, sharing: None, ..(*options).clone() };
                decode_shared(uri, bytes, of(BlockFormats::NONE), &options, notes)
            }
        }
    }
}

/// Returns the filters and wrap modes of a sampler. Filters that it leaves open are linear, between levels too.
fn sampling(sampler: &gltf::texture::Sampler<'_>) -> Sampling {
    use gltf::texture::MinFilter::{
        Linear, LinearMipmapLinear, LinearMipmapNearest, Nearest, NearestMipmapLinear, NearestMipmapNearest,
    };
    use gltf::texture::{MagFilter, WrappingMode};
    let (min, mip) = match sampler.min_filter() {
        Some(Nearest) => (FilterMode::Nearest, None),
        Some(Linear) => (FilterMode::Linear, None),
        Some(NearestMipmapNearest) => (FilterMode::Nearest, Some(FilterMode::Nearest)),
        Some(LinearMipmapNearest) => (FilterMode::Linear, Some(FilterMode::Nearest)),
        Some(NearestMipmapLinear) => (FilterMode::Nearest, Some(FilterMode::Linear)),
        Some(LinearMipmapLinear) | None => (FilterMode::Linear, Some(FilterMode::Linear)),
    };
    let mag = match sampler.mag_filter() {
        Some(MagFilter::Nearest) => FilterMode::Nearest,
        Some(MagFilter::Linear) | None => FilterMode::Linear,
    };
    let wrap = [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
        WrappingMode::ClampToEdge => WrapMode::ClampToEdge,
        WrappingMode::MirroredRepeat => WrapMode::Mirror,
        WrappingMode::Repeat => WrapMode::Repeat,
    });
    Sampling { wrap, mag, min, mip }
}
