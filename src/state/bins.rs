//! Render bins: number, name and order of the leaves; prototypes of bins by name. Any thread.

use std::sync::RwLock;

use super::{DrawHook, StateSet};

/// A render bin. Bins that differ in anything are different bins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BinDetails {
    /// Bins are drawn in the order of their numbers; opaque 0, transparent 10. Of several with the same number those of
    /// the renderer's own come first, in the order of [`SortMode`], then those of prototypes in the order in which these
    /// were first registered.
    pub number: i32,
    /// Order of the leaves.
    pub sort: SortMode,
    /// The prototype it is made like.
    pub name: BinName,
}

/// The name of a [`BinPrototype`], or as by default that of the bins of the renderer's own, which their sort tells apart.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BinName(u32);

/// Order of the leaves in a bin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SortMode {
    /// Leaves of one state together, states in the order first met. Those of which the nearer hides the farther, whichever
    /// is drawn first, may change places, so that fewer calls draw them; others are as traversed inside a state.
    #[default]
    ByState,
    /// As `ByState`, nearest first inside a state and states by their nearest leaf.
    ByStateThenFrontToBack,
    /// Nearest first.
    FrontToBack,
    /// Farthest first.
    BackToFront,
    /// As traversed: depth first, and what hangs in the tiles of a page after the page.
    TraversalOrder,
    /// By a key that the application computes; equal keys as traversed.
    ByKey(SortKey),
}

/// What a [`SortKey`] may know of a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SortLeaf {
    /// Metres in front of the eye, of the bound's centre.
    pub depth: f32,
    /// Number of its state in the order first met.
    pub state: u32,
    /// Its place in traversal order.
    pub order: u32,
}

/// A sort callback: smaller keys are drawn first.
#[derive(Clone, Copy, Debug)]
pub struct SortKey(pub fn(&SortLeaf) -> u64);

impl PartialEq for SortKey {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::fn_addr_eq(self.0, other.0)
    }
}

impl Eq for SortKey {}

impl std::hash::Hash for SortKey {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (self.0 as usize).hash(state);
    }
}

impl BinDetails {
    /// Bin 0, sorted by state.
    pub const OPAQUE: Self = Self::new(0, SortMode::ByState);
    /// Bin 10, back to front.
    pub const TRANSPARENT: Self = Self::new(10, SortMode::BackToFront);

    /// A bin of the renderer's own.
    pub const fn new(number: i32, sort: SortMode) -> Self {
        Self { number, sort, name: BinName(0) }
    }

    /// Returns the key of the order among bins; equal only for equal bins.
    pub(crate) fn order_key(&self) -> (i32, BinName, u8, usize) {
        let (kind, key) = match self.sort {
            SortMode::ByState => (0, 0),
            SortMode::ByStateThenFrontToBack => (1, 0),
            SortMode::FrontToBack => (2, 0),
            SortMode::BackToFront => (3, 0),
            SortMode::TraversalOrder => (4, 0),
            SortMode::ByKey(SortKey(key)) => (5, key as usize),
        };
        (self.number, self.name, kind, key)
    }
}

/// What bins of a name are made like; OSG's prototypes of render bins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BinPrototype {
    /// Order of the leaves; a sort callback is [`SortMode::ByKey`].
    pub sort: SortMode,
    /// Draws the bin in place of the renderer (`draw::BinCallback`).
    pub draw: Option<DrawHook>,
}

/// A name that no prototype of bins has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no render bin prototype is called {name:?}")]
pub struct UnknownBin {
    /// What was asked for.
    pub name: String,
}

/// Prototypes by name, in the order first registered. Written by whoever registers one, read while state sets are made.
static PROTOTYPES: RwLock<Vec<(String, BinPrototype)>> = RwLock::new(Vec::new());

