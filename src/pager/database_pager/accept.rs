//! Accepts requests of culls and of scenes, and lets failures be requested again.

use super::DatabasePager;
use crate::cull::PageRequest;
use crate::pager::requests::table::Changes;
use crate::pager::residency::Unused;
use crate::pager::scenes::scene_set::SceneSet;
use crate::scene::SlotState;

/// A slot that a cull met within this many frames is seen.
const MET_FRAMES: u32 = 2;

impl DatabasePager {
    /// Accepts new requests and renews those that are known. Returns true if there is something new to load, or a prefetch
    /// is wanted now.
    pub(super) fn accept(&mut self, scenes: &dyn SceneSet, requests: &[PageRequest]) -> bool {
        if let Some(scene) = self.scenes.claimant(scenes) {
            self.claim(scene);
        }
        let frame = self.control.times.frame();
        let mut changes = Changes::default();
        for request in requests {
            if self.table.renew(request, frame, &mut changes) {
                continue;
            }
            let Some(slot) = scenes.slot(request.slot) else { continue };
            let is_open = match slot.state {
                SlotState::Empty => true,
                SlotState::Resident(page) => self.outdated.contains_key(&page),
                SlotState::Failed => false,
            };
            if !is_open || !self.control.takes_requests {
                continue;
            }
            let Some((ancestors, scope)) = self.scenes.origin(&slot) else { continue };
            let tile = self.scenes.tile_volume(scenes, request.slot, &scope).filter(|_| !slot.is_proxy);
            self.table.add(request, &slot, ancestors, scope, tile, frame);
            changes.requested += 1;
        }
        self.stats.requested += changes.requested;
        self.stats.retried += changes.retried;
        changes.rearranged.iter().for_each(|(slot, urgency)| self.arrivals.set_urgency(*slot, *urgency));
        changes.has_new()
    }

    /// Accepts and renews requests for slots that are filled whatever cameras see.
    pub(super) fn accept_forced(&mut self, scenes: &mut dyn SceneSet) {
        self.forced.forget_settled(scenes, &self.table);
        for slot in self.forced.take_new(scenes) {
            self.table.retry_now(scenes, slot);
        }
        let requests = self.forced.requests();
        if !requests.is_empty() {
            self.accept(scenes, &requests);
        }
    }

    /// Lets failures be requested again whose back-off is over.
    pub(super) fn retry_failures(&mut self, scenes: &mut dyn SceneSet) {
        let unused = Unused::new(self.config.expiry_frames.max(MET_FRAMES), self.config.expiry_time);
        self.table.retry_due(scenes, |frame| unused.allows(frame, &self.control.times));
    }
}
