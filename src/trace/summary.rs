//! [`TraceSummary`].

/// Summary of a written recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TraceSummary {
    /// Number of threads with at least one event.
    pub threads: usize,
    /// Number of spans.
    pub spans: u64,
    /// Number of requests.
    pub requests: u64,
    /// Number of events dropped because their thread already had about a million.
    pub lost: u64,
}
