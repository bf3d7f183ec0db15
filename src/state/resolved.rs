//! [`ResolvedState`]: the result of a chain of state sets from the root of the scene to a drawable.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::attributes::Attribute;
use super::bins::{BinDetails, SortMode};
use super::hook::OpaqueDrawData;
use super::inherited::{EyeSpaceState, Inherited, LocationState, Modes, applies};
use super::lighting::{Fog, Light, LightModel, SurfaceMaterial};
use super::modes::{COLOR_LOCATIONS, Mode, NumberError, StateValue, TEXTURE_UNITS};
use super::program::{Program, Uniform};
use super::raster::{
    AlphaFunc, BlendEquation, BlendFunc, ColorMask, CullFace, Depth, FrontFace, PolygonMode, PolygonOffset, SampleMask,
    Scissor, Stencil, Viewport,
};
use super::state_set::StateSet;
use super::texture::TextureBinding;
use super::texture_units::{TexEnv, TexGen};
use super::variance::DataVariance;

/// The state that a chain of state sets results in. Cull resolves each chain once and keeps it from frame to frame.
///
/// More than 16 fields: one for each attribute that OSG knows, read through methods that combine it with its mode.
#[derive(Clone, Debug)]
pub struct ResolvedState {
    /// Identifies the chain in the process; draw caches what it derives by it.
    pub id: u64,
    /// The name of the last state set that has one.
    pub name: String,
    /// The product of all linear colour factors.
    pub color: [f32; 4],
    /// The bin of the leaves, from the outermost to the innermost; empty for the stage's own leaves.
    pub bins: Vec<BinDetails>,
    /// By index into `bins`: the callback that draws the bin instead of the renderer. May be shorter than `bins`.
    pub bin_callbacks: Vec<Option<OpaqueDrawData>>,
    bins_overridden: bool,
    /// The materials of the drawables blend.
    blended_material: bool,
    /// The state is below a node with local lights.
    local_lights: bool,
    modes: Modes,
    blend_func: Inherited<BlendFunc>,
    blend_equation: Inherited<BlendEquation>,
    blend_color: Inherited<[f32; 4]>,
    depth: Inherited<Depth>,
    cull_face: Inherited<CullFace>,
    front_face: Inherited<FrontFace>,
    polygon_mode: Inherited<PolygonMode>,
    polygon_offset: Inherited<PolygonOffset>,
    color_mask: Inherited<ColorMask>,
    locations: [LocationState; COLOR_LOCATIONS],
    sample_mask: Inherited<SampleMask>,
    alpha_func: Inherited<AlphaFunc>,
    stencil: Inherited<Stencil>,
    scissor: Inherited<Scissor>,
    viewport: Inherited<Option<Viewport>>,
    /// Materials of front and back faces.
    materials: Inherited<Option<[SurfaceMaterial; 2]>>,
    light_model: Inherited<Option<LightModel>>,
    fog: Inherited<Option<Fog>>,
    texgens: [Inherited<Option<TexGen>>; TEXTURE_UNITS],
    textures: [Inherited<Option<TextureBinding>>; TEXTURE_UNITS],
    tex_envs: [Inherited<TexEnv>; TEXTURE_UNITS],
    tex_mats: [Inherited<Option<[[f32; 4]; 4]>>; TEXTURE_UNITS],
    program: Inherited<Option<Arc<Program>>>,
    /// The attribute of the application's own.
    custom: Inherited<Option<OpaqueDrawData>>,
    eye_space: Option<Arc<EyeSpaceState>>,
    /// Some state set of the chain is [`DataVariance::Dynamic`].
    is_dynamic: bool,
    /// Uniforms, each with whether it overrides those below.
    uniforms: Vec<(Uniform, bool)>,
    /// References to lights, clip planes or texture units whose number is out of range, with the names of the state sets
    /// that contain them.
    invalid_numbers: Vec<(String, NumberError)>,
}

fn next_id() -> u64 {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    NEXT.fetch_add(1, Ordering::Relaxed)
}

