//! [`PagerGroup`]: a pager with the scenes that it serves, its turns in a frame, and the question whether it is at rest.
//! Main thread.

use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::sync::Arc;
use std::time::Instant;

use super::SceneList;
use super::paged_scene::PagedScene;
use crate::cull::PageRequest;
use crate::formats::OverlaySet;
use crate::pager::{DatabasePager, SceneSet};
use crate::scene::Scene;
use crate::viewer::ViewerError;
use crate::viewer::clock::FrameStamp;
use crate::viewer::ids::SceneId;
use crate::viewer::rendering::{Rendering, millis};

/// After this many frames without progress the remaining requests count as declined. Frames in which the pager scans all
/// pages for memory are added to it.
const QUIET_FRAMES: u32 = 4;

/// The scenes of a group as the pager changes them.
struct Members<'a> {
    scenes: &'a mut SceneList,
    ids: &'a [SceneId],
}

impl SceneSet for Members<'_> {
    fn at(&self, index: usize) -> Option<&Scene> {
        self.scenes.get(*self.ids.get(index)?).map(PagedScene::scene)
    }

    fn at_mut(&mut self, index: usize) -> Option<&mut Scene> {
        self.scenes.get_mut(*self.ids.get(index)?).map(PagedScene::scene_mut)
    }
}

/// The scenes of a group, read only.
struct MembersView<'a> {
    scenes: &'a SceneList,
    ids: &'a [SceneId],
}

impl SceneSet for MembersView<'_> {
    fn at(&self, index: usize) -> Option<&Scene> {
        self.scenes.get(*self.ids.get(index)?).map(PagedScene::scene)
    }

    fn at_mut(&mut self, _: usize) -> Option<&mut Scene> {
        None
    }
}

/// A pager, and the scenes that share it.
pub(in crate::viewer) struct PagerGroup {
    /// Distinguishes the pager's uploads from those of other pagers.
    owner: u16,
    /// `None` until one of the scenes has contents to page.
    pager: Option<DatabasePager>,
    /// Each update waits until everything wanted is loaded.
    blocking: bool,
    /// The scenes in the order added.
    members: Vec<SceneId>,
    /// The requests of all scenes together; kept for its memory.
    requests: Vec<PageRequest>,
    /// The pager had nothing to do after its last turn.
    is_idle: bool,
    /// Successive frames with the same requests, for which the pager could do nothing.
    quiet_frames: u32,
    /// A hash of the last frame's requests.
    request_hash: u64,
}

impl PagerGroup {
    pub(super) fn new(owner: u16, blocking: bool) -> Self {
        Self {
            owner,
            pager: None,
            blocking,
            members: Vec::new(),
            requests: Vec::new(),
            is_idle: false,
            quiet_frames: 0,
            request_hash: 0,
        }
    }

    pub(super) fn owner(&self) -> u16 {
        self.owner
    }

    pub(in crate::viewer) fn pager(&self) -> Option<&DatabasePager> {
        self.pager.as_ref()
    }

    pub(in crate::viewer) fn pager_mut(&mut self) -> Option<&mut DatabasePager> {
        self.pager.as_mut()
    }

    pub(in crate::viewer) fn members(&self) -> &[SceneId] {
        &self.members
    }

    /// Adds a scene that is about to be created.
    pub(super) fn add_member(&mut self, scene: SceneId) {
        self.members.push(scene);
    }

    fn member_scenes<'a>(&'a self, scenes: &'a SceneList) -> impl Iterator<Item = &'a PagedScene> {
        self.members.iter().filter_map(|id| scenes.get(*id))
    }

    /// Gives a scene another pager and removes the pages that the old one merged into it. A pager that other scenes use is
    /// kept and adopts the scope of the new one.
    pub(super) fn set_pager(
        &mut self,
        pager: DatabasePager,
        scenes: &mut SceneList,
        scene: SceneId,
        rendering: &mut Rendering,
    ) -> Result<(), ViewerError> {
        self.clear_pages(scenes, scene, rendering);
        match &mut self.pager {
            Some(before) if self.members.len() > 1 => Ok(before.adopt(scenes[scene].scene().number(), pager)?),
            _ => {
                self.replace_pager(pager, scenes, scene, rendering);
                Ok(())
            }
        }
    }

    /// Replaces the pager of a group with one scene, or one that had no pager.
    pub(super) fn replace_pager(
        &mut self,
        mut pager: DatabasePager,
        scenes: &mut SceneList,
        scene: SceneId,
        rendering: &mut Rendering,
    ) {
        self.clear_pages(scenes, scene, rendering);
        pager.claim(scenes[scene].scene().number());
        if let Some(before) = &self.pager {
            pager.continue_from(before);
        }
        self.pager = Some(pager);
    }

