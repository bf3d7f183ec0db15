//! [`Scheduler`]: writes the request list that the threads take from, in order of priority, and sets how many jobs may be
//! outstanding within the budgets. Update thread.

use std::collections::{BTreeMap, HashSet};
use std::ops::RangeInclusive;

use super::entry::{Entry, Progress};
use super::fairness::{Aging, SceneTurns};
use super::table::RequestTable;
use crate::fetch;
use crate::pager::config::PagerConfig;
use crate::pager::loading::page_job::PageJob;
use crate::pager::loading::request_list::{Limits, ListState, RequestList};
use crate::pager::loading::ticket::Ticket;
use crate::pager::residency::Unused;
use crate::pager::residency::budget::{MemoryUse, RESERVED_TENTHS, Room};
use crate::scene::SceneNumber;

/// Decoded pages that wait for their upload may hold about this many bytes per decode thread; beyond that nothing is
/// loaded. This is about what a thread decodes while the main thread makes a frame.
const MAX_PENDING_BYTES: u64 = 8 << 20;
/// This many pages per decode thread may wait for their upload, however large they are.
const MIN_PENDING_PAGES: u64 = 2;

/// Prefetches are listed for this many times as many as may be in flight: enough until the list is rewritten.
const PREFETCHES_LISTED: usize = 32;

/// A page wanted within this many frames of another is not worth replacing by it.
const PREFETCH_MARGIN_FRAMES: u32 = 2;

/// After a trial load had no room, the next one waits for this many frames, doubled each time.
const TRIAL_BACKOFF_FRAMES: RangeInclusive<u32> = 8..=128;

/// Prefetches that find no free room.
#[derive(Clone, Copy, Debug)]
struct PrefetchShortage {
    /// Frames until the soonest is needed; pages not wanted for longer than that may expire for it.
    frames: u32,
    /// The number of prefetches that are needed about as soon.
    count: u64,
}

/// Contents that wait for room, as of the last list.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::pager) struct Shortage {
    /// The budgets are full of what is visible; nothing may be loaded.
    is_full: bool,
    /// More requests wait than there is room for.
    is_short: bool,
    /// Size of the most urgent page that was loaded and had no room.
    blocked_page_size: Option<MemoryUse>,
    prefetch: Option<PrefetchShortage>,
}

impl Shortage {
    /// Returns true if nothing may be loaded.
    pub fn is_full(&self) -> bool {
        self.is_full
    }

    /// Returns true if a page of known size waits for room.
    pub fn has_blocked_page(&self) -> bool {
        self.blocked_page_size.is_some()
    }

    /// Returns true if something waits for room.
    pub fn is_any(&self) -> bool {
        self.is_missing() || self.prefetch.is_some()
    }

    /// Returns true if something that a frame lacks waits for room.
    fn is_missing(&self) -> bool {
        self.is_short || self.blocked_page_size.is_some()
    }

    /// Returns how long a page must be unused to expire: as configured; less for a prefetch that is needed sooner; and only
    /// not shown if a frame lacks something.
    pub fn unused(&self, config: &PagerConfig) -> Unused {
        if self.is_missing() {
            return Unused::NOT_SHOWN;
        }
        let mut unused = Unused { frames: config.expiry_frames, time: config.expiry_time };
        if let Some(prefetch) = self.prefetch {
            unused.frames = unused.frames.min(prefetch.frames.saturating_add(PREFETCH_MARGIN_FRAMES));
        }
        unused
    }

    /// Returns true while pages should expire: the reserved tenths are not free, or what waits has no room.
    pub fn needs_room(&self, room: &Room) -> bool {
        let for_prefetch = |short: PrefetchShortage| room.pages_of_mean_size(RESERVED_TENTHS) < short.count;
        !room.has_free_tenths(RESERVED_TENTHS)
            || self.prefetch.is_some_and(for_prefetch)
            || self.is_short && room.pages_of_mean_size(0) == 0
            || self.blocked_page_size.is_some_and(|size| !room.fits(size))
    }
}

/// Trial loads: where no page of the mean size has room one is loaded anyway, because sizes are known only after loading.
#[derive(Clone, Copy, Debug, Default)]
struct TrialLoads {
    next_frame: u32,
    backoff_frames: u32,
}

impl TrialLoads {
    fn ended(&mut self, had_room: bool, frame: u32) {
        let (min, max) = TRIAL_BACKOFF_FRAMES.into_inner();
        self.backoff_frames = if had_room { 0 } else { (2 * self.backoff_frames).clamp(min, max) };
        self.next_frame = frame.saturating_add(self.backoff_frames);
    }
}

