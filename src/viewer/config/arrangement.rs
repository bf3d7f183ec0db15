//! [`Arrangement`]: which windows open, where, and what each shows.

use super::view_setup::ViewsSetup;
use super::window_setup::WindowSetup;

/// The windows that an application opens.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Arrangement {
    /// The arrangement that environment variables ask for; without any, one window of the configuration's size.
    #[default]
    Usual,
    /// These windows; the list is never empty.
    Windows(Vec<WindowSetup>),
    /// A full-screen window on each screen, all parts of one image as the screens stand beside each other. The master
    /// camera is on the middle screen, and all windows share a device. OSG does this when no variable is set.
    ///
    /// With two screens and [`StereoMode::HorizontalSplit`](crate::cull::StereoMode), each screen shows one eye instead,
    /// as in OSG.
    AllScreens,
    /// Several views in windows, for `run_views`; a program that shows a single view refuses it.
    Views(ViewsSetup),
}

/// A window arrangement that is invalid: names the file or variable, the field and the reason.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{source_name}: {field}{}{reason}", if field.is_empty() { "" } else { ": " })]
pub struct ArrangementError {
    /// The file or the environment variable.
    pub source_name: String,
    /// The path of the field, such as `windows[1].size_px`; empty when the error concerns the whole source.
    pub field: String,
    /// Why the value is invalid.
    pub reason: String,
}
