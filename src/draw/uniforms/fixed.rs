//! The fixed function as uniforms: material, fog, alpha test and texture units. Mirrors the structs `Fixed` and `Reflection` of
//! shaders/fixed.wgsl; a test compares them with naga's layout. Lights and clip planes are in [`super::stage`]. Draw thread.

use std::sync::Arc;

use super::stage::{eye_from, has_own_sun, replaces_sun};
use crate::cull::RenderStage;
use crate::state::{
    CLIP_PLANES, ColorControl, CombineFunction, CombineOperand, CombineSource, CompareFunction, FogMode, LIGHTS, Mode,
    ResolvedState, Sampler, SurfaceMaterial, TEXTURE_UNITS, TexEnv, TexEnvCombine, TexGen, TextureBinding,
    TextureDimension, WrapMode,
};

/// Set in the source of coordinates of a unit with a matrix.
const HAS_MATRIX: u32 = 16;

/// The material of one side of a surface; mirrors `Reflection` in fixed.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct Reflection {
    pub(in crate::draw) ambient: [f32; 4],
    pub(in crate::draw) diffuse: [f32; 4],
    /// Linear colour; w is the shininess.
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

/// The uniforms of a state; mirrors `Fixed` in fixed.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
pub(in crate::draw) struct FixedUniform {
    pub(in crate::draw) front: Reflection,
    pub(in crate::draw) back: Reflection,
    /// Linear colour; w is 0 without fog, 1 for the environment's haze, 2 for linear, 3 for exp and 4 for exp2.
    pub(in crate::draw) fog_color: [f32; 4],
    /// The end in metres and 1 / (end - start) of linear fog; the density per metre of the others. z is 1 if colours are
    /// mixed as they are displayed.
    pub(in crate::draw) fog: [f32; 4],
    /// Linear ambient colour of the light model; w is the reference of the alpha test.
    pub(in crate::draw) model_ambient: [f32; 4],
    /// x is 1 for a local viewer. y is the lit side: 0 for the visible one, 1 for the front, 2 for both. z is 1 if highlights
    /// are added after textures.
    pub(in crate::draw) model: [u32; 4],
    /// Bits of lights, bits of clip planes, the alpha test's function (7 passes all), 1 if a light replaces the sun.
    pub(in crate::draw) flags: [u32; 4],
    /// By unit: 0 off, 1 plane, 2 cube, 3 volume, 4 array.
    pub(in crate::draw) units: [u32; 4],
    /// The source of coordinates by unit: 0 the mesh, 1 object linear, 2 eye linear, 3 sphere map, 4 normal map,
    /// 5 reflection map, 6 the mesh's second ones, 7 the third ones; 16 more if a matrix follows.
    pub(in crate::draw) texgens: [u32; 4],
    /// The bias of the mip level by unit.
    pub(in crate::draw) bias: [f32; 4],
    /// The planes of s, t, r and q by unit.
    pub(in crate::draw) planes: [[f32; 4]; 4 * TEXTURE_UNITS],
    /// By unit: function and arguments of colour and of alpha, and the bits of the two scales; see [`combination`]. Zeros
    /// multiply the colour by the texture.
    pub(in crate::draw) envs: [[u32; 4]; TEXTURE_UNITS],
    /// The constant colour by unit, linear.
    pub(in crate::draw) env_colors: [[f32; 4]; TEXTURE_UNITS],
    /// The matrices of coordinates by unit.
    pub(in crate::draw) matrices: [[[f32; 4]; 4]; TEXTURE_UNITS],
    /// By unit: the axes, as bits, beyond whose edges the shader itself takes the border colour.
    pub(in crate::draw) borders: [u32; 4],
    /// The border colour by unit.
    pub(in crate::draw) border_colors: [[f32; 4]; TEXTURE_UNITS],
}

const _: () = assert!(TEXTURE_UNITS == 4);

/// Returns the lower unit that has taken the one binding for cubes, volumes or arrays with another texture.
pub(in crate::draw) fn taken_by(state: &ResolvedState, unit: usize) -> Option<usize> {
    let binding = state.texture(unit)?;
    if matches!(binding.texture.dimension, TextureDimension::D1 | TextureDimension::D2) {
        return None;
    }
    let is_alike = |b: &TextureBinding| b.texture.dimension == binding.texture.dimension;
    let first = (0..unit).find(|before| state.texture(*before).is_some_and(is_alike))?;
    // The bias of the mip level is separate for each unit.
    let sampler = |b: &TextureBinding| Sampler { mip_bias: 0.0, ..b.sampler };
    let is_other = |b: &TextureBinding| !Arc::ptr_eq(&b.texture, &binding.texture) || sampler(b) != sampler(binding);
    state.texture(first).is_some_and(is_other).then_some(first)
}

