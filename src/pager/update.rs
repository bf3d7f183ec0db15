//! [`DatabasePager`]: the main thread's side. Everything here runs in the update stage.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::config::{CompileContext, PagerConfig, PagerError};
use super::list::{Above, Answer, Arrived, Entry, Job, Progress};
use super::residents::{Resident, Residents, Unused};
use super::shares::Shares;
use super::stats::{ErrorRecord, Errors, PagerStats};
use super::threads::Threads;
use crate::cull::PageRequest;
use crate::gpu::{CompileBudget, CompileOperation};
use crate::io::{self, Content, IoError, ReadOptions};
use crate::scene::{DrawKind, NodeId, Page, PageId, PagingOptions, Scene, SharedStateManager, SlotState};
use crate::timeline;

/// Pages looked at for expiry in one frame while under the byte and tile limits' pressure.
const EXPIRY_LOOKS: usize = 256;
/// Tenths of each budget that are kept free of what was not wanted for long.
const EXPIRY_TENTHS: u64 = 1;
/// Tenths of each budget that must be free before anything is loaded that is wanted only later. More than expiry makes
/// free, so that nothing goes for it and comes again.
const AHEAD_TENTHS: u64 = 2;
/// How often contexts are asked for what they uploaded, between frames.
const COMPILE_POLL: Duration = Duration::from_micros(200);
/// Decoded pages may hold about so many bytes while they wait for their upload; beyond that nothing is loaded.
const MOST_PENDING_BYTES: u64 = 24 << 20;
/// Kept free before the next frame is due: the longest single step, the upload of one slice or the merge of a page.
const WORK_MARGIN: Duration = Duration::from_micros(500);

/// Streams pages in and out of a [`Scene`].
pub struct DatabasePager {
    config: PagerConfig,
    options: ReadOptions,
    threads: Threads,
    /// Requests that are not merged, by slot.
    entries: HashMap<NodeId, Entry>,
    /// Slots by ticket, for what contexts hand back.
    compiling: HashMap<u64, NodeId>,
    /// Arrived and compiled, waiting to be merged.
    ready: Vec<NodeId>,
    residents: Residents,
    /// What pages share, counted once.
    shares: Shares,
    /// What is above the contents of pages that are tilesets; roots have `above_roots`.
    above: HashMap<PageId, Above>,
    above_roots: Above,
    next_ticket: u64,
    frame: u32,
    stats: PagerStats,
    errors: Errors,
    /// Mean sizes of the last pages, for reserving budget before a size is known; 0 before the first.
    mean_cpu_bytes: u64,
    mean_gpu_bytes: u64,
    /// The scene's budget is full of what is visible.
    full: bool,
    is_paused: bool,
    takes_requests: bool,
}

impl DatabasePager {
    /// Starts the threads. `options` is the scope of the tile set that is paged.
    pub fn new(config: PagerConfig, options: ReadOptions) -> Result<Self, PagerError> {
        let build_kd_trees = config.build_kd_trees || options.build_kd_trees;
        let sharing = options.sharing.clone();
        let sharing =
            sharing.or_else(|| config.sharing.any().then(|| Arc::new(SharedStateManager::new(config.sharing))));
        let options = ReadOptions { limits: config.limits, build_kd_trees, sharing, ..options };
        let threads = Threads::start(&config, &options)?;
        Ok(Self {
            above_roots: Above { chain: options.chain.clone(), set_from_page: options.set_from_content },
            config,
            options,
            threads,
            entries: HashMap::new(),
            compiling: HashMap::new(),
            ready: Vec::new(),
            residents: Residents::new(),
            above: HashMap::new(),
            shares: Shares::default(),
            next_ticket: 1,
            frame: 0,
            stats: PagerStats::default(),
            errors: Errors::default(),
            mean_cpu_bytes: 0,
            mean_gpu_bytes: 0,
            full: false,
            is_paused: false,
            takes_requests: true,
        })
    }

