//! The uniforms of a frame and the leaves: mirrors of the structs `Frame` and `Leaf` of shaders/frame.wgsl. A test compares
//! them with naga's layout. Draw thread.

use glam::{DMat2, DMat4, Mat4, Vec3};

use super::air::{AirParameters, direction_in_eye, eye_height_m, sun_height};
use crate::cull::{CullCamera, StageShadows};
use crate::math::color::linear_from_srgb8;
use crate::scene::{Environment, MAX_CASCADES, MORPH_START, Sky, has_parallel_rays};

/// Height in metres over which the density of air falls to 1/e.
const AIR_SCALE_HEIGHT_M: f64 = 8_000.0;

/// The uniforms of a view; mirrors `Frame` in frame.wgsl field by field. Colours are linear.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct FrameUniform {
    pub(in crate::draw) clip_from_eye: Mat4,
    /// Eye-space direction to the sun; w is the range in metres per metre of geometric error.
    pub(in crate::draw) sun_direction: [f32; 4],
    /// w is the share of a range at which morphing starts.
    pub(in crate::draw) sun_color: [f32; 4],
    /// w is the density of fog per metre at height 0; 0 without fog.
    pub(in crate::draw) ambient_color: [f32; 4],
    /// Eye-space direction up at the eye; w is the height of the eye in metres.
    pub(in crate::draw) up: [f32; 4],
    /// Colour of the sky at the horizon; w is 1 / scale height of the air in metres.
    pub(in crate::draw) horizon_color: [f32; 4],
    /// x is the curvature of the ground, 1 / radius in metres, 0 if it is flat. y is the exposure, 0 without tone mapping.
    /// z is 1 with an atmosphere, w is 1 if the atmosphere is also drawn in front of things.
    pub(in crate::draw) shape: [f32; 4],
    /// The two columns of the map from a pixel's clip position to its eye-space ray. The ray is a point of the plane one
    /// metre in front of the eye, or of the eye's own plane if rays are parallel.
    pub(in crate::draw) ray: [f32; 4],
    /// The ray of the clip position (0, 0); z and w are the size of a pixel in clip positions.
    pub(in crate::draw) middle_ray: [f32; 4],
    /// Colour of deep water; w is its height in metres.
    pub(in crate::draw) water: [f32; 4],
    /// The eye that the air tables were computed for: kilometres from the earth's centre, cosines of horizon and limb. w is
    /// 1 if rays are parallel.
    pub(in crate::draw) air: [f32; 4],
    /// Irradiance of the sun outside the air; w is the layer of the first cascade's map.
    pub(in crate::draw) sun_top: [f32; 4],
    /// x is the share of the ambient light that remains at night.
    pub(in crate::draw) night: [f32; 4],
    /// Eye-space axis across the sun's rays; w is the bias along the normal in texels.
    pub(in crate::draw) shadow_x: [f32; 4],
    /// The other axis; w is the bias towards the sun in texels.
    pub(in crate::draw) shadow_y: [f32; 4],
    /// The number of cascades, 0 without shadows; 1 / texels a side; the depths in metres between which shadows fade out.
    pub(in crate::draw) shadow: [f32; 4],
    /// For each cascade: the scales from metres to the map, across and along the rays; its greatest depth in metres; the
    /// depth at which the next one begins.
    pub(in crate::draw) cascade_scales: [[f32; 4]; MAX_CASCADES],
    /// For each cascade: the eye's position in the map; w is the width of a texel in metres.
    pub(in crate::draw) cascade_offsets: [[f32; 4]; MAX_CASCADES],
}

/// The data of a leaf; mirrors `Leaf` in frame.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct LeafUniform {
    /// The rows of the 3x4 transform from the drawable's frame to the eye.
    pub(in crate::draw) eye_from_drawable: [[f32; 4]; 3],
    /// Linear colour factor.
    pub(in crate::draw) color: [f32; 4],
    /// The layer in the texture arrays of its block; the record of a metallic-roughness surface.
    pub(in crate::draw) layer: u32,
    /// `FLAG_*`, the index count of pulled meshes, and the band of a fade.
    pub(in crate::draw) flags: u32,
    /// The bits of the `f32` alpha below which masked fragments are dropped; the first vertex of pulled meshes.
    pub(in crate::draw) alpha_cutoff: u32,
    /// The vertices along a side of a height tile; the first index of pulled meshes.
    pub(in crate::draw) side: u32,
}

