//! Counters of the pager, each counted where the thing happens.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::io::{IoError, shown};
use crate::scene::SharingStats;

/// What the pager did since it started; main thread.
///
/// Every request ends in one way: after an update `requested + retried` is the sum of `merged`, `failed`, `cancelled`,
/// `stale`, `declined`, `dropped`, `waiting` and `in_flight`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PagerStats {
    /// Requests taken up.
    pub requested: u64,
    /// Contents read and decoded.
    pub loaded: u64,
    /// Pages merged into the scene.
    pub merged: u64,
    /// Those of them that were wanted only later.
    pub merged_ahead: u64,
    /// Pages taken out of the scene.
    pub expired: u64,
    /// Contents taken up again that failed, or found no room.
    pub retried: u64,
    /// Contents that could not be read or decoded, or that are beyond a whole budget.
    pub failed: u64,
    /// Drawables of merged pages that a context could not make.
    pub drawables_failed: u64,
    /// Running requests that were aborted because nobody wanted them any more.
    pub cancelled: u64,
    /// Requests dropped before they cost I/O.
    pub stale: u64,
    /// Loads put off because the budget was full of what is visible.
    pub declined: u64,
    /// Requests given up under way: their tileset expired, or contexts came or went and what was loaded is to be
    /// uploaded anew.
    pub dropped: u64,
    /// Bytes read from files and servers.
    pub bytes_read: u64,
    /// Those of them from servers.
    pub bytes_http: u64,
    /// CPU bytes of what was decoded.
    pub bytes_decoded: u64,
    /// CPU bytes of merged pages.
    pub cpu_bytes: u64,
    /// Most that `cpu_bytes` was.
    pub cpu_bytes_peak: u64,
    /// GPU bytes of merged pages.
    pub gpu_bytes: u64,
    /// Most that `gpu_bytes` was.
    pub gpu_bytes_peak: u64,
    /// CPU bytes of merged pages and of those that have arrived and wait for their uploads or their merge, without what is
    /// yet to be uploaded. Never beyond [`PagerConfig::max_bytes_cpu`](super::PagerConfig::max_bytes_cpu).
    pub cpu_bytes_held: u64,
    /// Most that `cpu_bytes_held` was once room was made for an arrival.
    pub cpu_bytes_held_peak: u64,
    /// GPU bytes of merged pages and of those that are uploaded and wait for their merge. Never beyond
    /// [`PagerConfig::max_bytes_gpu`](super::PagerConfig::max_bytes_gpu).
    pub gpu_bytes_held: u64,
    /// Most that `gpu_bytes_held` was once room was made for an upload.
    pub gpu_bytes_held_peak: u64,
    /// Most pages that were merged or had arrived; never beyond
    /// [`PagerConfig::max_tiles`](super::PagerConfig::max_tiles).
    pub held_peak: u64,
    /// Pages merged now.
    pub resident: u64,
    /// Requests waiting for I/O.
    pub waiting: u64,
    /// Requests being read, decoded or compiled.
    pub in_flight: u64,
    /// Those of them whose bytes are here and not decoded.
    pub decoding: u64,
    /// Those of them that are decoded and not merged.
    pub compiling: u64,
    /// Sum over merged pages of the seconds from request to merge.
    pub latency_sum_s: f64,
    /// Longest of them.
    pub latency_max_s: f64,
    /// Equal contents found, by kind.
    pub sharing: SharingStats,
    /// CPU bytes that merged pages would hold besides if each had its own; counted in no budget.
    pub shared_cpu_bytes_saved: u64,
    /// GPU bytes that merged pages would hold besides if each had its own.
    pub shared_gpu_bytes_saved: u64,
    /// Most that `shared_gpu_bytes_saved` was.
    pub shared_gpu_bytes_saved_peak: u64,
}

/// A failure, however often it happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ErrorRecord {
    /// What failed, as [`shown`] has it.
    pub uri: Arc<str>,
    /// Why.
    pub reason: Arc<str>,
    /// How often.
    pub count: u64,
}

/// Failures by URI and reason; at most [`Self::MAX`] different ones are kept, the rest is counted in one line.
#[derive(Debug, Default)]
pub(super) struct Errors {
    by_uri: BTreeMap<(Arc<str>, Arc<str>), u64>,
    others: u64,
}

impl Errors {
    const MAX: usize = 1000;

    pub fn add(&mut self, error: &IoError) {
        self.add_text(error.uri(), &error.reason());
    }

    pub fn add_text(&mut self, uri: &str, reason: &str) {
        let key = (Arc::from(&*shown(uri)), Arc::from(reason));
        if self.by_uri.len() >= Self::MAX && !self.by_uri.contains_key(&key) {
            self.others += 1;
            return;
        }
        *self.by_uri.entry(key).or_insert(0) += 1;
    }

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