impl Default for ResolvedState {
    fn default() -> Self {
        Self {
            id: next_id(),
            name: String::new(),
            color: [1.0; 4],
            bins: Vec::new(),
            bin_callbacks: Vec::new(),
            bins_overridden: false,
            blended_material: false,
            local_lights: false,
            modes: Modes { on: Mode::ON_BY_DEFAULT, overrides: 0 },
            blend_func: Inherited { value: BlendFunc::ALPHA, is_set: false, overrides: false },
            blend_equation: Inherited::default(),
            blend_color: Inherited::default(),
            depth: Inherited::default(),
            cull_face: Inherited::default(),
            front_face: Inherited::default(),
            polygon_mode: Inherited::default(),
            polygon_offset: Inherited::default(),
            color_mask: Inherited::default(),
            locations: Default::default(),
            sample_mask: Inherited::default(),
            alpha_func: Inherited::default(),
            stencil: Inherited::default(),
            scissor: Inherited::default(),
            viewport: Inherited::default(),
            materials: Inherited::default(),
            light_model: Inherited::default(),
            fog: Inherited::default(),
            texgens: Default::default(),
            textures: Default::default(),
            tex_envs: Default::default(),
            tex_mats: Default::default(),
            program: Inherited::default(),
            custom: Inherited::default(),
            eye_space: None,
            is_dynamic: false,
            uniforms: Vec::new(),
            invalid_numbers: Vec::new(),
        }
    }
}

impl ResolvedState {
    /// Returns the state below a state set.
    pub fn below(&self, set: &StateSet) -> Self {
        let mut below = Self { id: next_id(), ..self.clone() };
        if !set.name.is_empty() {
            below.name.clone_from(&set.name);
        }
        if let Some(color) = set.color {
            for (mine, factor) in below.color.iter_mut().zip(color) {
                *mine *= factor;
            }
        }
        if let Some(bin) = set.bin
            && applies(self.bins_overridden, set.bin_value)
        {
            if !set.nest_bins {
                below.bins.clear();
                below.bin_callbacks.clear();
            }
            if set.bin_callback.is_some() {
                below.bin_callbacks.resize(below.bins.len(), None);
                below.bin_callbacks.push(set.bin_callback.clone());
            }
            below.bins.push(bin);
        }
        below.bins_overridden |= set.bin_value.contains(StateValue::OVERRIDE);
        below.is_dynamic |= set.data_variance == DataVariance::Dynamic;
        for (mode, how) in &set.modes {
            below.modes.apply(*mode, *how);
            // A mode that is switched off needs no check.
            if how.contains(StateValue::ON) {
                below.note(set, mode.check());
            }
        }
        for (attribute, how) in &set.attributes {
            below.apply(attribute, *how);
            below.note(set, attribute.check());
        }
        for (uniform, how) in &set.uniforms {
            match below.uniforms.iter_mut().find(|(u, _)| u.name == uniform.name) {
                Some((held, overrides)) if applies(*overrides, *how) => {
                    (*held, *overrides) = (uniform.clone(), how.contains(StateValue::OVERRIDE));
                }
                Some(_) => {}
                None if applies(false, *how) => {
                    below.uniforms.push((uniform.clone(), how.contains(StateValue::OVERRIDE)));
                }
                None => {}
            }
        }
        below
    }

    /// Records a number that is out of range.
    fn note(&mut self, set: &StateSet, checked: Result<(), NumberError>) {
        let is_known = |error| self.invalid_numbers.iter().any(|(name, known)| *known == error && *name == set.name);
        if let Err(error) = checked
            && !is_known(error)
        {
            self.invalid_numbers.push((set.name.clone(), error));
        }
    }

    /// Returns the numbers of lights, clip planes, texture units and attachments in the chain that are out of range, with the
    /// names of the state sets that contain them.
    pub fn wrong_numbers(&self) -> &[(String, NumberError)] {
        &self.invalid_numbers
    }

