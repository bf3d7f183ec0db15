//! Answers of the loading threads and of the contexts.

use std::sync::Arc;
use std::time::Duration;

use super::{ANSWERS_END, DatabasePager, UPLOADED_END};
use crate::fetch::{ContentMemory, IoError};
use crate::gpu::Compiled;
use crate::pager::loading::job::Answer;
use crate::pager::loading::page_job::PageJob;
use crate::pager::loading::ticket::{RequestEnd, Ticket};
use crate::pager::requests::entry::{Entry, Progress};
use crate::pager::requests::retry_policy::{RetryPolicy, RetryState, retry_moment};
use crate::pager::residency::budget::MemoryUse;
use crate::pager::scenes::scene_set::SceneSet;
use crate::pager::time_budget::TimeBudget;
use crate::pager::upload::Uploaded;
use crate::pager::upload::context::CompileContext;
use crate::scene::{DrawKind, NodeId, Page};

impl DatabasePager {
    /// Takes answers of the loading threads, at least one and then as the budget allows. The others stay in their channel,
    /// which has room for all.
    pub(super) fn take_answers(
        &mut self,
        scenes: &mut dyn SceneSet,
        contexts: &mut [&mut dyn CompileContext],
        budget: &TimeBudget,
    ) {
        while let Some(answer) = self.threads.try_answer() {
            self.received(&answer);
            self.answer(scenes, answer, contexts);
            if budget.is_over_at(ANSWERS_END) {
                break;
            }
        }
    }

    /// Waits for one answer of the loading threads, at most for `timeout`.
    pub(super) fn wait_for_answer(
        &mut self,
        scenes: &mut dyn SceneSet,
        contexts: &mut [&mut dyn CompileContext],
        timeout: Duration,
    ) {
        if let Some(answer) = self.threads.wait_answer(timeout) {
            self.received(&answer);
            self.answer(scenes, answer, contexts);
        }
    }

    /// Counts an answer; its thread may take another job.
    pub(super) fn received(&mut self, answer: &Answer<PageJob>) {
        self.threads.list().lock().answered(&answer.job, matches!(answer.content, Some(Ok(_))));
        self.stats.bytes_read += answer.bytes_read;
        self.stats.bytes_http += answer.bytes_http;
    }

    /// Acts on an answer that was received.
    pub(super) fn answer(
        &mut self,
        scenes: &mut dyn SceneSet,
        answer: Answer<PageJob>,
        contexts: &mut [&mut dyn CompileContext],
    ) {
        let Answer { job, content, memory, .. } = answer;
        if self.table.of_job(&job).is_none() {
            // The tree that held the slot is gone.
            if let Some(Ok(page)) = content {
                self.reaper.drop_page(Box::new(page));
            }
            return;
        }
        match content {
            None => self.aborted(&job),
            Some(Err(error)) => self.failed(scenes, &job, &error),
            Some(Ok(page)) if !self.scenes.block_formats().get().contains(page.block_formats()) => {
                self.undrawable(&job, page);
            }
            Some(Ok(page)) => self.arrived(scenes, &job, (page, memory), contexts),
        }
    }

    fn aborted(&mut self, job: &PageJob) {
        self.stats.cancelled += 1;
        job.ticket.trace_end(RequestEnd::Cancelled);
        if self.table.begin(job.slot, Entry::end_unwanted) == Some(false) {
            self.table.remove(job.slot);
        }
    }

    /// Drops a page that was decoded before a context without its compressed formats was added. It is requested again.
    fn undrawable(&mut self, job: &PageJob, page: Page) {
        self.stats.dropped += 1;
        job.ticket.trace_end(RequestEnd::Dropped);
        self.table.remove(job.slot);
        self.reaper.drop_page(Box::new(page));
    }

    fn failed(&mut self, scenes: &mut dyn SceneSet, job: &PageJob, error: &IoError) {
        self.stats.failed += 1;
        job.ticket.trace_end(RequestEnd::Failed);
        self.errors.add(error);
        // The first back-off is configured; a pause that the server asks for is in the error.
        let policy = RetryPolicy { first_backoff: self.config.retry_after, max_attempts: self.config.max_tries };
        self.table.begin(job.slot, |entry| {
            let backoff = entry.retries.fail(error, policy).map(|backoff| backoff.mul_f64(spread(job.ticket)));
            entry.progress = Progress::Failed { retry_at: retry_moment(backoff) };
        });
        self.mark_failed(scenes, job.slot);
    }

