//! Generational handles: a page, and a node inside a page. Plain values; any thread.

use std::fmt;
use std::num::NonZeroU32;
use std::sync::atomic::{AtomicU32, Ordering};

/// Stands for "no index".
pub(crate) const NONE: u32 = u32::MAX;

/// Tells a [`super::Scene`] from all others of the process. It is in each of its handles, so that what serves several
/// scenes, a pager say, knows whose they are; another scene does not know them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
// None is 0, so that an optional handle takes no more room than a handle.
pub struct SceneNumber(NonZeroU32);

impl SceneNumber {
    /// One that no scene had before, counted from 1.
    pub(super) fn next() -> Self {
        static SCENES: AtomicU32 = AtomicU32::new(1);
        // Four thousand million scenes later numbers begin again.
        Self(NonZeroU32::new(SCENES.fetch_add(1, Ordering::Relaxed)).unwrap_or(NonZeroU32::MIN))
    }

    /// The number.
    pub fn get(self) -> u32 {
        self.0.get()
    }
}

impl fmt::Display for SceneNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Names one page of a [`super::Scene`]; stale once the page was detached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PageId {
    /// The scene that has the page.
    pub scene: SceneNumber,
    /// Place in the scene's page table.
    pub slot: u32,
    /// Counts how often that place was reused.
    pub generation: u32,
}

/// Names one node: a page and the node's depth-first index in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeId {
    /// The page that holds the node.
    pub page: PageId,
    /// Depth-first index inside the page; 0 is the page's root.
    pub index: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Entries of the table of pages, which culls read, are no larger than without the scene's number.
    #[test]
    fn an_optional_handle_is_as_large_as_a_handle() {
        assert_eq!((size_of::<PageId>(), size_of::<Option<NodeId>>()), (12, 16));
    }
}
