//! [`AdapterClock`]: converts timestamps of the adapter to the processor's clock. Draw thread; plain values.
//!
//! wgpu has no call that reads both clocks at once. But no pass begins before it was submitted. So timestamps are moved by
//! the least difference that agrees with this for all of the last frames. A converted time is too early by the shortest wait
//! of those submissions, which is some tens of microseconds if the adapter was idle once. It is never too late, except for
//! the drift of the clocks in 512 frames.

use std::time::{Duration, Instant};

/// The number of frames after which a bound on the difference is dropped, since the clocks drift.
const MAX_BOUND_AGE: u32 = 256;

/// The difference between the adapter's clock and the processor's. Each event that cannot have happened before a known
/// moment bounds it from below.
#[derive(Default)]
pub(super) struct AdapterClock {
    /// The origin of the processor's times: the submission of the first observed frame.
    epoch: Option<Instant>,
    /// The largest bound in nanoseconds, of the current series of frames and of the one before.
    bounds: [Option<f64>; 2],
    /// The number of frames in the current series.
    frames: u32,
}

impl AdapterClock {
    /// Notes that something which was submitted at a moment began at a time of the adapter.
    pub(super) fn observe(&mut self, began_ns: f64, submitted: Instant) {
        let epoch = *self.epoch.get_or_insert(submitted);
        self.add_bound(signed_ns(epoch, submitted) - began_ns);
    }

    fn add_bound(&mut self, bound_ns: f64) {
        self.frames += 1;
        if self.frames > MAX_BOUND_AGE {
            self.bounds = [None, self.bounds[0]];
            self.frames = 0;
        }
        self.bounds[0] = Some(self.bounds[0].map_or(bound_ns, |known| known.max(bound_ns)));
    }

    /// Returns the least difference that agrees with all bounds; 0 without bounds.
    fn difference_ns(&self) -> f64 {
        self.bounds.iter().flatten().copied().reduce(f64::max).unwrap_or(0.0)
    }

    /// Converts a time of the adapter. Must not be called before the first observation.
    pub(super) fn instant(&self, adapter_ns: f64) -> Option<Instant> {
        Some(from_signed_ns(self.epoch?, adapter_ns + self.difference_ns()))
    }
}

/// Returns the nanoseconds from one moment to another, negative if that is earlier.
fn signed_ns(from: Instant, to: Instant) -> f64 {
    match to.checked_duration_since(from) {
        Some(after) => after.as_nanos() as f64,
        None => -(from.saturating_duration_since(to).as_nanos() as f64),
    }
}

fn from_signed_ns(from: Instant, ns: f64) -> Instant {
    let distance = Duration::from_nanos(ns.abs() as u64);
    let moved = if ns >= 0.0 { from.checked_add(distance) } else { from.checked_sub(distance) };
    moved.unwrap_or(from)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_begins_before_it_was_submitted() {
        let mut clock = AdapterClock::default();
        let ours_ns = |clock: &AdapterClock, adapter_ns: f64| adapter_ns + clock.difference_ns();
        let observe =
            |clock: &mut AdapterClock, adapter_ns: f64, submitted_ns: f64| clock.add_bound(submitted_ns - adapter_ns);
        assert_eq!(ours_ns(&clock, 5.0), 5.0);
        // The adapter's clock is 1,000 behind. Submissions wait for 70, 20 and 300 before they begin.
        for (submitted, waits) in [(5_000.0, 70.0), (6_000.0, 20.0), (7_000.0, 300.0)] {
            observe(&mut clock, submitted + waits - 1_000.0, submitted);
            assert!(ours_ns(&clock, submitted + waits - 1_000.0) >= submitted);
        }
        // The error is the shortest wait.
        assert_eq!(ours_ns(&clock, 9_000.0), 9_980.0);
        // The adapter's clock runs faster by 1 in 1,000. The bound follows some series of frames later.
        for frame in 0..4 * MAX_BOUND_AGE {
            let ours = 10_000.0 + 1_000.0 * f64::from(frame);
            observe(&mut clock, ours * 1.001 - 1_000.0, ours);
        }
        let last = 10_000.0 + 1_000.0 * f64::from(4 * MAX_BOUND_AGE);
        let error = ours_ns(&clock, last * 1.001 - 1_000.0) - last;
        assert!((0.0..=f64::from(3 * MAX_BOUND_AGE)).contains(&error), "{error}");
    }

    #[test]
    fn signed_nanoseconds_convert_both_ways() {
        let now = Instant::now();
        for ns in [0.0, 1_500.0, -1_500.0] {
            assert_eq!(signed_ns(now, from_signed_ns(now, ns)), ns);
        }
    }
}
