//! Imagery files: RGBA rasters with a position on the earth, and smaller copies of them for coarse tiles.

use std::f64::consts::TAU;
use std::path::Path;

use crate::GenError;
use crate::georeference::{Crs, Placement, geotiff};
use crate::pyramid::Extent;
use crate::store::Rect;

/// Offsets to try for a longitude, in radians: imagery of the whole world may span 0 to 360 degrees.
const TURNS: [f64; 3] = [0.0, TAU, -TAU];

/// An image in memory, with its position on the earth.
pub(crate) struct Imagery {
    /// The image, and copies of it, each half as fine as the one before.
    levels: Vec<Level>,
    placement: Placement,
}

/// The pixels of an image, row-major, north row first. The opacity is straight.
struct Level {
    width: usize,
    height: usize,
    rgba: Vec<u8>,
}

impl Imagery {
    /// Reads an image file. `given` is the reference system of files that do not name their own. Pixels with the nodata
    /// value of the file, and those that its mask hides, are transparent.
    pub fn read(path: &Path, given: Option<Crs>) -> Result<Self, GenError> {
        GenError::if_not_regular(path)?;
        let is_tiff = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"));
        let (size, rgba, placement) = if is_tiff {
            let t = geotiff::Tiff::open(path)?;
            let placement = Placement::of_tiff(path, &t, given)?.unwrap_or_default();
            let all = Rect { column: 0, row: 0, width: t.width, height: t.height };
            ([t.width, t.height], t.rgba(all)?.into_flattened(), placement)
        } else {
            // The format is recognised by the content, because extensions may be wrong.
            let reader = image::ImageReader::open(path).and_then(|r| r.with_guessed_format());
            let image = reader.map_err(GenError::file(path))?.decode();
            let image = image.map_err(|e| GenError::invalid(path, e.to_string()))?;
            let size = [image.width() as usize, image.height() as usize];
            (size, image.into_rgba8().into_raw(), Placement::of_image(path, size, given)?)
        };
        let mut levels = vec![Level { width: size[0], height: size[1], rgba }];
        while let Some(coarser) = levels.last().and_then(Level::halved) {
            levels.push(coarser);
        }
        Ok(Self { levels, placement })
    }

    /// Returns true if the image overlaps `extent`. A grid of points of each is searched in the other.
    pub fn covers(&self, extent: &Extent) -> bool {
        let grid = (0..=32).flat_map(|j| (0..=32).map(move |i| [f64::from(i) / 32.0, f64::from(j) / 32.0]));
        let [width, height] = self.size();
        grid.into_iter().any(|[s, t]| {
            let longitude = extent.west + s * (extent.east - extent.west);
            let latitude = extent.south + t * (extent.north - extent.south);
            let [lon, lat] = self.placement.longitude_latitude(s * width, t * height);
            let is_within = |turn: &f64| (extent.west..=extent.east).contains(&(lon + turn));
            let inside = TURNS.iter().any(is_within) && (extent.south..=extent.north).contains(&lat);
            inside || self.at(longitude, latitude, 0).is_some()
        })
    }

    /// Returns the size of a pixel at the centre of the image, in radians of longitude and latitude.
    pub fn pixel_size(&self) -> [f64; 2] {
        let [width, height] = self.size();
        let at = |dx: f64, dy: f64| self.placement.longitude_latitude(0.5 * width + dx, 0.5 * height + dy);
        let [a, b, c] = [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)];
        [0, 1].map(|k| (b[k] - a[k]).hypot(c[k] - a[k]))
    }

    /// Returns the level for texels of a size in radians around the middle of `extent`: the one whose pixels are about as
    /// large.
    pub fn level(&self, extent: &Extent, texel: [f64; 2]) -> usize {
        let (longitude, latitude) = (0.5 * (extent.west + extent.east), 0.5 * (extent.south + extent.north));
        let at = |longitude: f64, latitude: f64| self.placement.pixel(longitude, latitude);
        let around = [at(longitude, latitude), at(longitude + texel[0], latitude), at(longitude, latitude + texel[1])];
        let [Some(a), Some(b), Some(c)] = around else { return 0 };
        let pixels = [b, c].map(|p| (p[0] - a[0]).hypot(p[1] - a[1])).into_iter().fold(1.0, f64::max);
        (pixels.log2().round() as usize).min(self.levels.len() - 1)
    }

    /// Returns the colour at a longitude and latitude in radians: sRGB, 0..255, and the opacity, 0..1. They are interpolated
    /// between the pixels of a level that are not transparent. `None` outside of the image, and if the nearest pixel is
    /// transparent.
    pub fn at(&self, longitude: f64, latitude: f64, level: usize) -> Option<[f64; 4]> {
        let [w, h] = self.size();
        let is_inside = |[c, r]: &[f64; 2]| (0.0..=w).contains(c) && (0.0..=h).contains(r);
        let [c, r] =
            TURNS.iter().find_map(|turn| self.placement.pixel(longitude + turn, latitude).filter(is_inside))?;
        let scale = 1.0 / (1u64 << level) as f64;
        self.levels.get(level)?.at(c * scale, r * scale)
    }

    /// Returns the width and height in pixels.
    fn size(&self) -> [f64; 2] {
        [self.levels[0].width as f64, self.levels[0].height as f64]
    }
}

