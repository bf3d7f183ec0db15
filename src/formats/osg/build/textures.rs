//! Textures of the images of a file: inside of it or beside it.

use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;

use super::coordinates::Coordinates;
use super::old_images::{self, OldImage};
use super::units::MAX_UNITS;
use super::{Builder, Source};
use crate::fetch::{IoError, Limits};
use crate::formats::external_files::ExternalFiles;
use crate::formats::image::{self, BlockKind, ImageUse, SharedTexture};
use crate::formats::osg::file_names::escaped;
use crate::formats::osg::objects::{
    AttributeObject, ImageData, ImageObject, NodeClass, NodeObject, Object, RawImage, StateObject, TextureObject,
    TextureTarget,
};
use crate::math::color::linear_rgba;
use crate::scene::{BlockFormats, ContentKey, Sampling, Texture};
use crate::state::{
    FilterMode, Sampler, TexEnv, TexGen, TextureBinding, TextureDimension, TextureObject as StateTexture, WrapMode,
};

const GL_CLAMP_TO_BORDER: u32 = 0x812d;
/// OpenGL's types and formats of pixels.
const GL_UNSIGNED_BYTE: u32 = 0x1401;
const GL_RGB: u32 = 0x1907;
const GL_RGBA: u32 = 0x1908;
const GL_COMPRESSED_RGB_S3TC_DXT1: u32 = 0x83f0;
const GL_COMPRESSED_RGBA_S3TC_DXT1: u32 = 0x83f1;
const GL_COMPRESSED_RGBA_S3TC_DXT3: u32 = 0x83f2;
const GL_COMPRESSED_RGBA_S3TC_DXT5: u32 = 0x83f3;

/// A texture, and the end of it that texture coordinates start at.
#[derive(Clone)]
pub(super) struct BuiltTexture {
    pub shared: SharedTexture,
    /// True if t = 0 is at the first row, as for pixels in the file, for DDS, which OSG does not turn over, and for
    /// [`old_images`].
    pub starts_at_bottom: bool,
}

/// A texture unit of the fixed function for one drawable.
pub(super) struct FixedUnit {
    pub binding: TextureBinding,
    pub environment: TexEnv,
    pub coordinates: Coordinates,
    /// Which of the mesh's coordinates the geometry's ones of the unit are; `None` for the first.
    pub own_coordinates: Option<TexGen>,
    /// True if those go down from the first row of an image.
    pub are_turned_over: bool,
    /// True if the coordinates of the texture do.
    pub is_turned_over: bool,
}

