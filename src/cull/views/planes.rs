//! The frustum as cull tests it: the four side planes at once in f32, near and far separately.
//!
//! Planes are computed in eye space in f64, moved into the frame where bounds are stored and normalised there. Only then
//! are they rounded, so that bounds near that frame's origin are tested as precisely as f32 allows.

use crate::scene::CullingMode;
use glam::{DAffine3, DMat3, DMat4, DVec3, DVec4, Vec3, Vec4, Vec4Swizzles as _};

/// Bits of the side planes in a mask of the planes that a bound may cross.
pub(in crate::cull) const SIDES: u8 = 0b00_1111;
/// Bit of the near plane.
pub(in crate::cull) const NEAR: u8 = 0b01_0000;
/// Bit of the far plane.
pub(in crate::cull) const FAR: u8 = 0b10_0000;

/// A plane that culls nothing.
const EVERYTHING: DVec4 = DVec4::new(0.0, 0.0, 0.0, 1.0);

/// The frustum in eye space: left, right, bottom, top, near and far plane, with `normal . p + d >= 0` inside.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct EyePlanes {
    planes: [DVec4; 6],
    /// The planes that are tested.
    pub mask: u8,
}

impl EyePlanes {
    /// A frustum that culls nothing.
    pub const NONE: Self = Self { planes: [EVERYTHING; 6], mask: 0 };

    /// Takes the planes of a reversed-Z projection.
    pub fn new(clip_from_eye: &DMat4, culling: CullingMode) -> Self {
        let m: DMat4 = clip_from_eye.transpose();
        // Reversed-Z: depth is 0 at the far plane. An infinite far plane has a zero normal.
        let mut planes = [
            m.w_axis + m.x_axis,
            m.w_axis - m.x_axis,
            m.w_axis + m.y_axis,
            m.w_axis - m.y_axis,
            m.w_axis - m.z_axis,
            m.z_axis,
        ];
        for plane in &mut planes {
            *plane *= plane.truncate().length_recip();
            if !plane.is_finite() {
                *plane = EVERYTHING;
            }
        }
        let mut mask = 0;
        if culling.contains(CullingMode::VIEW_FRUSTUM_SIDES) {
            mask |= SIDES;
        }
        if culling.contains(CullingMode::NEAR_PLANE) {
            mask |= NEAR;
        }
        if culling.contains(CullingMode::FAR_PLANE) && planes[5] != EVERYTHING {
            mask |= FAR;
        }
        Self { planes, mask }
    }

    /// Moves the near plane to the eye.
    pub fn begin_at_eye(&mut self) {
        self.planes[4] = DVec4::new(0.0, 0.0, -1.0, 0.0);
    }

    /// Returns true if points in eye space are all outside of the same plane.
    pub fn are_outside(&self, points: &[DVec3]) -> bool {
        let is_outside = |plane: &DVec4| points.iter().all(|p| plane.truncate().dot(*p) + plane.w < 0.0);
        self.planes.iter().enumerate().any(|(bit, plane)| self.mask & 1 << bit != 0 && is_outside(plane))
    }

    /// Returns true if a sphere in eye space is outside of some plane.
    pub fn sphere_is_outside(&self, center: DVec3, radius_m: f64) -> bool {
        let is_outside = |plane: &DVec4| plane.truncate().dot(center) + plane.w < -radius_m;
        self.planes.iter().enumerate().any(|(bit, plane)| self.mask & 1 << bit != 0 && is_outside(plane))
    }

    /// Returns the planes in the frame of `eye_from_frame`, relative to `origin` in that frame.
    pub fn in_frame(&self, eye_from_frame: &DAffine3, origin: DVec3) -> Planes {
        let to_frame: DMat3 = eye_from_frame.matrix3.transpose();
        let origin_in_eye = eye_from_frame.transform_point3(origin);
        let mut moved = [EVERYTHING.as_vec4(); 6];
        for (p, moved) in self.planes.iter().zip(&mut moved) {
            let normal = to_frame * p.truncate();
            let d = p.truncate().dot(origin_in_eye) + p.w;
            let length2 = normal.length_squared();
            // Most maps are rigid and keep the unit length, which saves the root and the divisions.
            if (length2 - 1.0).abs() < 1e-12 {
                *moved = normal.extend(d).as_vec4();
                continue;
            }
            let length = length2.sqrt();
            if length > 0.0 && length.is_finite() && d.is_finite() {
                *moved = (normal / length).extend(d / length).as_vec4();
            }
        }
        let [a, b, c, d, near, far] = moved;
        Planes {
            x: Vec4::new(a.x, b.x, c.x, d.x),
            y: Vec4::new(a.y, b.y, c.y, d.y),
            z: Vec4::new(a.z, b.z, c.z, d.z),
            w: Vec4::new(a.w, b.w, c.w, d.w),
            near,
            far,
        }
    }
}

