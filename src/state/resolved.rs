//! What a chain of state sets comes to.

use super::attributes::{
    Attribute, BlendEquation, BlendFunc, ColorMask, CullFace, Depth, FrontFace, Mode, PolygonMode, PolygonOffset,
    StateValue,
};
use super::{BinDetails, StateSet};

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
    const fn new(value: T) -> Self {
        Self { value, given: false, overrides: false }
    }

    /// What a state set further down says; as `State::pushMode` and `State::pushAttribute` of OSG decide.
    fn state(&mut self, value: T, how: StateValue) {
        let counts = !self.overrides || how.contains(StateValue::PROTECTED);
        if counts && !how.contains(StateValue::INHERIT) {
            *self = Self { value, given: true, overrides: how.contains(StateValue::OVERRIDE) };
        }
    }

    /// What a drawable itself says, where nothing above overrides it.
    fn by_drawable(&self, value: T) -> T
    where
        T: Copy,
    {
        if self.overrides { self.value } else { value }
    }
}

/// Inherited state sets, resolved. Cull makes one for each state that has leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResolvedState {
    /// Linear colour factor: the product of all.
    pub color: [f32; 4],
    /// The bin the leaves are in.
    pub bin: BinDetails,
    /// Some state set asked for `bin`.
    bin_given: bool,
    /// The drawables' materials blend.
    blended_material: bool,
    modes: [Stated<bool>; Mode::ALL.len()],
    blend_func: Stated<BlendFunc>,
    blend_equation: Stated<BlendEquation>,
    depth: Stated<Depth>,
    cull_face: Stated<CullFace>,
    front_face: Stated<FrontFace>,
    polygon_mode: Stated<PolygonMode>,
    polygon_offset: Stated<PolygonOffset>,
    color_mask: Stated<ColorMask>,
}

impl Default for ResolvedState {
    fn default() -> Self {
        Self {
            color: [1.0; 4],
            bin: BinDetails::OPAQUE,
            bin_given: false,
            blended_material: false,
            modes: [Stated::new(false), Stated::new(true), Stated::new(true), Stated::new(false)],
            blend_func: Stated::new(BlendFunc::ALPHA),
            blend_equation: Stated::default(),
            depth: Stated::default(),
            cull_face: Stated::default(),
            front_face: Stated::default(),
            polygon_mode: Stated::default(),
            polygon_offset: Stated::default(),
            color_mask: Stated::default(),
        }
    }
}

impl ResolvedState {
    /// The state below a state set.
    pub fn below(mut self, set: &StateSet) -> Self {
        if let Some(color) = set.color {
            for (mine, factor) in self.color.iter_mut().zip(color) {
                *mine *= factor;
            }
        }
        if let Some(bin) = set.bin {
            (self.bin, self.bin_given) = (bin, true);
        }
        for (mode, how) in &set.modes {
            self.modes[*mode as usize].state(how.contains(StateValue::ON), *how);
        }
        for (attribute, how) in &set.attributes {
            match *attribute {
                Attribute::BlendFunc(v) => self.blend_func.state(v, *how),
                Attribute::BlendEquation(v) => self.blend_equation.state(v, *how),
                Attribute::Depth(v) => self.depth.state(v, *how),
                Attribute::CullFace(v) => self.cull_face.state(v, *how),
                Attribute::FrontFace(v) => self.front_face.state(v, *how),
                Attribute::PolygonMode(v) => self.polygon_mode.state(v, *how),
                Attribute::PolygonOffset(v) => self.polygon_offset.state(v, *how),
                Attribute::ColorMask(v) => self.color_mask.state(v, *how),
            }
        }
        self
    }

    /// The state of drawables whose material blends: they write no depth and go to the transparent bin, unless a
    /// state set says otherwise.
    pub fn blended(mut self) -> Self {
        self.blended_material = true;
        if !self.bin_given {
            self.bin = BinDetails::TRANSPARENT;
        }
        self
    }

    /// Whether a mode is on, before the drawable's own material.
    pub fn mode(&self, mode: Mode) -> bool {
        self.modes[mode as usize].value
    }

    /// Blending is on: by a state set, or by the material.
    pub fn blends(&self) -> bool {
        let mode = &self.modes[Mode::Blend as usize];
        if self.blended_material { mode.by_drawable(true) } else { mode.value }
    }

    /// How blending weighs.
    pub fn blend_func(&self) -> BlendFunc {
        self.blend_func.value
    }

    /// How blending adds.
    pub fn blend_equation(&self) -> BlendEquation {
        self.blend_equation.value
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

    /// The faces that are culled, of a drawable whose material is double-sided or not.
    pub fn culled_face(&self, double_sided: bool) -> Option<CullFace> {
        let mode = &self.modes[Mode::CullFace as usize];
        let on = if double_sided { mode.by_drawable(false) } else { mode.value };
        on.then_some(self.cull_face.value)
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
