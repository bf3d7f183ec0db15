//! [`Camera`]: the pose and the lens of a view. Written in update, read by cull, on the main thread.
//!
//! Eye space looks down -z with y up. The projection is reversed-Z with an infinite far plane. Only its near distance depends
//! on the scene. It is set after cull, from the nearest object that cull kept: neither a fast approach nor a near model is
//! ever clipped.

use glam::{DAffine3, DMat3, DMat4, DVec3};

use crate::cull::CullCamera;
use crate::scene::CullSettings;

/// An angle of view, and the side of the image that it spans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FieldOfView {
    /// Radians from the bottom to the top edge.
    Vertical(f64),
    /// Radians from the left to the right edge.
    Horizontal(f64),
    /// Radians along the longer side of the image, as in CesiumJS.
    LongerSide(f64),
    /// Shows the same in an image of any aspect ratio, by stretching it.
    Fixed {
        /// Radians from the bottom to the top edge.
        vertical: f64,
        /// Width by height of the image in which nothing is stretched.
        aspect: f64,
    },
}

/// The part of the projection that follows the aspect ratio of the image; OSG's `ProjectionResizePolicy`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ResizePolicy {
    /// The projection stays, and the image is stretched.
    Fixed,
    /// The horizontal angle follows: a wider image shows more at the sides.
    Horizontal,
    /// The vertical angle follows: a higher image shows more at the top and bottom.
    Vertical,
}

/// Pose and lens of one view.
///
/// Manipulators write the pose in each update. Without one, the application does, before
/// [`Viewer::frame`](crate::viewer::Viewer::frame):
///
/// ```
/// use terrane::glam::DVec3;
/// use terrane::viewer::{Camera, FieldOfView};
/// let mut camera = Camera { field_of_view: FieldOfView::Vertical(0.8), ..Camera::default() };
/// camera.look_at(DVec3::new(0.0, -100.0, 50.0), DVec3::ZERO, DVec3::Z);
/// assert_eq!(camera.eye(), DVec3::new(0.0, -100.0, 50.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// The pose: a rotation and a translation from eye space to the world, without scale.
    pub world_from_eye: DAffine3,
    /// The angle of view.
    pub field_of_view: FieldOfView,
    /// The settings of cull.
    pub settings: CullSettings,
    /// The smallest distance of the near plane, in metres.
    pub min_near_m: f64,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            world_from_eye: DAffine3::IDENTITY,
            field_of_view: FieldOfView::LongerSide(60f64.to_radians()),
            settings: CullSettings::default(),
            min_near_m: 0.01,
        }
    }
}

impl Camera {
    /// Returns the position of the eye in the world, in metres.
    pub fn eye(&self) -> DVec3 {
        self.world_from_eye.translation
    }

    /// Returns the direction of view in the world, of unit length.
    pub fn direction(&self) -> DVec3 {
        -self.world_from_eye.matrix3.z_axis
    }

    /// Moves the eye and turns it towards a point.
    pub fn look_at(&mut self, eye: DVec3, target: DVec3, up: DVec3) {
        self.world_from_eye = world_from_eye(eye, target - eye, up);
    }

    /// Returns the vertical angle of view in radians for an image of a size.
    pub fn fovy(&self, size_px: [u32; 2]) -> f64 {
        let aspect = shape(size_px);
        let within = |angle: f64| angle.clamp(1e-4, 179f64.to_radians());
        // Beyond half a circle the tangent would be negative.
        let from_width = |angle: f64| 2.0 * ((0.5 * within(angle)).tan() / aspect).atan();
        let angle = match self.field_of_view {
            FieldOfView::Vertical(fovy) | FieldOfView::Fixed { vertical: fovy, .. } => fovy,
            FieldOfView::Horizontal(fovx) => from_width(fovx),
            FieldOfView::LongerSide(angle) if aspect > 1.0 => from_width(angle),
            FieldOfView::LongerSide(angle) => angle,
        };
        within(angle)
    }

    /// Returns width by height of the field of view, in tangents, for an image of a size.
    pub fn aspect(&self, size_px: [u32; 2]) -> f64 {
        match self.field_of_view {
            FieldOfView::Fixed { aspect, .. } if aspect.is_finite() => aspect.clamp(1e-4, 1e4),
            _ => shape(size_px),
        }
    }

