//! What budgets are reckoned against: merged pages and those that have arrived and wait for their uploads or their merge,
//! together never more than they allow. Update thread.
//!
//! How much a page takes on the CPU is known when it arrives, on the GPU only once it was uploaded: while it is, the mean of
//! the last pages is reserved for it, and it waits for others where that is not free. One that turns out to be larger than
//! the room is given up at once, and asked for again when there is room for it.

use std::time::Duration;

use super::DatabasePager;
use super::config::CompileContext;
use super::entry::{Arrived, Entry, Payload, Progress};
use super::expiry::{EXPIRY_LOOKS, UNSEEN};
use super::scenes::Scenes;
use super::shares::Held;
use crate::gpu::{CompileBudget, CompileOperation};
use crate::scene::NodeId;
use crate::timeline;

/// Sums over the pages that have arrived.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct ArrivedSum {
    pub pages: u64,
    /// Of these, being uploaded.
    pub uploading: u64,
    /// In memory.
    pub known: Held,
    /// What their uploads may take besides.
    pub reserved_gpu: u64,
}

impl ArrivedSum {
    /// A page counts.
    pub fn add(&mut self, arrived: &Arrived) {
        self.pages += 1;
        self.uploading += u64::from(arrived.is_uploading());
        self.known.cpu += arrived.counts.cpu;
        self.known.gpu += arrived.counts.gpu;
        self.reserved_gpu += arrived.reserved_gpu;
    }

    /// The same page counts no more.
    pub fn take(&mut self, arrived: &Arrived) {
        self.pages -= 1;
        self.uploading -= u64::from(arrived.is_uploading());
        self.known.cpu -= arrived.counts.cpu;
        self.known.gpu -= arrived.counts.gpu;
        self.reserved_gpu -= arrived.reserved_gpu;
    }
}

impl DatabasePager {
    /// In memory for merged pages and those that have arrived, what they share once.
    pub(super) fn in_memory(&self) -> Held {
        Held {
            cpu: self.residents.cpu_bytes + self.arrived.known.cpu + self.shares.all.cpu,
            gpu: self.residents.gpu_bytes + self.arrived.known.gpu + self.shares.all.gpu,
        }
    }

    /// That, and what is reserved for uploads.
    pub(super) fn held(&self) -> Held {
        let known = self.in_memory();
        Held { gpu: known.gpu + self.arrived.reserved_gpu, ..known }
    }

    /// Merged or arrived.
    pub(super) fn pages_held(&self) -> u64 {
        self.residents.len() as u64 + self.arrived.pages
    }

    fn is_over(&self, held: Held) -> bool {
        held.cpu > self.config.max_bytes_cpu
            || held.gpu > self.config.max_bytes_gpu
            || self.pages_held() > self.config.max_tiles as u64
    }

    /// What the upload of a page may take whose drawables have so many bytes, to so many contexts.
    fn may_take_gpu(&self, payload_bytes: u64, contexts: usize) -> u64 {
        let first = || payload_bytes.saturating_mul(contexts as u64).min(self.config.max_bytes_gpu);
        if self.mean_gpu_bytes > 0 { self.mean_gpu_bytes } else { first() }
    }

    /// Expires what is in no picture, and gives up what has arrived and finds no room beside what is more urgent, until the
    /// budgets hold. For what is wanted only later nothing goes.
    pub(super) fn keep_budgets(&mut self, scenes: &mut dyn Scenes, contexts: &mut [&mut dyn CompileContext]) {
        let mut looks = self.residents.len().min(4 * EXPIRY_LOOKS.end());
        while self.is_over(self.in_memory()) {
            let lacks_room = self.lacks_room();
            if !lacks_room.is_some_and(|(_, is_ahead)| is_ahead)
                && let Some(id) = self.residents.pop_expired(scenes, self.frame, UNSEEN, &mut looks)
            {
                self.detach(scenes, id, contexts);
                continue;
            }
            let Some((slot, _)) = lacks_room else { break };
            self.decline(slot, contexts);
        }
        let (held, pages, s) = (self.in_memory(), self.pages_held(), &mut self.stats);
        s.cpu_bytes_held_peak = s.cpu_bytes_held_peak.max(held.cpu);
        s.gpu_bytes_held_peak = s.gpu_bytes_held_peak.max(held.gpu);
        s.held_peak = s.held_peak.max(pages);
    }

