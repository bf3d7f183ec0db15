//! The order in which uploaded pages are merged: by priority, fair between scenes.

use std::collections::BTreeMap;

use crate::pager::requests::fairness::SceneTurns;
use crate::scene::{NodeId, SceneNumber};

/// Orders merges, and remembers which scenes were passed over. Update thread.
#[derive(Debug, Default)]
pub(in crate::pager) struct MergeOrder {
    turns: SceneTurns,
}

impl MergeOrder {
    /// Orders slots, the most urgent first, fairly if there are several scenes.
    pub fn arrange(&self, ready: Vec<NodeId>, has_several_scenes: bool) -> Vec<NodeId> {
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
