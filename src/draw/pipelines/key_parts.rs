//! Parts of states with too many values for bits of a key: polygon offsets, stencil tests, blending and sample masks,
//! numbered by use; and the kinds of air. Draw thread.

use crate::scene::{Environment, Sky};
use crate::state::{BlendEquation, BlendFunc, COLOR_LOCATIONS, PolygonOffset, ResolvedState, SampleMask, Stencil};

/// The bits of a key for the index of a part.
pub(super) const PART_BITS: u32 = 10;
/// The number of different parts of a kind that a key tells apart; 0 is none.
const MAX_PARTS: usize = (1 << PART_BITS) - 1;

/// The blending of a state's colour attachments, and the components that are written to them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::draw) struct Blending {
    /// By location; `None` without blending.
    pub blends: [Option<(BlendFunc, BlendEquation)>; COLOR_LOCATIONS],
    /// By location: red, green, blue and alpha in bits 0 to 3.
    pub masks: [u8; COLOR_LOCATIONS],
}

impl Blending {
    /// Returns the blending of a state; `None` for a state that blends nothing and has one mask for all attachments.
    fn of(state: &ResolvedState) -> Option<Self> {
        let masks = std::array::from_fn(|location| state.color_mask_of(location).bits());
        let own_masks = masks.iter().any(|mask| *mask != state.color_mask().bits());
        let blends = state.blends();
        let blending = |location| blends.then(|| state.blending_of(location));
        (blends || own_masks).then(|| Self { blends: std::array::from_fn(blending), masks })
    }
}

/// Parts of states, each kept once, with the frame in which it was last used. Indices begin with 1; 0 is none.
#[derive(Debug)]
struct Interned<T>(Vec<(T, u32)>);

impl<T> Default for Interned<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T: Copy + PartialEq> Interned<T> {
    /// Returns the index of a value in a frame, and whether it was another value's, which was used neither in this frame nor
    /// in the last. With more than 1,023 different values the last one is used for all others, which is an error.
    fn index_of(&mut self, value: Option<T>, frame: u32, kind: &str, errors: &mut Vec<String>) -> (u16, bool) {
        let Some(value) = value else { return (0, false) };
        let index = |position: usize| position as u16 + 1;
        if let Some(position) = self.0.iter().position(|(known, _)| *known == value) {
            self.0[position].1 = frame;
            return (index(position), false);
        }
        if self.0.len() < MAX_PARTS {
            self.0.push((value, frame));
            return (index(self.0.len() - 1), false);
        }
        let age = |used: u32| frame.wrapping_sub(used);
        let oldest = self.0.iter_mut().enumerate().max_by_key(|(_, (_, used))| age(*used));
        if let Some((position, entry)) = oldest.filter(|(_, (_, used))| age(*used) > 1) {
            *entry = (value, frame);
            return (index(position), true);
        }
        errors.push(format!(
            "more than {MAX_PARTS} different {kind} at once; further ones are drawn as the last of them"
        ));
        (index(self.0.len() - 1), false)
    }

    fn get(&self, index: u16) -> Option<T> {
        usize::from(index).checked_sub(1).and_then(|i| self.0.get(i)).map(|(value, _)| *value)
    }
}

/// The parts of states that have too many values for bits in a key.
#[derive(Debug, Default)]
pub(in crate::draw) struct Parts {
    offsets: Interned<PolygonOffset>,
    /// Without their references, which are dynamic state.
    stencils: Interned<Stencil>,
    blendings: Interned<Blending>,
    samples: Interned<SampleMask>,
}

/// The indices of a state's parts in [`Parts`]; 0 for parts that it does not have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::draw) struct PartIndices {
    offset: u16,
    stencil: u16,
    blending: u16,
    samples: u16,
}

impl PartIndices {
    #[cfg(test)]
    pub(super) fn new(offset: u16, stencil: u16, blending: u16, samples: u16) -> Self {
        Self { offset, stencil, blending, samples }
    }

    pub fn offset(self) -> u16 {
        self.offset
    }

    pub fn stencil(self) -> u16 {
        self.stencil
    }

    pub fn blending(self) -> u16 {
        self.blending
    }

    pub fn samples(self) -> u16 {
        self.samples
    }
}

impl Parts {
    pub fn offset(&self, index: u16) -> Option<PolygonOffset> {
        self.offsets.get(index)
    }

    pub fn stencil(&self, index: u16) -> Option<Stencil> {
        self.stencils.get(index)
    }

    pub fn blending(&self, index: u16) -> Option<Blending> {
        self.blendings.get(index)
    }

    pub fn samples(&self, index: u16) -> Option<SampleMask> {
        self.samples.get(index)
    }

