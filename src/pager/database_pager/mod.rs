//! [`DatabasePager`]: the parts of the pager, and its turn in a frame. Everything here runs on the update thread.
//!
//! The parts keep their fields private. The methods in this folder pass results from one part to the next:
//!
//! | file | step |
//! |---|---|
//! | `accept` | requests of culls go into the table |
//! | `arrive` | answers of threads and contexts go into the arrivals |
//! | `make_room` | uploads begin, pages expire and arrivals without room are declined |
//! | `merge` | uploaded pages are attached to their scenes |
//! | `remove` | pages and requests of a scene or of a context are dropped |
//! | `serve` | scenes are added and removed, and roots are read |
//! | `status` | counters, errors, states of requests, and whether there is work |

mod accept;
mod arrive;
mod blocking;
mod make_room;
mod merge;
mod refresh;
mod remove;
mod serve;
mod status;

use std::sync::Arc;
use std::time::{Duration, Instant};

use self::refresh::Outdated;
use super::config::{PagerConfig, PagerError};
use super::frame_times::FrameTimes;
use super::loading::config::{LimitRange, LoadConfig};
use super::loading::page_job::PageJob;
use super::loading::reaper::Reaper;
use super::loading::threads::LoadThreads;
use super::requests::forced::ForcedSlots;
use super::requests::scheduler::{Conditions, Scheduler};
use super::requests::table::RequestTable;
use super::residency::Residency;
use super::residency::budget::Budget;
use super::scenes::registry::SceneRegistry;
use super::scenes::scene_set::SceneSet;
use super::stats::{Errors, PagerStats};
use super::time_budget::{TimeBudget, WorkClock};
use super::upload::Arrivals;
use super::upload::context::CompileContext;
use super::upload::merge_order::MergeOrder;
use crate::cull::PageRequest;
#[cfg(feature = "http")]
use crate::fetch;
use crate::fetch::LoadRoom;
use crate::formats::ReadOptions;
use crate::gpu::CompileBudget;
use crate::scene::{BlockFormats, SharedStateManager};

/// How often contexts are polled for finished uploads, between frames.
const COMPILE_POLL: Duration = Duration::from_micros(200);
/// Time kept free before a deadline: the longest single step, the upload of one slice or the merge of a page.
const WORK_MARGIN: Duration = Duration::from_micros(500);
/// The tenths of an update's time at which each step for what has arrived ends. A step uses what those before it have left, and
/// does at least one item. No step can take all: a burst of answers keeps no page from its merge.
const ANSWERS_END: u32 = 3;
const UPLOADED_END: u32 = 5;
const BEGIN_UPLOADS_END: u32 = 7;
const MERGES_END: u32 = 9;
const EXPIRY_END: u32 = 10;
/// The frame for which the time of an update is configured. In longer frames, up to this many times, the time grows with them:
/// otherwise slow frames would load few pages.
const BUDGETED_FRAME: Duration = Duration::from_nanos(1_000_000_000 / 60);
const MAX_BUDGET_GROWTH: f64 = 8.0;
/// Decoded pages that may wait for the update thread while files are read, per decode thread: as many as are accepted in
/// a frame of 1/60 s.
const DECODED_AHEAD: usize = 12;

/// Streams pages in and out of a [`Scene`](crate::scene::Scene), or of several ([`Self::add_scene`]). All scenes share one
/// request list, one set of threads, one budget and their equal contents.
///
/// Its methods are called by one thread, that of update: a viewer calls them in its frame. Its own threads read and decode; they end
/// when it is dropped. A load that fails is no error of a call, but one of [`Self::errors`].
pub struct DatabasePager {
    config: PagerConfig,
    scenes: SceneRegistry,
    table: RequestTable,
    forced: ForcedSlots,
    scheduler: Scheduler,
    threads: LoadThreads<PageJob>,
    reaper: Reaper,
    arrivals: Arrivals,
    merge_order: MergeOrder,
    residency: Residency,
    /// Pages that were loaded before the overlays of their scene changed.
    outdated: Outdated,
    stats: PagerStats,
    errors: Errors,
    control: Control,
    clock: WorkClock,
}

