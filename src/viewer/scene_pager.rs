//! [`ScenePager`]: a pager with the scenes of a viewer that it fills, its turns in a frame, and whether it is at rest. Main
//! thread, with all scenes to itself.

use std::collections::HashSet;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::time::Instant;

use super::ViewerError;
use super::base::ViewerBase;
use super::home::LoadedRoot;
use super::paged_scene::PagedScene;
use super::rendering::{Rendering, millis};
use super::view::View;
use crate::cull::PageRequest;
use crate::pager::{DatabasePager, SceneSet};
use crate::scene::{PageId, Scene};

/// With nothing under way for this many frames, besides those in which the pager looks at all pages for room, requests that
/// remain are ones that it declines.
const QUIET_FRAMES: u32 = 4;
/// Rounds of cull and load in one frame of the blocking mode: the deepest tree of tilesets that is followed.
const MAX_BLOCKING_ROUNDS: u32 = 256;

/// Scenes that a viewer may have at once, and pagers: their numbers share the tickets of uploads with the pages'.
pub(super) const MOST_SCENES: usize = 1 << 15;

/// The least number that nobody's uploads have.
pub(super) fn free_owner(taken: impl Iterator<Item = u16>) -> Option<u16> {
    let taken: HashSet<u16> = taken.collect();
    (0..MOST_SCENES as u16).find(|owner| !taken.contains(owner))
}

/// A pager, and the scenes that have it.
pub(super) struct ScenePager {
    /// Tells its uploads from those of other pagers.
    owner: u16,
    /// Once one of the scenes has something to page.
    pager: Option<DatabasePager>,
    /// It waits, in each update, for all that is wanted.
    blocking: bool,
    /// Places of its scenes, in the order added.
    pub(super) members: Vec<usize>,
    /// What the scenes ask for, together.
    requests: Vec<PageRequest>,
    /// The pager had nothing to do after its last turn.
    is_idle: bool,
    /// Frames in a row in which the same was asked for, and the pager could do nothing for it.
    quiet_frames: u32,
    /// A hash of what the last frame's pictures lacked.
    asked: u64,
}

/// The scenes of a pager.
struct Members<'a> {
    scenes: &'a mut [PagedScene],
    members: &'a [usize],
}

impl SceneSet for Members<'_> {
    fn at(&self, place: usize) -> Option<&Scene> {
        self.scenes.get(*self.members.get(place)?).map(PagedScene::scene)
    }

    fn at_mut(&mut self, place: usize) -> Option<&mut Scene> {
        self.scenes.get_mut(*self.members.get(place)?).map(PagedScene::scene_mut)
    }
}

/// The same, only looked at.
struct Seen<'a> {
    scenes: &'a [PagedScene],
    members: &'a [usize],
}

impl SceneSet for Seen<'_> {
    fn at(&self, place: usize) -> Option<&Scene> {
        self.scenes.get(*self.members.get(place)?).map(PagedScene::scene)
    }

    fn at_mut(&mut self, _: usize) -> Option<&mut Scene> {
        None
    }
}

impl ScenePager {
    pub(super) fn new(owner: u16, blocking: bool) -> Self {
        Self {
            owner,
            pager: None,
            blocking,
            members: Vec::new(),
            requests: Vec::new(),
            is_idle: false,
            quiet_frames: 0,
            asked: 0,
        }
    }

    pub(super) fn pager(&self) -> Option<&DatabasePager> {
        self.pager.as_ref()
    }

    pub(super) fn pager_mut(&mut self) -> Option<&mut DatabasePager> {
        self.pager.as_mut()
    }

    fn seen<'a>(&'a self, scenes: &'a [PagedScene]) -> impl Iterator<Item = &'a PagedScene> {
        self.members.iter().filter_map(|place| scenes.get(*place))
    }

    /// Takes another pager for a scene, whose scope is that scene's. What hangs in the scene by the one before goes with it,
    /// and so does that pager where no other scene has it; where others have, it goes on and takes the scope alone.
    fn set_pager(
        &mut self,
        pager: DatabasePager,
        scenes: &mut [PagedScene],
        place: usize,
        rendering: &mut Rendering,
    ) -> Result<(), ViewerError> {
        self.clear_pages(scenes, place, rendering);
        match &mut self.pager {
            Some(before) if self.members.len() > 1 => Ok(before.adopt(scenes[place].scene().number(), pager)?),
            _ => {
                self.replace_pager(pager, scenes, place, rendering);
                Ok(())
            }
        }
    }