    fn arrived(
        &mut self,
        scenes: &mut dyn SceneSet,
        job: &PageJob,
        (mut page, memory): (Page, Option<ContentMemory>),
        contexts: &mut [&mut dyn CompileContext],
    ) {
        let slot = job.slot;
        self.stats.loaded += 1;
        self.stats.bytes_decoded += page.size_bytes();
        let scene = scenes.numbered(slot.page.scene);
        let kinds: Arc<[DrawKind]> = scene.map_or(Vec::new(), |s| s.draw_kinds(Some(slot), &page)).into();
        page.hold_textures();
        self.residency.note_arrival(&page, contexts.iter().map(|context| context.id()));
        let arrived = self.table.begin(slot, |entry| {
            entry.progress = Progress::Arrived;
            entry.urgency()
        });
        let Some(urgency) = arrived else { return };
        self.arrivals.insert((slot, urgency), job.ticket, (page, memory), kinds, contexts.len());
        if !self.refuse_oversized(scenes, slot, contexts) {
            self.learn_size_if_known(slot);
            self.keep_budgets(scenes, contexts);
        }
    }

    /// Takes what the contexts have uploaded, at least one page and then as the budget allows. The others wait in
    /// [`Arrivals`](crate::pager::upload::Arrivals).
    pub(super) fn take_compiled(
        &mut self,
        scenes: &mut dyn SceneSet,
        contexts: &mut [&mut dyn CompileContext],
        budget: &TimeBudget,
    ) {
        for context in contexts.iter_mut() {
            self.arrivals.add_finished(context.id(), context.take_compiled());
        }
        while let Some(finished) = self.arrivals.next_finished() {
            self.note_compiled(scenes, [finished], contexts);
            if budget.is_over_at(UPLOADED_END) {
                break;
            }
        }
    }

    /// Acts on compile operations that contexts, by their ids, have finished.
    pub(super) fn note_compiled(
        &mut self,
        scenes: &mut dyn SceneSet,
        compiled: impl IntoIterator<Item = (u32, Compiled)>,
        contexts: &mut [&mut dyn CompileContext],
    ) {
        let mut complete = Vec::new();
        for (id, mut compiled) in compiled {
            let (shared, errors) = (std::mem::take(&mut compiled.shared), std::mem::take(&mut compiled.errors));
            // In the blocking mode the budget counts slots alone: when blocks grow and are freed depends on timing.
            if !self.config.blocking {
                self.residency.note_unused(id, compiled.unused_bytes);
            }
            let slot = match self.arrivals.uploaded(id, compiled) {
                Uploaded::Late(slots) => {
                    if let Some(context) = contexts.iter_mut().find(|context| context.id() == id) {
                        context.release(slots);
                    }
                    continue;
                }
                Uploaded::Partly(slot) => slot,
                Uploaded::Completely(slot) => {
                    complete.push(slot);
                    slot
                }
            };
            self.residency.note_upload(id, &shared);
            let uri = self.table.get(slot).map(|entry| entry.job.uri.clone()).unwrap_or_default();
            for error in &errors {
                self.stats.drawables_failed += 1;
                self.errors.add_text(&uri, error);
            }
        }
        if complete.is_empty() {
            return;
        }
        for slot in complete {
            if !self.refuse_oversized(scenes, slot, contexts) {
                self.learn_size_if_known(slot);
            }
        }
        self.keep_budgets(scenes, contexts);
    }

    /// Learns the size of a page once it is uploaded.
    fn learn_size_if_known(&mut self, slot: NodeId) {
        if let Some(arrived) = self.arrivals.get(slot).filter(|arrived| arrived.is_uploaded()) {
            self.residency.learn_size(arrived.page(), arrived.bytes());
        }
    }

    /// Refuses an arrived page that exceeds a budget alone: an error that is not retried. Returns true if it did.
    fn refuse_oversized(
        &mut self,
        scenes: &mut dyn SceneSet,
        slot: NodeId,
        contexts: &mut [&mut dyn CompileContext],
    ) -> bool {
        let Some(arrived) = self.arrivals.get(slot) else { return false };
        let size = arrived.bytes() + self.residency.shared_bytes(arrived.page());
        let budget = self.residency.budget();
        if !budget.is_exceeded_by(size) {
            return false;
        }
        self.drop_arrived(slot, contexts);
        let failed = self.table.begin(slot, |entry| {
            entry.job.ticket.trace_end(RequestEnd::Failed);
            entry.progress = Progress::Failed { retry_at: None };
            (entry.retries, entry.known_size) = (RetryState::default(), None);
            entry.job.uri.to_string()
        });
        let Some(uri) = failed else { return true };
        self.stats.failed += 1;
        self.errors.add(&too_large(uri, size, budget.bytes));
        self.mark_failed(scenes, slot);
        true
    }
}

fn too_large(uri: String, size: MemoryUse, max: MemoryUse) -> IoError {
    let (what, got, limit) = if size.cpu > max.cpu {
        ("memory of the page", size.cpu, max.cpu)
    } else {
        ("GPU memory of the page", size.gpu, max.gpu)
    };
    IoError::TooLarge { uri, what, got, limit }
}

/// Returns a factor from 1 to 1.25 by the number of an attempt: contents that failed together are not retried together.
fn spread(ticket: Ticket) -> f64 {
    1.0 + (crate::math::random::fibonacci_hash(ticket.number()) >> 40) as f64 / (1u64 << 26) as f64
}