    /// Returns true when the last frame showed everything that it wanted of these scenes, the application's pages included, and
    /// the pager is idle.
    pub(in crate::viewer) fn is_settled(&self, scenes: &SceneList) -> bool {
        self.is_idle && self.member_scenes(scenes).all(PagedScene::is_complete)
    }

    /// Returns true when the last frame showed everything and the next frames will look the same.
    pub(in crate::viewer) fn is_at_rest(&self, scenes: &SceneList) -> bool {
        let view = MembersView { scenes, ids: &self.members };
        let has_asked = self.pager.as_ref().is_some_and(|pager| pager.has_asked(&view));
        let is_fading = self.member_scenes(scenes).any(|scene| scene.findings().is_fading());
        !has_asked && !is_fading && self.is_settled(scenes)
    }

    /// Returns true when the next frames will look like the last one: everything is resident, or what is missing cannot be loaded
    /// now, for lack of memory or because the pager is paused.
    pub(in crate::viewer) fn is_unchanging(&self, scenes: &SceneList) -> bool {
        let is_steady = |scene: &PagedScene| !scene.findings().is_fading() && !scene.is_uploading();
        let is_stuck = || self.member_scenes(scenes).all(is_steady) && self.is_stuck(scenes, self.quiet_frames);
        self.is_at_rest(scenes) || is_stuck()
    }

    /// Returns true when the pager had nothing to do for `quiet` frames, or rounds of the blocking mode, and these are enough to
    /// know that it declines the remaining requests.
    pub(in crate::viewer) fn is_stuck(&self, scenes: &SceneList, quiet: u32) -> bool {
        let scan_frames = self.pager.as_ref().map_or(0, DatabasePager::frames_to_look);
        quiet >= QUIET_FRAMES + scan_frames && !self.has_work(scenes)
    }

    /// Returns true when the pager's next turn would act on the last frame's requests.
    pub(in crate::viewer) fn has_work(&self, scenes: &SceneList) -> bool {
        let Some(pager) = &self.pager else { return false };
        let view = MembersView { scenes, ids: &self.members };
        pager.has_work(&view, self.member_scenes(scenes).flat_map(|scene| scene.findings().requests()))
    }

    /// Returns true when the back-off of a failed request is over.
    pub(in crate::viewer) fn has_due(&self) -> bool {
        self.pager.as_ref().is_some_and(DatabasePager::has_due)
    }

    /// Runs the pager's turn in update: it merges, expires, uploads and requests. Returns its milliseconds.
    pub(in crate::viewer) fn page(
        &mut self,
        scenes: &mut SceneList,
        rendering: &mut Rendering,
        stamp: &FrameStamp,
    ) -> f64 {
        let start = Instant::now();
        let _span = crate::trace::span("merge");
        for id in &self.members {
            scenes[*id].merge_own(rendering);
        }
        self.gather_requests(scenes, true);
        // Simulation time repeats with a flight.
        let time_s = if self.blocking { stamp.simulation_time_s } else { stamp.reference_time_s };
        let Self { owner, pager, members, requests, .. } = self;
        self.is_idle = pager.as_mut().is_none_or(|pager| {
            let mut scenes = Members { scenes, ids: members };
            rendering.compile_for(*owner, |contexts| {
                pager.update_scene_graph(&mut scenes, stamp.frame, time_s, requests, contexts);
            });
            pager.is_idle()
        });
        millis(start.elapsed())
    }

    /// Collects the requests of all scenes, and their prefetches if asked.
    fn gather_requests(&mut self, scenes: &SceneList, with_prefetches: bool) {
        self.requests.clear();
        for scene in self.members.iter().map(|id| &scenes[*id]) {
            self.requests.extend_from_slice(scene.findings().requests());
            if with_prefetches {
                self.requests.extend_from_slice(scene.findings().prefetches());
            }
        }
    }

    /// Hands the requests of the last culls to the pager, so that loading starts while this frame is drawn instead of in
    /// the next update.
    pub(in crate::viewer) fn request(&mut self, scenes: &SceneList) {
        self.gather_requests(scenes, false);
        if let (Some(pager), false) = (&mut self.pager, self.blocking) {
            pager.request(&MembersView { scenes, ids: &self.members }, &self.requests);
        }
        let mut hash = DefaultHasher::new();
        self.requests.iter().for_each(|request| (request.slot, request.priority.to_bits()).hash(&mut hash));
        let before = std::mem::replace(&mut self.request_hash, hash.finish());
        let is_quiet = self.request_hash == before && !self.has_work(scenes);
        self.quiet_frames = if is_quiet { self.quiet_frames.saturating_add(1) } else { 0 };
    }

    /// Returns true when tiles were merged that no cull has seen. The blocking mode culls in rounds anyway.
    pub(in crate::viewer) fn has_new_tiles(&self) -> bool {
        !self.blocking && self.pager.as_ref().is_some_and(DatabasePager::has_new_tiles)
    }

