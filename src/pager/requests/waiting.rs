//! [`WaitingRequests`]: the requests that wait for a thread, and which of them the request list has. Update thread.

use std::collections::HashSet;
use std::sync::Arc;

use lru::LruCache;

use super::entry::{Entry, Progress};
use super::list_changes::ListChanges;
use crate::cull::PageRequest;
use crate::pager::loading::page_job::PageJob;
use crate::pager::loading::request_list::ListState;
use crate::pager::loading::ticket::{RequestEnd, Ticket, TicketIssuer};
use crate::pager::loading::waiting_jobs::Urgency;
use crate::pager::residency::budget::{MemoryUse, Room};
use crate::pager::scenes::read_scope::ReadScope;
use crate::scene::{NodeId, SceneNumber};

/// The requests that wait for a thread, in the order in which they were last renewed. So stale ones are found without a look at
/// the others.
#[derive(Debug)]
pub(in crate::pager) struct WaitingRequests {
    /// The request renewed longest ago is the least recently used.
    entries: LruCache<NodeId, Entry>,
    /// The requests that are prefetches. They are looked at in no order.
    prefetches: HashSet<NodeId>,
    /// The requests whose size is known, since they were declined. They are looked at in no order.
    sized: HashSet<NodeId>,
    /// Changes that the request list does not have yet.
    changes: ListChanges,
}

/// The prefetches that wait, as far as they have room by their known size.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct WaitingPrefetches {
    pub count: usize,
    /// Frames until the soonest is needed.
    pub soonest: Option<u32>,
    /// The number that is needed in one of the next frames.
    pub soon: u64,
}

fn has_room(entry: &Entry, room: &Room) -> bool {
    entry.known_size.is_none_or(|size| room.fits(size))
}

impl WaitingRequests {
    pub fn new() -> Self {
        Self {
            entries: LruCache::unbounded(),
            prefetches: HashSet::new(),
            sized: HashSet::new(),
            changes: ListChanges::default(),
        }
    }

    /// Returns the number of requests.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Returns the number of requests that are not prefetches.
    pub fn wanted_now(&self) -> usize {
        self.entries.len() - self.prefetches.len()
    }

    /// Returns the entry of a slot.
    pub fn get(&self, slot: NodeId) -> Option<&Entry> {
        self.entries.peek(&slot)
    }

