//! [`RequestTable`]: all requests for contents that are not merged, by slot. Update thread.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

use super::entry::{Entry, Progress};
use super::retry_policy::RetryState;
use super::waiting::WaitingRequests;
use crate::cull::PageRequest;
use crate::formats::TileVolume;
use crate::pager::loading::page_job::{LoadStage, PageJob};
use crate::pager::loading::ticket::{RequestEnd, TicketIssuer};
use crate::pager::loading::waiting_jobs::Urgency;
use crate::pager::scenes::read_scope::{ReadScope, TilesetAncestors};
use crate::pager::scenes::scene_set::SceneSet;
use crate::scene::{NodeId, PagingOptions, ReaderData, SceneNumber, SlotInfo};

/// Failures that are remembered. Beyond that, those are forgotten that no camera meets.
const MAX_FAILURES: usize = 4096;

/// The priority of a content that continues a tile tree, in multiples of that of its tile. It is small, and the contents of the
/// tiles in it cannot be requested before: each of them costs one round trip more.
const TREE_PRIORITY_SCALE: f32 = 4.0;

/// The effect of accepting requests.
#[derive(Debug, Default)]
pub(in crate::pager) struct Changes {
    /// Requests for contents that were not requested before.
    pub requested: u64,
    /// Contents that failed before and are requested again.
    pub retried: u64,
    /// True if a prefetch is wanted now.
    pub has_sooner: bool,
    /// Arrived pages whose urgency has changed.
    pub rearranged: Vec<(NodeId, Urgency)>,
}

impl Changes {
    /// Returns true if there is something new to load, or something is wanted sooner.
    pub fn has_new(&self) -> bool {
        self.requested + self.retried > 0 || self.has_sooner
    }
}

/// All requests for contents that are not merged, by slot, and the failures that are remembered. Update thread.
///
/// Requests that wait for a thread are apart, so that a frame that changes nothing examines only what is under way.
#[derive(Debug)]
pub(in crate::pager) struct RequestTable {
    waiting: WaitingRequests,
    /// Requests that are loading or have arrived.
    begun: HashMap<NodeId, Entry>,
    /// Requests that have failed. No update looks at all of them, unless the back-off of one is over.
    failed: HashMap<NodeId, Entry>,
    /// The end of the first back-off, or an earlier moment; `None` if nothing will be retried.
    next_retry: Option<Instant>,
    tickets: TicketIssuer,
}

/// Returns the options of a slot's tile as they apply to the kind of its content.
fn paging(slot: &SlotInfo<'_>) -> PagingOptions {
    let mut paging = slot.paging;
    if slot.reader_data.is_some_and(ReaderData::continues_tileset) {
        paging.priority_scale *= TREE_PRIORITY_SCALE;
    }
    paging
}

impl RequestTable {
    pub fn new() -> Self {
        Self {
            waiting: WaitingRequests::new(),
            begun: HashMap::new(),
            failed: HashMap::new(),
            next_retry: None,
            tickets: TicketIssuer::new(),
        }
    }

    /// Issues no ticket number that `before` has issued.
    pub fn continue_from(&mut self, before: &Self) {
        self.tickets.continue_from(&before.tickets);
    }

    /// Returns the entry of a slot.
    pub fn get(&self, slot: NodeId) -> Option<&Entry> {
        self.waiting.get(slot).or_else(|| self.begun.get(&slot)).or_else(|| self.failed.get(&slot))
    }

    /// Returns the entry that a job belongs to; `None` if the job is of an earlier attempt or its slot is gone.
    pub fn of_job(&self, job: &PageJob) -> Option<&Entry> {
        self.get(job.slot).filter(|entry| entry.job.ticket == job.ticket)
    }

