//! Declared volumes of tiles as the tile walk reads them: 32 bytes a tile, two to a line of the cache. Plain values, made
//! when a page is flattened and read by cull and by intersections, on any thread.
//!
//! ```text
//! place   3 x i32   centre, in steps of the page's grid
//!         1 x i32   0: a box along the frame, above: index of the box's axes, below: a sphere
//! extent  3 x f32   half the length along each axis, metres; of a sphere its radius
//!         1 x f32   geometric error, or range, metres
//! ```
//! Steps are a power of two so small that all centres fit: 2^-15 m for a terrain of 20 km, 2^-7 m (8 mm) around the earth.
//! What lies between two steps is moved to one, and its volume made larger by a step, so that it holds what it held.
//! The offset from the eye is a difference of whole numbers, exact before it is rounded to f32.

use glam::{DMat3, DVec3, Vec3, Vec4};

use super::page::UNBOUNDED;
use crate::math::{BoundingSphere, OrientedBox};

/// Unit axes of a box.
pub(crate) type BoxAxes = [[f32; 3]; 3];

/// Axes of boxes along the frame's own, mostly of all tiles of a map in a plane.
pub(super) const ALONG_FRAME: BoxAxes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// In the place of axes' index.
const ALONG: i32 = 0;
const SPHERE: i32 = -1;

/// Places are so many steps from the grid's origin at most, so that the difference of two is no overflow.
const MOST_STEPS: f64 = (1 << 30) as f64;
/// Steps are no smaller: a micrometre.
const LEAST_STEP_M: f64 = 1.0 / (1 << 20) as f64;

/// Declared volume of a tile in the tile frame; see the module.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct TileBounds {
    place: [i32; 4],
    extent: [f32; 4],
}

/// The same before the grid of a page is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct DeclaredBounds {
    pub center: DVec3,
    pub half_m: [f64; 3],
    /// As in [`TileBounds`].
    axes: i32,
    pub metric_m: f32,
}

/// Where the places of a page's tiles are counted from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileGrid {
    origin: DVec3,
    step_m: f64,
}

/// The eye in the frame of tiles, as their bounds are read from it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileEye {
    /// Steps from the grid's origin.
    place: [i32; 4],
    /// From there to the eye, metres.
    rest_m: Vec4,
    /// 0 for what is no coordinate.
    step_m: Vec4,
    /// Where it is, f64.
    pub position: DVec3,
}

impl Default for TileGrid {
    fn default() -> Self {
        Self { origin: DVec3::ZERO, step_m: LEAST_STEP_M }
    }
}

impl TileGrid {
    /// A grid that holds all centres.
    pub(super) fn around(bounds: &[DeclaredBounds]) -> Self {
        let ends = bounds.iter().fold(None, |ends: Option<(DVec3, DVec3)>, b| {
            let (min, max) = ends.unwrap_or((b.center, b.center));
            Some((min.min(b.center), max.max(b.center)))
        });
        let Some((min, max)) = ends else { return Self::default() };
        // As a part of two differences, which overflow for no finite number.
        let reach_m = (max * 0.5 - min * 0.5).max_element();
        let step_m = (reach_m / (0.99 * MOST_STEPS)).log2().ceil().exp2().max(LEAST_STEP_M);
        // On the grid itself, so that what lies on it stays there.
        let origin = ((max * 0.5 + min * 0.5) / step_m).round() * step_m;
        Self { origin, step_m }
    }

    /// Steps from the origin, none beyond the grid.
    fn place(&self, point: DVec3) -> [i32; 3] {
        let steps = ((point - self.origin) / self.step_m).round();
        // What is no number is 0.
        steps.to_array().map(|steps| steps.clamp(-MOST_STEPS, MOST_STEPS) as i32)
    }

    fn point(&self, place: [i32; 3]) -> DVec3 {
        self.origin + DVec3::from_array(place.map(f64::from)) * self.step_m
    }

    /// A tile's volume on the grid.
    pub(super) fn fit(&self, declared: &DeclaredBounds) -> TileBounds {
        let [x, y, z] = self.place(declared.center);
        let moved = self.point([x, y, z]) != declared.center;
        let slack_m = if moved { self.step_m } else { 0.0 };
        let [a, b, c] = declared.half_m.map(|half_m| round_up(half_m + slack_m));
        TileBounds { place: [x, y, z, declared.axes], extent: [a, b, c, declared.metric_m] }
    }

