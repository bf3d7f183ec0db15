//! [`ListChanges`]: how waiting requests differ from the request list. Update thread.
//!
//! Under the list's lock the list is changed as much as the requests have changed since the last time, within a limit. While
//! a camera moves, the priorities of all requests change. Then two groups are written: the most urgent now, and those that are
//! still at the front of the list. The threads take no others before the next update. The rest is noted again when the next
//! frame wants it. The limit is a count and not a time, so that equal flights give equal lists.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use lru::LruCache;

use super::entry::{Entry, Progress};
use crate::pager::loading::page_job::PageJob;
use crate::pager::loading::request_list::ListState;
use crate::pager::loading::ticket::Ticket;
use crate::pager::loading::waiting_jobs::Urgency;
use crate::scene::{NodeId, SceneNumber};

/// The changes since the list was last written. The buffers keep their memory.
#[derive(Debug, Default)]
pub(super) struct ListChanges {
    /// Counts how often the noted entries were compared with the list.
    round: u64,
    /// Slots whose waiting entries are not in the list.
    unlisted: Vec<NodeId>,
    /// Waiting entries whose urgency differs from the list's, by scene.
    changed: BTreeMap<SceneNumber, Vec<ChangedUrgency>>,
    /// Jobs that the list has and that do not wait any more.
    removed: Vec<Ticket>,
    /// Jobs to add, with the frame in which each was first requested.
    added: Vec<(PageJob, Urgency, u32)>,
    /// New urgencies of jobs that the list has.
    urgencies: Vec<(Ticket, Urgency)>,
}

/// A waiting entry whose urgency differs from the list's.
#[derive(Clone, Copy, Debug)]
struct ChangedUrgency {
    slot: NodeId,
    now: Urgency,
    listed: Urgency,
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

    /// Notes that a job does not wait any more, if the list has it. Returns true if it has.
    pub fn note_removed(&mut self, entry: &mut Entry) -> bool {
        let is_listed = entry.listed.take().is_some();
        if is_listed {
            self.removed.push(entry.job.ticket);
        }
        is_listed
    }

    /// Compares the noted entries with the list: all new ones, and of those whose urgency has changed the `max_changed` most
    /// urgent ones by their new urgency and as many by the urgency in the list. Scenes share these numbers.
    pub fn collect_noted(&mut self, waiting: &mut LruCache<NodeId, Entry>, max_changed: usize) {
        self.round += 1;
        let (mut unlisted, mut changed) = (std::mem::take(&mut self.unlisted), std::mem::take(&mut self.changed));
        changed.retain(|_, of_scene| !of_scene.is_empty());
        let share = max_changed.div_ceil(changed.len().max(1));
        let written = changed.values_mut().flat_map(|of_scene| {
            let count = select(of_scene, share, |entry| entry.now);
            let count = count + select(&mut of_scene[count..], share, |entry| entry.listed);
            of_scene.drain(..).take(count).map(|entry| entry.slot)
        });
        for slot in unlisted.drain(..).chain(written) {
            let Some(entry) = waiting.peek_mut(&slot) else { continue };
            if !entry.is_prefetch() && entry.known_size.is_none() {
                self.compare(entry, true);
            }
        }
        (self.unlisted, self.changed) = (unlisted, changed);
    }

    /// Notes the difference between an entry and the list, which has its job from now on if `is_listed`.
    pub fn compare(&mut self, entry: &mut Entry, is_listed: bool) {
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

    /// Writes the changes to the list.
    pub fn write(&mut self, list: &mut ListState<PageJob>) {
        self.removed.drain(..).for_each(|ticket| list.remove(ticket));
        self.added.drain(..).for_each(|(job, urgency, first_frame)| list.insert(job, urgency, first_frame));
        list.set_urgencies(&self.urgencies);
        self.urgencies.clear();
    }
}

/// Moves the greatest by `urgency` to the front, `max` at most; returns how many these are.
fn select(changed: &mut [ChangedUrgency], max: usize, urgency: impl Fn(&ChangedUrgency) -> Urgency) -> usize {
    if changed.len() > max {
        changed.select_nth_unstable_by_key(max, |entry| (Reverse(urgency(entry)), entry.slot));
    }
    changed.len().min(max)
}
