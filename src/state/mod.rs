//! State sets: how things are drawn, shared by identity.
//!
//! A state set holds modes and attributes, each with the flags that say how it meets what others say
//! ([`StateValue`]). Cull resolves the chain of state sets above a drawable ([`ResolvedState`]); draw makes pipelines
//! of what comes out. Knows no wgpu.

mod attributes;
mod resolved;

pub use attributes::{
    Attribute, BlendEquation, BlendFactor, BlendFunc, ColorMask, CompareFunction, CullFace, Depth, FrontFace, Mode,
    PolygonMode, PolygonOffset, StateValue,
};
pub use resolved::ResolvedState;

/// State for a node and below.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateSet {
    /// Bin the leaves go to; `None` inherits.
    pub bin: Option<BinDetails>,
    /// Linear colour factor multiplied into every drawable below; `None` inherits.
    pub color: Option<[f32; 4]>,
    /// What is switched, see [`Self::set_mode`].
    pub modes: Vec<(Mode, StateValue)>,
    /// What is given, see [`Self::set_attribute`].
    pub attributes: Vec<(Attribute, StateValue)>,
}

impl StateSet {
    /// Switches a mode; a second time replaces the first.
    pub fn set_mode(&mut self, mode: Mode, value: StateValue) -> &mut Self {
        self.modes.retain(|(m, _)| *m != mode);
        self.modes.push((mode, value));
        self
    }

    /// Gives an attribute without switching its mode; a second of its type replaces the first.
    pub fn set_attribute(&mut self, attribute: Attribute, value: StateValue) -> &mut Self {
        let kind = std::mem::discriminant(&attribute);
        self.attributes.retain(|(a, _)| std::mem::discriminant(a) != kind);
        self.attributes.push((attribute, value));
        self
    }

    /// Gives an attribute and switches its mode, where it has one, with the same value.
    pub fn set_attribute_and_modes(&mut self, attribute: Attribute, value: StateValue) -> &mut Self {
        if let Some(mode) = attribute.mode() {
            self.set_mode(mode, value);
        }
        self.set_attribute(attribute, value)
    }

    /// The same set with a mode switched, for building.
    pub fn with_mode(mut self, mode: Mode, value: StateValue) -> Self {
        self.set_mode(mode, value);
        self
    }

    /// The same set with an attribute and its mode on, for building.
    pub fn with(mut self, attribute: Attribute) -> Self {
        self.set_attribute_and_modes(attribute, StateValue::ON);
        self
    }
}

/// A render bin: number and sort.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BinDetails {
    /// Bins are drawn in the order of their numbers; opaque 0, transparent 10.
    pub number: i32,
    /// Order of the leaves.
    pub sort: SortMode,
}

/// Order of the leaves in a bin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SortMode {
    /// Leaves of one state together, states in the order first met.
    #[default]
    ByState,
    /// As `ByState`, nearest first inside a state and states by their nearest leaf.
    ByStateThenFrontToBack,
    /// Nearest first.
    FrontToBack,
    /// Farthest first.
    BackToFront,
    /// As traversed.
    TraversalOrder,
}

impl BinDetails {
    /// Bin 0, sorted by state.
    pub const OPAQUE: Self = Self { number: 0, sort: SortMode::ByState };
    /// Bin 10, back to front.
    pub const TRANSPARENT: Self = Self { number: 10, sort: SortMode::BackToFront };
}
