//! When a page is unused for long enough, and how many pages one frame examines.

use std::ops::RangeInclusive;
use std::time::Duration;

use crate::pager::frame_times::FrameTimes;

/// Pages examined for expiry in one frame while the reserved tenths of the budgets are not free. The number doubles from
/// frame to frame while pages expire, and halves while all are in use.
const PAGES_PER_FRAME: RangeInclusive<usize> = 16..=256;

/// How long a page must not have been wanted before it may expire: for more than `frames` and for at least `time`.
#[derive(Clone, Copy, Debug)]
pub(in crate::pager) struct Unused {
    pub frames: u32,
    pub time: Duration,
}

impl Unused {
    /// Pages that the last two frames did not show; enough when room is short.
    pub const NOT_SHOWN: Self = Self { frames: 2, time: Duration::ZERO };

    /// Returns true if what was last wanted in `frame`, or is wanted in that coming frame, is unused for long enough.
    pub fn allows(&self, frame: u32, times: &FrameTimes) -> bool {
        times.frame().abs_diff(frame) > self.frames && (self.time.is_zero() || times.distance(frame) >= self.time)
    }

    /// Returns the longer of two frame counts and of two times.
    pub fn at_least(self, frames: u32, time: Duration) -> Self {
        Self { frames: self.frames.max(frames), time: self.time.max(time) }
    }
}

/// Adapts how many pages a frame examines for expiry.
#[derive(Debug, Default)]
pub(in crate::pager) struct ExpirySearch {
    pages: usize,
}

impl ExpirySearch {
    /// Returns the maximum of pages examined in one frame.
    pub fn max_pages() -> usize {
        *PAGES_PER_FRAME.end()
    }

    /// Returns how many pages this frame examines; the maximum when room is short.
    pub fn start(&mut self, is_short: bool) -> usize {
        if is_short {
            self.pages = Self::max_pages();
        }
        self.pages
    }

    /// Adapts the next frame's number; `has_found` is true if pages expired in this frame.
    pub fn end(&mut self, has_found: bool) {
        let next = if has_found { 2 * self.pages } else { self.pages / 2 };
        self.pages = next.clamp(*PAGES_PER_FRAME.start(), *PAGES_PER_FRAME.end());
    }
}
