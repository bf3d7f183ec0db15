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
mod tile_state;
mod window_size;

pub use help::HelpHandler;
pub use lod_scale::LodScaleHandler;
pub use pager_debug::{PagerDebugHandler, TileColors};
pub use record_path::RecordCameraPathHandler;
pub use screen_capture::ScreenCaptureHandler;
pub use state_set::StateSetManipulator;
pub use stats::{StatsHandler, StatsPage};
pub use threading::ThreadingHandler;
pub use tile_state::TileState;
pub use window_size::WindowSizeHandler;

use std::path::Path;

use super::{GuiActionAdapter, View};

/// Adds all of them to a view (a [`Viewer`](super::Viewer) is one); pictures and camera paths go into a folder.
pub fn add_usual(view: &mut View, folder: &Path, stats: StatsPage) {
    view.add_event_handler(HelpHandler::default());
    view.add_event_handler(StatsHandler { page: stats });
    view.add_event_handler(WindowSizeHandler);
    view.add_event_handler(ScreenCaptureHandler::new(folder));
    view.add_event_handler(RecordCameraPathHandler::new(folder.join("terrane.path")));
    view.add_event_handler(StateSetManipulator::default());
    view.add_event_handler(LodScaleHandler);
    view.add_event_handler(ThreadingHandler);
    view.add_event_handler(PagerDebugHandler::default());
}
