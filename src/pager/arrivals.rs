//! What comes: answers of the threads go to the contexts' compile queues, what they have compiled into the scene. Update
//! thread.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use super::DatabasePager;
use super::config::CompileContext;
use super::entry::{Arrived, Entry, Payload, Progress};
use super::expiry::EXPIRY_TENTHS;
use super::job::{Above, Answer, Job};
use super::residents::Resident;
use super::scenes::Scenes;
use super::shares::Held;
use super::tries::Tries;
use crate::io::IoError;
use crate::scene::{DrawKind, NodeId, PagingOptions, SceneError, SceneNumber};
use crate::timeline;

impl DatabasePager {
    pub(super) fn take_answers(&mut self, scenes: &mut dyn Scenes, contexts: &mut [&mut dyn CompileContext]) {
        while let Some(answer) = self.threads.answers.as_ref().and_then(|a| a.try_recv().ok()) {
            self.answer(scenes, answer, contexts);
        }
    }

    pub(super) fn answer(&mut self, scenes: &mut dyn Scenes, answer: Answer, contexts: &mut [&mut dyn CompileContext]) {
        let has_page = matches!(answer.page, Some(Ok(_)));
        self.threads.list.lock().answered(&answer.job, has_page);
        self.stats.bytes_read += answer.bytes_read;
        self.stats.bytes_http += answer.bytes_http;
        let slot = answer.job.slot;
        let known = self.entries.get_mut(&slot).filter(|e| e.job.ticket == answer.job.ticket);
        let Some(entry) = known else {
            // The tree that held the slot is gone.
            if let Some(Ok(page)) = answer.page {
                self.threads.reap(Box::new(page));
            }
            return;
        };
        match answer.page {
            None => {
                self.stats.cancelled += 1;
                timeline::request_ends(self.threads.list.ticket_source | answer.job.ticket, "cancelled");
                if !entry.rests() {
                    self.entries.remove(&slot);
                }
            }
            Some(Err(error)) => {
                self.stats.failed += 1;
                timeline::request_ends(self.threads.list.ticket_source | answer.job.ticket, "failed");
                self.errors.add(&error);
                let wait = entry.tries.fail(&error, self.config.retry_after, self.config.max_tries);
                let wait = wait.map(|wait| wait.mul_f64(spread(entry.job.ticket)));
                // Beyond what the clock knows it is never.
                let retry_at = wait.and_then(|wait| Instant::now().checked_add(wait));
                entry.progress = Progress::Failed { retry_at };
                scenes.set_failed(slot, true);
            }
            Some(Ok(mut page)) => {
                self.stats.loaded += 1;
                self.stats.bytes_decoded += page.size_bytes();
                let scene = scenes.numbered(slot.page.scene);
                let kinds: Arc<[DrawKind]> = scene.map_or(Vec::new(), |s| s.draw_kinds(Some(slot), &page)).into();
                let all_bytes = page.size_bytes();
                let drawables = page.take_drawables();
                self.shares.take(&page);
                let (ticket, cpu_bytes) = (entry.job.ticket, page.own_bytes());
                let contexts_left = if drawables.is_empty() { 0 } else { contexts.len() };
                let payload = Payload { drawables, kinds, bytes: all_bytes.saturating_sub(page.size_bytes()) };
                let arrived = Arrived {
                    page: Box::new(page),
                    gpu_bytes: Vec::new(),
                    contexts_left,
                    counts: Held { cpu: cpu_bytes, gpu: 0 },
                    reserved_gpu: 0,
                    payload: (contexts_left > 0).then_some(payload),
                };
                self.arrived.add(&arrived);
                entry.progress = Progress::Arrived(arrived);
                if contexts_left == 0 {
                    self.ready.push(slot);
                } else {
                    self.compiling.insert(ticket, slot);
                    self.uploads.push(slot);
                }
                if !self.refuses(scenes, slot, contexts) {
                    if contexts_left == 0 {
                        self.learn_size(slot);
                    }
                    self.keep_budgets(scenes, contexts);
                }
                self.begin_uploads(scenes, contexts);
            }
        }
    }