    /// Keeps the field of view for an image of the given size, and applies a policy to images of other sizes.
    pub fn set_resize_policy(&mut self, policy: ResizePolicy, size_px: [u32; 2]) {
        let (vertical, aspect) = (self.fovy(size_px), self.aspect(size_px));
        self.field_of_view = match policy {
            ResizePolicy::Fixed => FieldOfView::Fixed { vertical, aspect },
            ResizePolicy::Horizontal => FieldOfView::Vertical(vertical),
            ResizePolicy::Vertical => FieldOfView::Horizontal(2.0 * ((0.5 * vertical).tan() * aspect).atan()),
        };
    }

    /// Returns the reversed-Z infinite projection for a near distance in metres.
    pub fn clip_from_eye(&self, size_px: [u32; 2], near_m: f64) -> DMat4 {
        glam::dcamera::rh::proj::directx::perspective_infinite_reverse(
            self.fovy(size_px),
            self.aspect(size_px),
            near_m.max(self.min_near_m),
        )
    }

    /// Returns the near distance for a frame whose nearest object is `nearest_m` away. It is half of that, because the
    /// bound is measured along the direction of view and the corners of the image see farther.
    pub fn near_for(&self, nearest_m: f64) -> f64 {
        if nearest_m.is_finite() { (0.5 * nearest_m).max(self.min_near_m) } else { self.min_near_m }
    }

    /// Returns this camera as cull takes it. `context` is the number of the device.
    pub fn cull_camera(&self, size_px: [u32; 2], frame: u32, context: u32) -> CullCamera {
        CullCamera {
            eye_from_world: self.world_from_eye.inverse(),
            clip_from_eye: self.clip_from_eye(size_px, self.min_near_m),
            viewport_px: size_px,
            settings: self.settings,
            horizon: None,
            simulation_time_s: 0.0,
            frame,
            ahead_frames: 0,
            culls_contents: true,
            context,
        }
    }

    /// Returns the direction in the world of the ray through an image position (pixels, origin upper left), of unit length.
    pub fn ray_direction(&self, size_px: [u32; 2], x_px: f64, y_px: f64) -> DVec3 {
        let (width, height) = (f64::from(size_px[0].max(1)), f64::from(size_px[1].max(1)));
        let half_height = (0.5 * self.fovy(size_px)).tan();
        let in_eye = DVec3::new(
            (2.0 * x_px / width - 1.0) * half_height * self.aspect(size_px),
            (1.0 - 2.0 * y_px / height) * half_height,
            -1.0,
        );
        (self.world_from_eye.matrix3 * in_eye).normalize()
    }
}

/// Returns the width of an image by its height.
fn shape(size_px: [u32; 2]) -> f64 {
    f64::from(size_px[0].max(1)) / f64::from(size_px[1].max(1))
}

