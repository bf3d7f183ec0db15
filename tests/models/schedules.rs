//! Schedules that switch threads at every step. Shuttle's locks replace the standard library's, and [`channel`]
//! replaces crossbeam's channels, in the files of the library that a model runs.

pub mod channel;
pub mod thread;

/// The names of `terrane::sync::primitives`.
pub mod primitives {
    pub use super::channel;
    pub use super::thread::{Builder, JoinHandle};
    pub use shuttle::future::block_on;
    pub use shuttle::sync::{Arc, Condvar, Mutex, MutexGuard};
}

/// The number of random schedules per model, and that of schedules with few, well placed switches.
const SCHEDULES: usize = 500;
/// The same with `TERRANE_LONG_TESTS=1`.
const LONG_SCHEDULES: usize = 1500;

fn schedules() -> usize {
    if kit::long_tests() { LONG_SCHEDULES } else { SCHEDULES }
}

/// Runs a model. A deadlock, a lost wake-up or a failed assertion in any schedule is a failure.
pub fn check(model: impl Fn() + Send + Sync + Clone + 'static) {
    shuttle::check_random(model.clone(), schedules());
    shuttle::check_pct(model, schedules(), 3);
}

/// Runs a model with threads that may loop until another stops them, in schedules that give each thread its turns.
pub fn check_fairly(model: impl Fn() + Send + Sync + 'static) {
    shuttle::check_random(model, 2 * schedules());
}