    /// Applies an attribute of a state set further down.
    fn apply(&mut self, attribute: &Attribute, how: StateValue) {
        match attribute {
            Attribute::BlendFunc(v) => self.blend_func.apply(*v, how),
            Attribute::BlendEquation(v) => self.blend_equation.apply(*v, how),
            Attribute::BlendColor(v) => self.blend_color.apply(*v, how),
            Attribute::Depth(v) => self.depth.apply(*v, how),
            Attribute::CullFace(v) => self.cull_face.apply(*v, how),
            Attribute::FrontFace(v) => self.front_face.apply(*v, how),
            Attribute::PolygonMode(v) => self.polygon_mode.apply(*v, how),
            Attribute::PolygonOffset(v) => self.polygon_offset.apply(*v, how),
            Attribute::ColorMask(v) => self.color_mask.apply(*v, how),
            Attribute::BlendFuncOf(location, v) => {
                apply_at(&mut self.locations, *location, |at| at.func.apply(Some(*v), how));
            }
            Attribute::BlendEquationOf(location, v) => {
                apply_at(&mut self.locations, *location, |at| at.equation.apply(Some(*v), how));
            }
            Attribute::ColorMaskOf(location, v) => {
                apply_at(&mut self.locations, *location, |at| at.mask.apply(Some(*v), how));
            }
            Attribute::SampleMask(v) => self.sample_mask.apply(*v, how),
            Attribute::AlphaFunc(v) => self.alpha_func.apply(*v, how),
            Attribute::Stencil(v) => self.stencil.apply(*v, how),
            Attribute::Scissor(v) => self.scissor.apply(*v, how),
            Attribute::Viewport(v) => self.viewport.apply(Some(*v), how),
            Attribute::SurfaceMaterial(v) => self.materials.apply(Some([*v; 2]), how),
            Attribute::SurfaceMaterials { front, back } => self.materials.apply(Some([*front, *back]), how),
            Attribute::LightModel(v) => self.light_model.apply(Some(*v), how),
            Attribute::Fog(v) => self.fog.apply(Some(*v), how),
            Attribute::TexGen(unit, v) => apply_at(&mut self.texgens, *unit, |at| at.apply(Some(*v), how)),
            Attribute::TexEnv(unit, v) => apply_at(&mut self.tex_envs, *unit, |at| at.apply(*v, how)),
            Attribute::TexMat(unit, v) => apply_at(&mut self.tex_mats, *unit, |at| at.apply(Some(*v), how)),
            Attribute::Texture(unit, v) => apply_at(&mut self.textures, *unit, |at| at.apply(Some(v.clone()), how)),
            Attribute::Light(v) => {
                let lights = &mut EyeSpaceState::of(&mut self.eye_space).lights;
                apply_at(lights, v.number, |at| at.apply(Some(*v), how));
            }
            Attribute::ClipPlane(number, v) => {
                let planes = &mut EyeSpaceState::of(&mut self.eye_space).clip_planes;
                apply_at(planes, *number, |at| at.apply(Some(*v), how));
            }
            Attribute::Custom(v) => self.custom.apply(Some(v.clone()), how),
            Attribute::Program(v) => self.program.apply(Some(v.clone()), how),
        }
    }

    /// Returns the state of drawables whose material blends: they write no depth and are in the transparent bin, unless a
    /// state set decides otherwise.
    pub fn blended(&self) -> Self {
        let mut blended = Self { id: next_id(), blended_material: true, ..self.clone() };
        if blended.bins.is_empty() {
            blended.bins.push(BinDetails::TRANSPARENT);
        }
        blended
    }

    /// Returns the state of everything below a node with local lights.
    pub(crate) fn below_local_lights(&self) -> Self {
        Self { id: next_id(), local_lights: true, ..self.clone() }
    }

    /// Returns true below a node with local lights. The stage has the lights themselves.
    pub(crate) fn has_local_lights(&self) -> bool {
        self.local_lights
    }

    /// Returns the innermost bin.
    pub fn bin(&self) -> BinDetails {
        self.bins.last().copied().unwrap_or(BinDetails::OPAQUE)
    }

    /// Returns true if a mode is on, regardless of the drawable's own material.
    pub fn mode(&self, mode: Mode) -> bool {
        self.modes.is_on(mode)
    }

    /// Returns true if blending is on, by a state set or by the material.
    pub fn blends(&self) -> bool {
        if self.blended_material { self.modes.for_drawable(Mode::Blend, true) } else { self.mode(Mode::Blend) }
    }

