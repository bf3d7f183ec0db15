//! Parts of states with too many values for bits of a key: polygon offsets, stencil tests and blending, numbered by use.
//! Draw thread.

use crate::state::{BlendEquation, BlendFunc, PolygonOffset, ResolvedState, Stencil};

/// The number of different parts of a kind that a key's 6 bits tell apart; 0 is none.
const MAX_PARTS: usize = 63;

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
    /// in the last. With more than 63 different values the last one is used for all others, which is an error.
    fn index_of(&mut self, value: Option<T>, frame: u32, kind: &str, errors: &mut Vec<String>) -> (u8, bool) {
        let Some(value) = value else { return (0, false) };
        let index = |position: usize| position as u8 + 1;
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

    fn get(&self, index: u8) -> Option<T> {
        usize::from(index).checked_sub(1).and_then(|i| self.0.get(i)).map(|(value, _)| *value)
    }
}

/// The parts of states that have too many values for bits in a key.
#[derive(Debug, Default)]
pub(in crate::draw) struct Parts {
    offsets: Interned<PolygonOffset>,
    /// Without their references, which are dynamic state.
    stencils: Interned<Stencil>,
    blends: Interned<(BlendFunc, BlendEquation)>,
}

/// The indices of a state's parts in [`Parts`]; 0 for parts that it does not have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::draw) struct PartIndices {
    offset: u8,
    stencil: u8,
    blend: u8,
}

impl PartIndices {
    #[cfg(test)]
    pub(super) fn new(offset: u8, stencil: u8, blend: u8) -> Self {
        Self { offset, stencil, blend }
    }

    pub fn offset(self) -> u8 {
        self.offset
    }

    pub fn stencil(self) -> u8 {
        self.stencil
    }

    pub fn blend(self) -> u8 {
        self.blend
    }
}

impl Parts {
    pub fn offset(&self, index: u8) -> Option<PolygonOffset> {
        self.offsets.get(index)
    }

    pub fn stencil(&self, index: u8) -> Option<Stencil> {
        self.stencils.get(index)
    }

    pub fn blend(&self, index: u8) -> Option<(BlendFunc, BlendEquation)> {
        self.blends.get(index)
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
        let blend = state.blends().then(|| (state.blend_func(), state.blend_equation()));
        let stencil = state.stencil().map(|s| Stencil { reference: 0, ..s });
        let offset = state.polygon_offset().filter(usable);
        let offset = self.offsets.index_of(offset, frame, "polygon offsets", errors);
        let stencil = self.stencils.index_of(stencil, frame, "stencils", errors);
        let blend = self.blends.index_of(blend, frame, "blend functions and equations", errors);
        let replaced = |(index, is_replaced): (u8, bool)| if is_replaced { index } else { 0 };
        (
            PartIndices { offset: offset.0, stencil: stencil.0, blend: blend.0 },
            PartIndices { offset: replaced(offset), stencil: replaced(stencil), blend: replaced(blend) },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::state::{Attribute, BlendFactor, Mode, StateSet, StateValue};

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
        // Up to 63 values at once have different indices.
        for i in 1..100u8 {
            let full = usize::from(i.saturating_sub(62));
            assert_eq!(index_in(1, &offset(0.0, f32::from(i))), (u8::min(i + 1, 63), false, full));
        }
        let errors_so_far = 100 - 63;
        assert_eq!(index_in(2, &offset(0.0, 5.0)), (6, false, errors_so_far));
        // The value of the first frame is replaced first. In the next frame all but one may be replaced.
        assert_eq!(index_in(2, &offset(7.0, 1.0)), (1, true, errors_so_far));
        assert_eq!(index_in(2, &offset(7.0, 2.0)), (63, false, errors_so_far + 1));
        for i in 0..60 {
            assert_eq!(index_in(3 + i, &offset(8.0, 1.0 + i as f32)).2, errors_so_far + 1);
        }
        assert_eq!(parts.offsets.get(1).map(|o| o.factor), Some(7.0));
        assert_eq!((parts.offsets.get(0), parts.offsets.get(64)), (None, None));
        assert!(errors[0].contains("polygon offsets"));
        let blend = |func| {
            let set = StateSet::default().with(Attribute::BlendFunc(func)).with_mode(Mode::Blend, StateValue::ON);
            ResolvedState::default().below(&set)
        };
        let apart = BlendFunc::ALPHA.with_alpha(BlendFactor::One, BlendFactor::Zero);
        let states = [BlendFunc::ALPHA, apart, BlendFunc::ALPHA].map(blend);
        assert_eq!(states.map(|state| parts.intern(&state, 0, &mut errors).0.blend), [1, 2, 1]);
        assert_eq!(parts.blends.get(2), Some((apart, BlendEquation::Add)));
    }
}
