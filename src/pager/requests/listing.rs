//! Writes additions, changes and removals of waiting requests to the request list. Update thread.
//!
//! The jobs to add are copied before the list is locked, and each once while it waits. Under the lock the list is changed
//! as much as the requests have changed since the last time. While a camera moves, the priorities of all requests change;
//! that is one pass over as many numbers.

use super::entry::{Entry, Progress};
use super::table::RequestTable;
use crate::pager::loading::page_job::PageJob;
use crate::pager::loading::request_list::ListState;
use crate::pager::loading::ticket::Ticket;
use crate::pager::loading::waiting_jobs::Urgency;
use crate::pager::residency::budget::{MemoryUse, Room};
use crate::scene::NodeId;

/// The changes since the list was last written; the memory is kept.
#[derive(Debug, Default)]
pub(super) struct ListChanges {
    /// Slots whose waiting entries are new or may differ from the list, each once ([`Entry::is_noted`]).
    pub noted: Vec<NodeId>,
    /// Jobs that the list has and that do not wait any more.
    pub removed: Vec<Ticket>,
    /// Jobs to add, with the frame in which each was first requested.
    added: Vec<(PageJob, Urgency, u32)>,
    urgencies: Vec<(Ticket, Urgency)>,
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

impl RequestTable {
    /// Collects what the list does not know yet. Prefetches and requests of known size follow under the lock, where it is
    /// known how many jobs are under way.
    pub(super) fn collect_changes(&mut self) {
        let mut noted = std::mem::take(&mut self.changes.noted);
        for slot in noted.drain(..) {
            let Some(entry) = self.waiting.peek_mut(&slot) else { continue };
            entry.is_noted = false;
            if !entry.is_prefetch() && entry.known_size.is_none() {
                self.changes.compare(entry, true);
            }
        }
        self.changes.noted = noted;
    }

    /// Lists the requests of known size that have room, and takes the others out. Returns the size of the most urgent one
    /// without room, and how many have none; neither counts prefetches, for which no page expires.
    pub(super) fn list_sized(&mut self, room: &Room) -> (Option<MemoryUse>, usize) {
        let mut blocked: Option<(Urgency, Ticket, MemoryUse)> = None;
        let mut count = 0;
        for slot in &self.sized {
            let Some(entry) = self.waiting.peek_mut(slot).filter(|entry| !entry.is_prefetch()) else { continue };
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
    pub(super) fn waiting_prefetches(&self, room: &Room) -> WaitingPrefetches {
        let prefetches = self.prefetches.iter().filter_map(|slot| self.waiting.peek(slot));
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
            let Some(entry) = self.waiting.peek_mut(slot) else { continue };
            let is_listed = entry.ahead_frames <= latest && has_room(entry, room);
            self.changes.compare(entry, is_listed);
            count += usize::from(is_listed);
        }
        count
    }

    /// Writes the collected changes to the list.
    pub(super) fn write_changes(&mut self, list: &mut ListState<PageJob>) {
        let ListChanges { removed, added, urgencies, .. } = &mut self.changes;
        removed.drain(..).for_each(|ticket| list.remove(ticket));
        added.drain(..).for_each(|(job, urgency, first_frame)| list.insert(job, urgency, first_frame));
        list.set_urgencies(urgencies);
        urgencies.clear();
    }
}

impl ListChanges {
    /// Notes the difference between an entry and the list.
    fn compare(&mut self, entry: &mut Entry, is_listed: bool) {
        debug_assert_eq!(entry.progress, Progress::Waiting);
        let urgency = entry.urgency();
        match entry.listed {
            None if is_listed => self.added.push((entry.job.clone(), urgency, entry.first_frame)),
            Some(_) if !is_listed => self.removed.push(entry.job.ticket),
            Some(before) if before != urgency => self.urgencies.push((entry.job.ticket, urgency)),
            _ => return,
        }
        entry.listed = is_listed.then_some(urgency);
    }
}
