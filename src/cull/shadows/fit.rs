//! Fits the cascades to a view: how the depths are split, and the square of the shadow map around each part. Culling thread.
//!
//! Computed in f64, relative to the eye. The square encloses the bounding sphere of its part, so that its size stays the
//! same when the eye turns. It moves by whole texels only, so that the edges of shadows do not flicker when the eye moves.

use glam::{DAffine3, DMat3, DMat4, DVec2, DVec3, DVec4};

use super::light::ShadowLight;
use crate::cull::CullCamera;
use crate::scene::{MAX_CASCADES, SunShadows};

/// Texels around each cascade's part that filters and snapping may reach into.
const MARGIN_TEXELS: f64 = 6.0;
/// Share of the range of depths, at its near end, that logarithmic splits leave out.
const NEAREST_SHARE: f64 = 1e-3;
/// Share of a part's depths, at its far end, over which it is blended with the next part.
const BLEND_SHARE: f64 = 0.12;
/// Share of the shadow distance at which shadows start to fade out.
const FADE_START: f64 = 0.9;
/// Shadows reach at least this multiple of the nearest depth.
const REACH_PER_NEAR: f64 = 4.0;
/// Distance in texels between the anchors that texel grids are counted from. While the sun moves, the grid turns around a
/// nearby anchor. Around the centre of the earth, every texel would change in each frame.
const ANCHOR_TEXELS: f64 = 16_384.0;
/// Sine of the lowest elevation of the sun at which something within reach is still lit: mountains of 9 km see it 3
/// degrees below the horizon.
const LOWEST_SUN: f64 = -0.1;
const EARTH_RADIUS_M: f64 = 6_371_000.0;

/// The cascades of a view.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct Fit {
    /// Rotation into light space: z points towards the sun.
    pub light_from_eye: DMat3,
    /// Number of cascades in use.
    pub count: usize,
    pub cascades: [CascadeFit; MAX_CASCADES],
    /// Depths between which shadows fade out, metres.
    pub fade_m: [f64; 2],
}

/// The square of a cascade, in light space: relative to the eye, z towards the sun, metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::cull) struct CascadeFit {
    /// Least and greatest depth that it covers, metres.
    pub depths_m: [f64; 2],
    /// Width of a texel, metres.
    pub texel_m: f64,
    /// Centre of the square and of the sphere.
    pub center: DVec3,
    /// Half the square's side.
    pub half_m: f64,
    /// Radius of the sphere around what it covers.
    pub radius_m: f64,
    /// Maps the volume of casters from eye space to -1 to 1 across the rays, and to above 0 along them.
    pub casters_from_eye: DMat4,
}

impl CascadeFit {
    /// Returns the reversed-Z projection of the square: depth 1 at `nearest_m` towards the sun, 0 behind the sphere.
    pub fn clip_from_eye(&self, light_from_eye: &DMat3, nearest_m: f64) -> DMat4 {
        let bottom = self.center.z - self.radius_m;
        let nearest = if nearest_m.is_finite() { nearest_m } else { self.center.z + self.radius_m };
        // A margin, so that rounding clips no caster.
        let nearest = nearest.max(self.center.z + self.radius_m) + 1e-3 * self.radius_m;
        let across = 1.0 / self.half_m;
        let along = 1.0 / (nearest - bottom);
        let [x, y, z] = [0, 1, 2].map(|row| light_from_eye.row(row));
        DMat4::from_cols_array_2d(&[
            (x * across).extend(-self.center.x * across).to_array(),
            (y * across).extend(-self.center.y * across).to_array(),
            (z * along).extend(-bottom * along).to_array(),
            [0.0, 0.0, 0.0, 1.0],
        ])
        .transpose()
    }
}

