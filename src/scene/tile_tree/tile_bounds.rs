//! Declared volumes of tiles as the tile walk reads them: 32 bytes a tile, two to a cache line. Plain values, made when a
//! page is built and read by culls and intersections on any thread.
//!
//! ```text
//! steps   3 x i32   centre, in steps of the page's grid
//!         1 x i32   0: a box along the frame; positive: index of the box's axes; negative: a sphere
//! extent  3 x f32   half the length along each axis, metres; of a sphere its radius
//!         1 x f32   geometric error, or range, metres
//! ```
//! A step is the smallest power of two with which all centres fit: 2^-15 m for a terrain of 20 km, 2^-7 m (8 mm) around
//! the earth. A centre between two steps is moved to one of them, and its volume is enlarged by a step, so that it still
//! holds everything. The offset from the eye is a difference of integers, exact before it is rounded to f32.

use glam::{DMat3, DVec3, Vec3, Vec4};

use super::tile_contents::taken;
use crate::math::{BoundingSphere, OrientedBox};
use crate::scene::pages::UNBOUNDED;

/// Unit axes of a box.
pub(crate) type BoxAxes = [[f32; 3]; 3];

/// The axes of boxes along the frame's own. All tiles of a flat map usually have them.
const ALONG_FRAME: BoxAxes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Stands for a box along the frame instead of an index of axes.
const ALONG: i32 = 0;
/// Stands for a sphere instead of an index of axes.
const SPHERE: i32 = -1;

/// The largest number of steps from the grid's origin; the difference of two positions must not overflow.
const MAX_STEPS: f64 = (1 << 30) as f64;
/// A box is skewed if the cosine of the angle between two of its axes is larger; rounding alone stays below.
const MIN_SKEW: f64 = 1e-6;
/// Steps up to this length make no tile noticeably larger.
const FINE_STEP_M: f64 = 1.0;
/// If steps would be longer than [`FINE_STEP_M`], centres are left out whose distance from the middle is larger than the
/// median distance by this factor.
const FAR_FACTOR: f64 = 65536.0;
/// The length of the smallest step: a micrometre.
const MIN_STEP_M: f64 = 1.0 / (1 << 20) as f64;

/// The declared volume of a tile in the tile frame; see the module for the layout.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct TileBounds {
    steps: [i32; 4],
    extent: [f32; 4],
}

/// A declared volume before the grid of the page is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct DeclaredBounds {
    pub center: DVec3,
    pub half_m: [f64; 3],
    /// An index of axes, [`ALONG`] or [`SPHERE`], as in [`TileBounds`].
    axes: i32,
    pub metric_m: f32,
}

/// The grid on which the centres of a page's tiles are counted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileGrid {
    origin: DVec3,
    step_m: f64,
}

/// The eye in the tile frame, prepared for offsets to tiles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileEye {
    /// The position in steps from the grid's origin.
    steps: [i32; 4],
    /// The offset from that grid position to the eye, metres.
    rest_m: Vec4,
    /// The length of a step in the first three components, 0 in the fourth.
    step_m: Vec4,
    /// The position in the tile frame, f64.
    pub position: DVec3,
}

impl Default for TileGrid {
    fn default() -> Self {
        Self { origin: DVec3::ZERO, step_m: MIN_STEP_M }
    }
}

impl TileGrid {
    /// Returns a grid that holds all centres. If a few centres far from all others would make the steps long, those are left
    /// out.
    pub(super) fn around(bounds: &[DeclaredBounds]) -> Self {
        let all = Self::of(bounds.iter().map(|b| b.center));
        if all.step_m <= FINE_STEP_M {
            return all;
        }
        // There are tiles: a page without any has the finest grid.
        let mut axes: [Vec<f64>; 3] = std::array::from_fn(|k| bounds.iter().map(|b| b.center[k]).collect());
        let mut middle = |k: usize| *axes[k].select_nth_unstable_by(bounds.len() / 2, f64::total_cmp).1;
        let middle = DVec3::new(middle(0), middle(1), middle(2));
        let distance_m = |b: &DeclaredBounds| (b.center * 0.5 - middle * 0.5).abs().max_element();
        let mut distances: Vec<f64> = bounds.iter().map(distance_m).collect();
        let half_m = *distances.select_nth_unstable_by(bounds.len() / 2, f64::total_cmp).1;
        let most_m = (FAR_FACTOR * half_m).max(0.5 * FINE_STEP_M * MAX_STEPS);
        Self::of(bounds.iter().filter(|b| distance_m(b) <= most_m).map(|b| b.center))
    }

