//! Room in the budgets: uploads begin where there is room, pages expire, and arrivals without room are declined. Update thread.

use super::{BEGIN_UPLOADS_END, DatabasePager, EXPIRY_END};
use crate::pager::loading::ticket::RequestEnd;
use crate::pager::requests::entry::Entry;
use crate::pager::residency::Unused;
use crate::pager::residency::budget::MemoryUse;
use crate::pager::scenes::scene_set::SceneSet;
use crate::pager::time_budget::TimeBudget;
use crate::pager::upload::context::CompileContext;
use crate::scene::{NodeId, Page, PageId};

impl DatabasePager {
    /// Begins uploads, the most urgent first, as far as there is room. If nothing is uploading, one upload starts even
    /// without room; its size is checked afterwards. At least one begins that may, and the others as the budget allows.
    pub(super) fn begin_uploads(
        &mut self,
        scenes: &mut dyn SceneSet,
        contexts: &mut [&mut dyn CompileContext],
        budget: &TimeBudget,
    ) {
        if self.arrivals.next_upload().is_some() {
            let max_bytes = self.config.max_bytes_gpu / contexts.len().max(1) as u64;
            contexts.iter_mut().for_each(|context| context.set_max_bytes(max_bytes));
        }
        let mut looks = self.residency.urgent_looks();
        while let Some((slot, is_prefetch)) = self.arrivals.next_upload() {
            let reserved = self.upload_reserve(slot);
            let has_room = |pager: &Self| pager.residency.room(pager.arrivals.total()).fits_upload(reserved);
            while !is_prefetch
                && !has_room(self)
                && let Some(id) = self.residency.pop_expired(scenes, &self.control.times, Unused::NOT_SHOWN, &mut looks)
            {
                self.detach(scenes, id, contexts);
            }
            if !has_room(self) && self.arrivals.total().uploading > 0 {
                break;
            }
            self.arrivals.begin_upload(slot, reserved, contexts, self.config.pre_compile);
            if budget.is_over_at(BEGIN_UPLOADS_END) {
                break;
            }
        }
    }

    /// Returns the GPU bytes to reserve for an upload: the mean of recent pages, or for the first pages what is uploaded.
    fn upload_reserve(&self, slot: NodeId) -> u64 {
        match self.residency.mean_size().gpu {
            0 => self.arrivals.upload_bytes(slot).min(self.config.max_bytes_gpu),
            mean => mean,
        }
    }

    /// Makes the budgets hold after an arrival: pages that are not shown expire, then arrivals without room are declined,
    /// the least urgent first. No page expires for a prefetch.
    ///
    /// Pages expire also for GPU memory that is allocated and unused, since blocks are freed with their last slot. No arrival
    /// is declined for it: the next upload may use it.
    pub(super) fn keep_budgets(&mut self, scenes: &mut dyn SceneSet, contexts: &mut [&mut dyn CompileContext]) {
        let budget = self.residency.budget();
        let mut looks = self.residency.urgent_looks();
        while self.residency.is_over_budget_allocated(self.arrivals.total()) {
            let (merged, pages) = (self.residency.bytes_without_arrived(), self.residency.len() as u64);
            let without_room = self.arrivals.first_without_room(&budget, merged, pages);
            let is_prefetch = |slot: NodeId| self.table.get(slot).is_some_and(Entry::is_prefetch);
            if !without_room.is_some_and(is_prefetch)
                && let Some(id) = self.residency.pop_expired(scenes, &self.control.times, Unused::NOT_SHOWN, &mut looks)
            {
                self.detach(scenes, id, contexts);
                continue;
            }
            let is_over = self.residency.is_over_budget(self.arrivals.total());
            let Some(slot) = without_room.filter(|_| is_over) else { break };
            self.decline(slot, contexts);
        }
        let arrived = self.arrivals.total();
        let (bytes, pages) = (self.residency.bytes_in_memory(arrived), self.residency.len() as u64 + arrived.pages);
        self.stats.note_memory(bytes.cpu, bytes.gpu, pages);
    }

