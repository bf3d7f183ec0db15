//! Values that a chain of state sets leaves: [`Inherited`] values, and the modes. Plain values.

use std::sync::Arc;

use super::lighting::Light;
use super::modes::{CLIP_PLANES, LIGHTS, Mode, StateValue};
use super::raster::{BlendEquation, BlendFunc, ColorMask};

/// A value as the chain above left it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Inherited<T> {
    pub(super) value: T,
    /// Some state set has set the value; otherwise it is the default.
    pub(super) is_set: bool,
    /// Values below are ignored unless they are protected.
    pub(super) overrides: bool,
}

impl<T> Inherited<T> {
    /// Applies the value of a state set further down, by the rules of OSG's `State::pushAttribute`.
    pub(super) fn apply(&mut self, value: T, how: StateValue) {
        if applies(self.overrides, how) {
            *self = Self { value, is_set: true, overrides: how.contains(StateValue::OVERRIDE) };
        }
    }
}

/// Returns true if a value applies, below one that overrides or not.
pub(super) fn applies(overridden: bool, how: StateValue) -> bool {
    (!overridden || how.contains(StateValue::PROTECTED)) && !how.contains(StateValue::INHERIT)
}

/// All modes, one bit each by [`Mode::index`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Modes {
    pub(super) on: u64,
    pub(super) overrides: u64,
}

const _: () = assert!(Mode::COUNT <= 64);

/// Returns the bit of a mode; 0 for a number that is out of range.
fn bit(mode: Mode) -> u64 {
    mode.index().map_or(0, |index| 1 << index)
}

impl Modes {
    /// Applies the flags of a state set further down, by the rules of OSG's `State::pushMode`.
    pub(super) fn apply(&mut self, mode: Mode, how: StateValue) {
        let bit = bit(mode);
        if applies(self.overrides & bit != 0, how) {
            let put = |bits: u64, set: bool| if set { bits | bit } else { bits & !bit };
            self.on = put(self.on, how.contains(StateValue::ON));
            self.overrides = put(self.overrides, how.contains(StateValue::OVERRIDE));
        }
    }

    pub(super) fn is_on(&self, mode: Mode) -> bool {
        self.on & bit(mode) != 0
    }

    /// Returns the value of a mode that a drawable itself sets to `value`, unless a state set overrides it.
    pub(super) fn for_drawable(&self, mode: Mode, value: bool) -> bool {
        if self.overrides & bit(mode) != 0 { self.is_on(mode) } else { value }
    }
}

/// The blending and the mask that state sets give one colour attachment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct LocationState {
    pub(super) func: Inherited<Option<BlendFunc>>,
    pub(super) equation: Inherited<Option<BlendEquation>>,
    pub(super) mask: Inherited<Option<ColorMask>>,
}

/// Lights and clip planes of state sets, in eye space. Few states have any.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct EyeSpaceState {
    pub(super) lights: [Inherited<Option<Light>>; LIGHTS],
    pub(super) clip_planes: [Inherited<Option<[f64; 4]>>; CLIP_PLANES],
}

impl EyeSpaceState {
    /// Returns the lights and planes of a state, to be changed.
    pub(super) fn of(state: &mut Option<Arc<Self>>) -> &mut Self {
        Arc::make_mut(state.get_or_insert_default())
    }
}
