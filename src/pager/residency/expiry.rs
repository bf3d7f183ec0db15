//! When a page is unused for long enough, and how many pages one frame examines.

use std::ops::RangeInclusive;
use std::time::Duration;

use crate::pager::frame_times::FrameTimes;

/// Pages examined for expiry in one frame while the reserved tenths of the budgets are not free. The number doubles from
/// frame to frame while pages expire, and halves while all are in use.
const PAGES_PER_FRAME: RangeInclusive<usize> = 16..=256;

/// How long a page must not have been wanted before it may expire: for more than `frames` and for at least `time`, or for
/// more than `enough_frames` whatever time they took.
#[derive(Clone, Copy, Debug)]
pub(in crate::pager) struct Unused {
    frames: u32,
    time: Duration,
    enough_frames: u32,
}

impl Unused {
    /// Pages that the last two frames did not show; enough when room is short.
    pub const NOT_SHOWN: Self = Self { frames: 2, time: Duration::ZERO, enough_frames: u32::MAX };

    /// Returns the condition of more than `frames` and at least `time`.
    pub fn new(frames: u32, time: Duration) -> Self {
        Self { frames, time, enough_frames: u32::MAX }
    }

    /// Adds that more than `frames` are enough, whatever time they took.
    pub fn or_frames(self, frames: u32) -> Self {
        Self { enough_frames: frames, ..self }
    }

    /// Returns true if what was last wanted in `frame`, or is wanted in that coming frame, is unused for long enough.
    pub fn allows(&self, frame: u32, times: &FrameTimes) -> bool {
        let age = times.frame().abs_diff(frame);
        let is_long = || self.time.is_zero() || times.distance(frame) >= self.time;
        age > self.enough_frames || age > self.frames && is_long()
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: in the first frames a prefetch replaced pages wanted as soon as itself, because no earlier frame told how
    /// long its frames take.
    #[test]
    fn frames_alone_are_enough_whatever_is_known_of_their_time() {
        let mut times = FrameTimes::default();
        (1..=11).for_each(|frame| times.begin(frame, f64::from(frame) / 60.0));
        let configured = Unused::new(2, Duration::from_millis(500));
        let for_prefetch = configured.or_frames(18);
        assert!(!for_prefetch.allows(26, &times) && !for_prefetch.allows(1, &times));
        assert!(for_prefetch.allows(30, &times) && !configured.allows(30, &times));
        (12..=60).for_each(|frame| times.begin(frame, f64::from(frame) / 60.0));
        assert!(for_prefetch.allows(29, &times) && configured.allows(29, &times));
        assert!(for_prefetch.allows(41, &times) && !configured.allows(41, &times));
        assert!(!for_prefetch.allows(42, &times));
    }
}