    /// Reads a root tileset (or a single content) on the calling thread.
    pub fn read_root(&mut self, uri: &Arc<str>) -> Result<Page, IoError> {
        let bytes = self.fetch(uri)?;
        self.stats.bytes_read += bytes.len() as u64;
        let content = Content { uri: uri.clone(), bytes, reader_data: None, companions: Vec::new() };
        // A root is the application's.
        let page = io::decode(content, &ReadOptions { sharing: None, ..self.options.clone() })?;
        self.above_roots.chain = self.options.below(uri).chain;
        Ok(page)
    }

    fn fetch(&mut self, uri: &str) -> Result<Vec<u8>, IoError> {
        #[cfg(feature = "http")]
        if let Some(door) = self.threads.door.as_ref().filter(|_| io::is_http(uri)) {
            let body = door.get(uri, &self.config.limits)?;
            self.stats.bytes_http += body.network_bytes;
            return Ok(body.bytes);
        }
        io::Source::new(self.config.limits).read(uri)
    }

    /// The pager's turn with the scene, once a frame: takes what was loaded and compiled, merges, expires, and
    /// rewrites the request list from `requests` (the last culls' outputs, all cameras together).
    pub fn update_scene_graph(
        &mut self,
        scene: &mut Scene,
        frame: u32,
        requests: &[PageRequest],
        contexts: &mut [&mut dyn CompileContext],
    ) {
        self.frame = frame;
        self.accept(scene, requests);
        self.merge_arrived(scene, contexts);
        self.retry(scene);
        self.rewrite_list();
        while self.config.blocking && self.is_busy() {
            let answer = self.threads.answers.as_ref().and_then(|a| a.recv_timeout(Duration::from_millis(20)).ok());
            if let Some(answer) = answer {
                self.answer(scene, answer, contexts);
            }
            self.merge_arrived(scene, contexts);
            self.rewrite_list();
        }
        self.count();
    }

    /// Hands over what a cull asks for without waiting for the next update: reading overlaps the rest of the frame.
    /// Optional, after a cull; the next [`Self::update_scene_graph`] may get the same requests again.
    pub fn request(&mut self, scene: &Scene, requests: &[PageRequest]) {
        if !requests.is_empty() {
            self.accept(scene, requests);
            self.rewrite_list();
        }
    }

    /// Takes what was loaded and compiled, merges and expires; may be called more than once a frame.
    pub fn merge_arrived(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        self.take_answers(scene, contexts);
        self.take_compiled(contexts);
        self.merge(scene, contexts);
        self.expire(scene, contexts);
        self.allow_more();
    }

    /// Lets the threads go on when there is more room than the list last said.
    fn allow_more(&self) {
        let allowed = self.allowed_in_flight(self.threads.list.capacity);
        let mut waiting = self.threads.list.lock();
        waiting.allowed = allowed;
        let go_on = waiting.outstanding < allowed && waiting.len() > 0;
        drop(waiting);
        if go_on {
            self.threads.list.ring();
        }
    }