    /// Returns the finest grid that holds some points.
    fn of(points: impl Iterator<Item = DVec3>) -> Self {
        let ends = points.fold(None, |ends: Option<(DVec3, DVec3)>, point| {
            let (min, max) = ends.unwrap_or((point, point));
            Some((min.min(point), max.max(point)))
        });
        let Some((min, max)) = ends else { return Self::default() };
        // Halves are subtracted, which overflows for no finite number.
        let reach_m = (max * 0.5 - min * 0.5).max_element();
        let step_m = (reach_m / (0.99 * MAX_STEPS)).log2().ceil().exp2().max(MIN_STEP_M);
        // The origin lies on the grid itself, so that round coordinates are not moved.
        let origin = ((max * 0.5 + min * 0.5) / step_m).round() * step_m;
        Self { origin, step_m }
    }

    /// Returns a point in steps from the origin, clamped to the grid.
    fn steps_of(&self, point: DVec3) -> [i32; 3] {
        let steps = ((point - self.origin) / self.step_m).round();
        // NaN becomes 0.
        steps.to_array().map(|steps| steps.clamp(-MAX_STEPS, MAX_STEPS) as i32)
    }

    fn point(&self, steps: [i32; 3]) -> DVec3 {
        self.origin + DVec3::from_array(steps.map(f64::from)) * self.step_m
    }

    /// Returns a tile's volume on the grid. A centre beyond the grid gets an unbounded volume.
    pub(super) fn fit(&self, declared: &DeclaredBounds) -> TileBounds {
        let [x, y, z] = self.steps_of(declared.center);
        if (declared.center - self.origin).abs().max_element() > MAX_STEPS * self.step_m {
            let extent = [UNBOUNDED, UNBOUNDED, UNBOUNDED, declared.metric_m];
            return TileBounds { steps: [x, y, z, SPHERE], extent };
        }
        let moved = self.point([x, y, z]) != declared.center;
        let slack_m = if moved { self.step_m } else { 0.0 };
        let [a, b, c] = declared.half_m.map(|half_m| round_up(half_m + slack_m));
        TileBounds { steps: [x, y, z, declared.axes], extent: [a, b, c, declared.metric_m] }
    }

    /// Returns the centre of a tile's volume, tile frame.
    pub fn center(&self, bounds: &TileBounds) -> DVec3 {
        let [x, y, z, _] = bounds.steps;
        self.point([x, y, z])
    }

    /// Prepares an eye in the tile frame.
    pub fn eye(&self, position: DVec3) -> TileEye {
        let [x, y, z] = self.steps_of(position);
        let rest_m = (position - self.point([x, y, z])).as_vec3();
        let step_m = self.step_m as f32;
        TileEye {
            steps: [x, y, z, 0],
            rest_m: rest_m.extend(0.0),
            step_m: Vec4::new(step_m, step_m, step_m, 0.0),
            position,
        }
    }
}

impl DeclaredBounds {
    /// Declares a sphere, or the box inside it. NaN or infinite bounds become unbounded: always visible, at distance 0.
    /// `axes_index` returns the index of a box's axes.
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
                let (axes, half_m) =
                    if is_skewed(&b.half_axes) { box_around(&b.half_axes) } else { unit_axes(&b.half_axes) };
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
        self.steps[3] == SPHERE
    }

    /// Returns true for a box along the axes of the frame.
    #[inline(always)]
    pub fn is_along_frame(&self) -> bool {
        self.steps[3] == ALONG
    }

    /// Returns the index of a box's axes.
    pub(super) fn axes(&self) -> usize {
        self.steps[3].max(ALONG) as usize
    }

    /// Returns half the length along each axis, or the radius, in metres; the fourth component is the metric.
    #[inline(always)]
    pub fn extent(&self) -> Vec4 {
        Vec4::from_array(self.extent)
    }

    /// Returns half the length along each axis, metres.
    #[inline(always)]
    pub fn half_m(&self) -> [f32; 3] {
        let [x, y, z, _] = self.extent;
        [x, y, z]
    }

    /// Returns the radius of a sphere around the volume; [`UNBOUNDED`] or more if there is none.
    #[inline(always)]
    pub fn radius_m(&self) -> f32 {
        // Rounded up, since the root may be rounded down.
        if self.is_sphere() { self.extent[0] } else { self.radius2_m2().sqrt() * (1.0 + f32::EPSILON) }
    }

    /// Returns the squared radius, which is not rounded up; infinite if the volume is unbounded.
    #[inline(always)]
    pub fn radius2_m2(&self) -> f32 {
        let [x, y, z, _] = self.extent;
        if self.is_sphere() { x * x } else { x * x + y * y + z * z }
    }

    /// Returns the geometric error or range, metres.
    #[inline(always)]
    pub fn metric_m(&self) -> f32 {
        self.extent[3]
    }
}

