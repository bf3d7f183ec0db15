//! Counts holes: background pixels where terrain must be. Runs on a picture read back, on any thread.
//!
//! A ray must meet the terrain when it enters the set's volume through the ceiling (or starts inside) and leaves
//! it through the floor, both inside the footprint: between the two it has crossed the surface, whatever its
//! shape. Pixels beyond the set's rim, where background is right, are so left out without a guess.

use glam::{DMat3, DVec3};
use image::RgbaImage;

use super::camera::Camera;
use super::home::SetBounds;
use crate::math::{BoundingVolume, OrientedBox, Region, WGS84};

/// The colour that stands for background when holes or coverage are counted.
pub const KEY_COLOR: [u8; 3] = [255, 0, 255];

/// Share of the footprint at its rim that is not judged: the rim pixels' rays graze the edge.
const RIM: f64 = 0.01;

/// The part of space that terrain is known to seal from below.
#[derive(Clone, Copy, Debug)]
pub struct HoleCheck {
    slab: Slab,
}

#[derive(Clone, Copy, Debug)]
enum Slab {
    /// Unit-cube frame of a box whose third axis is up.
    Box {
        unit_from_world: DMat3,
        center: DVec3,
        rim: f64,
    },
    Region(Region),
}

impl HoleCheck {
    /// The check for a set; `None` when its bounds (a sphere alone) do not say where the terrain must be.
    pub fn new(bounds: &SetBounds) -> Option<Self> {
        let slab = match bounds.volume? {
            BoundingVolume::Region(region) => Slab::Region(region),
            BoundingVolume::Box(b) => box_slab(&b, bounds)?,
            BoundingVolume::Sphere(_) => return None,
        };
        Some(Self { slab })
    }

    /// True when a ray must meet the terrain.
    pub fn must_hit(&self, eye: DVec3, direction: DVec3) -> bool {
        match self.slab {
            Slab::Box { unit_from_world, center, rim } => {
                let (p, d) = (unit_from_world * (eye - center), unit_from_world * direction);
                if p.z < -1.0 || d.z >= -1e-12 {
                    return false;
                }
                let start = if p.z > 1.0 { p + d * ((1.0 - p.z) / d.z) } else { p };
                let end = p + d * ((-1.0 - p.z) / d.z);
                [start, end].iter().all(|q| q.x.abs().max(q.y.abs()) <= 1.0 - rim)
            }
            Slab::Region(region) => {
                if WGS84.geodetic(eye).height_m < region.min_height_m {
                    return false;
                }
                let inside = |t: f64| in_footprint(&region, eye + direction * t);
                let above = WGS84.geodetic(eye).height_m > region.max_height_m;
                let start = if above { ellipsoid_hit(eye, direction, region.max_height_m) } else { Some(0.0) };
                let end = ellipsoid_hit(eye, direction, region.min_height_m);
                matches!((start, end), (Some(a), Some(b)) if inside(a) && inside(b))
            }
        }
    }

    /// Background pixels of a picture whose rays must meet the terrain.
    pub fn count(&self, image: &RgbaImage, camera: &Camera, background: [u8; 3]) -> u64 {
        let size_px = [image.width(), image.height()];
        let is_background = |p: &image::Rgba<u8>| p.0.first_chunk::<3>() == Some(&background);
        image
            .enumerate_pixels()
            .filter(|(_, _, pixel)| is_background(pixel))
            .filter(|(x, y, _)| {
                let direction = camera.ray_direction(size_px, f64::from(*x) + 0.5, f64::from(*y) + 0.5);
                self.must_hit(camera.eye(), direction)
            })
            .count() as u64
    }
}

/// Share of pixels that are not background.
pub fn coverage(image: &RgbaImage, background: [u8; 3]) -> f64 {
    let total = u64::from(image.width()) * u64::from(image.height());
    let shown = image.pixels().filter(|p| p.0.first_chunk::<3>() != Some(&background)).count();
    shown as f64 / total.max(1) as f64
}

