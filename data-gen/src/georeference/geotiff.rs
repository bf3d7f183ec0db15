//! Reads GeoTIFF (OGC 19-008): samples with the crate `tiff-reader`, the georeference from the tags.
//!
//! Blocks that a sparse file leaves out, samples equal to the nodata value, and samples that a mask hides have no data.

use std::path::Path;

use tiff_reader::{ColorModel, ExtraSample, Ifd, OpenOptions, RasterLayout, TiffFile};

use super::geo_keys::{FOOT_M, GeoKeys, US_SURVEY_FOOT_M};
use super::transform::GeoTransform;
use crate::GenError;

/// Largest number of pixels of one image.
const MAX_PIXELS: usize = 1 << 30;
/// About the number of pixels that are decoded at once.
const PIXELS_AT_ONCE: usize = 1 << 22;

const NEW_SUBFILE_TYPE: u16 = 254;
const MODEL_PIXEL_SCALE: u16 = 33550;
const MODEL_TIEPOINT: u16 = 33922;
const MODEL_TRANSFORMATION: u16 = 34264;
const GEO_KEY_DIRECTORY: u16 = 34735;
const GEO_DOUBLE_PARAMS: u16 = 34736;
const GDAL_METADATA: u16 = 42112;
const GDAL_NODATA: u16 = 42113;

/// An open GeoTIFF. Its samples are read on request.
pub(crate) struct Tiff {
    file: TiffFile,
    layout: RasterLayout,
    /// The mask: a further image of the file, or the file beside it with the extension `msk`.
    mask: Option<Mask>,
    pub width: usize,
    pub height: usize,
    pub transform: Option<GeoTransform>,
    pub keys: GeoKeys,
    nodata: Option<f64>,
    /// GDAL's metadata about the samples, XML.
    gdal: String,
}

/// An image whose samples other than 0 mark pixels with data.
struct Mask {
    /// The file beside the image; `None` if the mask is an image of the same file.
    beside: Option<TiffFile>,
    index: usize,
}

impl Tiff {
    /// Opens a TIFF and reads its tags. Images of more than 2^30 pixels are refused.
    pub fn open(path: &Path) -> Result<Self, GenError> {
        let bad = |e: tiff_reader::TiffError| GenError::invalid(path, format!("TIFF: {e}"));
        let options = OpenOptions::default();
        let file = TiffFile::open_with_options(path, options).map_err(bad)?;
        let ifd = file.ifd(0).map_err(bad)?;
        let layout = ifd.raster_layout().map_err(bad)?;
        let (width, height) = (layout.width, layout.height);
        let pixels = width.saturating_mul(height);
        if pixels == 0 || pixels > MAX_PIXELS {
            return Err(GenError::invalid(path, format!("TIFF: {width} x {height} pixels; 1 to 2^30 are supported")));
        }
        let text = |tag: u16| ifd.tag(tag).and_then(|tag| tag.value.as_str()).unwrap_or_default();
        let directory = ifd.tag(GEO_KEY_DIRECTORY).and_then(|tag| tag.value.as_u16_slice()).unwrap_or_default();
        let keys = GeoKeys::new(directory.to_vec(), numbers(ifd, GEO_DOUBLE_PARAMS).unwrap_or_default());
        let nodata = text(GDAL_NODATA).trim_matches(|c: char| c == '\0' || c.is_whitespace());
        let nodata =
            if nodata.contains("#IND") || nodata.contains("#QNAN") { Some(f64::NAN) } else { nodata.parse().ok() };
        let (transform, gdal) = (transform(ifd, &keys), text(GDAL_METADATA).to_owned());
        let mask = mask(path, &file, [width, height]);
        Ok(Self { layout, mask, width, height, transform, keys, nodata, gdal, file })
    }

    /// Returns the number of channels.
    pub fn channels(&self) -> usize {
        self.layout.samples_per_pixel
    }