impl TileEye {
    /// Returns the offset of a tile's centre in steps from the eye's grid position; the fourth component has no meaning.
    #[inline(always)]
    pub fn steps_to(&self, bounds: &TileBounds) -> Vec4 {
        let steps: [f32; 4] = std::array::from_fn(|k| bounds.steps[k].wrapping_sub(self.steps[k]) as f32);
        Vec4::from_array(steps)
    }

    /// Returns the offset of a tile's centre from the eye, metres; the fourth component is 0.
    #[inline(always)]
    pub fn offset_to(&self, bounds: &TileBounds) -> Vec4 {
        self.steps_to(bounds) * self.step_m - self.rest_m
    }

    /// Returns the length of a step, metres.
    pub fn step_m(&self) -> f32 {
        self.step_m.x
    }

    /// Returns the offset from the eye's grid position to the eye, metres.
    pub fn rest_m(&self) -> Vec3 {
        self.rest_m.truncate()
    }
}

/// The volumes of a page's tiles.
#[derive(Debug, Default)]
pub(super) struct TileVolumes {
    bounds: Vec<TileBounds>,
    grid: TileGrid,
    /// The axes of boxes, each once in a row; empty without boxes.
    axes: Vec<BoxAxes>,
}

impl TileVolumes {
    #[inline(always)]
    pub fn bounds(&self) -> &[TileBounds] {
        &self.bounds
    }

    #[inline(always)]
    pub fn grid(&self) -> &TileGrid {
        &self.grid
    }

    /// Returns the axes of a tile's box.
    #[inline(always)]
    pub fn axes_of(&self, bounds: &TileBounds) -> &BoxAxes {
        self.axes.get(bounds.axes()).unwrap_or(&ALONG_FRAME)
    }

    /// Returns the index of a box's axes. Axes along the frame, and those of the box before, are not stored again.
    pub fn index_of_axes(&mut self, axes: BoxAxes) -> u32 {
        if self.axes.is_empty() {
            self.axes.push(ALONG_FRAME);
        }
        // A box looks the same from both ends of an axis.
        if axes.iter().zip(&ALONG_FRAME).all(|(axis, own)| axis.map(f32::abs) == *own) {
            return 0;
        }
        if self.axes.last() != Some(&axes) {
            self.axes.push(axes);
        }
        self.axes.len() as u32 - 1
    }

    /// Chooses the grid for all declared volumes and stores them on it.
    pub fn fit(&mut self, declared: &[DeclaredBounds]) {
        self.grid = TileGrid::around(declared);
        self.bounds = declared.iter().map(|declared| self.grid.fit(declared)).collect();
    }

    /// Puts the tiles into another order.
    pub fn reorder(&mut self, order: &[u32]) {
        self.bounds = taken(&self.bounds, order);
    }

    /// Returns the bytes that are not proportional to the number of tiles.
    pub fn shared_bytes(&self) -> u64 {
        (self.axes.len() * size_of::<BoxAxes>()) as u64
    }
}

/// Rounds a length up to f32, so that a volume never shrinks.
fn round_up(length_m: f64) -> f32 {
    (length_m * (1.0 + 2.0 * f64::from(f32::EPSILON))) as f32
}

/// Returns true if the axes are not perpendicular, as below a transform with different scales along its axes.
fn is_skewed(half_axes: &DMat3) -> bool {
    let [a, b, c] = [half_axes.x_axis, half_axes.y_axis, half_axes.z_axis];
    [(a, b), (b, c), (c, a)].iter().any(|(a, b)| a.dot(*b).abs() > MIN_SKEW * a.length() * b.length())
}

/// Returns directions and lengths of a box with perpendicular axes around a skewed one: the first axis is the longest one,
/// the second as close to the second longest as possible.
fn box_around(half_axes: &DMat3) -> ([DVec3; 3], [f64; 3]) {
    let given = [half_axes.x_axis, half_axes.y_axis, half_axes.z_axis];
    let mut sorted = given;
    sorted.sort_by(|a, b| b.length_squared().total_cmp(&a.length_squared()));
    let first = sorted[0].normalize_or(DVec3::X);
    let second = sorted[1].reject_from_normalized(first).try_normalize();
    let second = second.unwrap_or_else(|| first.any_orthonormal_vector());
    let axes = [first, second, first.cross(second)];
    (axes, axes.map(|axis| given.iter().map(|half| axis.dot(*half).abs()).sum()))
}