/// Switches that the application sets, and the state of the frame.
#[derive(Debug)]
struct Control {
    /// The times of frames, the current one last.
    times: FrameTimes,
    is_paused: bool,
    takes_requests: bool,
    /// True if it was resumed since the last update.
    is_resumed: bool,
    /// True if tiles were merged since requests were last accepted, so that a cull may want contents that none has seen.
    has_new_tiles: bool,
}

impl DatabasePager {
    /// Starts the threads. `options` describes the initial read scope: it belongs to the first scene that the pager is
    /// given and that was not added by [`Self::add_scene`]. Other scenes that were not added get nothing.
    ///
    /// # Errors
    /// [`PagerError`] if a thread or the HTTP client cannot be started.
    pub fn new(config: PagerConfig, options: ReadOptions) -> Result<Self, PagerError> {
        let sharing = options.sharing.clone();
        let sharing =
            sharing.or_else(|| config.sharing.any().then(|| Arc::new(SharedStateManager::new(config.sharing))));
        #[cfg(feature = "http")]
        let client = fetch::HttpClient::new(&config.http).map_err(PagerError::Http)?;
        let (readers, decoders) = (config.file_threads.max(1), config.decode_threads.max(1));
        let threads = LoadThreads::start(&LoadConfig {
            readers,
            decoders,
            max_files: LoadConfig::busy_jobs(readers, decoders) + DECODED_AHEAD * decoders,
            per_server: LimitRange::new(config.http_in_flight, config.http_in_flight_max),
            max_bytes: config.max_bytes_loading,
            waits_for_contents: !config.blocking,
            limits: config.limits,
        })?;
        let reaper = match config.blocking {
            true => Reaper::here(sharing.clone()),
            false => Reaper::start(sharing.clone())?,
        };
        #[cfg(feature = "http")]
        if let Some(http) = threads.http() {
            http.add_client(client.clone());
        }
        let scenes = SceneRegistry::new(
            &config,
            options,
            sharing,
            #[cfg(feature = "http")]
            client,
        );
        Ok(Self {
            scenes,
            table: RequestTable::new(),
            forced: ForcedSlots::default(),
            scheduler: Scheduler::default(),
            threads,
            reaper,
            arrivals: Arrivals::default(),
            merge_order: MergeOrder::default(),
            residency: Residency::new(Budget::new(&config)),
            outdated: Outdated::default(),
            stats: PagerStats::default(),
            errors: Errors::default(),
            control: Control {
                times: FrameTimes::default(),
                is_paused: false,
                takes_requests: true,
                is_resumed: false,
                // The tiles of the root.
                has_new_tiles: true,
            },
            clock: WorkClock::default(),
            config,
        })
    }

    /// Issues ticket numbers after those of another pager, whose late answers then match none of this pager's.
    pub(crate) fn continue_from(&mut self, before: &Self) {
        self.table.continue_from(&before.table);
    }

    /// Replaces the clock of the time budgets: it returns the time since an arbitrary moment.
    #[cfg(feature = "testing")]
    pub fn set_work_clock(&mut self, clock: impl Fn() -> Duration + Send + Sync + 'static) {
        self.clock = WorkClock::new(clock);
    }

    /// Returns a budget of this much time in a frame of 60 Hz from now on. The blocking mode has none, so that equal flights give
    /// equal tiles.
    fn budget(&self, time: Duration) -> TimeBudget {
        let times = &self.control.times;
        let frame = times.distance(times.frame().saturating_sub(1));
        let growth = frame.div_duration_f64(BUDGETED_FRAME).clamp(1.0, MAX_BUDGET_GROWTH);
        let time = Duration::try_from_secs_f64(time.as_secs_f64() * growth).unwrap_or(Duration::MAX);
        self.clock.budget((!self.config.blocking).then_some(time))
    }

