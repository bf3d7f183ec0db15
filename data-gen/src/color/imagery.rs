//! Imagery files: RGBA images with a position on the earth, read by blocks, and smaller copies of them for coarse tiles.

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;
use terrane::math::Ellipsoid;

use super::files;
use super::levels::{Level, Opened, completed};
use crate::georeference::{Crs, DatumGrid, Placement};
use crate::store::{BlockCache, Cursor, is_remote};
use crate::{Extent, GenError};

/// Offsets to try for a longitude, in radians: imagery of the whole world may span 0 to 360 degrees.
const TURNS: [f64; 3] = [0.0, TAU, -TAU];
/// Images in the order of their priority. Where an image is transparent, the next one is seen.
pub(crate) struct Imagery {
    images: Vec<Image>,
}

/// An image with its position on the earth.
struct Image {
    path: PathBuf,
    /// The image, and copies of it, each about half as fine as the one before.
    levels: Vec<Level>,
    placement: Placement,
    is_remote: bool,
}

impl Imagery {
    /// Opens image files. `given` is the reference system of files that do not name their own, `grid` shifts
    /// datums to WGS84. Pixels with the nodata value of
    /// a file, and those that its mask hides, are transparent.
    pub fn open(
        paths: &[PathBuf],
        given: Option<&Crs>,
        grid: Option<&DatumGrid>,
        cache: &Arc<BlockCache>,
    ) -> Result<Self, GenError> {
        let images = paths.par_iter().map(|path| Image::open(path, given.cloned(), grid, cache));
        Ok(Self { images: images.collect::<Result<_, _>>()? })
    }

    /// Returns true if an image overlaps `extent`. A grid of points of each is searched in the other.
    pub fn covers(&self, extent: &Extent) -> Result<bool, GenError> {
        for image in &self.images {
            if image.covers(extent)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Returns the ellipsoids that the reference systems of images name.
    pub fn ellipsoids(&self) -> impl Iterator<Item = Ellipsoid> {
        self.images.iter().filter_map(|image| image.placement.ellipsoid())
    }

    /// Returns notes about images without a georeference, whose placement was assumed.
    pub fn notes(&self) -> impl Iterator<Item = String> {
        self.images.iter().filter_map(|image| image.placement.note(&image.path))
    }

    /// Returns the size of the smallest pixel at the centre of an image, in radians of longitude and latitude.
    pub fn pixel_size(&self) -> [f64; 2] {
        let sizes = self.images.iter().map(Image::pixel_size);
        sizes.fold([f64::INFINITY; 2], |a, b| [a[0].min(b[0]), a[1].min(b[1])])
    }

    /// Returns the bounds of each image, found at points on its edges: west, south, east and north in radians.
    pub fn bounds(&self) -> Vec<[f64; 4]> {
        self.images.iter().map(Image::bounds).collect()
    }

    /// Returns a sampler for texels of a size in radians inside `extent`, on one thread.
    pub fn sampler(&self, extent: &Extent, texel: [f64; 2]) -> ImagerySampler<'_> {
        let layer = |image: &'_ Image| image.level(extent, texel);
        let layers = self.images.iter().map(|image| {
            let level = layer(image);
            image.read_ahead(extent, level);
            (image, level, Cursor::new(&image.levels[level].image))
        });
        ImagerySampler { layers: layers.collect() }
    }
}

/// Samples imagery for one tile.
pub(crate) struct ImagerySampler<'a> {
    /// Each image with the level that is sampled.
    layers: Vec<(&'a Image, usize, Cursor<'a>)>,
}

impl ImagerySampler<'_> {
    /// Returns the colour at a longitude and latitude in radians: sRGB, 0..255, and the opacity, 0..1. They are interpolated
    /// between the pixels that are not transparent. `None` outside of the images, and where the nearest pixels are
    /// transparent.
    pub fn at(&mut self, longitude: f64, latitude: f64) -> Result<Option<[f64; 4]>, GenError> {
        // The colours above, multiplied by their opacity.
        let mut above = [0.0; 4];
        for (image, level, cursor) in &mut self.layers {
            let Some([r, g, b, opacity]) = image.at(cursor, longitude, latitude, *level)? else { continue };
            let seen = (1.0 - above[3]) * opacity;
            above = [above[0] + seen * r, above[1] + seen * g, above[2] + seen * b, above[3] + seen];
            if above[3] >= 1.0 {
                break;
            }
        }
        let [r, g, b, opacity] = above;
        Ok((opacity > 0.0).then(|| [r / opacity, g / opacity, b / opacity, opacity]))
    }
}

