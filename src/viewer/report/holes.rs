//! [`HoleCheck`]: counts holes, background pixels where terrain must be. Runs on a captured image, on any thread.
//!
//! A ray must meet the terrain when it enters the set's volume through the ceiling (or starts inside) and leaves it
//! through the floor, both inside the footprint. Between the two it has crossed the surface, whatever its shape. Rays
//! beyond the set's rim may show background and are not counted.

use glam::{DMat3, DVec3};
use image::RgbaImage;

use crate::math::{BoundingVolume, Ellipsoid, OrientedBox, Region};
use crate::viewer::camera::Camera;
use crate::viewer::view::set_bounds::SetBounds;

/// The background colour while holes or coverage are counted, sRGB.
pub const KEY_COLOR: [u8; 3] = [255, 0, 255];

/// The fraction of the footprint at its rim that is skipped, because rays there graze the edge.
const RIM: f64 = 0.01;

/// The volume whose floor the terrain covers completely.
#[derive(Clone, Copy, Debug)]
pub struct HoleCheck {
    slab: Slab,
}

#[derive(Clone, Copy, Debug)]
enum Slab {
    /// A box as the unit cube's frame, with the third axis up.
    Box {
        unit_from_world: DMat3,
        center: DVec3,
        rim: f64,
    },
    Region(Region),
}

impl HoleCheck {
    /// Creates the check for a tile set; `None` when its bounds are only a sphere, which does not tell where terrain must be.
    pub fn new(bounds: &SetBounds) -> Option<Self> {
        let slab = match bounds.volume? {
            BoundingVolume::Region(region) => Slab::Region(region),
            BoundingVolume::Box(b) => box_slab(&b, bounds)?,
            BoundingVolume::Sphere(_) => return None,
        };
        Some(Self { slab })
    }

    /// Returns true when a ray must meet the terrain.
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
                // First what tells most rays apart: those into the sky.
                let Some(end) = ellipsoid_hit(&region.ellipsoid, eye, direction, region.min_height_m) else {
                    return false;
                };
                let height_m = region.ellipsoid.geodetic(eye).height_m;
                if height_m < region.min_height_m {
                    return false;
                }
                let above = height_m > region.max_height_m;
                let start = if above {
                    ellipsoid_hit(&region.ellipsoid, eye, direction, region.max_height_m)
                } else {
                    Some(0.0)
                };
                let inside = |t: f64| in_footprint(&region, eye + direction * t);
                start.is_some_and(inside) && inside(end)
            }
        }
    }

    /// Counts the background pixels of an image whose rays must meet the terrain.
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

/// Returns the fraction of pixels that are not background.
pub fn coverage(image: &RgbaImage, background: [u8; 3]) -> f64 {
    let total = u64::from(image.width()) * u64::from(image.height());
    let shown = image.pixels().filter(|p| p.0.first_chunk::<3>() != Some(&background)).count();
    shown as f64 / total.max(1) as f64
}

/// Creates the slab of a box, with the axis nearest to up as the third; `None` when the box is flat in another axis.
fn box_slab(b: &OrientedBox, bounds: &SetBounds) -> Option<Slab> {
    let up = bounds.frame.up();
    let mut axes = [b.half_axes.x_axis, b.half_axes.y_axis, b.half_axes.z_axis];
    axes.sort_by(|a, b| a.normalize_or_zero().dot(up).abs().total_cmp(&b.normalize_or_zero().dot(up).abs()));
    let [x, y, z] = axes;
    if x.length().min(y.length()) < 1e-9 {
        return None;
    }
    // A flat set still gets a ceiling and a floor, a millionth of its width from its middle.
    let height_m = z.length().max(1e-6 * x.length());
    let up_axis = if z.dot(up) < 0.0 { -z } else { z }.normalize_or(up) * height_m;
    let unit_from_world = DMat3::from_cols(x, y, up_axis).inverse();
    // A georeferenced set is curved and does not fill the corners of its box.
    let rim = if bounds.frame.is_georeferenced() { 0.1 } else { RIM };
    unit_from_world.is_finite().then_some(Slab::Box { unit_from_world, center: b.center, rim })
}

fn in_footprint(region: &Region, point: DVec3) -> bool {
    let g = region.ellipsoid.geodetic(point);
    let east = (g.longitude - region.west).rem_euclid(std::f64::consts::TAU) / region.width().max(1e-15);
    let north = (g.latitude - region.south) / (region.north - region.south).max(1e-15);
    (RIM..=1.0 - RIM).contains(&east) && (RIM..=1.0 - RIM).contains(&north)
}

/// Returns the distance along a ray to the surface `height_m` above the ellipsoid, approximated by an ellipsoid with longer
/// axes (accurate to a few millimetres at terrain heights).
fn ellipsoid_hit(ellipsoid: &Ellipsoid, eye: DVec3, direction: DVec3, height_m: f64) -> Option<f64> {
    let scale = (ellipsoid.radii_m() + height_m).recip();
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
    use crate::math::WGS84;
    use crate::viewer::ViewFrom;

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
        // A camera that looks at the sky has no ray that must hit.
        let up = bounds.frame.up();
        camera.look_at(camera.eye(), camera.eye() + up, bounds.frame.direction(0.0, 0.0));
        assert_eq!(check.count(&all, &camera, KEY_COLOR), 0);
    }

    #[test]
    fn rays_into_a_planar_set_must_hit() {
        let half_axes = DMat3::from_diagonal(DVec3::new(5000.0, 4000.0, 300.0));
        let volume = BoundingVolume::Box(OrientedBox { center: DVec3::new(0.0, 0.0, 200.0), half_axes });
        check(&SetBounds::new(volume.bounding_sphere(), Some(volume)));
    }

    #[test]
    fn rays_into_a_georeferenced_set_must_hit() {
        let region = Region {
            west: 0.139,
            south: 0.81,
            east: 0.142,
            north: 0.812,
            min_height_m: 300.0,
            max_height_m: 2000.0,
            ellipsoid: WGS84,
        };
        let volume = BoundingVolume::Region(region);
        check(&SetBounds::new(volume.bounding_sphere(), Some(volume)));
    }
}
