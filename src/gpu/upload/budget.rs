//! [`CompileBudget`] and [`CompilePace`]: the part of a frame that uploads may take. Plain values.

use std::ops::RangeInclusive;
use std::time::Duration;

/// The maximum time and bytes of uploads in a frame of the target rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CompileBudget {
    /// The time limit, checked after each slice of at most 256 KiB.
    pub time: Duration,
    /// The limit in bytes. A call may always upload 16 KiB, or one row of an image.
    pub bytes: u64,
}

impl Default for CompileBudget {
    /// Returns 2 ms and 4 MiB: about ten height tiles with colour per frame.
    fn default() -> Self {
        Self { time: Duration::from_millis(2), bytes: 4 << 20 }
    }
}

impl CompileBudget {
    /// No limit: a call uploads everything that waits.
    pub const UNLIMITED: Self = Self { time: Duration::MAX, bytes: u64::MAX };

    /// Returns the budget for the next frame, if the last frames took `busy` (the shortest to the longest) without their
    /// uploads.
    ///
    /// The time is the share of the remaining frame that `pace` allows, at least f times
    /// [`CompilePace::minimum_time_available`] and at most f times this budget's. f is the shortest frame divided by that of
    /// [`CompilePace::target_frame_rate`], and at least 1: on a slow adapter uploads take the same share of a frame as on a
    /// fast one. The bytes are reduced if the time is less than this budget's, and never grow.
    pub fn beside(&self, busy: &RangeInclusive<Duration>, pace: &CompilePace) -> Self {
        let frame_s = 1.0 / pace.target_frame_rate;
        let left_s = (frame_s - busy.end().as_secs_f64()) * pace.conservative_ratio;
        // A rate of 0 leaves infinite time, which no duration holds. NaN leaves none.
        let left = duration(left_s.max(0.0));
        let longer = if frame_s > 0.0 { (busy.start().as_secs_f64() / frame_s).max(1.0) } else { 1.0 };
        let grown = |time: Duration| if longer > 1.0 { duration(time.as_secs_f64() * longer) } else { time };
        let time = left.max(grown(pace.minimum_time_available)).min(grown(self.time));
        if time >= self.time {
            return Self { time, ..*self };
        }
        let share = time.as_secs_f64() / self.time.as_secs_f64();
        Self { time, bytes: (self.bytes as f64 * share) as u64 }
    }
}

/// Returns the longest duration if `seconds` is too large for one.
fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
}

/// The share of frames that uploads may take. The fields are those of OpenSceneGraph's `IncrementalCompileOperation`, whose
/// default frame rate is 100.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CompilePace {
    /// The frame rate in Hz that uploads must not endanger; 0 lets them use the whole budget.
    pub target_frame_rate: f64,
    /// The time that uploads get in each frame however long the frame takes otherwise, within the budget. Frames that are
    /// longer than the target's give them more, in proportion.
    pub minimum_time_available: Duration,
    /// The share of a frame's free time that uploads may take, 0 to 1. Less than 1, since frames differ in length.
    pub conservative_ratio: f64,
}

impl Default for CompilePace {
    /// Returns 60 frames a second, 1 ms and one half.
    fn default() -> Self {
        Self { target_frame_rate: 60.0, minimum_time_available: Duration::from_millis(1), conservative_ratio: 0.5 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn uploads_get_a_share_of_the_free_time() {
        let budget = CompileBudget { time: 4 * MS, bytes: 4000 };
        let pace = CompilePace { target_frame_rate: 50.0, minimum_time_available: MS, conservative_ratio: 0.5 };
        let of = |busy_ms: u32| budget.beside(&(Duration::ZERO..=busy_ms * MS), &pace);
        assert_eq!([0, 5, 12].map(of), [budget; 3], "half of the time that is free of 20 ms, at most the budget");
        let near = |a: Duration, b: Duration| a.abs_diff(b) < Duration::from_nanos(100);
        assert!(near(of(14).time, 3 * MS) && (2999..=3000).contains(&of(14).bytes), "{:?}", of(14));
        assert!(near(of(16).time, 2 * MS) && (1999..=2000).contains(&of(16).bytes), "{:?}", of(16));
        assert_eq!([18, 20, 1000].map(of), [CompileBudget { time: MS, bytes: 1000 }; 3], "the minimum");
    }

    #[test]
    fn uploads_keep_their_share_of_longer_frames() {
        let budget = CompileBudget { time: 4 * MS, bytes: 4000 };
        let pace = CompilePace { target_frame_rate: 50.0, minimum_time_available: MS, conservative_ratio: 0.5 };
        let of = |shortest_ms: u32| budget.beside(&(shortest_ms * MS..=1000 * MS), &pace);
        assert_eq!(of(20), CompileBudget { time: MS, bytes: 1000 }, "one long frame is not a slow adapter");
        assert_eq!(of(60), CompileBudget { time: 3 * MS, bytes: 3000 });
        assert_eq!(of(200), CompileBudget { time: 10 * MS, bytes: 4000 }, "the limit in bytes does not grow");
        let generous = CompilePace { minimum_time_available: 100 * MS, ..pace };
        assert_eq!(budget.beside(&(200 * MS..=200 * MS), &generous), CompileBudget { time: 40 * MS, bytes: 4000 });
        let none = CompileBudget { time: Duration::ZERO, bytes: 0 };
        assert_eq!(none.beside(&(200 * MS..=200 * MS), &pace), none);
        assert_eq!(CompileBudget::UNLIMITED.beside(&(200 * MS..=200 * MS), &generous).time, 1000 * MS);
    }

    #[test]
    fn invalid_numbers_give_a_valid_budget() {
        let budget = CompileBudget::default();
        let of = |target_frame_rate: f64, conservative_ratio: f64, minimum_ms: u32| {
            let minimum_time_available = minimum_ms * MS;
            let pace = CompilePace { target_frame_rate, minimum_time_available, conservative_ratio };
            budget.beside(&(5 * MS..=5 * MS), &pace).time
        };
        assert_eq!(of(0.0, 0.5, 1), budget.time, "no frame rate to keep");
        for (rate, ratio) in [(-1.0, 0.5), (f64::NAN, 0.5), (60.0, f64::NAN), (60.0, -1.0), (f64::INFINITY, 0.5)] {
            assert_eq!(of(rate, ratio, 1), MS, "{rate} {ratio}");
        }
        assert_eq!(of(60.0, 1e300, 1), budget.time);
        assert_eq!((of(1000.0, 0.5, 0), of(1000.0, 0.5, 100)), (Duration::ZERO, 5 * budget.time));
        let none = CompileBudget { time: Duration::ZERO, bytes: 0 };
        assert_eq!(none.beside(&(MS..=MS), &CompilePace::default()), none);
        assert_eq!(
            CompileBudget::UNLIMITED.beside(&(Duration::ZERO..=Duration::ZERO), &CompilePace::default()).time,
            MS * 25 / 3
        );
    }
}
