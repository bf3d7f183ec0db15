//! The nodes of a page as flat arrays in depth-first order: what the node scan of a cull reads.

use std::ops::Range;

use crate::scene::id::NONE;

/// Kinds of a [`NodeRecord`].
pub(crate) mod kind {
    pub const GROUP: u8 = 0;
    pub const TRANSFORM: u8 = 1;
    pub const GEODE: u8 = 2;
    pub const SWITCH: u8 = 3;
    pub const LOD: u8 = 4;
    /// A PagedLod or ProxyNode: the tile walk visits the subtree.
    pub const TILE: u8 = 5;
    /// A kind that few pages have; see [`RareNode`](super::RareNode).
    pub const SPECIAL: u8 = 6;
}

/// Set if the subtree has only groups, transforms and geodes that every camera sees: once it is wholly inside the frustum,
/// its drawables and transforms are two ranges.
pub(crate) const SIMPLE_SUBTREE: u8 = 1;
/// Set if the node has a cull callback.
pub(crate) const CALLBACK: u8 = 2;
/// Set if the node's bound does not cull, because culling is off for the node itself or for a node below it.
pub(crate) const INACTIVE: u8 = 4;
/// Set if culling is off for the node itself: its own drawables are not culled either.
pub(crate) const UNCULLED: u8 = 8;
/// Set if tiles or nodes without culling are below: the node is visited however small it looks.
pub(crate) const LARGE: u8 = 16;
/// Set if something below the node has changed: its sphere is large enough, and will be fitted again.
pub(crate) const STALE: u8 = 32;

/// A node as the node scan reads it, 16 bytes; its sphere is in an array beside it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NodeRecord {
    /// The number of nodes in the subtree, this one included.
    pub skip: u32,
    /// The number of drawables before this node; its own follow, then those of its children.
    pub first_drawable: u32,
    /// The number of transforms before this node, counting the page's own. For a transform node this is its own index.
    pub first_transform: u32,
    pub kind: u8,
    pub flags: u8,
}

/// Parallel arrays with an entry for each node.
#[derive(Debug, Default)]
pub(crate) struct NodeArrays {
    /// Has one entry more than there are nodes once the page is finished; the last one holds the totals.
    records: Vec<NodeRecord>,
    parents: Vec<u32>,
    /// Node masks; empty if every camera sees every node.
    masks: Vec<u32>,
    /// Indices into the table of the node's kind (switches, LODs, tiles, rare nodes); empty if no node has one.
    payloads: Vec<u32>,
}

impl NodeArrays {
    /// Returns the records of all nodes in depth-first order, and one more that holds the totals.
    #[inline(always)]
    pub fn records(&self) -> &[NodeRecord] {
        &self.records
    }

    /// Returns the parent of each node, `NONE` for the root.
    #[inline(always)]
    pub fn parents(&self) -> &[u32] {
        &self.parents
    }

    /// Returns the mask of each node, or nothing if every camera sees every node.
    #[inline(always)]
    pub fn masks(&self) -> &[u32] {
        &self.masks
    }

    /// Returns the payload index of each node, or nothing if no node has one.
    #[inline(always)]
    pub fn payloads(&self) -> &[u32] {
        &self.payloads
    }

    /// Returns the number of nodes of a finished page.
    pub fn node_count(&self) -> usize {
        self.records.len() - 1
    }

    /// Returns the record of a node of a finished page; `None` if the index is out of range.
    pub fn get(&self, node: u32) -> Option<&NodeRecord> {
        self.records.get(node as usize).filter(|_| (node as usize) < self.node_count())
    }

    /// Returns the payload index of a node of the given kind; `None` for all other nodes.
    pub fn payload_of(&self, node: u32, kind: u8) -> Option<usize> {
        self.get(node).filter(|record| record.kind == kind)?;
        self.payloads.get(node as usize).map(|payload| *payload as usize)
    }

