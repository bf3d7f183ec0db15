//! Contents that several pages share. Reference counts of `Arc` tell how long a content is in use. Any thread.

use std::sync::{Arc, OnceLock};

use super::content_key::ContentKey;
use crate::scene::geometry::{Geometry, MetallicRoughness};
use crate::scene::intersect::KdTree;
use crate::state::TextureObject;

/// A shared content, referenced by the pages that use it. Its key identifies the slots on the GPU.
#[derive(Debug)]
pub(crate) struct SharedContent {
    pub(crate) key: ContentKey,
    /// The k-d tree, built on first use.
    tree: OnceLock<Option<Arc<KdTree>>>,
}

impl SharedContent {
    pub(super) fn new(key: ContentKey) -> Arc<Self> {
        Arc::new(Self { key, tree: OnceLock::new() })
    }

    /// Returns the content of a texture of state sets: those of one texture have one key.
    pub(crate) fn of_texture(texture: &Arc<TextureObject>) -> Arc<Self> {
        let address = Arc::as_ptr(texture).addr() as u64;
        Self::new(ContentKey::of(&[b"texture of state sets", &address.to_le_bytes()]))
    }

    /// Returns the k-d tree of the geometry, which all pages with equal geometry share.
    pub(crate) fn tree(&self, geometry: &Geometry) -> Option<Arc<KdTree>> {
        self.tree.get_or_init(|| KdTree::build(geometry).map(Arc::new)).clone()
    }

    /// Returns the shared k-d tree, which is `built` if there is none yet.
    pub(super) fn tree_or(&self, built: Arc<KdTree>) -> Option<Arc<KdTree>> {
        self.tree.get_or_init(|| Some(built)).clone()
    }
}

/// The contents that a drawable shares with others.
#[derive(Clone, Debug, Default)]
pub(crate) struct SharedParts {
    pub(crate) geometry: Option<Arc<SharedContent>>,
    pub(crate) indices: Option<Arc<SharedContent>>,
    /// The texture of the base colour.
    pub(crate) texture: Option<Arc<SharedContent>>,
    /// The maps of the surface, in the order of [`MetallicRoughness::maps`].
    pub(crate) maps: [Option<Arc<SharedContent>>; MetallicRoughness::MAPS],
}

impl SharedParts {
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Arc<SharedContent>> {
        [&self.geometry, &self.indices, &self.texture].into_iter().chain(&self.maps).flatten()
    }
}