/// Returns the pose of an eye that looks along `direction` with `up` upwards in the image. When the two are parallel, some
/// perpendicular direction becomes up.
pub fn world_from_eye(eye: DVec3, direction: DVec3, up: DVec3) -> DAffine3 {
    let back = -direction.normalize_or(DVec3::NEG_Z);
    let mut right = up.cross(back);
    if right.length_squared() < 1e-20 {
        right = back.any_orthogonal_vector();
    }
    // The cross product of nearly parallel vectors is inexact, so it is made perpendicular to `back` once more.
    let right = right.normalize();
    let right = (right - back * back.dot(right)).normalize();
    DAffine3 { matrix3: DMat3::from_cols(right, back.cross(right), back), translation: eye }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pose_is_a_rotation_for_nearly_parallel_direction_and_up() {
        let up = DVec3::new(0.6758678476252854, 0.09079264767835152, 0.7314091520304615).normalize();
        for exponent in 1..16 {
            let aside = up.any_orthonormal_vector() * 10f64.powi(-exponent);
            for direction in [aside - up, aside + up] {
                let m = world_from_eye(DVec3::ZERO, direction, up).matrix3;
                let off = (m.transpose() * m - DMat3::IDENTITY).to_cols_array();
                assert!(off.iter().all(|v| v.abs() < 1e-14), "1e-{exponent}: {off:?}");
            }
        }
    }

    /// Regression: angles beyond half a circle gave the narrowest view.
    #[test]
    fn angles_out_of_range_give_the_widest_view() {
        for angle in [3.2, 10.0, f64::INFINITY] {
            for field_of_view in
                [FieldOfView::Horizontal(angle), FieldOfView::LongerSide(angle), FieldOfView::Vertical(angle)]
            {
                let camera = Camera { field_of_view, ..Camera::default() };
                assert!(camera.fovy([1280, 720]) > 3.0, "{field_of_view:?}");
            }
        }
    }

    #[test]
    fn sixty_degrees_span_the_longer_side() {
        let camera = Camera::default();
        let fovx = 2.0 * ((0.5 * camera.fovy([1280, 720])).tan() * 1280.0 / 720.0).atan();
        assert!((fovx - 60f64.to_radians()).abs() < 1e-12);
        assert!((camera.fovy([720, 1280]) - 60f64.to_radians()).abs() < 1e-12);
    }

    #[test]
    fn resize_policy_decides_the_field_of_view_for_other_aspect_ratios() {
        // Tangents of half the angles, horizontal and vertical.
        let seen = |camera: &Camera, size_px: [u32; 2]| {
            let clip = camera.clip_from_eye(size_px, 1.0);
            [1.0 / clip.x_axis.x, 1.0 / clip.y_axis.y]
        };
        let before = [600, 300];
        for (policy, wider, higher) in [
            (ResizePolicy::Fixed, [1.0, 1.0], [1.0, 1.0]),
            (ResizePolicy::Horizontal, [2.0, 1.0], [0.5, 1.0]),
            (ResizePolicy::Vertical, [1.0, 0.5], [1.0, 2.0]),
        ] {
            let mut camera = Camera::default();
            let [across, upwards] = seen(&camera, before);
            camera.set_resize_policy(policy, before);
            for (size_px, [x, y]) in
                [(before, [1.0, 1.0]), ([1200, 600], [1.0, 1.0]), ([1200, 300], wider), ([600, 600], higher)]
            {
                let [now_x, now_y] = seen(&camera, size_px);
                assert!((now_x - x * across).abs() < 1e-9, "{policy:?} {size_px:?}: {now_x} across, of {across}");
                assert!((now_y - y * upwards).abs() < 1e-9, "{policy:?} {size_px:?}: {now_y} upwards, of {upwards}");
                // Rays agree with the projection.
                let ray = camera.ray_direction(size_px, f64::from(size_px[0]), 0.0);
                assert!((ray.x / -ray.z - now_x).abs() < 1e-9 && (ray.y / -ray.z - now_y).abs() < 1e-9, "{ray}");
            }
            // A change of policy keeps the present field of view.
            camera.set_resize_policy(ResizePolicy::Vertical, [1200, 300]);
            assert!((seen(&camera, [1200, 300])[0] - wider[0] * across).abs() < 1e-9);
        }
    }

    #[test]
    fn middle_ray_is_the_direction_of_view() {
        let mut camera = Camera::default();
        camera.look_at(DVec3::new(1.0, 2.0, 3.0), DVec3::new(-4.0, 6.0, 0.5), DVec3::Z);
        assert!(camera.ray_direction([640, 360], 320.0, 180.0).distance(camera.direction()) < 1e-12);
        // Rays agree with the projection.
        let direction = camera.ray_direction([640, 360], 500.0, 50.0);
        let in_eye = camera.world_from_eye.inverse().transform_point3(camera.eye() + 10.0 * direction);
        let clip = camera.clip_from_eye([640, 360], 0.1) * in_eye.extend(1.0);
        assert!((clip.x / clip.w - (2.0 * 500.0 / 640.0 - 1.0)).abs() < 1e-12);
        assert!((clip.y / clip.w - (1.0 - 2.0 * 50.0 / 360.0)).abs() < 1e-12);
    }

    #[test]
    fn looking_straight_down_has_a_pose() {
        let pose = world_from_eye(DVec3::ZERO, DVec3::NEG_Z, DVec3::Z);
        assert!((pose.matrix3.determinant() - 1.0).abs() < 1e-12);
    }
}
