//! Windows of winit and the event loops that run them. Main thread.
//!
//! [`run_window`] runs one view, in one window or several; [`run_views`] runs several views. Both open windows, feed events to
//! the event queues, run frames at the wanted pace, and return the viewer once the last window is closed. A window or a
//! display that cannot be opened is a [`ViewerError::Window`](super::ViewerError::Window).
//!
//! | file | content |
//! |---|---|
//! | `one_view`, `many_views` | the two event loops |
//! | `open` | creates windows and their contexts, and carries out commands of handlers |
//! | `input_routes` | the view of a window that an event goes to |
//! | `events` | from winit's events to [`GuiEventAdapter`](super::GuiEventAdapter)s |
//! | `pacing` | when the next frame is drawn |
//! | `parent` | windows inside another toolkit's window |

pub(super) mod events;
mod input_routes;
mod many_views;
mod one_view;
mod open;
mod overlay_input;
mod pacing;
mod parent;
mod slave_window;

pub use many_views::{EachFrame, OnViewsOpen, ViewsOptions, run_views};
pub use one_view::{AfterFrame, BeforeFrame, OnOpen, WindowOptions, run_window};
pub use parent::ParentWindow;
pub use slave_window::SlaveWindow;