impl Fit {
    /// Fits cascades to a camera with drawables between two depths. Returns `None` where no shadow can be seen: the sun is
    /// below the horizon, there are no drawables, or the input is not finite.
    pub fn new(camera: &CullCamera, light: &ShadowLight, near_m: f64, far_m: f64) -> Option<Self> {
        let settings = &light.shadows;
        settings.check().ok()?;
        let to_sun = light.to_sun.try_normalize()?;
        let world_from_eye = camera.eye_from_world.inverse();
        if !(world_from_eye.is_finite() && camera.clip_from_eye.is_finite()) {
            return None;
        }
        let rays = Rays::new(&camera.clip_from_eye)?;
        // Parallel rays may start behind the eye: depths are then counted from their start.
        let behind_m = -near_m.max(rays.near_m).min(0.0);
        let behind_m = if behind_m > 0.0 { power_of_two(behind_m).ceil().exp2() } else { 0.0 };
        let reaching = SunShadows { distance_m: settings.distance_m + behind_m, ..*settings };
        let (span, fade_m) = span(&reaching, near_m + behind_m, far_m + behind_m)?;
        let lowest = LOWEST_SUN - (span[1] / EARTH_RADIUS_M).min(1.0);
        if to_sun.dot(light.up) < lowest {
            return None;
        }
        let (x, y) = to_sun.any_orthonormal_pair();
        let light_from_world = DMat3::from_cols(x, y, to_sun).transpose();
        let light_from_eye = light_from_world * rotation(&world_from_eye)?;
        let count = settings.cascades as usize;
        let mut cascades = [CascadeFit::default(); MAX_CASCADES];
        let split = |i: usize| split_m(settings.split_lambda, span, i, count);
        for (i, cascade) in cascades.iter_mut().enumerate().take(count) {
            let start = match i {
                0 => 0.0,
                _ => split(i) - BLEND_SHARE * (split(i) - if i > 1 { split(i - 1) } else { 0.0 }),
            };
            let depths_m = [start, split(i + 1)].map(|depth| depth - behind_m);
            let (center, radius_m) = rays.sphere(depths_m)?;
            let texels = f64::from(settings.resolution_px);
            let texel_m = 2.0 * radius_m / (texels - 2.0 * MARGIN_TEXELS);
            let in_light = snapped(&light_from_world, &light_from_eye, &world_from_eye, center, texel_m);
            *cascade = CascadeFit {
                depths_m,
                texel_m,
                center: in_light,
                half_m: 0.5 * texels * texel_m,
                radius_m,
                casters_from_eye: rays.casters(&light_from_eye, depths_m, MARGIN_TEXELS * texel_m),
            };
        }
        let is_finite =
            cascades[..count].iter().all(|c| c.center.is_finite() && c.texel_m > 0.0 && c.half_m.is_finite());
        is_finite.then_some(Self { light_from_eye, count, cascades, fade_m: fade_m.map(|depth| depth - behind_m) })
    }
}

/// Returns the linear part of a map without scale.
fn rotation(map: &DAffine3) -> Option<DMat3> {
    let [x, y, z] = [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis].map(DVec3::try_normalize);
    Some(DMat3::from_cols(x?, y?, z?))
}

/// Returns the logarithm to base 2 of a length; finite for any input.
fn power_of_two(value: f64) -> f64 {
    value.clamp(1e-9, 1e15).log2()
}

/// Returns the depths with shadows, and the depths between which these fade out. Values that follow the scene are powers
/// of two, so that they stay the same from frame to frame.
fn span(settings: &SunShadows, near_m: f64, far_m: f64) -> Option<([f64; 2], [f64; 2])> {
    if !(far_m > 0.0 && near_m <= far_m) {
        return None;
    }
    let near_m = near_m.max(0.0);
    let reach = settings.distance_m.max(REACH_PER_NEAR * power_of_two(near_m).floor().exp2());
    let end = power_of_two(far_m).ceil().exp2();
    let far = reach.min(end);
    let near = power_of_two(near_m).floor().exp2().max(far * NEAREST_SHARE).min(0.5 * far);
    let fade = if far < reach { [far, 2.0 * far] } else { [FADE_START * far, far] };
    Some(([near, far], fade))
}

/// Returns the depth where part `i` of `count` starts: Zhang et al. 2006, equation 4.
fn split_m(lambda: f64, [near, far]: [f64; 2], i: usize, count: usize) -> f64 {
    let share = i as f64 / count as f64;
    let logarithmic = near * (far / near).powf(share);
    let uniform = near + (far - near) * share;
    if i == count { far } else { lambda * logarithmic + (1.0 - lambda) * uniform }
}

/// Returns a point in light space, relative to the eye, moved to the nearest corner of the texel grid.
fn snapped(
    light_from_world: &DMat3,
    light_from_eye: &DMat3,
    world_from_eye: &DAffine3,
    in_eye: DVec3,
    texel_m: f64,
) -> DVec3 {
    let in_light = *light_from_eye * in_eye;
    let in_world = world_from_eye.translation + light_from_world.transpose() * in_light;
    let spacing = ANCHOR_TEXELS * texel_m;
    let from_anchor = *light_from_world * (in_world - (in_world / spacing).round() * spacing);
    let shift = (from_anchor / texel_m).round() * texel_m - from_anchor;
    in_light + DVec3::new(shift.x, shift.y, 0.0)
}