/// A box with the axis nearest to up as its third; `None` when it is flat in another axis.
fn box_slab(b: &OrientedBox, bounds: &SetBounds) -> Option<Slab> {
    let up = bounds.frame.up();
    let mut axes = [b.half_axes.x_axis, b.half_axes.y_axis, b.half_axes.z_axis];
    axes.sort_by(|a, b| a.normalize_or_zero().dot(up).abs().total_cmp(&b.normalize_or_zero().dot(up).abs()));
    let [x, y, z] = axes;
    if x.length().min(y.length()) < 1e-9 {
        return None;
    }
    // A flat set (or one declared flat) still has a ceiling and a floor, at the same height.
    let height_m = z.length().max(1e-6 * x.length());
    let up_axis = if z.dot(up) < 0.0 { -z } else { z }.normalize_or(up) * height_m;
    let unit_from_world = DMat3::from_cols(x, y, up_axis).inverse();
    // A curved set does not fill its box's corners.
    let rim = if bounds.frame.georeferenced { 0.1 } else { RIM };
    unit_from_world.is_finite().then_some(Slab::Box { unit_from_world, center: b.center, rim })
}

fn in_footprint(region: &Region, point: DVec3) -> bool {
    let g = WGS84.geodetic(point);
    let east = (g.longitude - region.west).rem_euclid(std::f64::consts::TAU) / region.width().max(1e-15);
    let north = (g.latitude - region.south) / (region.north - region.south).max(1e-15);
    (RIM..=1.0 - RIM).contains(&east) && (RIM..=1.0 - RIM).contains(&north)
}

/// Distance along a ray to the surface `height_m` above the ellipsoid, taken as the ellipsoid with longer axes
/// (true to a few millimetres at terrain heights).
fn ellipsoid_hit(eye: DVec3, direction: DVec3, height_m: f64) -> Option<f64> {
    let a = WGS84.semi_major_m + height_m;
    let scale = DVec3::new(1.0 / a, 1.0 / a, 1.0 / (WGS84.semi_minor_m + height_m));
    let (p, d) = (eye * scale, direction * scale);
    let (dd, pd, pp) = (d.dot(d), p.dot(d), p.dot(p) - 1.0);
    let root = (pd * pd - dd * pp).sqrt();
    let t = (-pd - root) / dd;
    // NaN when the ray misses.
    (t >= 0.0).then_some(t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::home::ViewFrom;

    fn check(bounds: &SetBounds) {
        let check = HoleCheck::new(bounds).unwrap();
        let mut camera = Camera { world_from_eye: bounds.first_camera(&ViewFrom::default()), ..Camera::default() };
        let size = [64, 36];
        let all = RgbaImage::from_pixel(size[0], size[1], image::Rgba([255, 0, 255, 255]));
        let judged = check.count(&all, &camera, KEY_COLOR);
        assert!(judged > 50 && judged < 64 * 36 / 2, "{judged}");
        assert!(check.must_hit(camera.eye(), camera.direction()));
        assert_eq!(check.count(&all, &camera, [0, 0, 0]), 0);
        assert_eq!(coverage(&all, KEY_COLOR), 0.0);
        // Turned to the sky nothing must be hit.
        let up = bounds.frame.up();
        camera.look_at(camera.eye(), camera.eye() + up, bounds.frame.direction(0.0, 0.0));
        assert_eq!(check.count(&all, &camera, KEY_COLOR), 0);
    }

    #[test]
    fn a_plane_set() {
        let half_axes = DMat3::from_diagonal(DVec3::new(5000.0, 4000.0, 300.0));
        let volume = BoundingVolume::Box(OrientedBox { center: DVec3::new(0.0, 0.0, 200.0), half_axes });
        check(&SetBounds::new(volume.bounding_sphere(), Some(volume)));
    }

    #[test]
    fn a_georeferenced_set() {
        let region =
            Region { west: 0.139, south: 0.81, east: 0.142, north: 0.812, min_height_m: 300.0, max_height_m: 2000.0 };
        let volume = BoundingVolume::Region(region);
        check(&SetBounds::new(volume.bounding_sphere(), Some(volume)));
    }
}
