//! What a chain of state sets comes to.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::attributes::{
    AlphaFunc, Attribute, BlendEquation, BlendFunc, ColorMask, CullFace, Depth, FrontFace, Mode, NumberError,
    PolygonMode, PolygonOffset, Scissor, StateValue, Stencil, TEXTURE_UNITS, TexGen, Viewport,
};
use super::lighting::{Fog, LightModel, SurfaceMaterial};
use super::{BinDetails, DrawHook, Program, StateSet, TextureBinding, Uniform};

/// A value as the chain above left it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Stated<T> {
    value: T,
    /// Some state set said it.
    given: bool,
    /// What comes below does not count unless it is protected.
    overrides: bool,
}

impl<T> Stated<T> {
    /// What a state set further down says; as `State::pushMode` and `State::pushAttribute` of OSG decide.
    fn state(&mut self, value: T, how: StateValue) {
        if counts(self.overrides, how) {
            *self = Self { value, given: true, overrides: how.contains(StateValue::OVERRIDE) };
        }
    }
}

/// Whether what is said below something that overrides (or not) counts.
fn counts(overridden: bool, how: StateValue) -> bool {
    (!overridden || how.contains(StateValue::PROTECTED)) && !how.contains(StateValue::INHERIT)
}

/// All modes, a bit each by [`Mode::index`].
#[derive(Clone, Copy, Debug, PartialEq)]
struct Modes {
    on: u64,
    overrides: u64,
}

const _: () = assert!(Mode::COUNT <= 64);

/// None for what there is not.
fn bit(mode: Mode) -> u64 {
    mode.index().map_or(0, |index| 1 << index)
}

impl Modes {
    fn state(&mut self, mode: Mode, how: StateValue) {
        let bit = bit(mode);
        if counts(self.overrides & bit != 0, how) {
            let put = |bits: u64, set: bool| if set { bits | bit } else { bits & !bit };
            self.on = put(self.on, how.contains(StateValue::ON));
            self.overrides = put(self.overrides, how.contains(StateValue::OVERRIDE));
        }
    }

    fn is_on(&self, mode: Mode) -> bool {
        self.on & bit(mode) != 0
    }

    /// What a drawable itself says, where nothing above overrides it.
    fn by_drawable(&self, mode: Mode, value: bool) -> bool {
        if self.overrides & bit(mode) != 0 { self.is_on(mode) } else { value }
    }
}

/// Inherited state sets, resolved once for each chain and kept by cull from frame to frame.
#[derive(Clone, Debug)]
pub struct ResolvedState {
    /// Unlike that of any other chain in the process; draw keeps what it derives under it.
    pub id: u64,
    /// Name of the last state set that has one.
    pub name: String,
    /// Linear colour factor: the product of all.
    pub color: [f32; 4],
    /// The bin the leaves are in, from the outermost to the innermost; the stage's own without any.
    pub bins: Vec<BinDetails>,
    /// Those of `bins` that the application draws itself, in their places; may be shorter.
    pub bin_callbacks: Vec<Option<DrawHook>>,
    bins_overridden: bool,
    /// The drawables' materials blend.
    blended_material: bool,
    modes: Modes,
    blend_func: Stated<BlendFunc>,
    blend_equation: Stated<BlendEquation>,
    blend_color: Stated<[f32; 4]>,
    depth: Stated<Depth>,
    cull_face: Stated<CullFace>,
    front_face: Stated<FrontFace>,
    polygon_mode: Stated<PolygonMode>,
    polygon_offset: Stated<PolygonOffset>,
    color_mask: Stated<ColorMask>,
    alpha_func: Stated<AlphaFunc>,
    stencil: Stated<Stencil>,
    scissor: Stated<Scissor>,
    viewport: Stated<Option<Viewport>>,
    /// Front and back.
    materials: Stated<Option<[SurfaceMaterial; 2]>>,
    light_model: Stated<Option<LightModel>>,
    fog: Stated<Option<Fog>>,
    texgens: [Stated<Option<TexGen>>; TEXTURE_UNITS],
    textures: [Stated<Option<TextureBinding>>; TEXTURE_UNITS],
    program: Stated<Option<Arc<Program>>>,
    uniforms: Vec<(Uniform, bool)>,
    /// What was said of lights, planes and units that there are not, with the names of the sets that said it.
    wrong: Vec<(String, NumberError)>,
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
            modes: Modes { on: Mode::ON_BY_DEFAULT, overrides: 0 },
            blend_func: Stated { value: BlendFunc::ALPHA, given: false, overrides: false },
            blend_equation: Stated::default(),
            blend_color: Stated::default(),
            depth: Stated::default(),
            cull_face: Stated::default(),
            front_face: Stated::default(),
            polygon_mode: Stated::default(),
            polygon_offset: Stated::default(),
            color_mask: Stated::default(),
            alpha_func: Stated::default(),
            stencil: Stated::default(),
            scissor: Stated::default(),
            viewport: Stated::default(),
            materials: Stated::default(),
            light_model: Stated::default(),
            fog: Stated::default(),
            texgens: Default::default(),
            textures: Default::default(),
            program: Stated::default(),
            uniforms: Vec::new(),
            wrong: Vec::new(),
        }
    }
}

