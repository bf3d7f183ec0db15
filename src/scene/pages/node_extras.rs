//! Names, callbacks and metadata of nodes: sparse lists, sorted by node.

use std::collections::HashSet;
use std::sync::Arc;

use crate::scene::features::TileMetadata;
use crate::scene::nodes::{CullCallback, EventCallback, UpdateCallback};
use crate::scene::sparse_list::SparseList;

/// Names, callbacks and metadata of the nodes that have them, whatever their kind.
#[derive(Debug, Default)]
pub(crate) struct NodeExtras {
    names: Vec<(Box<str>, u32)>,
    pub(super) cull_callbacks: SparseList<CullCallback>,
    pub(super) update_callbacks: SparseList<UpdateCallback>,
    pub(super) event_callbacks: SparseList<EventCallback>,
    pub(super) metadata: SparseList<Arc<TileMetadata>>,
}

impl NodeExtras {
    /// Adds the name of a node. Nodes must arrive in ascending order.
    pub(super) fn push_name(&mut self, node: u32, name: String) {
        self.names.push((name.into_boxed_str(), node));
    }

    /// Returns the nodes that have names, in depth-first order.
    pub fn names(&self) -> &[(Box<str>, u32)] {
        &self.names
    }

    /// Returns the bytes of CPU memory of the metadata; names and callbacks are few and not counted.
    pub fn size_bytes(&self) -> usize {
        let mut counted = HashSet::new();
        self.metadata.values().map(|metadata| metadata.size_bytes_beside(&mut counted)).sum()
    }
}