    pub(super) fn take_compiled(&mut self, scenes: &mut dyn Scenes, contexts: &mut [&mut dyn CompileContext]) {
        let mut known = Vec::new();
        for context in contexts.iter_mut() {
            for compiled in context.take_compiled() {
                let slot = self.compiling.get(&compiled.ticket).copied();
                let entry = slot.and_then(|s| self.entries.get_mut(&s));
                let (Some(slot), Some(entry)) = (slot, entry) else {
                    context.release(compiled.slots);
                    continue;
                };
                self.shares.uploaded(context.id(), &compiled.shared);
                for error in &compiled.errors {
                    self.stats.drawables_failed += 1;
                    self.errors.add_text(&entry.job.uri, error);
                }
                let Progress::Arrived(arrived) = &mut entry.progress else {
                    context.release(compiled.slots);
                    continue;
                };
                self.arrived.take(arrived);
                arrived.gpu_bytes.push((context.id(), compiled.bytes));
                arrived.page.set_draw_slots(context.id(), compiled.slots);
                arrived.contexts_left = arrived.contexts_left.saturating_sub(1);
                arrived.counts = Held { cpu: arrived.page.own_bytes(), gpu: arrived.counts.gpu + compiled.bytes };
                arrived.reserved_gpu = match arrived.contexts_left {
                    0 => 0,
                    _ => arrived.reserved_gpu.saturating_sub(compiled.bytes),
                };
                self.arrived.add(arrived);
                if arrived.contexts_left == 0 {
                    self.compiling.remove(&compiled.ticket);
                    self.ready.push(slot);
                    known.push(slot);
                }
            }
        }
        if known.is_empty() {
            return;
        }
        for slot in known {
            if !self.refuses(scenes, slot, contexts) {
                self.learn_size(slot);
            }
        }
        self.keep_budgets(scenes, contexts);
    }

    /// How much a page takes is known now.
    fn learn_size(&mut self, slot: NodeId) {
        let Some(Progress::Arrived(arrived)) = self.entries.get(&slot).map(|entry| &entry.progress) else { return };
        let shared = self.shares.only_of(&arrived.page);
        self.mean_cpu_bytes = moving_mean(self.mean_cpu_bytes, arrived.counts.cpu + shared.cpu);
        self.mean_gpu_bytes = moving_mean(self.mean_gpu_bytes, arrived.counts.gpu + shared.gpu);
    }

    /// A page that has arrived and alone is beyond a budget is an error, and is not asked for again.
    fn refuses(&mut self, scenes: &mut dyn Scenes, slot: NodeId, contexts: &mut [&mut dyn CompileContext]) -> bool {
        let Some(Progress::Arrived(arrived)) = self.entries.get(&slot).map(|entry| &entry.progress) else {
            return false;
        };
        let shared = self.shares.of(&arrived.page);
        let alone = (arrived.counts.cpu + shared.cpu, arrived.counts.gpu + shared.gpu);
        if alone.0 <= self.config.max_bytes_cpu && alone.1 <= self.config.max_bytes_gpu {
            return false;
        }
        let Some(Entry { job, progress: Progress::Arrived(arrived), .. }) = self.entries.remove(&slot) else {
            return false;
        };
        self.arrived.take(&arrived);
        self.compiling.remove(&job.ticket);
        if arrived.is_uploading() {
            contexts.iter_mut().for_each(|context| context.cancel(&[job.ticket]));
        }
        self.ready.retain(|ready| *ready != slot);
        self.uploads.retain(|waiting| *waiting != slot);
        timeline::request_ends(self.threads.list.ticket_source | job.ticket, "failed");
        self.refuse(scenes, slot, job, alone);
        self.retire(arrived.page, contexts);
        true
    }

