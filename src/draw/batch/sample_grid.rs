//! Finds small meshes that lie between the centres of pixels, and so need not be drawn.
//!
//! A triangle colours the pixels whose centres it covers. Most meshes seen from afar cover none, and the work of the
//! adapter until it finds that out is most of the frame. Draw thread; plain values.

use glam::{DMat4, DVec4, Vec4};

use crate::gpu::Extent;

/// Tolerance in pixels: rasterizers snap vertices to 1/256 pixel, and rounding in f32 here and there differs by less than
/// that up to 16,384 pixels.
const MARGIN_PX: f32 = 1.0 / 64.0;

/// The pixels of a viewport as seen from the eye.
///
/// The columns times an eye-space point (x, y, z, 1) are its x and y in pixels from the target's upper left corner, both
/// times the clip-space w, and that w.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SampleGrid([Vec4; 4]);

impl SampleGrid {
    /// Returns the grid of a viewport: x, y, width, height in pixels.
    pub(super) fn new(clip_from_eye: &DMat4, [x, y, width, height]: [f32; 4]) -> Self {
        let half = [0.5 * f64::from(width), 0.5 * f64::from(height)];
        let middle = [f64::from(x) + half[0], f64::from(y) + half[1]];
        Self([0, 1, 2, 3].map(|column| {
            let DVec4 { x, y, w, .. } = clip_from_eye.col(column);
            DVec4::new(half[0] * x + middle[0] * w, middle[1] * w - half[1] * y, w, 0.0).as_vec4()
        }))
    }

    /// Returns true if the projection of a box contains no pixel centre. `rows` are those of the transform from the
    /// box's frame to the eye. Returns false if a part of the box is behind the eye, or a number is not finite.
    #[inline]
    pub(super) fn misses(&self, rows: &[[f32; 4]; 3], extent: &Extent) -> bool {
        let column = |i: usize| self.0[0] * rows[0][i] + self.0[1] * rows[1][i] + self.0[2] * rows[2][i];
        let axes = [column(0), column(1), column(2)];
        let [x, y, z] = extent.center;
        let center = axes[0] * x + axes[1] * y + axes[2] * z + column(3) + self.0[3];
        let reach =
            axes[0].z.abs() * extent.half[0] + axes[1].z.abs() * extent.half[1] + axes[2].z.abs() * extent.half[2];
        let nearest = center.z - reach;
        if nearest.is_nan() || nearest <= 0.0 {
            return false;
        }
        // The centre has the grid coordinates p and depth z; a vector from it to a point of the box adds q and w. On the
        // grid the point is (p + q) / (z + w) - p / z = (q - w p / z) / (z + w) away from the centre.
        let at = center / center.z;
        let off = |axis: Vec4, half: f32| (axis - at * axis.z).abs() * half;
        let spread = off(axes[0], extent.half[0]) + off(axes[1], extent.half[1]) + off(axes[2], extent.half[2]);
        let spread = spread / nearest + MARGIN_PX;
        let (first, last) = ((at - spread - 0.5).ceil(), (at + spread - 0.5).floor());
        first.x > last.x || first.y > last.y
    }
}

#[cfg(test)]
mod tests {
    use glam::{DAffine3, DVec3, DVec4};
    use proptest::prelude::*;

    use super::*;

    /// Projects a point to pixels from the target's upper left corner.
    fn pixel(clip_from_eye: &DMat4, viewport: [f32; 4], eye: DVec3) -> [f64; 2] {
        let clip: DVec4 = *clip_from_eye * eye.extend(1.0);
        let [x, y, width, height] = viewport.map(f64::from);
        [x + width * (0.5 + 0.5 * clip.x / clip.w), y + height * (0.5 - 0.5 * clip.y / clip.w)]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]
        #[test]
        fn missed_boxes_hold_no_centre_and_small_boxes_without_centre_are_missed(
            center in prop::array::uniform3(-5.0f64..5.0),
            size in -4.0f64..0.0,
            shape in prop::array::uniform3(0.1f64..1.0),
            turn in prop::array::uniform3(0.0f64..6.3),
            origin in (-30.0f64..30.0, -30.0f64..30.0, -100.0f64..-8.0),
            viewport in prop::array::uniform2(0.0f32..300.0),
        ) {
            let viewport = [viewport[0], viewport[1], 320.0, 200.0];
            let clip = glam::dcamera::rh::proj::directx::perspective_infinite_reverse(1.0, 1.6, 0.1);
            let turn = glam::DQuat::from_euler(glam::EulerRot::XYZ, turn[0], turn[1], turn[2]);
            let center = DVec3::from_array(center);
            let origin = DVec3::new(origin.0, origin.1, origin.2) - turn * center;
            let map = DAffine3::from_rotation_translation(turn, origin);
            let half = DVec3::from_array(shape) * 10f64.powf(size);
            let m = map.matrix3.transpose();
            let rows = [m.x_axis, m.y_axis, m.z_axis].map(|r| r.as_vec3());
            let rows = [0, 1, 2].map(|i| [rows[i].x, rows[i].y, rows[i].z, map.translation[i] as f32]);
            let extent = Extent { center: center.as_vec3().to_array(), half: half.as_vec3().to_array() };
            let missed = SampleGrid::new(&clip, viewport).misses(&rows, &extent);
            let corners = (0..8).map(|i| {
                let side = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
                pixel(&clip, viewport, map.transform_point3(center + half * DVec3::new(side(0), side(1), side(2))))
            });
            let (mut min, mut max) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
            for corner in corners {
                for axis in 0..2 {
                    (min[axis], max[axis]) = (min[axis].min(corner[axis]), max[axis].max(corner[axis]));
                }
            }
            let lies_between = |room: f64| (0..2).any(|i| (min[i] - room - 0.5).ceil() > (max[i] + room - 0.5).floor());
            prop_assert!(!missed || lies_between(0.0), "{min:?} {max:?}");
            let wide = (max[0] - min[0]).max(max[1] - min[1]);
            prop_assert!(missed || !lies_between(1.5 * f64::from(MARGIN_PX) + 0.3 * wide), "{min:?} {max:?}");
        }
    }

    #[test]
    fn boxes_around_the_eye_or_not_finite_are_never_missed() {
        let clip = glam::dcamera::rh::proj::directx::perspective_infinite_reverse(1.0, 1.0, 0.1);
        let grid = SampleGrid::new(&clip, [0.0, 0.0, 64.0, 64.0]);
        let at = |z: f32| [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, z]];
        let small = Extent { center: [0.0; 3], half: [1e-3; 3] };
        // On the corner of four pixels.
        assert!(grid.misses(&at(-10.0), &small));
        assert!(!grid.misses(&at(10.0), &small));
        assert!(!grid.misses(&at(0.0), &small));
        assert!(!grid.misses(&at(-10.0), &Extent { half: [20.0; 3], ..small }));
        assert!(!grid.misses(&at(f32::NAN), &small));
        assert!(!grid.misses(&at(-10.0), &Extent { half: [f32::NAN; 3], ..small }));
        assert!(!SampleGrid::new(&DMat4::ZERO, [0.0; 4]).misses(&at(-10.0), &small));
    }
}