    /// Returns the budget of the steps for what has arrived, from now on.
    fn update_budget(&self) -> TimeBudget {
        self.budget(self.config.update_time)
    }

    /// Runs the pager's turn with all its scenes, once a frame. `time_s` is the reference time of the frame in seconds, by
    /// which pages expire. `requests` are the last culls' requests, all cameras and scenes together; all scenes count frames
    /// alike.
    ///
    /// The cost follows the requests, what has arrived since the last update within [`PagerConfig::update_time`], and the number
    /// of loads under way; neither the waiting requests nor the resident pages.
    pub fn update_scene_graph(
        &mut self,
        scenes: &mut dyn SceneSet,
        frame: u32,
        time_s: f64,
        requests: &[PageRequest],
        contexts: &mut [&mut dyn CompileContext],
    ) {
        self.begin_frame(frame, time_s);
        self.note_formats(contexts);
        self.residency.count_roots(scenes, Budget::new(&self.config));
        self.accept(scenes, requests);
        self.accept_forced(scenes);
        self.refresh(scenes, contexts);
        self.merge_arrived(scenes, contexts);
        self.retry_failures(scenes);
        self.write_list();
        self.threads.list().ring_if_due();
        if self.config.blocking {
            self.load_all(scenes, contexts);
        }
        self.count();
    }

    /// Decodes contents from now on to the compressed formats that all contexts sample; to none without contexts.
    fn note_formats(&self, contexts: &[&mut dyn CompileContext]) {
        let common = contexts.iter().map(|context| context.block_formats()).reduce(BlockFormats::intersection);
        self.scenes.block_formats().set(common.unwrap_or_default());
    }

    fn begin_frame(&mut self, frame: u32, time_s: f64) {
        self.control.times.begin(frame, time_s);
        self.control.is_resumed = false;
    }

    /// Accepts a cull's requests without waiting for the next update. The threads are woken by the next
    /// [`Self::work_until`] or update, because waking one may take longer than the frame's cull. Optional, after a cull;
    /// the next [`Self::update_scene_graph`] may get the same requests again.
    pub fn request(&mut self, scenes: &dyn SceneSet, requests: &[PageRequest]) {
        self.control.has_new_tiles = false;
        if self.accept(scenes, requests) {
            self.write_list();
        }
    }

    /// Returns true if tiles were merged since the last [`Self::request`]: a cull may find contents in them to request.
    pub fn has_new_tiles(&self) -> bool {
        self.control.has_new_tiles
    }

    /// Accepts the requests of a cull as [`Self::request`] does, and wakes the threads.
    pub fn request_now(&mut self, scenes: &dyn SceneSet, requests: &[PageRequest]) {
        self.request(scenes, requests);
        self.threads.list().ring_if_due();
    }

    /// Takes what was loaded and uploaded, merges and expires. May be called more than once a frame.
    pub fn merge_arrived(&mut self, scenes: &mut dyn SceneSet, contexts: &mut [&mut dyn CompileContext]) {
        let budget = self.update_budget();
        self.take_answers(scenes, contexts, &budget);
        self.take_compiled(scenes, contexts, &budget);
        self.begin_uploads(scenes, contexts, &budget);
        self.merge(scenes, contexts, &budget);
        self.expire(scenes, contexts, &budget);
        // In the blocking mode threads take only from a list that was just written.
        if !self.config.blocking {
            self.update_limits();
        }
    }

    /// Uploads, merges and expires until shortly before `deadline`, for a main thread that would otherwise wait for the
    /// next frame. Returns early when nothing is under way.
    pub fn work_until(
        &mut self,
        scenes: &mut dyn SceneSet,
        contexts: &mut [&mut dyn CompileContext],
        deadline: Instant,
    ) {
        self.work_while(scenes, contexts, deadline, |_| true);
    }

