//! Conversion of depth buffer values to metres.

use glam::DMat4;

/// Returns the distance in front of the eye in metres, along the view axis, for a depth under a reversed-Z projection.
///
/// The projection may be parallel, or without a far plane: then depth 0 is infinitely far. Its depth must not depend on the
/// position in the image, as it does with an oblique near plane.
pub fn distance_of_depth(clip_from_eye: &DMat4, depth: f32) -> f64 {
    let depth = f64::from(depth);
    // depth = (z.z * -d + w.z) / (z.w * -d + w.w)
    let (z, w) = (clip_from_eye.z_axis, clip_from_eye.w_axis);
    (w.z - depth * w.w) / (z.z - depth * z.w)
}

#[cfg(test)]
mod tests {
    use glam::DVec4;
    use glam::dcamera::rh::proj::directx as proj;

    use super::*;

    #[test]
    fn depth_converts_back_to_the_projected_distance() {
        let all = [
            proj::perspective_infinite_reverse(1.0, 1.5, 0.1),
            proj::perspective(1.0, 1.5, 1e5, 0.1),
            proj::orthographic(-3.0, 4.0, -1.0, 1.0, 1e5, 0.1),
        ];
        for (clip_from_eye, far) in all.into_iter().zip([f64::INFINITY, 1e5, 1e5]) {
            for distance in [0.1, 0.5, 7.0, 1234.0] {
                let clip = clip_from_eye * DVec4::new(0.3, -0.2, -distance, 1.0);
                let depth = (clip.z / clip.w) as f32;
                let found = distance_of_depth(&clip_from_eye, depth);
                assert!((found - distance).abs() < 1e-5 * distance + 1e5 * 1e-7, "{found} instead of {distance}");
            }
            let end = distance_of_depth(&clip_from_eye, 0.0);
            assert!(end == far || (end - far).abs() < 1.0, "{end} instead of {far}");
        }
    }
}
