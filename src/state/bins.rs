//! Render bins: number, name and order of the leaves, and prototypes of bins by name. Any thread.

use std::sync::RwLock;
use std::sync::atomic::{AtomicU32, Ordering};

use super::hook::OpaqueDrawData;

/// Identifies a render bin. Bins that differ in any field are different bins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BinDetails {
    /// Bins are drawn in the order of their numbers: opaque is 0, transparent 10. Among bins of the same number the built-in
    /// ones are drawn first, in the order of [`SortMode`], then those of prototypes in the order of their registration.
    pub number: i32,
    /// Order of the leaves.
    pub sort: SortMode,
    /// The prototype of the bin.
    pub name: BinName,
}

/// The name of a [`BinPrototype`]. The default stands for built-in bins, which differ by their sort mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BinName(u32);

/// The order of the leaves in a bin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SortMode {
    /// Groups leaves by state, states in the order in which they were first met. Leaves that may be drawn in any order (the
    /// depth test decides) may be regrouped for fewer draw calls; others keep traversal order inside a state.
    #[default]
    ByState,
    /// Groups leaves by state: nearest first inside a state, and states by their nearest leaf.
    ByStateThenFrontToBack,
    /// Nearest first.
    FrontToBack,
    /// Farthest first.
    BackToFront,
    /// Traversal order: depth first, and the content of a page's tiles after the page.
    TraversalOrder,
    /// Sorts by a key that the application computes; equal keys keep traversal order.
    ByKey(SortKey),
}

/// The argument of a [`SortKey`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SortLeaf {
    /// Depth of the bound's centre in front of the eye, metres.
    pub depth: f32,
    /// Index of its state in the order in which states were first met.
    pub state: u32,
    /// Its index in traversal order.
    pub order: u32,
}

/// A sort callback, compared by identity: smaller keys are drawn first.
#[derive(Clone, Copy)]
pub struct SortKey {
    /// The number in the order of creation, which is also that of bins.
    number: u32,
    key: &'static (dyn Fn(&SortLeaf) -> u64 + Send + Sync),
}

impl SortKey {
    /// Creates a callback. It is kept until the process ends, so that bins can be plain values: an application creates its few
    /// callbacks once.
    pub fn new(key: impl Fn(&SortLeaf) -> u64 + Send + Sync + 'static) -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        Self { number: NEXT.fetch_add(1, Ordering::Relaxed), key: Box::leak(Box::new(key)) }
    }

    /// Returns the key of a leaf.
    pub fn of(&self, leaf: &SortLeaf) -> u64 {
        (self.key)(leaf)
    }
}

impl PartialEq for SortKey {
    fn eq(&self, other: &Self) -> bool {
        self.number == other.number
    }
}

impl Eq for SortKey {}

impl std::hash::Hash for SortKey {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.number.hash(state);
    }
}

impl std::fmt::Debug for SortKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SortKey({})", self.number)
    }
}

impl BinDetails {
    /// Bin 0, sorted by state.
    pub const OPAQUE: Self = Self::new(0, SortMode::ByState);
    /// Bin 10, back to front.
    pub const TRANSPARENT: Self = Self::new(10, SortMode::BackToFront);

    /// Returns a built-in bin.
    pub const fn new(number: i32, sort: SortMode) -> Self {
        Self { number, sort, name: BinName(0) }
    }

    /// Returns the key of the order among bins; equal only for equal bins.
    pub(crate) fn order_key(&self) -> (i32, BinName, u8, u32) {
        let (kind, key) = match self.sort {
            SortMode::ByState => (0, 0),
            SortMode::ByStateThenFrontToBack => (1, 0),
            SortMode::FrontToBack => (2, 0),
            SortMode::BackToFront => (3, 0),
            SortMode::TraversalOrder => (4, 0),
            SortMode::ByKey(key) => (5, key.number),
        };
        (self.number, self.name, kind, key)
    }
}

/// A template for bins of a name; OSG's prototypes of render bins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BinPrototype {
    /// The order of the leaves; a sort callback is [`SortMode::ByKey`].
    pub sort: SortMode,
    /// Draws the bin instead of the renderer (`draw::BinCallback`).
    pub draw: Option<OpaqueDrawData>,
}

/// The error for a name without a registered prototype.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no render bin prototype is called {name:?}")]
pub struct UnknownBin {
    /// The name that was given.
    pub name: String,
}

/// Prototypes by name, in the order of their first registration. Written by [`BinPrototype::register`], read when a state
/// set names a bin.
static PROTOTYPES: RwLock<Vec<(String, BinPrototype)>> = RwLock::new(Vec::new());

impl BinPrototype {
    /// Registers a prototype for the process, for state sets that name it from now on. It replaces one of the same name, also
    /// one of the four built-in names: `RenderBin` and `StateSortedBin` (by state), `DepthSortedBin` (back to front) and
    /// `TraversalOrderBin`.
    pub fn register(name: &str, prototype: Self) {
        let mut all = PROTOTYPES.write().unwrap_or_else(std::sync::PoisonError::into_inner);
        match all.iter_mut().find(|(known, _)| known == name) {
            Some((_, known)) => *known = prototype,
            None => all.push((name.to_owned(), prototype)),
        }
    }

    /// Finds the prototype of a name.
    pub(super) fn find(name: &str) -> Option<(BinName, Self)> {
        let all = PROTOTYPES.read().unwrap_or_else(std::sync::PoisonError::into_inner);
        let found = (1..).zip(all.iter()).find(|(_, (known, _))| known == name);
        if let Some((number, (_, prototype))) = found {
            return Some((BinName(number), prototype.clone()));
        }
        let sort = match name {
            "RenderBin" | "StateSortedBin" => SortMode::ByState,
            "DepthSortedBin" => SortMode::BackToFront,
            "TraversalOrderBin" => SortMode::TraversalOrder,
            _ => return None,
        };
        Some((BinName(0), Self { sort, draw: None }))
    }
}
