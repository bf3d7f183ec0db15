//! [`TimeBudget`]: how long a step of update may take, by a clock that tests replace. Update thread.

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
        let end = time.and_then(|time| (self.0)().checked_add(time));
        TimeBudget { clock: self.clone(), end }
    }
}

/// The time that a step may take.
pub(in crate::pager) struct TimeBudget {
    clock: WorkClock,
    end: Option<Duration>,
}

impl TimeBudget {
    /// Returns true once the time has passed.
    pub fn is_over(&self) -> bool {
        self.end.is_some_and(|end| (self.clock.0)() >= end)
    }
}
