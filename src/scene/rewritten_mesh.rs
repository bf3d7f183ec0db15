//! [`RewrittenMesh`]: a mesh change on its way from the scene to the graphics contexts. Plain values.

use std::sync::Arc;

use super::geometry::Mesh;
use super::id::PageId;
use crate::state::DataVariance;

/// A mesh that replaces the one of a drawable, until it was sent to all contexts.
#[derive(Clone, Debug)]
pub(crate) struct RewrittenMesh {
    pub(crate) page: PageId,
    /// The index of the drawable in its page.
    pub(crate) drawable: u32,
    pub(crate) mesh: Arc<Mesh>,
    pub(crate) variance: DataVariance,
}
