//! The event phase of a view: events reach handlers, the manipulator and event callbacks of nodes.
//!
//! The event phase runs at the start of each frame, on the main thread. A window or a test feeds the view's
//! [`EventQueue`](super::EventQueue) before it. `event_phase` then hands each event on and lays out the overlay; the update
//! phase moves the camera by the manipulator.

mod action_adapter;
mod camera_motion;
mod event_callback;
mod event_phase;
mod handler;
mod handler_list;
mod pointer;
mod redraw;
mod state;
mod view_input;
mod window_matrix;

pub(super) use action_adapter::manipulator_view;
pub use action_adapter::{GuiActionAdapter, OnPicture};
pub use event_callback::event_callback;
pub use handler::GuiEventHandler;
pub(super) use redraw::{changes, needs_frame};
pub(super) use state::Input;
pub use state::{MouseCursor, ViewEvent, ViewUpdate, WindowCommand};
pub use window_matrix::{WindowMatrix, WindowRay, camera_with_focus};
