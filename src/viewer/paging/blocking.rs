//! The blocking mode: each update loads until the views lack nothing, so that frames do not depend on timing. Main thread.

use super::{PagedScene, PagerGroup, SceneList};
use crate::viewer::clock::FrameStamp;
use crate::viewer::ids::SceneId;
use crate::viewer::rendering::Rendering;
use crate::viewer::view::{Probe, ViewList};

/// Rounds of cull and load in one frame. It limits the depth of the tree of tilesets that is followed.
const MAX_ROUNDS: u32 = 256;

/// Culls and loads until the views of a group's scenes lack nothing, or nothing more can be loaded. Returns the
/// milliseconds of paging.
pub(in crate::viewer) fn load_all(
    group: &mut PagerGroup,
    views: &ViewList,
    scenes: &mut SceneList,
    rendering: &mut Rendering,
    probe: &mut Probe,
    stamp: &FrameStamp,
) -> f64 {
    let (mut merge_ms, mut quiet_rounds) = (0.0, 0);
    cull_all(group, views, scenes, probe, stamp.frame);
    for _ in 0..MAX_ROUNDS {
        if group.is_settled(scenes) || group.is_stuck(scenes, quiet_rounds) {
            break;
        }
        merge_ms += group.page(scenes, rendering, stamp);
        cull_all(group, views, scenes, probe, stamp.frame);
        quiet_rounds = if group.has_work(scenes) { 0 } else { quiet_rounds + 1 };
    }
    merge_ms
}

/// Finds the requests of all scenes of a group.
fn cull_all(group: &PagerGroup, views: &ViewList, scenes: &mut SceneList, probe: &mut Probe, frame: u32) {
    for id in group.members() {
        if let Some(scene) = scenes.get_mut(*id) {
            cull_scene(*id, scene, views, probe, frame);
        }
    }
}

/// Culls a scene from all cameras that show it, without drawing.
fn cull_scene(id: SceneId, scene: &mut PagedScene, views: &ViewList, probe: &mut Probe, frame: u32) {
    scene.findings_mut().begin_cull();
    for view in views.values().filter(|view| view.scene() == id) {
        for camera in view.cameras() {
            let Some(task) = view.task(camera, scene, frame, Vec::new()) else { continue };
            let outcome = probe.cull(task);
            scene.findings_mut().add_blocking(&outcome.requests, &outcome.counters);
        }
    }
}
