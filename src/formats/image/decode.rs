//! Decodes image files to textures: RGBA8 or, for KTX2, a compressed format. Sizes are checked before any pixel is decoded.

use std::io::Cursor;
use std::sync::Arc;

use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits as ImageLimits};

use super::dds;
use super::ktx2::{self, Levels};
use super::mips::{MipFilter, mips};
use super::rgba::decode_rgb;
use super::size::{check_area, check_size};
use super::transcode::MAGIC as KTX2_MAGIC;
use crate::fetch::markup::refuse_markup;
use crate::fetch::{IoError, Limits, about_to_allocate, guarded};
use crate::formats::ignored::Notes;
use crate::formats::options::ReadOptions;
use crate::scene::{BlockFormats, ContentKey, Sampling, SharedContent, TexelFormat, Texture};

/// Formats of image files, recognized by their magic bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FileFormat {
    Raster(ImageFormat),
    Ktx2,
    Dds,
}

impl FileFormat {
    fn of(bytes: &[u8]) -> Option<Self> {
        if bytes.starts_with(b"\x89PNG") {
            Some(Self::Raster(ImageFormat::Png))
        } else if bytes.starts_with(&[0xff, 0xd8, 0xff]) {
            Some(Self::Raster(ImageFormat::Jpeg))
        } else if bytes.starts_with(b"RIFF") && bytes.get(8..12) == Some(b"WEBP") {
            Some(Self::Raster(ImageFormat::WebP))
        } else if bytes.starts_with(b"GIF8") {
            Some(Self::Raster(ImageFormat::Gif))
        } else if bytes.starts_with(b"BM") && bytes.get(6..10) == Some(&[0; 4]) {
            Some(Self::Raster(ImageFormat::Bmp))
        } else if bytes.starts_with(b"II*\0") || bytes.starts_with(b"MM\0*") {
            Some(Self::Raster(ImageFormat::Tiff))
        } else if bytes.starts_with(KTX2_MAGIC) {
            Some(Self::Ktx2)
        } else if dds::is_dds(bytes) {
            Some(Self::Dds)
        } else {
            None
        }
    }
}

/// Returns true for the magic bytes of an image that is read.
pub(in crate::formats) fn is_image(bytes: &[u8]) -> bool {
    FileFormat::of(bytes).is_some()
}

/// Returns width and height of an image in pixels, without decoding it.
pub(in crate::formats) fn size_of(uri: &str, bytes: &[u8], limits: &Limits) -> Result<[u32; 2], IoError> {
    let Some(FileFormat::Raster(format)) = FileFormat::of(bytes) else {
        refuse_markup(uri, bytes)?;
        return Err(IoError::unsupported(uri, "image that is neither PNG, JPEG, WebP, GIF, BMP nor TIFF"));
    };
    let size = ImageReader::with_format(Cursor::new(bytes), format).into_dimensions();
    let (width, height) = size.map_err(|error| IoError::invalid(uri, format!("image: {error}")))?;
    check_area(uri, width, height, limits)?;
    Ok([width, height])
}

/// A texture and, if it is shared between contents, its reference count.
pub(in crate::formats) type SharedTexture = (Arc<Texture>, Option<Arc<SharedContent>>);

/// The way in which a texture's image is sampled, which decides how it is decoded.
#[derive(Clone, Copy, Debug)]
pub(in crate::formats) struct ImageUse {
    pub sampling: Sampling,
    /// The compressed formats that the texture may have; none if the texels are read by the CPU.
    pub formats: BlockFormats,
    /// How its texels are averaged.
    pub filter: MipFilter,
}

impl ImageUse {
    /// Returns the use of an image with colours.
    pub(in crate::formats) fn colors(sampling: Sampling, formats: BlockFormats) -> Self {
        Self { sampling, formats, filter: MipFilter::Srgb }
    }
}