    /// Begins to collect requests for [`Self::request_now`].
    pub(super) fn begin_requests(&mut self) {
        self.requests.clear();
    }

    /// Adds requests to those that [`Self::request_now`] hands over.
    pub(super) fn add_requests(&mut self, requests: &[PageRequest]) {
        self.requests.extend_from_slice(requests);
    }

    /// Hands the collected requests to the pager, and lets its threads begin.
    pub(super) fn request_now(&mut self, scenes: &SceneList) {
        if let Some(pager) = &mut self.pager {
            pager.request_now(&MembersView { scenes, ids: &self.members }, &self.requests);
        }
    }

    /// Returns true when pages may arrive and be merged while the main thread waits.
    pub(in crate::viewer) fn is_paging(&self) -> bool {
        !self.blocking && self.pager.as_ref().is_some_and(|pager| !pager.is_idle())
    }

    pub(in crate::viewer) fn merge_arrived(&mut self, scenes: &mut SceneList, rendering: &mut Rendering) {
        if let Some(pager) = &mut self.pager {
            let mut scenes = Members { scenes, ids: &self.members };
            rendering.compile_for(self.owner, |contexts| pager.merge_arrived(&mut scenes, contexts));
        }
    }

    /// Uploads, merges and expires pages until there are new tiles, or until shortly before `deadline`.
    pub(in crate::viewer) fn work_until_new_tiles(
        &mut self,
        scenes: &mut SceneList,
        rendering: &mut Rendering,
        deadline: Instant,
    ) {
        if let (Some(pager), false) = (&mut self.pager, self.blocking) {
            let mut scenes = Members { scenes, ids: &self.members };
            rendering.compile_for(self.owner, |contexts| pager.work_until_new_tiles(&mut scenes, contexts, deadline));
        }
    }

    /// Uploads, merges and expires pages until shortly before `deadline`.
    pub(in crate::viewer) fn work_until(
        &mut self,
        scenes: &mut SceneList,
        rendering: &mut Rendering,
        deadline: Instant,
    ) {
        if let (Some(pager), false) = (&mut self.pager, self.blocking) {
            let mut scenes = Members { scenes, ids: &self.members };
            rendering.compile_for(self.owner, |contexts| pager.work_until(&mut scenes, contexts, deadline));
        }
    }

    /// Drops the uploads to a device that is gone; they would never finish.
    pub(super) fn device_closed(&mut self, rendering: &mut Rendering, device: u32) {
        if let Some(pager) = &mut self.pager {
            rendering.compile_for(self.owner, |contexts| pager.forget_context(device, contexts));
        }
    }

    /// Notes that pages are removed, which the next frames will want.
    fn note_removal(&mut self) {
        (self.is_idle, self.quiet_frames) = (false, 0);
    }

    /// Removes every page that the pager merged into a scene, and forgets its requests.
    pub(super) fn clear_pages(&mut self, scenes: &mut SceneList, scene: SceneId, rendering: &mut Rendering) {
        self.note_removal();
        let scene = &mut scenes[scene];
        scene.findings_mut().clear_requests();
        if let Some(pager) = &mut self.pager {
            rendering.compile_for(self.owner, |contexts| pager.clear(scene.scene_mut(), contexts));
        }
    }

    /// Replaces the overlays of a scene.
    pub(super) fn set_overlays(
        &mut self,
        scenes: &mut SceneList,
        scene: SceneId,
        overlays: Option<Arc<OverlaySet>>,
        rendering: &mut Rendering,
    ) {
        self.note_removal();
        let scene = &mut scenes[scene];
        scene.set_overlays(overlays.clone());
        scene.findings_mut().clear_requests();
        if let Some(pager) = &mut self.pager {
            rendering.compile_for(self.owner, |contexts| pager.set_overlays(scene.scene_mut(), overlays, contexts));
        }
    }

    /// Removes a scene from the group, with its merged pages and requests. Returns false when no scene is left.
    pub(super) fn remove_scene(&mut self, scenes: &mut SceneList, scene: SceneId, rendering: &mut Rendering) -> bool {
        if let Some(index) = self.members.iter().position(|of| *of == scene) {
            self.members.remove(index);
            self.note_removal();
            if let Some(pager) = &mut self.pager {
                let scene = scenes[scene].scene_mut();
                rendering.compile_for(self.owner, |contexts| pager.remove_scene(scene, contexts));
            }
        }
        !self.members.is_empty()
    }

    /// Removes every merged page that can be loaded again, so that a new device gets all of them.
    pub(super) fn page_anew(&mut self, scenes: &mut SceneList, rendering: &mut Rendering) {
        self.note_removal();
        let Some(pager) = &mut self.pager else { return };
        for id in &self.members {
            let scene = scenes[*id].scene_mut();
            rendering.compile_for(self.owner, |contexts| pager.page_anew(scene, contexts));
        }
    }
}
