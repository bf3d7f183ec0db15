//! Refreshing: contents that were loaded before the overlays of their scene changed are loaded again. They stay on screen until
//! their successors are uploaded. Update thread.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::DatabasePager;
use crate::cull::PageRequest;
use crate::formats::OverlaySet;
use crate::pager::requests::entry::Entry;
use crate::pager::scenes::scene_set::SceneSet;
use crate::pager::upload::context::CompileContext;
use crate::scene::{NodeId, Page, PageId, ProxyLoading, Scene, SlotState};

/// The priority of successors in pixels of error: after what is missing on screen, before prefetches.
const PRIORITY_PX: f32 = 1.0;
/// A page whose tile a cull met within this many frames is on screen.
const SHOWN_FRAMES: u32 = 2;

/// Merged pages that are to be replaced, with their slots.
pub(super) type Outdated = BTreeMap<PageId, NodeId>;

impl DatabasePager {
    /// Replaces the overlays of a scene. Contents on screen stay until each is loaded with the new ones; others leave, and are
    /// loaded when they are wanted. A content that has tiles below it in the same file (OpenSceneGraph's databases) leaves with
    /// them once its successor is there.
    pub fn set_overlays(
        &mut self,
        scene: &mut Scene,
        overlays: Option<Arc<OverlaySet>>,
        contexts: &mut [&mut dyn CompileContext],
    ) {
        let number = scene.number();
        if let Some(claimant) = self.scenes.claimant(scene) {
            self.claim(claimant);
        }
        if !self.scenes.set_overlays(number, overlays) {
            return;
        }
        // Contents in flight have the old images, and failed ones are tried again.
        let failed = self.table.iter().filter(|(slot, entry)| slot.page.scene == number && entry.has_failed());
        for (slot, _) in failed {
            scene.forget_failure(slot);
            // No camera requests these.
            let is_asked = matches!(scene.proxy_loading(slot), Some(ProxyLoading::Immediately | ProxyLoading::Never));
            self.forced.extend(is_asked.then_some(slot));
        }
        self.drop_requests(contexts, |slot, _| slot.page.scene == number);
        let has_content = |page: &Page| !page.is_tile_tree() || page.drawable_count() > 0;
        let is_content = |page: &PageId| scene.page(*page).is_some_and(has_content);
        self.outdated.extend(self.residency.slots_of(number).filter(|(page, _)| is_content(page)));
    }

    /// Requests the successors of outdated pages that are on screen, and detaches those that are not.
    pub(super) fn refresh(&mut self, scenes: &mut dyn SceneSet, contexts: &mut [&mut dyn CompileContext]) {
        if self.outdated.is_empty() {
            return;
        }
        let first_shown = self.control.times.frame().saturating_sub(SHOWN_FRAMES);
        let (mut requests, mut unused) = (Vec::new(), Vec::new());
        self.outdated.retain(|page, slot| {
            let found = scenes.slot(*slot).filter(|info| info.state == SlotState::Resident(*page));
            let Some(info) = found else { return false };
            let is_expirable = || scenes.numbered(page.scene).is_some_and(|scene| scene.is_expirable(*page));
            // Not all proxies are requested by culls.
            if info.last_used_frame >= first_shown || info.is_proxy {
                requests.push(PageRequest { slot: *slot, priority: PRIORITY_PX, error_px: 0.0, ahead_frames: 0 });
            } else if is_expirable() {
                unused.push(*page);
                return false;
            }
            true
        });
        for page in unused {
            self.residency.remove(page);
            self.detach(scenes, page, contexts);
        }
        self.accept(scenes, &requests);
    }

    /// Detaches the outdated page of a slot, if it has one: its successor is about to be attached.
    pub(super) fn detach_outdated(
        &mut self,
        scenes: &mut dyn SceneSet,
        slot: NodeId,
        contexts: &mut [&mut dyn CompileContext],
    ) {
        if let Some(SlotState::Resident(page)) = scenes.slot(slot).map(|slot| slot.state)
            && self.outdated.contains_key(&page)
        {
            self.detach_with_below(scenes, page, contexts);
        }
    }

    /// Detaches a page, and before it the pages in its slots, which would be lost with it.
    fn detach_with_below(&mut self, scenes: &mut dyn SceneSet, page: PageId, contexts: &mut [&mut dyn CompileContext]) {
        let is_below = |(below, slot): (PageId, NodeId)| (slot.page == page).then_some(below);
        let below: Vec<PageId> = self.residency.slots_of(page.scene).filter_map(is_below).collect();
        for below in below {
            self.detach_with_below(scenes, below, contexts);
        }
        self.outdated.remove(&page);
        self.residency.remove(page);
        self.detach(scenes, page, contexts);
    }

    /// Marks a slot whose load has failed. If it was for a successor, the outdated page stays: for good, unless there will be
    /// a retry.
    pub(super) fn mark_failed(&mut self, scenes: &mut dyn SceneSet, slot: NodeId) {
        let Some(SlotState::Resident(page)) = scenes.slot(slot).map(|slot| slot.state) else {
            scenes.set_failed(slot, true);
            return;
        };
        if !self.table.get(slot).is_some_and(Entry::will_retry) {
            self.outdated.remove(&page);
            self.table.remove(slot);
        }
    }
}
