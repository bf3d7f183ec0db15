//! [`Pagers`]: the pager groups of a viewer, and what happens to them when scenes and devices are added and removed. Main
//! thread, with all frames drawn.

use std::collections::HashSet;
use std::sync::Arc;

use super::SceneList;
use super::loaded_root::LoadedRoot;
use super::paged_scene::PagedScene;
use super::pager_group::PagerGroup;
use crate::formats::OverlaySet;
use crate::pager::DatabasePager;
use crate::scene::PageId;
use crate::viewer::ViewerError;
use crate::viewer::ids::{KeyedList, PagerId, SceneId};
use crate::viewer::rendering::{Rendering, UploadOwner};

/// The number of scenes, and of pagers, that a viewer can have at once: uploads carry their owner in 15 bits.
pub(in crate::viewer) const MAX_SCENES: usize = 1 << 15;

/// Returns the smallest owner number that is not taken; `None` when all are.
pub(in crate::viewer) fn free_owner(taken: impl Iterator<Item = u16>) -> Option<u16> {
    let taken: HashSet<u16> = taken.collect();
    (0..MAX_SCENES as u16).find(|owner| !taken.contains(owner))
}

/// All pager groups of a viewer.
pub(in crate::viewer) struct Pagers {
    groups: KeyedList<PagerId, PagerGroup>,
    blocking: bool,
}

impl Pagers {
    pub(in crate::viewer) fn new(blocking: bool) -> Self {
        Self { groups: KeyedList::new(), blocking }
    }

    pub(in crate::viewer) fn iter(&self) -> impl Iterator<Item = &PagerGroup> {
        self.groups.values()
    }

    pub(in crate::viewer) fn iter_mut(&mut self) -> impl Iterator<Item = &mut PagerGroup> {
        self.groups.values_mut()
    }

    pub(in crate::viewer) fn of(&self, scene: &PagedScene) -> &PagerGroup {
        &self.groups[scene.pager()]
    }

    pub(in crate::viewer) fn of_mut(&mut self, scene: &PagedScene) -> &mut PagerGroup {
        &mut self.groups[scene.pager()]
    }

    /// Assigns a pager to a scene that is about to be added: another scene's, or a new one.
    pub(in crate::viewer) fn assign(&mut self, scene: SceneId, shared: Option<PagerId>) -> PagerId {
        let id = shared.unwrap_or_else(|| {
            // There are at most as many pagers as scenes, so a number is free.
            let owner = free_owner(self.iter().map(PagerGroup::owner)).unwrap_or(u16::MAX);
            self.groups.push(PagerGroup::new(owner, self.blocking))
        });
        self.groups[id].add_member(scene);
        id
    }

    /// Adds a root tile set to a scene that has none.
    pub(in crate::viewer) fn set_root(
        &mut self,
        scenes: &mut SceneList,
        scene: SceneId,
        root: LoadedRoot,
        rendering: &mut Rendering,
    ) -> Result<PageId, ViewerError> {
        let LoadedRoot { pager, page, uri, region } = root;
        scenes[scene].check_has_no_set()?;
        self.set_pager(scenes, scene, pager, rendering)?;
        scenes[scene].add_set(page, uri, region, rendering)
    }

    /// Replaces the pager of a scene, or its scope in a shared pager.
    pub(in crate::viewer) fn set_pager(
        &mut self,
        scenes: &mut SceneList,
        scene: SceneId,
        pager: DatabasePager,
        rendering: &mut Rendering,
    ) -> Result<(), ViewerError> {
        let group = scenes[scene].pager();
        self.groups[group].set_pager(pager, scenes, scene, rendering)
    }

    /// Removes every page that a scene's pager merged into it.
    pub(in crate::viewer) fn clear_pages(&mut self, scenes: &mut SceneList, scene: SceneId, rendering: &mut Rendering) {
        let group = scenes[scene].pager();
        self.groups[group].clear_pages(scenes, scene, rendering);
    }

    /// Replaces the overlays of a scene.
    pub(in crate::viewer) fn set_overlays(
        &mut self,
        scenes: &mut SceneList,
        scene: SceneId,
        overlays: Option<Arc<OverlaySet>>,
        rendering: &mut Rendering,
    ) {
        let group = scenes[scene].pager();
        self.groups[group].set_overlays(scenes, scene, overlays, rendering);
    }

    /// Removes a scene with everything that it has on devices, and its pager when no other scene uses it.
    pub(in crate::viewer) fn remove_scene(
        &mut self,
        scenes: &mut SceneList,
        scene: SceneId,
        rendering: &mut Rendering,
    ) {
        let group = scenes[scene].pager();
        let is_used = self.groups[group].remove_scene(scenes, scene, rendering);
        // Uploads in flight would arrive when their owner number belongs to another scene. A pager that stays takes its own.
        rendering.finish_compiles();
        if let Some(scene) = scenes.remove(scene) {
            scene.close(rendering);
        }
        if !is_used && let Some(group) = self.groups.remove(group) {
            rendering.release_compiled(UploadOwner::Pager(group.owner()));
        }
    }

    /// Pins the threads of all pagers to a core.
    pub(in crate::viewer) fn set_processor_affinity(&mut self, scenes: &mut SceneList, core: usize) {
        for pager in self.iter_mut().filter_map(PagerGroup::pager_mut) {
            pager.set_processor_affinity(core);
        }
        for pager in scenes.values_mut().filter_map(PagedScene::image_pager_mut) {
            pager.set_processor_affinity(core);
        }
    }

    /// Uploads everything to a device that was opened after others.
    pub(in crate::viewer) fn device_opened(
        &mut self,
        scenes: &mut SceneList,
        device: u32,
        rendering: &mut Rendering,
    ) -> Result<(), ViewerError> {
        for scene in scenes.values_mut() {
            scene.device_opened(rendering, device)?;
        }
        for group in self.iter_mut() {
            group.page_anew(scenes, rendering);
        }
        Ok(())
    }

    /// Forgets what a device had that is gone.
    pub(in crate::viewer) fn device_closed(&mut self, scenes: &mut SceneList, device: u32, rendering: &mut Rendering) {
        for group in self.iter_mut() {
            group.device_closed(rendering, device);
        }
        for scene in scenes.values_mut() {
            scene.device_closed(device);
        }
    }
}
