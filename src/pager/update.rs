//! [`DatabasePager`]: the main thread's side, and its turn in a frame. Everything here runs in the update stage.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::config::{CompileContext, PagerConfig, PagerError};
use super::entry::{Entry, Progress};
use super::held::ArrivedSum;
use super::job::Above;
use super::requests::AheadShort;
use super::residents::Residents;
use super::scenes::{Scenes, Scope, Served, fitted};
use super::shares::{Held, Shares};
use super::states::RequestState;
use super::stats::{ErrorRecord, Errors, PagerStats};
use super::threads::Threads;
use super::turns::{LongWaits, Turns};
use crate::cull::PageRequest;
use crate::gpu::CompileBudget;
use crate::io::{self, ReadOptions};
use crate::scene::{NodeId, PageId, Scene, SceneNumber, SharedStateManager};

/// How often contexts are asked for what they uploaded, between frames.
const COMPILE_POLL: Duration = Duration::from_micros(200);
/// Kept free before the next frame is due: the longest single step, the upload of one slice or the merge of a page.
const WORK_MARGIN: Duration = Duration::from_micros(500);

/// Streams pages in and out of a [`Scene`], or of several ([`Self::add_scene`]): one list of requests,
/// one set of threads and one budget for all of them, and what is equal in any of them is there once.
pub struct DatabasePager {
    pub(super) config: PagerConfig,
    /// What it serves, and the scope that it was made with until a scene has it.
    pub(super) served: BTreeMap<SceneNumber, Served>,
    pub(super) unclaimed: Option<Served>,
    /// Scenes that are served no more: the unclaimed scope is not theirs.
    pub(super) removed: BTreeSet<SceneNumber>,
    /// The scene that has it.
    pub(super) first: Option<SceneNumber>,
    /// Which scene is to be loaded for next, and merged into.
    pub(super) turns: Turns,
    pub(super) merge_turns: Turns,
    pub(super) long_waits: LongWaits,
    /// Shared by all scenes.
    pub(super) sharing: Option<Arc<SharedStateManager>>,
    /// As the configuration has it.
    #[cfg(feature = "http")]
    pub(super) client: io::HttpClient,
    pub(super) threads: Threads,
    /// Requests that are not merged, by slot.
    pub(super) entries: HashMap<NodeId, Entry>,
    /// Slots to be filled whatever cameras see, until they are or it failed.
    pub(super) asked: Vec<NodeId>,
    /// Slots by ticket, for what contexts hand back.
    pub(super) compiling: HashMap<u64, NodeId>,
    /// Arrived, waiting for room to be uploaded; some may be gone.
    pub(super) uploads: Vec<NodeId>,
    /// Arrived and compiled, waiting to be merged.
    pub(super) ready: Vec<NodeId>,
    pub(super) residents: Residents,
    /// What has arrived and is not merged.
    pub(super) arrived: ArrivedSum,
    /// Pages that the next look for what may go takes in.
    pub(super) expiry_looks: usize,
    /// What pages share, counted once.
    pub(super) shares: Shares,
    /// What is above the contents of pages that are tilesets.
    pub(super) above: HashMap<PageId, Above>,
    pub(super) next_ticket: u64,
    pub(super) frame: u32,
    pub(super) stats: PagerStats,
    pub(super) errors: Errors,
    /// Mean sizes of the last pages, for reserving budget before a size is known; 0 before the first.
    pub(super) mean_cpu_bytes: u64,
    pub(super) mean_gpu_bytes: u64,
    /// The budget is full of what is visible.
    pub(super) full: bool,
    /// More waits than there is room for.
    pub(super) is_short: bool,
    /// From when on a page may be tried where none of the mean size has room, and how long the last wait was; frames.
    pub(super) try_room_frame: u32,
    pub(super) try_room_wait: u32,
    /// What the most urgent page needs that was loaded and found no room.
    pub(super) lacks: Option<Held>,
    /// How many are wanted in one of the next frames, and not there.
    pub(super) soon: u64,
    /// What is wanted soonest of what found no free room.
    pub(super) ahead_short: Option<AheadShort>,
    pub(super) is_paused: bool,
    pub(super) takes_requests: bool,
    /// It was told to go on since the last update.
    pub(super) goes_on: bool,
    /// [`Self::request`] has written the list, and nothing has changed what it is to be.
    pub(super) is_listed: bool,
}

