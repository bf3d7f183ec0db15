//! The blocking mode: an update that loads all that it can, in rounds whose results do not depend on timing. Main thread.
//!
//! ```text
//! list -> threads take and load all that has room -> answers, in order of their tickets
//!      -> uploads of all contexts, in order of their tickets -> merge, expiry -> list ...
//! ```
//! Within a round nothing is decided before everything has arrived, so that budgets, which depend on the sizes of the
//! pages so far, decide alike each time. Tickets are numbered as requests are accepted, and culls list those in one order. A
//! retry is due by the clock: it comes in the same frame again only if the back-off is zero.
//!
//! New kinds of asynchronous work must end within a round too: [`DatabasePager::is_busy`] has to count them.

use std::time::Duration;

use super::DatabasePager;
use crate::gpu::Compiled;
use crate::pager::loading::job::Answer;
use crate::pager::loading::page_job::PageJob;
use crate::pager::scenes::scene_set::SceneSet;
use crate::pager::upload::context::CompileContext;

/// How long the blocking mode waits for an answer, or for an upload, before it looks again.
const POLL: Duration = Duration::from_millis(1);

impl DatabasePager {
    /// Loads until nothing is left that has room.
    pub(super) fn load_all(&mut self, scenes: &mut dyn SceneSet, contexts: &mut [&mut dyn CompileContext]) {
        while self.is_busy() && are_alive(contexts) {
            for answer in self.all_answers(contexts) {
                self.answer(scenes, answer, contexts);
            }
            self.take_all_compiled(scenes, contexts);
            // Without an end in this mode.
            let budget = self.update_budget();
            self.merge(scenes, contexts, &budget);
            self.expire(scenes, contexts, &budget);
            self.accept_forced(scenes);
            self.write_list();
            self.threads.list().ring_if_due();
        }
    }

    /// Waits until the threads have answered all that they may take.
    fn all_answers(&mut self, contexts: &[&mut dyn CompileContext]) -> Vec<Answer<PageJob>> {
        let mut answers = Vec::new();
        while are_alive(contexts) && self.threads.list().lock().is_under_way() {
            if let Some(answer) = self.threads.wait_answer(POLL) {
                self.received(&answer);
                answers.push(answer);
            }
            // An answer lets its thread take the next job.
            let list = self.threads.list();
            list.ring(list.lock());
        }
        answers.sort_by_key(|answer| answer.job.ticket.number());
        answers
    }

    /// Uploads what waits for it: begins what has room, waits for all contexts, and begins the next.
    fn take_all_compiled(&mut self, scenes: &mut dyn SceneSet, contexts: &mut [&mut dyn CompileContext]) {
        let budget = self.update_budget();
        self.begin_uploads(scenes, contexts, &budget);
        while self.arrivals.total().uploading > 0 && are_alive(contexts) {
            let (mut compiled, mut left) = (Vec::new(), self.arrivals.operations_left());
            while left > 0 && are_alive(contexts) {
                let before = compiled.len();
                for context in contexts.iter_mut() {
                    let id = context.id();
                    let taken = context.take_compiled();
                    // Cancelled operations are answered too.
                    left = left.saturating_sub(taken.iter().filter(|c| self.arrivals.is_uploading(c.ticket)).count());
                    compiled.extend(taken.into_iter().map(|compiled| (id, compiled)));
                }
                if compiled.len() == before {
                    std::thread::sleep(POLL);
                }
            }
            compiled.sort_by_key(|(context, compiled): &(u32, Compiled)| (compiled.ticket, *context));
            self.note_compiled(scenes, compiled, contexts);
            self.merge(scenes, contexts, &budget);
            self.begin_uploads(scenes, contexts, &budget);
        }
    }
}

fn are_alive(contexts: &[&mut dyn CompileContext]) -> bool {
    contexts.iter().all(|context| context.is_alive())
}