    /// Returns true if a drawable is lit, whose own material is `unlit` or not.
    pub fn is_lit(&self, unlit: bool) -> bool {
        if unlit { self.modes.for_drawable(Mode::Lighting, false) } else { self.mode(Mode::Lighting) }
    }

    /// Returns true if the textures of drawables' own materials and of height tiles are used: texture unit 0 is not
    /// overridden off.
    pub fn has_own_textures(&self) -> bool {
        self.modes.for_drawable(Mode::Texture(0), true)
    }

    /// Returns the factors of blending.
    pub fn blend_func(&self) -> BlendFunc {
        self.blend_func.value
    }

    /// Returns the operation of blending.
    pub fn blend_equation(&self) -> BlendEquation {
        self.blend_equation.value
    }

    /// Returns the constant colour of blending, linear.
    pub fn blend_color(&self) -> [f32; 4] {
        self.blend_color.value
    }

    /// Returns depth test and write; `None` if the depth test is off.
    pub fn depth(&self) -> Option<Depth> {
        let blended = self.blended_material && !self.depth.is_set;
        let depth = if blended { Depth { write: false, ..self.depth.value } } else { self.depth.value };
        self.mode(Mode::DepthTest).then_some(depth)
    }

    /// Returns true if depth is written.
    pub fn writes_depth(&self) -> bool {
        self.depth().is_some_and(|d| d.write)
    }

    /// Returns true if drawables cast shadows: they write depth and do not blend.
    pub fn casts_shadow(&self) -> bool {
        self.writes_depth() && !self.blends()
    }

    /// Returns the faces that are culled of a drawable, whose material is double-sided or not.
    pub fn culled_face(&self, double_sided: bool) -> Option<CullFace> {
        let on = if double_sided { self.modes.for_drawable(Mode::CullFace, false) } else { self.mode(Mode::CullFace) };
        on.then_some(self.cull_face.value)
    }

    /// Returns true if the fixed function shades: there are lights besides the environment's, fog, materials, clip planes,
    /// alpha test or textures of units.
    pub(crate) fn is_fixed_function(&self) -> bool {
        let of_modes = self.modes.on ^ Mode::ON_BY_DEFAULT;
        of_modes & Mode::OF_FIXED_FUNCTION != 0
            || self.materials.value.is_some()
            || self.fog.value.is_some()
            || self.light_model.value.is_some()
            || self.lights().any(|light| self.mode(Mode::Light(light.number)))
    }

    /// Returns the bits, by number, of the lights or clip planes that are on. `first` is the mode of number 0.
    pub(crate) fn mode_bits(&self, first: Mode, count: usize) -> u32 {
        first.index().map_or(0, |index| (self.modes.on >> index) as u32 & ((1 << count) - 1))
    }

    /// Returns factors and operation of blending for a colour attachment.
    pub fn blending_of(&self, location: usize) -> (BlendFunc, BlendEquation) {
        let own = self.locations.get(location).copied().unwrap_or_default();
        (own.func.value.unwrap_or(self.blend_func.value), own.equation.value.unwrap_or(self.blend_equation.value))
    }

    /// Returns the components that are written to a colour attachment.
    pub fn color_mask_of(&self, location: usize) -> ColorMask {
        self.locations.get(location).and_then(|own| own.mask.value).unwrap_or(self.color_mask.value)
    }

    /// Returns the samples that are drawn if the mode is on.
    pub fn sample_mask(&self) -> Option<SampleMask> {
        self.mode(Mode::SampleMask).then_some(self.sample_mask.value)
    }

    /// Returns true if blended leaves drop fragments of alpha 0, which would only write depth. Leaves of bins that are sorted
    /// back to front do; OSG's state set of such bins has an alpha test for it.
    pub(crate) fn drops_invisible(&self) -> bool {
        self.blends() && self.writes_depth() && self.bin().sort == SortMode::BackToFront
    }

    /// Returns true if some state set of the chain is [`DataVariance::Dynamic`].
    pub fn is_dynamic(&self) -> bool {
        self.is_dynamic
    }

