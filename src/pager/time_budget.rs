//! [`TimeBudget`]: how long the steps of update may take, by a clock that tests replace. Update thread.

use std::sync::Arc;
use std::time::{Duration, Instant};

/// Returns the time since an arbitrary moment.
type Clock = dyn Fn() -> Duration + Send + Sync;

/// The clock of time budgets.
#[derive(Clone)]
pub(in crate::pager) struct WorkClock(Arc<Clock>);

impl Default for WorkClock {
    fn default() -> Self {
        let start = Instant::now();
        Self(Arc::new(move || start.elapsed()))
    }
}

impl WorkClock {
    /// Creates a clock that shows what `clock` returns.
    #[cfg(feature = "testing")]
    pub fn new(clock: impl Fn() -> Duration + Send + Sync + 'static) -> Self {
        Self(Arc::new(clock))
    }

    /// Returns a budget of this much time from now on; `None` has no end.
    pub fn budget(&self, time: Option<Duration>) -> TimeBudget {
        TimeBudget { clock: self.clone(), start: (self.0)(), time }
    }
}

/// The time that several steps may take together.
pub(in crate::pager) struct TimeBudget {
    clock: WorkClock,
    start: Duration,
    time: Option<Duration>,
}

impl TimeBudget {
    /// Returns true once this many tenths of the time have passed. Steps that follow each other end at ascending tenths: what
    /// one leaves, the next may use.
    pub fn is_over_at(&self, tenths: u32) -> bool {
        self.time.is_some_and(|time| (self.clock.0)().saturating_sub(self.start) >= time / 10 * tenths)
    }
}