impl Builder<'_> {
    /// Returns the texture of an attribute; `None` if it has no image that can be read, which is noted.
    pub(super) fn texture(&mut self, attribute: &Arc<AttributeObject>) -> Result<Option<BuiltTexture>, IoError> {
        let AttributeObject::Texture(texture) = &**attribute else { return Ok(None) };
        let key = Arc::as_ptr(attribute).addr();
        if let Some(known) = self.textures.get(&key) {
            return Ok(known.clone());
        }
        let image = texture.all_images().next();
        let made = self.image(texture, image, self.source.options.block_formats)?;
        self.textures.insert(key, made.clone());
        Ok(made)
    }

    /// Returns the texture of an attribute for a unit of the fixed function, and true if t = 0 is at its first row.
    pub(super) fn unit_texture(
        &mut self,
        attribute: &Arc<AttributeObject>,
    ) -> Result<Option<(TextureBinding, bool)>, IoError> {
        let AttributeObject::Texture(texture) = &**attribute else { return Ok(None) };
        let key = Arc::as_ptr(attribute).addr();
        if let Some(known) = self.unit_textures.get(&key) {
            return Ok(known.clone());
        }
        if texture.target == TextureTarget::D3 {
            let volume = self.volume(texture)?;
            let binding =
                |object| TextureBinding { sampler: sampler(texture), ..TextureBinding::new(Arc::new(object)) };
            // The first row of the first slice is at t = 0.
            let made = volume.map(|object| (binding(object), true));
            self.unit_textures.insert(key, made.clone());
            return Ok(made);
        }
        // Textures of state sets are not compressed.
        let mut images = Vec::with_capacity(texture.images.len());
        for image in texture.all_images() {
            images.extend(self.image(texture, Some(image), BlockFormats::NONE)?);
        }
        let made = match texture.target {
            TextureTarget::Cube => {
                let cube = cube_of(&images);
                if cube.is_none() {
                    self.note("OpenSceneGraph: cube map without six equal images");
                }
                // The rows of faces begin where OSG's do.
                cube.map(|cube| (cube, true))
            }
            _ => images.first().map(|image| (plane_of(&image.shared.0), image.starts_at_bottom)),
        };
        let made = made.map(|(object, starts_at_bottom)| {
            let binding = TextureBinding { sampler: sampler(texture), ..TextureBinding::new(Arc::new(object)) };
            (binding, starts_at_bottom)
        });
        self.unit_textures.insert(key, made.clone());
        Ok(made)
    }

    /// Returns the volume of a texture; `None` if it cannot be read, which is noted.
    fn volume(&mut self, texture: &TextureObject) -> Result<Option<StateTexture>, IoError> {
        let Some(image) = texture.all_images().next() else { return Ok(None) };
        let ImageData::Raw(raw) = &image.data else {
            self.note("OpenSceneGraph: a volume that is not in the file");
            return Ok(None);
        };
        let Source { uri, options, .. } = self.source;
        let depth = u32::try_from(raw.size[2]).unwrap_or(0).max(1);
        let mut texels = Vec::new();
        let mut size = [0; 2];
        for slice in 0..depth {
            match slice_of(uri, raw, slice as usize, &options.limits) {
                Ok((width, height, rows)) => {
                    size = [width, height];
                    let (got, limit) =
                        ((rows.len() as u64).saturating_mul(depth.into()), options.limits.max_image_bytes);
                    if got > limit {
                        return Err(IoError::TooLarge { uri: uri.to_string(), what: "volume", got, limit });
                    }
                    texels.extend(rows);
                }
                Err(IoError::Unsupported { what, .. }) => {
                    self.note(format!("OpenSceneGraph: {what}"));
                    return Ok(None);
                }
                Err(IoError::Invalid { .. }) => {
                    self.note("OpenSceneGraph: an image that cannot be read");
                    return Ok(None);
                }
                Err(error) => return Err(error),
            }
        }
        let [width, height] = size;
        Ok(Some(StateTexture {
            dimension: TextureDimension::D3,
            size: [width, height, depth],
            ..(*StateTexture::image("OpenSceneGraph", size, texels)).clone()
        }))
    }

    /// Returns an image of a texture; `None` if it cannot be read, which is noted.
    fn image(
        &mut self,
        texture: &TextureObject,
        image: Option<&Arc<ImageObject>>,
        formats: BlockFormats,
    ) -> Result<Option<BuiltTexture>, IoError> {
        let Some(image) = image else { return Ok(None) };
        let made = match self.new_texture(texture, image, formats) {
            Ok(made) => made,
            Err(IoError::Unsupported { what, .. }) => {
                self.note(format!("OpenSceneGraph: {what}"));
                None
            }
            Err(IoError::Invalid { .. }) => {
                self.note("OpenSceneGraph: an image that cannot be read");
                None
            }
            Err(error) => return Err(error),
        };
        if let Some(texture) = &made {
            let Source { uri, options, .. } = self.source;
            self.image_bytes = self.image_bytes.saturating_add(texture.shared.0.size_bytes());
            let (got, limit) = (self.image_bytes, options.limits.max_image_bytes.saturating_mul(4));
            if got > limit {
                let what = "images of an OpenSceneGraph file";
                return Err(IoError::TooLarge { uri: uri.to_string(), what, got, limit });
            }
        }
        Ok(made)
    }

    fn new_texture(
        &self,
        texture: &TextureObject,
        object: &ImageObject,
        formats: BlockFormats,
    ) -> Result<Option<BuiltTexture>, IoError> {
        let Source { uri, base, companions, options, notes } = self.source;
        let sampling = sampling(texture);
        let decode = |uri: &str, bytes: &[u8], name: &str| {
            if let Some(image) = old_images::decode(name, bytes, &options.limits) {
                let OldImage { width, height, texels } = image?;
                let shared = (image::texture_of_rgba(width, height, texels, sampling, &options.limits), None);
                return Ok(Some(BuiltTexture { shared, starts_at_bottom: true }));
            }
            let shared = image::decode_shared(uri, bytes, ImageUse::colors(sampling, formats), options, notes)?;
            Ok(Some(BuiltTexture { shared, starts_at_bottom: image::is_dds(bytes) }))
        };
        match &object.data {
            ImageData::File(bytes) => decode(uri, bytes, &object.file_name),
            ImageData::Raw(raw) => {
                let what = [raw.size[0], raw.size[1], raw.pixel_format as i32].map(i32::to_le_bytes).concat();
                let key = ContentKey::of(&[&raw.bytes, &what, &sampling.key()]);
                let make = || {
                    let (width, height, texels) = rgba_of(uri, raw, &options.limits)?;
                    Ok(image::texture_of_rgba(width, height, texels, sampling, &options.limits))
                };
                let shared = match &options.sharing {
                    Some(sharing) => sharing.image(key, make)?,
                    None => (make()?, None),
                };
                Ok(Some(BuiltTexture { shared, starts_at_bottom: true }))
            }
            ImageData::External => {
                let files = ExternalFiles::new(base, &options.root, &options.limits, companions);
                match files.get(&escaped(&object.file_name)) {
                    Ok((uri, bytes)) => decode(&uri, &bytes, &uri),
                    Err(error) if error.is_transient() && !error.is_doubtful() => Err(error),
                    Err(error) => {
                        notes.add_missing("OpenSceneGraph: external image that is missing", &error);
                        Ok(None)
                    }
                }
            }
        }
    }
}