/// Decodes an image, or returns the texture that another content decoded from the same bytes.
pub(in crate::formats) fn decode_shared(
    uri: &str,
    bytes: &[u8],
    of: ImageUse,
    options: &ReadOptions,
    notes: &Notes,
) -> Result<SharedTexture, IoError> {
    let (ImageUse { sampling, formats, filter }, limits) = (of, &options.limits);
    let (format, note) = match FileFormat::of(bytes) {
        Some(FileFormat::Ktx2) => ktx2::choose_format(bytes, formats, limits),
        _ => (TexelFormat::Rgba8, None),
    };
    if let Some(note) = note {
        notes.add(note);
    }
    let decode = || decode(uri, bytes, format, (sampling, filter), limits);
    let shared = match &options.sharing {
        Some(sharing) => {
            sharing.image(ContentKey::of(&[bytes, &sampling.key(), &[format as u8, filter as u8]]), decode)?
        }
        None => (decode()?, None),
    };
    if let Some(files) = &options.image_files {
        files.add(&shared.0, bytes);
    }
    Ok(shared)
}

/// Decodes an image with its mip levels. An image whose sides are longer than the limit is halved until it fits.
fn decode(
    uri: &str,
    bytes: &[u8],
    format: TexelFormat,
    (sampling, filter): (Sampling, MipFilter),
    limits: &Limits,
) -> Result<Arc<Texture>, IoError> {
    let levels = match FileFormat::of(bytes) {
        Some(FileFormat::Raster(format)) => decode_raster(uri, bytes, format, filter, limits)?,
        Some(FileFormat::Ktx2) => ktx2::decode(uri, bytes, format, filter, limits)?,
        Some(FileFormat::Dds) => {
            let (width, height, texels) = dds::decode(uri, bytes, limits)?;
            Levels { width, height, levels: mips(width, height, texels, filter) }
        }
        None => {
            refuse_markup(uri, bytes)?;
            return Err(IoError::unsupported(
                uri,
                "image that is neither PNG, JPEG, WebP, KTX2, DDS, GIF, BMP nor TIFF",
            ));
        }
    };
    Ok(texture_of(levels, format, sampling, limits))
}

/// Returns a texture of sRGB colours in RGBA8 with its mip levels, halved until its sides are within the limit. Its size was checked
/// with [`check_size`].
pub(in crate::formats) fn texture_of_rgba(
    width: u32,
    height: u32,
    texels: Vec<u8>,
    sampling: Sampling,
    limits: &Limits,
) -> Arc<Texture> {
    let levels = Levels { width, height, levels: mips(width, height, texels, MipFilter::Srgb) };
    texture_of(levels, TexelFormat::Rgba8, sampling, limits)
}

/// Returns a texture of the levels whose sides are within the limit, or of the last one.
fn texture_of(all: Levels, format: TexelFormat, sampling: Sampling, limits: &Limits) -> Arc<Texture> {
    let Levels { width, height, levels } = all;
    let too_long = |level: usize| width.max(height) >> level > limits.max_image_side_px;
    let skipped = (0..levels.len().saturating_sub(1)).take_while(|level| too_long(*level)).count();
    let side = |of: u32| (of >> skipped).max(1);
    let kept = if sampling.mip.is_some() { usize::MAX } else { 1 };
    let mips = levels.into_iter().skip(skipped).take(kept).collect();
    Arc::new(Texture { width: side(width), height: side(height), format, mips, sampling })
}

/// Decodes a PNG, JPEG, WebP, GIF (its first picture), BMP or TIFF (its first page) and builds its mip levels.
fn decode_raster(
    uri: &str,
    bytes: &[u8],
    format: ImageFormat,
    filter: MipFilter,
    limits: &Limits,
) -> Result<Levels, IoError> {
    let bad = |e: image::ImageError| IoError::invalid(uri, format!("image: {e}"));
    let mut image_limits = ImageLimits::default();
    image_limits.max_alloc = Some(limits.max_image_bytes.saturating_mul(2));
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(image_limits.clone());
    let mut decoder = reader.into_decoder().map_err(bad)?;
    let (width, height) = decoder.dimensions();
    check_size(uri, width, height, limits)?;
    image_limits.reserve(decoder.total_bytes()).map_err(bad)?;
    // Texels of more than eight bits a channel are reduced behind the decoder.
    if decoder.total_bytes() > 4 * u64::from(width) * u64::from(height) {
        about_to_allocate(decoder.total_bytes()).map_err(|error| error.at(uri))?;
    }
    decoder.set_limits(image_limits).map_err(bad)?;
    let pixels = if decoder.color_type() == ColorType::Rgb8 {
        decode_rgb(width as usize * height as usize * 3, |rgb| decoder.read_image(rgb)).map_err(bad)?
    } else {
        DynamicImage::from_decoder(decoder).map_err(bad)?.into_rgba8().into_raw()
    };
    Ok(Levels { width, height, levels: mips(width, height, pixels, filter) })
}

