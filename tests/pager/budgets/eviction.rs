//! Which pages leave memory, and when: the least recently used first, by the time of frame stamps. Real files, no GPU.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

use glam::{DAffine3, DVec3};
use kit::pager::{Run, above};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::pager::PagerConfig;
use terrane::scene::{Node, NodeId, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine, SlotState};

/// Returns a scene of tiles with these centres. All have the same small file, and no tile is above another.
fn tiles(folder: &Path, places: impl Iterator<Item = DVec3>, config: PagerConfig) -> Run {
    let file = folder.join("tile.glb");
    let positions = vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]];
    let mesh = GlbMesh { positions, indices: vec![0, 1, 2], base_color: [1.0; 4], ..GlbMesh::default() };
    std::fs::write(&file, write_glb(&mesh)).unwrap();
    let tile = |center: DVec3| {
        Node::new(NodeKind::PagedLod(Box::new(PagedLod {
            bounds: BoundingVolume::Sphere(BoundingSphere::new(center, 10.0)),
            range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
            refine: Refine::Replace,
            content: Some(file.display().to_string().into()),
            content_transform: DAffine3::from_translation(center),
            reader_data: None,
            request_volume: None,
            paging: PagingOptions::default(),
        })))
    };
    let root = Page::from_node(Node::group(places.map(tile).collect())).unwrap();
    Run::of_page(root, folder.to_str().unwrap(), config)
}

fn slots(run: &Run) -> Vec<NodeId> {
    run.scene.slots_of_page(run.scene.roots()[0]).collect()
}

/// Returns the tiles that the last cull used.
fn used(run: &Run, slots: &[NodeId]) -> Vec<usize> {
    let is_used = |tile: &usize| run.scene.slot(slots[*tile]).unwrap().last_used_frame == run.frame;
    (0..slots.len()).filter(is_used).collect()
}

fn resident(run: &Run, slots: &[NodeId]) -> BTreeSet<usize> {
    let is_resident = |tile: &usize| matches!(run.scene.slot(slots[*tile]).unwrap().state, SlotState::Resident(_));
    (0..slots.len()).filter(is_resident).collect()
}

/// A cache of tiles that replaces by a rule, with room for as many as the pager had after each frame.
#[derive(Default)]
struct Model {
    /// The frame by which each tile is ordered: the earliest leaves first.
    tiles: BTreeMap<usize, u32>,
    misses: usize,
}

impl Model {
    fn frame(&mut self, frame: u32, used: &[usize], room: usize, by_use: bool) {
        for tile in used {
            match self.tiles.get_mut(tile) {
                Some(last) if by_use => *last = frame,
                Some(_) => {}
                None => {
                    self.misses += 1;
                    self.tiles.insert(*tile, frame);
                }
            }
        }
        while self.tiles.len() > room {
            let next = self.tiles.iter().filter(|(tile, _)| !used.contains(tile)).min_by_key(|(_, frame)| **frame);
            let Some((tile, _)) = next else { break };
            self.tiles.remove(&tile.clone());
        }
    }
}

const TILES: usize = 120;
const SPACING_M: f64 = 25.0;
/// Tiles that the camera glances at again and again.
const LANDMARKS: usize = 4;

/// The camera flies along a row of tiles and back, and glances at a few landmarks every sixth frame. The budget holds a sixth
/// of the tiles. Regression: pages left in the order in which they were found unused, whatever had been used since.
#[test]
fn flight_that_turns_back_misses_as_often_as_an_exact_lru() {
    let folder = tempfile::tempdir().unwrap();
    let landmarks = DVec3::new(0.0, 1e5, 0.0);
    let row = (0..TILES).map(|tile| DVec3::X * SPACING_M * tile as f64);
    let places = row.chain((0..LANDMARKS).map(|n| landmarks + DVec3::X * 3.0 * n as f64));
    // Pages leave only for want of room.
    let config =
        PagerConfig { max_tiles: TILES / 6, blocking: true, expiry_time: Duration::MAX, ..PagerConfig::default() };
    let mut run = tiles(folder.path(), places, config);
    let slots = slots(&run);
    let steps = (TILES as f64 * SPACING_M / 10.0) as usize;
    let path = (0..steps).chain((0..steps).rev());
    let (mut lru, mut fifo) = (Model::default(), Model::default());
    let (mut misses, mut at_turn, mut most_used, mut evicted) = (0, [0; 3], 0, 0);
    let mut last_used: BTreeMap<usize, u32> = BTreeMap::new();
    for (n, step) in path.enumerate() {
        let is_glance = n % 6 == 5;
        run.cull(above(30.0) + if is_glance { landmarks } else { DVec3::X * 10.0 * step as f64 });
        let used = used(&run, &slots);
        let before = resident(&run, &slots);
        most_used = most_used.max(used.len());
        misses += used.iter().filter(|tile| !before.contains(tile)).count();
        last_used.extend(used.iter().map(|tile| (*tile, run.frame)));
        let mut rounds = 0;
        let after = loop {
            // The blocking mode culls and updates until nothing is missing.
            run.update_with(&[]);
            let now = resident(&run, &slots);
            if used.iter().all(|tile| now.contains(tile)) {
                break now;
            }
            rounds += 1;
            assert!(rounds < 100, "step {n}: {:?}", run.pager.stats());
        };
        // No page left that was used after one that stays.
        let left = before.difference(&after).map(|tile| last_used[tile]).max();
        let stays = after.iter().map(|tile| last_used[tile]).min();
        evicted += before.difference(&after).count();
        assert!(left <= stays || left.is_none(), "step {n}: {left:?} left and {stays:?} stays");
        lru.frame(run.frame, &used, after.len(), true);
        fifo.frame(run.frame, &used, after.len(), false);
        if n + 1 == steps {
            at_turn = [misses, lru.misses, fifo.misses];
        }
    }
    let [pager, lru, fifo] = [misses - at_turn[0], lru.misses - at_turn[1], fifo.misses - at_turn[2]];
    assert!(evicted > TILES && pager > TILES / 2, "{evicted} evicted, {pager} misses");
    assert!(pager.abs_diff(lru) <= most_used, "{pager} misses, {lru} of an exact LRU");
    assert!(fifo > lru + 2 * most_used, "the flight tells the orders apart: {fifo} misses of a FIFO, {lru} of an LRU");
}

/// Regression: all was counted in frames, so that quick frames expired what slow ones kept.
#[test]
fn expiry_follows_the_time_of_frame_stamps() {
    for (frame_s, frames) in [(0.1, 20), (0.01, 200), (5.0, 3)] {
        let folder = tempfile::tempdir().unwrap();
        let config = PagerConfig { max_tiles: 10, expiry_time: Duration::from_secs(2), ..PagerConfig::default() };
        let mut run = tiles(folder.path(), (0..10).map(|n| DVec3::X * f64::from(n)), config);
        run.frame_s = frame_s;
        run.settle(above(60.0));
        assert_eq!(run.pager.stats().resident, 10);
        let (last_seen, mut left_in) = (run.frame, None);
        for _ in 0..2 * frames + 10 {
            run.frame(above(60.0) + DVec3::Y * 1e5);
            if run.pager.stats().expired > 0 && left_in.is_none() {
                left_in = Some(run.frame - last_seen);
            }
        }
        // At least two seconds, and at least the frames that may still draw it.
        let left_in = left_in.expect("a tenth of the budget becomes free");
        assert!((frames..=frames + 2).contains(&left_in), "{left_in} frames of {frame_s} s");
    }
}
