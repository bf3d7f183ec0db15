//! What holds for the children of a tile that is open.

use crate::cull::fade::Fade;
use crate::cull::visitor::Purpose;

/// What holds for the children of a tile that is open.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct TileFrame {
    /// The child to go on with when all below the one before is met.
    pub next: u32,
    /// Behind the last child.
    pub end: u32,
    pub mask: u8,
    pub purpose: Purpose,
    /// They take the place of the parent's content, which waits for all of them: culled ones are kept (and asked for) too.
    pub required: bool,
    /// Squared error in pixels of what is shown while tiles here are missing.
    pub shown_px2: f32,
    pub fade: Fade,
}

impl TileFrame {
    /// A copy, a field at a time: one of the whole waits some 15 cycles for fields that were just written one by one.
    #[inline(always)]
    pub fn read(&self) -> Self {
        let Self { next, end, mask, purpose, required, shown_px2, fade } = *self;
        Self { next, end, mask, purpose, required, shown_px2, fade }
    }
}

/// Opens a tile: `frame` holds for its children, with its siblings from `next` the walk goes on behind them.
#[inline(always)]
pub(in crate::cull) fn open(stack: &mut Vec<TileFrame>, next: u32, frame: TileFrame) {
    if let Some(above) = stack.last_mut() {
        above.next = next;
    }
    stack.push(frame);
}
