//! A view during cull: a camera, and the values derived from it that nodes and tiles are tested against. Culling thread.
//!
//! A stage has one view; Projection nodes and nested cameras add others for what is below them.

use glam::{DMat4, DVec3};

use super::planes::EyePlanes;
use crate::cull::CullCamera;
use crate::scene::{
    ClampProjection, ComputeNearFar, CullSettings, CullingMode, LodRanges, has_parallel_rays, px_per_radian,
};

/// The nearest and farthest depth met, in metres along the view's depth axis; never NaN.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct DepthRange {
    pub near: f32,
    pub far: f32,
}

impl DepthRange {
    /// The range before anything was met.
    pub const EMPTY: Self = Self { near: f32::INFINITY, far: f32::NEG_INFINITY };
}

/// A camera with what follows from it; [`Self::derive`] computes the derived fields.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct View {
    /// Pose, projection, viewport and settings.
    pub camera: CullCamera,
    /// Index in the view stack; 0 is the stage's own view.
    pub index: u32,
    /// Viewport in the target (x, y, width, height in pixels) of a camera node that sets one.
    pub viewport_rect: Option<[u32; 4]>,
    /// Overrides the near and far depths that were found.
    pub clamp_projection: Option<ClampProjection>,
    /// The projection is inherited from the view around this one, with its near and far.
    pub inherits_projection: bool,
    /// The view belongs to a camera that shows the scene, or lies below one. Other cameras that show the scene are
    /// skipped in it, so that mirrors do not recurse.
    pub in_scene_camera: bool,
    /// The view collects casters of a shadow cascade: nothing is requested, lights are not positioned, and other
    /// projections are skipped.
    pub casts: bool,
    pub planes: EyePlanes,
    /// Distances at which tiles and Lods are refined.
    pub ranges: LodRanges,
    pub max_sse_px: f32,
    /// Squared error of what is drawn, times distance over range, up to which a level is skipped; 0 where none is.
    pub skip_px2: f32,
    /// Ratio of radius to depth below which a bound is culled as too small; 0 when that is off.
    pub small_feature: f32,
    /// Direction along which depths are measured, in eye space.
    pub depth_axis: DVec3,
    /// Bounds that lie wholly nearer are culled. 0 culls what is behind the eye; minus infinity nothing, since parallel
    /// rays may start behind it.
    pub min_depth: f32,
    /// Depths met in the view; those of the current view are in the view stack.
    pub depths: DepthRange,
}

impl View {
    /// Creates the stage's own view of a camera.
    pub fn new(camera: &CullCamera) -> Self {
        let mut view = Self {
            camera: *camera,
            index: 0,
            viewport_rect: None,
            clamp_projection: None,
            inherits_projection: false,
            in_scene_camera: false,
            casts: false,
            planes: EyePlanes::NONE,
            ranges: LodRanges::new(1.0, 1.0, 1.0, false),
            max_sse_px: 0.0,
            skip_px2: 0.0,
            small_feature: 0.0,
            depth_axis: DVec3::NEG_Z,
            min_depth: 0.0,
            depths: DepthRange::EMPTY,
        };
        view.derive();
        view
    }

    /// Creates the view of a shadow cascade's casters.
    ///
    /// Eye and levels of detail are those of the camera, so that what casts a shadow is exactly what receives it. The
    /// frustum is a box along the sun's rays that is open towards the sun.
    pub fn casting(camera: &CullCamera, light_clip_from_eye: &DMat4, to_sun: DVec3, caster_mask: u32) -> Self {
        let mut view = Self::new(camera);
        let culling = CullingMode::VIEW_FRUSTUM_SIDES | CullingMode::FAR_PLANE;
        let settings = &mut view.camera.settings;
        settings.culling = culling;
        settings.cull_mask &= caster_mask;
        settings.compute_near_far = ComputeNearFar::Off;
        // A tile that fades in casts its whole shadow; one that fades out casts none.
        settings.lod_fade_s = 0.0;
        view.camera.horizon = None;
        view.planes = EyePlanes::new(light_clip_from_eye, culling);
        view.small_feature = 0.0;
        view.depth_axis = -to_sun;
        view.min_depth = f32::NEG_INFINITY;
        view.casts = true;
        view
    }

