//! [`Scheduler`]: tells the request list, which the threads take from, what has changed, and sets how many jobs may be
//! outstanding within the budgets. Update thread.

use std::ops::RangeInclusive;
use std::time::Duration;

use super::entry::Progress;
use super::table::RequestTable;
use crate::fetch::{self, LoadRoom};
use crate::pager::config::PagerConfig;
use crate::pager::frame_times::FrameTimes;
use crate::pager::loading::page_job::PageJob;
use crate::pager::loading::request_list::{Limits, ListState, RequestList};
use crate::pager::residency::Unused;
use crate::pager::residency::budget::{MemoryUse, RESERVED_TENTHS, Room};
use crate::scene::NodeId;

/// Decoded pages that wait for their upload may hold about this many bytes per decode thread; beyond that nothing is
/// loaded. This is about what a thread decodes while the main thread makes a frame.
const MAX_PENDING_BYTES: u64 = 8 << 20;
/// This many pages per decode thread may wait for their upload, however large they are.
const MIN_PENDING_PAGES: u64 = 2;

/// A request is old after this many frames: some slots go to old ones.
const AGED_FRAMES: u32 = 120;

/// A request that the last frames did not renew is not wanted any more, whatever time has passed. Culls of several threads
/// renew it in one of two frames.
const MIN_UNWANTED_FRAMES: u32 = 2;

/// A page wanted within this many frames of another is not worth replacing by it.
const PREFETCH_MARGIN_FRAMES: u32 = 2;

/// The number of jobs that one update marks as taken. Threads may take thousands between two updates; what is left counts as
/// waiting until the next one.
const MAX_TAKEN: usize = 256;
/// One update writes the changed urgencies of this many jobs that are the most urgent now, and of as many that were the most urgent in
/// the list. Threads take fewer between two updates.
const MAX_CHANGED: usize = 1024;
/// One update drops this many stale requests that were renewed longest ago, and as many that are among the most urgent, which threads
/// would take next.
const MAX_STALE: usize = 2048;
/// The number of the most urgent jobs that are looked at until none of them is stale.
const MAX_LOOKED_AT: usize = 256;

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
        let unused = Unused::new(config.expiry_frames, config.expiry_time);
        match self.prefetch {
            Some(prefetch) => unused.or_frames(prefetch.frames.saturating_add(PREFETCH_MARGIN_FRAMES)),
            None => unused,
        }
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
    pub times: &'a FrameTimes,
    pub is_paused: bool,
    pub room: Room,
    /// Loads for which the bytes that may be on their way have room.
    pub load_room: LoadRoom,
    /// Pages that have arrived and are not merged.
    pub arrived_pages: u64,
    /// Prefetches of them.
    pub arrived_prefetches: usize,
}

impl Conditions<'_> {
    /// Returns true if what was last wanted in a frame has not been wanted for this long.
    fn is_unwanted(&self, wanted_frame: u32, time: Duration) -> bool {
        let age = self.times.frame().saturating_sub(wanted_frame);
        age > MIN_UNWANTED_FRAMES && self.times.distance(wanted_frame) >= time
    }
}

/// Drops stale requests among the most urgent jobs of the list; returns how many.
fn drop_urgent_stale(
    table: &mut RequestTable,
    list: &mut ListState<PageJob>,
    is_stale: impl Fn(u32) -> bool + Copy,
) -> usize {
    let mut count = 0;
    while count < MAX_STALE && table.has_stale(is_stale) {
        let is_of_stale = |job: &&PageJob| table.of_job(job).is_some_and(|entry| is_stale(entry.wanted_frame));
        let slots: Vec<NodeId> =
            list.most_urgent(MAX_LOOKED_AT).filter(is_of_stale).take(MAX_STALE - count).map(|job| job.slot).collect();
        if slots.is_empty() {
            break;
        }
        count += slots.len();
        slots.into_iter().for_each(|slot| table.end_stale(slot));
        table.waiting_mut().write_changes(list);
    }
    count
}

/// Writes the request list.
#[derive(Debug, Default)]
pub(in crate::pager) struct Scheduler {
    trials: TrialLoads,
    shortage: Shortage,
    /// Prefetches that are loading and needed in one of the next frames.
    soon: u64,
    /// Stale requests are left in the list.
    has_stale: bool,
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