    /// Begins uploads, the most urgent first, as far as there is room for what they may take. One at a time goes on
    /// whatever it may take: how much it does is seen then.
    pub(super) fn begin_uploads(&mut self, scenes: &mut dyn Scenes, contexts: &mut [&mut dyn CompileContext]) {
        if self.uploads.is_empty() {
            return;
        }
        let mut waiting: Vec<(NodeId, &Entry)> =
            self.uploads.iter().filter_map(|slot| Some((*slot, self.entries.get(slot)?))).collect();
        waiting.sort_by(|(_, a), (_, b)| by_urgency(a, b));
        let waiting: Vec<NodeId> = waiting.into_iter().map(|(slot, _)| slot).collect();
        let mut looks = self.residents.len().min(4 * EXPIRY_LOOKS.end());
        let mut begun = 0;
        for slot in &waiting {
            let Some(entry) = self.entries.get(slot) else { continue };
            let Progress::Arrived(Arrived { payload: Some(payload), contexts_left, .. }) = &entry.progress else {
                continue;
            };
            let (is_ahead, may_take) = (entry.is_ahead(), self.may_take_gpu(payload.bytes, *contexts_left));
            let has_room = |pager: &Self| pager.held().gpu + may_take <= pager.config.max_bytes_gpu;
            while !is_ahead
                && !has_room(self)
                && let Some(id) = self.residents.pop_expired(scenes, self.frame, UNSEEN, &mut looks)
            {
                self.detach(scenes, id, contexts);
            }
            if !has_room(self) && self.arrived.uploading > 0 {
                break;
            }
            self.begin_upload(*slot, may_take, contexts);
            begun += 1;
        }
        self.uploads = waiting;
        self.uploads.drain(..begun.min(self.uploads.len()));
    }

    fn begin_upload(&mut self, slot: NodeId, may_take_gpu: u64, contexts: &mut [&mut dyn CompileContext]) {
        let Some(entry) = self.entries.get_mut(&slot) else { return };
        let Progress::Arrived(arrived) = &mut entry.progress else { return };
        self.arrived.take(arrived);
        let payload = arrived.payload.take();
        arrived.reserved_gpu = may_take_gpu;
        self.arrived.add(arrived);
        let (ticket, last) = (entry.job.ticket, contexts.len().saturating_sub(1));
        let Some(Payload { drawables, kinds, .. }) = payload else { return };
        let mut drawables = Some(drawables);
        for (i, context) in contexts.iter_mut().enumerate() {
            let for_this = if i == last { drawables.take() } else { drawables.clone() };
            context.prewarm(&kinds);
            context.compile(CompileOperation { ticket, drawables: for_this.unwrap_or_default() });
            if !self.config.pre_compile {
                context.run_compiles(&CompileBudget { time: Duration::MAX, bytes: u64::MAX });
            }
        }
    }

    /// Of what has arrived, the most urgent first, what finds no room beside those before it; whether it is wanted only
    /// later.
    fn lacks_room(&self) -> Option<(NodeId, bool)> {
        let arrived = self.compiling.values().chain(&self.ready);
        let mut arrived: Vec<&Entry> = arrived.filter_map(|slot| self.entries.get(slot)).collect();
        arrived.sort_by(|a, b| by_urgency(a, b));
        let last = arrived.last().map(|entry| (entry.job.slot, entry.is_ahead()));
        let mut cpu = self.residents.cpu_bytes + self.shares.all.cpu;
        let mut gpu = self.residents.gpu_bytes + self.shares.all.gpu;
        let mut pages = self.residents.len();
        for entry in arrived {
            let Progress::Arrived(Arrived { counts, .. }) = &entry.progress else { continue };
            let (with_cpu, with_gpu) = (cpu + counts.cpu, gpu + counts.gpu);
            if with_cpu > self.config.max_bytes_cpu
                || with_gpu > self.config.max_bytes_gpu
                || pages >= self.config.max_tiles
            {
                return Some((entry.job.slot, entry.is_ahead()));
            }
            (cpu, gpu, pages) = (with_cpu, with_gpu, pages + 1);
        }
        last
    }

    /// Gives up a page that has arrived and has no room; it is loaded again once it has, unless it was wanted only later.
    fn decline(&mut self, slot: NodeId, contexts: &mut [&mut dyn CompileContext]) {
        let Some(mut entry) = self.entries.remove(&slot) else { return };
        let Progress::Arrived(arrived) = std::mem::replace(&mut entry.progress, Progress::Waiting) else { return };
        let ticket = entry.job.ticket;
        self.compiling.remove(&ticket);
        if arrived.is_uploading() {
            contexts.iter_mut().for_each(|context| context.cancel(&[ticket]));
        }
        self.ready.retain(|ready| *ready != slot);
        self.uploads.retain(|waiting| *waiting != slot);
        self.arrived.take(&arrived);
        let shared = self.shares.only_of(&arrived.page);
        // Given up before its upload, it needs what such pages do.
        let gpu = if arrived.contexts_left > 0 { self.mean_gpu_bytes } else { arrived.counts.gpu + shared.gpu };
        let needs = Held { cpu: arrived.counts.cpu + shared.cpu, gpu };
        self.stats.declined += 1;
        self.tried_room(false);
        timeline::request_ends(self.threads.list.ticket_source | ticket, "declined");
        self.retire(arrived.page, contexts);
        if !entry.is_ahead() {
            self.ask_again(Entry { needs: Some(needs), ..entry });
        }
    }
}

/// The most urgent first.
fn by_urgency(a: &Entry, b: &Entry) -> std::cmp::Ordering {
    let sooner = a.ahead_frames.cmp(&b.ahead_frames);
    sooner.then(b.priority.total_cmp(&a.priority)).then(a.job.slot.cmp(&b.job.slot))
}
