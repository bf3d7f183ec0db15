//! The fixed function: lights, material, fog, clip planes, alpha test and texture units as uniforms of
//! shaders/fixed.wgsl. Mirrors of its structs; a test compares them with naga's layout.

use std::sync::Arc;

use glam::DAffine3;

use crate::cull::{RenderStage, move_light, move_plane};
use crate::state::{
    CLIP_PLANES, ColorControl, CompareFunction, FogMode, LIGHTS, Light, Mode, ResolvedState, Sampler, SurfaceMaterial,
    TEXTURE_UNITS, TexGen, TextureBinding, TextureDimension,
};

/// A light; `StageLight` in frame.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct StageLight {
    /// Eye space; w 1 for a place, 0 for a direction.
    pub(in crate::draw) position: [f32; 4],
    /// Where a spot shines; w: cosine of its half angle.
    pub(in crate::draw) direction: [f32; 4],
    /// w: exponent of the spot.
    pub(in crate::draw) ambient: [f32; 4],
    /// w: 1 where there is such a light.
    pub(in crate::draw) diffuse: [f32; 4],
    pub(in crate::draw) specular: [f32; 4],
    pub(in crate::draw) attenuation: [f32; 4],
}

/// What is positioned in a stage; `Stage` in frame.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct StageUniform {
    pub(in crate::draw) lights: [StageLight; LIGHTS],
    pub(in crate::draw) clip_planes: [[f32; 4]; CLIP_PLANES],
}

impl StageUniform {
    /// In a view: where its lights shine as seen by `light_from`, whose argument is the view that they were met in, and
    /// its planes cut by the view's own eye.
    pub(in crate::draw) fn new(stage: &RenderStage, view: u32, light_from: impl Fn(u32) -> DAffine3) -> Self {
        let mut uniform = Self {
            lights: [StageLight::default(); LIGHTS],
            // Planes that nothing is cut by.
            clip_planes: [[0.0, 0.0, 0.0, 1.0]; CLIP_PLANES],
        };
        for positioned in &stage.lights {
            let light = &move_light(&light_from(positioned.view), &positioned.light);
            let Some(slot) = uniform.lights.get_mut(usize::from(light.number)) else { continue };
            let [x, y, z] = light.direction;
            let direction = glam::DVec3::new(x, y, z).normalize_or(glam::DVec3::NEG_Z).as_vec3();
            let Ok(position) = position_of(light) else { continue };
            let is_spot = light.spot_cutoff < std::f32::consts::FRAC_PI_2;
            *slot = StageLight {
                position,
                direction: direction.extend(if is_spot { light.spot_cutoff.cos() } else { -1.0 }).to_array(),
                ambient: rgb(light.ambient, light.spot_exponent),
                diffuse: rgb(light.diffuse, 1.0),
                specular: rgb(light.specular, 0.0),
                attenuation: rgb(light.attenuation, 0.0),
            };
        }
        for clip in &stage.clip_planes {
            if let Some(plane) = uniform.clip_planes.get_mut(usize::from(clip.number)) {
                *plane = move_plane(&eye_from(stage, view, clip.view), clip.plane).as_vec4().to_array();
            }
        }
        uniform
    }
}

/// From the eye of one view of a stage to another's; the identity where that cannot be said.
fn eye_from(stage: &RenderStage, to: u32, from: u32) -> DAffine3 {
    if to == from {
        return DAffine3::IDENTITY;
    }
    let to_from = stage.camera_of(to).eye_from_world * stage.camera_of(from).eye_from_world.inverse();
    if to_from.is_finite() { to_from } else { DAffine3::IDENTITY }
}

/// Why a light does not shine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("light {number} does not shine: its {what}")]
pub(in crate::draw) struct DarkLight {
    number: u8,
    what: &'static str,
}

