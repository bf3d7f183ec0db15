//! Reads the samples of a GeoTIFF: heights, or colours.
//!
//! Blocks that a sparse file leaves out, samples equal to the nodata value, and samples that a mask hides have no data.

use exr::prelude::f16;
use tiff_reader::{ByteOrder, ColorModel, ExtraSample, RasterLayout, TiffError};

use super::geotiff::{Tiff, failed};
use crate::GenError;
use crate::store::Rect;

/// The code of LERC.
const LERC: u16 = 34887;

impl Tiff {
    /// Reads a rectangle of a channel as heights in metres, row-major, north row first; NaN without data. `more_nodata` is
    /// another value that marks samples without data.
    pub fn heights(&self, channel: usize, more_nodata: Option<f64>, r: Rect) -> Result<Vec<f32>, GenError> {
        let scaled = self.factor_and_offset_m(channel).map_err(|reason| GenError::invalid(&self.path, reason))?;
        self.samples(channel, more_nodata, r, scaled)
    }

    /// Reads a rectangle of a channel's samples, multiplied by a factor and with an offset added; NaN without data.
    pub(super) fn samples(
        &self,
        channel: usize,
        more_nodata: Option<f64>,
        r: Rect,
        [factor, offset]: [f64; 2],
    ) -> Result<Vec<f32>, GenError> {
        self.check_unchanged()?;
        // A nodata value is written with more digits than a 32-bit sample has.
        let is_single = (self.layout.sample_format, self.layout.bytes_per_sample) == (3, 4);
        let narrow = |v: f64| if is_single { f64::from(v as f32) } else { v };
        let nodata = [self.nodata, more_nodata].map(|nodata| nodata.map(|v| [v, narrow(v)]));
        let is_nodata = |h: f64| nodata.iter().flatten().any(|[exact, narrow]| h == *exact || h == *narrow);
        let bytes = self.band(channel, r)?;
        let mask = self.mask_in(r)?;
        let opacity = match self.alpha().filter(|alpha| *alpha != channel) {
            Some(alpha) => Some(self.band(alpha, r)?),
            None => None,
        };
        if is_single && mask.is_none() && opacity.is_none() && (self.nodata.is_none() || self.missing.is_empty()) {
            let heights = bytes.as_chunks::<4>().0.iter().map(|bytes| {
                let h = f64::from(f32::from_ne_bytes(*bytes));
                if is_nodata(h) || h == f64::from(i16::MIN) { f32::NAN } else { (h * factor + offset) as f32 }
            });
            return Ok(heights.collect());
        }
        let opacity: Option<Vec<f64>> = opacity.and_then(|bytes| Some(values(&bytes, &self.layout)?.collect()));
        let values = values(&bytes, &self.layout)
            .ok_or_else(|| self.bad(format!("samples of {} bits", self.layout.bits_per_sample)))?;
        let plane = self.plane(channel);
        let heights = values.enumerate().map(|(k, h)| {
            let is_void = is_nodata(h)
                // It marks missing data in SRTM. In feet it would become a depth above the limit for impossible heights.
                || h == f64::from(i16::MIN)
                || mask.as_ref().is_some_and(|mask| mask.get(k) == Some(&0))
                || opacity.as_ref().is_some_and(|opacity| opacity.get(k) == Some(&0.0))
                // Without a nodata value the samples of missing blocks are 0, as GDAL reads them.
                || (self.nodata.is_some() && self.missing.has(plane, r.column + k % r.width, r.row + k / r.width));
            if is_void { f32::NAN } else { (h * factor + offset) as f32 }
        });
        Ok(heights.collect())
    }

    /// Returns the channel of the opacity, which tells where a grey image has data.
    pub fn alpha(&self) -> Option<usize> {
        let model = self.file.ifd(self.index).ok()?.color_model().ok()?;
        let ColorModel::Grayscale { extra_samples, .. } = &model else { return None };
        extra_samples.iter().position(is_alpha).map(|k| k + 1)
    }

