//! Accepts requests of culls and of scenes, and lets failures be requested again. Update thread.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use super::DatabasePager;
use crate::cull::PageRequest;
use crate::pager::loading::waiting_jobs::Urgency;
use crate::pager::requests::table::{Changes, RequestTable};
use crate::pager::residency::Unused;
use crate::pager::scenes::scene_set::SceneSet;
use crate::scene::{SlotInfo, SlotState};

/// The number of new requests that an update accepts, more than threads can begin in a frame. Culls list the others again in
/// the next frame.
const MAX_NEW: usize = 1024;
/// An update looks up the slots of this many new requests for each that it accepts: the options of a slot change the priority that
/// its cull gave it.
const CANDIDATES_PER_NEW: usize = 2;

/// A slot that a cull met within this many frames is seen.
const MET_FRAMES: u32 = 2;

/// Returns the `max` most urgent of new requests, given with their indices; of each scene its share.
fn most_urgent<S: Copy + Ord>(
    new: Vec<(Urgency, usize)>,
    max: usize,
    scene_of: impl Fn(usize) -> S,
) -> Vec<(Urgency, usize)> {
    if new.len() <= max {
        return new;
    }
    let mut by_scene: BTreeMap<S, Vec<(Urgency, usize)>> = BTreeMap::new();
    for request in new {
        by_scene.entry(scene_of(request.1)).or_default().push(request);
    }
    let share = max.div_ceil(by_scene.len().max(1));
    for of_scene in by_scene.values_mut().filter(|of_scene| of_scene.len() > share) {
        of_scene.select_nth_unstable_by_key(share, |(urgency, index)| (Reverse(*urgency), *index));
        of_scene.truncate(share);
    }
    let mut all: Vec<_> = by_scene.into_values().flatten().collect();
    // Tickets are numbered as cameras have listed the requests.
    all.sort_unstable_by_key(|(_, index)| *index);
    all
}

impl DatabasePager {
    /// Renews the requests that are known, and accepts the most urgent new ones: [`MAX_NEW`] at most, an equal share of each
    /// scene. Returns true if there is something new to load, or a prefetch is wanted now.
    pub(super) fn accept(&mut self, scenes: &dyn SceneSet, requests: &[PageRequest]) -> bool {
        self.accept_some(scenes, requests, if self.config.blocking { usize::MAX } else { MAX_NEW })
    }

    /// Does the same with another number of new requests.
    fn accept_some(&mut self, scenes: &dyn SceneSet, requests: &[PageRequest], max_new: usize) -> bool {
        if let Some(scene) = self.scenes.claimant(scenes) {
            self.claim(scene);
        }
        let frame = self.control.times.frame();
        let mut changes = Changes::default();
        // The indices of new requests.
        let mut new: Vec<(Urgency, usize)> = Vec::new();
        for (index, request) in requests.iter().enumerate() {
            if !self.table.renew(request, frame, &mut changes) && self.control.takes_requests {
                new.push((Urgency::new(request.priority, request.ahead_frames > 0), index));
            }
        }
        let scene_of = |index: usize| requests[index].slot.page.scene;
        let mut new = most_urgent(new, max_new.saturating_mul(CANDIDATES_PER_NEW), scene_of);
        new.retain_mut(|(urgency, index)| {
            let Some(slot) = scenes.slot(requests[*index].slot).filter(|slot| self.is_open(slot)) else { return false };
            *urgency = RequestTable::urgency(&requests[*index], &slot);
            true
        });
        for request in most_urgent(new, max_new, scene_of).into_iter().map(|(_, index)| &requests[index]) {
            // Another camera may have requested it too.
            if self.table.renew(request, frame, &mut changes) {
                continue;
            }
            let Some(slot) = scenes.slot(request.slot) else { continue };
            let Some((ancestors, scope)) = self.scenes.origin(&slot) else { continue };
            let tile = self.scenes.tile_volume(scenes, request.slot, &scope).filter(|_| !slot.is_proxy);
            self.table.add(request, &slot, ancestors, scope, tile, frame);
            changes.requested += 1;
        }
        self.stats.requested += changes.requested;
        self.stats.retried += changes.retried;
        changes.rearranged.iter().for_each(|(slot, urgency)| self.arrivals.set_urgency(*slot, *urgency));
        changes.has_new()
    }