    /// Returns the winding order of front faces.
    pub fn front_face(&self) -> FrontFace {
        self.front_face.value
    }

    /// Returns the rasterisation of triangles.
    pub fn polygon_mode(&self) -> PolygonMode {
        self.polygon_mode.value
    }

    /// Returns the depth offset if it is on.
    pub fn polygon_offset(&self) -> Option<PolygonOffset> {
        self.mode(Mode::PolygonOffset).then_some(self.polygon_offset.value)
    }

    /// Returns the components that are written.
    pub fn color_mask(&self) -> ColorMask {
        self.color_mask.value
    }

    /// Returns the alpha test if it is on.
    pub fn alpha_func(&self) -> Option<AlphaFunc> {
        self.mode(Mode::AlphaTest).then_some(self.alpha_func.value)
    }

    /// Returns the stencil test if it is on.
    pub fn stencil(&self) -> Option<Stencil> {
        self.mode(Mode::StencilTest).then_some(self.stencil.value)
    }

    /// Returns the scissor if it is on.
    pub fn scissor(&self) -> Option<Scissor> {
        self.mode(Mode::ScissorTest).then_some(self.scissor.value)
    }

    /// Returns the viewport if one is set.
    pub fn viewport(&self) -> Option<Viewport> {
        self.viewport.value
    }

    /// Returns the materials of front and back faces that replace those of the drawables, if set.
    pub fn materials(&self) -> Option<[SurfaceMaterial; 2]> {
        self.materials.value
    }

    /// Returns the light model if one is set.
    pub fn light_model(&self) -> Option<LightModel> {
        self.light_model.value
    }

    /// Returns the fog that replaces the environment's haze, if set.
    pub fn fog(&self) -> Option<Fog> {
        self.fog.value
    }

    /// Returns the generator of a unit's texture coordinates if it is on.
    pub fn texgen(&self, unit: usize) -> Option<TexGen> {
        let on = self.mode(Mode::TexGen(unit as u8));
        self.texgens.get(unit).and_then(|t| t.value).filter(|_| on)
    }

    /// Returns how the texture of a unit changes the colour.
    pub fn tex_env(&self, unit: usize) -> TexEnv {
        self.tex_envs.get(unit).map(|env| env.value).unwrap_or_default()
    }

    /// Returns true if some texture does more than multiply the colour.
    pub fn combines_textures(&self) -> bool {
        (0..TEXTURE_UNITS).any(|unit| self.tex_env(unit) != TexEnv::Modulate && self.texture(unit).is_some())
    }

    /// Returns the matrix of a unit's texture coordinates by columns, if one is set.
    pub fn tex_mat(&self, unit: usize) -> Option<[[f32; 4]; 4]> {
        self.tex_mats.get(unit)?.value
    }

    /// Returns the lights of state sets, in eye space.
    pub fn lights(&self) -> impl Iterator<Item = &Light> {
        let lights = self.eye_space.iter().flat_map(|state| &state.lights);
        lights.filter_map(|light| light.value.as_ref())
    }

    /// Returns the clip planes of state sets with their numbers, in eye space: a point `p` is kept if `normal . p + d >= 0`.
    pub fn clip_planes(&self) -> impl Iterator<Item = (u8, [f64; 4])> {
        let planes = self.eye_space.iter().flat_map(|state| (0..).zip(&state.clip_planes));
        planes.filter_map(|(number, plane)| Some((number, plane.value?)))
    }

    /// Returns the attribute of the application's own, if one is set.
    pub fn custom(&self) -> Option<&OpaqueDrawData> {
        self.custom.value.as_ref()
    }

    /// Returns the texture of a unit if it is on.
    pub fn texture(&self, unit: usize) -> Option<&TextureBinding> {
        let on = self.mode(Mode::Texture(unit as u8));
        self.textures.get(unit).and_then(|t| t.value.as_ref()).filter(|_| on)
    }

    /// Returns the program, if one is set.
    pub fn program(&self) -> Option<&Arc<Program>> {
        self.program.value.as_ref()
    }

