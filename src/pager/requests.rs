//! What is asked for: requests of culls become entries, and entries the list that the threads take from. Update thread.

use std::collections::{BTreeMap, HashSet};
use std::sync::Arc;
use std::time::Instant;

use super::DatabasePager;
use super::entry::{Entry, Progress};
use super::expiry::{AHEAD_MARGIN, EXPIRY_TENTHS, less_tenths};
use super::job::Job;
use super::list::Waiting;
use super::scenes::Scenes;
use super::shares::Held;
use super::tries::Tries;
use crate::cull::PageRequest;
use crate::io;
use crate::scene::{NodeId, SceneNumber, SlotState};
use crate::timeline;

/// Of each decode thread, decoded pages may hold about so many bytes while they wait for their upload; beyond that nothing
/// is loaded. What a thread decodes while the main thread has a frame to make.
const MOST_PENDING_BYTES: u64 = 8 << 20;
/// But so many pages may, however large they are.
const LEAST_PENDING: u64 = 2;

/// Waiting contents that are wanted only later are listed for so many times as many as may be under way: enough until the
/// list is written again.
const AHEAD_LISTED: usize = 32;

/// What was met in the last so many frames is seen.
const MET_FRAMES: u32 = 2;

/// After a page that was tried for its size had no room, the next is tried in so many frames; each time in twice as many.
const TRY_ROOM_FRAMES: std::ops::RangeInclusive<u32> = 8..=128;

/// Of what the application asked for: before all that cameras want, whatever options make of that.
const ASKED_PRIORITY: f32 = f32::INFINITY;

/// Failures that are remembered: frames look through them. With more, those are forgotten that nobody meets.
const MOST_FAILURES: usize = 4096;

/// What is wanted later and found no free room.
#[derive(Clone, Copy, Debug)]
pub(super) struct AheadShort {
    /// Frames until the soonest is wanted; what is not wanted for longer gives way to it.
    pub frames: u32,
    /// How many are wanted about as soon.
    pub count: u64,
}

impl DatabasePager {
    /// Takes up new requests and renews those that are known. Whether there are new ones, or one is wanted now that was
    /// wanted later.
    pub(super) fn accept(&mut self, scenes: &dyn Scenes, requests: &[PageRequest]) -> bool {
        self.claim_first(scenes);
        let known = self.next_ticket;
        let mut is_sooner = false;
        for request in requests {
            if let Some(entry) = self.entries.get_mut(&request.slot) {
                is_sooner |= request.ahead_frames == 0 && entry.is_ahead();
                let priority = entry.paging.priority(request.priority);
                self.is_listed &= entry.priority == priority;
                if entry.wanted_frame == self.frame {
                    entry.priority = entry.priority.max(priority);
                    entry.ahead_frames = entry.ahead_frames.min(request.ahead_frames);
                } else {
                    entry.priority = priority;
                    entry.ahead_frames = request.ahead_frames;
                    entry.wanted_frame = self.frame;
                }
                if matches!(entry.progress, Progress::Resting)
                    && let Some(rested) = self.entries.remove(&request.slot)
                {
                    self.ask_again(rested);
                }
                continue;
            }
            let Some(slot) = scenes.slot(request.slot) else { continue };
            if slot.state != SlotState::Empty || !self.takes_requests {
                continue;
            }
            let Some(served) = self.served.get(&slot.page.scene) else { continue };
            let mut above = self.above.get(&slot.page).unwrap_or(&served.above_roots).clone();
            if !above.chain.is_empty() {
                above.set_from_page *= slot.content_transform;
            }
            let job = Job {
                ticket: self.next_ticket,
                slot: request.slot,
                uri: slot.uri.clone(),
                reader_data: slot.reader_data.cloned(),
                above,
                scope: served.scope.clone(),
                is_ahead: request.ahead_frames > 0,
                stage: Arc::default(),
            };
            timeline::request_begins(self.threads.list.ticket_source | job.ticket, &job.uri);
            self.next_ticket += 1;
            self.stats.requested += 1;
            let entry = Entry {
                job,
                priority: slot.paging.priority(request.priority),
                paging: slot.paging,
                asked_frame: self.frame,
                wanted_frame: self.frame,
                ahead_frames: request.ahead_frames,
                since: Instant::now(),
                tries: Tries::default(),
                needs: None,
                progress: Progress::Waiting,
            };
            self.entries.insert(request.slot, entry);
            self.is_listed = false;
        }
        is_sooner || self.next_ticket != known
    }

