//! What holds for the children of a tile that is open.

use crate::cull::fade::Fade;
use crate::cull::visitor::Purpose;

/// What holds for the tiles up to `end`.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct TileFrame {
    pub end: u32,
    pub mask: u8,
    pub purpose: Purpose,
    /// Culled tiles are kept (and asked for) too: the parent waits for all of them.
    pub required: bool,
    /// Error in pixels of what is shown while tiles here are missing.
    pub shown_px: f32,
    pub fade: Fade,
}

impl TileFrame {
    /// A copy, a field at a time: one of the whole waits some 15 cycles for fields that were just written one by one.
    #[inline(always)]
    pub fn read(&self) -> Self {
        let Self { end, mask, purpose, required, shown_px, fade } = *self;
        Self { end, mask, purpose, required, shown_px, fade }
    }
}