impl LeafUniform {
    pub(in crate::draw) const EMPTY: Self =
        Self { eye_from_drawable: [[0.0; 4]; 3], color: [0.0; 4], layer: 0, flags: 0, alpha_cutoff: 0, side: 0 };
}

/// The lowest bit of the index count of pulled meshes in the flags; the count has 8 bits.
pub(in crate::draw) const INDEX_COUNT_SHIFT: u32 = 8;

/// The lowest bit of a fade's band in the flags: 8 bits of its first value, then 8 bits of the end behind its last value.
pub(in crate::draw) const BAND_SHIFT: u32 = 16;
/// Stands for a fade's band in leaves that are cut to the volume of the stage uniform. No band starts at 255.
pub(in crate::draw) const BAND_OF_VOLUME: u32 = 255;
/// Stands for the same, behind all other surfaces.
pub(in crate::draw) const BAND_OF_BACKDROP: u32 = BAND_OF_VOLUME | 1 << 8;

/// Set if the leaf is not lit.
pub(in crate::draw) const FLAG_UNLIT: u32 = 1;
/// Set if the drawable's own texture is not used.
pub(in crate::draw) const FLAG_UNTEXTURED: u32 = 2;

fn mix(a: [f64; 3], b: [f64; 3], t: f64) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

fn vec4(v: [f64; 3], w: f64) -> [f32; 4] {
    [v[0] as f32, v[1] as f32, v[2] as f32, w as f32]
}

/// Returns the colour that a view is cleared with: the background's, or the horizon's under a sky.
pub(in crate::draw) fn clear_color(environment: &Environment, frame: &FrameUniform) -> wgpu::Color {
    let [r, g, b] = match environment.sky {
        Sky::Background(rgb) => rgb.map(linear_from_srgb8),
        Sky::Atmosphere => [0, 1, 2].map(|i| f64::from(frame.horizon_color[i])),
    };
    wgpu::Color { r, g, b, a: 1.0 }
}

impl FrameUniform {
    /// Returns the uniforms for a projection of a camera. `air` are the parameters of the tables that the view uses, which
    /// may be those of another eye.
    pub(in crate::draw) fn new(
        camera: &CullCamera,
        clip_from_eye: &DMat4,
        environment: &Environment,
        air: &AirParameters,
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
        // A projection may rotate the image.
        let eye_from_clip = DMat2::from_cols(p.x_axis.truncate().truncate(), p.y_axis.truncate().truncate()).inverse();
        let middle_ray = eye_from_clip * middle.truncate().truncate();
        let pixel = camera.viewport_px.map(|side| 2.0 / side.max(1) as f32);
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
                if is_globe { (1.0 / environment.ellipsoid.semi_major_m) as f32 } else { 0.0 },
                environment.exposure.unwrap_or(0.0).max(0.0),
                switch(has_atmosphere),
                switch(has_atmosphere && fog.enabled),
            ],
            ray: eye_from_clip.as_mat2().to_cols_array(),
            middle_ray: [middle_ray.x as f32, middle_ray.y as f32, pixel[0], pixel[1]],
            water: environment.water.map_or([0.0; 4], |w| with_w(w.color, w.height_m)),
            air: [air.eye_km, air.horizon_cosine, air.limb_cosine, switch(is_parallel)],
            sun_top: with_w(air.sun_irradiance(environment.sun_color), 0.0),
            night: [environment.night_light.clamp(0.0, 1.0), 0.0, 0.0, 0.0],
            shadow_x: [0.0; 4],
            shadow_y: [0.0; 4],
            shadow: [0.0; 4],
            cascade_scales: [[0.0; 4]; MAX_CASCADES],
            cascade_offsets: [[0.0; 4]; MAX_CASCADES],
        }
    }

    /// Returns the uniforms for a view with shadows. The maps have `map_px` texels a side, of which the cascades use the
    /// first ones, and begin at the layer `first_layer`.
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
        for (index, (cascade, (scales, offsets))) in shadows.cascades.iter().zip(uniforms).enumerate() {
            let [across, down, along] = [0, 1, 2].map(|row| cascade.clip_from_eye.row(row));
            let next = shadows.cascades.get(index + 1).map_or(cascade.depths_m[1], |c| c.depths_m[0]);
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
