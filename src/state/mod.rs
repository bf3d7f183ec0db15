//! State sets: how things are drawn, shared by identity.

/// State for a node and below.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StateSet {
    /// Bin the leaves go to; `None` inherits.
    pub bin: Option<BinDetails>,
    /// Depth test and write; `None` inherits.
    pub depth_write: Option<bool>,
    /// Wireframe where the adapter can; `None` inherits.
    pub wireframe: Option<bool>,
    /// Linear colour factor multiplied into every drawable below; `None` inherits.
    pub color: Option<[f32; 4]>,
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
