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
