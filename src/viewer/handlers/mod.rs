//! The handlers that viewers usually have; OSG's `osgViewer/ViewerEventHandlers`. Main thread, event phase.
//!
//! Each answers its own keys and says so in the help; an application adds those it likes, or all by [`add_usual`].

mod help;
mod lod_scale;
mod pager_debug;
mod record_path;
mod screen_capture;
mod state_set;
mod stats;
mod threading;
mod window_size;

pub use help::HelpHandler;
pub use lod_scale::LodScaleHandler;
pub use pager_debug::{PagerDebugHandler, TileColors};
pub use record_path::RecordCameraPathHandler;
pub use screen_capture::ScreenCaptureHandler;
pub use state_set::StateSetManipulator;
pub use stats::{StatsHandler, StatsPage};
pub use threading::{SwitchThreading, ThreadingHandler};
pub use window_size::WindowSizeHandler;

use std::path::Path;

use super::Viewer;

/// Adds all of them but [`ThreadingHandler`]; pictures and camera paths go into a folder.
pub fn add_usual(viewer: &mut Viewer, folder: &Path, stats: StatsPage) {
    viewer.add_event_handler(HelpHandler::default());
    viewer.add_event_handler(StatsHandler { page: stats });
    viewer.add_event_handler(WindowSizeHandler);
    viewer.add_event_handler(ScreenCaptureHandler::new(folder));
    viewer.add_event_handler(RecordCameraPathHandler::new(folder.join("terrane.path")));
    viewer.add_event_handler(StateSetManipulator::default());
    viewer.add_event_handler(LodScaleHandler);
    viewer.add_event_handler(PagerDebugHandler::default());
}