    /// Takes another pager for its only scene, or for the first that has something to page.
    fn replace_pager(
        &mut self,
        mut pager: DatabasePager,
        scenes: &mut [PagedScene],
        place: usize,
        rendering: &mut Rendering,
    ) {
        self.clear_pages(scenes, place, rendering);
        pager.claim(scenes[place].scene().number());
        if let Some(before) = &self.pager {
            pager.continue_from(before);
        }
        self.pager = Some(pager);
    }

    /// The last frame showed everything that it wanted of these scenes, the application's pages too, and the pager has
    /// nothing to do.
    pub(super) fn is_settled(&self, scenes: &[PagedScene]) -> bool {
        self.is_idle && self.seen(scenes).all(PagedScene::shows_all)
    }

    /// The last frame's pictures show everything, and are those that the next ones will be.
    pub(super) fn is_at_rest(&self, scenes: &[PagedScene]) -> bool {
        let seen = Seen { scenes, members: &self.members };
        let is_asked = self.pager.as_ref().is_some_and(|pager| pager.has_asked(&seen));
        !is_asked && self.seen(scenes).all(|scene| scene.fading == 0) && self.is_settled(scenes)
    }

    /// The next frames' pictures will be the last one's: everything is there, or what is not does not come, as where it
    /// finds no room or the pager is paused.
    pub(super) fn is_unchanging(&self, scenes: &[PagedScene]) -> bool {
        let stands = |scene: &PagedScene| scene.fading == 0 && !scene.is_uploading();
        let is_stuck = || self.seen(scenes).all(stands) && self.is_stuck(scenes, self.quiet_frames);
        self.is_at_rest(scenes) || is_stuck()
    }

    /// After so many frames, or rounds of the blocking mode, in which the pager could do nothing.
    pub(super) fn is_stuck(&self, scenes: &[PagedScene], quiet: u32) -> bool {
        let to_look = self.pager.as_ref().map_or(0, DatabasePager::frames_to_look);
        quiet >= QUIET_FRAMES + to_look && !self.has_work(scenes)
    }

    /// The pager's next turn would do something for what the last frame's pictures lacked.
    pub(super) fn has_work(&self, scenes: &[PagedScene]) -> bool {
        let Some(pager) = &self.pager else { return false };
        let seen = Seen { scenes, members: &self.members };
        pager.has_work(&seen, self.seen(scenes).flat_map(|scene| &scene.requests))
    }

    /// Something that failed is to be tried again.
    pub(super) fn has_due(&self) -> bool {
        self.pager.as_ref().is_some_and(DatabasePager::has_due)
    }

    /// The pager's turn with its scenes; milliseconds.
    pub(super) fn page(&mut self, scenes: &mut [PagedScene], rendering: &mut Rendering, frame: u32) -> f64 {
        let start = Instant::now();
        let _span = crate::timeline::span("merge");
        for place in &self.members {
            scenes[*place].merge_own(rendering);
        }
        self.gather(scenes, true);
        let Self { owner, pager, members, requests, .. } = self;
        self.is_idle = pager.as_mut().is_none_or(|pager| {
            let mut scenes = Members { scenes, members };
            rendering.compile_for(*owner, |contexts| {
                pager.update_scene_graph(&mut scenes, frame, requests, contexts);
            });
            pager.is_idle()
        });
        millis(start.elapsed())
    }

    /// What pictures lack, and with `ahead` what they will.
    fn gather(&mut self, scenes: &[PagedScene], ahead: bool) {
        self.requests.clear();
        for scene in self.members.iter().map(|place| &scenes[*place]) {
            self.requests.extend_from_slice(&scene.requests);
            if ahead {
                self.requests.extend_from_slice(&scene.requests_ahead);
            }
        }
    }

    /// Hands over what the last culls lack: it is read while this frame is drawn, not from the next update on.
    pub(super) fn request(&mut self, scenes: &mut [PagedScene]) {
        self.gather(scenes, false);
        if let (Some(pager), false) = (&mut self.pager, self.blocking) {
            pager.request(&Seen { scenes, members: &self.members }, &self.requests);
        }
        let mut hash = DefaultHasher::new();
        self.requests.iter().for_each(|request| (request.slot, request.priority.to_bits()).hash(&mut hash));
        let before = std::mem::replace(&mut self.asked, hash.finish());
        let is_quiet = self.asked == before && !self.has_work(scenes);
        self.quiet_frames = if is_quiet { self.quiet_frames.saturating_add(1) } else { 0 };
    }

