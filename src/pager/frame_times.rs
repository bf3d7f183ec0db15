//! [`FrameTimes`]: when recent frames began, by the reference time of their stamps. Update thread.
//!
//! Culls stamp tiles with frame numbers, and expiry counts seconds. The time is that of the frame stamps, not a clock's, so
//! that a replay expires what the flight did.

use std::collections::VecDeque;
use std::time::Duration;

/// The number of frames whose times are kept. Of the older half every second one is dropped when there are more, so that
/// long ages are known roughly.
const MAX_FRAMES: usize = 4096;

/// The times of frames, ascending.
#[derive(Debug, Default)]
pub(in crate::pager) struct FrameTimes {
    /// Frame number and seconds of reference time.
    begun: VecDeque<(u32, f64)>,
}

impl FrameTimes {
    /// Notes that a frame begins. A time that runs backwards counts as one that stands still. Frame numbers that run backwards
    /// are those of another frame loop.
    pub fn begin(&mut self, frame: u32, time_s: f64) {
        match self.begun.back() {
            Some((last, _)) if frame == *last => return,
            Some((last, _)) if frame < *last => self.begun.clear(),
            _ => {}
        }
        if self.begun.len() >= MAX_FRAMES {
            let mut index = 0;
            self.begun.retain(|_| {
                index += 1;
                index > MAX_FRAMES / 2 || index % 2 == 1
            });
        }
        let time_s = if time_s.is_finite() { time_s } else { 0.0 };
        let time_s = self.begun.back().map_or(time_s, |(_, last)| time_s.max(*last));
        self.begun.push_back((frame, time_s));
    }

    /// Returns the number of the frame that began last; 0 before the first.
    pub fn frame(&self) -> u32 {
        self.begun.back().map_or(0, |(frame, _)| *frame)
    }

    /// Returns the time from a frame to the one that began last; for frames before the first, from the first. A coming frame
    /// is as far away as the frame that lies as far in the past.
    pub fn distance(&self, frame: u32) -> Duration {
        let Some(&(now, now_s)) = self.begun.back() else { return Duration::ZERO };
        let past = now.saturating_sub(now.abs_diff(frame));
        let after = self.begun.partition_point(|(begun, _)| *begun <= past);
        let before = after.checked_sub(1).and_then(|index| self.begun.get(index));
        let at_s = match (before, self.begun.get(after)) {
            (Some(&(first, first_s)), Some(&(second, second_s))) => {
                first_s + (second_s - first_s) * f64::from(past - first) / f64::from(second - first)
            }
            (Some(&(_, time_s)), None) | (None, Some(&(_, time_s))) => time_s,
            (None, None) => now_s,
        };
        Duration::try_from_secs_f64(now_s - at_s).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_reference_times_whatever_the_frame_rate() {
        let mut times = FrameTimes::default();
        assert_eq!((times.frame(), times.distance(7)), (0, Duration::ZERO));
        // 100 frames of a second, then ten of a quarter.
        (1..=100).for_each(|frame| times.begin(frame, f64::from(frame)));
        (1..=10).for_each(|frame| times.begin(100 + frame, 100.0 + 0.25 * f64::from(frame)));
        let seconds = |frame: u32| times.distance(frame).as_secs_f64();
        assert_eq!([110, 106, 100, 90, 1, 0].map(seconds), [0.0, 1.0, 2.5, 12.5, 101.5, 101.5]);
        assert_eq!((seconds(114), seconds(120)), (1.0, 2.5), "coming frames");
        // A time that runs backwards, or is no number.
        times.begin(111, 3.0);
        times.begin(112, f64::NAN);
        assert_eq!(times.distance(110), Duration::ZERO);
        times.begin(5, 1000.0);
        assert_eq!((times.frame(), times.distance(110)), (5, Duration::ZERO), "another frame loop");
    }

    #[test]
    fn ages_of_many_frames_stay_known_in_bounded_memory() {
        let mut times = FrameTimes::default();
        let last = 50 * MAX_FRAMES as u32;
        (1..=last).for_each(|frame| times.begin(frame, f64::from(frame)));
        assert!(times.begun.len() <= MAX_FRAMES);
        for age in [0, 1, 100, 1999, 10_000, last - 1] {
            assert_eq!(times.distance(last - age).as_secs_f64(), f64::from(age), "frames of equal length");
        }
    }
}
