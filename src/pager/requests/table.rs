//! [`RequestTable`]: all requests for contents that are not merged, by slot.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::sync::Arc;
use std::time::Instant;

use super::entry::{Entry, Progress};
use super::retry_policy::RetryState;
use crate::cull::PageRequest;
use crate::pager::loading::page_job::{LoadStage, PageJob};
use crate::pager::loading::ticket::{RequestEnd, Ticket, TicketIssuer};
use crate::pager::scenes::read_scope::{ReadScope, TilesetAncestors};
use crate::pager::scenes::scene_set::SceneSet;
use crate::scene::{NodeId, SceneNumber, SlotInfo};

/// Failures that are remembered: each frame iterates over them. Beyond that, those are forgotten that no camera meets.
const MAX_FAILURES: usize = 4096;

/// A slot that a cull met within this many frames is seen.
const MET_FRAMES: u32 = 2;

/// The number of entries that taking up requests has changed.
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::pager) struct Changes {
    /// Requests for contents that were not requested before.
    pub requested: u64,
    /// Contents that failed before and are requested again.
    pub retried: u64,
    /// True if a prefetch is wanted now.
    pub has_sooner: bool,
    /// True if a priority changed.
    pub has_new_order: bool,
}

impl Changes {
    /// Returns true if there is something new to load, or something is wanted sooner.
    pub fn has_new(&self) -> bool {
        self.requested + self.retried > 0 || self.has_sooner
    }

    /// Returns true if the request list is out of date.
    pub fn changes_list(&self) -> bool {
        self.requested + self.retried > 0 || self.has_new_order
    }
}

/// All requests for contents that are not merged, by slot, and the failures that are remembered. Update thread.
#[derive(Debug)]
pub(in crate::pager) struct RequestTable {
    entries: HashMap<NodeId, Entry>,
    tickets: TicketIssuer,
}

impl RequestTable {
    pub fn new() -> Self {
        Self { entries: HashMap::new(), tickets: TicketIssuer::new() }
    }

    /// Issues no ticket number that `before` has issued.
    pub fn continue_from(&mut self, before: &Self) {
        self.tickets.continue_from(&before.tickets);
    }

    /// Returns the entry of a slot.
    pub fn get(&self, slot: NodeId) -> Option<&Entry> {
        self.entries.get(&slot)
    }

    /// Returns the entry of a slot, mutably.
    pub fn get_mut(&mut self, slot: NodeId) -> Option<&mut Entry> {
        self.entries.get_mut(&slot)
    }

    /// Returns the entry that a job belongs to; `None` if the job is of an earlier attempt or its slot is gone.
    pub fn of_job(&mut self, job: &PageJob) -> Option<&mut Entry> {
        self.entries.get_mut(&job.slot).filter(|entry| entry.job.ticket == job.ticket)
    }

