//! [`add_usual`]: the handlers of a window.

use std::path::Path;

use super::credits::CreditsHandler;
use super::help::HelpHandler;
use super::lod_scale::LodScaleHandler;
use super::pager_debug::PagerDebugHandler;
use super::record_path::RecordCameraPathHandler;
use super::screen_capture::ScreenCaptureHandler;
use super::state_set::StateSetManipulator;
use super::stats::{StatsHandler, StatsPage};
use super::threading::ThreadingHandler;
use super::window_size::WindowSizeHandler;
use crate::viewer::View;

/// Adds all handlers of this module to a view (a [`Viewer`](crate::viewer::Viewer) is one). Images and camera paths are
/// written into `folder`.
pub fn add_usual(view: &mut View, folder: &Path, stats: StatsPage) {
    view.add_event_handler(HelpHandler::default());
    view.add_event_handler(CreditsHandler::default());
    view.add_event_handler(StatsHandler { page: stats });
    view.add_event_handler(WindowSizeHandler);
    view.add_event_handler(ScreenCaptureHandler::new(folder));
    view.add_event_handler(RecordCameraPathHandler::new(folder.join("terrane.path")));
    view.add_event_handler(StateSetManipulator::default());
    view.add_event_handler(LodScaleHandler);
    view.add_event_handler(ThreadingHandler);
    view.add_event_handler(PagerDebugHandler::default());
}