    /// Returns an error for samples of a kind that is not supported, and for units of heights that are not known.
    pub fn check_samples(&self) -> Result<(), GenError> {
        self.factor_and_offset_m(0).map_err(|reason| GenError::invalid(&self.path, reason))?;
        let is_lerc = self.file.ifd(self.index).is_ok_and(|ifd| ifd.compression() == LERC);
        if is_lerc && self.file.byte_order() == ByteOrder::BigEndian {
            return Err(self.bad(
                "samples compressed as LERC in a big-endian file, whose bytes libtiff swaps before it compresses them; \
                 gdal_translate -co COMPRESS=DEFLATE converts the file",
            ));
        }
        let unsupported = || self.bad(format!("samples of {} bits", self.layout.bits_per_sample));
        values(&[], &self.layout).map(|_| ()).ok_or_else(unsupported)
    }

    /// Returns the bytes of a channel's samples in a rectangle, in the machine's byte order.
    fn band(&self, channel: usize, r: Rect) -> Result<Vec<u8>, GenError> {
        if self.has_plain_rows() {
            return self.plain_rows(channel, r);
        }
        let read = self.file.read_band_window_bytes(self.index, channel, r.row, r.column, r.height, r.width);
        read.map_err(|e| failed(&self.path, e))
    }

    /// Returns true if rows of the file can be read without the rows above: strips without compression.
    pub(super) fn has_plain_rows(&self) -> bool {
        let Ok(ifd) = self.file.ifd(self.index) else { return false };
        let is_plain = ifd.compression() == 1 && ifd.predictor() == 1 && ifd.fill_order() == 1;
        is_plain && !ifd.is_tiled() && self.layout.bits_per_sample as usize == 8 * self.layout.bytes_per_sample
    }

    /// Reads rows of strips without compression.
    fn plain_rows(&self, channel: usize, r: Rect) -> Result<Vec<u8>, GenError> {
        let ifd = self.file.ifd(self.index).map_err(|e| failed(&self.path, e))?;
        let (offsets, counts) = (ifd.strip_offsets().unwrap_or_default(), ifd.strip_byte_counts().unwrap_or_default());
        let (bytes, is_planar) = (self.layout.bytes_per_sample, self.layout.planar_configuration == 2);
        let (stride, first) = if is_planar { (bytes, 0) } else { (bytes * self.channels(), bytes * channel) };
        let rows_per_strip = (ifd.rows_per_strip() as usize).clamp(1, self.height);
        let strips = self.height.div_ceil(rows_per_strip);
        let mut samples = Vec::with_capacity(r.pixels() * bytes);
        for row in r.row..r.row + r.height {
            let strip = row / rows_per_strip + if is_planar { channel * strips } else { 0 };
            let (Some(offset), Some(count)) = (offsets.get(strip), counts.get(strip)) else {
                return Err(self.bad(format!("no strip for row {row}")));
            };
            let start = (row % rows_per_strip * self.width + r.column) as u64 * stride as u64;
            let length = r.width * stride;
            if *offset == 0 || *count == 0 {
                samples.resize(samples.len() + r.width * bytes, 0);
                continue;
            }
            if start + length as u64 > *count {
                return Err(self.bad(format!("row {row} ends beyond its strip of {count} bytes")));
            }
            let stored = self.file.source().read_exact_at(offset.saturating_add(start), length);
            let stored = stored.map_err(|e| failed(&self.path, e))?;
            match stride == bytes {
                true => samples.extend_from_slice(&stored),
                false => samples.extend(stored.chunks_exact(stride).flat_map(|pixel| &pixel[first..first + bytes])),
            }
        }
        let is_native = (self.file.byte_order() == ByteOrder::LittleEndian) == cfg!(target_endian = "little");
        if !is_native {
            samples.chunks_exact_mut(bytes).for_each(<[u8]>::reverse);
        }
        Ok(samples)
    }