    /// Works as [`Self::work_until`] does until there are new tiles ([`Self::has_new_tiles`]).
    pub fn work_until_new_tiles(
        &mut self,
        scenes: &mut dyn SceneSet,
        contexts: &mut [&mut dyn CompileContext],
        deadline: Instant,
    ) {
        self.work_while(scenes, contexts, deadline, |pager| !pager.has_new_tiles());
    }

    fn work_while(
        &mut self,
        scenes: &mut dyn SceneSet,
        contexts: &mut [&mut dyn CompileContext],
        deadline: Instant,
        goes_on: impl Fn(&Self) -> bool,
    ) {
        // Requests since the last expiry may need room.
        self.expire(scenes, contexts, &self.update_budget());
        self.update_limits();
        let left = || deadline.saturating_duration_since(Instant::now()).saturating_sub(WORK_MARGIN);
        let mut uploading = 0;
        while goes_on(self) && self.is_under_way() && !left().is_zero() {
            // A context without a thread of its own uploads what has begun in this turn, not after a wait for an answer.
            let has_begun = std::mem::replace(&mut uploading, self.arrivals.total().uploading) < uploading;
            let is_ready = has_begun || self.arrivals.has_ready() || self.arrivals.has_finished();
            let timeout = match (is_ready, self.arrivals.has_uploads()) {
                // More pages are ready than one turn may take.
                (true, _) => Duration::ZERO,
                (false, true) => left().min(COMPILE_POLL),
                (false, false) => left(),
            };
            self.wait_for_answer(scenes, contexts, timeout);
            let time = left();
            for context in contexts.iter_mut() {
                context.run_compiles(&CompileBudget { time, bytes: u64::MAX });
            }
            self.merge_arrived(scenes, contexts);
        }
        self.count();
    }

    /// Returns true if something is being read, decoded, uploaded or merged, or will be once a thread is free.
    fn is_under_way(&self) -> bool {
        self.arrivals.has_uploads() || self.arrivals.has_ready() || self.threads.list().lock().is_under_way()
    }

    /// Stops the threads from beginning anything, from the next update on. What is under way is still merged, and requests
    /// wait.
    pub fn set_paused(&mut self, is_paused: bool) {
        self.control.is_resumed |= self.control.is_paused && !is_paused;
        self.control.is_paused = is_paused;
    }

    /// Pins the loading threads to a core, each before its next job; OSG's `setProcessorAffinity`. Cores are numbered as the
    /// system does. Does nothing where it does not support that.
    pub fn set_processor_affinity(&mut self, core: usize) {
        self.threads.set_core(core);
    }

    /// Sets whether requests for contents that were not requested before are accepted; known requests continue.
    pub fn set_takes_requests(&mut self, takes_requests: bool) {
        self.control.is_resumed |= takes_requests && !self.control.takes_requests;
        self.control.takes_requests = takes_requests;
    }

    /// Tells the request list what has changed; wakes no thread.
    fn write_list(&mut self) {
        let conditions = conditions(&self.config, &self.control, &self.arrivals, &self.residency, &self.threads);
        let list = self.threads.list();
        self.stats.stale += self.scheduler.write_list(&mut self.table, list, &conditions);
    }

    /// Lets the threads continue if there is more room than when the list was written.
    fn update_limits(&self) {
        let conditions = conditions(&self.config, &self.control, &self.arrivals, &self.residency, &self.threads);
        self.scheduler.update_limits(self.threads.list(), &conditions);
    }
}

/// Collects what the request list depends on.
fn conditions<'a>(
    config: &'a PagerConfig,
    control: &'a Control,
    arrivals: &Arrivals,
    residency: &Residency,
    threads: &LoadThreads<PageJob>,
) -> Conditions<'a> {
    Conditions {
        config,
        times: &control.times,
        is_paused: control.is_paused,
        room: residency.room(arrivals.total()),
        // In the blocking mode loads wait for their bytes, which depend on timing, in the threads alone.
        load_room: if config.blocking { LoadRoom::UNLIMITED } else { threads.budgets().bodies.room() },
        arrived_pages: arrivals.total().pages,
        arrived_prefetches: arrivals.prefetches(),
    }
}
