//! Configuration from outside: the display's settings, and arrangements of windows and views.
//!
//! Everything here is read once on the main thread, before a window opens. [`DisplaySettings`] come from environment
//! variables and the command line. An [`Arrangement`] comes from environment variables ([`mod@environment`]) or from a
//! JSON file ([`mod@file`]).

mod arrangement;
mod display_settings;
mod environment;
mod file;
#[cfg(feature = "window")]
mod screen;
mod screens;
mod view_setup;
mod window_setup;

pub use arrangement::Arrangement;
pub use display_settings::{DisplaySettingError, DisplaySettings, DisplayType};
pub use environment::{CONFIG_FILE_VARIABLE, SCREEN_VARIABLE, WINDOW_VARIABLE};
#[cfg(feature = "window")]
pub use screen::Screen;
#[cfg(feature = "window")]
pub(super) use screens::{across_screens, one_eye_per_screen};
pub use view_setup::{SceneSetup, ViewCamera, ViewSetup, ViewsSetup};
pub use window_setup::{CameraSetup, WindowSetup};