    /// True where something may arrive and be merged while the main thread waits.
    pub(super) fn is_paging(&self) -> bool {
        !self.blocking && self.pager.as_ref().is_some_and(|pager| !pager.is_idle())
    }

    pub(super) fn merge_arrived(&mut self, scenes: &mut [PagedScene], rendering: &mut Rendering) {
        if let Some(pager) = &mut self.pager {
            let mut scenes = Members { scenes, members: &self.members };
            rendering.compile_for(self.owner, |contexts| pager.merge_arrived(&mut scenes, contexts));
        }
    }

    /// Uploads, merges and expires what arrives until shortly before `deadline`.
    pub(super) fn work_until(&mut self, scenes: &mut [PagedScene], rendering: &mut Rendering, deadline: Instant) {
        if let (Some(pager), false) = (&mut self.pager, self.blocking) {
            let mut scenes = Members { scenes, members: &self.members };
            rendering.compile_for(self.owner, |contexts| pager.work_until(&mut scenes, contexts, deadline));
        }
    }

    /// Uploads that wait for a device that is gone would wait for ever.
    pub(super) fn device_closed(&mut self, rendering: &mut Rendering, device: u32) {
        if let Some(pager) = &mut self.pager {
            rendering.compile_for(self.owner, |contexts| pager.forget_context(device, contexts));
        }
    }

    /// Takes every paged page of a scene out, and forgets what was asked for it.
    pub(super) fn clear_pages(&mut self, scenes: &mut [PagedScene], place: usize, rendering: &mut Rendering) {
        (self.is_idle, self.quiet_frames) = (false, 0);
        let scene = &mut scenes[place];
        scene.requests.clear();
        scene.requests_ahead.clear();
        if let Some(pager) = &mut self.pager {
            rendering.compile_for(self.owner, |contexts| pager.clear(scene.scene_mut(), contexts));
        }
    }

    /// A scene goes, with its pages and what was asked for it; those behind it change their places. False where no scene
    /// is left.
    fn remove_scene(&mut self, scenes: &mut [PagedScene], place: usize, rendering: &mut Rendering) -> bool {
        if let Some(at) = self.members.iter().position(|of| *of == place) {
            self.members.remove(at);
            (self.is_idle, self.quiet_frames) = (false, 0);
            if let Some(pager) = &mut self.pager {
                let scene = scenes[place].scene_mut();
                rendering.compile_for(self.owner, |contexts| pager.remove_scene(scene, contexts));
            }
        }
        self.members.iter_mut().filter(|of| **of > place).for_each(|of| *of -= 1);
        !self.members.is_empty()
    }

    /// Takes every paged page out that can go, to be loaded and uploaded again.
    pub(super) fn page_anew(&mut self, scenes: &mut [PagedScene], rendering: &mut Rendering) {
        (self.is_idle, self.quiet_frames) = (false, 0);
        let Some(pager) = &mut self.pager else { return };
        for place in &self.members {
            let scene = scenes[*place].scene_mut();
            rendering.compile_for(self.owner, |contexts| pager.page_anew(scene, contexts));
        }
    }
}

impl ViewerBase {
    /// The pager of a scene that is about to be added: a new one, or another scene's.
    pub(super) fn add_pager(&mut self, place: usize, shared: Option<usize>) -> usize {
        let of = shared.unwrap_or_else(|| {
            // No more than there are scenes, which are few enough.
            let owner = free_owner(self.pagers.iter().map(|pager| pager.owner)).unwrap_or(u16::MAX);
            self.pagers.push(ScenePager::new(owner, self.blocking));
            self.pagers.len() - 1
        });
        self.pagers[of].members.push(place);
        of
    }

    pub(super) fn pager_of(&self, scene: &PagedScene) -> &ScenePager {
        &self.pagers[scene.pager]
    }

    /// Loads a root tile set into a scene that shows none.
    pub(super) fn set_root(
        &mut self,
        scenes: &mut [PagedScene],
        place: usize,
        root: LoadedRoot,
    ) -> Result<PageId, ViewerError> {
        let LoadedRoot { pager, page, uri, region } = root;
        scenes[place].check_shows_none()?;
        self.set_pager(scenes, place, pager)?;
        scenes[place].hang_set(page, uri, region, &mut self.rendering)
    }

