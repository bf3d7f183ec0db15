//! Writes additions, changes and removals of waiting requests to the request list. Update thread.
//!
//! The jobs to add are copied before the list is locked, and each once while it waits. Under the lock the list is changed
//! as much as the requests have changed since the last time, within a limit. While a camera moves, the priorities of all
//! requests change. Then two groups are written: the most urgent now, and those that are still at the front of the list. The
//! threads take no others before the next update. The rest is noted again when the next frame wants it. The limit is a count and not a
//! time, so that equal flights give equal lists.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use super::entry::{Entry, Progress};
use super::table::RequestTable;
use crate::pager::loading::page_job::PageJob;
use crate::pager::loading::request_list::ListState;
use crate::pager::loading::ticket::Ticket;
use crate::pager::loading::waiting_jobs::Urgency;
use crate::pager::residency::budget::{MemoryUse, Room};
use crate::scene::{NodeId, SceneNumber};

/// The changes since the list was last written; the memory is kept.
#[derive(Debug, Default)]
pub(super) struct ListChanges {
    /// Counts how often the noted entries were compared with the list.
    round: u64,
    /// Slots whose waiting entries are not in the list.
    unlisted: Vec<NodeId>,
    /// Waiting entries whose urgency differs from the list's, by scene.
    changed: BTreeMap<SceneNumber, Vec<ChangedUrgency>>,
    /// Jobs that the list has and that do not wait any more.
    pub removed: Vec<Ticket>,
    /// Jobs to add, with the frame in which each was first requested.
    added: Vec<(PageJob, Urgency, u32)>,
    urgencies: Vec<(Ticket, Urgency)>,
}

/// A waiting entry whose urgency differs from the list's.
#[derive(Clone, Copy, Debug)]
struct ChangedUrgency {
    slot: NodeId,
    now: Urgency,
    listed: Urgency,
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
    /// Collects the entries to write to the list: all new requests, and of those whose urgency has changed the `max_changed` most
    /// urgent ones by their new urgency and as many by the urgency in the list. Scenes share these numbers. Prefetches and requests
    /// of known size follow under the lock, where the number of jobs under way is known.
    pub(super) fn collect_changes(&mut self, max_changed: usize) {
        self.changes.round += 1;
        let (mut unlisted, mut changed) =
            (std::mem::take(&mut self.changes.unlisted), std::mem::take(&mut self.changes.changed));
        changed.retain(|_, of_scene| !of_scene.is_empty());
        let share = max_changed.div_ceil(changed.len().max(1));
        let written = changed.values_mut().flat_map(|of_scene| {
            let count = select(of_scene, share, |entry| entry.now);
            let count = count + select(&mut of_scene[count..], share, |entry| entry.listed);
            of_scene.drain(..).take(count).map(|entry| entry.slot)
        });
        for slot in unlisted.drain(..).chain(written) {
            let Some(entry) = self.waiting.peek_mut(&slot) else { continue };
            if !entry.is_prefetch() && entry.known_size.is_none() {
                self.changes.compare(entry, true);
            }
        }
        (self.changes.unlisted, self.changes.changed) = (unlisted, changed);
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

/// Moves the greatest by `urgency` to the front, `max` at most; returns how many these are.
fn select(changed: &mut [ChangedUrgency], max: usize, urgency: impl Fn(&ChangedUrgency) -> Urgency) -> usize {
    if changed.len() > max {
        changed.select_nth_unstable_by_key(max, |entry| (Reverse(urgency(entry)), entry.slot));
    }
    changed.len().min(max)
}

impl ListChanges {
    /// Notes a waiting entry if it differs from the list, once until the list is written. Prefetches and requests of known
    /// size are compared with it each time.
    pub fn note(&mut self, entry: &mut Entry) {
        let (slot, now) = (entry.job.slot, entry.urgency());
        let is_known = entry.noted_in == self.round + 1 || entry.listed == Some(now);
        if is_known || entry.is_prefetch() || entry.known_size.is_some() {
            return;
        }
        entry.noted_in = self.round + 1;
        match entry.listed {
            None => self.unlisted.push(slot),
            Some(listed) => {
                self.changed.entry(slot.page.scene).or_default().push(ChangedUrgency { slot, now, listed });
            }
        }
    }

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