impl DatabasePager {
    /// Starts the threads. `options` is the scope of the tile set that is paged: that of the first scene that the pager is
    /// given and that was not added. Others that were not added get nothing.
    pub fn new(config: PagerConfig, options: ReadOptions) -> Result<Self, PagerError> {
        let sharing = options.sharing.clone();
        let sharing =
            sharing.or_else(|| config.sharing.any().then(|| Arc::new(SharedStateManager::new(config.sharing))));
        let options = fitted(options, &config, sharing.clone());
        #[cfg(feature = "http")]
        let client = io::HttpClient::new(&config.http).map_err(PagerError::Http)?;
        let threads = Threads::start(&config, sharing.clone())?;
        #[cfg(feature = "http")]
        threads.list.lock().clients.push(client.clone());
        let scope = Scope {
            options,
            #[cfg(feature = "http")]
            client: client.clone(),
        };
        Ok(Self {
            config,
            served: BTreeMap::new(),
            unclaimed: Some(Served::new(scope)),
            removed: BTreeSet::new(),
            first: None,
            turns: Turns::default(),
            merge_turns: Turns::default(),
            long_waits: LongWaits::default(),
            sharing,
            #[cfg(feature = "http")]
            client,
            threads,
            entries: HashMap::new(),
            asked: Vec::new(),
            compiling: HashMap::new(),
            uploads: Vec::new(),
            ready: Vec::new(),
            residents: Residents::new(),
            arrived: ArrivedSum::default(),
            expiry_looks: 0,
            above: HashMap::new(),
            shares: Shares::default(),
            next_ticket: 1,
            frame: 0,
            stats: PagerStats::default(),
            errors: Errors::default(),
            mean_cpu_bytes: 0,
            mean_gpu_bytes: 0,
            full: false,
            is_short: false,
            try_room_frame: 0,
            try_room_wait: 0,
            lacks: None,
            soon: 0,
            ahead_short: None,
            is_paused: false,
            takes_requests: true,
            goes_on: false,
            is_listed: false,
        })
    }

    /// Counts its tickets on from another pager's, whose late answers then name none of its own.
    pub(crate) fn continue_from(&mut self, before: &Self) {
        self.next_ticket = self.next_ticket.max(before.next_ticket);
    }

    /// The pager's turn with all its scenes, once a frame: takes what was loaded and compiled, merges, expires, and
    /// rewrites the request list from `requests` (the last culls' outputs, all cameras and scenes together, whose frames
    /// are counted alike).
    pub fn update_scene_graph(
        &mut self,
        scenes: &mut dyn Scenes,
        frame: u32,
        requests: &[PageRequest],
        contexts: &mut [&mut dyn CompileContext],
    ) {
        self.frame = frame;
        self.goes_on = false;
        self.accept(scenes, requests);
        self.accept_asked(scenes);
        self.merge_arrived(scenes, contexts);
        self.retry(scenes);
        // As a rule the same is asked for as after the last cull, and listed as it is to be.
        if !self.is_listed || self.lacks.is_some() {
            self.rewrite_list();
        }
        self.is_listed = false;
        self.threads.list.ring_if_due();
        while self.config.blocking && self.is_busy() && contexts.iter().all(|context| context.is_alive()) {
            let answer = self.threads.answers.as_ref().and_then(|a| a.recv_timeout(Duration::from_millis(20)).ok());
            if let Some(answer) = answer {
                self.answer(scenes, answer, contexts);
            }
            self.merge_arrived(scenes, contexts);
            self.accept_asked(scenes);
            self.rewrite_list();
            self.threads.list.ring_if_due();
        }
        self.count();
    }

    /// Hands over what a cull asks for without waiting for the next update. The threads are told by the next
    /// [`Self::work_until`] (or update): telling one may take the frame longer than its cull. Optional, after a cull; the
    /// next [`Self::update_scene_graph`] may get the same requests again.
    pub fn request(&mut self, scenes: &dyn Scenes, requests: &[PageRequest]) {
        if self.accept(scenes, requests) {
            self.rewrite_list();
            self.is_listed = true;
        }
    }

    /// Takes what was loaded and compiled, merges and expires; may be called more than once a frame.
    pub fn merge_arrived(&mut self, scenes: &mut dyn Scenes, contexts: &mut [&mut dyn CompileContext]) {
        self.take_answers(scenes, contexts);
        self.take_compiled(scenes, contexts);
        self.begin_uploads(scenes, contexts);
        self.merge(scenes, contexts);
        self.expire(scenes, contexts);
        self.allow_more();
    }

    /// Uploads, merges and expires what arrives until shortly before `deadline`, for a main thread that would
    /// otherwise wait for the next frame to be due. Returns early when nothing is under way.
    pub fn work_until(&mut self, scenes: &mut dyn Scenes, contexts: &mut [&mut dyn CompileContext], deadline: Instant) {
        // What was listed since the last look may need room.
        self.expire(scenes, contexts);
        self.allow_more();
        let left = || deadline.saturating_duration_since(Instant::now()).saturating_sub(WORK_MARGIN);
        while self.is_under_way() && !left().is_zero() {
            let patience = match (self.ready.is_empty(), self.compiling.is_empty()) {
                // More is ready than one merge may take.
                (false, _) => Duration::ZERO,
                (true, false) => left().min(COMPILE_POLL),
                (true, true) => left(),
            };
            if let Some(answer) = self.threads.answers.as_ref().and_then(|a| a.recv_timeout(patience).ok()) {
                self.answer(scenes, answer, contexts);
            }
            self.take_answers(scenes, contexts);
            let time = left();
            for context in contexts.iter_mut() {
                context.run_compiles(&CompileBudget { time, bytes: u64::MAX });
            }
            self.merge_arrived(scenes, contexts);
            self.allow_more();
        }
        self.count();
    }