    /// Returns all entries, in no order.
    pub fn iter(&self) -> impl Iterator<Item = (&NodeId, &Entry)> + Clone + '_ {
        self.entries.iter()
    }

    /// Returns the one that was renewed longest ago.
    pub fn oldest(&self) -> Option<&Entry> {
        self.entries.peek_lru().map(|(_, entry)| entry)
    }

    /// Returns true if a request that is no prefetch has room as far as its size is known.
    pub fn has_any_that(&self, fits: impl Fn(&Entry) -> bool) -> bool {
        let sized = self.sized.iter().filter_map(|slot| self.get(*slot)).filter(|entry| !entry.is_prefetch());
        self.wanted_now() > sized.filter(|entry| !fits(entry)).count()
    }

    /// Inserts an entry that waits from now on.
    pub fn insert(&mut self, mut entry: Entry) {
        let slot = entry.job.slot;
        entry.progress = Progress::Waiting;
        (entry.listed, entry.noted_in) = (None, 0);
        self.changes.note(&mut entry);
        if entry.is_prefetch() {
            self.prefetches.insert(slot);
        }
        if entry.known_size.is_some() {
            self.sized.insert(slot);
        }
        self.entries.put(slot, entry);
    }

    /// Removes an entry, and its job from the list.
    pub fn remove(&mut self, slot: NodeId) -> Option<Entry> {
        let mut entry = self.entries.pop(&slot)?;
        self.prefetches.remove(&slot);
        self.sized.remove(&slot);
        self.changes.note_removed(&mut entry);
        Some(entry)
    }

    /// Renews the request for a slot. Returns true if a prefetch has become wanted now; `None` if the slot has no entry.
    pub fn renew(&mut self, request: &PageRequest, frame: u32) -> Option<bool> {
        let entry = self.entries.get_mut(&request.slot)?;
        let was_prefetch = entry.is_prefetch();
        entry.renew(request, frame);
        self.changes.note(entry);
        match entry.is_prefetch() {
            true if !was_prefetch => drop(self.prefetches.insert(request.slot)),
            false if was_prefetch => drop(self.prefetches.remove(&request.slot)),
            _ => {}
        }
        Some(was_prefetch && request.ahead_frames == 0)
    }

    /// Replaces the read scope of all requests of a scene.
    pub fn set_scope(&mut self, scene: SceneNumber, scope: &Arc<ReadScope>, tickets: &mut TicketIssuer) {
        for (_, entry) in self.entries.iter_mut().filter(|(slot, _)| slot.page.scene == scene) {
            entry.job.scope = scope.clone();
            // The list, or a thread that took the job meanwhile, has a copy of it: that one is of an earlier attempt now.
            if self.changes.note_removed(entry) {
                entry.job.ticket.trace_end(RequestEnd::Dropped);
                entry.job.ticket = tickets.issue();
                entry.job.progress = Arc::default();
                entry.job.ticket.trace_begin(&entry.job.uri);
                entry.noted_in = 0;
            }
            self.changes.note(entry);
        }
    }

    /// Collects the changes to write to the list, at most `max_changed` of urgencies; see [`ListChanges::collect_noted`]. The
    /// jobs to add are copied here, before the list is locked, and each once while it waits. Prefetches and requests of known
    /// size follow under the lock, where the number of jobs under way is known.
    pub(super) fn collect_changes(&mut self, max_changed: usize) {
        self.changes.collect_noted(&mut self.entries, max_changed);
    }

    /// Lists the requests of known size that have room, and takes the others out. Returns the size of the most urgent one
    /// without room, and how many have none; neither counts prefetches, for which no page expires.
    pub(super) fn list_sized(&mut self, room: &Room) -> (Option<MemoryUse>, usize) {
        let mut blocked: Option<(Urgency, Ticket, MemoryUse)> = None;
        let mut count = 0;
        for slot in &self.sized {
            let Some(entry) = self.entries.peek_mut(slot).filter(|entry| !entry.is_prefetch()) else { continue };
            let fits = has_room(entry, room);
            self.changes.compare(entry, fits);
            if let (false, Some(size)) = (fits, entry.known_size) {
                count += 1;
                let (urgency, ticket) = (entry.urgency(), entry.job.ticket);
                // The oldest of several equally urgent ones counts, since the set has no order.
                if blocked.is_none_or(|(highest, of, _)| urgency > highest || urgency == highest && ticket < of) {
                    blocked = Some((urgency, ticket, size));
                }
            }
        }
        (blocked.map(|(_, _, size)| size), count)
    }

    /// Returns the prefetches that wait.
    pub(super) fn prefetches(&self, room: &Room) -> WaitingPrefetches {
        let prefetches = self.prefetches.iter().filter_map(|slot| self.entries.peek(slot));
        prefetches.filter(|entry| has_room(entry, room)).fold(WaitingPrefetches::default(), |sum, entry| {
            let soonest = sum.soonest.map_or(entry.ahead_frames, |frames| frames.min(entry.ahead_frames));
            let soon = sum.soon + u64::from(entry.is_soon());
            WaitingPrefetches { count: sum.count + 1, soonest: Some(soonest), soon }
        })
    }

    /// Lists the prefetches that are needed within `latest` frames, and takes the others out. Returns how many are listed.
    pub(super) fn list_prefetches(&mut self, room: &Room, latest: u32) -> usize {
        let mut count = 0;
        for slot in &self.prefetches {
            let Some(entry) = self.entries.peek_mut(slot) else { continue };
            let is_listed = entry.ahead_frames <= latest && has_room(entry, room);
            self.changes.compare(entry, is_listed);
            count += usize::from(is_listed);
        }
        count
    }

    /// Writes the collected changes to the list.
    pub(super) fn write_changes(&mut self, list: &mut ListState<PageJob>) {
        self.changes.write(list);
    }
}