    /// Uploads, merges and expires what arrives until shortly before `deadline`, for a main thread that would
    /// otherwise wait for the next frame to be due. Returns early when nothing is under way.
    pub fn work_until(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext], deadline: Instant) {
        let left = || deadline.saturating_duration_since(Instant::now()).saturating_sub(WORK_MARGIN);
        while self.is_under_way() && !left().is_zero() {
            let patience = match (self.ready.is_empty(), self.compiling.is_empty()) {
                // More is ready than one merge may take.
                (false, _) => Duration::ZERO,
                (true, false) => left().min(COMPILE_POLL),
                (true, true) => left(),
            };
            if let Some(answer) = self.threads.answers.as_ref().and_then(|a| a.recv_timeout(patience).ok()) {
                self.answer(scene, answer, contexts);
            }
            self.take_answers(scene, contexts);
            let time = left();
            for context in contexts.iter_mut() {
                context.run_compiles(&CompileBudget { time, bytes: u64::MAX });
            }
            self.merge_arrived(scene, contexts);
        }
        self.count();
    }

    /// Something is being read, decoded, uploaded or merged, or will be once a thread is free.
    fn is_under_way(&self) -> bool {
        if !self.compiling.is_empty() || !self.ready.is_empty() {
            return true;
        }
        let waiting = self.threads.list.lock();
        waiting.outstanding > 0 || (waiting.allowed > 0 && waiting.len() > 0)
    }

    /// Lets the threads begin nothing while paused; what is under way goes on to its merge, and requests wait. From the
    /// next update on.
    pub fn set_paused(&mut self, is_paused: bool) {
        self.is_paused = is_paused;
    }

    /// Whether requests for contents that were not asked for before are taken up; those that were go on.
    pub fn set_takes_requests(&mut self, takes_requests: bool) {
        self.takes_requests = takes_requests;
    }

    /// True when nothing is waiting, being read, decoded, compiled or merged. What failed does not count, nor what is
    /// wanted only later.
    pub fn is_idle(&self) -> bool {
        !self.entries.values().any(|e| !e.is_ahead() && !matches!(e.progress, Progress::Failed { .. }))
    }

    /// Counters up to the last update.
    pub fn stats(&self) -> &PagerStats {
        &self.stats
    }

    /// Counters of the cache on disk, where there is one.
    pub fn cache_stats(&self) -> Option<io::CacheStats> {
        #[cfg(feature = "http")]
        return self.threads.door.as_ref()?.client.cache().map(|cache| cache.stats());
        #[cfg(not(feature = "http"))]
        None
    }

    /// What makes equal contents one; `None` where nothing is shared.
    pub fn sharing(&self) -> Option<&Arc<SharedStateManager>> {
        self.options.sharing.as_ref()
    }

    /// Starts the longest latency of [`PagerStats`] anew, to measure a phase by itself.
    pub fn reset_latency_max(&mut self) {
        self.stats.latency_max_s = 0.0;
    }

    /// What failed so far, by URI and reason.
    pub fn errors(&self) -> Vec<ErrorRecord> {
        self.errors.list()
    }

    /// Something will change without another request: for the blocking mode.
    fn is_busy(&self) -> bool {
        self.entries.values().filter(|e| !e.is_ahead()).any(|e| match e.progress {
            Progress::Waiting => !self.full,
            Progress::Loading | Progress::Arrived(_) => true,
            Progress::Failed { .. } => false,
        })
    }

    /// Takes up new requests and renews those that are known.
    fn accept(&mut self, scene: &Scene, requests: &[PageRequest]) {
        for request in requests {
            if let Some(entry) = self.entries.get_mut(&request.slot) {
                let priority = entry.paging.priority(request.priority);
                if entry.wanted_frame == self.frame {
                    entry.priority = entry.priority.max(priority);
                } else {
                    entry.priority = priority;
                    entry.wanted_frame = self.frame;
                }
                continue;
            }
            let Some(slot) = scene.slot(request.slot) else { continue };
            if slot.state != SlotState::Empty || !self.takes_requests {
                continue;
            }
            let mut above = self.above.get(&slot.page).unwrap_or(&self.above_roots).clone();
            if !above.chain.is_empty() {
                above.set_from_page *= slot.content_transform;
            }
            let job = Job {
                ticket: self.next_ticket,
                slot: request.slot,
                uri: slot.uri.clone(),
                reader_data: slot.reader_data.cloned(),
                above,
            };
            timeline::request_begins(self.threads.list.ticket_source | job.ticket, &job.uri);
            self.next_ticket += 1;
            self.stats.requested += 1;
            let entry = Entry {
                job,
                priority: slot.paging.priority(request.priority),
                paging: slot.paging,
                wanted_frame: self.frame,
                since: Instant::now(),
                tries: 0,
                progress: Progress::Waiting,
            };
            self.entries.insert(request.slot, entry);
        }
    }

    fn take_answers(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        while let Some(answer) = self.threads.answers.as_ref().and_then(|a| a.try_recv().ok()) {
            self.answer(scene, answer, contexts);
        }
    }

    fn answer(&mut self, scene: &mut Scene, answer: Answer, contexts: &mut [&mut dyn CompileContext]) {
        {
            let mut waiting = self.threads.list.lock();
            waiting.outstanding = waiting.outstanding.saturating_sub(1);
        }
        self.stats.bytes_read += answer.bytes_read;
        self.stats.bytes_http += answer.bytes_http;
        let slot = answer.job.slot;
        let known = self.entries.get_mut(&slot).filter(|e| e.job.ticket == answer.job.ticket);
        let Some(entry) = known else {
            // The tree that held the slot is gone.
            if let Some(Ok(page)) = answer.page {
                self.threads.reap(Box::new(page));
            }
            return;
        };
        match answer.page {
            None => {
                self.stats.cancelled += 1;
                timeline::request_ends(self.threads.list.ticket_source | answer.job.ticket, "cancelled");
                self.entries.remove(&slot);
            }
            Some(Err(error)) => {
                self.stats.failed += 1;
                timeline::request_ends(self.threads.list.ticket_source | answer.job.ticket, "failed");
                self.errors.add(&error);
                entry.tries += 1;
                let again = error.is_transient() && entry.tries < self.config.max_tries;
                let wait = self.config.retry_after * 2u32.saturating_pow(entry.tries.min(10) - 1);
                let wait = wait.max(error.retry_after().unwrap_or_default()).mul_f64(spread(entry.job.ticket));
                entry.progress = Progress::Failed { retry_at: again.then(|| Instant::now() + wait) };
                scene.set_failed(slot, true);
            }
            Some(Ok(mut page)) => {
                self.stats.loaded += 1;
                self.stats.bytes_decoded += page.size_bytes();
                let kinds: Arc<[DrawKind]> = scene.draw_kinds(Some(slot), &page).into();
                let drawables = page.take_drawables();
                self.shares.take(&page);
                let ticket = entry.job.ticket;
                let contexts_left = if drawables.is_empty() { 0 } else { contexts.len() };
                entry.progress = Progress::Arrived(Arrived { page: Box::new(page), gpu_bytes: 0, contexts_left });
                if contexts_left == 0 {
                    self.ready.push(slot);
                    return;
                }
                self.compiling.insert(ticket, slot);
                let mut drawables = Some(drawables);
                let last = contexts.len() - 1;
                for (i, context) in contexts.iter_mut().enumerate() {
                    let for_this = if i == last { drawables.take() } else { drawables.clone() };
                    context.foresee(&kinds);
                    context.compile(CompileOperation { ticket, drawables: for_this.unwrap_or_default() });
                }
            }
        }
    }

    fn take_compiled(&mut self, contexts: &mut [&mut dyn CompileContext]) {
        for context in contexts.iter_mut() {
            for compiled in context.take_compiled() {
                let slot = self.compiling.get(&compiled.ticket).copied();
                let entry = slot.and_then(|s| self.entries.get_mut(&s));
                let (Some(slot), Some(entry)) = (slot, entry) else {
                    context.release(compiled.slots);
                    continue;
                };
                self.shares.uploaded(context.id(), &compiled.shared);
                for error in &compiled.errors {
                    self.stats.drawables_failed += 1;
                    self.errors.add_text(&entry.job.uri, error);
                }
                let Progress::Arrived(arrived) = &mut entry.progress else {
                    context.release(compiled.slots);
                    continue;
                };
                arrived.gpu_bytes += compiled.bytes;
                arrived.page.set_draw_slots(context.id(), compiled.slots);
                arrived.contexts_left = arrived.contexts_left.saturating_sub(1);
                if arrived.contexts_left == 0 {
                    self.compiling.remove(&compiled.ticket);
                    self.ready.push(slot);
                }
            }
        }
    }

    /// Hangs pages into their slots, coarse before fine, within the time budget. What does not fit into the byte
    /// budgets, with everything else in use, is dropped and asked for again when there is room.
    fn merge(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        if self.ready.is_empty() {
            return;
        }
        let _span = timeline::span("merge pages");
        let start = Instant::now();
        let priority = |s: &NodeId| self.entries.get(s).map_or(f32::MIN, |e| e.priority);
        self.ready.sort_by(|a, b| priority(b).total_cmp(&priority(a)).then(a.cmp(b)));
        let mut done = 0;
        for slot in std::mem::take(&mut self.ready) {
            if done > 0 && !self.config.blocking && start.elapsed() >= self.config.merge_time {
                self.ready.push(slot);
                continue;
            }
            let Some(entry) = self.entries.remove(&slot) else { continue };
            let is_ahead = entry.is_ahead();
            let Progress::Arrived(Arrived { page, gpu_bytes, .. }) = entry.progress else { continue };
            let ticket = self.threads.list.ticket_source | entry.job.ticket;
            let cpu_bytes = page.own_bytes();
            let shared = self.shares.of(&page);
            let alone = (cpu_bytes + shared.cpu, gpu_bytes + shared.gpu);
            if alone.0 > self.config.max_bytes_cpu || alone.1 > self.config.max_bytes_gpu {
                timeline::request_ends(ticket, "failed");
                self.refuse(scene, slot, entry.job, alone);
                self.retire(page, contexts);
                continue;
            }
            // Counts before there is room, so that what goes to make room and shares with it takes nothing along.
            let added = self.shares.merge(&page);
            self.mean_cpu_bytes = moving_mean(self.mean_cpu_bytes, cpu_bytes + added.cpu);
            self.mean_gpu_bytes = moving_mean(self.mean_gpu_bytes, gpu_bytes + added.gpu);
            if (is_ahead && !self.has_free(EXPIRY_TENTHS)) || !self.make_room(scene, cpu_bytes, gpu_bytes, contexts) {
                self.stats.declined += 1;
                timeline::request_ends(ticket, "declined");
                self.shares.unmerge(&page);
                self.retire(page, contexts);
                continue;
            }
            let tile_tree = page.is_tile_tree();
            match scene.attach(slot, *page) {
                Ok(id) => {
                    let latency_s = entry.since.elapsed().as_secs_f64();
                    self.stats.merged += 1;
                    self.stats.merged_ahead += u64::from(is_ahead);
                    timeline::request_ends(ticket, "merged");
                    self.stats.latency_sum_s += latency_s;
                    self.stats.latency_max_s = self.stats.latency_max_s.max(latency_s);
                    self.residents.insert(id, Resident::new(slot, (cpu_bytes, gpu_bytes), entry.paging));
                    if tile_tree {
                        let Above { chain, set_from_page } = entry.job.above;
                        let chain = chain.iter().cloned().chain([entry.job.uri.clone()]).collect();
                        self.above.insert(id, Above { chain, set_from_page });
                    }
                }
                // The slot went with its tree.
                Err(refused) => {
                    self.stats.dropped += 1;
                    timeline::request_ends(ticket, "dropped");
                    self.shares.unmerge(&refused.1);
                    self.retire(Box::new(refused.1), contexts);
                }
            }
            done += 1;
        }
    }

    /// A page that alone is beyond a budget: an error, and not asked for again.
    fn refuse(&mut self, scene: &mut Scene, slot: NodeId, job: Job, (cpu_bytes, gpu_bytes): (u64, u64)) {
        let config = &self.config;
        let (what, got, limit) = if cpu_bytes > config.max_bytes_cpu {
            ("memory of the page", cpu_bytes, config.max_bytes_cpu)
        } else {
            ("GPU memory of the page", gpu_bytes, config.max_bytes_gpu)
        };
        self.stats.failed += 1;
        self.errors.add(&IoError::TooLarge { uri: job.uri.to_string(), what, got, limit });
        let entry = Entry {
            job,
            priority: 0.0,
            wanted_frame: self.frame,
            since: Instant::now(),
            tries: self.config.max_tries,
            progress: Progress::Failed { retry_at: None },
            paging: PagingOptions::default(),
        };
        self.entries.insert(slot, entry);
        scene.set_failed(slot, true);
    }

    /// Of merged pages, what they share once.
    fn cpu_bytes(&self) -> u64 {
        self.residents.cpu_bytes + self.shares.held.cpu
    }

    /// Of merged pages, what they share once.
    fn gpu_bytes(&self) -> u64 {
        self.residents.gpu_bytes + self.shares.held.gpu
    }

    /// Expires what is not needed until so many bytes and one tile more fit; false when they never will for now.
    fn make_room(
        &mut self,
        scene: &mut Scene,
        cpu_bytes: u64,
        gpu_bytes: u64,
        contexts: &mut [&mut dyn CompileContext],
    ) -> bool {
        let mut looks = self.residents.len().min(4 * EXPIRY_LOOKS);
        while self.cpu_bytes() + cpu_bytes > self.config.max_bytes_cpu
            || self.gpu_bytes() + gpu_bytes > self.config.max_bytes_gpu
            || self.residents.len() + 1 > self.config.max_tiles
        {
            // In want of room, the last two frames' tiles alone are safe.
            let unused = Unused { frames: 2, time: Duration::ZERO };
            let Some(id) = self.residents.pop_expired(scene, self.frame, unused, &mut looks) else { return false };
            self.detach(scene, id, contexts);
        }
        true
    }

    /// True while so many tenths of each budget are free.
    fn has_free(&self, tenths: u64) -> bool {
        let is_free = |used: u64, max: u64| used <= max / 10 * (10 - tenths);
        is_free(self.cpu_bytes(), self.config.max_bytes_cpu)
            && is_free(self.gpu_bytes(), self.config.max_bytes_gpu)
            && is_free(self.residents.len() as u64, self.config.max_tiles as u64)
    }

    /// Takes out what was not wanted for long, while less than [`EXPIRY_TENTHS`] of a budget are free.
    fn expire(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        let unused = Unused { frames: self.config.expiry_frames, time: self.config.expiry_time };
        let mut looks = self.residents.len().min(EXPIRY_LOOKS);
        while !self.has_free(EXPIRY_TENTHS) {
            let Some(id) = self.residents.pop_expired(scene, self.frame, unused, &mut looks) else { break };
            self.detach(scene, id, contexts);
        }
    }

    fn detach(&mut self, scene: &mut Scene, id: PageId, contexts: &mut [&mut dyn CompileContext]) {
        // Requests for slots inside an expired tileset go with it.
        if self.above.remove(&id).is_some() {
            self.drop_entries(contexts, |slot, _| slot.page == id);
        }
        match scene.detach(id) {
            Ok(page) => {
                self.stats.expired += 1;
                self.shares.unmerge(&page);
                self.retire(Box::new(page), contexts);
            }
            Err(e) => log::error!("an expired page could not be taken out: {e}"),
        }
    }

    /// Gives a page's slots back and drops it on the reaper's thread.
    fn retire(&mut self, mut page: Box<Page>, contexts: &mut [&mut dyn CompileContext]) {
        self.shares.give_back(&page);
        for (id, slots) in page.take_draw_slots() {
            if let Some(context) = contexts.iter_mut().find(|c| c.id() == id) {
                context.release(slots);
            }
        }
        self.threads.reap(page);
    }

    /// Takes every page out that nothing else hangs in, and what was loaded and not merged: all of it is loaded and
    /// uploaded again when it is wanted. For contexts that come later.
    pub fn page_anew(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        self.drop_uploads(contexts);
        // What hangs deepest goes first; each round takes a level.
        loop {
            let expirable = self.residents.take_if(|id| scene.is_expirable(id));
            if expirable.is_empty() {
                break;
            }
            for id in expirable {
                self.detach(scene, id, contexts);
            }
        }
    }

    /// Takes every page out and forgets every request, also what failed: as it was before the first frame.
    pub fn clear(&mut self, scene: &mut Scene, contexts: &mut [&mut dyn CompileContext]) {
        self.page_anew(scene, contexts);
        for (slot, _) in self.entries.iter().filter(|(_, e)| matches!(e.progress, Progress::Failed { .. })) {
            scene.set_failed(*slot, false);
        }
        self.drop_entries(contexts, |_, _| true);
        self.rewrite_list();
        self.count();
    }

    /// Drops what was loaded and waits for its upload or its merge, to be asked for again. For contexts that go, whose
    /// uploads nobody would finish.
    pub fn drop_uploads(&mut self, contexts: &mut [&mut dyn CompileContext]) {
        self.drop_entries(contexts, |_, entry| matches!(entry.progress, Progress::Arrived(_)));
        self.compiling.clear();
        self.ready.clear();
    }

    /// Forgets requests, with what was loaded and uploaded for them; late answers and uploads find nobody.
    fn drop_entries(&mut self, contexts: &mut [&mut dyn CompileContext], drops: impl Fn(&NodeId, &Entry) -> bool) {
        let dropped: Vec<Entry> =
            self.entries.extract_if(|slot, entry| drops(slot, entry)).map(|(_, entry)| entry).collect();
        for Entry { job, progress, .. } in dropped {
            if matches!(progress, Progress::Failed { .. }) {
                continue;
            }
            self.stats.dropped += 1;
            timeline::request_ends(self.threads.list.ticket_source | job.ticket, "dropped");
            match progress {
                Progress::Arrived(Arrived { page, .. }) => {
                    self.compiling.remove(&job.ticket);
                    self.retire(page, contexts);
                }
                // Aborted, unless its answer is there already.
                Progress::Loading if io::is_http(&job.uri) => self.threads.list.lock().abort.push(job.ticket),
                _ => {}
            }
        }
    }

    /// Lets failures whose wait is over be requested again.
    fn retry(&mut self, scene: &mut Scene) {
        let now = Instant::now();
        for entry in self.entries.values_mut() {
            if let Progress::Failed { retry_at: Some(at) } = entry.progress
                && at <= now
            {
                scene.set_failed(entry.job.slot, false);
                entry.job.ticket = self.next_ticket;
                timeline::request_begins(self.threads.list.ticket_source | self.next_ticket, &entry.job.uri);
                self.next_ticket += 1;
                entry.wanted_frame = self.frame;
                entry.progress = Progress::Waiting;
                self.stats.retried += 1;
            }
        }
    }

    /// Drops what is stale, aborts what nobody wants, and writes the waiting jobs in order of priority.
    fn rewrite_list(&mut self) {
        let frame = self.frame;
        let stale_frames = self.config.stale_frames;
        let has_free = self.has_free(AHEAD_TENTHS);
        let list = &self.threads.list;
        let mut waiting = list.lock();
        let taken: HashSet<u64> = waiting.taken.drain(..).collect();
        if !taken.is_empty() {
            for entry in self.entries.values_mut() {
                // What was taken and answered since the last look is further already.
                if matches!(entry.progress, Progress::Waiting) && taken.contains(&entry.job.ticket) {
                    entry.progress = Progress::Loading;
                }
            }
        }
        let mut stale = 0;
        self.entries.retain(|_, e| {
            let old = frame.saturating_sub(e.wanted_frame) > stale_frames && matches!(e.progress, Progress::Waiting);
            stale += u64::from(old);
            if old {
                timeline::request_ends(self.threads.list.ticket_source | e.job.ticket, "stale");
            }
            !old
        });
        self.stats.stale += stale;
        let mut jobs: Vec<(f32, &Entry)> = Vec::new();
        let mut ahead_under_way = 0;
        for entry in self.entries.values() {
            if entry.is_ahead() && matches!(entry.progress, Progress::Loading | Progress::Arrived(_)) {
                ahead_under_way += 1;
            }
            match entry.progress {
                Progress::Waiting => jobs.push((entry.priority, entry)),
                Progress::Loading
                    if io::is_http(&entry.job.uri)
                        && frame.saturating_sub(entry.wanted_frame) > self.config.abort_frames =>
                {
                    waiting.abort.push(entry.job.ticket);
                }
                _ => {}
            }
        }
        // Taken from the end: the most urgent last.
        jobs.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.job.slot.cmp(&a.1.job.slot)));
        // Of what is wanted later as many as may be under way, the most urgent ones.
        let ahead = jobs.partition_point(|(priority, _)| *priority < 0.0);
        let may_start = if has_free { self.config.ahead_in_flight.saturating_sub(ahead_under_way) } else { 0 };
        jobs.drain(..ahead.saturating_sub(may_start));
        waiting.file.clear();
        waiting.http.clear();
        for (_, entry) in &jobs {
            let to = if io::is_http(&entry.job.uri) { &mut waiting.http } else { &mut waiting.file };
            to.push(entry.job.clone());
        }
        waiting.allowed = self.allowed_in_flight(list.capacity);
        self.full = waiting.allowed == 0 && !jobs.is_empty();
        drop(waiting);
        list.ring();
    }

    /// How many loads the budgets have room for, at the mean size so far; what can expire counts as room.
    fn allowed_in_flight(&self, capacity: usize) -> usize {
        if self.is_paused {
            return 0;
        }
        let arrived = (self.compiling.len() + self.ready.len()) as u64;
        let room = |max: u64, used: u64, mean: u64| max.saturating_sub(used + arrived * mean) / mean.max(1);
        let cpu = room(self.config.max_bytes_cpu, self.cpu_bytes(), self.mean_cpu_bytes);
        let gpu = room(self.config.max_bytes_gpu, self.gpu_bytes(), self.mean_gpu_bytes);
        let tiles = (self.config.max_tiles as u64).saturating_sub(self.residents.len() as u64 + arrived);
        // What waits for its upload holds memory besides the budgets'.
        let pending = (MOST_PENDING_BYTES / self.mean_gpu_bytes.max(1)).saturating_sub(arrived);
        cpu.min(gpu).min(tiles).min(pending).min(capacity as u64) as usize
    }

    fn count(&mut self) {
        let (cpu_bytes, gpu_bytes) = (self.cpu_bytes(), self.gpu_bytes());
        let s = &mut self.stats;
        s.cpu_bytes = cpu_bytes;
        s.cpu_bytes_peak = s.cpu_bytes_peak.max(s.cpu_bytes);
        s.gpu_bytes = gpu_bytes;
        s.gpu_bytes_peak = s.gpu_bytes_peak.max(s.gpu_bytes);
        s.shared_cpu_bytes_saved = self.shares.saved.cpu;
        s.shared_gpu_bytes_saved = self.shares.saved.gpu;
        s.shared_gpu_bytes_saved_peak = s.shared_gpu_bytes_saved_peak.max(s.shared_gpu_bytes_saved);
        if let Some(sharing) = &self.options.sharing {
            s.sharing = sharing.stats();
        }
        s.resident = self.residents.len() as u64;
        s.waiting = self.entries.values().filter(|e| matches!(e.progress, Progress::Waiting)).count() as u64;
        let flying = |e: &&Entry| matches!(e.progress, Progress::Loading | Progress::Arrived(_));
        s.in_flight = self.entries.values().filter(flying).count() as u64;
    }
}

/// From 1 to 1.25 by the number of a load: what failed together is not asked for again together.
fn spread(ticket: u64) -> f64 {
    1.0 + (ticket.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 / (1u64 << 26) as f64
}

fn moving_mean(mean: u64, value: u64) -> u64 {
    if mean == 0 { value } else { (7 * mean + value) / 8 }
}
