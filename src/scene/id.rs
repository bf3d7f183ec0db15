//! Generational handles: a page, and a node inside a page.

/// Names one page of a [`super::Scene`]; stale once the page was detached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct PageId {
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
