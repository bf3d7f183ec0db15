//! [`Input`]: the input state of a view: its queue, handlers, manipulator, notice and overlay. Main thread.

use std::sync::Arc;

use glam::DVec2;

use super::camera_motion::CameraMotion;
use super::handler_list::HandlerList;
use crate::state::StateSet;
use crate::viewer::clock::{FrameStamp, ReferenceClock};
use crate::viewer::config::Arrangement;
use crate::viewer::events::{EventQueue, GuiEventAdapter, Key};
use crate::viewer::ids::ContextId;
#[cfg(feature = "window")]
use crate::viewer::overlay::Overlay;
use crate::viewer::view::View;

/// How long a notice is shown, seconds.
const NOTICE_S: f64 = 2.5;

/// A request to the window, carried out before the next frame by the code that runs the window.
#[derive(Clone, Debug, PartialEq)]
pub enum WindowCommand {
    /// Switches between full screen and a window.
    ToggleFullScreen,
    /// Resizes the window to a width and height in pixels.
    Resize([u32; 2]),
    /// Shows a shape of the pointer over the window; see [`View::set_cursor`](crate::viewer::View::set_cursor).
    SetCursor(MouseCursor),
    /// Moves the pointer to a position in the window, in pixels from its upper left corner; see
    /// [`View::warp_pointer`](crate::viewer::View::warp_pointer). Ignored where the window system does not support it.
    WarpPointer(DVec2),
    /// Closes the window of a context, its context and the cameras in it. Other windows stay open.
    Close(ContextId),
    /// Opens the windows of an arrangement for the view, and closes those that it has; see
    /// [`View::set_up`](crate::viewer::View::set_up).
    SetUp(Arrangement),
}

/// The shape of the pointer over a window; OSG's `MouseCursor`. Shapes that the window system lacks look like the nearest one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum MouseCursor {
    /// The usual one of the window system.
    #[default]
    Inherit,
    /// None: the pointer is hidden.
    None,
    /// An arrow.
    Arrow,
    /// An arrow with a question mark.
    Help,
    /// Busy.
    Wait,
    /// A bar between letters.
    Text,
    /// A thin cross.
    Crosshair,
    /// A hand that points.
    Hand,
    /// An open hand, for what can be dragged.
    Grab,
    /// A closed hand, while it is dragged.
    Grabbing,
    /// Arrows in four directions.
    Move,
    /// Arrows up and down.
    UpDown,
    /// Arrows left and right.
    LeftRight,
    /// Arrows along the diagonal from the upper left to the lower right.
    UpperLeftLowerRight,
    /// Arrows along the diagonal from the upper right to the lower left.
    UpperRightLowerLeft,
    /// A crossed-out circle.
    NotAllowed,
}

/// A callback of a view's cameras in update.
pub type ViewUpdate = Box<dyn FnMut(&mut View, &FrameStamp)>;
/// A callback of a view's cameras for an event.
pub type ViewEvent = Box<dyn FnMut(&mut View, &GuiEventAdapter)>;

/// The input state of a view: queue, handlers, manipulator, notice and overlay. Main thread.
pub(in crate::viewer) struct Input {
    pub(super) queue: EventQueue,
    pub(super) handlers: HandlerList,
    pub(super) camera_motion: CameraMotion,
    pub(super) on_update: Option<ViewUpdate>,
    pub(super) on_event: Option<ViewEvent>,
    /// The events of the current frame; kept to reuse its memory.
    pub(super) events: Vec<GuiEventAdapter>,
    pub(super) quit_keys: Vec<Key>,
    pub(super) is_done: bool,
    /// True while the event phase calls handlers.
    pub(super) is_in_event_phase: bool,
    pub(super) window_commands: Vec<WindowCommand>,
    /// The notice and the time of the queue until which it is shown, seconds.
    notice: Option<(String, f64)>,
    /// True when something since the last frame may change the image.
    pub(super) needs_redraw: bool,
    /// The state set above all roots.
    pub state_set: Option<Arc<StateSet>>,
    #[cfg(feature = "window")]
    pub(super) overlay: Overlay,
    /// The user's input for the overlay of the next frame, and the pixels per point.
    #[cfg(feature = "window")]
    pub(super) overlay_input: Option<(egui::RawInput, f32)>,
}

impl Input {
    /// Creates the input state of a view of `size_px` pixels. Its events have the times of `clock`.
    pub fn new(size_px: [u32; 2], clock: ReferenceClock) -> Self {
        let mut queue = EventQueue::with_clock(clock);
        queue.set_input_range(DVec2::ZERO, DVec2::new(f64::from(size_px[0].max(1)), f64::from(size_px[1].max(1))));
        Self {
            queue,
            handlers: HandlerList::default(),
            camera_motion: CameraMotion::default(),
            on_update: None,
            on_event: None,
            events: Vec::new(),
            quit_keys: vec![Key::Escape],
            is_done: false,
            is_in_event_phase: false,
            window_commands: Vec::new(),
            notice: None,
            needs_redraw: true,
            state_set: None,
            #[cfg(feature = "window")]
            overlay: Overlay::default(),
            #[cfg(feature = "window")]
            overlay_input: None,
        }
    }

    /// Queues a resize event after the view's size has changed.
    pub fn resized(&mut self, size_px: [u32; 2]) {
        let time_s = self.queue.time_s();
        self.queue.window_resize(size_px, time_s);
    }

    /// Replaces the overlay by an empty one, after its device was lost.
    #[cfg(feature = "window")]
    pub fn reset_overlay(&mut self) {
        self.overlay = Overlay::default();
    }

    /// Shows a line of text for [`NOTICE_S`].
    pub(super) fn set_notice(&mut self, text: String) {
        self.notice = Some((text, self.queue.time_s() + NOTICE_S));
    }

    pub(super) fn notice(&self) -> Option<&str> {
        self.notice.as_ref().map(|(text, _)| &**text)
    }

    /// Removes a notice whose time is over, and requests one more frame without it.
    pub(super) fn expire_notice(&mut self, time_s: f64) {
        if self.notice.as_ref().is_some_and(|(_, until_s)| time_s > *until_s) {
            self.notice = None;
            self.needs_redraw = true;
        }
    }
}
