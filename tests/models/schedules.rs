//! Models of threads: schedules in which they are switched at every step, and what stands in the place of the standard
//! library's locks and of crossbeam's channels in files of the library that a model runs.

pub mod channel;
pub mod thread;

/// What `terrane::sync::primitives` names.
pub mod primitives {
    pub use super::channel;
    pub use super::thread::{Builder, JoinHandle};
    pub use shuttle::sync::{Arc, Condvar, Mutex, MutexGuard};
}

/// Schedules tried of each model; half of them with few, well placed switches.
const SCHEDULES: usize = 1500;

/// A deadlock, a lost wake-up or a failed assertion in any schedule fails.
pub fn check(model: impl Fn() + Send + Sync + Clone + 'static) {
    shuttle::check_random(model.clone(), SCHEDULES);
    shuttle::check_pct(model, SCHEDULES, 3);
}

/// As [`check`], of threads that may go round and round until another tells them to end: in schedules that let all have
/// their turns.
pub fn check_fairly(model: impl Fn() + Send + Sync + 'static) {
    shuttle::check_random(model, 2 * SCHEDULES);
}