    /// Returns the indices of a state's parts in a frame, and those of them that were other values' before. Parts that find
    /// no index are errors.
    pub fn intern(
        &mut self,
        state: &ResolvedState,
        frame: u32,
        errors: &mut Vec<String>,
    ) -> (PartIndices, PartIndices) {
        let usable = |o: &PolygonOffset| o.factor.is_finite() && o.units.is_finite() && *o != PolygonOffset::default();
        let stencil = state.stencil().map(|s| Stencil { reference: 0, ..s });
        let offset = state.polygon_offset().filter(usable);
        let offset = self.offsets.index_of(offset, frame, "polygon offsets", errors);
        let stencil = self.stencils.index_of(stencil, frame, "stencils", errors);
        let kind = "blend functions, equations and colour masks";
        let blending = self.blendings.index_of(Blending::of(state), frame, kind, errors);
        let samples = self.samples.index_of(state.sample_mask(), frame, "sample masks", errors);
        let replaced = |(index, is_replaced): (u16, bool)| if is_replaced { index } else { 0 };
        (
            PartIndices { offset: offset.0, stencil: stencil.0, blending: blending.0, samples: samples.0 },
            PartIndices {
                offset: replaced(offset),
                stencil: replaced(stencil),
                blending: replaced(blending),
                samples: replaced(samples),
            },
        )
    }
}

/// The air between the eye and what it sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::draw) enum AirKind {
    /// An atmosphere, which the frame's uniforms describe.
    Atmosphere,
    /// Haze, but no atmosphere.
    Haze,
    /// Neither.
    Clear,
}

impl AirKind {
    /// Returns the kind of air of an environment.
    pub fn of(environment: &Environment) -> Self {
        match environment.sky {
            Sky::Atmosphere => Self::Atmosphere,
            Sky::Background(_) if environment.fog.enabled => Self::Haze,
            Sky::Background(_) => Self::Clear,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{Attribute, BlendFactor, ColorMask, Mode, StateSet, StateValue};

    #[test]
    fn equal_parts_share_an_index() {
        let (mut parts, mut errors) = (Parts::default(), Vec::new());
        let offset = |factor, units| {
            let set = StateSet::default().with(Attribute::PolygonOffset(PolygonOffset { factor, units }));
            ResolvedState::default().below(&set)
        };
        let indices = [ResolvedState::default(), offset(1.0, 2.0), offset(1.0, 2.0), offset(f32::NAN, 0.0)];
        let mut index_in = |frame: u32, state: &ResolvedState| {
            let (indices, replaced) = parts.intern(state, frame, &mut errors);
            assert!(replaced == PartIndices::default() || replaced.offset == indices.offset);
            (indices.offset, replaced.offset != 0, errors.len())
        };
        assert_eq!(indices.map(|state| index_in(0, &state).0), [0, 1, 1, 0]);
        // Up to 1,023 values at once have different indices.
        let max = MAX_PARTS as u16;
        for i in 1..1100u16 {
            let full = usize::from(i.saturating_sub(max - 1));
            assert_eq!(index_in(1, &offset(0.0, f32::from(i))), (u16::min(i + 1, max), false, full));
        }
        let errors_so_far = 1100 - MAX_PARTS;
        assert_eq!(index_in(2, &offset(0.0, 5.0)), (6, false, errors_so_far));
        // The value of the first frame is replaced first. In the next frame all but one may be replaced.
        assert_eq!(index_in(2, &offset(7.0, 1.0)), (1, true, errors_so_far));
        assert_eq!(index_in(2, &offset(7.0, 2.0)), (max, false, errors_so_far + 1));
        for i in 0..60 {
            assert_eq!(index_in(3 + i, &offset(8.0, 1.0 + i as f32)).2, errors_so_far + 1);
        }
        assert_eq!(parts.offsets.get(1).map(|o| o.factor), Some(7.0));
        assert_eq!((parts.offsets.get(0), parts.offsets.get(max + 1)), (None, None));
        assert!(errors[0].contains("polygon offsets"));
        let blend = |func| {
            let set = StateSet::default().with(Attribute::BlendFunc(func)).with_mode(Mode::Blend, StateValue::ON);
            ResolvedState::default().below(&set)
        };
        let apart = BlendFunc::ALPHA.with_alpha(BlendFactor::One, BlendFactor::Zero);
        let states = [BlendFunc::ALPHA, apart, BlendFunc::ALPHA].map(blend);
        assert_eq!(states.map(|state| parts.intern(&state, 0, &mut errors).0.blending), [1, 2, 1]);
        assert_eq!(parts.blendings.get(2).map(|b| b.blends), Some([Some((apart, BlendEquation::Add)); 8]));
        // One attachment with its own factors or mask is another value, also without blending.
        let own = |attribute| ResolvedState::default().below(&StateSet::default().with(attribute));
        let states = [
            own(Attribute::BlendFuncOf(3, BlendFunc::ADD)),
            own(Attribute::ColorMaskOf(1, ColorMask([false; 4]))),
            own(Attribute::ColorMask(ColorMask([false; 4]))),
        ];
        assert_eq!(states.map(|state| parts.intern(&state, 0, &mut errors).0.blending), [3, 4, 0]);
        let [own_factors, own_mask] = [3, 4].map(|index| parts.blendings.get(index).unwrap());
        assert_eq!(
            own_factors.blends[2..4].iter().flatten().map(|b| b.0).collect::<Vec<_>>(),
            [BlendFunc::ALPHA, BlendFunc::ADD]
        );
        assert_eq!((own_mask.masks, own_mask.blends), ([15, 0, 15, 15, 15, 15, 15, 15], [None; 8]));
    }
}
