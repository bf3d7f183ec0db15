//! Generational handles: a page, and a node inside a page. Plain values; any thread.

use std::fmt;
use std::num::NonZeroU32;
use std::sync::atomic::{AtomicU32, Ordering};

/// Stands for "no index".
pub(crate) const NONE: u32 = u32::MAX;

/// Distinguishes a [`super::Scene`] from all others of the process. Every handle contains it: a pager that serves several
/// scenes knows whose a handle is, and a scene rejects handles of another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
// Not zero, so that an optional handle is as small as a handle.
pub struct SceneNumber(NonZeroU32);

impl SceneNumber {
    /// Returns a number that no scene had before, counted from 1.
    pub(super) fn next() -> Self {
        static SCENES: AtomicU32 = AtomicU32::new(1);
        // After four thousand million scenes the numbers repeat.
        Self(NonZeroU32::new(SCENES.fetch_add(1, Ordering::Relaxed)).unwrap_or(NonZeroU32::MIN))
    }

    /// Returns the number.
    pub fn get(self) -> u32 {
        self.0.get()
    }
}

impl fmt::Display for SceneNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Identifies a page of a [`super::Scene`]; stale once the page was detached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PageId {
    /// The scene that has the page.
    pub scene: SceneNumber,
    /// The position in the scene's page table.
    pub slot: u32,
    /// The number of times that the position was reused.
    pub generation: u32,
}

/// Identifies a node: a page and the node's depth-first index in it.
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

    /// The page table, which culls read, does not grow by the scene's number.
    #[test]
    fn an_optional_handle_is_as_large_as_a_handle() {
        assert_eq!((size_of::<PageId>(), size_of::<Option<NodeId>>()), (12, 16));
    }
}