    /// Returns all entries, in no order.
    pub fn iter(&self) -> impl Iterator<Item = (NodeId, &Entry)> + Clone + '_ {
        self.waiting.iter().chain(&self.begun).chain(&self.failed).map(|(slot, entry)| (*slot, entry))
    }

    /// Returns the entries that are loading or have arrived, in no order.
    pub fn begun(&self) -> impl Iterator<Item = (NodeId, &Entry)> + '_ {
        self.begun.iter().map(|(slot, entry)| (*slot, entry))
    }

    /// Returns the requests that wait for a thread.
    pub fn waiting(&self) -> &WaitingRequests {
        &self.waiting
    }

    /// Returns the requests that wait for a thread, to write them to the request list.
    pub(super) fn waiting_mut(&mut self) -> &mut WaitingRequests {
        &mut self.waiting
    }

    /// Removes the entry of a slot.
    pub fn remove(&mut self, slot: NodeId) -> Option<Entry> {
        self.waiting.remove(slot).or_else(|| self.begun.remove(&slot)).or_else(|| self.failed.remove(&slot))
    }

    /// Changes an entry that does not wait any more, and returns the result.
    pub fn begin<R>(&mut self, slot: NodeId, change: impl FnOnce(&mut Entry) -> R) -> Option<R> {
        let mut entry = self.remove(slot)?;
        let result = change(&mut entry);
        self.insert_begun(entry);
        Some(result)
    }

    /// Inserts an entry that does not wait.
    fn insert_begun(&mut self, entry: Entry) {
        if let Progress::Failed { retry_at: Some(at) } = entry.progress {
            self.next_retry = Some(self.next_retry.map_or(at, |next| next.min(at)));
        }
        let entries = if entry.has_failed() { &mut self.failed } else { &mut self.begun };
        entries.insert(entry.job.slot, entry);
    }

    /// Removes and returns the entries for which `condition` holds.
    pub fn extract_if(&mut self, condition: impl Fn(NodeId, &Entry) -> bool) -> Vec<Entry> {
        let slots: Vec<NodeId> =
            self.iter().filter(|(slot, entry)| condition(*slot, entry)).map(|(slot, _)| slot).collect();
        slots.into_iter().filter_map(|slot| self.remove(slot)).collect()
    }

    /// Renews the request for a known slot. Returns false if the slot has no entry.
    pub fn renew(&mut self, request: &PageRequest, frame: u32, changes: &mut Changes) -> bool {
        let slot = request.slot;
        if let Some(is_sooner) = self.waiting.renew(request, frame) {
            changes.has_sooner |= is_sooner;
            return true;
        }
        let Some(entry) = self.begun.get_mut(&slot).or_else(|| self.failed.get_mut(&slot)) else { return false };
        changes.has_sooner |= request.ahead_frames == 0 && entry.is_prefetch();
        let before = entry.urgency();
        entry.renew(request, frame);
        match entry.progress {
            Progress::Retryable => {
                if let Some(entry) = self.failed.remove(&slot) {
                    self.requeue(entry);
                    changes.retried += 1;
                }
            }
            Progress::Arrived if entry.urgency() != before => changes.rearranged.push((slot, entry.urgency())),
            _ => {}
        }
        true
    }

    /// Returns how urgent a request for a slot is that has no entry.
    pub fn urgency(request: &PageRequest, slot: &SlotInfo<'_>) -> Urgency {
        Urgency::new(paging(slot).priority(request.priority), request.ahead_frames > 0)
    }

    /// Adds a request for a slot that has no entry.
    pub fn add(
        &mut self,
        request: &PageRequest,
        slot: &SlotInfo<'_>,
        ancestors: TilesetAncestors,
        scope: Arc<ReadScope>,
        tile: Option<TileVolume>,
        frame: u32,
    ) {
        let job = PageJob {
            ticket: self.tickets.issue(),
            slot: request.slot,
            uri: slot.uri.clone(),
            reader_data: slot.reader_data.cloned(),
            ancestors,
            scope,
            tile,
            is_prefetch: request.ahead_frames > 0,
            progress: Arc::default(),
        };
        job.ticket.trace_begin(&job.uri);
        let paging = paging(slot);
        let entry = Entry {
            job,
            priority: paging.priority(request.priority),
            paging,
            first_frame: frame,
            wanted_frame: frame,
            ahead_frames: request.ahead_frames,
            since: Instant::now(),
            retries: RetryState::default(),
            known_size: None,
            progress: Progress::Waiting,
            listed: None,
            noted_in: 0,
        };
        self.waiting.insert(entry);
    }

    /// Inserts a removed entry as a new attempt that waits.
    pub fn requeue(&mut self, mut entry: Entry) {
        entry.job.ticket = self.tickets.issue();
        entry.job.progress.set(LoadStage::Waiting);
        entry.job.ticket.trace_begin(&entry.job.uri);
        self.waiting.insert(entry);
    }

    /// Marks the entry of a job that a thread has taken. Returns false if the job has lost its entry.
    pub fn mark_loading(&mut self, job: &PageJob) -> bool {
        if self.of_job(job).is_none() {
            return false;
        }
        self.begin(job.slot, |entry| {
            if entry.progress == Progress::Waiting {
                entry.progress = Progress::Loading;
            }
        });
        true
    }

    /// Ends at most `max` of the waiting requests for which `is_stale` holds of the frame in which they were last wanted, those
    /// first that were renewed longest ago; returns how many.
    pub fn drop_stale(&mut self, max: usize, is_stale: impl Fn(u32) -> bool) -> usize {
        let mut count = 0;
        while count < max
            && let Some(oldest) = self.waiting.oldest()
            && is_stale(oldest.wanted_frame)
        {
            let slot = oldest.job.slot;
            self.end_stale(slot);
            count += 1;
        }
        count
    }

    /// Returns true if `is_stale` holds of the frame in which a waiting request was last wanted.
    pub fn has_stale(&self, is_stale: impl Fn(u32) -> bool) -> bool {
        self.waiting.oldest().is_some_and(|entry| is_stale(entry.wanted_frame))
    }

    /// Ends a waiting request that is stale.
    pub fn end_stale(&mut self, slot: NodeId) {
        let Some(mut entry) = self.waiting.remove(slot) else { return };
        entry.job.ticket.trace_end(RequestEnd::Stale);
        if entry.end_unwanted() {
            self.insert_begun(entry);
        }
    }

    /// Makes failures retryable whose back-off is over; their failure counts stay. If there are too many, those are forgotten
    /// whose slots no camera has met for long: `is_unused` holds of the frame in which a cull last met the slot.
    pub fn retry_due(&mut self, scenes: &mut dyn SceneSet, is_unused: impl Fn(u32) -> bool) {
        if self.has_due() {
            let now = Instant::now();
            for entry in self.failed.values_mut().filter(|entry| entry.is_due(now)) {
                scenes.set_failed(entry.job.slot, false);
                entry.progress = Progress::Retryable;
            }
            self.next_retry = self.failed.values().filter_map(Entry::retry_at).min();
        }
        if self.failed.len() > MAX_FAILURES {
            self.forget_failures(scenes, is_unused);
        }
    }

    /// Forgets failures whose slots no cull has met for long; they are requested once more when they are met.
    fn forget_failures(&mut self, scenes: &mut dyn SceneSet, is_unused: impl Fn(u32) -> bool) {
        self.failed.retain(|slot, _| {
            let is_met = scenes.slot(*slot).is_some_and(|slot| !is_unused(slot.last_used_frame));
            if !is_met {
                scenes.forget_failure(*slot);
            }
            is_met
        });
    }

    /// Ends the back-off of a failed slot; one without an entry only loses its failure mark.
    pub fn retry_now(&mut self, scenes: &mut dyn SceneSet, slot: NodeId) {
        match self.failed.get_mut(&slot) {
            Some(entry) if !matches!(entry.progress, Progress::Failed { .. }) => return,
            Some(entry) => entry.progress = Progress::Retryable,
            None if self.waiting.get(slot).is_some() || self.begun.contains_key(&slot) => return,
            None => {}
        }
        scenes.set_failed(slot, false);
    }

    /// Returns true if the back-off of a failure may be over, so that the next update makes it retryable.
    pub fn has_due(&self) -> bool {
        self.next_retry.is_some_and(|at| at <= Instant::now())
    }

    /// Replaces the read scope of all requests of a scene.
    pub fn set_scope(&mut self, scene: SceneNumber, scope: &Arc<ReadScope>) {
        self.waiting.set_scope(scene, scope, &mut self.tickets);
        let of_scene = |entry: &&mut Entry| entry.job.slot.page.scene == scene;
        for entry in self.begun.values_mut().chain(self.failed.values_mut()).filter(of_scene) {
            entry.job.scope = scope.clone();
        }
    }
}