    /// Reads a channel as heights in metres, row-major, north row first; NaN without data. `more_nodata` is another value
    /// that marks samples without data.
    pub fn heights(&self, path: &Path, channel: usize, more_nodata: Option<f64>) -> Result<Vec<f32>, GenError> {
        let [factor, offset] = self.factor_and_offset_m().map_err(|reason| GenError::invalid(path, reason))?;
        let bad = |e: tiff_reader::TiffError| GenError::invalid(path, format!("TIFF: {e}"));
        let is_single = (self.layout.sample_format, self.layout.bytes_per_sample) == (3, 4);
        // A nodata value is written with more digits than a 32-bit sample has.
        let is_nodata = |h: f64, nodata: Option<f64>| {
            nodata.is_some_and(|nodata| h == nodata || (is_single && h as f32 == nodata as f32))
        };
        let missing = MissingBlocks::of(self.file.ifd(0).map_err(bad)?, &self.layout, channel);
        let mut heights = Vec::new();
        for [first, rows] in self.steps() {
            let bytes = self.file.read_band_window_bytes(0, channel, first, 0, rows, self.width).map_err(bad)?;
            let mask = self.mask_rows(first, rows).map_err(bad)?;
            let values = values(&bytes, &self.layout).ok_or_else(|| {
                GenError::invalid(path, format!("TIFF: samples of {} bits", self.layout.bits_per_sample))
            })?;
            for (k, h) in values.enumerate() {
                let is_void = is_nodata(h, self.nodata)
                    || is_nodata(h, more_nodata)
                    // It marks missing data in SRTM. In feet it would become a depth above the limit for impossible heights.
                    || h == f64::from(i16::MIN)
                    || mask.as_ref().is_some_and(|mask| mask.get(k) == Some(&0))
                    // Without a nodata value the samples of missing blocks are 0, as GDAL reads them.
                    || (self.nodata.is_some() && missing.has(k % self.width, first + k / self.width));
                heights.push(if is_void { f32::NAN } else { (h * factor + offset) as f32 });
            }
        }
        Ok(heights)
    }

    /// Reads the image as RGBA, row-major, north row first, with the colours of its colour model. Pixels without data are
    /// transparent.
    pub fn rgba(&self, path: &Path) -> Result<Vec<u8>, GenError> {
        let bad = |e: tiff_reader::TiffError| GenError::invalid(path, format!("TIFF: {e}"));
        let ifd = self.file.ifd(0).map_err(bad)?;
        let decoded = ifd.decoded_raster_layout().map_err(bad)?;
        if decoded.sample_format != 1 || !matches!(decoded.bytes_per_sample, 1 | 2) {
            let reason = "TIFF: imagery must have 8 bits per channel or 16, without sign";
            return Err(GenError::invalid(path, reason));
        }
        let channels = Channels::of(&ifd.color_model().map_err(bad)?).map_err(|e| GenError::invalid(path, e))?;
        let (count, wide) = (decoded.samples_per_pixel, decoded.bytes_per_sample == 2);
        let missing = MissingBlocks::of(ifd, &self.layout, 0);
        let mut rgba = Vec::new();
        for [first, rows] in self.steps() {
            let bytes = self.file.read_decoded_window_bytes(0, first, 0, rows, self.width).map_err(bad)?;
            let mask = self.mask_rows(first, rows).map_err(bad)?;
            let nodata = self.nodata_rows(channels.stored_colors, first, rows).map_err(bad)?;
            let value = |pixel: usize, channel: usize| {
                let at = pixel * count + channel;
                match wide {
                    false => bytes.get(at).copied().unwrap_or_default(),
                    true => {
                        let pair = bytes.get(2 * at..2 * at + 2).map_or([0; 2], |b| [b[0], b[1]]);
                        ((u32::from(u16::from_ne_bytes(pair)) + 128) / 257) as u8
                    }
                }
            };
            for pixel in 0..rows * self.width {
                let is_hidden = mask.as_ref().is_some_and(|mask| mask.get(pixel) == Some(&0))
                    || nodata.as_ref().is_some_and(|nodata| nodata.get(pixel) == Some(&true))
                    || missing.has(pixel % self.width, first + pixel / self.width);
                let alpha = channels.alpha.map_or(255, |channel| value(pixel, channel));
                let mut color = channels.colors.map(|channel| value(pixel, channel));
                if channels.is_premultiplied && alpha > 0 {
                    color = color.map(|c| (u32::from(c) * 255 / u32::from(alpha)).min(255) as u8);
                }
                let [r, g, b] = color;
                rgba.extend([r, g, b, if is_hidden { 0 } else { alpha }]);
            }
        }
        Ok(rgba)
    }

