//! Pages that are visited after the current one, and the coordinate frames that they are attached to. Culling thread.
//!
//! A visit of a page adds the pages in its tiles to the queue, so that pages are visited breadth first. Siblings are
//! queued as one range: a tile tree draws most of its tiles in runs.

use glam::DAffine3;

use crate::cull::fading::Fade;

/// The reason for which a page or tile is visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::cull) enum Purpose {
    /// The content is drawn.
    Draw,
    /// An ancestor is drawn instead: missing content is requested, and resident content is kept from expiring.
    Want,
    /// The tile is culled, but its siblings can only replace their parent together with it.
    Keep,
}

/// Pages that wait for their visit: the contents of adjacent tiles, or one root of the scene.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct QueuedPage {
    /// First tile of the holder's page; for a root, its slot in the scene's page table.
    pub first: u32,
    /// One past the last tile (or slot).
    pub end: u32,
    /// Index of the [`AttachmentFrame`] that the pages hang in.
    pub attachment: u32,
    /// State graph node above the pages.
    pub state: u32,
    pub fade: Fade,
    /// Frustum planes that the pages may cross.
    pub mask: u8,
}

/// A coordinate frame that pages are attached to, with what their visits have in common.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct AttachmentFrame {
    pub eye_from_frame: DAffine3,
    /// Slot of the page that holds the tiles; `NONE` for roots, which lie in the world's frame.
    pub holder: u32,
    /// Index of the frame that the holder hangs in; its own for roots.
    pub above: u32,
    /// State graph node above the contents of tiles.
    pub state: u32,
    /// Index of the view in the view stack.
    pub view: u32,
    pub purpose: Purpose,
    /// See [`PageVisit::required`]; only external tile sets use it, since other content holds no tiles.
    pub required: bool,
    /// See [`PageVisit::shown_px`].
    pub shown_px: f32,
}

/// The visit of one page.
#[derive(Clone, Copy, Debug)]
pub(in crate::cull) struct PageVisit {
    /// Slot of the page in the scene's page table.
    pub slot: u32,
    /// Index of the [`AttachmentFrame`] that the page hangs in.
    pub attachment: u32,
    pub eye_from_page: DAffine3,
    /// Frustum planes that the page may cross.
    pub mask: u8,
    pub purpose: Purpose,
    /// The page can only replace its parent as a whole: its top tiles are kept and requested even where culled.
    pub required: bool,
    /// State graph node above the page.
    pub state: u32,
    /// Index of the view in the view stack.
    pub view: u32,
    /// Error in pixels of what is drawn while the page's top tiles are missing.
    pub shown_px: f32,
    pub fade: Fade,
}

/// A first-in, first-out queue of pages with the frames that they share.
#[derive(Debug, Default)]
pub(in crate::cull) struct PageQueue {
    pages: Vec<QueuedPage>,
    frames: Vec<AttachmentFrame>,
    /// Index of the next page to visit.
    next: usize,
}

impl PageQueue {
    /// Empties the queue and keeps its memory.
    pub fn clear(&mut self) {
        self.pages.clear();
        self.frames.clear();
        self.next = 0;
    }

    /// Adds a frame that pages may be attached to and returns its index.
    pub fn add_frame(&mut self, frame: AttachmentFrame) -> u32 {
        self.frames.push(frame);
        self.frames.len() as u32 - 1
    }

    /// Returns a frame by the index that [`Self::add_frame`] returned.
    pub fn frame(&self, index: u32) -> &AttachmentFrame {
        &self.frames[index as usize]
    }

    /// Adds pages at the end.
    #[inline(always)]
    pub fn push(&mut self, pages: QueuedPage) {
        self.pages.push(pages);
    }

    /// Takes the pages that were queued first among those not yet taken.
    pub fn pop(&mut self) -> Option<QueuedPage> {
        let pages = self.pages.get(self.next).copied();
        self.next += usize::from(pages.is_some());
        pages
    }
}