    /// Something is being read, decoded, uploaded or merged, or will be once a thread is free.
    fn is_under_way(&self) -> bool {
        if !self.compiling.is_empty() || !self.ready.is_empty() {
            return true;
        }
        self.threads.list.lock().is_under_way()
    }

    /// Lets the threads begin nothing while paused; what is under way goes on to its merge, and requests wait. From the
    /// next update on.
    pub fn set_paused(&mut self, is_paused: bool) {
        self.goes_on |= self.is_paused && !is_paused;
        self.is_paused = is_paused;
        self.is_listed = false;
    }

    /// Whether requests for contents that were not asked for before are taken up; those that were go on.
    pub fn set_takes_requests(&mut self, takes_requests: bool) {
        self.goes_on |= takes_requests && !self.takes_requests;
        self.takes_requests = takes_requests;
    }

    /// True when nothing is waiting, being read, decoded, compiled or merged. What failed does not count, nor what is
    /// wanted only later.
    pub fn is_idle(&self) -> bool {
        !self.entries.values().any(|e| !e.is_ahead() && !e.has_failed())
    }

    /// Counters up to the last update.
    pub fn stats(&self) -> &PagerStats {
        &self.stats
    }

    /// Counters of the cache on disk that the configuration names, where it names one.
    pub fn cache_stats(&self) -> Option<io::CacheStats> {
        #[cfg(feature = "http")]
        return self.client.cache().map(|cache| cache.stats());
        #[cfg(not(feature = "http"))]
        None
    }

    /// What makes equal contents one; `None` where nothing is shared.
    pub fn sharing(&self) -> Option<&Arc<SharedStateManager>> {
        self.sharing.as_ref()
    }

    /// Starts the longest latency of [`PagerStats`] anew, to measure a phase by itself.
    pub fn reset_latency_max(&mut self) {
        self.stats.latency_max_s = 0.0;
    }

    /// What failed so far, by URI and reason.
    pub fn errors(&self) -> Vec<ErrorRecord> {
        self.errors.list()
    }

    /// Something will change without another request: for the blocking mode. What waits while there is no room for it, or
    /// while the pager is paused, does not count.
    fn is_busy(&self) -> bool {
        let lets_begin = !self.full && !self.is_paused;
        self.entries.values().filter(|e| !e.is_ahead()).any(|e| match e.progress {
            Progress::Waiting => lets_begin && e.needs.is_none_or(|needs| self.fits(&needs)),
            Progress::Loading | Progress::Arrived(_) => true,
            Progress::Failed { .. } | Progress::Resting => false,
        })
    }

    /// Another update would do something for the scenes and those who ask for these: also take up one, or go on.
    pub(crate) fn has_work<'a>(
        &self,
        scenes: &dyn Scenes,
        mut requests: impl Iterator<Item = &'a PageRequest>,
    ) -> bool {
        let is_new = |request: &PageRequest| match self.entries.get(&request.slot) {
            Some(entry) => matches!(entry.progress, Progress::Resting),
            None => self.takes_requests,
        };
        self.goes_on || self.is_busy() || self.has_asked(scenes) || requests.any(is_new)
    }

    /// Slots are to be filled that were not taken up.
    pub(crate) fn has_asked(&self, scenes: &dyn Scenes) -> bool {
        self.takes_requests && scenes.all().any(Scene::has_asked)
    }

    pub(super) fn count(&mut self) {
        let (cpu_bytes, gpu_bytes, held) = (self.cpu_bytes(), self.gpu_bytes(), self.in_memory());
        let s = &mut self.stats;
        s.cpu_bytes = cpu_bytes;
        s.cpu_bytes_peak = s.cpu_bytes_peak.max(s.cpu_bytes);
        s.gpu_bytes = gpu_bytes;
        s.gpu_bytes_peak = s.gpu_bytes_peak.max(s.gpu_bytes);
        s.shared_cpu_bytes_saved = self.shares.saved.cpu;
        s.shared_gpu_bytes_saved = self.shares.saved.gpu;
        s.shared_gpu_bytes_saved_peak = s.shared_gpu_bytes_saved_peak.max(s.shared_gpu_bytes_saved);
        if let Some(sharing) = &self.sharing {
            s.sharing = sharing.stats();
        }
        s.resident = self.residents.len() as u64;
        (s.cpu_bytes_held, s.gpu_bytes_held) = (held.cpu, held.gpu);
        (s.waiting, s.in_flight, s.decoding, s.compiling) = (0, 0, 0, 0);
        for entry in self.entries.values() {
            match entry.progress {
                Progress::Waiting => s.waiting += 1,
                Progress::Loading | Progress::Arrived(_) => {
                    s.in_flight += 1;
                    match entry.state() {
                        RequestState::Decoding => s.decoding += 1,
                        RequestState::Compiling | RequestState::Merging => s.compiling += 1,
                        _ => {}
                    }
                }
                Progress::Failed { .. } | Progress::Resting => {}
            }
        }
    }
}