/// The state of the pager that the list depends on.
#[derive(Clone, Copy)]
pub(in crate::pager) struct Conditions<'a> {
    pub config: &'a PagerConfig,
    pub frame: u32,
    pub is_paused: bool,
    pub room: Room,
    /// Pages that have arrived and are not merged.
    pub arrived_pages: u64,
    /// Prefetches of them.
    pub arrived_prefetches: usize,
    /// True if the pager serves more than one scene.
    pub has_several_scenes: bool,
}

/// Writes the request list.
#[derive(Debug, Default)]
pub(in crate::pager) struct Scheduler {
    turns: SceneTurns,
    aging: Aging,
    trials: TrialLoads,
    shortage: Shortage,
    /// Prefetches that are loading and needed in one of the next frames.
    soon: u64,
}

impl Scheduler {
    /// Returns the contents that waited for room when the list was last written.
    pub fn shortage(&self) -> &Shortage {
        &self.shortage
    }

    /// Notes that a page was merged.
    pub fn merged(&mut self, is_prefetch: bool, frame: u32) {
        self.trials.ended(true, frame);
        if is_prefetch && let Some(prefetch) = &mut self.shortage.prefetch {
            prefetch.count = prefetch.count.saturating_sub(1);
        }
    }

    /// Notes that a loaded page had no room.
    pub fn declined(&mut self, frame: u32) {
        self.trials.ended(false, frame);
    }

    /// Forgets a scene that is no longer served.
    pub fn forget_scene(&mut self, scene: SceneNumber) {
        self.turns.forget(scene);
    }

    /// Drops stale requests, aborts what is no longer wanted, and writes the waiting jobs in order of priority. Returns the
    /// number of stale requests. The list is locked meanwhile, so that no job is taken twice.
    pub fn write_list(&mut self, table: &mut RequestTable, list: &RequestList<PageJob>, at: &Conditions<'_>) -> u64 {
        let mut state = list.lock();
        let mut taken: HashSet<Ticket> = state.drain_taken().collect();
        let by_scene = table.mark_loading(&mut taken);
        if cfg!(feature = "http") {
            // The remaining tickets have lost their entries meanwhile.
            taken.into_iter().for_each(|ticket| state.abort(ticket));
        }
        let stale = table.drop_stale(at.frame, at.config.stale_frames);
        abort_unwanted(table, &mut state, at);
        let (waiting, blocked) = waiting_entries(table, &at.room);
        let soon = |entry: &Entry| entry.is_soon() && entry.is_loading();
        self.soon = table.iter().filter(|(_, entry)| soon(entry)).count() as u64;

        let (mut prefetches, now): (Vec<&Entry>, Vec<&Entry>) =
            waiting.into_iter().partition(|entry| entry.is_prefetch());
        let prefetch_short = self.select_prefetches(&mut prefetches, &state, at);
        let now = self.order_fairly(now, &by_scene, at);

        let allowed = self.max_in_flight(list.capacity(), at);
        let outstanding = self.with_trial(allowed, at);
        self.shortage = Shortage {
            is_full: outstanding == 0 && !now.is_empty(),
            is_short: !at.is_paused && allowed < list.capacity().min(state.outstanding() + now.len()),
            blocked_page_size: blocked.filter(|_| !at.is_paused),
            prefetch: prefetch_short,
        };
        // Threads take from the end.
        let job = |entry: &Entry| PageJob { is_prefetch: entry.is_prefetch(), ..entry.job.clone() };
        state.set_jobs(prefetches.into_iter().chain(now.into_iter().rev()).map(job));
        let limits = self.limits(outstanding, &state, at);
        state.set_limits(limits);
        stale
    }

    /// Keeps the prefetches to list, the most urgent last: where room is tight, those needed about as soon as the soonest.
    /// Returns the shortage then.
    fn select_prefetches(
        &self,
        prefetches: &mut Vec<&Entry>,
        state: &ListState<PageJob>,
        at: &Conditions<'_>,
    ) -> Option<PrefetchShortage> {
        prefetches.sort_by(|a, b| by_priority(b, a));
        let soonest = prefetches.iter().map(|entry| entry.ahead_frames).min();
        let room = at.room.pages_of_mean_size(RESERVED_TENTHS).saturating_sub(state.outstanding() as u64);
        let takes_any = at.config.ahead_in_flight > 0 && !at.is_paused;
        let short = soonest.filter(|_| takes_any && room < prefetches.len() as u64);
        if let Some(soonest) = short {
            let latest = soonest.saturating_add(PREFETCH_MARGIN_FRAMES);
            prefetches.retain(|entry| entry.ahead_frames <= latest);
        }
        let shortage = short.map(|frames| PrefetchShortage { frames, count: prefetches.len() as u64 });
        let listed = PREFETCHES_LISTED.saturating_mul(at.config.ahead_in_flight);
        prefetches.drain(..prefetches.len().saturating_sub(listed));
        shortage
    }