    /// Returns all entries, in no order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (NodeId, &Entry)> + Clone + '_ {
        self.entries.iter().map(|(slot, entry)| (*slot, entry))
    }

    /// Removes the entry of a slot.
    pub fn remove(&mut self, slot: NodeId) -> Option<Entry> {
        self.entries.remove(&slot)
    }

    /// Removes and returns the entries for which `condition` holds.
    pub fn extract_if(&mut self, condition: impl Fn(NodeId, &Entry) -> bool) -> Vec<Entry> {
        self.entries.extract_if(|slot, entry| condition(*slot, entry)).map(|(_, entry)| entry).collect()
    }

    /// Renews the request for a known slot. Returns false if the slot has no entry.
    pub fn renew(&mut self, request: &PageRequest, frame: u32, changes: &mut Changes) -> bool {
        let Some(entry) = self.entries.get_mut(&request.slot) else { return false };
        changes.has_sooner |= request.ahead_frames == 0 && entry.is_prefetch();
        let priority = entry.paging.priority(request.priority);
        changes.has_new_order |= entry.priority != priority;
        if entry.wanted_frame == frame {
            entry.priority = entry.priority.max(priority);
            entry.ahead_frames = entry.ahead_frames.min(request.ahead_frames);
        } else {
            entry.priority = priority;
            entry.ahead_frames = request.ahead_frames;
            entry.wanted_frame = frame;
        }
        if entry.progress == Progress::Retryable
            && let Some(entry) = self.entries.remove(&request.slot)
        {
            self.requeue(entry);
            changes.retried += 1;
        }
        true
    }

    /// Adds a request for a slot that has no entry.
    pub fn add(
        &mut self,
        request: &PageRequest,
        slot: &SlotInfo<'_>,
        ancestors: TilesetAncestors,
        scope: Arc<ReadScope>,
        frame: u32,
    ) {
        let job = PageJob {
            ticket: self.tickets.issue(),
            slot: request.slot,
            uri: slot.uri.clone(),
            reader_data: slot.reader_data.cloned(),
            ancestors,
            scope,
            is_prefetch: request.ahead_frames > 0,
            progress: Arc::default(),
        };
        job.ticket.trace_begin(&job.uri);
        let entry = Entry {
            job,
            priority: slot.paging.priority(request.priority),
            paging: slot.paging,
            first_frame: frame,
            wanted_frame: frame,
            ahead_frames: request.ahead_frames,
            since: Instant::now(),
            retries: RetryState::default(),
            known_size: None,
            progress: Progress::Waiting,
        };
        self.entries.insert(request.slot, entry);
    }

    /// Inserts a removed entry as a new attempt that waits.
    pub fn requeue(&mut self, mut entry: Entry) {
        entry.job.ticket = self.tickets.issue();
        entry.job.progress.set(LoadStage::Waiting);
        entry.job.ticket.trace_begin(&entry.job.uri);
        entry.progress = Progress::Waiting;
        self.entries.insert(entry.job.slot, entry);
    }

    /// Marks the entries of these tickets as loading. Returns how many each scene has of them, without prefetches, and
    /// leaves in `taken` the tickets without an entry.
    pub fn mark_loading(&mut self, taken: &mut HashSet<Ticket>) -> BTreeMap<SceneNumber, u32> {
        let mut by_scene: BTreeMap<SceneNumber, u32> = BTreeMap::new();
        if taken.is_empty() {
            return by_scene;
        }
        for entry in self.entries.values_mut().filter(|entry| taken.remove(&entry.job.ticket)) {
            entry.progress = Progress::Loading;
            if !entry.is_prefetch() {
                *by_scene.entry(entry.job.slot.page.scene).or_default() += 1;
            }
        }
        by_scene
    }

    /// Ends the waiting requests that were not renewed for more than `stale_frames`; returns how many.
    pub fn drop_stale(&mut self, frame: u32, stale_frames: u32) -> u64 {
        let mut count = 0;
        self.entries.retain(|_, entry| {
            let age = frame.saturating_sub(entry.wanted_frame);
            if age <= stale_frames || entry.progress != Progress::Waiting {
                return true;
            }
            count += 1;
            entry.job.ticket.trace_end(RequestEnd::Stale);
            entry.end_unwanted()
        });
        count
    }

    /// Makes failures retryable whose back-off is over; their failure counts stay. `expiry_frames` is the time after which
    /// failures are forgotten that no camera meets, if there are too many.
    pub fn retry_due(&mut self, scenes: &mut dyn SceneSet, frame: u32, expiry_frames: u32) {
        let now = Instant::now();
        for entry in self.entries.values_mut().filter(|entry| entry.is_due(now)) {
            scenes.set_failed(entry.job.slot, false);
            entry.progress = Progress::Retryable;
        }
        let failures = || self.entries.values().filter(|entry| entry.has_failed()).count();
        if self.entries.len() > MAX_FAILURES && failures() > MAX_FAILURES {
            let oldest = frame.saturating_sub(expiry_frames.max(MET_FRAMES));
            self.forget_failures_before(scenes, oldest);
        }
    }

    /// Forgets failures whose slots no cull has met since `oldest`; they are requested once more when they are met.
    fn forget_failures_before(&mut self, scenes: &mut dyn SceneSet, oldest: u32) {
        self.entries.retain(|slot, entry| {
            let is_met = scenes.slot(*slot).is_some_and(|slot| slot.last_used_frame >= oldest);
            let is_kept = !entry.has_failed() || is_met;
            if !is_kept {
                scenes.forget_failure(*slot);
            }
            is_kept
        });
    }

    /// Ends the back-off of a failed slot; one without an entry only loses its failure mark.
    pub fn retry_now(&mut self, scenes: &mut dyn SceneSet, slot: NodeId) {
        match self.entries.get_mut(&slot) {
            Some(entry) if !matches!(entry.progress, Progress::Failed { .. }) => return,
            Some(entry) => entry.progress = Progress::Retryable,
            None => {}
        }
        scenes.set_failed(slot, false);
    }

    /// Returns true if the back-off of a failure is over, so that the next update makes it retryable.
    pub fn has_due(&self) -> bool {
        let now = Instant::now();
        self.entries.values().any(|entry| entry.is_due(now))
    }

    /// Replaces the read scope of all requests of a scene.
    pub fn set_scope(&mut self, scene: SceneNumber, scope: &Arc<ReadScope>) {
        for entry in self.entries.values_mut().filter(|entry| entry.job.slot.page.scene == scene) {
            entry.job.scope = scope.clone();
        }
    }
}
