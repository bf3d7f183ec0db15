//! Merging: uploaded pages are attached to the slots of their scenes.

use std::collections::BTreeMap;

use super::{DatabasePager, MERGES_END};
use crate::pager::loading::ticket::RequestEnd;
use crate::pager::requests::entry::Entry;
use crate::pager::residency::Resident;
use crate::pager::residency::budget::RESERVED_TENTHS;
use crate::pager::scenes::scene_set::SceneSet;
use crate::pager::time_budget::TimeBudget;
use crate::pager::upload::context::CompileContext;
use crate::scene::{ContentKey, NodeId, Page, ReaderData, SceneError, SceneNumber};
use crate::trace;

/// The memory of a page that is about to be merged, and the contents that it shares.
struct Held {
    cpu_bytes: u64,
    /// By context id.
    gpu_bytes: Vec<(u32, u64)>,
    shared: Box<[ContentKey]>,
}

impl DatabasePager {
    /// Merges uploaded pages in order of priority, at least one and then as the budget and [`PagerConfig::merge_time`] allow;
    /// their room is already counted.
    ///
    /// [`PagerConfig::merge_time`]: crate::pager::PagerConfig::merge_time
    pub(super) fn merge(
        &mut self,
        scenes: &mut dyn SceneSet,
        contexts: &mut [&mut dyn CompileContext],
        budget: &TimeBudget,
    ) {
        if !self.arrivals.has_ready() {
            return;
        }
        let _span = trace::span("merge pages");
        let merging = self.budget(self.config.merge_time);
        let has_several = self.scenes.has_several();
        let ready = self.merge_order.arrange(self.arrivals.ready_to_merge().collect(), has_several);
        let mut merged: BTreeMap<SceneNumber, u32> = BTreeMap::new();
        let mut left = Vec::new();
        for slot in ready {
            if !merged.is_empty() && (merging.is_over_at(10) || budget.is_over_at(MERGES_END)) {
                left.push(slot);
            } else if self.merge_one(scenes, slot, contexts) {
                *merged.entry(slot.page.scene).or_default() += 1;
            }
        }
        if has_several {
            self.merge_order.merged(&merged, &left);
        }
    }

    /// Merges the page of a slot. Returns false if that took no time: it was a prefetch without free room.
    fn merge_one(&mut self, scenes: &mut dyn SceneSet, slot: NodeId, contexts: &mut [&mut dyn CompileContext]) -> bool {
        let Some(entry) = self.table.remove(slot) else { return false };
        // A page that waits counts in the budgets: its room is free once it is taken out.
        let Some(arrived) = self.arrivals.remove(slot) else { return false };
        let has_free = self.residency.room(self.arrivals.total()).has_free_tenths(RESERVED_TENTHS);
        let cpu_bytes = arrived.bytes().cpu;
        let (page, gpu_bytes) = arrived.into_page();
        if entry.is_prefetch() && !entry.is_soon() && !has_free {
            self.stats.declined += 1;
            entry.job.ticket.trace_end(RequestEnd::Declined);
            self.drop_page(page, contexts);
            return false;
        }
        self.detach_outdated(scenes, slot, contexts);
        self.residency.begin_merge(&page);
        let shared = page.shared_contents().iter().map(|used| used.content.key).collect();
        match self.attach(scenes, slot, page, &entry, Held { cpu_bytes, gpu_bytes, shared }) {
            Ok(()) => self.count_merged(&entry),
            Err(page) => {
                self.stats.dropped += 1;
                entry.job.ticket.trace_end(RequestEnd::Dropped);
                self.residency.abort_merge(&page);
                self.drop_page(page, contexts);
            }
        }
        true
    }

    /// Attaches a page to its slot; returns it if the slot is gone.
    fn attach(
        &mut self,
        scenes: &mut dyn SceneSet,
        slot: NodeId,
        page: Box<Page>,
        entry: &Entry,
        Held { cpu_bytes, gpu_bytes, shared }: Held,
    ) -> Result<(), Box<Page>> {
        let (is_tileset, ellipsoid) = (page.is_tile_tree(), page.ellipsoid());
        let attached = match scenes.numbered_mut(slot.page.scene) {
            Some(scene) => scene.attach(slot, *page),
            None => Err(Box::new((SceneError::StaleNode { node: slot }, *page))),
        };
        let id = attached.map_err(|refused| Box::new(refused.1))?;
        if self.forced.contains(slot)
            && let Some(scene) = scenes.numbered(slot.page.scene)
        {
            // No camera has used it yet.
            scene.note_use(slot, self.control.times.frame());
        }
        if let Some(info) = scenes.numbered(slot.page.scene).and_then(|scene| scene.slot(slot)) {
            self.residency.insert(id, Resident::new(slot, &info, cpu_bytes, gpu_bytes, shared));
        }
        if is_tileset {
            self.control.has_new_tiles = true;
            let ancestors = entry.job.ancestors.clone();
            // A further part of a tileset is no tileset of its own.
            let continues = entry.job.reader_data.as_ref().is_some_and(ReaderData::continues_tileset);
            let ancestors = if continues { ancestors } else { ancestors.below(&entry.job.uri, ellipsoid) };
            self.scenes.add_tileset(id, ancestors);
        }
        Ok(())
    }

    fn count_merged(&mut self, entry: &Entry) {
        let latency_s = entry.since.elapsed().as_secs_f64();
        self.stats.merged += 1;
        self.stats.merged_ahead += u64::from(entry.is_prefetch());
        self.stats.latency_sum_s += latency_s;
        self.stats.latency_max_s = self.stats.latency_max_s.max(latency_s);
        self.scheduler.merged(entry.is_prefetch(), self.control.times.frame());
        entry.job.ticket.trace_end(RequestEnd::Merged);
    }
}
