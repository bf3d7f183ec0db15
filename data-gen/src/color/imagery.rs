//! Imagery files: RGB rasters with a position on the earth.

use std::f64::consts::TAU;
use std::path::Path;

use tiff::decoder::DecodingResult;

use crate::GenError;
use crate::georeference::{Crs, Placement, geotiff};
use crate::pyramid::Extent;

/// Offsets to try for a longitude, in radians: imagery of the whole world may span 0 to 360 degrees.
const TURNS: [f64; 3] = [0.0, TAU, -TAU];

/// An RGB image in memory, with its position on the earth.
pub(crate) struct Imagery {
    width: usize,
    height: usize,
    channels: usize,
    /// True if the last channel is the opacity.
    has_alpha: bool,
    pixels: Vec<u8>,
    placement: Placement,
}

impl Imagery {
    /// Reads an image file. `given` is the reference system of files that do not name their own.
    pub fn read(path: &Path, given: Option<Crs>) -> Result<Self, GenError> {
        GenError::if_not_regular(path)?;
        let is_tiff = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"));
        if is_tiff {
            let t = geotiff::read(path)?;
            let placement = Placement::of_tiff(path, &t, given)?.unwrap_or_default();
            let DecodingResult::U8(pixels) = t.samples else {
                return Err(GenError::invalid(path, "imagery must have 8 bits per channel"));
            };
            let (width, height, channels) = (t.width, t.height, t.channels);
            let has_alpha = t.has_alpha && channels > 1;
            return Ok(Self { width, height, channels, has_alpha, pixels, placement });
        }
        // The format is recognised by the content, because extensions may be wrong.
        let reader = image::ImageReader::open(path).and_then(|r| r.with_guessed_format());
        let image = reader.map_err(GenError::file(path))?.decode();
        let image = image.map_err(|e| GenError::invalid(path, e.to_string()))?;
        let (width, height) = (image.width() as usize, image.height() as usize);
        let placement = Placement::of_image(path, [width, height], given)?;
        let has_alpha = image.color().has_alpha();
        let (channels, pixels) =
            if has_alpha { (4, image.into_rgba8().into_raw()) } else { (3, image.into_rgb8().into_raw()) };
        Ok(Self { width, height, channels, has_alpha, pixels, placement })
    }

    /// Returns true if the image overlaps `extent`. A grid of points of each is searched in the other.
    pub fn covers(&self, extent: &Extent) -> bool {
        let grid = (0..=32).flat_map(|j| (0..=32).map(move |i| [f64::from(i) / 32.0, f64::from(j) / 32.0]));
        grid.into_iter().any(|[s, t]| {
            let longitude = extent.west + s * (extent.east - extent.west);
            let latitude = extent.south + t * (extent.north - extent.south);
            let [lon, lat] = self.placement.longitude_latitude(s * self.width as f64, t * self.height as f64);
            let is_within = |turn: &f64| (extent.west..=extent.east).contains(&(lon + turn));
            let inside = TURNS.iter().any(is_within) && (extent.south..=extent.north).contains(&lat);
            inside || self.at(longitude, latitude).is_some()
        })
    }

    /// Returns the sRGB colour, 0..255, at a longitude and latitude in radians, interpolated between the pixels that are
    /// not transparent. `None` outside of the image, and if the nearest pixel is transparent.
    pub fn at(&self, longitude: f64, latitude: f64) -> Option<[f64; 3]> {
        let (w, h) = (self.width as f64, self.height as f64);
        let is_inside = |[c, r]: &[f64; 2]| (0.0..=w).contains(c) && (0.0..=h).contains(r);
        let [c, r] =
            TURNS.iter().find_map(|turn| self.placement.pixel(longitude + turn, latitude).filter(is_inside))?;
        let (x, y) = ((c - 0.5).clamp(0.0, w - 1.0), (r - 0.5).clamp(0.0, h - 1.0));
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (fx, fy) = (x - x0 as f64, y - y0 as f64);
        let nearest = (if fy < 0.5 { y0 } else { y1 }) * self.width + if fx < 0.5 { x0 } else { x1 };
        let is_opaque = |pixel: usize| !self.has_alpha || self.pixels.get((pixel + 1) * self.channels - 1) != Some(&0);
        if !is_opaque(nearest) {
            return None;
        }
        let around = [(x0, y0, 1.0 - fx, 1.0 - fy), (x1, y0, fx, 1.0 - fy), (x0, y1, 1.0 - fx, fy), (x1, y1, fx, fy)];
        let weights = around.map(|(x, y, wx, wy)| if is_opaque(y * self.width + x) { wx * wy } else { 0.0 });
        let sum: f64 = weights.iter().sum();
        let at = |x: usize, y: usize, k: usize| {
            let k = if self.channels < 3 { 0 } else { k };
            f64::from(self.pixels.get((y * self.width + x) * self.channels + k).copied().unwrap_or(0))
        };
        Some(
            [0, 1, 2].map(|k| {
                around.iter().zip(weights).map(|((x, y, ..), weight)| at(*x, *y, k) * weight).sum::<f64>() / sum
            }),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn format_is_recognised_by_content() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["image", "image.jpg"] {
            let path = folder.path().join(name);
            image::RgbImage::from_pixel(4, 4, image::Rgb([10, 20, 30]))
                .save_with_format(&path, image::ImageFormat::Png)
                .unwrap();
            assert_eq!(Imagery::read(&path, None).unwrap().pixels[..3], [10, 20, 30], "{name}");
        }
    }

    #[test]
    fn transparent_pixels_have_no_color() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("half.png");
        // Transparent pixels are black here; they must not darken their neighbours.
        let half = |x: u32, _| image::Rgba(if x < 2 { [0; 4] } else { [10, 20, 30, 255] });
        image::RgbaImage::from_fn(4, 4, half).save(&path).unwrap();
        std::fs::write(path.with_extension("pgw"), "1\n0\n0\n-1\n0.5\n3.5\n").unwrap();
        let imagery = Imagery::read(&path, None).unwrap();
        let at = |longitude: f64| imagery.at(longitude.to_radians(), 2f64.to_radians());
        assert_eq!([at(0.7), at(1.9), at(2.1), at(3.5)].map(|c| c.is_some()), [false, false, true, true]);
        for longitude in [2.1, 2.4, 2.5, 3.5] {
            let color = at(longitude).unwrap();
            assert!(color.iter().zip([10.0, 20.0, 30.0]).all(|(c, e)| (c - e).abs() < 1e-9), "{longitude}: {color:?}");
        }
    }
}