impl Image {
    fn open(
        path: &Path,
        given: Option<Crs>,
        grid: Option<&DatumGrid>,
        cache: &Arc<BlockCache>,
    ) -> Result<Self, GenError> {
        let Opened { levels, mut placement } = files::open(path, given, cache)?;
        if let Some(grid) = grid {
            let size = levels.first().map_or([1; 2], |level| level.image.grid().size);
            placement = placement.shifted_by(grid, size).map_err(|reason| GenError::invalid(path, reason))?;
        }
        Ok(Self { path: path.to_owned(), levels: completed(levels, cache), placement, is_remote: is_remote(path) })
    }

    /// Reads the blocks of a level inside of a rectangle, several at the same time, if the image is on a server.
    fn read_ahead(&self, extent: &Extent, level: usize) {
        if !self.is_remote {
            return;
        }
        let level = &self.levels[level];
        let parts = (0..=8).map(|k| f64::from(k) / 8.0);
        let places = parts.clone().flat_map(|s| parts.clone().map(move |t| [s, t])).filter_map(|[s, t]| {
            let longitude = extent.west + s * (extent.east - extent.west);
            let [c, r] = self.placement.pixel(longitude, extent.south + t * (extent.north - extent.south))?;
            Some([0, 1].map(|axis| level.origin[axis] + [c, r][axis] * level.scale[axis]))
        });
        let ends = places.fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |e, [c, r]| {
            [e[0].min(c), e[1].min(r), e[2].max(c), e[3].max(r)]
        });
        let [width, height] = level.image.grid().size.map(|side| side as f64);
        if ends[0] <= width && ends[1] <= height && ends[2] >= 0.0 && ends[3] >= 0.0 {
            // Casts of numbers clamp them.
            level.image.read_ahead(ends[0] as usize..=ends[2] as usize, ends[1] as usize..=ends[3] as usize);
        }
    }

    fn covers(&self, extent: &Extent) -> Result<bool, GenError> {
        let grid = (0..=32).flat_map(|j| (0..=32).map(move |i| [f64::from(i) / 32.0, f64::from(j) / 32.0]));
        let [width, height] = self.size();
        let mut cursor = Cursor::new(&self.levels[0].image);
        for [s, t] in grid {
            let longitude = extent.west + s * (extent.east - extent.west);
            let latitude = extent.south + t * (extent.north - extent.south);
            let [lon, lat] = self.placement.longitude_latitude(s * width, t * height);
            let is_within = |turn: &f64| (extent.west..=extent.east).contains(&(lon + turn));
            let inside = TURNS.iter().any(is_within) && (extent.south..=extent.north).contains(&lat);
            if inside || self.at(&mut cursor, longitude, latitude, 0)?.is_some() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn bounds(&self) -> [f64; 4] {
        let [width, height] = self.size();
        let sides = (0..=32).map(|k| f64::from(k) / 32.0).flat_map(|t| [[t, 0.0], [t, 1.0], [0.0, t], [1.0, t]]);
        let places = sides.map(|[s, t]| self.placement.longitude_latitude(s * width, t * height));
        places.fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |[w, s, e, n], [lon, lat]| {
            [w.min(lon), s.min(lat), e.max(lon), n.max(lat)]
        })
    }

    fn pixel_size(&self) -> [f64; 2] {
        let [width, height] = self.size();
        let at = |dx: f64, dy: f64| self.placement.longitude_latitude(0.5 * width + dx, 0.5 * height + dy);
        let [a, b, c] = [at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)];
        [0, 1].map(|k| (b[k] - a[k]).hypot(c[k] - a[k]))
    }

    /// Returns the level for texels of a size in radians around the middle of `extent`: the one whose pixels are about as
    /// large.
    fn level(&self, extent: &Extent, texel: [f64; 2]) -> usize {
        let (longitude, latitude) = (0.5 * (extent.west + extent.east), 0.5 * (extent.south + extent.north));
        let at = |longitude: f64, latitude: f64| self.placement.pixel(longitude, latitude);
        let around = [at(longitude, latitude), at(longitude + texel[0], latitude), at(longitude, latitude + texel[1])];
        let [Some(a), Some(b), Some(c)] = around else { return 0 };
        let pixels = [b, c].map(|p| (p[0] - a[0]).hypot(p[1] - a[1])).into_iter().fold(1.0, f64::max);
        let far = |level: &usize| (self.levels[*level].coarseness().log2() - pixels.log2()).abs();
        (0..self.levels.len()).min_by(|a, b| far(a).total_cmp(&far(b))).unwrap_or(0)
    }

    /// Returns the colour at a longitude and latitude in radians of a level whose cursor is given.
    fn at(
        &self,
        cursor: &mut Cursor<'_>,
        longitude: f64,
        latitude: f64,
        level: usize,
    ) -> Result<Option<[f64; 4]>, GenError> {
        let [w, h] = self.size();
        let is_inside = |[c, r]: &[f64; 2]| (0.0..=w).contains(c) && (0.0..=h).contains(r);
        let mut found = TURNS.iter().filter_map(|turn| self.placement.pixel(longitude + turn, latitude));
        let Some([c, r]) = found.find(is_inside) else { return Ok(None) };
        let level = &self.levels[level];
        let [column, row] = [0, 1].map(|axis| level.origin[axis] + [c, r][axis] * level.scale[axis]);
        interpolate(cursor, level.image.grid().size, column, row)
    }

    /// Returns the width and height in pixels.
    fn size(&self) -> [f64; 2] {
        self.levels[0].image.grid().size.map(|side| side as f64)
    }
}

