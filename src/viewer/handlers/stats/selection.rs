//! [`StatsPage`]: the page of statistics that is shown.

/// The number of frames over which medians and bars are taken.
pub(super) const RECENT_FRAMES: usize = 120;

/// A page of statistics; each page includes the previous one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StatsPage {
    /// No page.
    #[default]
    None,
    /// The frame rate.
    FrameRate,
    /// The phases of the last frames as bars.
    Frame,
    /// Draw counters.
    Drawing,
    /// Pager counters.
    Pager,
}
