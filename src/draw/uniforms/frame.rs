//! Mirrors of the shaders' structs, and how a frame's uniform is filled. A test compares them with naga's layout.

use glam::{DMat4, DVec3, Mat4, Vec3};

use crate::cull::RenderStage;
use crate::draw::environment::{Environment, Sky};
use crate::math::WGS84;

/// Share of a level's range at which its vertices start to morph into the coarser level.
const MORPH_START: f32 = 0.7;
/// Height in metres over which air thins to 1/e.
const AIR_SCALE_HEIGHT_M: f64 = 8_000.0;
/// Eyes closer to the world's origin are in a local frame; the earth's poles are 6,357 km from it.
const LOCAL_WORLD_RADIUS_M: f64 = 6_200_000.0;

/// Per frame; `Frame` in frame.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct FrameUniform {
    pub(in crate::draw) clip_from_eye: Mat4,
    /// Eye-space direction to the sun; w: metres of range per metre of error.
    pub(in crate::draw) sun_direction: [f32; 4],
    /// Linear; w: share of a range where morphing starts.
    pub(in crate::draw) sun_color: [f32; 4],
    /// Linear; w: fog density per metre at height 0, 0 when off.
    pub(in crate::draw) ambient_color: [f32; 4],
    /// Eye-space up at the eye; w: height of the eye in metres.
    pub(in crate::draw) up: [f32; 4],
    /// Linear colour of the sky at the horizon; w: 1 / air scale height.
    pub(in crate::draw) horizon_color: [f32; 4],
    /// Linear colour of the sky at the zenith; w: curvature of the ground, 1 / radius (0 when flat).
    pub(in crate::draw) zenith_color: [f32; 4],
    /// Eye-space ray of a pixel from its clip position: x and y scale, x and y offset.
    pub(in crate::draw) ray: [f32; 4],
    /// Sine of the dip of the horizon, share of air at the eye, sine over which the sky's haze thins to 1/e; w: exposure,
    /// 0 without tone mapping.
    pub(in crate::draw) horizon: [f32; 4],
    /// Linear colour of deep water; w: its height in metres.
    pub(in crate::draw) water: [f32; 4],
}

/// Per leaf; `Leaf` in frame.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct LeafUniform {
    /// Rows of the 3x4 map from the drawable's frame to the eye.
    pub(in crate::draw) eye_from_drawable: [[f32; 4]; 3],
    /// Linear factor.
    pub(in crate::draw) color: [f32; 4],
    /// Layer in the block's texture arrays.
    pub(in crate::draw) layer: u32,
    /// `FLAG_*`.
    pub(in crate::draw) flags: u32,
    /// Bits of the alpha below which fragments are dropped where the pipeline masks; first vertex of pulled meshes.
    pub(in crate::draw) alpha_cutoff: u32,
    /// Vertices along a side of a height tile; first index of pulled meshes.
    pub(in crate::draw) side: u32,
}

impl LeafUniform {
    pub(in crate::draw) const EMPTY: Self =
        Self { eye_from_drawable: [[0.0; 4]; 3], color: [0.0; 4], layer: 0, flags: 0, alpha_cutoff: 0, side: 0 };
}

/// Where the number of indices of pulled meshes begins in the flags.
pub(in crate::draw) const INDEX_COUNT_SHIFT: u32 = 8;

/// Not lit.
pub(in crate::draw) const FLAG_UNLIT: u32 = 1;
/// The drawable's own texture does not count.
pub(in crate::draw) const FLAG_UNTEXTURED: u32 = 2;