    /// Declines an arrived page that has no room. It is loaded again once there is room, unless it was a prefetch.
    fn decline(&mut self, slot: NodeId, contexts: &mut [&mut dyn CompileContext]) {
        let Some(arrived) = self.arrivals.get(slot) else { return };
        let own = arrived.bytes() + self.residency.unshared_bytes(arrived.page());
        // Before its upload a page counts as one of the mean size.
        let gpu = if arrived.is_uploaded() { own.gpu } else { self.residency.mean_size().gpu };
        self.drop_arrived(slot, contexts);
        self.stats.declined += 1;
        self.scheduler.declined(self.control.times.frame());
        let Some(entry) = self.table.remove(slot) else { return };
        entry.job.ticket.trace_end(RequestEnd::Declined);
        if !entry.is_prefetch() {
            let known_size = Some(MemoryUse { cpu: own.cpu, gpu });
            self.requeue(Entry { known_size, ..entry });
        }
    }

    /// Requests a content again whose last load has ended.
    fn requeue(&mut self, entry: Entry) {
        self.table.requeue(entry);
        self.stats.retried += 1;
    }

    /// Drops an arrived page and cancels its upload.
    pub(super) fn drop_arrived(&mut self, slot: NodeId, contexts: &mut [&mut dyn CompileContext]) {
        let Some(arrived) = self.arrivals.remove(slot) else { return };
        if let Some(ticket) = arrived.upload_ticket() {
            contexts.iter_mut().for_each(|context| context.cancel(&[ticket]));
        }
        self.drop_page(arrived.into_page().0, contexts);
    }

    /// Expires pages that were not wanted for long while the reserved tenths of a budget are not free. Shorter times hold
    /// if there is no room for prefetches, and the shortest if a frame lacks something that has no room. At least one page
    /// expires if it may, and then as many as the budget allows.
    pub(super) fn expire(
        &mut self,
        scenes: &mut dyn SceneSet,
        contexts: &mut [&mut dyn CompileContext],
        budget: &TimeBudget,
    ) {
        let unused = self.scheduler.shortage().unused(&self.config);
        let mut looks = self.residency.start_search(self.scheduler.shortage().is_any());
        let expired_before = self.stats.expired;
        while self.needs_room() {
            let expired = self.residency.pop_expired(scenes, &self.control.times, unused, &mut looks);
            let Some(id) = expired else { break };
            self.detach(scenes, id, contexts);
            if budget.is_over_at(EXPIRY_END) {
                break;
            }
        }
        self.forget_removed_pages(contexts);
        self.residency.end_search(self.stats.expired > expired_before);
    }

    fn needs_room(&self) -> bool {
        self.scheduler.shortage().needs_room(&self.residency.room(self.arrivals.total()))
    }

    /// Forgets the pages that the application took out of its scenes.
    pub(super) fn forget_removed_pages(&mut self, contexts: &mut [&mut dyn CompileContext]) {
        for id in self.residency.forget_removed() {
            self.stats.expired += 1;
            self.forget_requests_in(id, contexts);
        }
    }

    /// Detaches an expired page from its scene and drops it.
    pub(super) fn detach(&mut self, scenes: &mut dyn SceneSet, id: PageId, contexts: &mut [&mut dyn CompileContext]) {
        self.forget_requests_in(id, contexts);
        if let Some(page) = self.residency.detach(scenes, id) {
            self.stats.expired += 1;
            self.drop_page(page, contexts);
        }
    }

    /// Forgets the requests for the slots inside a tileset that leaves its scene.
    fn forget_requests_in(&mut self, id: PageId, contexts: &mut [&mut dyn CompileContext]) {
        if self.scenes.forget_page(id) {
            self.drop_requests(contexts, |slot, _| slot.page == id);
        }
    }

    /// Returns a page's draw slots to their contexts and drops it on the reaper's thread.
    pub(super) fn drop_page(&mut self, mut page: Box<Page>, contexts: &mut [&mut dyn CompileContext]) {
        self.residency.note_drop(&page);
        for (id, slots) in page.take_draw_slots() {
            if let Some(context) = contexts.iter_mut().find(|c| c.id() == id) {
                context.release(slots);
            }
        }
        self.reaper.drop_page(page);
    }
}