impl Level {
    fn pixel(&self, x: usize, y: usize) -> [u8; 4] {
        let at = 4 * (y * self.width + x);
        self.rgba.get(at..at + 4).map_or([0; 4], |p| [p[0], p[1], p[2], p[3]])
    }

    /// Interpolates at a column and row; whole numbers are pixel corners.
    fn at(&self, column: f64, row: f64) -> Option<[f64; 4]> {
        let (w, h) = (self.width as f64, self.height as f64);
        let (x, y) = ((column - 0.5).clamp(0.0, w - 1.0), (row - 0.5).clamp(0.0, h - 1.0));
        let (x0, y0) = (x as usize, y as usize);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let (fx, fy) = (x - x0 as f64, y - y0 as f64);
        if self.pixel(if fx < 0.5 { x0 } else { x1 }, if fy < 0.5 { y0 } else { y1 })[3] == 0 {
            return None;
        }
        let corners = [(x0, y0, 1.0 - fx, 1.0 - fy), (x1, y0, fx, 1.0 - fy), (x0, y1, 1.0 - fx, fy), (x1, y1, fx, fy)];
        let (mut color, mut opacity, mut weights) = ([0.0; 3], 0.0, 0.0);
        for (x, y, wx, wy) in corners {
            let [r, g, b, alpha] = self.pixel(x, y).map(f64::from);
            if alpha > 0.0 {
                weights += wx * wy;
                opacity += wx * wy * alpha;
                for (sum, c) in color.iter_mut().zip([r, g, b]) {
                    *sum += wx * wy * alpha * c;
                }
            }
        }
        let [r, g, b] = color.map(|c| c / opacity);
        Some([r, g, b, opacity / (255.0 * weights)])
    }

    /// Returns the image at half the resolution: the average of 2 x 2 pixels, weighted by their opacity. `None` if it is
    /// a single pixel.
    fn halved(&self) -> Option<Self> {
        if self.width == 1 && self.height == 1 {
            return None;
        }
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let mut rgba = Vec::with_capacity(4 * width * height);
        for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (2 * x, 2 * y))) {
            let (mut color, mut opacity, mut count) = ([0u32; 3], 0, 0);
            for (x, y) in [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)] {
                if x < self.width && y < self.height {
                    let [r, g, b, alpha] = self.pixel(x, y).map(u32::from);
                    for (sum, c) in color.iter_mut().zip([r, g, b]) {
                        *sum += alpha * c;
                    }
                    opacity += alpha;
                    count += 1;
                }
            }
            let [r, g, b] = color.map(|c| ((c + opacity / 2) / opacity.max(1)) as u8);
            rgba.extend([r, g, b, ((opacity + count / 2) / count) as u8]);
        }
        Some(Self { width, height, rgba })
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
            assert_eq!(Imagery::read(&path, None).unwrap().levels[0].rgba[..4], [10, 20, 30, 255], "{name}");
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
        let at = |longitude: f64| imagery.at(longitude.to_radians(), 2f64.to_radians(), 0);
        assert_eq!([at(0.7), at(1.9), at(2.1), at(3.5)].map(|c| c.is_some()), [false, false, true, true]);
        for longitude in [2.1, 2.4, 2.5, 3.5] {
            let color = at(longitude).unwrap();
            assert_eq!(color[3], 1.0, "{longitude}");
            assert!(color.iter().zip([10.0, 20.0, 30.0]).all(|(c, e)| (c - e).abs() < 1e-9), "{longitude}: {color:?}");
        }
    }

    /// Regression: coarse tiles took single pixels of fine imagery.
    #[test]
    fn coarse_levels_are_averages_of_opaque_pixels() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checks.png");
        let check = |x: u32, y: u32| match (x / 4, (x + y) % 2) {
            (0, 0) => image::Rgba([200, 100, 0, 255]),
            (0, _) => image::Rgba([100, 0, 50, 255]),
            // Half of these pixels are transparent.
            (_, 0) => image::Rgba([80, 90, 70, 255]),
            _ => image::Rgba([0; 4]),
        };
        image::RgbaImage::from_fn(7, 7, check).save(&path).unwrap();
        std::fs::write(path.with_extension("pgw"), "1\n0\n0\n-1\n0.5\n6.5\n").unwrap();
        let imagery = Imagery::read(&path, None).unwrap();
        assert_eq!(
            imagery.levels.iter().map(|l| [l.width, l.height]).collect::<Vec<_>>(),
            [[7, 7], [4, 4], [2, 2], [1, 1]]
        );
        let at = |longitude: f64| imagery.at(longitude.to_radians(), 5f64.to_radians(), 1).unwrap();
        assert_eq!(at(1.0), [150.0, 50.0, 25.0, 1.0]);
        let [r, g, b, alpha] = at(5.0);
        assert_eq!([r, g, b], [80.0, 90.0, 70.0]);
        assert!((alpha - 0.5).abs() < 0.01, "{alpha}");
        // One pixel is 1 degree: tiles whose texels are 1.9 degrees wide take the level of 2 degrees.
        let extent = Extent { west: 0.0, south: 0.0, east: 7f64.to_radians(), north: 7f64.to_radians() };
        assert_eq!(
            [0.5, 1.1, 1.9, 4.2].map(|degrees: f64| imagery.level(&extent, [degrees.to_radians(); 2])),
            [0, 0, 1, 2]
        );
    }
}
