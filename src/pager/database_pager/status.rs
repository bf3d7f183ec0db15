//! Status for applications and the viewer: counters, errors, states of requests, and whether there is work.

use std::sync::Arc;

use super::DatabasePager;
use crate::cull::PageRequest;
use crate::fetch;
use crate::formats::Ignored;
use crate::pager::requests::entry::{Entry, Progress};
use crate::pager::requests::state::RequestState;
use crate::pager::scenes::scene_set::SceneSet;
use crate::pager::stats::{ErrorRecord, PagerStats};
use crate::scene::{NodeId, Scene, SharedStateManager};

impl DatabasePager {
    /// Returns the counters as of the last update.
    pub fn stats(&self) -> &PagerStats {
        &self.stats
    }

    /// Returns what the contents of all scenes asked for and their readers left out so far, counted by kind.
    pub fn ignored(&self) -> Ignored {
        self.scenes.ignored().snapshot()
    }

    /// Returns the counters of the cache on disk that the configuration names, if it names one.
    pub fn cache_stats(&self) -> Option<fetch::CacheStats> {
        #[cfg(feature = "http")]
        return self.scenes.own_client().cache().map(|cache| cache.stats());
        #[cfg(not(feature = "http"))]
        None
    }

    /// Returns the manager that makes equal contents one; `None` if nothing is shared.
    pub fn sharing(&self) -> Option<&Arc<SharedStateManager>> {
        self.scenes.sharing()
    }

    /// Resets the longest latency of [`PagerStats`], to measure a phase separately.
    pub fn reset_latency_max(&mut self) {
        self.stats.latency_max_s = 0.0;
    }

    /// Returns all failures so far, by URI and reason.
    pub fn errors(&self) -> Vec<ErrorRecord> {
        self.errors.list()
    }

    /// Returns how far the request for a slot's content is; `None` if it is merged or was not requested.
    pub fn request_state(&self, slot: NodeId) -> Option<RequestState> {
        self.table.get(slot).map(|entry| self.state(slot, entry))
    }

    /// Returns how far all requests are that are not merged, in no order. The stages of jobs that threads have are current.
    pub fn request_states(&self) -> impl Iterator<Item = (NodeId, RequestState)> + '_ {
        self.table.iter().map(|(slot, entry)| (slot, self.state(slot, entry)))
    }

    fn state(&self, slot: NodeId, entry: &Entry) -> RequestState {
        entry.state(self.arrivals.get(slot).is_some_and(|arrived| arrived.is_uploaded()))
    }

    /// Returns true when nothing waits, is read, decoded, uploaded or merged. Failures and prefetches do not count.
    pub fn is_idle(&self) -> bool {
        self.table.waiting().wanted_now() == 0 && self.table.begun().all(|(_, entry)| entry.is_prefetch())
    }

    /// Returns true if something will change without another request. What waits for room, or while the pager is paused,
    /// does not count. The blocking mode waits for this.
    pub(super) fn is_busy(&self) -> bool {
        let may_begin = !self.scheduler.shortage().is_full() && !self.control.is_paused;
        let room = self.residency.room(self.arrivals.total());
        let fits = |entry: &Entry| entry.known_size.is_none_or(|size| room.fits(size));
        let is_under_way = |(_, entry): (NodeId, &Entry)| !entry.is_prefetch();
        may_begin && self.table.waiting().has_any_that(fits) || self.table.begun().any(is_under_way)
    }

    /// Returns true if another update would do something for the scenes or for these requests: accept one, or continue.
    pub(crate) fn has_work<'a>(
        &self,
        scenes: &dyn SceneSet,
        mut requests: impl Iterator<Item = &'a PageRequest>,
    ) -> bool {
        let is_new = |request: &PageRequest| match self.table.get(request.slot) {
            Some(entry) => entry.progress == Progress::Retryable,
            None => self.control.takes_requests,
        };
        self.control.is_resumed || self.is_busy() || self.has_asked(scenes) || requests.any(is_new)
    }

    /// Returns true if a scene asks for slots to be filled that were not accepted yet.
    pub(crate) fn has_asked(&self, scenes: &dyn SceneSet) -> bool {
        self.control.takes_requests && scenes.all().any(Scene::has_asked)
    }

    /// Returns true if the back-off of a failure is over: after the next update it may be requested again.
    pub(crate) fn has_due(&self) -> bool {
        self.table.has_due()
    }

    /// Returns the number of frames in which the expiry search examines all pages when room is short.
    pub(crate) fn frames_to_look(&self) -> u32 {
        self.residency.frames_to_search()
    }

    /// Updates the counters that are states and not events.
    pub(super) fn count(&mut self) {
        let merged = self.residency.merged_bytes();
        let in_memory = self.residency.bytes_in_memory(self.arrivals.total());
        let saved = self.residency.saved_bytes();
        let mut s = self.stats;
        s.cpu_bytes = merged.cpu;
        s.cpu_bytes_peak = s.cpu_bytes_peak.max(s.cpu_bytes);
        s.gpu_bytes = merged.gpu;
        s.gpu_bytes_peak = s.gpu_bytes_peak.max(s.gpu_bytes);
        s.shared_cpu_bytes_saved = saved.cpu;
        s.shared_gpu_bytes_saved = saved.gpu;
        s.shared_gpu_bytes_saved_peak = s.shared_gpu_bytes_saved_peak.max(s.shared_gpu_bytes_saved);
        if let Some(sharing) = self.sharing() {
            s.sharing = sharing.stats();
        }
        s.root_bytes = self.residency.root_bytes();
        s.resident = self.residency.len() as u64;
        let loading = self.threads.budgets().total();
        (s.loading_bytes, s.loading_bytes_peak) = (loading.bytes, loading.peak);
        (s.loading_waits, s.loading_wait_s) = (loading.waits, loading.waited.as_secs_f64());
        s.gpu_bytes_unused = self.residency.unused_gpu();
        (s.cpu_bytes_held, s.gpu_bytes_held) = (in_memory.cpu, in_memory.gpu);
        (s.waiting, s.in_flight, s.decoding, s.compiling) = (self.table.waiting().len() as u64, 0, 0, 0);
        for (slot, entry) in self.table.begun() {
            s.in_flight += 1;
            match self.state(slot, entry) {
                RequestState::Decoding => s.decoding += 1,
                RequestState::Compiling | RequestState::Merging => s.compiling += 1,
                _ => {}
            }
        }
        self.stats = s;
    }
}
