//! Mirrors of the shaders' structs, and how a frame's uniform is filled. A test compares them with naga's layout.

use glam::{DMat2, DMat4, DVec3, Mat4, Vec3};

use crate::cull::{CullCamera, MAX_CASCADES, StageShadows};
use crate::draw::atmosphere::Air;
use crate::math::WGS84;
use crate::math::color::linear_from_srgb8;
use crate::scene::{Environment, MORPH_START, Sky, has_parallel_rays, is_over_globe};

/// Height in metres over which air thins to 1/e.
const AIR_SCALE_HEIGHT_M: f64 = 8_000.0;

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
    /// Curvature of the ground, 1 / radius (0 when flat); exposure, 0 without tone mapping; 1 where there is an
    /// atmosphere; 1 where it is seen in front of things.
    pub(in crate::draw) shape: [f32; 4],
    /// Eye-space ray of a pixel from its clip position, in the plane one metre in front of the eye; where rays are
    /// parallel, in the eye's own: two columns,
    pub(in crate::draw) ray: [f32; 4],
    /// and the ray of the middle.
    pub(in crate::draw) middle_ray: [f32; 4],
    /// Linear colour of deep water; w: its height in metres.
    pub(in crate::draw) water: [f32; 4],
    /// Of the eye the air's tables were made for: kilometres from the earth's centre, cosines of horizon and limb; w: 1
    /// where rays are parallel.
    pub(in crate::draw) air: [f32; 4],
    /// Linear irradiance of the sun before any air; w: layer of the first cascade's map.
    pub(in crate::draw) sun_top: [f32; 4],
    /// Axis across the sun's rays in eye space; w: bias along the normal in texels.
    pub(in crate::draw) shadow_x: [f32; 4],
    /// The other axis; w: bias towards the sun in texels.
    pub(in crate::draw) shadow_y: [f32; 4],
    /// How many cascades, 0 without shadows; 1 / texels a side; depths between which they fade out.
    pub(in crate::draw) shadow: [f32; 4],
    /// Of each cascade, metres to the map across and along the rays; greatest depth, depth where the next begins.
    pub(in crate::draw) cascade_scales: [[f32; 4]; MAX_CASCADES],
    /// Place of the eye in the map; w: width of a texel in metres.
    pub(in crate::draw) cascade_offsets: [[f32; 4]; MAX_CASCADES],
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

/// Where the number of indices of pulled meshes, 8 bits, begins in the flags.
pub(in crate::draw) const INDEX_COUNT_SHIFT: u32 = 8;

/// Where the part of the pixels begins in the flags: its first value, and 8 bits above that behind its last.
pub(in crate::draw) const BAND_SHIFT: u32 = 16;

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

fn direction_in_eye(camera: &CullCamera, world: DVec3) -> [f64; 3] {
    camera.eye_from_world.matrix3.mul_vec3(world).normalize_or(DVec3::Z).to_array()
}

/// The colour targets are cleared with: the background's, or that of the horizon under a sky.
pub(in crate::draw) fn clear_color(environment: &Environment, frame: &FrameUniform) -> wgpu::Color {
    let [r, g, b] = match environment.sky {
        Sky::Background(rgb) => rgb.map(linear_from_srgb8),
        Sky::Atmosphere => [0, 1, 2].map(|i| f64::from(frame.horizon_color[i])),
    };
    wgpu::Color { r, g, b, a: 1.0 }
}

/// Height of a camera's eye in metres, and whether it is near a globe. Steers air and water only; a local frame counts as
/// flat, with its ground at 0.
pub(in crate::draw) fn eye_height_m(camera: &CullCamera, environment: &Environment) -> (f64, bool) {
    let eye = camera.eye_from_world.inverse().translation;
    let is_globe = is_over_globe(eye);
    let height_m = if is_globe { WGS84.geodetic(eye).height_m } else { eye.dot(environment.up_in_world) };
    (if height_m.is_finite() { height_m.max(0.0) } else { 0.0 }, is_globe)
}

/// Sine of the sun's height over the level at the eye.
pub(in crate::draw) fn sun_height(camera: &CullCamera, environment: &Environment) -> f64 {
    let sun = DVec3::from(direction_in_eye(camera, environment.sun_direction));
    sun.dot(direction_in_eye(camera, environment.up_in_world).into())
}