    /// Returns the first row and the number of rows of each step of reading: whole rows of blocks.
    fn steps(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let ifd = self.file.ifd(0).ok();
        let block = ifd.map_or(1, |ifd| ifd.tile_height().unwrap_or_else(|| ifd.rows_per_strip()));
        let (block, height) = ((block as usize).clamp(1, self.height), self.height);
        let rows = (PIXELS_AT_ONCE / self.width / block).max(1) * block;
        (0..height).step_by(rows).map(move |first| [first, rows.min(height - first)])
    }

    /// Returns the samples of the mask in some rows, `None` without a mask.
    fn mask_rows(&self, first: usize, rows: usize) -> Result<Option<Vec<u8>>, tiff_reader::TiffError> {
        let Some(mask) = &self.mask else { return Ok(None) };
        let file = mask.beside.as_ref().unwrap_or(&self.file);
        file.read_band_window_bytes(mask.index, 0, first, 0, rows, self.width).map(Some)
    }

    /// Returns for each pixel of some rows whether its first `colors` stored channels all have the nodata value; `None`
    /// without such a value.
    fn nodata_rows(
        &self,
        colors: usize,
        first: usize,
        rows: usize,
    ) -> Result<Option<Vec<bool>>, tiff_reader::TiffError> {
        let Some(nodata) = self.nodata else { return Ok(None) };
        let mut all = vec![true; rows * self.width];
        for channel in 0..colors.min(self.channels()) {
            let bytes = self.file.read_band_window_bytes(0, channel, first, 0, rows, self.width)?;
            for (all, value) in all.iter_mut().zip(values(&bytes, &self.layout).into_iter().flatten()) {
                *all &= value == nodata;
            }
        }
        Ok(Some(all))
    }

    /// Returns the factor and the offset that convert samples to heights in metres. The error is the reason.
    fn factor_and_offset_m(&self) -> Result<[f64; 2], String> {
        let number = |role: &str, usual: f64| match gdal_item(&self.gdal, role) {
            None => Ok(usual),
            Some(text) => text.parse().ok().filter(|n: &f64| n.is_finite()).ok_or_else(|| format!("{role} `{text}`")),
        };
        let unit = match (self.keys.height_unit_m()?, gdal_item(&self.gdal, "unittype")) {
            (Some(metres), _) => Ok(metres),
            (None, None | Some("" | "m" | "metre" | "metres" | "meter" | "meters")) => Ok(1.0),
            (None, Some("ft" | "foot" | "feet")) => Ok(FOOT_M),
            (None, Some("US survey foot" | "US survey feet" | "ftUS" | "us-ft" | "sfoot")) => Ok(US_SURVEY_FOOT_M),
            (None, Some(other)) => Err(format!("heights in units of `{other}`")),
        };
        let (scale, offset) = (number("scale", 1.0), number("offset", 0.0));
        let unsupported = |what: String| format!("GDAL's metadata: {what}, which is not supported");
        let [scale, offset, unit] = [scale, offset, unit].map(|n| n.map_err(unsupported));
        let unit = unit?;
        Ok([scale? * unit, offset? * unit])
    }
}

/// The channels of a decoded image.
struct Channels {
    /// Red, green and blue.
    colors: [usize; 3],
    alpha: Option<usize>,
    /// True if the colours are multiplied by the opacity.
    is_premultiplied: bool,
    /// The number of stored channels that hold the colour.
    stored_colors: usize,
}

