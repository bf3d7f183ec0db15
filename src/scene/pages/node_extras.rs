//! Names, callbacks and metadata of nodes: sparse lists, sorted by node.

use std::collections::HashSet;
use std::sync::Arc;

use crate::math::{Ellipsoid, WGS84};
use crate::scene::features::TileMetadata;
use crate::scene::nodes::{CullCallback, EventCallback, UpdateCallback};
use crate::scene::sparse_list::SparseList;

/// Names, callbacks and metadata of the nodes that have them, whatever their kind.
#[derive(Debug, Default)]
pub(crate) struct NodeExtras {
    labels: Option<Box<Labels>>,
    /// Each with the state path of its node.
    pub(super) cull_callbacks: SparseList<(CullCallback, u32)>,
    pub(super) update_callbacks: SparseList<UpdateCallback>,
    pub(super) event_callbacks: SparseList<EventCallback>,
}

/// Names, metadata and attributions. Apart from the page, since most pages have none.
#[derive(Debug, Default)]
struct Labels {
    names: Vec<(Box<str>, u32)>,
    metadata: SparseList<Arc<TileMetadata>>,
    credits: Box<[Arc<str>]>,
    /// The ellipsoid of the page, if it is not WGS84.
    ellipsoid: Option<Ellipsoid>,
}

impl NodeExtras {
    /// Adds the name of a node. Nodes must arrive in ascending order.
    pub(super) fn push_name(&mut self, node: u32, name: String) {
        self.labels.get_or_insert_default().names.push((name.into_boxed_str(), node));
    }

    /// Returns the nodes that have names, in depth-first order.
    pub fn names(&self) -> &[(Box<str>, u32)] {
        self.labels.as_ref().map_or(&[], |labels| &labels.names)
    }

    /// Adds the metadata of a node. Nodes must arrive in ascending order.
    pub(super) fn push_metadata(&mut self, node: u32, metadata: Arc<TileMetadata>) {
        self.labels.get_or_insert_default().metadata.push(node, metadata);
    }

    /// Returns the metadata of a node, if it has any.
    pub(super) fn metadata(&self, node: u32) -> Option<&TileMetadata> {
        self.labels.as_ref()?.metadata.get(node).map(|metadata| &**metadata)
    }

    /// Stores the attributions of the page.
    pub(super) fn set_credits(&mut self, credits: Vec<Arc<str>>) {
        if !credits.is_empty() {
            self.labels.get_or_insert_default().credits = credits.into();
        }
    }

    /// Returns the attributions of the page.
    pub fn credits(&self) -> &[Arc<str>] {
        self.labels.as_ref().map_or(&[], |labels| &labels.credits)
    }

    /// Stores the ellipsoid of the page.
    pub(super) fn set_ellipsoid(&mut self, ellipsoid: Ellipsoid) {
        if ellipsoid != self.ellipsoid() {
            self.labels.get_or_insert_default().ellipsoid = Some(ellipsoid);
        }
    }

    /// Returns the ellipsoid of the page.
    pub fn ellipsoid(&self) -> Ellipsoid {
        self.labels.as_ref().and_then(|labels| labels.ellipsoid).unwrap_or(WGS84)
    }

    /// Returns the bytes of CPU memory of the metadata; names and callbacks are few and not counted.
    pub fn size_bytes(&self) -> usize {
        let Some(labels) = &self.labels else { return 0 };
        let mut counted = HashSet::new();
        labels.metadata.values().map(|metadata| metadata.size_bytes_beside(&mut counted)).sum()
    }
}
