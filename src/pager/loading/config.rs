//! Numbers of threads and of jobs under way, and what follows from them.

use crate::fetch::Limits;

/// This many servers may each have the start limit of requests in flight at once.
const SERVERS_AT_ONCE: usize = 4;

/// The maximum of requests in flight at one server: each has a slot in channels.
const MAX_IN_FLIGHT: usize = 4096;

/// Limits of one server's requests in flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::pager) struct LimitRange {
    /// The limit at the start, and the minimum while answers are only slow.
    pub start: usize,
    /// The maximum; has no effect where it is below `start`.
    pub max: usize,
}

impl LimitRange {
    /// Creates a range within the supported numbers.
    pub fn new(start: usize, max: usize) -> Self {
        Self { start: start.clamp(1, MAX_IN_FLIGHT), max: max.min(MAX_IN_FLIGHT) }
    }

    /// Returns the maximum of requests in flight to all servers together: several servers at their start, and one at its
    /// maximum.
    pub fn max_in_flight(self) -> usize {
        SERVERS_AT_ONCE * self.start + self.max.saturating_sub(self.start)
    }
}

/// Sizes of a set of loading threads.
#[derive(Clone, Copy, Debug)]
pub(in crate::pager) struct LoadConfig {
    /// Threads that read files; at least 1.
    pub readers: usize,
    /// Threads that decode; at least 1.
    pub decoders: usize,
    /// Files that may be outstanding: taken by a thread and not yet accepted by update.
    pub max_files: usize,
    /// Requests in flight at one server.
    pub per_server: LimitRange,
    /// Maximum bytes that are on their way; see [`LoadBudgets`](super::budgets::LoadBudgets).
    pub max_bytes: u64,
    /// True if decode threads wait for room for their contents. Not where update takes contents only once all have arrived.
    pub waits_for_contents: bool,
    /// Bounds on data from outside.
    pub limits: Limits,
}

impl LoadConfig {
    /// Returns the number of jobs that keep this many threads busy.
    pub fn busy_jobs(readers: usize, decoders: usize) -> usize {
        4 * readers + 2 * decoders
    }

    /// Returns the number of jobs that may be outstanding.
    pub fn capacity(&self) -> usize {
        let busy = Self::busy_jobs(self.readers, self.decoders);
        (self.per_server.max_in_flight() + busy).max(self.max_files)
    }
}