impl BinPrototype {
    /// Registers a prototype for the process; state sets that name it from now on have bins of it. It takes the place of
    /// one of the same name, and of the four that there are without: `RenderBin` and `StateSortedBin` by state,
    /// `DepthSortedBin` back to front, `TraversalOrderBin`.
    pub fn register(name: &str, prototype: Self) {
        let mut all = PROTOTYPES.write().unwrap_or_else(std::sync::PoisonError::into_inner);
        match all.iter_mut().find(|(known, _)| known == name) {
            Some((_, known)) => *known = prototype,
            None => all.push((name.to_owned(), prototype)),
        }
    }

    /// The prototype of a name.
    fn find(name: &str) -> Option<(BinName, Self)> {
        let all = PROTOTYPES.read().unwrap_or_else(std::sync::PoisonError::into_inner);
        let found = (1..).zip(all.iter()).find(|(_, (known, _))| known == name);
        if let Some((place, (_, prototype))) = found {
            return Some((BinName(place), prototype.clone()));
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

impl StateSet {
    /// Puts what is below into a bin by its number and the name of a prototype, in place of what [`Self::bin`] and
    /// [`Self::bin_callback`] said; an empty name inherits. With a name that nobody registered it is the bin of that
    /// number by state, and the name is the error.
    pub fn set_render_bin_details(&mut self, number: i32, name: &str) -> Result<&mut Self, UnknownBin> {
        (self.bin, self.bin_callback) = (None, None);
        if name.is_empty() {
            return Ok(self);
        }
        let Some((name, prototype)) = BinPrototype::find(name) else {
            self.bin = Some(BinDetails::new(number, SortMode::ByState));
            return Err(UnknownBin { name: name.to_owned() });
        };
        self.bin = Some(BinDetails { number, sort: prototype.sort, name });
        self.bin_callback = prototype.draw;
        Ok(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bin(number: i32, name: &str) -> BinDetails {
        let mut set = StateSet::default();
        set.set_render_bin_details(number, name).unwrap();
        set.bin.unwrap()
    }

    #[test]
    fn names_are_those_of_osg_and_those_registered() {
        assert_eq!(bin(0, "RenderBin"), BinDetails::OPAQUE);
        assert_eq!(bin(10, "DepthSortedBin"), BinDetails::TRANSPARENT);
        assert_eq!(bin(3, "TraversalOrderBin"), BinDetails::new(3, SortMode::TraversalOrder));
        let key = SortMode::ByKey(SortKey(|leaf| u64::from(leaf.order)));
        let hook = DrawHook(std::sync::Arc::new(7));
        BinPrototype::register("bins: by key", BinPrototype { sort: key, draw: Some(hook.clone()) });
        BinPrototype::register("bins: plain", BinPrototype::default());
        let [keyed, plain] = [bin(2, "bins: by key"), bin(2, "bins: plain")];
        assert_eq!((keyed.sort, plain.sort), (key, SortMode::ByState));
        assert!(
            BinDetails::new(2, SortMode::TraversalOrder).order_key() < keyed.order_key(),
            "the renderer's own first"
        );
        assert!(keyed.order_key() < plain.order_key(), "then as registered");
        assert_ne!(plain, bin(2, "RenderBin"), "a bin of its own");
        // Another of the name has its place.
        BinPrototype::register("bins: by key", BinPrototype { sort: SortMode::FrontToBack, draw: None });
        let other = bin(2, "bins: by key");
        assert_eq!((other.sort, other.name), (SortMode::FrontToBack, keyed.name));

        let mut set = StateSet { bin_callback: Some(hook), ..StateSet::default() };
        set.set_render_bin_details(4, "bins: plain").unwrap();
        assert_eq!(set.bin_callback, None);
        let error = set.set_render_bin_details(5, "bins: nobody's").unwrap_err();
        assert_eq!(error.to_string(), "no render bin prototype is called \"bins: nobody's\"");
        assert_eq!(set.bin, Some(BinDetails::new(5, SortMode::ByState)));
        set.set_render_bin_details(0, "").unwrap();
        assert_eq!(set.bin, None);
    }
}