impl FrameUniform {
    /// For a projection of a camera; in the air as this or another eye sees it.
    pub(in crate::draw) fn new(
        camera: &CullCamera,
        clip_from_eye: &DMat4,
        environment: &Environment,
        air: &Air,
    ) -> Self {
        let (height_m, is_globe) = eye_height_m(camera, environment);
        let sun = direction_in_eye(camera, environment.sun_direction);
        let up = direction_in_eye(camera, environment.up_in_world);
        let day = ((sun_height(camera, environment) + 0.1) / 0.35).clamp(0.0, 1.0);
        let horizon = mix([0.05, 0.05, 0.09], [0.62, 0.72, 0.84], day);
        let fog = environment.fog;
        let density = if fog.enabled && fog.density_per_m.is_finite() { f64::from(fog.density_per_m) } else { 0.0 };
        let p = clip_from_eye;
        let is_parallel = has_parallel_rays(p);
        let middle = if is_parallel { -p.w_axis } else { p.z_axis };
        // A projection may turn the picture.
        let eye_from_clip = DMat2::from_cols(p.x_axis.truncate().truncate(), p.y_axis.truncate().truncate()).inverse();
        let sse_scale = camera.px_per_radian() / (camera.settings.max_sse_px * camera.settings.lod_scale).max(1e-9);
        let has_atmosphere = environment.sky == Sky::Atmosphere;
        let switch = |on: bool| if on { 1.0 } else { 0.0 };
        Self {
            clip_from_eye: p.as_mat4(),
            sun_direction: vec4(sun, sse_scale),
            sun_color: with_w(environment.sun_color, MORPH_START as f32),
            ambient_color: with_w(environment.ambient_color, density as f32),
            up: vec4(up, height_m),
            horizon_color: vec4(horizon, 1.0 / AIR_SCALE_HEIGHT_M),
            shape: [
                if is_globe { (1.0 / WGS84.semi_major_m) as f32 } else { 0.0 },
                environment.exposure.unwrap_or(0.0).max(0.0),
                switch(has_atmosphere),
                switch(has_atmosphere && fog.enabled),
            ],
            ray: eye_from_clip.as_mat2().to_cols_array(),
            middle_ray: vec4((eye_from_clip * middle.truncate().truncate()).extend(0.0).into(), 0.0),
            water: environment.water.map_or([0.0; 4], |w| with_w(w.color, w.height_m)),
            air: [air.eye_km, air.horizon_cosine, air.limb_cosine, switch(is_parallel)],
            sun_top: with_w(air.sun_irradiance(environment.sun_color), 0.0),
            shadow_x: [0.0; 4],
            shadow_y: [0.0; 4],
            shadow: [0.0; 4],
            cascade_scales: [[0.0; 4]; MAX_CASCADES],
            cascade_offsets: [[0.0; 4]; MAX_CASCADES],
        }
    }

    /// The same where shadows fall; the maps have `map_px` texels a side, of which the cascades use the first, and lie
    /// from a layer on.
    pub(in crate::draw) fn with_shadows(mut self, shadows: &StageShadows, map_px: u32, first_layer: usize) -> Self {
        self.sun_top[3] = first_layer as f32;
        let [x, y] = [0, 1].map(|row| shadows.light_from_eye.row(row).to_array());
        let settings = &shadows.settings;
        self.shadow_x = vec4(x, f64::from(settings.normal_bias_texels));
        self.shadow_y = vec4(y, f64::from(settings.depth_bias_texels));
        let count = shadows.cascades.len().min(MAX_CASCADES);
        let [fade_start, fade_end] = shadows.fade_m.map(|d| d as f32);
        self.shadow = [count as f32, 1.0 / map_px as f32, fade_start, fade_end];
        let used = f64::from(settings.resolution_px) / f64::from(map_px);
        let uniforms = self.cascade_scales.iter_mut().zip(&mut self.cascade_offsets);
        for (place, (cascade, (scales, offsets))) in shadows.cascades.iter().zip(uniforms).enumerate() {
            let [across, down, along] = [0, 1, 2].map(|row| cascade.clip_from_eye.row(row));
            let next = shadows.cascades.get(place + 1).map_or(cascade.depths_m[1], |c| c.depths_m[0]);
            let scale = 0.5 * used * across.truncate().length();
            *scales = [scale, along.truncate().length(), cascade.depths_m[1], next].map(|v| v as f32);
            let [u, v] = [used * (0.5 + 0.5 * across.w), used * (0.5 - 0.5 * down.w)];
            *offsets = [u, v, along.w, cascade.texel_m].map(|v| v as f32);
        }
        self
    }
}

fn with_w(rgb: [f32; 3], w: f32) -> [f32; 4] {
    let v = Vec3::from_array(rgb).extend(w);
    v.to_array()
}
