//! The processor cores that threads are pinned to; OSG's processor affinity. Main thread, when threads are started.
//!
//! A thread that is started by a pinned one inherits its mask, and the system then reports one core. So the cores are read
//! once, before this module pins the first thread.

use std::sync::OnceLock;

use core_affinity::CoreId;

/// Returns the cores that the process may use, in ascending order; empty where the system does not tell.
pub(super) fn all() -> &'static [CoreId] {
    static CORES: OnceLock<Vec<CoreId>> = OnceLock::new();
    CORES.get_or_init(|| {
        let mut cores = core_affinity::get_core_ids().unwrap_or_default();
        cores.sort_unstable();
        cores
    })
}

/// Returns how many threads run in parallel, at least 1.
pub(super) fn count() -> usize {
    static COUNT: OnceLock<usize> = OnceLock::new();
    *COUNT.get_or_init(|| std::thread::available_parallelism().map_or(1, usize::from))
}

/// Pins the calling thread to a core.
pub(super) fn pin(core: CoreId) {
    if !core_affinity::set_for_current(core) {
        log::warn!("cannot pin a thread to core {}", core.id);
    }
}

/// Returns the cores for the threads of a model, in turn, without the first core, which the main thread uses. Empty on a
/// single core.
pub(super) fn for_threads() -> impl Iterator<Item = CoreId> {
    let spare = all().get(1..).unwrap_or_default();
    (0..).map_while(move |i: usize| spare.get(i % spare.len().max(1)).copied())
}

/// Returns the cores of the main thread and of the pagers in the single-threaded model; `None` on a single core.
pub(super) fn single_threaded() -> Option<[CoreId; 2]> {
    all().first_chunk().copied()
}
