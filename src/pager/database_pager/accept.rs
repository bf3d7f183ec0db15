//! Accepts requests of culls and of scenes, and lets failures be requested again.

use super::DatabasePager;
use crate::cull::PageRequest;
use crate::pager::requests::table::Changes;
use crate::pager::scenes::scene_set::SceneSet;
use crate::scene::SlotState;

impl DatabasePager {
    /// Accepts new requests and renews those that are known. Returns true if there is something new to load, or a prefetch
    /// is wanted now.
    pub(super) fn accept(&mut self, scenes: &dyn SceneSet, requests: &[PageRequest]) -> bool {
        if let Some(scene) = self.scenes.claimant(scenes) {
            self.claim(scene);
        }
        let frame = self.control.frame;
        let mut changes = Changes::default();
        for request in requests {
            if self.table.renew(request, frame, &mut changes) {
                continue;
            }
            let Some(slot) = scenes.slot(request.slot) else { continue };
            if slot.state != SlotState::Empty || !self.control.takes_requests {
                continue;
            }
            let Some((ancestors, scope)) = self.scenes.origin(&slot) else { continue };
            self.table.add(request, &slot, ancestors, scope, frame);
            changes.requested += 1;
        }
        self.stats.requested += changes.requested;
        self.stats.retried += changes.retried;
        self.control.is_list_current &= !changes.changes_list();
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
        self.table.retry_due(scenes, self.control.frame, self.config.expiry_frames);
    }
}