    /// The centre of a tile's volume, tile frame.
    pub fn center(&self, bounds: &TileBounds) -> DVec3 {
        let [x, y, z, _] = bounds.place;
        self.point([x, y, z])
    }

    /// An eye in the tile frame.
    pub fn eye(&self, position: DVec3) -> TileEye {
        let [x, y, z] = self.place(position);
        let rest_m = (position - self.point([x, y, z])).as_vec3();
        let step_m = self.step_m as f32;
        TileEye {
            place: [x, y, z, 0],
            rest_m: rest_m.extend(0.0),
            step_m: Vec4::new(step_m, step_m, step_m, 0.0),
            position,
        }
    }
}

impl DeclaredBounds {
    /// A sphere, or the box in it. What is NaN or infinite becomes unbounded: always visible, at distance 0. `axes_index`
    /// finds or keeps a box's axes.
    pub fn new(
        sphere: &BoundingSphere,
        oriented_box: Option<&OrientedBox>,
        metric_m: f64,
        axes_index: impl FnOnce(BoxAxes) -> u32,
    ) -> Self {
        let metric_m = if metric_m > 0.0 { metric_m as f32 } else { 0.0 };
        let unbounded = f64::from(UNBOUNDED);
        let usable = sphere.center.is_finite() && sphere.radius_m >= 0.0 && sphere.radius_m < unbounded;
        if !usable {
            return Self { center: DVec3::ZERO, half_m: [unbounded; 3], axes: SPHERE, metric_m };
        }
        match oriented_box {
            Some(b) if b.half_axes != DMat3::ZERO => {
                let (axes, half_m) = unit_axes(&b.half_axes);
                let axes = axes_index(axes.map(|axis| axis.as_vec3().to_array()));
                Self { center: b.center, half_m, axes: axes.try_into().unwrap_or(ALONG), metric_m }
            }
            _ => Self { center: sphere.center, half_m: [sphere.radius_m; 3], axes: SPHERE, metric_m },
        }
    }
}

impl TileBounds {
    #[inline(always)]
    pub fn is_sphere(&self) -> bool {
        self.place[3] == SPHERE
    }

    /// A box along the axes of the frame.
    #[inline(always)]
    pub fn is_along_frame(&self) -> bool {
        self.place[3] == ALONG
    }

    /// Index of a box's axes.
    pub(super) fn axes(&self) -> usize {
        self.place[3].max(ALONG) as usize
    }

    /// Half the length along each axis, or the radius; metres, and something else behind.
    #[inline(always)]
    pub fn extent(&self) -> Vec4 {
        Vec4::from_array(self.extent)
    }

    /// Half the length along each axis, metres.
    #[inline(always)]
    pub fn half_m(&self) -> [f32; 3] {
        let [x, y, z, _] = self.extent;
        [x, y, z]
    }

    /// Of a sphere around it; [`UNBOUNDED`] or more where there is none.
    #[inline(always)]
    pub fn radius_m(&self) -> f32 {
        // Rounded, as the root may be.
        if self.is_sphere() { self.extent[0] } else { self.radius2_m2().sqrt() * (1.0 + f32::EPSILON) }
    }

    /// Its square, which is not rounded up; infinite where there is none.
    #[inline(always)]
    pub fn radius2_m2(&self) -> f32 {
        let [x, y, z, _] = self.extent;
        if self.is_sphere() { x * x } else { x * x + y * y + z * z }
    }

    /// Geometric error or range, metres.
    #[inline(always)]
    pub fn metric_m(&self) -> f32 {
        self.extent[3]
    }
}

impl TileEye {
    /// Offset of a tile's centre in steps, from the eye's own place on the grid; something else behind.
    #[inline(always)]
    pub fn steps_to(&self, bounds: &TileBounds) -> Vec4 {
        let steps: [f32; 4] = std::array::from_fn(|k| bounds.place[k].wrapping_sub(self.place[k]) as f32);
        Vec4::from_array(steps)
    }

    /// Offset of a tile's centre, metres; 0 behind.
    #[inline(always)]
    pub fn offset_to(&self, bounds: &TileBounds) -> Vec4 {
        self.steps_to(bounds) * self.step_m - self.rest_m
    }

    /// Length of a step, metres.
    pub fn step_m(&self) -> f32 {
        self.step_m.x
    }

    /// From its place on the grid to the eye, metres.
    pub fn rest_m(&self) -> Vec3 {
        self.rest_m.truncate()
    }
}

/// The next f32 above a length, so that rounding never makes a volume smaller.
fn round_up(length_m: f64) -> f32 {
    (length_m * (1.0 + 2.0 * f64::from(f32::EPSILON))) as f32
}