impl ResolvedState {
    /// The state below a state set.
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
            && counts(self.bins_overridden, set.bin_value)
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
        for (mode, how) in &set.modes {
            below.modes.state(*mode, *how);
            // Off it is anyway.
            if how.contains(StateValue::ON) {
                below.check(set, *mode);
            }
        }
        for (attribute, how) in &set.attributes {
            below.give(attribute, *how);
            if let Some(mode) = attribute.mode() {
                below.check(set, mode);
            }
        }
        for (uniform, how) in &set.uniforms {
            match below.uniforms.iter_mut().find(|(u, _)| u.name == uniform.name) {
                Some((held, overrides)) if counts(*overrides, *how) => {
                    (*held, *overrides) = (uniform.clone(), how.contains(StateValue::OVERRIDE));
                }
                Some(_) => {}
                None if counts(false, *how) => {
                    below.uniforms.push((uniform.clone(), how.contains(StateValue::OVERRIDE)));
                }
                None => {}
            }
        }
        below
    }

    fn check(&mut self, set: &StateSet, mode: Mode) {
        let is_known = |error| self.wrong.iter().any(|(name, known)| *known == error && *name == set.name);
        if let Err(error) = mode.check()
            && !is_known(error)
        {
            self.wrong.push((set.name.clone(), error));
        }
    }

    /// Numbers of lights, planes and units in the chain that there are not, with the names of the sets that gave them.
    pub fn wrong_numbers(&self) -> &[(String, NumberError)] {
        &self.wrong
    }

    fn give(&mut self, attribute: &Attribute, how: StateValue) {
        match attribute {
            Attribute::BlendFunc(v) => self.blend_func.state(*v, how),
            Attribute::BlendEquation(v) => self.blend_equation.state(*v, how),
            Attribute::BlendColor(v) => self.blend_color.state(*v, how),
            Attribute::Depth(v) => self.depth.state(*v, how),
            Attribute::CullFace(v) => self.cull_face.state(*v, how),
            Attribute::FrontFace(v) => self.front_face.state(*v, how),
            Attribute::PolygonMode(v) => self.polygon_mode.state(*v, how),
            Attribute::PolygonOffset(v) => self.polygon_offset.state(*v, how),
            Attribute::ColorMask(v) => self.color_mask.state(*v, how),
            Attribute::AlphaFunc(v) => self.alpha_func.state(*v, how),
            Attribute::Stencil(v) => self.stencil.state(*v, how),
            Attribute::Scissor(v) => self.scissor.state(*v, how),
            Attribute::Viewport(v) => self.viewport.state(Some(*v), how),
            Attribute::SurfaceMaterial(v) => self.materials.state(Some([*v; 2]), how),
            Attribute::SurfaceMaterials { front, back } => self.materials.state(Some([*front, *back]), how),
            Attribute::LightModel(v) => self.light_model.state(Some(*v), how),
            Attribute::Fog(v) => self.fog.state(Some(*v), how),
            Attribute::TexGen(unit, v) => {
                if let Some(texgen) = self.texgens.get_mut(usize::from(*unit)) {
                    texgen.state(Some(*v), how);
                }
            }
            Attribute::Texture(unit, v) => {
                if let Some(texture) = self.textures.get_mut(usize::from(*unit)) {
                    texture.state(Some(v.clone()), how);
                }
            }
            Attribute::Program(v) => self.program.state(Some(v.clone()), how),
        }
    }

    /// The state of drawables whose material blends: they write no depth and go to the transparent bin, unless a
    /// state set says otherwise.
    pub fn blended(&self) -> Self {
        let mut blended = Self { id: next_id(), blended_material: true, ..self.clone() };
        if blended.bins.is_empty() {
            blended.bins.push(BinDetails::TRANSPARENT);
        }
        blended
    }

    /// The innermost bin.
    pub fn bin(&self) -> BinDetails {
        self.bins.last().copied().unwrap_or(BinDetails::OPAQUE)
    }

    /// Whether a mode is on, before the drawable's own material.
    pub fn mode(&self, mode: Mode) -> bool {
        self.modes.is_on(mode)
    }

    /// Blending is on: by a state set, or by the material.
    pub fn blends(&self) -> bool {
        if self.blended_material { self.modes.by_drawable(Mode::Blend, true) } else { self.mode(Mode::Blend) }
    }

    /// Light falls on a drawable whose material is lit or not.
    pub fn is_lit(&self, unlit: bool) -> bool {
        if unlit { self.modes.by_drawable(Mode::Lighting, false) } else { self.mode(Mode::Lighting) }
    }

    /// The textures of drawables' own materials and of height tiles count, until something above overrides texture
    /// unit 0.
    pub fn has_own_textures(&self) -> bool {
        self.modes.by_drawable(Mode::Texture(0), true)
    }

    /// How blending weighs.
    pub fn blend_func(&self) -> BlendFunc {
        self.blend_func.value
    }

    /// How blending adds.
    pub fn blend_equation(&self) -> BlendEquation {
        self.blend_equation.value
    }

    /// The constant of blending, linear.
    pub fn blend_color(&self) -> [f32; 4] {
        self.blend_color.value
    }

    /// Depth test and write; `None` where the depth test is off.
    pub fn depth(&self) -> Option<Depth> {
        let blended = self.blended_material && !self.depth.given;
        let depth = if blended { Depth { write: false, ..self.depth.value } } else { self.depth.value };
        self.mode(Mode::DepthTest).then_some(depth)
    }

    /// True when depth is written.
    pub fn writes_depth(&self) -> bool {
        self.depth().is_some_and(|d| d.write)
    }

    /// True when drawables of it cast shadows: they hide what is behind them, and are not seen through.
    pub fn casts_shadow(&self) -> bool {
        self.writes_depth() && !self.blends()
    }

    /// The faces that are culled, of a drawable whose material is double-sided or not.
    pub fn culled_face(&self, double_sided: bool) -> Option<CullFace> {
        let on = if double_sided { self.modes.by_drawable(Mode::CullFace, false) } else { self.mode(Mode::CullFace) };
        on.then_some(self.cull_face.value)
    }

    /// Whether the shading is that of the fixed function: other lights than the environment's, fog, materials, clip
    /// planes, alpha test, textures of units.
    pub(crate) fn is_fixed_function(&self) -> bool {
        let of_modes = self.modes.on ^ Mode::ON_BY_DEFAULT;
        of_modes & Mode::OF_FIXED_FUNCTION != 0
            || self.materials.value.is_some()
            || self.fog.value.is_some()
            || self.light_model.value.is_some()
    }

    /// Bits of the lights (or clip planes) that are on, by number.
    pub(crate) fn mode_bits(&self, first: Mode, count: usize) -> u32 {
        first.index().map_or(0, |index| (self.modes.on >> index) as u32 & ((1 << count) - 1))
    }

    /// Which faces are front faces.
    pub fn front_face(&self) -> FrontFace {
        self.front_face.value
    }

    /// How triangles are rasterised.
    pub fn polygon_mode(&self) -> PolygonMode {
        self.polygon_mode.value
    }

    /// The depth offset, where it is on.
    pub fn polygon_offset(&self) -> Option<PolygonOffset> {
        self.mode(Mode::PolygonOffset).then_some(self.polygon_offset.value)
    }

    /// What is written.
    pub fn color_mask(&self) -> ColorMask {
        self.color_mask.value
    }

    /// The alpha test, where it is on.
    pub fn alpha_func(&self) -> Option<AlphaFunc> {
        self.mode(Mode::AlphaTest).then_some(self.alpha_func.value)
    }

    /// The stencil test, where it is on.
    pub fn stencil(&self) -> Option<Stencil> {
        self.mode(Mode::StencilTest).then_some(self.stencil.value)
    }

    /// The scissor, where it is on.
    pub fn scissor(&self) -> Option<Scissor> {
        self.mode(Mode::ScissorTest).then_some(self.scissor.value)
    }

    /// The viewport, where one is given.
    pub fn viewport(&self) -> Option<Viewport> {
        self.viewport.value
    }

    /// The reflection that stands for that of the drawables, where one is given: of front and back faces.
    pub fn materials(&self) -> Option<[SurfaceMaterial; 2]> {
        self.materials.value
    }

    /// How lights are reckoned with, where it is given.
    pub fn light_model(&self) -> Option<LightModel> {
        self.light_model.value
    }

    /// The fog that stands for the environment's haze, where one is given.
    pub fn fog(&self) -> Option<Fog> {
        self.fog.value
    }

    /// Texture coordinates of a unit, where they are generated.
    pub fn texgen(&self, unit: usize) -> Option<TexGen> {
        let on = self.mode(Mode::TexGen(unit as u8));
        self.texgens.get(unit).and_then(|t| t.value).filter(|_| on)
    }

    /// The texture of a unit, where it is on.
    pub fn texture(&self, unit: usize) -> Option<&TextureBinding> {
        let on = self.mode(Mode::Texture(unit as u8));
        self.textures.get(unit).and_then(|t| t.value.as_ref()).filter(|_| on)
    }

    /// The program that shades.
    pub fn program(&self) -> Option<&Arc<Program>> {
        self.program.value.as_ref()
    }

    /// A uniform by its name.
    pub fn uniform(&self, name: &str) -> Option<&Uniform> {
        self.uniforms.iter().map(|(u, _)| u).find(|u| &*u.name == name)
    }

    /// All uniforms.
    pub fn uniforms(&self) -> impl Iterator<Item = &Uniform> {
        self.uniforms.iter().map(|(u, _)| u)
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

    /// The slow, obvious way: of the first `n` sets of a chain, which one's value holds.
    fn holder(chain: &[Option<StateValue>], n: usize) -> Option<usize> {
        let last = n.checked_sub(1)?;
        let above = holder(chain, last);
        let Some(own) = chain[last].filter(|own| !own.contains(StateValue::INHERIT)) else { return above };
        let overridden = above.and_then(|a| chain[a]).is_some_and(|a| a.contains(StateValue::OVERRIDE));
        if overridden && !own.contains(StateValue::PROTECTED) { above } else { Some(last) }
    }

    proptest! {
        #[test]
        fn chains_resolve_as_the_obvious_resolver_says(
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
    fn materials_speak_last_unless_overridden() {
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
