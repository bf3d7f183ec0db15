//! [`Images`]: the images, samplers and textures of a glb. Files are kept as they are; other texels are encoded. Any thread.

use std::collections::HashMap;
use std::io::Cursor;
use std::sync::Arc;

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use serde_json::{Value, json};

use crate::formats::image::ImageFiles;
use crate::formats::writers::buffers::Buffers;
use crate::scene::{Sampling, TexelFormat, Texture};
use crate::state::{FilterMode, WrapMode};

/// The quality of JPEG files of texels that came from no file, 1 to 100.
const JPEG_QUALITY: u8 = 90;

/// The meaning of the texels of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Texels {
    /// Colours, which JPEG may blur.
    Color,
    /// Values, which stay as they are.
    Values,
}

/// The images of one glb. One thread.
#[derive(Default)]
pub(super) struct Images {
    files: ImageFiles,
    images: Vec<Value>,
    samplers: Vec<Value>,
    textures: Vec<Value>,
    /// The indices of textures by the address of theirs.
    known: HashMap<usize, usize>,
    /// The files in the glb, with the indices of their images.
    written: Vec<(Arc<[u8]>, usize)>,
    known_samplers: HashMap<Sampling, usize>,
    /// The extensions that textures need.
    pub extensions: Vec<&'static str>,
    /// The number of images that were encoded.
    pub encoded: u64,
}

impl Images {
    pub fn new(files: ImageFiles) -> Self {
        Self { files, ..Self::default() }
    }

    /// Returns the index of a texture. The error says why its texels cannot be encoded.
    pub fn texture(&mut self, texture: &Arc<Texture>, texels: Texels, buffers: &mut Buffers) -> Result<usize, String> {
        let key = Arc::as_ptr(texture).addr();
        if let Some(known) = self.known.get(&key) {
            return Ok(*known);
        }
        let file = self.files.file_of(texture).filter(|file| mime_type(file).is_some());
        let file = match file {
            Some(file) => file,
            None => {
                self.encoded += 1;
                encoded(texture, texels)?.into()
            }
        };
        let same = |(other, _): &&(Arc<[u8]>, usize)| other.len() == file.len() && **other == *file;
        let source = match self.written.iter().find(same) {
            Some((_, image)) => *image,
            None => {
                let view = buffers.view(&file);
                self.images.push(json!({ "bufferView": view, "mimeType": mime_type(&file) }));
                self.written.push((file.clone(), self.images.len() - 1));
                self.images.len() - 1
            }
        };
        let sampler = *self.known_samplers.entry(texture.sampling).or_insert_with(|| {
            self.samplers.push(sampler(&texture.sampling));
            self.samplers.len() - 1
        });
        let extension = match mime_type(&file) {
            Some("image/ktx2") => Some("KHR_texture_basisu"),
            Some("image/webp") => Some("EXT_texture_webp"),
            _ => None,
        };
        let written = match extension {
            Some(name) => json!({ "sampler": sampler, "extensions": { name: { "source": source } } }),
            None => json!({ "sampler": sampler, "source": source }),
        };
        self.extensions.extend(extension.filter(|name| !self.extensions.contains(name)));
        // An image that is read as colours and as values is two textures here, and one in the file.
        let index = self.textures.iter().position(|known| *known == written).unwrap_or_else(|| {
            self.textures.push(written);
            self.textures.len() - 1
        });
        self.known.insert(key, index);
        Ok(index)
    }

    /// Adds the lists to a document.
    pub fn add_to(self, document: &mut Value) {
        for (name, list) in [("images", self.images), ("samplers", self.samplers), ("textures", self.textures)] {
            if !list.is_empty() {
                document[name] = list.into();
            }
        }
    }
}

/// Returns the MIME type of a file that glTF can hold; `None` for other files.
fn mime_type(file: &[u8]) -> Option<&'static str> {
    if file.starts_with(b"\x89PNG") {
        Some("image/png")
    } else if file.starts_with(&[0xff, 0xd8, 0xff]) {
        Some("image/jpeg")
    } else if file.starts_with(b"RIFF") && file.get(8..12) == Some(b"WEBP") {
        Some("image/webp")
    } else if file.starts_with(b"\xabKTX 20") {
        Some("image/ktx2")
    } else {
        None
    }
}

/// Returns a JPEG of colours without alpha, and a PNG of other texels.
fn encoded(texture: &Texture, texels: Texels) -> Result<Vec<u8>, String> {
    let Texture { width, height, format, mips, .. } = texture;
    let rgba = mips.first().map(Vec::as_slice).unwrap_or_default();
    if *format != TexelFormat::Rgba8 || rgba.len() as u64 != u64::from(*width) * u64::from(*height) * 4 {
        return Err(format!("a texture of {width} x {height} texels in the format {format:?} cannot be encoded"));
    }
    let has_alpha = rgba.chunks_exact(4).any(|texel| texel[3] != 255);
    let mut out = Cursor::new(Vec::new());
    let written = if has_alpha {
        PngEncoder::new(&mut out).write_image(rgba, *width, *height, ExtendedColorType::Rgba8)
    } else {
        let rgb: Vec<u8> = rgba.chunks_exact(4).flat_map(|texel| [texel[0], texel[1], texel[2]]).collect();
        match texels {
            Texels::Color => JpegEncoder::new_with_quality(&mut out, JPEG_QUALITY).write_image(
                &rgb,
                *width,
                *height,
                ExtendedColorType::Rgb8,
            ),
            Texels::Values => PngEncoder::new(&mut out).write_image(&rgb, *width, *height, ExtendedColorType::Rgb8),
        }
    };
    written.map_err(|error| format!("a texture of {width} x {height} texels: {error}"))?;
    Ok(out.into_inner())
}

/// Returns the sampler with glTF's numbers, which are those of OpenGL.
fn sampler(sampling: &Sampling) -> Value {
    let Sampling { wrap, mag, min, mip } = sampling;
    let is_linear = |filter: FilterMode| filter == FilterMode::Linear;
    let min = match (is_linear(*min), mip.map(is_linear)) {
        (false, None) => 9728,
        (true, None) => 9729,
        (false, Some(false)) => 9984,
        (true, Some(false)) => 9985,
        (false, Some(true)) => 9986,
        (true, Some(true)) => 9987,
    };
    let [wrap_s, wrap_t] = wrap.map(|mode| match mode {
        WrapMode::Repeat => 10497,
        WrapMode::Mirror => 33648,
        WrapMode::ClampToEdge | WrapMode::ClampToBorder => 33071,
    });
    json!({
        "magFilter": if is_linear(*mag) { 9729 } else { 9728 }, "minFilter": min, "wrapS": wrap_s, "wrapT": wrap_t,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opaque_colours_become_jpeg_and_other_texels_png() {
        let texture = |alpha: u8| Texture::rgba8(1, 2, vec![vec![10, 20, 30, 255, 40, 50, 60, alpha]]);
        let type_of = |alpha, texels| mime_type(&encoded(&texture(alpha), texels).unwrap()).unwrap();
        assert_eq!(type_of(255, Texels::Color), "image/jpeg");
        assert_eq!(type_of(255, Texels::Values), "image/png");
        assert_eq!(type_of(7, Texels::Color), "image/png");
        let short = Texture::rgba8(2, 2, vec![vec![0; 15]]);
        assert!(encoded(&short, Texels::Color).unwrap_err().contains("2 x 2"));
    }
}