/// Directions and lengths of half axes; axes of zero length get a direction perpendicular to the others.
fn unit_axes(half_axes: &DMat3) -> ([DVec3; 3], [f64; 3]) {
    let given = [half_axes.x_axis, half_axes.y_axis, half_axes.z_axis];
    let half = given.map(|a| a.length());
    let mut axes = given.map(|a| a.try_normalize());
    for k in 0..3 {
        if axes[k].is_none() {
            let (a, b) = (axes[(k + 1) % 3], axes[(k + 2) % 3]);
            axes[k] = match (a, b) {
                (Some(a), Some(b)) => a.cross(b).try_normalize(),
                (Some(a), None) | (None, Some(a)) => Some(a.any_orthonormal_vector()),
                (None, None) => Some(DVec3::X),
            };
        }
    }
    (axes.map(|a| a.unwrap_or(DVec3::X)), half)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sphere(center: DVec3, radius_m: f64) -> DeclaredBounds {
        DeclaredBounds::new(&BoundingSphere::new(center, radius_m), None, 1.0, |_| 0)
    }

    #[test]
    fn two_lie_in_a_line_of_the_cache() {
        assert_eq!((size_of::<TileBounds>(), align_of::<TileBounds>()), (32, 32));
    }

    proptest! {
        /// Volumes hold what they held, and offsets are as exact as those of f64 that are rounded.
        #[test]
        fn what_was_inside_is_inside(
            scale in prop::sample::select(vec![1e-3, 1.0, 2e4, 6.4e6, 1e12, 1e30]),
            points in prop::collection::vec(prop::array::uniform3(-1.0..1.0f64), 1..20),
            eye in prop::array::uniform3(-1.5..1.5f64),
            (radius, direction) in (0.0..1.0f64, prop::array::uniform3(-1.0..1.0f64)),
        ) {
            let (points, eye) = (points.iter().map(|p| DVec3::from_array(*p) * scale), DVec3::from_array(eye) * scale);
            let declared: Vec<DeclaredBounds> = points.map(|center| sphere(center, radius * 1e-6 * scale)).collect();
            let grid = TileGrid::around(&declared);
            let seen = grid.eye(eye);
            for declared in &declared {
                let bounds = grid.fit(declared);
                let center = grid.center(&bounds);
                prop_assert!((center - declared.center).length() <= 0.87 * grid.step_m + 1e-15 * scale);
                let on_it = declared.center + DVec3::from_array(direction).normalize_or_zero() * declared.half_m[0];
                let reach_m = f64::from(bounds.radius_m()) + 1e-15 * scale;
                prop_assert!((on_it - center).length() <= reach_m, "{on_it} {center} {reach_m}");
                let offset = seen.offset_to(&bounds);
                let error = (offset.truncate().as_dvec3() - (center - eye)).length();
                prop_assert!(error <= 3.0 * f64::from(f32::EPSILON) * (center - eye).length(), "{error}");
                prop_assert_eq!(offset.w, 0.0);
            }
        }
    }

    /// An eye beyond the grid sees what an eye in it sees.
    #[test]
    fn eyes_may_be_anywhere() {
        let declared = [sphere(DVec3::ZERO, 1.0), sphere(DVec3::splat(1000.0), 1.0)];
        let grid = TileGrid::around(&declared);
        for eye in [DVec3::splat(1e7), DVec3::new(-1e15, 0.0, 3.0), DVec3::splat(f64::MAX)] {
            for declared in &declared {
                let (offset, exact) = (grid.eye(eye).offset_to(&grid.fit(declared)), (declared.center - eye).as_vec3());
                let error = (offset.truncate() - exact).length();
                assert!(error <= 1e-6 * exact.length() || !exact.length().is_finite(), "{eye} {offset} {exact}");
            }
        }
        // No number is no panic.
        let offset = grid.eye(DVec3::NAN).offset_to(&grid.fit(&declared[0]));
        assert!(offset.truncate().is_nan());
    }

    #[test]
    fn whole_metres_stay_where_they_are() {
        let declared: Vec<_> = (0..100).map(|k| sphere(DVec3::new(f64::from(k) * 625.0, 0.5, -7.25), 300.0)).collect();
        let grid = TileGrid::around(&declared);
        for declared in &declared {
            let bounds = grid.fit(declared);
            assert_eq!(grid.center(&bounds), declared.center);
            assert!((bounds.radius_m() - 300.0).abs() < 1e-3, "no larger than it was");
        }
    }
}
