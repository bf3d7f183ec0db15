//! [`WindowMatrix`]: converts between window coordinates and the world.
//!
//! It is the product of a camera's view, projection and window matrices. Event handlers use it on the main thread.

use glam::{DMat4, DVec2, DVec3, DVec4};

use crate::viewer::camera::Camera;

/// The viewport of a camera in its window, and the projection from the world into it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowMatrix {
    /// The transform from the world to clip space.
    pub clip_from_world: DMat4,
    /// The upper left corner of the viewport in the window, pixels.
    pub origin_px: DVec2,
    /// The size of the viewport, pixels.
    pub size_px: DVec2,
}

/// A ray in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowRay {
    /// The start of the ray: the eye.
    pub origin: DVec3,
    /// The direction, of unit length.
    pub direction: DVec3,
}

impl WindowMatrix {
    /// Creates the matrix of a camera whose viewport fills the window.
    pub fn new(camera: &Camera, size_px: [u32; 2]) -> Self {
        let eye_from_world = DMat4::from(camera.world_from_eye.inverse());
        Self {
            clip_from_world: camera.clip_from_eye(size_px, camera.min_near_m) * eye_from_world,
            origin_px: DVec2::ZERO,
            size_px: DVec2::new(f64::from(size_px[0].max(1)), f64::from(size_px[1].max(1))),
        }
    }

    /// Returns true when a position in the window, in pixels from its upper left corner, is in the viewport.
    pub fn contains(&self, position_px: DVec2) -> bool {
        let at = position_px - self.origin_px;
        at.cmpge(DVec2::ZERO).all() && at.cmplt(self.size_px).all()
    }

    /// Returns the window position of a point in the world: pixels from the upper left corner, and depth (1 at the near
    /// plane, 0 infinitely far). `None` for points behind the eye.
    pub fn window_from_world(&self, point: DVec3) -> Option<DVec3> {
        let clip = self.clip_from_world * point.extend(1.0);
        if clip.w <= 0.0 || !clip.is_finite() {
            return None;
        }
        let ndc = clip.truncate() / clip.w;
        let at = self.origin_px + 0.5 * DVec2::new(1.0 + ndc.x, 1.0 - ndc.y) * self.size_px;
        at.is_finite().then(|| at.extend(ndc.z))
    }

    /// Returns the point in the world at a window position and depth; `None` when it is not finite.
    pub fn world_from_window(&self, position: DVec3) -> Option<DVec3> {
        let ndc = self.ndc(position.truncate());
        let world = self.clip_from_world.inverse() * DVec4::new(ndc.x, ndc.y, position.z, 1.0);
        let point = world.truncate() / world.w;
        point.is_finite().then_some(point)
    }

    /// Returns the ray from `eye` through a position in the window.
    pub fn ray(&self, position_px: DVec2, eye: DVec3) -> Option<WindowRay> {
        // The direction to a point on the near plane keeps its precision far from the world's origin.
        let world_from_clip = self.clip_from_world.inverse();
        let ndc = self.ndc(position_px);
        let near = world_from_clip * DVec4::new(ndc.x, ndc.y, 1.0, 1.0);
        let direction = (near.truncate() / near.w - eye).try_normalize()?;
        direction.is_finite().then_some(WindowRay { origin: eye, direction })
    }

    /// Returns the position in another camera's window that shows the same direction.
    ///
    /// OSG converts positions of the camera with focus into positions of the master camera this way.
    pub fn to_other(&self, position_px: DVec2, other: &WindowMatrix) -> Option<DVec2> {
        // Any depth between the near plane and infinity does.
        let world = self.world_from_window(position_px.extend(0.5))?;
        other.window_from_world(world).map(DVec3::truncate)
    }

    fn ndc(&self, position_px: DVec2) -> DVec2 {
        let share = (position_px - self.origin_px) / self.size_px;
        DVec2::new(2.0 * share.x - 1.0, 1.0 - 2.0 * share.y)
    }
}

/// Returns the index of the camera under a position in the window; OSG's camera with focus. When viewports overlap, it is
/// the one drawn last.
pub fn camera_with_focus(cameras: &[WindowMatrix], position_px: DVec2) -> Option<usize> {
    cameras.iter().rposition(|camera| camera.contains(position_px))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::FieldOfView;

    fn camera() -> Camera {
        let mut camera = Camera::default();
        camera.look_at(DVec3::new(4e6, 3e6, 4.2e6), DVec3::new(4e6, 3.1e6, 4.0e6), DVec3::Z);
        camera
    }

    #[test]
    fn window_and_world_positions_convert_both_ways() {
        let camera = camera();
        let matrix = WindowMatrix { origin_px: DVec2::new(100.0, 50.0), ..WindowMatrix::new(&camera, [640, 360]) };
        for at in [DVec2::new(100.0, 50.0), DVec2::new(420.0, 230.0), DVec2::new(739.0, 60.0)] {
            let ray = matrix.ray(at, camera.eye()).expect("a ray");
            let expected = camera.ray_direction([640, 360], at.x - 100.0, at.y - 50.0);
            assert!(ray.direction.distance(expected) < 1e-6, "{}", ray.direction.distance(expected));
            for distance_m in [1.0, 1e3, 1e6] {
                let point = camera.eye() + expected * distance_m;
                let shown = matrix.window_from_world(point).expect("in front");
                assert!(shown.truncate().distance(at) < 1e-3, "{shown}");
                assert!(shown.z > 0.0 && shown.z < 1.0);
            }
        }
        assert!(matrix.window_from_world(camera.eye() - camera.direction()).is_none());
        assert!(matrix.window_from_world(DVec3::NAN).is_none());
    }

    #[test]
    fn last_drawn_camera_under_the_pointer_has_the_focus() {
        let whole = WindowMatrix::new(&camera(), [640, 360]);
        let corner = WindowMatrix { origin_px: DVec2::new(400.0, 0.0), ..WindowMatrix::new(&camera(), [200, 100]) };
        let focus = |x, y| camera_with_focus(&[whole, corner], DVec2::new(x, y));
        assert_eq!([focus(10.0, 10.0), focus(410.0, 10.0), focus(640.0, 10.0)], [Some(0), Some(1), None]);
        assert_eq!(focus(f64::NAN, 0.0), None);
    }

    #[test]
    fn positions_in_a_part_map_to_positions_in_the_whole() {
        // The part shows the middle half of the whole image, from the same eye.
        let mut eye = Camera::default();
        eye.look_at(DVec3::ZERO, DVec3::Y, DVec3::Z);
        eye.field_of_view = FieldOfView::Vertical(1.0);
        let whole = WindowMatrix::new(&eye, [400, 400]);
        let half = Camera { field_of_view: FieldOfView::Vertical(2.0 * (0.5f64.tan() / 2.0).atan()), ..eye };
        let part = WindowMatrix::new(&half, [100, 100]);
        let at = part.to_other(DVec2::new(100.0, 50.0), &whole).expect("in front");
        assert!(at.distance(DVec2::new(300.0, 200.0)) < 1e-6, "{at}");
    }
}