/// Returns the references to the external images of a file.
pub(in super::super) fn external_images(root: &Object) -> Vec<String> {
    let mut found = BTreeSet::new();
    collect(root, &mut HashSet::new(), &mut found);
    found.into_iter().collect()
}

fn collect(object: &Object, seen: &mut HashSet<usize>, found: &mut BTreeSet<String>) {
    let of_state = |state: &Option<Arc<StateObject>>, found: &mut BTreeSet<String>| {
        let attributes = state.iter().flat_map(|state| state.texture_attributes.iter().take(MAX_UNITS)).flatten();
        for (attribute, _) in attributes {
            let AttributeObject::Texture(texture) = &**attribute else { continue };
            let external = texture.all_images().filter(|image| matches!(image.data, ImageData::External));
            found.extend(external.map(|image| escaped(&image.file_name)));
        }
    };
    match object {
        Object::Node(node) if seen.insert(Arc::as_ptr(node).addr()) => {
            let NodeObject { state, children, class, .. } = &**node;
            of_state(state, found);
            if let NodeClass::TerrainTile(tile) = class {
                let images = tile.images().map(|(_, _, image)| image);
                let external = images.filter(|image| matches!(image.data, ImageData::External));
                found.extend(external.map(|image| escaped(&image.file_name)));
            }
            children.iter().for_each(|child| collect(child, seen, found));
        }
        Object::Drawable(drawable) if seen.insert(Arc::as_ptr(drawable).addr()) => {
            of_state(&drawable.state, found);
        }
        _ => {}
    }
}

/// Returns an image as a texture of a state set.
fn plane_of(image: &Texture) -> StateTexture {
    StateTexture {
        size: [image.width, image.height, 1],
        levels: image.mips.len() as u32,
        texels: image.mips.clone(),
        ..(*StateTexture::image("OpenSceneGraph", [0, 0], Vec::new())).clone()
    }
}