impl Planes {
    /// Placeholder for frames in which no plane is crossed, so that none is tested.
    pub const UNUSED: Self =
        Self { x: Vec4::ZERO, y: Vec4::ZERO, z: Vec4::ZERO, w: Vec4::ONE, near: Vec4::W, far: Vec4::W };
}

/// The frustum in the frame of bounds: the four side planes by component, and near and far.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct Planes {
    x: Vec4,
    y: Vec4,
    z: Vec4,
    w: Vec4,
    near: Vec4,
    far: Vec4,
}

impl Planes {
    /// Tests a sphere (radius in w) against the planes in `mask`. Returns the planes that it crosses, or `None` if it is
    /// outside.
    #[inline(always)]
    pub fn test_sphere(&self, sphere: Vec4, mask: u8) -> Option<u8> {
        let distance = self.x * sphere.x + self.y * sphere.y + self.z * sphere.z + self.w;
        let outside = (distance + Vec4::splat(sphere.w)).cmplt(Vec4::ZERO).bitmask() as u8;
        let inside = distance.cmpgt(Vec4::splat(sphere.w)).bitmask() as u8;
        let mut crossing = mask & !inside;
        if outside & mask != 0 {
            return None;
        }
        if mask & (NEAR | FAR) != 0 {
            for (bit, n) in [(NEAR, self.near), (FAR, self.far)] {
                if mask & bit != 0 {
                    let distance = n.x * sphere.x + n.y * sphere.y + n.z * sphere.z + n.w;
                    if distance < -sphere.w {
                        return None;
                    }
                    if distance > sphere.w {
                        crossing &= !bit;
                    }
                }
            }
        }
        Some(crossing)
    }

    /// Returns true if spheres of one radius around some points are all outside of the same side plane in `mask`.
    #[inline]
    pub fn spheres_are_outside(&self, points: &[Vec3], radius_m: f32, mask: u8) -> bool {
        let is_outside = |point: &Vec3| {
            let distance = self.x * point.x + self.y * point.y + self.z * point.z + self.w;
            (distance + Vec4::splat(radius_m)).cmplt(Vec4::ZERO).bitmask() as u8
        };
        points.iter().fold(mask & SIDES, |outside, point| outside & is_outside(point)) != 0
    }

    /// Returns true if a box is outside of some plane in `mask`.
    #[inline(always)]
    pub fn box_is_outside(&self, center: [f32; 3], half: [f32; 3], mask: u8) -> bool {
        let distance = self.x * center[0] + self.y * center[1] + self.z * center[2] + self.w;
        let reach = self.x.abs() * half[0] + self.y.abs() * half[1] + self.z.abs() * half[2];
        let outside = (distance + reach).cmplt(Vec4::ZERO).bitmask() as u8;
        if outside & mask & SIDES != 0 {
            return true;
        }
        if mask & (NEAR | FAR) == 0 {
            return false;
        }
        [(NEAR, self.near), (FAR, self.far)].into_iter().any(|(bit, n)| {
            let distance = n.x * center[0] + n.y * center[1] + n.z * center[2] + n.w;
            let reach = n.x.abs() * half[0] + n.y.abs() * half[1] + n.z.abs() * half[2];
            mask & bit != 0 && distance + reach < 0.0
        })
    }

    /// Tests an oriented box with half axes `axes * half` as [`Self::test_sphere`]. The w component of `center` is ignored.
    #[inline(always)]
    pub fn test_oriented(&self, center: Vec4, axes: &[[f32; 3]; 3], half: [f32; 3], mask: u8) -> Option<u8> {
        let mut reach = Vec4::ZERO;
        for (axis, half) in axes.iter().zip(half) {
            reach += (self.x * axis[0] + self.y * axis[1] + self.z * axis[2]).abs() * half;
        }
        self.test_reach(center, mask, reach, |n| {
            axes.iter().zip(half).map(|(axis, half)| (n.x * axis[0] + n.y * axis[1] + n.z * axis[2]).abs() * half).sum()
        })
    }

