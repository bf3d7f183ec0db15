//! Counters and failures of the pager. Each event is counted where it happens. Update thread.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::fetch::{IoError, shown};
use crate::scene::SharingStats;

/// Counters since the pager started; main thread. There is a field for each event and each state, as the report has them.
///
/// Every request ends in one way: after an update `requested + retried` is the sum of `merged`, `failed`, `cancelled`,
/// `stale`, `declined`, `dropped`, `waiting` and `in_flight`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PagerStats {
    /// Requests accepted.
    pub requested: u64,
    /// Contents read and decoded.
    pub loaded: u64,
    /// Pages merged into their scenes.
    pub merged: u64,
    /// Prefetched pages among `merged`.
    pub merged_ahead: u64,
    /// Pages detached from their scenes.
    pub expired: u64,
    /// Contents requested again after a failure or after they had no room.
    pub retried: u64,
    /// Contents that could not be read or decoded, or that exceed a budget alone.
    pub failed: u64,
    /// Drawables of loaded pages that a context could not upload.
    pub drawables_failed: u64,
    /// Running requests aborted because their contents were no longer wanted.
    pub cancelled: u64,
    /// Requests dropped before they cost I/O.
    pub stale: u64,
    /// Loaded pages that had no room because the budgets were full of what is visible.
    pub declined: u64,
    /// Requests given up while under way: their tileset expired, or contexts were added or closed and the page must be
    /// uploaded again.
    pub dropped: u64,
    /// Bytes read from files and servers.
    pub bytes_read: u64,
    /// Bytes transferred from servers.
    pub bytes_http: u64,
    /// CPU bytes of decoded pages.
    pub bytes_decoded: u64,
    /// CPU bytes of merged pages.
    pub cpu_bytes: u64,
    /// Maximum of `cpu_bytes`.
    pub cpu_bytes_peak: u64,
    /// GPU bytes of merged pages.
    pub gpu_bytes: u64,
    /// Maximum of `gpu_bytes`.
    pub gpu_bytes_peak: u64,
    /// CPU bytes of merged pages and of those that wait for their uploads or their merge, without what is yet to be
    /// uploaded. Never exceeds [`PagerConfig::max_bytes_cpu`](super::PagerConfig::max_bytes_cpu).
    pub cpu_bytes_held: u64,
    /// CPU bytes of the tile trees of roots. They count in [`PagerConfig::max_bytes_cpu`](super::PagerConfig::max_bytes_cpu), up
    /// to half of it, beside `cpu_bytes_held`.
    pub root_bytes: u64,
    /// Maximum of `cpu_bytes_held`, measured after room was made for an arrival.
    pub cpu_bytes_held_peak: u64,
    /// GPU bytes of merged pages and of those that are uploaded and wait for their merge. Never exceeds
    /// [`PagerConfig::max_bytes_gpu`](super::PagerConfig::max_bytes_gpu).
    pub gpu_bytes_held: u64,
    /// Bytes of GPU memory that the contexts have allocated beyond what is in use, after their last uploads: free slots of
    /// blocks, and blocks that are being replaced by larger ones. Textures of state sets count here.
    pub gpu_bytes_unused: u64,
    /// Maximum of `gpu_bytes_held`, measured after room was made for an upload.
    pub gpu_bytes_held_peak: u64,
    /// CPU bytes on their way: read and not decoded, or decoded and not merged. Exceeds
    /// [`PagerConfig::max_bytes_loading`](super::PagerConfig::max_bytes_loading) only by what is larger than was expected.
    pub loading_bytes: u64,
    /// Maximum of `loading_bytes`, or slightly more.
    pub loading_bytes_peak: u64,
    /// Times that a load waited until bytes were free.
    pub loading_waits: u64,
    /// Sum of these waits, seconds.
    pub loading_wait_s: f64,
    /// Maximum number of pages merged or arrived; never exceeds
    /// [`PagerConfig::max_tiles`](super::PagerConfig::max_tiles).
    pub held_peak: u64,
    /// Pages merged now.
    pub resident: u64,
    /// Requests waiting for I/O.
    pub waiting: u64,
    /// Requests being read, decoded, uploaded or merged.
    pub in_flight: u64,
    /// Requests in flight whose bytes were read and are not decoded.
    pub decoding: u64,
    /// Requests in flight that are decoded and not merged.
    pub compiling: u64,
    /// Sum over merged pages of the seconds from request to merge.
    pub latency_sum_s: f64,
    /// Longest time from request to merge, seconds.
    pub latency_max_s: f64,
    /// Equal contents found, by kind.
    pub sharing: SharingStats,
    /// Additional CPU bytes that merged pages would hold if each had its own copy; counted in no budget.
    pub shared_cpu_bytes_saved: u64,
    /// Additional GPU bytes that merged pages would hold if each had its own copy.
    pub shared_gpu_bytes_saved: u64,
    /// Maximum of `shared_gpu_bytes_saved`.
    pub shared_gpu_bytes_saved_peak: u64,
}

impl PagerStats {
    /// Updates the maxima of memory and pages, after room was made.
    pub(super) fn note_memory(&mut self, cpu_bytes: u64, gpu_bytes: u64, pages: u64) {
        self.cpu_bytes_held_peak = self.cpu_bytes_held_peak.max(cpu_bytes);
        self.gpu_bytes_held_peak = self.gpu_bytes_held_peak.max(gpu_bytes);
        self.held_peak = self.held_peak.max(pages);
    }
}

/// A failure by URI and reason, and how often it happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ErrorRecord {
    /// The URI that failed, without credentials; see [`shown`].
    pub uri: Arc<str>,
    /// The reason.
    pub reason: Arc<str>,
    /// The number of times it happened.
    pub count: u64,
}

/// Failures by URI and reason; at most [`Self::MAX`] different ones are kept, further ones are counted together.
#[derive(Debug, Default)]
pub(super) struct Errors {
    by_uri: BTreeMap<(Arc<str>, Arc<str>), u64>,
    others: u64,
}

impl Errors {
    const MAX: usize = 1000;

    /// Counts an error.
    pub fn add(&mut self, error: &IoError) {
        self.add_text(error.uri(), &error.reason());
    }

    /// Counts an error by its URI and reason.
    pub fn add_text(&mut self, uri: &str, reason: &str) {
        let key = (Arc::from(&*shown(uri)), Arc::from(reason));
        if self.by_uri.len() >= Self::MAX && !self.by_uri.contains_key(&key) {
            self.others += 1;
            return;
        }
        *self.by_uri.entry(key).or_insert(0) += 1;
    }

    /// Returns all failures, by URI and reason.
    pub fn list(&self) -> Vec<ErrorRecord> {
        let mut list: Vec<ErrorRecord> = self
            .by_uri
            .iter()
            .map(|((uri, reason), count)| ErrorRecord { uri: uri.clone(), reason: reason.clone(), count: *count })
            .collect();
        if self.others > 0 {
            list.push(ErrorRecord { uri: "".into(), reason: "further errors".into(), count: self.others });
        }
        list
    }
}
