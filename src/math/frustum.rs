//! The view frustum as planes, for callers outside the cull loop (which keeps its own SIMD form).

use glam::{DMat4, DVec3, DVec4};

/// Planes `(normal, d)` with `normal . p + d >= 0` inside, unit normals, in the frame of the matrix they came from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frustum {
    /// Left, right, bottom, top, near.
    pub planes: [DVec4; 5],
}

impl Frustum {
    /// Takes the side and near planes of a reversed-Z projection. `clip_from_world` may map from any frame; the planes are in
    /// that frame.
    pub fn from_clip(clip_from_world: &DMat4) -> Self {
        let m = clip_from_world.transpose();
        let (x, y, z, w) = (m.x_axis, m.y_axis, m.z_axis, m.w_axis);
        // Reversed-Z: near is z = w, so inside means w - z >= 0.
        let planes = [w + x, w - x, w + y, w - y, w - z].map(|p| {
            let length = p.truncate().length();
            if length > 0.0 { p / length } else { DVec4::new(0.0, 0.0, 0.0, 1.0) }
        });
        Self { planes }
    }

    /// Returns true if the point is inside all planes.
    pub fn contains(&self, point: DVec3) -> bool {
        self.planes.iter().all(|p| p.truncate().dot(point) + p.w >= 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_down_minus_z() {
        let f = Frustum::from_clip(&glam::dcamera::rh::proj::directx::perspective_infinite_reverse(1.0, 1.0, 0.1));
        assert!(f.contains(DVec3::new(0.0, 0.0, -1.0)));
        assert!(!f.contains(DVec3::new(0.0, 0.0, 1.0)));
        assert!(!f.contains(DVec3::new(5.0, 0.0, -1.0)));
    }
}