    /// Hangs pages into their slots, coarse before fine, within the time budget: they have their room already.
    pub(super) fn merge(&mut self, scenes: &mut dyn Scenes, contexts: &mut [&mut dyn CompileContext]) {
        if self.ready.is_empty() {
            return;
        }
        let _span = timeline::span("merge pages");
        let start = Instant::now();
        let priority = |s: &NodeId| self.entries.get(s).map_or(f32::MIN, |e| e.priority);
        self.ready.sort_by(|a, b| priority(b).total_cmp(&priority(a)).then(a.cmp(b)));
        if self.served.len() > 1 {
            self.ready = self.merge_turns.arrange(std::mem::take(&mut self.ready), |slot| slot.page.scene);
        }
        let mut of_scenes: BTreeMap<SceneNumber, u32> = BTreeMap::new();
        let mut done = 0;
        for slot in std::mem::take(&mut self.ready) {
            if done > 0 && !self.config.blocking && start.elapsed() >= self.config.merge_time {
                self.ready.push(slot);
                continue;
            }
            let Some(mut entry) = self.entries.remove(&slot) else { continue };
            let (is_ahead, is_soon) = (entry.is_ahead(), entry.is_soon());
            let progress = std::mem::replace(&mut entry.progress, Progress::Waiting);
            let Progress::Arrived(arrived) = progress else { continue };
            self.arrived.take(&arrived);
            let Arrived { page, gpu_bytes: by_context, counts: Held { cpu: cpu_bytes, .. }, .. } = arrived;
            let ticket = self.threads.list.ticket_source | entry.job.ticket;
            if is_ahead && !is_soon && !self.has_free(EXPIRY_TENTHS) {
                self.stats.declined += 1;
                timeline::request_ends(ticket, "declined");
                self.retire(page, contexts);
                continue;
            }
            self.shares.merge(&page);
            let shared = page.shared_contents().iter().map(|used| used.content.key).collect();
            let tile_tree = page.is_tile_tree();
            let attached = match scenes.numbered_mut(slot.page.scene) {
                Some(scene) => scene.attach(slot, *page),
                None => Err(Box::new((SceneError::StaleNode { node: slot }, *page))),
            };
            match attached {
                Ok(id) => {
                    if self.asked.contains(&slot)
                        && let Some(scene) = scenes.numbered(slot.page.scene)
                    {
                        // No camera has used it.
                        scene.note_use(slot, self.frame);
                    }
                    let latency_s = entry.since.elapsed().as_secs_f64();
                    self.stats.merged += 1;
                    self.tried_room(true);
                    if is_ahead {
                        self.stats.merged_ahead += 1;
                        self.ahead_short.iter_mut().for_each(|ahead| ahead.count = ahead.count.saturating_sub(1));
                    }
                    timeline::request_ends(ticket, "merged");
                    self.stats.latency_sum_s += latency_s;
                    self.stats.latency_max_s = self.stats.latency_max_s.max(latency_s);
                    self.residents.insert(id, Resident::new(slot, cpu_bytes, by_context, entry.paging, shared));
                    if tile_tree {
                        let Above { chain, set_from_page } = entry.job.above;
                        let chain = chain.iter().cloned().chain([entry.job.uri.clone()]).collect();
                        self.above.insert(id, Above { chain, set_from_page });
                    }
                }
                // The slot went with its tree.
                Err(refused) => {
                    self.stats.dropped += 1;
                    timeline::request_ends(ticket, "dropped");
                    self.shares.unmerge(&refused.1);
                    self.retire(Box::new(refused.1), contexts);
                }
            }
            done += 1;
            *of_scenes.entry(slot.page.scene).or_default() += 1;
        }
        if self.served.len() > 1 {
            self.merge_turns.took(&of_scenes, self.ready.iter().map(|slot| slot.page.scene));
        }
    }

    /// Puts a request that has ended among those that wait.
    pub(super) fn ask_again(&mut self, mut entry: Entry) {
        entry.job.ticket = self.next_ticket;
        entry.job.stage.waits();
        timeline::request_begins(self.threads.list.ticket_source | self.next_ticket, &entry.job.uri);
        self.next_ticket += 1;
        entry.progress = Progress::Waiting;
        self.stats.retried += 1;
        self.is_listed = false;
        self.entries.insert(entry.job.slot, entry);
    }

    /// A page that alone is beyond a budget: an error, and not asked for again.
    fn refuse(&mut self, scenes: &mut dyn Scenes, slot: NodeId, job: Job, (cpu_bytes, gpu_bytes): (u64, u64)) {
        let config = &self.config;
        let (what, got, limit) = if cpu_bytes > config.max_bytes_cpu {
            ("memory of the page", cpu_bytes, config.max_bytes_cpu)
        } else {
            ("GPU memory of the page", gpu_bytes, config.max_bytes_gpu)
        };
        self.stats.failed += 1;
        self.errors.add(&IoError::TooLarge { uri: job.uri.to_string(), what, got, limit });
        let entry = Entry {
            job,
            priority: 0.0,
            asked_frame: self.frame,
            wanted_frame: self.frame,
            ahead_frames: 0,
            since: Instant::now(),
            tries: Tries::default(),
            needs: None,
            progress: Progress::Failed { retry_at: None },
            paging: PagingOptions::default(),
        };
        self.entries.insert(slot, entry);
        scenes.set_failed(slot, true);
    }
}

/// From 1 to 1.25 by the number of a load: what failed together is not asked for again together.
fn spread(ticket: u64) -> f64 {
    1.0 + (crate::math::random::fibonacci_hash(ticket) >> 40) as f64 / (1u64 << 26) as f64
}

fn moving_mean(mean: u64, value: u64) -> u64 {
    if mean == 0 { value } else { (7 * mean + value) / 8 }
}
