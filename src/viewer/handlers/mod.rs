//! Ready-made event handlers; OSG's `osgViewer/ViewerEventHandlers`. Main thread, event phase.
//!
//! Each handles its own keys and lists them in the help. An application adds the ones it wants, or all with [`add_usual`].

mod credits;
mod help;
mod lod_scale;
mod pager_debug;
mod record_path;
mod screen_capture;
mod state_set;
mod stats;
mod threading;
mod usual;
mod window_size;

pub use credits::CreditsHandler;
pub use help::HelpHandler;
pub use lod_scale::LodScaleHandler;
pub use pager_debug::{PagerDebugHandler, TileColors, TileState};
pub use record_path::RecordCameraPathHandler;
pub use screen_capture::ScreenCaptureHandler;
pub use state_set::StateSetManipulator;
pub use stats::{StatsHandler, StatsPage};
pub use threading::ThreadingHandler;
pub use usual::add_usual;
pub use window_size::WindowSizeHandler;
