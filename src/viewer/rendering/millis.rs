//! Durations in milliseconds, as statistics have them.

use std::time::Duration;

/// Returns a duration in milliseconds.
pub(in crate::viewer) fn millis(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}
