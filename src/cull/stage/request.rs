//! [`PageRequest`]: what cull wants the pager to load.

use crate::scene::NodeId;

/// A request for a page that is wanted and not resident.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageRequest {
    /// The tile's node, whose slot the page fills.
    pub slot: NodeId,
    /// Requests are served in descending order of priority: the error in pixels of what is drawn instead.
    ///
    /// It is always below that of the tile above, so that coarse tiles load before fine ones. It is multiplied by the
    /// squared cosine of the angle to the middle of the view, down to a quarter. Tiles outside of the frustum, which are
    /// needed so that their siblings can replace the parent, have a quarter. Values below 0 are for tiles that are wanted
    /// later, see [`Self::ahead`].
    pub priority: f32,
    /// Error in pixels of the tile itself if it were drawn.
    pub error_px: f32,
    /// Number of frames until a view will need it; 0 if one does now.
    pub ahead_frames: u32,
}

impl PageRequest {
    /// Returns the request as a prefetch for an eye position in a number of frames (at least one).
    ///
    /// Prefetches are served after all that a view lacks now, sooner before later and otherwise in the same order. They
    /// use only memory that nothing else needs. The prefetching view must be culled with the same number of
    /// [`CullCamera::ahead_frames`](crate::cull::CullCamera::ahead_frames), so that no resident page that it needs is
    /// evicted for a page that is wanted later.
    pub fn ahead(self, frames: u32) -> Self {
        let ahead_frames = frames.max(1);
        let urgency = self.priority.max(0.0) / ahead_frames as f32;
        Self { priority: -(1.0 / (1.0 + urgency)).max(f32::MIN_POSITIVE), ahead_frames, ..self }
    }
}