    /// Returns true if a content may be requested for a slot.
    fn is_open(&self, slot: &SlotInfo<'_>) -> bool {
        match slot.state {
            SlotState::Empty => true,
            SlotState::Resident(page) => self.outdated.contains_key(&page),
            SlotState::Failed => false,
        }
    }

    /// Accepts and renews requests for slots that are filled whatever cameras see.
    pub(super) fn accept_forced(&mut self, scenes: &mut dyn SceneSet) {
        self.forced.forget_settled(scenes, &self.table);
        for slot in self.forced.take_new(scenes) {
            self.table.retry_now(scenes, slot);
        }
        let requests = self.forced.requests();
        if !requests.is_empty() {
            // Without a limit: the pager is not idle before all are loaded.
            self.accept_some(scenes, &requests, usize::MAX);
        }
    }

    /// Lets failures be requested again whose back-off is over.
    pub(super) fn retry_failures(&mut self, scenes: &mut dyn SceneSet) {
        let unused = Unused::new(self.config.expiry_frames.max(MET_FRAMES), self.config.expiry_time);
        self.table.retry_due(scenes, |frame| unused.allows(frame, &self.control.times));
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::time::{Duration, Instant};

    use glam::{DAffine3, DVec3};

    use super::*;
    use crate::fetch::Limits;
    use crate::formats::ReadOptions;
    use crate::math::{BoundingSphere, BoundingVolume};
    use crate::pager::PagerConfig;
    use crate::pager::loading::page_job::PageJob;
    use crate::pager::requests::entry::Progress;
    use crate::scene::{Node, NodeId, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine, Scene};

    const TILES: usize = 5_000;
    /// The number of the most urgent jobs that are in order after each update.
    const IN_ORDER: usize = 1_024;

    /// A scene that counts how often it is looked at.
    struct Counted<'a> {
        scene: &'a mut Scene,
        looked_at: Cell<usize>,
    }

    impl SceneSet for Counted<'_> {
        fn at(&self, index: usize) -> Option<&Scene> {
            self.looked_at.set(self.looked_at.get() + 1);
            self.scene.at(index)
        }

