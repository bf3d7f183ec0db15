//! Windows of winit and the event loops that run them. Main thread.

pub(super) mod events;
mod many_views;
mod one_view;
mod open;
mod pacing;
mod parent;
mod slave_window;

pub use many_views::{EachFrame, OnViewsOpen, ViewsOptions, run_views};
pub use one_view::{AfterFrame, BeforeFrame, OnOpen, WindowOptions, run_window};
pub use parent::ParentWindow;
pub use slave_window::SlaveWindow;