    /// Takes up, and renews, what is to be loaded whatever cameras see.
    pub(super) fn accept_asked(&mut self, scenes: &mut dyn Scenes) {
        let entries = &self.entries;
        self.asked.retain(|slot| match scenes.slot(*slot).map(|slot| slot.state) {
            Some(SlotState::Empty) => true,
            Some(SlotState::Failed) => entries.get(slot).is_some_and(Entry::will_be_tried),
            _ => false,
        });
        for place in 0.. {
            let Some(scene) = scenes.at_mut(place) else { break };
            let asked = scene.take_asked();
            if asked.is_empty() {
                continue;
            }
            let mut known: HashSet<NodeId> = self.asked.iter().copied().collect();
            for slot in asked.into_iter().filter(|slot| known.insert(*slot)) {
                self.try_now(scenes, slot);
                self.asked.push(slot);
            }
        }
        if self.asked.is_empty() {
            return;
        }
        let request =
            |slot: &NodeId| PageRequest { slot: *slot, priority: ASKED_PRIORITY, error_px: 0.0, ahead_frames: 0 };
        let requests: Vec<PageRequest> = self.asked.iter().map(request).collect();
        self.accept(scenes, &requests);
    }

    /// Ends the wait of what failed.
    fn try_now(&mut self, scenes: &mut dyn Scenes, slot: NodeId) {
        match self.entries.get_mut(&slot).map(|entry| &mut entry.progress) {
            Some(progress @ Progress::Failed { .. }) => *progress = Progress::Resting,
            Some(_) => return,
            None => {}
        }
        scenes.set_failed(slot, false);
    }

    /// Lets failures whose wait is over be asked for again, by whoever wants them: their tries are not forgotten while
    /// nobody does.
    pub(super) fn retry(&mut self, scenes: &mut dyn Scenes) {
        let now = Instant::now();
        for entry in self.entries.values_mut().filter(|entry| entry.is_due(now)) {
            scenes.set_failed(entry.job.slot, false);
            entry.progress = Progress::Resting;
        }
        if self.entries.len() > MOST_FAILURES {
            self.forget_failures(scenes);
        }
    }

    /// Where there are too many, forgets those that were not met for as long as a page must not be wanted to go: they are
    /// asked for once more by who comes back.
    fn forget_failures(&mut self, scenes: &mut dyn Scenes) {
        if self.entries.values().filter(|entry| entry.has_failed()).count() <= MOST_FAILURES {
            return;
        }
        let old = self.frame.saturating_sub(self.config.expiry_frames.max(MET_FRAMES));
        self.entries.retain(|slot, entry| {
            let is_met = scenes.slot(*slot).is_some_and(|slot| slot.last_used_frame >= old);
            let is_kept = !entry.has_failed() || is_met;
            if !is_kept {
                scenes.set_failed(*slot, false);
            }
            is_kept
        });
    }

    /// The wait of a failure is over: after the next update it may be asked for again.
    pub(crate) fn has_due(&self) -> bool {
        let now = Instant::now();
        self.entries.values().any(|entry| entry.is_due(now))
    }

