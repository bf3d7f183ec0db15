//! Contents that several pages share. Reference counts of `Arc` tell how long a content is in use. Any thread.

use std::sync::{Arc, OnceLock};

use super::content_key::ContentKey;
use crate::scene::geometry::Geometry;
use crate::scene::intersect::KdTree;

/// What pages hold of a shared content as long as they use it: places on the GPU go by its key.
#[derive(Debug)]
pub(crate) struct SharedContent {
    pub(crate) key: ContentKey,
    /// Built when first asked for.
    tree: OnceLock<Option<Arc<KdTree>>>,
}

impl SharedContent {
    pub(super) fn new(key: ContentKey) -> Arc<Self> {
        Arc::new(Self { key, tree: OnceLock::new() })
    }

    /// The tree over the geometry; equal geometry has one.
    pub(crate) fn tree(&self, geometry: &Geometry) -> Option<Arc<KdTree>> {
        self.tree.get_or_init(|| KdTree::build(geometry).map(Arc::new)).clone()
    }

    /// The tree over the geometry, where one was built before it was known to be shared.
    pub(super) fn tree_or(&self, built: Arc<KdTree>) -> Option<Arc<KdTree>> {
        self.tree.get_or_init(|| Some(built)).clone()
    }
}

/// What a drawable shares with others.
#[derive(Clone, Debug, Default)]
pub(crate) struct SharedParts {
    pub(crate) geometry: Option<Arc<SharedContent>>,
    pub(crate) indices: Option<Arc<SharedContent>>,
    pub(crate) texture: Option<Arc<SharedContent>>,
}

impl SharedParts {
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Arc<SharedContent>> {
        [&self.geometry, &self.indices, &self.texture].into_iter().flatten()
    }
}