    /// Orders requests with the most urgent first. Those that have waited long move up ([`Aging`]), so that no view
    /// starves, and scenes take turns.
    fn order_fairly<'a>(
        &mut self,
        mut now: Vec<&'a Entry>,
        taken: &BTreeMap<SceneNumber, u32>,
        at: &Conditions<'_>,
    ) -> Vec<&'a Entry> {
        now.sort_by(|a, b| by_priority(a, b));
        self.aging.took(taken.values().sum());
        now = self.aging.arrange(now, at.frame, |entry| (entry.first_frame, entry.job.slot));
        if at.has_several_scenes {
            let scene_of = |entry: &&Entry| entry.job.slot.page.scene;
            self.turns.took(taken, now.iter().map(scene_of));
            now = self.turns.arrange(now, scene_of);
        }
        now
    }

    /// Sets the limits again, and wakes threads if there is more room than when the list was written.
    pub fn update_limits(&self, list: &RequestList<PageJob>, at: &Conditions<'_>) {
        let outstanding = self.with_trial(self.max_in_flight(list.capacity(), at), at);
        let mut state = list.lock();
        let limits = self.limits(outstanding, &state, at);
        state.set_limits(limits);
        list.ring(state);
    }

    /// Returns how many loads the budgets have room for, at the mean size of recent pages.
    fn max_in_flight(&self, capacity: usize, at: &Conditions<'_>) -> usize {
        if at.is_paused {
            return 0;
        }
        // Pages that wait for their upload hold memory beyond the budgets.
        let per_thread = (MAX_PENDING_BYTES / at.room.mean.gpu.max(1)).max(MIN_PENDING_PAGES);
        let pending = (per_thread * at.config.decode_threads.max(1) as u64).saturating_sub(at.arrived_pages);
        at.room.pages_of_mean_size(0).min(pending).min(capacity as u64) as usize
    }

    /// Allows one trial load where no page of the mean size has room.
    fn with_trial(&self, allowed: usize, at: &Conditions<'_>) -> usize {
        let has_some = at.room.fits(MemoryUse { cpu: 1, gpu: 1 });
        let may_try = has_some && !at.is_paused && at.arrived_pages == 0 && at.frame >= self.trials.next_frame;
        allowed.max(usize::from(may_try))
    }

    /// Limits prefetches to the room beside other jobs, and to a few beside them, less those that have arrived.
    fn limits(&self, outstanding: usize, state: &ListState<PageJob>, at: &Conditions<'_>) -> Limits {
        // Prefetches that are needed in one of the next frames may use the reserved tenths.
        let room = at.room.pages_of_mean_size(RESERVED_TENTHS).max(at.room.pages_of_mean_size(0).min(self.soon));
        let room = (room as usize).saturating_sub(state.outstanding_now());
        Limits {
            outstanding,
            prefetch_room: if at.config.ahead_in_flight > 0 { room } else { 0 },
            prefetch_beside_others: at.config.ahead_in_flight.saturating_sub(at.arrived_prefetches),
        }
    }
}

/// Orders entries with the highest priority first.
fn by_priority(a: &Entry, b: &Entry) -> std::cmp::Ordering {
    b.priority.total_cmp(&a.priority).then(a.job.slot.cmp(&b.job.slot))
}

/// Aborts running HTTP requests that were not renewed for too long.
fn abort_unwanted(table: &RequestTable, state: &mut ListState<PageJob>, at: &Conditions<'_>) {
    if !cfg!(feature = "http") {
        return;
    }
    for (_, entry) in table.iter().filter(|(_, entry)| entry.progress == Progress::Loading) {
        let age = at.frame.saturating_sub(entry.wanted_frame);
        if age > at.config.abort_frames && fetch::is_remote(&entry.job.uri) {
            state.abort(entry.job.ticket);
        }
    }
}

/// Returns the waiting entries that have room as far as their size is known, and the size of the most urgent one that has
/// none. Pages never expire for a prefetch of known size.
fn waiting_entries<'a>(table: &'a RequestTable, room: &Room) -> (Vec<&'a Entry>, Option<MemoryUse>) {
    let mut waiting: Vec<&Entry> = Vec::new();
    let mut blocked: Option<(f32, MemoryUse)> = None;
    for (_, entry) in table.iter().filter(|(_, entry)| entry.progress == Progress::Waiting) {
        match entry.known_size.filter(|size| !room.fits(*size)) {
            None => waiting.push(entry),
            Some(size) if !entry.is_prefetch() && blocked.is_none_or(|(highest, _)| entry.priority > highest) => {
                blocked = Some((entry.priority, size));
            }
            Some(_) => {}
        }
    }
    (waiting, blocked.map(|(_, size)| size))
}
