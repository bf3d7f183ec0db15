//! The camera: where the eye is and how wide it sees. Written in update, read by cull, on the main thread.
//!
//! Eye space looks down -z with y up. The projection is reversed-Z with an infinite far plane; only its near
//! distance depends on the scene and is set after cull, from the nearest thing that cull kept, so that neither
//! a fast approach nor a near model is ever clipped.

use glam::{DAffine3, DMat3, DMat4, DVec3};

use crate::cull::{CullCamera, CullSettings};

/// An angle of view and the side of the picture it spans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FieldOfView {
    /// Radians from the bottom to the top edge.
    Vertical(f64),
    /// Radians from the left to the right edge.
    Horizontal(f64),
    /// Radians along the longer side of the picture, as CesiumJS measures it.
    LongerSide(f64),
    /// The same in a picture of any shape, which stretches it.
    Fixed {
        /// Radians from the bottom to the top edge.
        vertical: f64,
        /// Width by height, where nothing is stretched.
        aspect: f64,
    },
}

/// What changes with the shape of a picture; OSG's `ProjectionResizePolicy`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ResizePolicy {
    /// Nothing: what is seen is stretched.
    Fixed,
    /// The angle from left to right: a wider picture shows more to the sides.
    Horizontal,
    /// The angle from bottom to top: a higher picture shows more above and below.
    Vertical,
}

/// Pose and lens of one view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Maps eye space to the world; a rotation and a position, no scale.
    pub world_from_eye: DAffine3,
    /// The angle of view.
    pub field_of_view: FieldOfView,
    /// What is culled and how.
    pub settings: CullSettings,
    /// The near plane never comes closer to the eye than this, in metres.
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
    /// Position of the eye in the world, metres.
    pub fn eye(&self) -> DVec3 {
        self.world_from_eye.translation
    }

    /// Direction of view in the world, unit length.
    pub fn direction(&self) -> DVec3 {
        -self.world_from_eye.matrix3.z_axis
    }

    /// Places the eye and turns it towards a point.
    pub fn look_at(&mut self, eye: DVec3, target: DVec3, up: DVec3) {
        self.world_from_eye = world_from_eye(eye, target - eye, up);
    }

    /// Vertical angle of view in radians for a picture of a size.
    pub fn fovy(&self, size_px: [u32; 2]) -> f64 {
        let aspect = shape(size_px);
        let within = |angle: f64| angle.clamp(1e-4, 179f64.to_radians());
        // Of more than half a circle the tangent is negative.
        let from_width = |angle: f64| 2.0 * ((0.5 * within(angle)).tan() / aspect).atan();
        let angle = match self.field_of_view {
            FieldOfView::Vertical(fovy) | FieldOfView::Fixed { vertical: fovy, .. } => fovy,
            FieldOfView::Horizontal(fovx) => from_width(fovx),
            FieldOfView::LongerSide(angle) if aspect > 1.0 => from_width(angle),
            FieldOfView::LongerSide(angle) => angle,
        };
        within(angle)
    }

    /// Width by height, in tangents, of what is seen in a picture of a size.
    pub fn aspect(&self, size_px: [u32; 2]) -> f64 {
        match self.field_of_view {
            FieldOfView::Fixed { aspect, .. } if aspect.is_finite() => aspect.clamp(1e-4, 1e4),
            _ => shape(size_px),
        }
    }

    /// From now on sees in a picture of a size what it sees there now, and in others what a policy says.
    pub fn set_resize_policy(&mut self, policy: ResizePolicy, size_px: [u32; 2]) {
        let (vertical, aspect) = (self.fovy(size_px), self.aspect(size_px));
        self.field_of_view = match policy {
            ResizePolicy::Fixed => FieldOfView::Fixed { vertical, aspect },
            ResizePolicy::Horizontal => FieldOfView::Vertical(vertical),
            ResizePolicy::Vertical => FieldOfView::Horizontal(2.0 * ((0.5 * vertical).tan() * aspect).atan()),
        };
    }

    /// Reversed-Z infinite projection with a near distance in metres.
    pub fn clip_from_eye(&self, size_px: [u32; 2], near_m: f64) -> DMat4 {
        glam::dcamera::rh::proj::directx::perspective_infinite_reverse(
            self.fovy(size_px),
            self.aspect(size_px),
            near_m.max(self.min_near_m),
        )
    }

    /// The near distance for a frame whose nearest drawn thing is `nearest_m` away; half of it, because the
    /// bound is along the view direction's radius and the picture's corners see farther.
    pub fn near_for(&self, nearest_m: f64) -> f64 {
        if nearest_m.is_finite() { (0.5 * nearest_m).max(self.min_near_m) } else { self.min_near_m }
    }

    /// What cull needs to know of this camera.
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
            context,
        }
    }

    /// Direction in the world of the ray through a picture position (pixels, origin upper left), unit length.
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

/// Width by height of a picture.
fn shape(size_px: [u32; 2]) -> f64 {
    f64::from(size_px[0].max(1)) / f64::from(size_px[1].max(1))
}

/// The pose of an eye that looks along `direction` with `up` upwards in the picture; when the two are parallel
/// any upright is taken.
pub fn world_from_eye(eye: DVec3, direction: DVec3, up: DVec3) -> DAffine3 {
    let back = -direction.normalize_or(DVec3::NEG_Z);
    let mut right = up.cross(back);
    if right.length_squared() < 1e-20 {
        right = back.any_orthogonal_vector();
    }
    // Of nearly parallel vectors the cross product is hardly exact: once more at right angles to `back`.
    let right = right.normalize();
    let right = (right - back * back.dot(right)).normalize();
    DAffine3 { matrix3: DMat3::from_cols(right, back.cross(right), back), translation: eye }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_a_rotation_where_direction_and_up_are_nearly_parallel() {
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

    /// Half a circle and more was the narrowest.
    #[test]
    fn too_wide_a_view_is_the_widest() {
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
    fn a_policy_says_what_another_shape_shows() {
        // Tangents of half the angles, across and upwards.
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
            // One policy after another keeps what is seen.
            camera.set_resize_policy(ResizePolicy::Vertical, [1200, 300]);
            assert!((seen(&camera, [1200, 300])[0] - wider[0] * across).abs() < 1e-9);
        }
    }

    #[test]
    fn the_middle_ray_is_the_direction_of_view() {
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