/// Returns directions and lengths of half axes; axes of zero length get a direction perpendicular to the others.
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
    fn two_bounds_fit_in_a_cache_line() {
        assert_eq!((size_of::<TileBounds>(), align_of::<TileBounds>()), (32, 32));
    }

    proptest! {
        /// Stored volumes hold the declared ones, and offsets are as exact as rounded f64 offsets.
        #[test]
        fn stored_bounds_hold_declared_bounds(
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

    /// Offsets from an eye beyond the grid are as exact as from one inside.
    #[test]
    fn offsets_are_exact_from_eyes_outside_the_grid() {
        let declared = [sphere(DVec3::ZERO, 1.0), sphere(DVec3::splat(1000.0), 1.0)];
        let grid = TileGrid::around(&declared);
        for eye in [DVec3::splat(1e7), DVec3::new(-1e15, 0.0, 3.0), DVec3::splat(f64::MAX)] {
            for declared in &declared {
                let (offset, exact) = (grid.eye(eye).offset_to(&grid.fit(declared)), (declared.center - eye).as_vec3());
                let error = (offset.truncate() - exact).length();
                assert!(error <= 1e-6 * exact.length() || !exact.length().is_finite(), "{eye} {offset} {exact}");
            }
        }
        // NaN does not panic.
        let offset = grid.eye(DVec3::NAN).offset_to(&grid.fit(&declared[0]));
        assert!(offset.truncate().is_nan());
    }

    /// Regression: all tiles grew to the length of the steps that reach the far one.
    #[test]
    fn a_far_tile_does_not_enlarge_the_others() {
        for far_m in [1e10, 1e14, 1e300] {
            let mut declared: Vec<_> = (0..9).map(|k| sphere(DVec3::splat(f64::from(k) * 500.0), 1.0)).collect();
            declared.push(sphere(DVec3::new(far_m, 0.0, 0.0), 1.0));
            let grid = TileGrid::around(&declared);
            for near in &declared[..9] {
                let bounds = grid.fit(near);
                assert!(bounds.radius_m() < 1.01, "{far_m}: {bounds:?}");
                assert!((grid.center(&bounds) - near.center).length() < 1e-3, "{far_m}: {bounds:?}");
            }
            assert!(grid.fit(&declared[9]).radius_m() >= UNBOUNDED, "{far_m}");
        }
        // If all are far from each other, none is left out.
        let declared: Vec<_> = (0..9).map(|k| sphere(DVec3::splat(f64::from(k) * 1e13), 1.0)).collect();
        let grid = TileGrid::around(&declared);
        assert!(declared.iter().all(|declared| grid.fit(declared).radius_m() < 1e6));
    }

    /// Regression: corners lay outside.
    #[test]
    fn a_skewed_box_stays_inside_its_bounds() {
        let sheared =
            DMat3::from_cols(DVec3::new(700.0, 0.0, -7000.0), DVec3::Y * 1000.0, DVec3::new(700.0, 0.0, 7000.0));
        let flat = DMat3::from_cols(DVec3::X, DVec3::new(3.0, 1e-3, 0.0), DVec3::ZERO);
        for half_axes in [sheared, flat, DMat3::from_cols(DVec3::X, DVec3::X, DVec3::X)] {
            let oriented = OrientedBox { center: DVec3::new(10.0, -20.0, 30.0), half_axes };
            let mut kept = ALONG_FRAME;
            let around = oriented.bounding_sphere();
            let declared = DeclaredBounds::new(&around, Some(&oriented), 1.0, |axes| {
                kept = axes;
                1
            });
            let bounds = TileGrid::around(&[declared]).fit(&declared);
            let axes = kept.map(|axis| DVec3::from_array(axis.map(f64::from)));
            let [a, b, c] = axes;
            assert!([a.dot(b), b.dot(c), c.dot(a)].iter().all(|cosine| cosine.abs() < 1e-6), "upright: {axes:?}");
            for corner in 0..8 {
                let sign = |k: u32| if corner >> k & 1 == 0 { 1.0 } else { -1.0 };
                let corner = half_axes * DVec3::new(sign(0), sign(1), sign(2));
                for (axis, half_m) in axes.iter().zip(bounds.half_m()) {
                    let reach_m = axis.dot(corner).abs();
                    assert!(reach_m <= f64::from(half_m) * (1.0 + 1e-6) + 1e-9, "{half_axes} {reach_m} {half_m}");
                }
                assert!(corner.length() <= f64::from(bounds.radius_m()) * (1.0 + 1e-6), "{half_axes}");
            }
        }
    }

    #[test]
    fn centres_on_whole_metres_are_not_moved() {
        let declared: Vec<_> = (0..100).map(|k| sphere(DVec3::new(f64::from(k) * 625.0, 0.5, -7.25), 300.0)).collect();
        let grid = TileGrid::around(&declared);
        for declared in &declared {
            let bounds = grid.fit(declared);
            assert_eq!(grid.center(&bounds), declared.center);
            assert!((bounds.radius_m() - 300.0).abs() < 1e-3, "no larger than it was");
        }
    }
}