    /// Tests a bound by its extent along the normals of the side planes, and of any other plane.
    #[inline(always)]
    fn test_reach(&self, center: Vec4, mask: u8, reach: Vec4, reach_along: impl Fn(Vec4) -> f32) -> Option<u8> {
        let distance = self.x * center.xxxx() + self.y * center.yyyy() + self.z * center.zzzz() + self.w;
        let outside = (distance + reach).cmplt(Vec4::ZERO).bitmask() as u8;
        let inside = distance.cmpgt(reach).bitmask() as u8;
        let mut crossing = mask & !inside;
        if outside & mask != 0 {
            return None;
        }
        if mask & (NEAR | FAR) != 0 {
            for (bit, n) in [(NEAR, self.near), (FAR, self.far)] {
                if mask & bit != 0 {
                    let distance = n.truncate().dot(center.truncate()) + n.w;
                    let reach = reach_along(n);
                    if distance + reach < 0.0 {
                        return None;
                    }
                    if distance > reach {
                        crossing &= !bit;
                    }
                }
            }
        }
        Some(crossing)
    }
}

/// The frustum for boxes on a grid (`TileEye`): offsets in grid steps, lengths in metres.
///
/// The chain of dependent operations is as short as possible, since a mispredicted branch waits for all of it.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct GridPlanes {
    /// Side planes: distance per step along each axis, and at the origin of the grid.
    sides: [Vec4; 4],
    /// Side planes: absolute distance per metre along each axis.
    reach: [Vec4; 3],
    /// Near plane: distance per step and at the origin, and absolute distance per metre.
    near: [Vec4; 2],
    /// Far plane, as `near`.
    far: [Vec4; 2],
}

impl Planes {
    /// Returns the planes for a grid of steps of `step_m`, whose origin lies `rest_m` before the eye.
    pub fn on_grid(&self, step_m: f32, rest_m: Vec3) -> GridPlanes {
        let at_zero = self.w - (self.x * rest_m.x + self.y * rest_m.y + self.z * rest_m.z);
        let moved =
            |n: Vec4| [(n.truncate() * step_m).extend(n.w - n.truncate().dot(rest_m)), n.truncate().abs().extend(0.0)];
        GridPlanes {
            sides: [self.x * step_m, self.y * step_m, self.z * step_m, at_zero],
            reach: [self.x.abs(), self.y.abs(), self.z.abs()],
            near: moved(self.near),
            far: moved(self.far),
        }
    }
}

impl GridPlanes {
    /// Tests a box along the axes as [`Planes::test_sphere`]. The w components are ignored.
    #[inline(always)]
    pub fn test_aligned(&self, steps: Vec4, half_m: Vec4, mask: u8) -> Option<u8> {
        let [x, y, z, w] = self.sides;
        let distance = (x * steps.xxxx() + y * steps.yyyy()) + (z * steps.zzzz() + w);
        let [x, y, z] = self.reach;
        let reach = x * half_m.xxxx() + y * half_m.yyyy() + z * half_m.zzzz();
        let outside = distance.cmplt(-reach).bitmask() as u8;
        let inside = distance.cmpgt(reach).bitmask() as u8;
        let mut crossing = mask & !inside;
        if outside & mask != 0 {
            return None;
        }
        if mask & (NEAR | FAR) != 0 {
            for (bit, [n, along]) in [(NEAR, self.near), (FAR, self.far)] {
                if mask & bit != 0 {
                    let distance = n.truncate().dot(steps.truncate()) + n.w;
                    let reach = along.dot(half_m);
                    if distance < -reach {
                        return None;
                    }
                    if distance > reach {
                        crossing &= !bit;
                    }
                }
            }
        }
        Some(crossing)
    }
}

/// Returns the row that gives the depth along an axis of eye space for a point relative to `origin`.
pub(in crate::cull) fn depth_row(eye_from_frame: &DAffine3, origin: DVec3, axis: DVec3) -> Vec4 {
    let row = eye_from_frame.matrix3.transpose() * axis;
    let at_origin = axis.dot(eye_from_frame.transform_point3(origin));
    row.extend(at_origin).as_vec4()
}