    /// Reads a rectangle as RGBA, row-major, north row first, with the colours of its colour model. Pixels without data are
    /// transparent.
    pub fn rgba(&self, r: Rect) -> Result<Vec<[u8; 4]>, GenError> {
        self.check_unchanged()?;
        if let Some(pixels) = self.webp(r)? {
            return self.hidden(pixels, r);
        }
        let bad = |e: TiffError| failed(&self.path, e);
        let ifd = self.file.ifd(self.index).map_err(bad)?;
        let decoded = ifd.decoded_raster_layout().map_err(bad)?;
        if decoded.sample_format != 1 || self.layout.sample_format == 3 || !matches!(decoded.bytes_per_sample, 1 | 2) {
            return Err(self.bad(
                "imagery must have 8 bits per channel or 16, without sign; gdal_translate -ot Byte -scale converts it",
            ));
        }
        let channels = Channels::of(&ifd.color_model().map_err(bad)?).map_err(|e| GenError::invalid(&self.path, e))?;
        let (count, wide) = (decoded.samples_per_pixel, decoded.bytes_per_sample == 2);
        let bytes = self.file.read_decoded_window_bytes(self.index, r.row, r.column, r.height, r.width).map_err(bad)?;
        let mask = self.mask_in(r)?;
        let nodata = self.nodata_in(channels.stored_colors, r)?;
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
        let pixels = (0..r.pixels()).map(|pixel| {
            let is_hidden = mask.as_ref().is_some_and(|mask| mask.get(pixel) == Some(&0))
                || nodata.as_ref().is_some_and(|nodata| nodata.get(pixel) == Some(&true))
                || self.missing.has(0, r.column + pixel % r.width, r.row + pixel / r.width);
            let alpha = channels.alpha.map_or(255, |channel| value(pixel, channel));
            let mut color = channels.colors.map(|channel| value(pixel, channel));
            if channels.is_premultiplied && alpha > 0 {
                color = color.map(|c| (u32::from(c) * 255 / u32::from(alpha)).min(255) as u8);
            }
            let [red, green, blue] = color;
            [red, green, blue, if is_hidden { 0 } else { alpha }]
        });
        Ok(pixels.collect())
    }

    /// Makes the pixels of a rectangle transparent that have the nodata value or that the mask hides.
    fn hidden(&self, mut pixels: Vec<[u8; 4]>, r: Rect) -> Result<Vec<[u8; 4]>, GenError> {
        let mask = self.mask_in(r)?;
        let nodata = self.nodata.filter(|_| self.channels() == 3);
        for (k, pixel) in pixels.iter_mut().enumerate() {
            let is_hidden = mask.as_ref().is_some_and(|mask| mask.get(k) == Some(&0))
                || nodata.is_some_and(|nodata| pixel[..3].iter().all(|color| f64::from(*color) == nodata))
                || self.missing.has(0, r.column + k % r.width, r.row + k / r.width);
            if is_hidden {
                pixel[3] = 0;
            }
        }
        Ok(pixels)
    }

    /// Returns the samples of the mask in a rectangle, `None` without a mask.
    fn mask_in(&self, r: Rect) -> Result<Option<Vec<u8>>, GenError> {
        let Some(mask) = &self.mask else { return Ok(None) };
        let read = mask.file.read_band_window_bytes(mask.index, 0, r.row, r.column, r.height, r.width);
        read.map(Some).map_err(|e| failed(&self.path, e))
    }

    /// Returns for each pixel of a rectangle whether its first `colors` stored channels all have the nodata value; `None`
    /// without such a value.
    fn nodata_in(&self, colors: usize, r: Rect) -> Result<Option<Vec<bool>>, GenError> {
        let Some(nodata) = self.nodata else { return Ok(None) };
        let mut all = vec![true; r.pixels()];
        for channel in 0..colors.min(self.channels()) {
            let bytes = self.file.read_band_window_bytes(self.index, channel, r.row, r.column, r.height, r.width);
            let bytes = bytes.map_err(|e| failed(&self.path, e))?;
            for (all, value) in all.iter_mut().zip(values(&bytes, &self.layout).into_iter().flatten()) {
                *all &= value == nodata;
            }
        }
        Ok(Some(all))
    }
}

fn is_alpha(kind: &ExtraSample) -> bool {
    matches!(kind, ExtraSample::AssociatedAlpha | ExtraSample::UnassociatedAlpha)
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
        (3, 2) => of(bytes, |b| f16::from_ne_bytes(b).to_f64()),
        (3, 4) => of(bytes, |b| f32::from_ne_bytes(b).into()),
        (3, 8) => of(bytes, f64::from_ne_bytes),
        _ => return None,
    })
}
