//! A view during cull: where the eye is, what it sees, and what follows from both. A stage has one; Projection nodes
//! and nested cameras add others for what is below them.

use glam::{DAffine3, DMat4, DVec3};

use super::planes::EyePlanes;
use super::visitor::DepthRange;
use super::{CullCamera, CullingMode};
use crate::math::Ellipsoid;
use crate::scene::{ClampProjection, ComputeNearFar, CullSettings, LodRanges, has_parallel_rays, px_per_radian};

#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    pub eye_from_world: DAffine3,
    pub clip_from_eye: DMat4,
    pub viewport_px: [u32; 2],
    /// Where a camera in the graph says that it is in the target.
    pub viewport_rect: Option<[u32; 4]>,
    pub settings: CullSettings,
    pub horizon: Option<Ellipsoid>,
    pub planes: EyePlanes,
    /// Index of the projection: 0 is the stage's.
    pub index: u32,
    /// At which tiles are refined.
    pub ranges: LodRanges,
    pub max_sse_px: f32,
    /// Times the squared ratio of a tile's range to its distance: below it what is shown is fine enough to skip the tile; 0
    /// where no level is skipped.
    pub skip_px2: f32,
    /// Radius over depth below which a bound is too small; 0 when off.
    pub small_feature: f32,
    /// Along which depths are counted, in eye space.
    pub depth_axis: DVec3,
    /// What is nearer as a whole is not there: 0, what is behind the eye. Parallel rays begin anywhere.
    pub least_depth: f32,
    /// Of a shadow's cascade: nothing is asked for, nothing positioned, nothing below other projections is there.
    pub casts: bool,
    /// The picture is one of a camera that shows the scene, or belongs to one: others that do are left out.
    pub in_scene_camera: bool,
    /// Says near and far instead of what is found.
    pub clamp_projection: Option<ClampProjection>,
    /// The projection is that of the view that it is in.
    pub is_of_above: bool,
    /// What was found before another view was gone over to.
    pub range: DepthRange,
}

impl View {
    pub fn new(camera: &CullCamera) -> Self {
        let mut view = Self {
            eye_from_world: camera.eye_from_world,
            clip_from_eye: camera.clip_from_eye,
            viewport_px: camera.viewport_px,
            viewport_rect: None,
            settings: camera.settings,
            horizon: camera.horizon,
            planes: EyePlanes::NONE,
            index: 0,
            ranges: LodRanges::new(1.0, 1.0, 1.0, false),
            max_sse_px: 0.0,
            skip_px2: 0.0,
            small_feature: 0.0,
            depth_axis: DVec3::NEG_Z,
            least_depth: 0.0,
            casts: false,
            in_scene_camera: false,
            clamp_projection: None,
            is_of_above: false,
            range: DepthRange::EMPTY,
        };
        view.derive();
        view
    }

    /// The same eye with the same levels of detail, where its picture's shadows come from: inside a box along the sun's
    /// rays, from below up to the sun.
    pub fn casting(camera: &CullCamera, light_clip_from_eye: &DMat4, to_sun: DVec3, caster_mask: u32) -> Self {
        let mut view = Self::new(camera);
        let culling = CullingMode::VIEW_FRUSTUM_SIDES | CullingMode::FAR_PLANE;
        view.settings.culling = culling;
        view.settings.cull_mask &= caster_mask;
        view.settings.compute_near_far = ComputeNearFar::Off;
        // What comes in casts as a whole, what goes out no longer.
        view.settings.lod_fade_s = 0.0;
        view.horizon = None;
        view.planes = EyePlanes::new(light_clip_from_eye, culling);
        view.small_feature = 0.0;
        view.depth_axis = -to_sun;
        view.least_depth = f32::NEG_INFINITY;
        view.casts = true;
        view
    }