    /// Drops what is stale, aborts what nobody wants, and writes the waiting jobs in order of priority.
    pub(super) fn rewrite_list(&mut self) {
        let frame = self.frame;
        let stale_frames = self.config.stale_frames;
        let list = &self.threads.list;
        let mut waiting = list.lock();
        let mut taken: HashSet<u64> = waiting.taken.drain(..).collect();
        let mut of_scenes: BTreeMap<SceneNumber, u32> = BTreeMap::new();
        if !taken.is_empty() {
            for entry in self.entries.values_mut().filter(|entry| taken.remove(&entry.job.ticket)) {
                entry.progress = Progress::Loading;
                if !entry.is_ahead() {
                    *of_scenes.entry(entry.job.slot.page.scene).or_default() += 1;
                }
            }
            // What is left was forgotten meanwhile.
            if cfg!(feature = "http") {
                waiting.abort.extend(taken);
            }
        }
        let mut stale = 0;
        self.entries.retain(|_, e| {
            let old = frame.saturating_sub(e.wanted_frame) > stale_frames && matches!(e.progress, Progress::Waiting);
            stale += u64::from(old);
            if old {
                timeline::request_ends(self.threads.list.ticket_source | e.job.ticket, "stale");
            }
            !old || e.rests()
        });
        self.stats.stale += stale;
        let mut jobs: Vec<(f32, &Entry)> = Vec::new();
        let mut lacks: Option<(f32, Held)> = None;
        for entry in self.entries.values() {
            match entry.progress {
                Progress::Waiting => match entry.needs.filter(|needs| !self.fits(needs)) {
                    None => jobs.push((entry.priority, entry)),
                    // What is wanted only later makes nothing go.
                    Some(needs) if !entry.is_ahead() && lacks.is_none_or(|(most, _)| entry.priority > most) => {
                        lacks = Some((entry.priority, needs));
                    }
                    Some(_) => {}
                },
                Progress::Loading
                    if cfg!(feature = "http")
                        && io::is_remote(&entry.job.uri)
                        && frame.saturating_sub(entry.wanted_frame) > self.config.abort_frames =>
                {
                    waiting.abort.push(entry.job.ticket);
                }
                _ => {}
            }
        }
        // Taken from the end: the most urgent last.
        jobs.sort_by(|(priority_a, a), (priority_b, b)| {
            let by_priority = priority_a.total_cmp(priority_b).then(b.job.slot.cmp(&a.job.slot));
            b.is_ahead().cmp(&a.is_ahead()).then(by_priority)
        });
        // Of what is wanted later the most urgent; where room is tight, what is wanted about as soon.
        let ahead = jobs.partition_point(|(_, entry)| entry.is_ahead());
        let soonest = jobs[..ahead].iter().map(|(_, entry)| entry.ahead_frames).min();
        self.soon = self.entries.values().filter(|entry| entry.is_soon() && entry.is_under_way()).count() as u64;
        let room = self.room_within(EXPIRY_TENTHS).saturating_sub(waiting.outstanding as u64);
        let takes_any = self.config.ahead_in_flight > 0 && !self.is_paused;
        let short = soonest.filter(|_| takes_any && room < ahead as u64);
        let mut now = jobs.split_off(ahead);
        now.reverse();
        self.long_waits.took(of_scenes.values().sum());
        now = self.long_waits.arrange(now, frame, |(_, entry)| (entry.asked_frame, entry.job.slot));
        if self.served.len() > 1 {
            let scene_of = |(_, entry): &(f32, &Entry)| entry.job.slot.page.scene;
            self.turns.took(&of_scenes, now.iter().map(scene_of));
            now = self.turns.arrange(now, scene_of);
        }
        now.reverse();
        let allowed = self.allowed_in_flight(list.capacity);
        waiting.allowed = self.allowed_or_tried(allowed);
        self.full = waiting.allowed == 0 && !now.is_empty();
        self.is_short = !self.is_paused && allowed < list.capacity.min(waiting.outstanding + now.len());
        jobs.retain(|(_, entry)| {
            short.is_none_or(|soonest| entry.ahead_frames <= soonest.saturating_add(AHEAD_MARGIN))
        });
        let ahead_short = short.map(|frames| AheadShort { frames, count: jobs.len() as u64 });
        jobs.drain(..jobs.len().saturating_sub(AHEAD_LISTED.saturating_mul(self.config.ahead_in_flight)));
        jobs.extend(now);
        waiting.file.clear();
        waiting.http.clear();
        for (_, entry) in &jobs {
            // Without a client the file threads say that there is none.
            let is_remote = cfg!(feature = "http") && io::is_remote(&entry.job.uri);
            let to = if is_remote { &mut waiting.http } else { &mut waiting.file };
            to.push(Job { is_ahead: entry.is_ahead(), ..entry.job.clone() });
        }
        self.allow_ahead(&mut waiting);
        drop(waiting);
        self.ahead_short = ahead_short;
        self.lacks = lacks.filter(|_| !self.is_paused).map(|(_, needs)| needs);
    }