/// The rays through the corners of the image.
struct Rays {
    /// Position at depth 0 and step per metre of depth, across the view axis.
    corners: [(DVec2, DVec2); 4],
    /// Depth where the rays start.
    near_m: f64,
}

impl Rays {
    fn new(clip_from_eye: &DMat4) -> Option<Self> {
        let eye_from_clip = clip_from_eye.inverse();
        let point = |x: f64, y: f64, depth: f64| {
            let p = eye_from_clip * DVec4::new(x, y, depth, 1.0);
            p.truncate() / p.w
        };
        let mut corners = [(DVec2::ZERO, DVec2::ZERO); 4];
        for (ray, (x, y)) in corners.iter_mut().zip([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) {
            let (near, far) = (point(x, y, 1.0), point(x, y, 0.5));
            let step = (far - near).truncate() / (near.z - far.z);
            *ray = (near.truncate() + step * near.z, step);
            if !(step.is_finite() && ray.0.is_finite()) {
                return None;
            }
        }
        Some(Self { corners, near_m: -point(0.0, 0.0, 1.0).z })
    }

    fn at(&self, depth_m: f64) -> [DVec3; 4] {
        self.corners.map(|(start, step)| (start + step * depth_m).extend(-depth_m))
    }

    /// Returns the projection of the box along the sun's rays around the view between two depths, with a margin. It is
    /// tighter than the square of the map.
    fn casters(&self, light_from_eye: &DMat3, [near_m, far_m]: [f64; 2], room_m: f64) -> DMat4 {
        // Across the rays the box is aligned with the view axis.
        let [x, y, z] = [0, 1, 2].map(|row| light_from_eye.row(row));
        let ahead = DVec2::new(-x.z, -y.z).normalize_or(DVec2::X);
        let axes = [x * ahead.x + y * ahead.y, y * ahead.x - x * ahead.y, z];
        let corners = [self.at(near_m), self.at(far_m)];
        let [u, v, w] = axes.map(|axis| {
            let along_axis = corners.iter().flatten().map(|corner| axis.dot(*corner));
            let (low, high) = along_axis.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
            let half = 0.5 * (high - low) + room_m;
            (axis / half, -0.5 * (high + low) / half)
        });
        let along = (w.0, w.1 + 1.0);
        DMat4::from_cols_array_2d(&[
            u.0.extend(u.1).to_array(),
            v.0.extend(v.1).to_array(),
            along.0.extend(along.1).to_array(),
            [0.0, 0.0, 0.0, 1.0],
        ])
        .transpose()
    }

    /// Returns a sphere in eye space around the view between two depths; the smallest one for a symmetric projection.
    fn sphere(&self, [near_m, far_m]: [f64; 2]) -> Option<(DVec3, f64)> {
        let (near, far) = (self.at(near_m), self.at(far_m));
        let middle = |corners: &[DVec3; 4]| corners.iter().sum::<DVec3>() / 4.0;
        let reach = |corners: &[DVec3; 4], from: DVec3| corners.iter().map(|c| c.distance(from)).fold(0.0, f64::max);
        let (a, b) = (middle(&near), middle(&far));
        let (ra, rb) = (reach(&near, a), reach(&far, b));
        let length = a.distance(b);
        let share = (0.5 + 0.5 * (rb * rb - ra * ra) / (length * length)).clamp(0.0, 1.0);
        let center = a.lerp(b, share);
        let radius = reach(&near, center).max(reach(&far, center));
        // Rounded up to steps of about a thousandth, so that rounding does not change it from frame to frame.
        let step = (radius.log2().floor() - 10.0).exp2();
        let radius = ((radius / step).ceil() + 1.0) * step;
        (center.is_finite() && radius.is_finite() && radius > 0.0).then_some((center, radius))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use glam::dcamera::rh::proj::directx as proj;
    use proptest::prelude::*;

    fn light(to_sun: DVec3, shadows: SunShadows) -> ShadowLight {
        ShadowLight { to_sun: to_sun.normalize(), up: to_sun.normalize(), shadows }
    }

    fn camera(eye: DVec3, turn: DQuat, clip_from_eye: DMat4) -> CullCamera {
        let world_from_eye = DAffine3::from_rotation_translation(turn, eye);
        CullCamera { eye_from_world: world_from_eye.inverse(), clip_from_eye, ..CullCamera::default() }
    }

    fn unit() -> impl Strategy<Value = DVec3> {
        (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64)
            .prop_map(|(x, y, z)| DVec3::new(x, y, z))
            .prop_filter("a direction", |v| v.length() > 0.1)
    }

    fn turn() -> impl Strategy<Value = DQuat> {
        (unit(), -3.1..3.1f64).prop_map(|(axis, angle)| DQuat::from_axis_angle(axis.normalize(), angle))
    }

    proptest! {
        /// Every visible point lies in the map of the cascade of its depth, at least a filter's reach inside.
        #[test]
        fn cascades_cover_the_view(
            turn in turn(), to_sun in unit(), at in unit(), from_origin_m in 0.0..7e6f64,
            fov in 0.2..2.0f64, aspect in 0.3..3.0f64, shear in -0.5..0.5f64, is_flat in any::<bool>(),
            cascades in 1..=4u32, lambda in 0.0..=1.0f64, near_log in -2.0..4.0f64, far_log in 0.0..6.0f64,
            points in prop::collection::vec((-1.0..1.0f64, -1.0..1.0f64, 0.0..1.0f64), 30),
        ) {
            let is_behind = is_flat && shear > 0.0;
            let near_m = if is_behind { -near_log.exp2() } else { near_log.exp2() };
            let far_m = near_m + 10f64.powf(far_log);
            let clip_from_eye = if is_flat {
                proj::orthographic(-300.0, 500.0, -200.0, 200.0, 1e7, if is_behind { -1e5 } else { 0.1 })
            } else {
                let mut sheared = DMat4::IDENTITY;
                sheared.z_axis.x = shear;
                proj::perspective_infinite_reverse(fov, aspect, 0.1) * sheared
            };
            let camera = camera(at * from_origin_m, turn, clip_from_eye);
            let shadows = SunShadows { cascades, split_lambda: lambda, ..SunShadows::default() };
            let fit = Fit::new(&camera, &light(to_sun, shadows), near_m, far_m).unwrap();
            prop_assert_eq!(fit.count, cascades as usize);
            prop_assert!((fit.light_from_eye.determinant().abs() - 1.0).abs() < 1e-9);
            let all = &fit.cascades[..fit.count];
            let last = all[fit.count - 1].depths_m[1];
            prop_assert!(last >= far_m.min(shadows.distance_m), "{last} of {far_m}");
            prop_assert!(all[0].depths_m[0] <= near_m, "{:?} from {near_m}", all[0].depths_m);
            prop_assert!(all.windows(2).all(|c| c[1].depths_m[0] < c[0].depths_m[1] && c[0].depths_m[1] < c[1].depths_m[1]));
            let rays = Rays::new(&camera.clip_from_eye).unwrap();
            for cascade in all {
                let clip_from_eye = cascade.clip_from_eye(&fit.light_from_eye, f64::NAN);
                let inside = 1.0 - 2.0 * (MARGIN_TEXELS - 1.0) / 2048.0;
                for (x, y, along) in &points {
                    let [near, far] = cascade.depths_m;
                    let corners = rays.at(near + (far - near) * along);
                    let (u, v) = (0.5 + 0.5 * x, 0.5 + 0.5 * y);
                    let point = corners[0].lerp(corners[1], u).lerp(corners[3].lerp(corners[2], u), v);
                    let clip = clip_from_eye.project_point3(point);
                    prop_assert!(clip.x.abs() < inside && clip.y.abs() < inside, "{clip}");
                    prop_assert!(clip.z > 0.0 && clip.z < 1.0, "{clip}");
                    // Anything between the point and the sun is among the casters.
                    let to_sun = fit.light_from_eye.row(2);
                    for towards_m in [0.0, 1.0, 1e5] {
                        let caster = cascade.casters_from_eye.project_point3(point + to_sun * towards_m);
                        prop_assert!(caster.x.abs() < 1.0 && caster.y.abs() < 1.0 && caster.z > 0.0, "{caster}");
                    }
                }
            }
        }

        /// A point of the world keeps its position inside its texel while the eye moves and turns.
        #[test]
        fn texel_grid_is_fixed_in_the_world(turn in turn(), other in turn(), to_sun in unit(), step in unit(), length in 0.0..30.0f64) {
            let at = DVec3::new(4.2e6, -1.3e6, 4.6e6);
            let lens = proj::perspective_infinite_reverse(1.0, 1.5, 0.1);
            let light = light(to_sun, SunShadows::default());
            let fit = |eye, turn| {
                let camera = camera(eye, turn, lens);
                (Fit::new(&camera, &light, 3.0, 9_000.0).unwrap(), camera)
            };
            let ((before, a), (after, b)) = (fit(at, turn), fit(at + step * length, other));
            let point = at + DVec3::new(11.0, -7.0, 3.0);
            for (c, d) in before.cascades.iter().zip(&after.cascades) {
                prop_assert!((c.texel_m / d.texel_m - 1.0).abs() < 1e-12, "the size depends on the lens alone");
                let texel = |fit: &Fit, cascade: &CascadeFit, camera: &CullCamera| {
                    let in_eye = camera.eye_from_world.transform_point3(point);
                    let clip = cascade.clip_from_eye(&fit.light_from_eye, f64::NAN).project_point3(in_eye);
                    clip.truncate() * 1024.0
                };
                let moved = texel(&before, c, &a) - texel(&after, d, &b);
                // Another anchor has another grid. Centres are snapped after the anchor is chosen, so that points near the
                // edge between two anchors are left out.
                let anchor = |f: &Fit, c: &CascadeFit, camera: &CullCamera| {
                    let world_from_eye = camera.eye_from_world.inverse();
                    let world = world_from_eye.transform_point3(f.light_from_eye.transpose() * c.center);
                    world / (ANCHOR_TEXELS * c.texel_m)
                };
                let [from, to] = [anchor(&before, c, &a), anchor(&after, d, &b)];
                let is_clear = |p: DVec3| ((p - p.round()).abs() - 0.5).abs().min_element() > 2.0 / ANCHOR_TEXELS;
                if from.round() == to.round() && is_clear(from) && is_clear(to) {
                    prop_assert!((moved - moved.round()).abs().max_element() < 1e-3, "{moved}");
                }
            }
        }
    }

    #[test]
    fn splits_follow_the_practical_scheme() {
        let splits = |lambda| [0, 1, 2, 3, 4].map(|i| split_m(lambda, [1.0, 10_000.0], i, 4));
        for (split, logarithmic) in splits(1.0).into_iter().zip([1.0, 10.0, 100.0, 1000.0, 10_000.0]) {
            assert!((split / logarithmic - 1.0).abs() < 1e-12);
        }
        for (split, even) in splits(0.0).into_iter().zip([1.0, 2500.75, 5000.5, 7500.25, 10_000.0]) {
            assert!((split / even - 1.0).abs() < 1e-12);
        }
        let half = splits(0.5);
        assert!((half[1] - 1255.375).abs() < 1e-9 && half[4] == 10_000.0, "{half:?}");
    }

    #[test]
    fn depths_follow_the_scene_in_powers_of_two() {
        let settings = SunShadows::default();
        let of = |near, far| span(&settings, near, far).unwrap();
        assert_eq!(of(0.0, 1e9), ([20.0, 20_000.0], [18_000.0, 20_000.0]));
        assert_eq!(of(700.0, 1e9).0, [512.0, 20_000.0]);
        assert_eq!(of(700.0, 1000.0), ([512.0, 1024.0], [1024.0, 2048.0]), "no fade where everything is inside");
        assert_eq!(of(400_000.0, 1e9).0, [262_144.0, 1_048_576.0], "from orbit");
        assert_eq!(of(700.0, 700.0).0, [512.0, 1024.0]);
        assert!(span(&settings, 0.0, 0.0).is_none() && span(&settings, f64::NAN, 5.0).is_none());
    }

    #[test]
    fn a_sun_below_the_ground_casts_nothing() {
        let camera = CullCamera::default();
        let mut light = light(DVec3::Z, SunShadows::default());
        assert!(Fit::new(&camera, &light, 1.0, 100.0).is_some());
        light.up = DVec3::NEG_Z;
        assert!(Fit::new(&camera, &light, 1.0, 100.0).is_none());
        let nothing = ShadowLight { to_sun: DVec3::ZERO, ..light };
        assert!(Fit::new(&camera, &nothing, 1.0, 100.0).is_none());
    }

    #[test]
    fn invalid_settings_are_errors() {
        use crate::scene::ShadowError;
        let good = SunShadows::default();
        assert_eq!(good.check(), Ok(()));
        assert_eq!(SunShadows { cascades: 5, ..good }.check(), Err(ShadowError::Cascades(5)));
        assert_eq!(SunShadows { resolution_px: 0, ..good }.check(), Err(ShadowError::Resolution(0)));
        assert!(SunShadows { distance_m: f64::NAN, ..good }.check().is_err());
        assert!(SunShadows { split_lambda: 1.1, ..good }.check().is_err());
        assert!(SunShadows { depth_bias_texels: -1.0, ..good }.check().is_err());
    }
}