/// Returns six images as a cube; `None` unless they are squares of one size. OpenGL takes the rows of OSG's images from the
/// lowest on.
fn cube_of(images: &[BuiltTexture]) -> Option<StateTexture> {
    let first = &images.first().filter(|_| images.len() == 6)?.shared.0;
    let is_alike = |image: &BuiltTexture| {
        let image = &image.shared.0;
        (image.width, image.height, image.mips.len()) == (first.width, first.width, first.mips.len())
    };
    if !images.iter().all(is_alike) {
        return None;
    }
    let mut cube = plane_of(first);
    (cube.dimension, cube.size[2]) = (TextureDimension::Cube, 6);
    for (level, texels) in cube.texels.iter_mut().enumerate() {
        texels.clear();
        let row_bytes = 4 * (first.width >> level).max(1) as usize;
        for image in images {
            let rows = image.shared.0.mips[level].chunks_exact(row_bytes);
            match image.starts_at_bottom {
                true => texels.extend(rows.flatten()),
                false => texels.extend(rows.rev().flatten()),
            }
        }
    }
    Some(cube)
}

/// Returns the sampler of a unit of the fixed function.
fn sampler(texture: &TextureObject) -> Sampler {
    let Sampling { wrap, mag, min, mip } = sampling(texture);
    let mut sampler = Sampler {
        min_filter: min,
        mag_filter: mag,
        mip_filter: mip.unwrap_or(FilterMode::Nearest),
        wrap: [wrap[0], wrap[1], WrapMode::ClampToEdge],
        border_color: linear_rgba(texture.border_color),
        ..Sampler::default()
    };
    for (mode, of) in sampler.wrap.iter_mut().zip(texture.wrap) {
        if of == GL_CLAMP_TO_BORDER {
            *mode = WrapMode::ClampToBorder;
        }
    }
    sampler
}

fn sampling(texture: &TextureObject) -> Sampling {
    let wrap = texture.wrap.map(|mode| match mode {
        0x2901 => WrapMode::Repeat,
        0x8370 => WrapMode::Mirror,
        _ => WrapMode::ClampToEdge,
    });
    let (min, mip) = match texture.min_filter {
        0x2600 => (FilterMode::Nearest, None),
        0x2601 => (FilterMode::Linear, None),
        0x2700 => (FilterMode::Nearest, Some(FilterMode::Nearest)),
        0x2701 => (FilterMode::Linear, Some(FilterMode::Nearest)),
        0x2702 => (FilterMode::Nearest, Some(FilterMode::Linear)),
        _ => (FilterMode::Linear, Some(FilterMode::Linear)),
    };
    let mag = if texture.mag_filter == 0x2600 { FilterMode::Nearest } else { FilterMode::Linear };
    Sampling { wrap, mag, min, mip }
}

/// The type of a channel of pixels, in the byte order of the machines that OSG runs on.
#[derive(Clone, Copy)]
enum Channel {
    U8,
    U16,
    U32,
    F32,
}

impl Channel {
    /// Returns the type of an OpenGL number; `None` for those that are not read.
    fn of_type(data_type: u32) -> Option<Self> {
        Some(match data_type {
            GL_UNSIGNED_BYTE => Self::U8,
            0x1403 => Self::U16,
            0x1405 => Self::U32,
            0x1406 => Self::F32,
            _ => return None,
        })
    }

    fn size_bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// Returns a value as the nearest of 0 to 255. OpenGL limits floats to 0 to 1 as it displays them.
    fn level(self, bytes: &[u8]) -> u8 {
        let of_share = |share: f64| (share.clamp(0.0, 1.0) * 255.0).round() as u8;
        match (self, bytes) {
            (Self::U8, [level, ..]) => *level,
            (Self::U16, [a, b, ..]) => of_share(f64::from(u16::from_le_bytes([*a, *b])) / f64::from(u16::MAX)),
            (Self::U32, [a, b, c, d, ..]) => {
                of_share(f64::from(u32::from_le_bytes([*a, *b, *c, *d])) / f64::from(u32::MAX))
            }
            (Self::F32, [a, b, c, d, ..]) => of_share(f32::from_le_bytes([*a, *b, *c, *d]).into()),
            _ => 0,
        }
    }
}