    /// Replaces the pager of a scene, or its scope in a shared one.
    pub(super) fn set_pager(
        &mut self,
        scenes: &mut [PagedScene],
        place: usize,
        pager: DatabasePager,
    ) -> Result<(), ViewerError> {
        let of = scenes[place].pager;
        self.pagers[of].set_pager(pager, scenes, place, &mut self.rendering)
    }

    /// Replaces the pager of a viewer's only scene.
    pub(super) fn replace_pager(&mut self, paged: &mut PagedScene, pager: DatabasePager) {
        let of = paged.pager;
        self.pagers[of].replace_pager(pager, std::slice::from_mut(paged), 0, &mut self.rendering);
    }

    /// Takes every page out of a scene that its pager merged.
    pub(super) fn clear_pages(&mut self, scenes: &mut [PagedScene], place: usize) {
        let of = scenes[place].pager;
        self.pagers[of].clear_pages(scenes, place, &mut self.rendering);
    }

    /// Takes a scene out with what it has on devices, and its pager where no other scene has that. No frame is under way.
    pub(super) fn remove_scene(&mut self, scenes: &mut Vec<PagedScene>, place: usize) {
        let of = scenes[place].pager;
        let mut stays = true;
        for (at, pager) in self.pagers.iter_mut().enumerate() {
            let has_scenes = pager.remove_scene(scenes, place, &mut self.rendering);
            stays &= has_scenes || at != of;
        }
        let scene = scenes.remove(place);
        // What is on its way would come when its number is another's. A pager that stays takes its own.
        self.rendering.finish_compiles();
        scene.close(&mut self.rendering);
        if !stays {
            let gone = self.pagers.remove(of);
            self.rendering.release_compiled(gone.owner, false);
            scenes.iter_mut().filter(|scene| scene.pager > of).for_each(|scene| scene.pager -= 1);
        }
    }

    /// Uploads everything to a device that was opened after others.
    pub(super) fn device_opened(&mut self, scenes: &mut [PagedScene], device: u32) -> Result<(), ViewerError> {
        for scene in scenes.iter_mut() {
            scene.device_opened(&mut self.rendering, device)?;
        }
        for pager in &mut self.pagers {
            pager.page_anew(scenes, &mut self.rendering);
        }
        Ok(())
    }

    /// Forgets what a device had that is gone.
    pub(super) fn device_closed(&mut self, scenes: &mut [PagedScene], device: u32) {
        for pager in &mut self.pagers {
            pager.device_closed(&mut self.rendering, device);
        }
        for scene in scenes {
            scene.device_closed(device);
        }
    }

    /// Loads until nothing of what the views of a pager's scenes want is missing, or nothing more comes; milliseconds of
    /// paging.
    pub(super) fn settle(&mut self, views: &[View], scenes: &mut [PagedScene], pager: usize) -> f64 {
        let (mut merge_ms, mut quiet) = (0.0, 0);
        self.look(views, scenes, pager);
        for _ in 0..MAX_BLOCKING_ROUNDS {
            let of = &self.pagers[pager];
            if of.is_settled(scenes) || of.is_stuck(scenes, quiet) {
                break;
            }
            merge_ms += self.pagers[pager].page(scenes, &mut self.rendering, self.stamp.frame);
            self.look(views, scenes, pager);
            quiet = if self.pagers[pager].has_work(scenes) { 0 } else { quiet + 1 };
        }
        merge_ms
    }

    /// Looks at all scenes of a pager.
    fn look(&mut self, views: &[View], scenes: &mut [PagedScene], pager: usize) {
        for at in 0..self.pagers[pager].members.len() {
            let place = self.pagers[pager].members[at];
            self.look_at(views, &mut scenes[place], place);
        }
    }

    /// Culls on this very thread, without a frame: what would be requested, and what misses.
    fn look_at(&mut self, views: &[View], scene: &mut PagedScene, place: usize) {
        scene.requests.clear();
        scene.wanted_missing = 0;
        for view in views.iter().filter(|view| view.scene == place) {
            for camera in view.cameras() {
                let Some(task) = view.task(camera, scene, self.stamp.frame, Vec::new()) else { continue };
                let outcome = task.run(&mut self.probe, &mut self.probe_stage);
                scene.requests.extend_from_slice(&outcome.requests);
                scene.wanted_missing += outcome.counters.wanted_missing;
            }
        }
    }
}
