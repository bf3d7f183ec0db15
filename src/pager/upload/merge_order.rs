//! The order in which uploaded pages are merged: by priority, fair between scenes.

use std::collections::BTreeMap;

use crate::pager::requests::fairness::SceneTurns;
use crate::pager::requests::table::RequestTable;
use crate::scene::{NodeId, SceneNumber};

/// Orders merges, and remembers which scenes were passed over. Update thread.
#[derive(Debug, Default)]
pub(in crate::pager) struct MergeOrder {
    turns: SceneTurns,
}

impl MergeOrder {
    /// Orders slots by the priority of their requests, coarse before fine, and fairly if there are several scenes.
    pub fn arrange(&self, mut ready: Vec<NodeId>, table: &RequestTable, has_several_scenes: bool) -> Vec<NodeId> {
        let priority = |slot: &NodeId| table.get(*slot).map_or(f32::MIN, |entry| entry.priority);
        ready.sort_by(|a, b| priority(b).total_cmp(&priority(a)).then(a.cmp(b)));
        if has_several_scenes { self.turns.arrange(ready, |slot| slot.page.scene) } else { ready }
    }

    /// Notes how many pages of each scene were merged, and the scenes of the slots that were left for the next frame.
    pub fn merged(&mut self, by_scene: &BTreeMap<SceneNumber, u32>, left: &[NodeId]) {
        self.turns.took(by_scene, left.iter().map(|slot| slot.page.scene));
    }

    /// Forgets a scene that is no longer served.
    pub fn forget_scene(&mut self, scene: SceneNumber) {
        self.turns.forget(scene);
    }
}
