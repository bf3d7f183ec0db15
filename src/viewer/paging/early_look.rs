//! [`EarlyLook`]: requests the contents of new tiles without waiting for the next frame. Main thread, while it waits.
//!
//! A subtree of implicit tiling or a nested tileset brings tiles whose contents nobody could request before. The next cull would
//! find them, but it waits for the frames in flight, and on each level of a tree anew. So the cameras are culled once more as
//! soon as such a page is merged, for the requests alone, while the main thread has nothing else to do.

use std::time::{Duration, Instant};

use super::{PagerGroup, SceneList};
use crate::viewer::view::{Probe, ViewList};

/// After a look the next one waits this many times as long as the look took: looks take a fifth of the waiting time at most.
const PAUSE_FACTOR: u32 = 4;

/// Paces the looks.
#[derive(Debug)]
pub(in crate::viewer) struct EarlyLook {
    /// The time of the next look.
    next: Instant,
    /// The duration of the last look.
    last_took: Duration,
}

impl EarlyLook {
    pub(in crate::viewer) fn new() -> Self {
        Self { next: Instant::now(), last_took: Duration::ZERO }
    }

    /// Culls the cameras of a group for the contents of its new tiles, and requests these at once. Returns false without that
    /// where there are none, too soon after the last look, or if another like the last one would not end before `deadline`.
    pub(in crate::viewer) fn look(
        &mut self,
        group: &mut PagerGroup,
        views: &ViewList,
        scenes: &SceneList,
        probe: &mut Probe,
        frame: u32,
        deadline: Option<Instant>,
    ) -> bool {
        let start = Instant::now();
        if !group.has_new_tiles() || start < self.next {
            return false;
        }
        if deadline.is_some_and(|deadline| start + self.last_took >= deadline) {
            // One look that took long, since the thread was interrupted, does not prevent all others.
            self.last_took /= 2;
            return false;
        }
        let _span = crate::trace::span("early look");
        group.begin_requests();
        for view in views.values() {
            let scene = scenes.get(view.scene()).filter(|_| group.members().contains(&view.scene()));
            let Some(scene) = scene else { continue };
            for camera in view.cameras() {
                if let Some(task) = view.task(camera, scene, frame, Vec::new()) {
                    group.add_requests(probe.requests_of(scene.scene(), &task.camera));
                }
            }
        }
        group.request_now(scenes);
        self.last_took = start.elapsed();
        self.next = start + (PAUSE_FACTOR + 1) * self.last_took;
        true
    }

    /// Returns the time from which on there may be another look.
    pub(in crate::viewer) fn next(&self) -> Instant {
        self.next
    }
}
