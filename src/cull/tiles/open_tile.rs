//! [`OpenTile`]: a tile whose children are being walked. Culling thread.

use crate::cull::fading::Fade;
use crate::cull::visitor::Purpose;

/// Values that hold for the children of an open tile; an entry of the stack of the walk.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct OpenTile {
    /// The child to continue with after the subtree of the one before.
    pub next: u32,
    /// One past the last child.
    pub end: u32,
    /// Frustum planes that the children may cross.
    pub mask: u8,
    pub purpose: Purpose,
    /// The children replace the parent's content only all together: culled ones are kept and requested too.
    pub required: bool,
    /// Squared error in pixels of what is drawn while children are missing.
    pub shown_px2: f32,
    pub fade: Fade,
}

impl OpenTile {
    /// Copies the entry field by field. A copy as a whole stalls for about 15 cycles when the fields were just written one
    /// by one (failed store forwarding).
    #[inline(always)]
    pub fn read(&self) -> Self {
        let Self { next, end, mask, purpose, required, shown_px2, fade } = *self;
        Self { next, end, mask, purpose, required, shown_px2, fade }
    }
}

/// Opens a tile by pushing the entry of its children. The walk continues with the tile's sibling `next` after them.
#[inline(always)]
pub(super) fn open(stack: &mut Vec<OpenTile>, next: u32, children: OpenTile) {
    if let Some(above) = stack.last_mut() {
        above.next = next;
    }
    stack.push(children);
}