/// Returns a combination as the shader reads it. A function has 4 bits, followed by 6 for each argument: 4 bits of the
/// source and 2 of the operand. The highest bit of the first word says that values are combined as they are displayed.
fn combination(combine: &TexEnvCombine) -> [u32; 4] {
    let part = |function: CombineFunction, arguments: &[(CombineSource, CombineOperand); 3]| {
        let of = |(source, operand): &(CombineSource, CombineOperand)| {
            let source = match source {
                CombineSource::Texture => 0,
                CombineSource::Constant => 1,
                CombineSource::PrimaryColor => 2,
                CombineSource::Previous => 3,
                CombineSource::TextureOf(unit) => 4 + u32::from(*unit).min(TEXTURE_UNITS as u32),
            };
            source | (*operand as u32) << 4
        };
        let arguments = (0..).zip(arguments).map(|(at, argument)| of(argument) << (4 + 6 * at));
        function as u32 | arguments.sum::<u32>()
    };
    let scales = [combine.color_scale, combine.alpha_scale].map(f32::to_bits);
    let color = part(combine.color, &combine.color_arguments) | u32::from(combine.is_displayed) << 31;
    [color, part(combine.alpha, &combine.alpha_arguments), scales[0], scales[1]]
}

/// Returns the axes along which a sampler takes the border colour, as bits.
fn border_axes(sampler: &Sampler) -> u32 {
    (0..).zip(sampler.wrap).map(|(axis, mode)| u32::from(mode == WrapMode::ClampToBorder) << axis).sum()
}

impl FixedUniform {
    /// Returns the uniforms of a state in a view of a stage. `emulates_border` returns true for samplers whose border colour
    /// the adapter does not have.
    pub(in crate::draw) fn new(
        state: &ResolvedState,
        stage: &RenderStage,
        view: u32,
        emulates_border: impl Fn(&Sampler) -> bool,
    ) -> Self {
        let [front, back] = state.materials().unwrap_or_default();
        let given = state.light_model();
        let faces = given.map_or(0, |model| if model.two_sided { 2 } else { 1 });
        let model = given.unwrap_or_default();
        let is_separate = model.color_control == ColorControl::SeparateSpecularColor;
        let alpha = state.alpha_func();
        let (fog_color, fog) = match state.fog() {
            _ if !state.mode(Mode::Fog) => ([0.0; 4], [0.0; 4]),
            None => ([0.0, 0.0, 0.0, 1.0], [0.0; 4]),
            Some(fog) => {
                let as_displayed = f32::from(u8::from(fog.is_displayed));
                match fog.mode {
                    FogMode::Linear { start_m, end_m } => {
                        let span = end_m - start_m;
                        let scale = if span.abs() > 1e-6 { 1.0 / span } else { 1e6 };
                        (rgb(fog.color, 2.0), [end_m, scale, as_displayed, 0.0])
                    }
                    FogMode::Exp { density_per_m } => (rgb(fog.color, 3.0), [density_per_m, 0.0, as_displayed, 0.0]),
                    FogMode::Exp2 { density_per_m } => (rgb(fog.color, 4.0), [density_per_m, 0.0, as_displayed, 0.0]),
                }
            }
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
                u32::from(replaces_sun(stage) || has_own_sun(state)),
            ],
            units: [0; 4],
            texgens: [0; 4],
            bias: [0.0; 4],
            planes: [[0.0; 4]; 4 * TEXTURE_UNITS],
            envs: [[0; 4]; TEXTURE_UNITS],
            env_colors: [[0.0; 4]; TEXTURE_UNITS],
            matrices: [[[0.0; 4]; 4]; TEXTURE_UNITS],
            borders: [0; 4],
            border_colors: [[0.0; 4]; TEXTURE_UNITS],
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
            if state.tex_env(unit) != TexEnv::Modulate {
                let combine = state.tex_env(unit).as_combination();
                (uniform.envs[unit], uniform.env_colors[unit]) = (combination(&combine), combine.constant);
            }
            if emulates_border(&binding.sampler) {
                uniform.borders[unit] = border_axes(&binding.sampler);
                uniform.border_colors[unit] = binding.sampler.border_color;
            }
            if let Some(matrix) = state.tex_mat(unit) {
                (uniform.matrices[unit], uniform.texgens[unit]) = (matrix, HAS_MATRIX);
            }
            let Some(texgen) = state.texgen(unit) else { continue };
            let of_node = stage.texgens.iter().rev().find(|of| usize::from(of.unit) == unit);
            let of_node = of_node.map(|of| of.moved(&eye_from(stage, view, of.view)));
            let (kind, planes) = match (texgen, of_node) {
                (TexGen::ObjectLinear(planes), _) => (1, planes),
                (TexGen::EyeLinear(_), Some(TexGen::EyeLinear(planes))) | (TexGen::EyeLinear(planes), _) => (2, planes),
                (TexGen::SphereMap, _) => (3, [[0.0; 4]; 4]),
                (TexGen::NormalMap, _) => (4, [[0.0; 4]; 4]),
                (TexGen::ReflectionMap, _) => (5, [[0.0; 4]; 4]),
                (TexGen::SecondUv, _) => (6, [[0.0; 4]; 4]),
                (TexGen::ThirdUv, _) => (7, [[0.0; 4]; 4]),
            };
            uniform.texgens[unit] |= kind;
            uniform.planes[4 * unit..4 * unit + 4].copy_from_slice(&planes);
        }
        uniform
    }
}