/// Decodes the bytes of an image file to a clamped RGBA8 texture. If the decoder panics, only this file fails.
pub(crate) fn decode_file(uri: &str, bytes: &[u8], limits: &Limits) -> Result<Arc<Texture>, IoError> {
    guarded(uri, || decode(uri, bytes, TexelFormat::Rgba8, (Sampling::default(), MipFilter::Srgb), limits))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fetch::{ByteBudget, LargeContents};

    #[test]
    fn texels_of_all_levels_are_counted() {
        let mut png = Vec::new();
        image::RgbImage::new(64, 32).write_to(&mut Cursor::new(&mut png), ImageFormat::Png).unwrap();
        let memory = ByteBudget::new(u64::MAX);
        let limits = Limits::default();
        let (decoded, _held) = LargeContents::default().decode(memory.hold(0), || decode_file("a", &png, &limits));
        assert!(decoded.is_ok());
        assert_eq!(memory.total().bytes, 64 * 32 * 4 / 3 * 4);
        assert_eq!(size_of("a", &png, &limits).unwrap(), [64, 32]);
    }

    #[test]
    fn formats_that_old_files_name_are_decoded() {
        use image::ImageFormat::{Bmp, Gif, Tiff};
        let corner = |bytes: &[u8]| {
            let read = decode_file("a", bytes, &Limits::default()).unwrap();
            assert_eq!((read.width, read.height, read.mips.len()), (4, 2, 3));
            <[u8; 8]>::try_from(&read.mips[0][8..16]).unwrap()
        };
        let picture = image::RgbImage::from_fn(4, 2, |x, y| image::Rgb([x as u8 * 80, y as u8 * 255, 0]));
        for format in [Bmp, Gif, Tiff] {
            let mut file = Vec::new();
            DynamicImage::ImageRgb8(picture.clone()).write_to(&mut Cursor::new(&mut file), format).unwrap();
            assert!(is_image(&file));
            assert_eq!(corner(&file), [160, 0, 0, 255, 240, 0, 0, 255], "{format:?}");
            assert_eq!(size_of("a", &file, &Limits::default()).unwrap(), [4, 2], "{format:?}");
            let half = &file[..file.len() / 2];
            assert!(decode_file("a", half, &Limits::default()).is_err(), "{format:?}");
            let small = Limits { max_image_bytes: 31, ..Limits::default() };
            assert!(matches!(decode_file("a", &file, &small), Err(IoError::TooLarge { .. })), "{format:?}");
        }
        // The first frame of an animation is decoded.
        let frame = |alpha| image::Frame::new(image::RgbaImage::from_pixel(4, 2, image::Rgba([9, 8, 7, alpha])));
        let mut file = Vec::new();
        image::codecs::gif::GifEncoder::new(&mut file).encode_frames([frame(255), frame(0)]).unwrap();
        assert_eq!(corner(&file), [9, 8, 7, 255, 9, 8, 7, 255]);
        // Channels of 16 bits are rounded to 8.
        let mut file = Vec::new();
        let wide = image::ImageBuffer::from_pixel(4, 2, image::Rgb([0xffffu16, 0x8080, 0]));
        DynamicImage::ImageRgb16(wide).write_to(&mut Cursor::new(&mut file), Tiff).unwrap();
        assert_eq!(corner(&file), [255, 128, 0, 255, 255, 128, 0, 255]);
    }
}
