//! Slots that are filled whatever cameras see: the application asked for them, or they are loaded immediately.

use std::collections::HashSet;

use super::table::RequestTable;
use crate::cull::PageRequest;
use crate::pager::scenes::scene_set::SceneSet;
use crate::scene::{NodeId, SceneNumber, SlotState};

/// The priority of forced slots: before everything that cameras want, whatever paging options make of it.
const FORCED_PRIORITY: f32 = f32::INFINITY;

/// Slots to fill whatever cameras see, until they are filled or their load failed for good.
#[derive(Debug, Default)]
pub(in crate::pager) struct ForcedSlots {
    slots: Vec<NodeId>,
}

impl ForcedSlots {
    /// Returns true if a slot is forced.
    pub fn contains(&self, slot: NodeId) -> bool {
        self.slots.contains(&slot)
    }

    /// Adds slots that are not yet forced.
    pub fn extend(&mut self, slots: impl IntoIterator<Item = NodeId>) {
        self.slots.extend(slots);
    }

    /// Keeps the slots for which `condition` holds.
    pub fn retain(&mut self, condition: impl Fn(NodeId) -> bool) {
        self.slots.retain(|slot| condition(*slot));
    }

    /// Forgets the slots of a scene.
    pub fn forget_scene(&mut self, scene: SceneNumber) {
        self.retain(|slot| slot.page.scene != scene);
    }

    /// Forgets slots that are filled, gone or failed for good.
    pub fn forget_settled(&mut self, scenes: &dyn SceneSet, table: &RequestTable) {
        self.retain(|slot| match scenes.slot(slot).map(|slot| slot.state) {
            Some(SlotState::Empty) => true,
            Some(SlotState::Failed) => table.get(slot).is_some_and(|entry| entry.will_retry()),
            _ => false,
        });
    }

    /// Takes the slots that the scenes ask for since the last call; returns those that were not forced before.
    pub fn take_new(&mut self, scenes: &mut dyn SceneSet) -> Vec<NodeId> {
        let mut new = Vec::new();
        for index in 0.. {
            let Some(scene) = scenes.at_mut(index) else { break };
            let asked = scene.take_asked();
            if asked.is_empty() {
                continue;
            }
            let mut known: HashSet<NodeId> = self.slots.iter().copied().collect();
            let first = self.slots.len();
            self.slots.extend(asked.into_iter().filter(|slot| known.insert(*slot)));
            new.extend_from_slice(&self.slots[first..]);
        }
        new
    }

    /// Returns a request for each slot.
    pub fn requests(&self) -> Vec<PageRequest> {
        let request =
            |slot: &NodeId| PageRequest { slot: *slot, priority: FORCED_PRIORITY, error_px: 0.0, ahead_frames: 0 };
        self.slots.iter().map(request).collect()
    }
}