    /// Computes what follows from projection, viewport and settings.
    pub fn derive(&mut self) {
        let CullSettings { culling, lod_scale, max_sse_px, skip_sse_factor, small_feature_px, .. } = self.settings;
        let px = px_per_radian(&self.clip_from_eye, self.viewport_px);
        self.planes = EyePlanes::new(&self.clip_from_eye, culling);
        // Sizes do not depend on the distance then, and rays reach behind what the eye would see.
        let is_parallel = has_parallel_rays(&self.clip_from_eye);
        self.ranges = LodRanges::new(px, max_sse_px, lod_scale, is_parallel);
        self.max_sse_px = max_sse_px as f32;
        let skips = skip_sse_factor > 1.0;
        self.skip_px2 = if skips { (skip_sse_factor * max_sse_px).powi(2) as f32 } else { 0.0 };
        if is_parallel {
            self.horizon = None;
        }
        let is_fitted = self.settings.compute_near_far != ComputeNearFar::Off;
        if is_fitted {
            // Near follows what is met, also what is nearer than it was.
            self.planes.begin_at_eye();
        }
        self.least_depth = if is_parallel && !is_fitted { f32::NEG_INFINITY } else { 0.0 };
        let small = culling.contains(CullingMode::SMALL_FEATURE) && !is_parallel;
        self.small_feature = if small { (0.5 * small_feature_px / px) as f32 } else { 0.0 };
    }

    /// Near and far of what was met, in metres; 0 where that is nothing.
    pub fn depths_m(&self) -> [f64; 2] {
        let DepthRange { near, far } = self.range;
        if near <= far { [near, far].map(|depth| f64::from(depth.max(self.least_depth))) } else { [0.0; 2] }
    }

    /// The projection clamped to what was met, if the settings ask for it.
    pub fn clamped(&self) -> DMat4 {
        let [near_m, far_m] = self.depths_m();
        if self.settings.compute_near_far == ComputeNearFar::Off || far_m <= 0.0 {
            return self.clip_from_eye;
        }
        match self.clamp_projection {
            Some(callback) => {
                let (near_m, far_m) = callback(near_m, far_m);
                clamp(&self.clip_from_eye, near_m, far_m, 0.0)
            }
            None => clamp(&self.clip_from_eye, near_m, far_m, self.settings.near_far_ratio),
        }
    }
}

/// A reversed-Z projection with other depths: near (not nearer than a share of far) and, where it has one, far.
fn clamp(clip_from_eye: &DMat4, near_m: f64, far_m: f64, ratio: f64) -> DMat4 {
    let mut m = *clip_from_eye;
    let near_m = near_m.max(far_m * ratio);
    if !(near_m.is_finite() && far_m.is_finite() && near_m > 0.0 && far_m >= near_m) {
        return m;
    }
    // A little room, so that what defined the range is not cut by rounding.
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
    fn near_and_far_become_one_and_zero() {
        let (near, far) = (5.0 * 0.98, 80.0 * 1.02);
        let infinite = clamp(&proj::perspective_infinite_reverse(1.0, 1.0, 0.1), 5.0, 80.0, 1e-4);
        assert!((depth(&infinite, near) - 1.0).abs() < 1e-12 && depth(&infinite, 1e12) < 1e-10);
        // A reversed projection: near and far change places.
        for finite in [proj::perspective(1.0, 1.0, 500.0, 0.1), proj::orthographic(-1.0, 1.0, -1.0, 1.0, 500.0, 0.1)] {
            assert!((depth(&finite, 0.1) - 1.0).abs() < 1e-12);
            let fitted = clamp(&finite, 5.0, 80.0, 1e-4);
            assert!((depth(&fitted, near) - 1.0).abs() < 1e-9, "{fitted}");
            assert!(depth(&fitted, far).abs() < 1e-9);
        }
    }

    #[test]
    fn nonsense_changes_nothing() {
        let given = proj::perspective_infinite_reverse(1.0, 1.0, 0.1);
        for (near, far) in [(f64::NAN, 1.0), (1.0, f64::NAN), (0.0, 0.0), (5.0, 1.0), (f64::INFINITY, f64::INFINITY)] {
            assert_eq!(clamp(&given, near, far, 0.0), given, "{near} {far}");
        }
        assert!((depth(&clamp(&given, 1e-9, 100.0, 0.01), 0.98) - 1.0).abs() < 1e-12, "a share of far at least");
    }
}