impl Channels {
    /// Finds the channels of a colour model. The error is the reason.
    fn of(model: &ColorModel) -> Result<Self, String> {
        // The number of decoded colour channels, and of stored ones.
        let (decoded, stored_colors, extra) = match model {
            ColorModel::Grayscale { extra_samples, .. } => (1, 1, extra_samples.as_slice()),
            ColorModel::Palette { extra_samples, .. } => (3, 1, extra_samples.as_slice()),
            ColorModel::Rgb { extra_samples }
            | ColorModel::CieLab { extra_samples }
            | ColorModel::YCbCr { extra_samples, .. } => (3, 3, extra_samples.as_slice()),
            ColorModel::Cmyk { extra_samples } => (3, 4, extra_samples.as_slice()),
            ColorModel::TransparencyMask => (1, 1, [].as_slice()),
            ColorModel::Separated { .. } => return Err("TIFF: inks other than CMYK are not supported".to_owned()),
        };
        let is_alpha =
            |kind: &ExtraSample| matches!(kind, ExtraSample::AssociatedAlpha | ExtraSample::UnassociatedAlpha);
        let alpha = extra.iter().position(is_alpha);
        let others = extra.iter().filter(|kind| !is_alpha(kind)).count();
        // Satellite images often call their bands grey and two of unknown meaning.
        let (colors, stored_colors) = match decoded {
            1 if others >= 2 && alpha.is_none_or(|alpha| alpha >= 2) => ([0, 1, 2], 3),
            1 => ([0; 3], stored_colors),
            _ => ([0, 1, 2], stored_colors),
        };
        let is_premultiplied = alpha.is_some_and(|k| extra[k] == ExtraSample::AssociatedAlpha);
        Ok(Self { colors, alpha: alpha.map(|k| decoded + k), is_premultiplied, stored_colors })
    }
}

/// The blocks (tiles or strips) of one channel that a sparse file leaves out.
struct MissingBlocks {
    /// The width and height of a block in pixels.
    size: [usize; 2],
    across: usize,
    /// Row-major from the north-west; empty if no block is missing.
    is_missing: Vec<bool>,
}

impl MissingBlocks {
    fn of(ifd: &Ifd, layout: &RasterLayout, channel: usize) -> Self {
        let height = ifd.tile_height().unwrap_or_else(|| ifd.rows_per_strip());
        let size = [ifd.tile_width().map_or(layout.width, |w| w as usize), height as usize].map(|s| s.max(1));
        let (across, down) = (layout.width.div_ceil(size[0]), layout.height.div_ceil(size[1]));
        let (offsets, counts) = match ifd.is_tiled() {
            true => (ifd.tile_offsets(), ifd.tile_byte_counts()),
            false => (ifd.strip_offsets(), ifd.strip_byte_counts()),
        };
        let plane = if layout.planar_configuration == 2 { channel } else { 0 };
        let blocks = offsets.into_iter().flatten().zip(counts.into_iter().flatten());
        let blocks = blocks.skip(plane * across * down).take(across * down);
        let mut is_missing: Vec<bool> = blocks.map(|(offset, bytes)| offset == 0 || bytes == 0).collect();
        if !is_missing.contains(&true) {
            is_missing.clear();
        }
        Self { size, across, is_missing }
    }

    fn has(&self, column: usize, row: usize) -> bool {
        let block = || row / self.size[1] * self.across + column / self.size[0];
        !self.is_missing.is_empty() && self.is_missing.get(block()) == Some(&true)
    }
}

/// Returns samples of one channel as numbers, `None` for a format that is not supported.
fn values<'a>(bytes: &'a [u8], layout: &RasterLayout) -> Option<Box<dyn Iterator<Item = f64> + 'a>> {
    fn of<'a, const N: usize>(bytes: &'a [u8], read: fn([u8; N]) -> f64) -> Box<dyn Iterator<Item = f64> + 'a> {
        Box::new(bytes.as_chunks::<N>().0.iter().map(move |chunk| read(*chunk)))
    }
    Some(match (layout.sample_format, layout.bytes_per_sample) {
        (1, 1) => of(bytes, |[b]| b.into()),
        (1, 2) => of(bytes, |b| u16::from_ne_bytes(b).into()),
        (1, 4) => of(bytes, |b| u32::from_ne_bytes(b).into()),
        (1, 8) => of(bytes, |b| u64::from_ne_bytes(b) as f64),
        (2, 1) => of(bytes, |b| i8::from_ne_bytes(b).into()),
        (2, 2) => of(bytes, |b| i16::from_ne_bytes(b).into()),
        (2, 4) => of(bytes, |b| i32::from_ne_bytes(b).into()),
        (2, 8) => of(bytes, |b| i64::from_ne_bytes(b) as f64),
        (3, 4) => of(bytes, |b| f32::from_ne_bytes(b).into()),
        (3, 8) => of(bytes, f64::from_ne_bytes),
        _ => return None,
    })
}