    /// How many loads the budgets have room for, at the mean size so far.
    pub(super) fn allowed_in_flight(&self, capacity: usize) -> usize {
        if self.is_paused {
            return 0;
        }
        // What waits for its upload holds memory besides the budgets'.
        let of_each = (MOST_PENDING_BYTES / self.mean_gpu_bytes.max(1)).max(LEAST_PENDING);
        let pending = (of_each * self.config.decode_threads.max(1) as u64).saturating_sub(self.arrived.pages);
        self.room_within(0).min(pending).min(capacity as u64) as usize
    }

    /// Where no page of the mean size has room, one may be tried: only once it is there its size is known.
    fn allowed_or_tried(&self, allowed: usize) -> usize {
        let has_some = self.fits(&Held { cpu: 1, gpu: 1 });
        let may_try = has_some && !self.is_paused && self.arrived.pages == 0 && self.frame >= self.try_room_frame;
        allowed.max(usize::from(may_try))
    }

    /// One that was tried had room, or had none.
    pub(super) fn tried_room(&mut self, had_room: bool) {
        let (least, most) = TRY_ROOM_FRAMES.into_inner();
        self.try_room_wait = if had_room { 0 } else { (2 * self.try_room_wait).clamp(least, most) };
        self.try_room_frame = self.frame.saturating_add(self.try_room_wait);
    }

    /// A page of known size has room beside what is merged or will be.
    pub(super) fn fits(&self, needs: &Held) -> bool {
        let held = self.held();
        held.cpu + needs.cpu <= self.config.max_bytes_cpu
            && held.gpu + needs.gpu <= self.config.max_bytes_gpu
            && self.pages_held() < self.config.max_tiles as u64
    }

    /// Pages of the mean size that fit into the budgets less so many tenths, beside what is merged or will be.
    pub(super) fn room_within(&self, tenths: u64) -> u64 {
        let held = self.held();
        let room = |max: u64, used: u64, mean: u64| less_tenths(max, tenths).saturating_sub(used) / mean.max(1);
        let cpu = room(self.config.max_bytes_cpu, held.cpu, self.mean_cpu_bytes);
        let gpu = room(self.config.max_bytes_gpu, held.gpu, self.mean_gpu_bytes);
        cpu.min(gpu).min(room(self.config.max_tiles as u64, self.pages_held(), 1))
    }

    /// How many of those wanted only later may be outstanding: as far as there is room beside the others, and not many
    /// beside them, less those that have arrived.
    fn allow_ahead(&self, waiting: &mut Waiting) {
        let arrived = self.compiling.values().chain(&self.ready);
        let arrived = arrived.filter(|slot| self.entries.get(slot).is_some_and(Entry::is_ahead)).count();
        let others = waiting.outstanding.saturating_sub(waiting.ahead_outstanding);
        // What comes into the picture at once may take the rest too.
        let room = self.room_within(EXPIRY_TENTHS).max(self.room_within(0).min(self.soon));
        let room = (room as usize).saturating_sub(others);
        waiting.ahead_room = if self.config.ahead_in_flight > 0 { room } else { 0 };
        waiting.ahead_allowed = self.config.ahead_in_flight.saturating_sub(arrived);
    }

    /// Lets the threads go on when there is more room than the list last said.
    pub(super) fn allow_more(&self) {
        let allowed = self.allowed_or_tried(self.allowed_in_flight(self.threads.list.capacity));
        let mut waiting = self.threads.list.lock();
        waiting.allowed = allowed;
        self.allow_ahead(&mut waiting);
        self.threads.list.ring(waiting);
    }
}
