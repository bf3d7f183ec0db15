//! Drawing on demand: whether another frame could show another image.

use crate::viewer::frame::FrameLoop;
use crate::viewer::paging::SceneList;
use crate::viewer::view::View;

/// Returns false while another frame would show the same image.
pub(in crate::viewer) fn needs_frame(base: &FrameLoop, view: &View, scenes: &SceneList) -> bool {
    base.awaits_answers() || changes(base, view, scenes)
}

/// Returns true when anything but a pending readback may change the next image.
pub(in crate::viewer) fn changes(base: &FrameLoop, view: &View, scenes: &SceneList) -> bool {
    let (input, paged) = (&view.input, &scenes[view.scene()]);
    let pager = base.pager_of(paged);
    input.needs_redraw
        || !input.queue.is_empty()
        || view.shows_overlay()
        || input.camera_motion.is_moving()
        || view.shown.is_changing()
        || base.stamp().frame == 0
        || base.awaits_picture()
        || paged.has_update_callbacks()
        || view.has_update_callback()
        || !pager.is_unchanging(scenes)
        || pager.has_due()
        || paged.image_pager().is_some_and(|images| images.needs_frame())
}
