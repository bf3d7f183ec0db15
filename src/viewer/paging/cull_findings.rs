//! [`CullFindings`]: what the last frame's culls of a scene lacked, which its pager loads. Main thread.

use crate::cull::{CullCounters, PageRequest};

/// The results of the last frame's culls of a scene, over all cameras that saw it.
#[derive(Default)]
pub(in crate::viewer) struct CullFindings {
    /// Pages that the last frame lacked.
    requests: Vec<PageRequest>,
    /// Pages that cameras will need soon.
    prefetches: Vec<PageRequest>,
    /// Tiles that the last frame lacked.
    wanted_missing: u32,
    /// Tiles and Lods that the last frame showed between two levels of detail.
    fading: u32,
}

impl CullFindings {
    /// Forgets the last frame's requests; prefetches stay.
    pub(in crate::viewer) fn begin_cull(&mut self) {
        self.requests.clear();
        self.wanted_missing = 0;
    }

    /// Forgets the last frame, fades included.
    pub(in crate::viewer) fn begin_frame(&mut self) {
        self.begin_cull();
        self.fading = 0;
    }

    /// Adds what the cull of a camera found.
    pub(in crate::viewer) fn add(&mut self, requests: &[PageRequest], counters: &CullCounters) {
        self.requests.extend_from_slice(requests);
        self.wanted_missing += counters.wanted_missing;
        self.fading += counters.fading;
    }

    /// Adds what a cull of the blocking mode found. It advances no fade, so [`Self::is_fading`] stays as the frame's own
    /// cull leaves it.
    pub(in crate::viewer) fn add_blocking(&mut self, requests: &[PageRequest], counters: &CullCounters) {
        self.requests.extend_from_slice(requests);
        self.wanted_missing += counters.wanted_missing;
    }

    pub(in crate::viewer) fn requests(&self) -> &[PageRequest] {
        &self.requests
    }

    pub(in crate::viewer) fn prefetches(&self) -> &[PageRequest] {
        &self.prefetches
    }

    pub(in crate::viewer) fn clear_prefetches(&mut self) {
        self.prefetches.clear();
    }

    pub(in crate::viewer) fn add_prefetches(&mut self, requests: &[PageRequest]) {
        self.prefetches.extend_from_slice(requests);
    }

    /// Forgets all requests; counters stay until the next cull.
    pub(in crate::viewer) fn clear_requests(&mut self) {
        self.requests.clear();
        self.prefetches.clear();
    }

    /// Returns true if the last frame lacked no tile.
    pub(in crate::viewer) fn is_complete(&self) -> bool {
        self.wanted_missing == 0
    }

    /// Returns true while a transition between levels of detail is under way.
    pub(in crate::viewer) fn is_fading(&self) -> bool {
        self.fading > 0
    }
}