        fn at_mut(&mut self, index: usize) -> Option<&mut Scene> {
            self.scene.at_mut(index)
        }
    }

    /// A pager that loads nothing, and what its cameras want.
    struct Run {
        pager: DatabasePager,
        scene: Scene,
        slots: Vec<NodeId>,
        frame: u32,
    }

    impl Run {
        fn new(blocking: bool) -> Self {
            let options = ReadOptions::for_root("/set/tileset.json", Limits::default());
            let config = PagerConfig { blocking, ..PagerConfig::default() };
            let mut pager = DatabasePager::new(config, options).unwrap();
            pager.set_paused(true);
            let tile = |number: usize| {
                let center = DVec3::X * number as f64;
                Node::new(NodeKind::PagedLod(Box::new(PagedLod {
                    bounds: BoundingVolume::Sphere(BoundingSphere { center, radius_m: 1.0 }),
                    range_mode: RangeMode::Distance { center, range_m: 0.0 },
                    refine: Refine::Replace,
                    content: Some("/set/a.glb".into()),
                    content_transform: DAffine3::IDENTITY,
                    reader_data: None,
                    request_volume: None,
                    paging: PagingOptions::default(),
                })))
            };
            let mut scene = Scene::new();
            let root = scene.add_root(Page::from_node(Node::group((0..TILES).map(tile).collect())).unwrap());
            let slots = scene.slots_of_page(root).collect();
            Self { pager, scene, slots, frame: 0 }
        }

        /// Runs an update of a frame that wants these tiles with these priorities.
        fn update(&mut self, wanted: impl Iterator<Item = (usize, f32)>) {
            self.frame += 1;
            let request = |(tile, priority)| PageRequest {
                slot: self.slots[tile],
                priority,
                error_px: priority,
                ahead_frames: 0,
            };
            let requests: Vec<PageRequest> = wanted.map(request).collect();
            let time_s = f64::from(self.frame) / 60.0;
            self.pager.update_scene_graph(&mut self.scene, self.frame, time_s, &requests, &mut []);
        }

        /// Runs an update of a frame that wants all tiles, those with numbers near `center` most.
        fn look_at(&mut self, center: usize) {
            self.update((0..TILES).map(|tile| (tile, priority(tile, center))));
        }

        /// Repeats [`Self::look_at`] until the list has all requests.
        fn fill(&mut self, center: usize) {
            while self.pager.stats.waiting < TILES as u64 {
                self.look_at(center);
                assert!(self.frame < 100, "{:?}", self.pager.stats);
            }
        }

        /// Returns the tiles that threads would take next, in their order.
        fn next(&self, count: usize) -> Vec<usize> {
            let state = self.pager.threads.list().lock();
            state.most_urgent(count).map(|job| self.slots.binary_search(&job.slot).unwrap()).collect()
        }

        /// Returns the urgencies that the list has, by tile.
        fn listed(&self) -> Vec<Option<Urgency>> {
            self.slots.iter().map(|slot| self.pager.table.get(*slot).and_then(|entry| entry.listed)).collect()
        }
    }

    fn priority(tile: usize, place: usize) -> f32 {
        1e6 / (1 + 2 * tile.abs_diff(place) + usize::from(tile > place)) as f32
    }

    /// Returns the tiles in the order of their priorities.
    fn by_priority(place: usize, count: usize) -> Vec<usize> {
        let mut tiles: Vec<usize> = (0..TILES).collect();
        tiles.sort_by(|a, b| priority(*b, place).total_cmp(&priority(*a, place)));
        tiles.truncate(count);
        tiles
    }

    /// Regression: an update accepted all new requests, however many a cull listed.
    #[test]
    fn new_requests_are_accepted_in_parts_the_most_urgent_first() {
        let mut run = Run::new(false);
        for update in 1..=TILES.div_ceil(MAX_NEW) {
            run.look_at(4_000);
            assert_eq!(run.pager.stats.requested as usize, (update * MAX_NEW).min(TILES));
            assert_eq!(run.next(IN_ORDER), by_priority(4_000, IN_ORDER), "after {update} updates");
        }
        let is_listed = |urgency: &Option<Urgency>| urgency.is_some();
        assert!(run.listed().iter().all(is_listed), "all in the end");
    }

    /// A scene whose camera moves may have more new requests than fit in each frame.
    #[test]
    fn each_scene_has_its_share_of_new_requests() {
        let urgency = |index: usize| Urgency::new(1e6 - index as f32, false);
        let new: Vec<_> = (0..TILES + 10).map(|index| (urgency(index), index)).collect();
        let accepted = most_urgent(new, MAX_NEW, |index| usize::from(index >= TILES));
        let indices: Vec<usize> = accepted.into_iter().map(|(_, index)| index).collect();
        assert!(indices.iter().copied().eq((0..MAX_NEW / 2).chain(TILES..TILES + 10)), "{indices:?}");
    }

    #[test]
    fn blocking_update_accepts_all_requests() {
        let mut run = Run::new(true);
        run.look_at(0);
        assert_eq!(run.pager.stats.requested as usize, TILES);
        // And all that changes.
        run.look_at(TILES - 1);
        assert_eq!(run.next(TILES), by_priority(TILES - 1, TILES));
    }

    /// Regression: while the camera moved, each update changed the urgencies of all requests and filled the list again.
    #[test]
    fn moving_camera_changes_a_part_of_the_list_and_its_front_is_in_order() {
        let mut runs = [Run::new(false), Run::new(false)];
        let mut lists: [Vec<Vec<usize>>; 2] = Default::default();
        for (run, lists) in runs.iter_mut().zip(&mut lists) {
            run.fill(0);
            // It flies slowly, then jumps twice.
            for place in [1, 2, 3, 50, 51, 4_900, 4_901, 4_902, 2_000] {
                let before = run.listed();
                run.look_at(place);
                let changed = run.listed().iter().zip(&before).filter(|(now, before)| now != before).count();
                assert!((1..=2 * IN_ORDER).contains(&changed), "{changed} of {TILES} at {place}");
                assert_eq!(run.next(IN_ORDER), by_priority(place, IN_ORDER), "at {place}");
                lists.push(run.next(TILES));
            }
            // It stands: the others follow.
            for _ in 0..TILES.div_ceil(IN_ORDER) {
                run.look_at(2_000);
            }
            assert_eq!(run.next(TILES), by_priority(2_000, TILES));
        }
        assert!(lists[0] == lists[1], "the same flight gives the same lists");
    }

    /// Regression: an update dropped all requests that had become stale.
    #[test]
    fn stale_requests_are_dropped_in_parts_and_none_of_them_is_next() {
        const NEW: usize = 300;
        /// More than threads take between two updates.
        const NEXT: usize = 200;
        let mut run = Run::new(false);
        // The least urgent ones are renewed first.
        run.fill(TILES - 1);
        // The camera turns. A thousand of the requests that become stale are more urgent than the others.
        let wanted = || (0..NEW).map(|tile| (tile * 7, 500.0 - 0.01 * tile as f32));
        let (mut dropped, mut is_next) = (0, false);
        while dropped < (TILES - NEW) as u64 {
            run.update(wanted());
            let now = run.pager.stats.stale;
            assert!(now - dropped <= 2 * 2_048, "{} dropped at once", now - dropped);
            is_next |= run.pager.stats.waiting > NEW as u64 && run.next(NEXT).iter().all(|tile| tile % 7 == 0);
            dropped = now;
            assert!(run.frame < 100, "{:?}", run.pager.stats);
        }
        assert!(is_next, "stale requests are left, and threads take what is wanted");
        assert_eq!(run.next(TILES), (0..NEW).map(|tile| tile * 7).collect::<Vec<_>>());
        assert_eq!(run.pager.stats.stale as usize, TILES - NEW);
    }

    /// Regression: while stale requests were left, one in eight slots went to them, as the oldest.
    #[test]
    fn slots_for_old_requests_go_to_no_stale_ones() {
        /// The number of jobs that threads take in a frame.
        const TAKEN: usize = 16;
        let mut run = Run::new(false);
        run.fill(0);
        // All requests are old.
        run.frame += 200;
        run.look_at(0);
        // The camera turns to a few of the least urgent tiles.
        let wanted = |run: &mut Run| run.update((TILES - 300..TILES).map(|tile| (tile, 1e6)));
        let (mut stale, mut updates) = (0, 0);
        while run.pager.stats.waiting as usize > 300 {
            wanted(&mut run);
            if run.pager.stats.stale > 0 {
                updates += 1;
                let taken = run.pager.threads.list().lock().take_files_for_test(TAKEN);
                let is_stale = |job: &PageJob| run.slots.binary_search(&job.slot).unwrap() < TILES - 300;
                stale += taken.iter().filter(|job| is_stale(job)).count();
            }
            assert!(updates < 20, "{:?}", run.pager.stats);
        }
        assert!(updates > 1, "requests are stale for some updates");
        assert_eq!(stale, 0, "in {updates} updates");
    }

    /// Regression: each update looked at all remembered failures a few times.
    #[test]
    fn remembered_failures_are_apart_from_what_is_under_way() {
        let mut run = Run::new(false);
        run.fill(0);
        let later = Instant::now() + Duration::from_secs(600);
        for slot in &run.slots[..TILES / 2] {
            run.pager.table.begin(*slot, |entry| entry.progress = Progress::Failed { retry_at: Some(later) });
        }
        run.pager.table.begin(run.slots[TILES - 1], |entry| entry.progress = Progress::Loading);
        run.look_at(0);
        assert_eq!((run.pager.table.begun().count(), run.pager.stats.in_flight), (1, 1));
        assert!(!run.pager.has_due());
        // One that may be retried, and is: its request waits again.
        let failed = run.slots[7];
        run.pager.table.begin(failed, |entry| entry.progress = Progress::Failed { retry_at: Some(Instant::now()) });
        assert!(run.pager.has_due());
        run.look_at(0);
        assert!(!run.pager.has_due());
        run.look_at(0);
        assert_eq!(run.pager.table.get(failed).map(|entry| entry.progress), Some(Progress::Waiting));
        assert_eq!(run.pager.stats.retried, 1);
    }

    /// Regression: the first update looked up the slots of all new requests.
    #[test]
    fn slots_of_a_few_new_requests_are_looked_up() {
        let mut run = Run::new(false);
        let requests: Vec<PageRequest> = (0..TILES)
            .map(|tile| PageRequest {
                slot: run.slots[tile],
                priority: priority(tile, 0),
                error_px: 1.0,
                ahead_frames: 0,
            })
            .collect();
        let scenes = Counted { scene: &mut run.scene, looked_at: Cell::new(0) };
        run.pager.accept(&scenes, &requests);
        assert_eq!(run.pager.stats.requested as usize, MAX_NEW);
        let looked_up = scenes.looked_at.get();
        assert!((MAX_NEW..(CANDIDATES_PER_NEW + 1) * MAX_NEW + 16).contains(&looked_up), "{looked_up} of {TILES}");
    }
}