/// Finds the mask of an image of a size: an image of the file that says so, or the file beside it.
fn mask(path: &Path, file: &TiffFile, size: [usize; 2]) -> Option<Mask> {
    let is_mask = |ifd: &Ifd| {
        let kind = ifd.tag(NEW_SUBFILE_TYPE).and_then(|tag| tag.value.as_u32()).unwrap_or(0);
        // Bit 2 marks a mask, bit 0 an image of a lower resolution.
        kind & 5 == 4 && is_image_of(ifd, size)
    };
    if let Some(index) = file.ifds().iter().position(is_mask) {
        return Some(Mask { beside: None, index });
    }
    let mut beside = path.as_os_str().to_owned();
    beside.push(".msk");
    let beside = Path::new(&beside);
    let beside = beside.is_file().then(|| TiffFile::open(beside).ok()).flatten()?;
    let is_mask = beside.ifd(0).is_ok_and(|ifd| is_image_of(ifd, size));
    is_mask.then_some(Mask { beside: Some(beside), index: 0 })
}

/// Returns true if an image has a size and samples of one byte at most.
fn is_image_of(ifd: &Ifd, size: [usize; 2]) -> bool {
    ifd.raster_layout().is_ok_and(|layout| [layout.width, layout.height] == size && layout.bytes_per_sample == 1)
}

/// Returns the value of a role ("scale", "offset", "unittype") of the first band in GDAL's metadata.
fn gdal_item<'a>(xml: &'a str, role: &str) -> Option<&'a str> {
    let items = xml.split("<Item ").skip(1).filter_map(|item| item.split('<').next()?.split_once('>'));
    let mut found = items.filter(|(attributes, _)| {
        attributes.contains(&format!("role=\"{role}\""))
            && (attributes.contains("sample=\"0\"") || !attributes.contains("sample="))
    });
    found.next().map(|(_, value)| value.trim())
}

/// Returns the numbers of a tag.
fn numbers(ifd: &Ifd, tag: u16) -> Option<Vec<f64>> {
    ifd.tag(tag)?.value.as_f64_vec()
}

/// Returns the transform in the tags ModelPixelScale and ModelTiepoint, or in ModelTransformation.
fn transform(ifd: &Ifd, keys: &GeoKeys) -> Option<GeoTransform> {
    let [scale, tie, matrix] = [MODEL_PIXEL_SCALE, MODEL_TIEPOINT, MODEL_TRANSFORMATION].map(|tag| numbers(ifd, tag));
    let mut transform = match (scale.as_deref(), tie.as_deref(), matrix.as_deref()) {
        (Some([sx, sy, ..]), Some([i, j, _, x, y, ..]), _) => {
            GeoTransform { origin: [x - i * sx, y + j * sy], dx: [*sx, 0.0], dy: [0.0, -sy] }
        }
        (_, _, Some(m)) if m.len() >= 8 => GeoTransform { origin: [m[3], m[7]], dx: [m[0], m[4]], dy: [m[1], m[5]] },
        _ => return None,
    };
    // GTRasterType: with 1 (area) the reference is a pixel's corner, with 2 (point) its centre.
    if keys.number(1025) == Some(2) {
        transform.origin[0] -= 0.5 * (transform.dx[0] + transform.dy[0]);
        transform.origin[1] -= 0.5 * (transform.dx[1] + transform.dy[1]);
    }
    Some(transform)
}