fn mix(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

fn vec4(v: [f64; 3], w: f64) -> [f32; 4] {
    [v[0] as f32, v[1] as f32, v[2] as f32, w as f32]
}

fn direction_in_eye(stage: &RenderStage, world: DVec3) -> [f64; 3] {
    stage.camera.eye_from_world.matrix3.mul_vec3(world).normalize_or(DVec3::Z).to_array()
}

fn linear_from_srgb(byte: u8) -> f64 {
    let s = f64::from(byte) / 255.0;
    if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
}

/// The colour targets are cleared with: the background's, or that of the horizon under a sky.
pub(in crate::draw) fn clear_color(environment: &Environment, frame: &FrameUniform) -> wgpu::Color {
    let [r, g, b] = match environment.sky {
        Sky::Background(rgb) => rgb.map(linear_from_srgb),
        Sky::Gradient => [0, 1, 2].map(|i| f64::from(frame.horizon_color[i])),
    };
    wgpu::Color { r, g, b, a: 1.0 }
}

impl FrameUniform {
    /// For one of the stage's projections.
    pub(in crate::draw) fn new(stage: &RenderStage, clip_from_eye: &DMat4, environment: &Environment) -> Self {
        let camera = &stage.camera;
        let world_from_eye = camera.eye_from_world.inverse();
        let eye = world_from_eye.translation;
        // Height and curvature only steer haze and sky; a local frame counts as flat, with its ground at 0.
        let is_globe = eye.length() > LOCAL_WORLD_RADIUS_M;
        let height_m = if is_globe { WGS84.geodetic(eye).height_m } else { eye.dot(environment.up_in_world) }.max(0.0);
        let radius_m = WGS84.semi_major_m;
        let dip_sine = if is_globe {
            let cosine = radius_m / (radius_m + height_m);
            (1.0 - cosine * cosine).max(0.0).sqrt()
        } else {
            0.0
        };
        let air = (-height_m / (3.0 * AIR_SCALE_HEIGHT_M)).exp();
        // The bright band above the horizon: the air's thickness, seen from as far as the horizon is.
        let horizon_m = (height_m * (2.0 * radius_m + height_m)).sqrt().max(1.0);
        let band = (2.0 * AIR_SCALE_HEIGHT_M / horizon_m).min(0.32);
        let sun = direction_in_eye(stage, environment.sun_direction);
        let up = direction_in_eye(stage, environment.up_in_world);
        let sun_height = sun[0] * up[0] + sun[1] * up[1] + sun[2] * up[2];
        let day = ((sun_height + 0.1) / 0.35).clamp(0.0, 1.0);
        let horizon = mix([0.05, 0.05, 0.09], [0.62, 0.72, 0.84], day);
        let zenith = mix([0.005, 0.006, 0.015], [0.09, 0.22, 0.52], day);
        let space = [0.002, 0.002, 0.004];
        let fog = environment.fog;
        let density = if fog.enabled && fog.density_per_m.is_finite() { f64::from(fog.density_per_m) } else { 0.0 };
        let p = clip_from_eye;
        let sse_scale = camera.px_per_radian() / (camera.settings.max_sse_px * camera.settings.lod_scale).max(1e-9);
        Self {
            clip_from_eye: p.as_mat4(),
            sun_direction: vec4(sun, sse_scale),
            sun_color: with_w(environment.sun_color, MORPH_START),
            ambient_color: with_w(environment.ambient_color, density as f32),
            up: vec4(up, height_m),
            horizon_color: vec4(horizon, 1.0 / AIR_SCALE_HEIGHT_M),
            zenith_color: vec4(mix(space, zenith, air), if is_globe { 1.0 / radius_m } else { 0.0 }),
            ray: [
                (1.0 / p.x_axis.x) as f32,
                (1.0 / p.y_axis.y) as f32,
                (p.z_axis.x / p.x_axis.x) as f32,
                (p.z_axis.y / p.y_axis.y) as f32,
            ],
            horizon: [dip_sine as f32, air as f32, band as f32, environment.exposure.unwrap_or(0.0).max(0.0)],
            water: environment.water.map_or([0.0; 4], |w| with_w(w.color, w.height_m)),
        }
    }
}

fn with_w(rgb: [f32; 3], w: f32) -> [f32; 4] {
    let v = Vec3::from_array(rgb).extend(w);
    v.to_array()
}