    /// Computes the fields that follow from projection, viewport and settings.
    pub fn derive(&mut self) {
        let CullCamera { clip_from_eye, viewport_px, settings, .. } = self.camera;
        let CullSettings { culling, lod_scale, max_sse_px, skip_sse_factor, small_feature_px, .. } = settings;
        let px = px_per_radian(&clip_from_eye, viewport_px);
        self.planes = EyePlanes::new(&clip_from_eye, culling);
        let is_parallel = has_parallel_rays(&clip_from_eye);
        self.ranges = LodRanges::new(px, max_sse_px, lod_scale, is_parallel);
        self.max_sse_px = max_sse_px as f32;
        let skips = skip_sse_factor > 1.0;
        self.skip_px2 = if skips { (skip_sse_factor * max_sse_px).powi(2) as f32 } else { 0.0 };
        if is_parallel {
            // Parallel rays reach behind the horizon as seen from the eye.
            self.camera.horizon = None;
        }
        let is_fitted = settings.compute_near_far != ComputeNearFar::Off;
        if is_fitted {
            // The near plane follows the scene, so that nothing before the eye may be cut by the given one.
            self.planes.begin_at_eye();
        }
        self.min_depth = if is_parallel && !is_fitted { f32::NEG_INFINITY } else { 0.0 };
        // Under parallel rays sizes on the screen do not depend on the distance.
        let culls_small = culling.contains(CullingMode::SMALL_FEATURE) && !is_parallel;
        self.small_feature = if culls_small { (0.5 * small_feature_px / px) as f32 } else { 0.0 };
    }

    /// Returns the nearest and farthest depth met in metres, or 0 twice where nothing was met.
    pub fn depths_m(&self) -> [f64; 2] {
        let DepthRange { near, far } = self.depths;
        if near <= far { [near, far].map(|depth| f64::from(depth.max(self.min_depth))) } else { [0.0; 2] }
    }

    /// Returns the projection with near and far fitted to the depths met, where the settings ask for it.
    pub fn clamped(&self) -> DMat4 {
        let [near_m, far_m] = self.depths_m();
        if self.camera.settings.compute_near_far == ComputeNearFar::Off || far_m <= 0.0 {
            return self.camera.clip_from_eye;
        }
        match self.clamp_projection {
            Some(callback) => {
                let (near_m, far_m) = callback(near_m, far_m);
                clamp(&self.camera.clip_from_eye, near_m, far_m, 0.0)
            }
            None => clamp(&self.camera.clip_from_eye, near_m, far_m, self.camera.settings.near_far_ratio),
        }
    }
}

/// Replaces the near plane of a reversed-Z projection, and the far plane where it has one. Near is at least `ratio` times
/// far. Invalid depths leave the projection as it is.
fn clamp(clip_from_eye: &DMat4, near_m: f64, far_m: f64, ratio: f64) -> DMat4 {
    let mut m = *clip_from_eye;
    let near_m = near_m.max(far_m * ratio);
    if !(near_m.is_finite() && far_m.is_finite() && near_m > 0.0 && far_m >= near_m) {
        return m;
    }
    // A margin of 2 %, so that rounding does not cut the bounds that define the range.
    let (near_m, far_m) = (near_m * 0.98, (far_m * 1.02).max(near_m * 1.001));
    let is_perspective = m.z_axis.w != 0.0;
    let is_infinite = m.z_axis.z == 0.0 && is_perspective;
    // Depth is (a * z + b) / w with w = -z (perspective) or 1 (orthographic): 1 at -near, 0 at -far.
    let (a, b) = if is_infinite {
        (0.0, near_m)
    } else if is_perspective {
        (near_m / (far_m - near_m), near_m * far_m / (far_m - near_m))
    } else {
        (1.0 / (far_m - near_m), far_m / (far_m - near_m))
    };
    (m.z_axis.z, m.w_axis.z) = (a, b);
    m
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec4;
    use glam::dcamera::rh::proj::directx as proj;

    fn depth(m: &DMat4, distance_m: f64) -> f64 {
        let clip = *m * DVec4::new(0.0, 0.0, -distance_m, 1.0);
        clip.z / clip.w
    }

    #[test]
    fn fitted_near_has_depth_one_and_far_depth_zero() {
        let (near, far) = (5.0 * 0.98, 80.0 * 1.02);
        let infinite = clamp(&proj::perspective_infinite_reverse(1.0, 1.0, 0.1), 5.0, 80.0, 1e-4);
        assert!((depth(&infinite, near) - 1.0).abs() < 1e-12 && depth(&infinite, 1e12) < 1e-10);
        // In a reversed projection near and far are swapped.
        for finite in [proj::perspective(1.0, 1.0, 500.0, 0.1), proj::orthographic(-1.0, 1.0, -1.0, 1.0, 500.0, 0.1)] {
            assert!((depth(&finite, 0.1) - 1.0).abs() < 1e-12);
            let fitted = clamp(&finite, 5.0, 80.0, 1e-4);
            assert!((depth(&fitted, near) - 1.0).abs() < 1e-9, "{fitted}");
            assert!(depth(&fitted, far).abs() < 1e-9);
        }
    }

    #[test]
    fn invalid_depths_leave_the_projection_unchanged() {
        let given = proj::perspective_infinite_reverse(1.0, 1.0, 0.1);
        for (near, far) in [(f64::NAN, 1.0), (1.0, f64::NAN), (0.0, 0.0), (5.0, 1.0), (f64::INFINITY, f64::INFINITY)] {
            assert_eq!(clamp(&given, near, far, 0.0), given, "{near} {far}");
        }
        assert!((depth(&clamp(&given, 1e-9, 100.0, 0.01), 0.98) - 1.0).abs() < 1e-12, "at least a share of far");
    }
}