    /// Returns a uniform by its name.
    pub fn uniform(&self, name: &str) -> Option<&Uniform> {
        self.uniforms.iter().map(|(u, _)| u).find(|u| &*u.name == name)
    }

    /// Returns all uniforms.
    pub fn uniforms(&self) -> impl Iterator<Item = &Uniform> {
        self.uniforms.iter().map(|(u, _)| u)
    }
}

/// Applies a value to one of several; a number that is out of range was noted.
fn apply_at<T>(all: &mut [T], number: u8, apply: impl FnOnce(&mut T)) {
    if let Some(at) = all.get_mut(usize::from(number)) {
        apply(at);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn how() -> impl Strategy<Value = StateValue> {
        let flag = |on: bool, f: StateValue| if on { f } else { StateValue::OFF };
        (any::<bool>(), any::<bool>(), any::<bool>(), 0..8u8).prop_map(move |(on, over, protect, inherit)| {
            flag(on, StateValue::ON)
                | flag(over, StateValue::OVERRIDE)
                | flag(protect, StateValue::PROTECTED)
                | flag(inherit == 0, StateValue::INHERIT)
        })
    }

    /// Reference implementation: the index of the set whose value applies after the first `n` sets of a chain.
    fn holder(chain: &[Option<StateValue>], n: usize) -> Option<usize> {
        let last = n.checked_sub(1)?;
        let above = holder(chain, last);
        let Some(own) = chain[last].filter(|own| !own.contains(StateValue::INHERIT)) else { return above };
        let overridden = above.and_then(|a| chain[a]).is_some_and(|a| a.contains(StateValue::OVERRIDE));
        if overridden && !own.contains(StateValue::PROTECTED) { above } else { Some(last) }
    }

    proptest! {
        #[test]
        fn chains_resolve_as_the_reference_implementation(
            modes in prop::collection::vec(prop::option::of(how()), 0..8),
            offsets in prop::collection::vec(prop::option::of(how()), 0..8),
        ) {
            let sets = (0..modes.len().max(offsets.len())).map(|i| {
                let mut set = StateSet::default();
                if let Some(how) = modes.get(i).copied().flatten() {
                    set.set_mode(Mode::Blend, how);
                }
                if let Some(how) = offsets.get(i).copied().flatten() {
                    set.set_attribute(Attribute::PolygonOffset(PolygonOffset { factor: i as f32, units: 0.5 }), how);
                    set.set_mode(Mode::PolygonOffset, StateValue::ON | StateValue::PROTECTED);
                }
                set
            });
            let resolved = sets.fold(ResolvedState::default(), |state, set| state.below(&set));
            let on = holder(&modes, modes.len()).and_then(|i| modes[i]).is_some_and(|v| v.contains(StateValue::ON));
            prop_assert_eq!(resolved.mode(Mode::Blend), on);
            let offset = holder(&offsets, offsets.len()).map_or(0.0, |i| i as f32);
            prop_assert_eq!(resolved.polygon_offset.value.factor, offset);
            prop_assert_eq!(resolved.polygon_offset().is_some(), offsets.iter().any(Option::is_some));
        }
    }

    #[test]
    fn materials_decide_unless_overridden() {
        let with = |mode, how| {
            let mut set = StateSet::default();
            set.set_mode(mode, how);
            ResolvedState::default().below(&set)
        };
        let plain = ResolvedState::default();
        assert!(!plain.blends() && plain.blended().blends());
        assert!(plain.writes_depth() && !plain.blended().writes_depth());
        assert!(with(Mode::Blend, StateValue::OFF).blended().blends());
        assert!(!with(Mode::Blend, StateValue::OVERRIDE).blended().blends(), "overridden off");
        assert_eq!(plain.culled_face(true), None);
        assert_eq!(with(Mode::CullFace, StateValue::ON).culled_face(true), None);
        assert_eq!(with(Mode::CullFace, StateValue::ON | StateValue::OVERRIDE).culled_face(true), Some(CullFace::Back));
        assert_eq!(with(Mode::CullFace, StateValue::OFF).culled_face(false), None);
        assert_eq!(with(Mode::DepthTest, StateValue::OFF).depth(), None);
    }
}