    /// Drops stale requests, aborts what is no longer wanted, and writes the changes to the list. Returns the number of stale
    /// requests.
    pub fn write_list(&mut self, table: &mut RequestTable, list: &RequestList<PageJob>, at: &Conditions<'_>) -> u64 {
        let max = |count| if at.config.blocking { usize::MAX } else { count };
        let taken: Vec<PageJob> = list.lock().drain_taken(max(MAX_TAKEN)).collect();
        // Jobs that have lost their entries meanwhile are aborted.
        let mut aborted: Vec<_> = taken.iter().filter(|job| !table.mark_loading(job)).map(|job| job.ticket).collect();
        let is_stale = |wanted_frame| at.is_unwanted(wanted_frame, at.config.stale_time);
        let mut stale = table.drop_stale(max(MAX_STALE), is_stale);
        self.soon = 0;
        for (_, entry) in table.begun().filter(|(_, entry)| entry.progress == Progress::Loading) {
            self.soon += u64::from(entry.is_soon());
            let is_remote = fetch::is_remote(&entry.job.uri);
            if is_remote && at.is_unwanted(entry.wanted_frame, at.config.abort_time) {
                aborted.push(entry.job.ticket);
            }
        }
        table.waiting_mut().collect_changes(max(MAX_CHANGED));
        let (blocked, without_room) = table.waiting_mut().list_sized(&at.room);
        let now = table.waiting().wanted_now() - without_room;
        let prefetches = table.waiting().prefetches(&at.room);
        self.soon += prefetches.soon;

        // Locked from here on, so that no job is taken of which the list says otherwise.
        let mut state = list.lock();
        let now = now.saturating_sub(state.taken_now());
        let room = at.room.pages_of_mean_size(RESERVED_TENTHS).saturating_sub(state.outstanding() as u64);
        let takes_any = at.config.ahead_in_flight > 0 && !at.is_paused;
        // If room is tight, only prefetches that are needed about as soon as the soonest are listed.
        let short = prefetches.soonest.filter(|_| takes_any && room < prefetches.count as u64);
        let latest = short.map_or(u32::MAX, |soonest| soonest.saturating_add(PREFETCH_MARGIN_FRAMES));
        let count = table.waiting_mut().list_prefetches(&at.room, latest) as u64;
        table.waiting_mut().write_changes(&mut state);
        if table.has_stale(is_stale) {
            stale += drop_urgent_stale(table, &mut state, is_stale);
        }
        self.has_stale = table.has_stale(is_stale);
        if cfg!(feature = "http") {
            aborted.into_iter().for_each(|ticket| state.abort(ticket));
        }
        let allowed = self.max_in_flight(list.capacity(), at);
        let outstanding = self.with_trial(allowed, at);
        self.shortage = Shortage {
            is_full: outstanding == 0 && now > 0,
            is_short: !at.is_paused && allowed < list.capacity().min(state.outstanding() + now),
            blocked_page_size: blocked.filter(|_| !at.is_paused),
            prefetch: short.map(|frames| PrefetchShortage { frames, count }),
        };
        let limits = self.limits(outstanding, &state, at);
        state.set_limits(limits);
        stale as u64
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
        let may_try = has_some && !at.is_paused && at.arrived_pages == 0 && at.times.frame() >= self.trials.next_frame;
        allowed.max(usize::from(may_try))
    }

    /// Limits prefetches to the room beside other jobs, and to a few beside them, less those that have arrived.
    fn limits(&self, outstanding: usize, state: &ListState<PageJob>, at: &Conditions<'_>) -> Limits {
        // Prefetches that are needed in one of the next frames may use the reserved tenths.
        let room = at.room.pages_of_mean_size(RESERVED_TENTHS).max(at.room.pages_of_mean_size(0).min(self.soon));
        let room = (room as usize).saturating_sub(state.outstanding_now());
        // Jobs stay in the list, by priority, while they would only wait for bytes to become free.
        let load_room = at.load_room;
        let prefetches = state.outstanding_prefetches().saturating_add(load_room.prefetches);
        Limits {
            outstanding: outstanding.min(state.outstanding().saturating_add(load_room.loads)),
            prefetch_room: if at.config.ahead_in_flight > 0 { room.min(prefetches) } else { 0 },
            prefetch_beside_others: at.config.ahead_in_flight.saturating_sub(at.arrived_prefetches),
            // The oldest requests are stale ones while such are left. Then no slot goes to old requests.
            aged_before: if self.has_stale { 0 } else { at.times.frame().saturating_sub(AGED_FRAMES) },
        }
    }
}