/// Where a light shines from; with anything that is not a number it does not shine.
pub(in crate::draw) fn position_of(light: &Light) -> Result<[f32; 4], DarkLight> {
    let dark = |what| Err(DarkLight { number: light.number, what });
    let position = light.position.map(|p| p as f32);
    let is_somewhere = position.iter().all(|p| p.is_finite()) && position.iter().any(|p| *p != 0.0);
    let is_finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
    if !is_somewhere {
        dark("position is nowhere")
    } else if ![light.ambient, light.diffuse, light.specular].iter().all(|color| is_finite(color)) {
        dark("color is not finite")
    } else if !is_finite(&light.attenuation) {
        dark("attenuation is not finite")
    } else if !is_finite(&[light.spot_cutoff, light.spot_exponent]) || light.direction.iter().any(|d| !d.is_finite()) {
        dark("spot is not finite")
    } else {
        Ok(position)
    }
}

/// True when a LightSource has taken the place of the environment's sun.
pub(in crate::draw) fn replaces_sun(stage: &RenderStage) -> bool {
    stage.lights.iter().any(|l| l.light.number == 0 && position_of(&l.light).is_ok())
}

/// How a side of a surface reflects; `Reflection` in fixed.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct Reflection {
    pub(in crate::draw) ambient: [f32; 4],
    pub(in crate::draw) diffuse: [f32; 4],
    /// w: shininess.
    pub(in crate::draw) specular: [f32; 4],
    pub(in crate::draw) emission: [f32; 4],
}

impl Reflection {
    fn new(material: &SurfaceMaterial) -> Self {
        Self {
            ambient: rgb(material.ambient, 0.0),
            diffuse: material.diffuse,
            specular: rgb(material.specular, material.shininess),
            emission: rgb(material.emission, 0.0),
        }
    }
}

fn rgb(color: [f32; 3], w: f32) -> [f32; 4] {
    [color[0], color[1], color[2], w]
}

/// Per state; `Fixed` in fixed.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct FixedUniform {
    pub(in crate::draw) front: Reflection,
    pub(in crate::draw) back: Reflection,
    /// w: 0 none, 1 the environment's haze, 2 linear, 3 exp, 4 exp2.
    pub(in crate::draw) fog_color: [f32; 4],
    /// Linear: end and 1 / (end - start); else the density.
    pub(in crate::draw) fog: [f32; 4],
    /// w: reference of the alpha test.
    pub(in crate::draw) model_ambient: [f32; 4],
    /// 1 for a local viewer; faces: 0 lit on the side that is seen, 1 on the front, 2 on both; 1 for highlights that are
    /// added to textures.
    pub(in crate::draw) model: [u32; 4],
    /// Bits of lights, bits of clip planes, alpha test (7 passes all), 1 where the sun is replaced.
    pub(in crate::draw) flags: [u32; 4],
    /// By unit: 0 off, 1 plane, 2 cube, 3 volume, 4 layers.
    pub(in crate::draw) units: [u32; 4],
    /// By unit: 0 the mesh's, 1 object linear, 2 eye linear, 3 sphere, 4 normal, 5 reflection.
    pub(in crate::draw) texgens: [u32; 4],
    /// Added to the mip level by unit.
    pub(in crate::draw) bias: [f32; 4],
    /// Planes of s, t, r and q by unit.
    pub(in crate::draw) planes: [[f32; 4]; 4 * TEXTURE_UNITS],
}

const _: () = assert!(TEXTURE_UNITS == 4);

/// The unit before one that has another cube, volume or array: of each there is one binding.
pub(in crate::draw) fn taken_by(state: &ResolvedState, unit: usize) -> Option<usize> {
    let binding = state.texture(unit)?;
    if matches!(binding.texture.dimension, TextureDimension::D1 | TextureDimension::D2) {
        return None;
    }
    let is_alike = |b: &TextureBinding| b.texture.dimension == binding.texture.dimension;
    let first = (0..unit).find(|before| state.texture(*before).is_some_and(is_alike))?;
    // Each unit has a bias of its own.
    let sampler = |b: &TextureBinding| Sampler { mip_bias: 0.0, ..b.sampler };
    let is_other = |b: &TextureBinding| !Arc::ptr_eq(&b.texture, &binding.texture) || sampler(b) != sampler(binding);
    state.texture(first).is_some_and(is_other).then_some(first)
}