/// Returns width, height and the RGBA8 texels of the first level of an image.
fn rgba_of(uri: &str, raw: &RawImage, limits: &Limits) -> Result<(u32, u32, Vec<u8>), IoError> {
    match raw.size[2] > 1 {
        true => Err(IoError::unsupported(uri, "image with several layers")),
        false => slice_of(uri, raw, 0, limits),
    }
}

/// Returns width, height and the RGBA8 texels of a slice of an image.
fn slice_of(uri: &str, raw: &RawImage, slice: usize, limits: &Limits) -> Result<(u32, u32, Vec<u8>), IoError> {
    let bad = |reason: String| IoError::invalid(uri, format!("OpenSceneGraph file: image: {reason}"));
    let [width, height, depth] = raw.size;
    let (Ok(width), Ok(height)) = (u32::try_from(width), u32::try_from(height)) else {
        return Err(bad(format!("{width} x {height} pixels")));
    };
    image::check_size(uri, width, height, limits)?;
    let blocks = match raw.pixel_format {
        GL_COMPRESSED_RGB_S3TC_DXT1 => Some(BlockKind::Bc1 { has_alpha: false }),
        GL_COMPRESSED_RGBA_S3TC_DXT1 => Some(BlockKind::Bc1 { has_alpha: true }),
        GL_COMPRESSED_RGBA_S3TC_DXT3 => Some(BlockKind::Bc2),
        GL_COMPRESSED_RGBA_S3TC_DXT5 => Some(BlockKind::Bc3),
        _ => None,
    };
    if let Some(kind) = blocks {
        if depth > 1 {
            return Err(IoError::unsupported(uri, "volume of compressed blocks"));
        }
        let texels = image::decode_blocks(kind, width, height, &raw.bytes);
        return Ok((width, height, texels.ok_or_else(|| bad("too few blocks".to_owned()))?));
    }
    /// Indices that stand for the values 1 and 0, instead of a channel of a pixel.
    const ONE: usize = 4;
    const ZERO: usize = 5;
    let (channels, order) = match raw.pixel_format {
        GL_RGB => (3, [0, 1, 2, ONE]),
        GL_RGBA => (4, [0, 1, 2, 3]),
        0x80e0 => (3, [2, 1, 0, ONE]),
        0x80e1 => (4, [2, 1, 0, 3]),
        0x1909 => (1, [0, 0, 0, ONE]),
        0x190a => (2, [0, 0, 0, 1]),
        0x8049 => (1, [0, 0, 0, 0]),
        0x1906 => (1, [ONE, ONE, ONE, 0]),
        0x1903 => (1, [0, ZERO, ZERO, ONE]),
        0x8227 => (2, [0, 1, ZERO, ONE]),
        format => return Err(IoError::unsupported(uri, format!("image of pixel format 0x{format:x}"))),
    };
    let Some(channel) = Channel::of_type(raw.data_type) else {
        return Err(IoError::unsupported(uri, format!("image of data type 0x{:x}", raw.data_type)));
    };
    let pixel_bytes = channels * channel.size_bytes();
    let row = (width as usize * pixel_bytes).next_multiple_of(raw.packing.max(1) as usize);
    let needed = row * (height as usize - 1) + width as usize * pixel_bytes;
    let bytes = (row * height as usize).checked_mul(slice).and_then(|start| raw.bytes.get(start..)).unwrap_or(&[]);
    if bytes.len() < needed {
        return Err(bad(format!("{} bytes of {needed}", bytes.len())));
    }
    let mut texels: Vec<[u8; 4]> = Vec::with_capacity(width as usize * height as usize);
    for y in 0..height as usize {
        let pixels = &bytes[y * row..y * row + width as usize * pixel_bytes];
        match (channel, raw.pixel_format) {
            (Channel::U8, GL_RGB) => texels.extend(pixels.as_chunks().0.iter().map(|[r, g, b]| [*r, *g, *b, 255])),
            (Channel::U8, GL_RGBA) => texels.extend(pixels.as_chunks::<4>().0),
            // A loop over the channels, since `map` of arrays is a call for each.
            _ => texels.extend(pixels.chunks_exact(pixel_bytes).map(|pixel| {
                let mut texel = [255; 4];
                for (to, from) in texel.iter_mut().zip(order) {
                    match from {
                        ONE => {}
                        ZERO => *to = 0,
                        from => *to = channel.level(&pixel[from * channel.size_bytes()..]),
                    }
                }
                texel
            })),
        }
    }
    Ok((width, height, texels.into_flattened()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(size: [i32; 3], pixel_format: u32, packing: u32, bytes: &[u8]) -> RawImage {
        RawImage { size, pixel_format, data_type: GL_UNSIGNED_BYTE, packing, bytes: bytes.to_vec() }
    }

    fn limits() -> Limits {
        Limits { max_image_bytes: 100, ..Limits::default() }
    }

    #[test]
    fn pixels_of_every_format_become_rgba() {
        let texels = |format, bytes: &[u8]| rgba_of("t", &raw([1, 1, 1], format, 1, bytes), &limits()).unwrap().2;
        assert_eq!(texels(0x1907, &[1, 2, 3]), [1, 2, 3, 255]);
        assert_eq!(texels(0x80e1, &[1, 2, 3, 4]), [3, 2, 1, 4]);
        assert_eq!(texels(0x190a, &[7, 8]), [7, 7, 7, 8]);
        assert_eq!(texels(0x1906, &[9]), [255, 255, 255, 9]);
        assert_eq!(texels(0x1903, &[9]), [9, 0, 0, 255]);
    }

    #[test]
    fn wide_channels_become_bytes() {
        let texels = |data_type, format, bytes: &[u8]| {
            let image = RawImage { data_type, ..raw([1, 1, 1], format, 1, bytes) };
            rgba_of("t", &image, &limits()).map(|(.., texels)| texels)
        };
        let float = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        assert_eq!(texels(0x1406, 0x1907, &float(&[0.5, 2.0, -1.0])).unwrap(), [128, 255, 0, 255]);
        assert_eq!(texels(0x1406, 0x1907, &float(&[f32::NAN, 0.0, 1.0])).unwrap(), [0, 0, 255, 255]);
        assert_eq!(texels(0x1403, 0x190a, &[0xff, 0xff, 0x00, 0x80]).unwrap(), [255, 255, 255, 128]);
        assert_eq!(texels(0x1405, 0x1909, &[0, 0, 0, 0x40]).unwrap(), [64, 64, 64, 255]);
        assert!(texels(0x1406, 0x1907, &float(&[0.5, 2.0])).is_err(), "too short");
        assert!(texels(0x8363, 0x1907, &[0, 0]).is_err(), "packed");
    }

    #[test]
    fn volumes_have_slices() {
        let volume = raw([1, 1, 2], 0x1907, 1, &[1, 2, 3, 4, 5, 6]);
        assert_eq!(slice_of("t", &volume, 1, &limits()).unwrap().2, [4, 5, 6, 255]);
        assert!(slice_of("t", &volume, 2, &limits()).is_err(), "too short");
        assert!(rgba_of("t", &volume, &limits()).is_err(), "no image");
    }

    #[test]
    fn rows_are_aligned_and_short_images_are_refused() {
        let two_rows = [1, 2, 3, 0, 4, 5, 6];
        let (width, height, texels) = rgba_of("t", &raw([1, 2, 1], 0x1907, 4, &two_rows), &limits()).unwrap();
        assert_eq!((width, height, &texels[4..7]), (1, 2, &[4, 5, 6][..]));
        for bad in [
            raw([1, 2, 1], 0x1907, 4, &two_rows[..6]),
            raw([-1, 2, 1], 0x1907, 4, &two_rows),
            raw([0, 2, 1], 0x1907, 4, &two_rows),
            raw([4, 4, 1], GL_COMPRESSED_RGBA_S3TC_DXT5, 1, &[0; 15]),
            raw([1000, 1000, 1], 0x1907, 1, &two_rows),
        ] {
            assert!(rgba_of("t", &bad, &limits()).is_err(), "{bad:?}");
        }
    }
}