    /// Returns the indices of the drawables of a node itself, without those of its children.
    #[inline(always)]
    pub fn drawables_of(&self, node: usize) -> Range<usize> {
        self.records[node].first_drawable as usize..self.records[node + 1].first_drawable as usize
    }

    /// Returns the children of a node.
    pub fn children(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        let end = node + self.records[node].skip as usize;
        let mut next = node + 1;
        std::iter::from_fn(move || {
            let child = next;
            next += self.records.get(child)?.skip as usize;
            (child < end).then_some(child)
        })
    }

    /// Returns a node and those above it, each with the node below it on the path.
    pub fn path_to_root(&self, node: u32) -> impl Iterator<Item = (u32, Option<u32>)> + '_ {
        let mut at = (node, None);
        std::iter::from_fn(move || {
            let this = at;
            let parent = *self.parents.get(this.0 as usize)?;
            at = (parent, Some(this.0));
            Some(this)
        })
    }

    /// Returns true if something below the node has changed since its sphere was fitted.
    pub fn is_stale(&self, node: usize) -> bool {
        self.records[node].flags & STALE != 0
    }

    /// Marks a node as stale or fitted.
    pub fn set_stale(&mut self, node: usize, is_stale: bool) {
        let flags = &mut self.records[node].flags;
        *flags = if is_stale { *flags | STALE } else { *flags & !STALE };
    }

    /// Appends a node that has no children yet.
    pub(super) fn push(&mut self, record: NodeRecord, parent: u32, mask: u32, payload: u32) {
        self.records.push(record);
        self.parents.push(parent);
        self.masks.push(mask);
        self.payloads.push(payload);
    }

    /// Ends the subtree of a node: everything that was pushed after the node is below it.
    pub(super) fn close_subtree(&mut self, node: u32) {
        self.records[node as usize].skip = (self.records.len() - node as usize) as u32;
    }

    /// Appends the record with the totals, computes the flags that depend on subtrees and drops arrays that say nothing.
    /// `needs_tests` tells whether some drawable of a range is not taken with the range.
    pub(super) fn finish(&mut self, drawables: u32, transforms: u32, needs_tests: impl Fn(Range<usize>) -> bool) {
        let count = self.records.len();
        self.records.push(NodeRecord {
            skip: 1,
            first_drawable: drawables,
            first_transform: transforms,
            kind: kind::GROUP,
            flags: 0,
        });
        let mut is_simple = vec![true; count];
        for node in (0..count).rev() {
            let record = self.records[node];
            let parent = self.parents[node];
            is_simple[node] &= matches!(record.kind, kind::GROUP | kind::TRANSFORM | kind::GEODE)
                && self.masks[node] == u32::MAX
                && record.flags == 0
                && !needs_tests(self.drawables_of(node));
            let is_large = record.kind == kind::TILE || record.flags & (INACTIVE | LARGE) != 0;
            let inherited_upwards = record.flags & INACTIVE | if is_large { LARGE } else { 0 };
            self.records[node].flags |= inherited_upwards;
            if parent != NONE {
                self.records[parent as usize].flags |= inherited_upwards;
            }
            if is_simple[node] {
                self.records[node].flags |= SIMPLE_SUBTREE;
            } else if parent != NONE {
                is_simple[parent as usize] = false;
            }
        }
        if self.masks.iter().all(|m| *m == u32::MAX) {
            self.masks = Vec::new();
        }
        if self.payloads.iter().all(|p| *p == NONE) {
            self.payloads = Vec::new();
        }
    }

    /// Replaces the tile indices of tile nodes after the tiles were reordered.
    pub(super) fn renumber_tiles(&mut self, new_index: &[u32]) {
        for (record, payload) in self.records.iter().zip(&mut self.payloads) {
            if record.kind == kind::TILE {
                *payload = new_index[*payload as usize];
            }
        }
    }

    /// Returns the bytes of CPU memory of all arrays.
    pub fn size_bytes(&self) -> usize {
        self.records.len() * (size_of::<NodeRecord>() + 4) + (self.masks.len() + self.payloads.len()) * 4
    }
}