/// Interpolates at a column and row; whole numbers are pixel corners.
fn interpolate(
    cursor: &mut Cursor<'_>,
    [width, height]: [usize; 2],
    column: f64,
    row: f64,
) -> Result<Option<[f64; 4]>, GenError> {
    let (w, h) = (width as f64, height as f64);
    let (x, y) = ((column - 0.5).clamp(0.0, w - 1.0), (row - 0.5).clamp(0.0, h - 1.0));
    let (x0, y0) = (x as usize, y as usize);
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    let (fx, fy) = (x - x0 as f64, y - y0 as f64);
    let pixels = cursor.corners([x0, x1], [y0, y1])?.map(u32::to_ne_bytes);
    let nearest = pixels[usize::from(fx >= 0.5) + 2 * usize::from(fy >= 0.5)];
    if nearest[3] == 0 {
        return Ok(None);
    }
    let shares = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
    let (mut color, mut opacity, mut weights) = ([0.0; 3], 0.0, 0.0);
    for (pixel, share) in pixels.into_iter().zip(shares) {
        let [r, g, b, alpha] = pixel.map(f64::from);
        if alpha > 0.0 {
            weights += share;
            opacity += share * alpha;
            for (sum, c) in color.iter_mut().zip([r, g, b]) {
                *sum += share * alpha * c;
            }
        }
    }
    let [r, g, b] = color.map(|c| c / opacity);
    Ok(Some([r, g, b, opacity / (255.0 * weights)]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(path: &Path) -> Imagery {
        Imagery::open(&[path.to_owned()], None, None, &Arc::new(BlockCache::new(1 << 20))).unwrap()
    }

    /// Samples a level of the first image at a position in degrees.
    fn at_level(imagery: &Imagery, longitude: f64, latitude: f64, level: usize) -> Option<[f64; 4]> {
        let image = &imagery.images[0];
        let mut cursor = Cursor::new(&image.levels[level].image);
        image.at(&mut cursor, longitude.to_radians(), latitude.to_radians(), level).unwrap()
    }

    #[test]
    fn blocks_of_smaller_copies_are_averages_and_are_computed_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large.png");
        // Larger than a block in memory, and not a multiple of the blocks' sides.
        let pixel = |x: u32, y: u32| image::Rgb([(x / 8) as u8, (y / 8) as u8, ((x + y) % 2 * 200) as u8]);
        image::RgbImage::from_fn(1030, 1100, pixel).save(&path).unwrap();
        // No block stays in the cache.
        let imagery = Imagery::open(&[path], None, None, &Arc::new(BlockCache::new(0))).unwrap();
        let levels = &imagery.images[0].levels;
        for _ in 0..2 {
            for (level, x, y) in [(1, 0, 0), (1, 514, 549), (1, 255, 256), (2, 100, 200), (3, 128, 137)] {
                let [r, g, b, alpha] = Cursor::new(&levels[level].image).pixel(x, y).unwrap().to_ne_bytes();
                let expected = [(x << level) / 8, (y << level) / 8].map(|v| v as u8);
                assert_eq!(([r, g], b, alpha), (expected, 100, 255), "{level} {x} {y}");
            }
        }
    }

    #[test]
    fn images_below_are_seen_through_transparent_ones() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, pixel: [u8; 4], west: f64| {
            let path = folder.path().join(name);
            image::RgbaImage::from_pixel(2, 2, image::Rgba(pixel)).save(&path).unwrap();
            std::fs::write(path.with_extension("pgw"), format!("1\n0\n0\n-1\n{west}\n1.5\n")).unwrap();
            path
        };
        let paths = [write("above.png", [200, 0, 0, 51], 0.5), write("below.png", [0, 100, 0, 255], 1.5)];
        let imagery = Imagery::open(&paths, None, None, &Arc::new(BlockCache::new(1 << 20))).unwrap();
        let extent = Extent { west: 0.0, south: 0.0, east: 0.05, north: 0.03 };
        let mut sampler = imagery.sampler(&extent, [0.01; 2]);
        let mut at = |longitude: f64| sampler.at(longitude.to_radians(), 1f64.to_radians()).unwrap();
        assert_eq!(at(0.5), Some([200.0, 0.0, 0.0, 0.2]));
        let [r, g, b, opacity] = at(1.5).unwrap();
        assert!((r - 40.0).abs() < 1e-9 && (g - 80.0).abs() < 1e-9 && b == 0.0 && (opacity - 1.0).abs() < 1e-9);
        assert_eq!(at(2.5), Some([0.0, 100.0, 0.0, 1.0]));
        assert_eq!(at(3.5), None);
    }

    #[test]
    fn format_is_recognised_by_content() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["image", "image.jpg"] {
            let path = folder.path().join(name);
            image::RgbImage::from_pixel(4, 4, image::Rgb([10, 20, 30]))
                .save_with_format(&path, image::ImageFormat::Png)
                .unwrap();
            let imagery = open(&path);
            let mut cursor = Cursor::new(&imagery.images[0].levels[0].image);
            assert_eq!(cursor.pixel(0, 0).unwrap().to_ne_bytes(), [10, 20, 30, 255], "{name}");
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
        let imagery = open(&path);
        let at = |longitude: f64| at_level(&imagery, longitude, 2.0, 0);
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
        let imagery = open(&path);
        let image = &imagery.images[0];
        assert_eq!(
            image.levels.iter().map(|l| l.image.grid().size).collect::<Vec<_>>(),
            [[7, 7], [4, 4], [2, 2], [1, 1]]
        );
        let at = |longitude: f64| at_level(&imagery, longitude, 5.0, 1).unwrap();
        assert_eq!(at(1.0), [150.0, 50.0, 25.0, 1.0]);
        let [r, g, b, alpha] = at(5.0);
        assert_eq!([r, g, b], [80.0, 90.0, 70.0]);
        assert!((alpha - 0.5).abs() < 0.01, "{alpha}");
        // One pixel is 1 degree: tiles whose texels are 1.9 degrees wide take the level of 2 degrees.
        let extent = Extent { west: 0.0, south: 0.0, east: 7f64.to_radians(), north: 7f64.to_radians() };
        assert_eq!(
            [0.5, 1.1, 1.9, 4.2].map(|degrees: f64| image.level(&extent, [degrees.to_radians(); 2])),
            [0, 0, 1, 2]
        );
    }
}