impl FixedUniform {
    /// Of a state in a view of a stage.
    pub(in crate::draw) fn new(state: &ResolvedState, stage: &RenderStage, view: u32) -> Self {
        let [front, back] = state.materials().unwrap_or_default();
        let given = state.light_model();
        let faces = given.map_or(0, |model| if model.two_sided { 2 } else { 1 });
        let model = given.unwrap_or_default();
        let is_separate = model.color_control == ColorControl::SeparateSpecularColor;
        let alpha = state.alpha_func();
        let (fog_color, fog) = match state.fog() {
            _ if !state.mode(Mode::Fog) => ([0.0; 4], [0.0; 4]),
            None => ([0.0, 0.0, 0.0, 1.0], [0.0; 4]),
            Some(fog) => match fog.mode {
                FogMode::Linear { start_m, end_m } => {
                    let span = end_m - start_m;
                    let scale = if span.abs() > 1e-6 { 1.0 / span } else { 1e6 };
                    (rgb(fog.color, 2.0), [end_m, scale, 0.0, 0.0])
                }
                FogMode::Exp { density_per_m } => (rgb(fog.color, 3.0), [density_per_m, 0.0, 0.0, 0.0]),
                FogMode::Exp2 { density_per_m } => (rgb(fog.color, 4.0), [density_per_m, 0.0, 0.0, 0.0]),
            },
        };
        let mut uniform = Self {
            front: Reflection::new(&front),
            back: Reflection::new(&back),
            fog_color,
            fog,
            model_ambient: rgb(model.ambient, alpha.map_or(0.0, |a| a.reference)),
            model: [u32::from(model.local_viewer), faces, u32::from(is_separate), 0],
            flags: [
                state.mode_bits(Mode::Light(0), LIGHTS),
                state.mode_bits(Mode::ClipPlane(0), CLIP_PLANES),
                alpha.map_or(CompareFunction::Always, |a| a.function) as u32,
                u32::from(replaces_sun(stage)),
            ],
            units: [0; 4],
            texgens: [0; 4],
            bias: [0.0; 4],
            planes: [[0.0; 4]; 4 * TEXTURE_UNITS],
        };
        for unit in 0..TEXTURE_UNITS {
            let Some(binding) = state.texture(unit).filter(|_| taken_by(state, unit).is_none()) else { continue };
            uniform.units[unit] = match binding.texture.dimension {
                TextureDimension::D1 | TextureDimension::D2 => 1,
                TextureDimension::Cube => 2,
                TextureDimension::D3 => 3,
                TextureDimension::D2Array => 4,
            };
            uniform.bias[unit] = binding.sampler.mip_bias;
            let Some(texgen) = state.texgen(unit) else { continue };
            let of_node = stage.texgens.iter().rev().find(|of| usize::from(of.unit) == unit);
            let of_node = of_node.map(|of| of.moved(&eye_from(stage, view, of.view)));
            let (kind, planes) = match (texgen, of_node) {
                (TexGen::ObjectLinear(planes), _) => (1, planes),
                (TexGen::EyeLinear(_), Some(TexGen::EyeLinear(planes))) | (TexGen::EyeLinear(planes), _) => (2, planes),
                (TexGen::SphereMap, _) => (3, [[0.0; 4]; 4]),
                (TexGen::NormalMap, _) => (4, [[0.0; 4]; 4]),
                (TexGen::ReflectionMap, _) => (5, [[0.0; 4]; 4]),
            };
            uniform.texgens[unit] = kind;
            uniform.planes[4 * unit..4 * unit + 4].copy_from_slice(&planes);
        }
        uniform
    }
}
