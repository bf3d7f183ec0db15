//! The time that an update takes is bounded, by a clock that the tests replace. Real files, no GPU.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use kit::pager::{Run, above};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::pager::{PagerConfig, RequestState};
use terrane::scene::{Node, NodeKind, Page, PagedLod, PagingOptions, RangeMode, Refine};

/// Returns a scene of `count` tiles around the origin.
fn tiles(folder: &Path, count: usize, config: PagerConfig) -> Run {
    let positions = vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]];
    let mesh = GlbMesh { positions, indices: vec![0, 1, 2], base_color: [1.0; 4], ..GlbMesh::default() };
    std::fs::write(folder.join("tile.glb"), write_glb(&mesh)).unwrap();
    let tile = |_| {
        Node::new(NodeKind::PagedLod(Box::new(PagedLod {
            bounds: BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 10.0)),
            range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
            refine: Refine::Replace,
            content: Some(folder.join("tile.glb").display().to_string().into()),
            content_transform: DAffine3::IDENTITY,
            reader_data: None,
            request_volume: None,
            paging: PagingOptions::default(),
        })))
    };
    let root = Page::from_node(Node::group((0..count).map(tile).collect())).unwrap();
    Run::of_page(root, folder.to_str().unwrap(), config)
}

/// Lets the clock run by a millisecond each time that it is read: the budget of a millisecond is over after one step.
fn slow_clock(run: &mut Run) {
    let time_ms = Arc::new(AtomicU64::new(0));
    run.pager.set_work_clock(move || Duration::from_millis(time_ms.fetch_add(1, Ordering::Relaxed)));
}

/// Lets the clock run by a tenth of a millisecond each time that it is read.
fn ticking_clock(run: &mut Run) {
    let ticks = Arc::new(AtomicU64::new(0));
    run.pager.set_work_clock(move || Duration::from_micros(100 * ticks.fetch_add(1, Ordering::Relaxed)));
}

/// Waits until this many contents are read.
fn wait_until_read(run: &Run, count: usize) {
    let end = Instant::now() + kit::MAX_WAIT;
    let read = || run.pager.request_states().filter(|(_, state)| *state == RequestState::Decoding).count();
    while read() < count {
        assert!(Instant::now() < end, "not all were read: {:?}", run.pager.stats());
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Regression: each step had the whole time for itself, so that an update took several times as long; and where all share it,
/// the first step must not take it from the others.
#[test]
fn steps_of_an_update_share_its_time() {
    const TILES: usize = 40;
    let folder = tempfile::tempdir().unwrap();
    let update_time = Duration::from_millis(1);
    let config = PagerConfig { decode_threads: 4, update_time, merge_time: update_time, ..PagerConfig::default() };
    let mut run = tiles(folder.path(), TILES, config);
    ticking_clock(&mut run);
    run.frame(above(30.0));
    wait_until_read(&run, TILES);
    let (mut before, mut both) = (run.pager.stats().to_owned(), 0);
    let end = Instant::now() + kit::MAX_WAIT;
    while before.merged < TILES as u64 {
        assert!(Instant::now() < end, "not all were merged: {before:?}");
        run.frame(above(30.0));
        let now = run.pager.stats().to_owned();
        let [loaded, merged] = [now.loaded - before.loaded, now.merged - before.merged];
        // The clock is read after each step's item, ten times in an update; each step may do one item more.
        assert!(loaded + merged <= 12, "{loaded} were accepted and {merged} merged in an update");
        both += usize::from(loaded > 0 && merged > 0);
        before = now;
    }
    // How many depends on how fast the threads decode the last of them.
    assert!(both > 1, "updates accept and merge: {both} did both");
    assert!(run.pager.is_idle(), "{:?}", run.pager.stats());
}

/// Regression: each update took all answers, however many had arrived.
#[test]
fn answers_beyond_the_time_of_an_update_wait_for_the_next() {
    const TILES: usize = 16;
    let folder = tempfile::tempdir().unwrap();
    let config = PagerConfig { decode_threads: 1, ..PagerConfig::default() };
    let mut run = tiles(folder.path(), TILES, config);
    slow_clock(&mut run);
    run.frame(above(30.0));
    let end = Instant::now() + kit::MAX_WAIT;
    wait_until_read(&run, TILES);
    // Without the budget the next update would take what is decoded by now; with it this changes nothing.
    std::thread::sleep(Duration::from_millis(100));
    let mut loaded = 0;
    while loaded < TILES as u64 {
        assert!(Instant::now() < end, "not all were taken: {:?}", run.pager.stats());
        run.frame(above(30.0));
        let now = run.pager.stats().loaded;
        assert!(now - loaded <= 1, "{loaded} were loaded before the frame, {now} after it");
        loaded = now;
    }
    run.settle(above(30.0));
    assert_eq!(run.pager.stats().merged, TILES as u64);
}

/// The time between frames takes what the update has left.
#[test]
fn answers_that_an_update_left_are_taken_before_the_next_frame() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = tiles(folder.path(), 16, PagerConfig::default());
    slow_clock(&mut run);
    run.frame(above(30.0));
    run.work_until_idle();
    assert_eq!((run.pager.stats().merged, run.pager.is_idle()), (16, true), "{:?}", run.pager.stats());
}

/// Regression: up to 256 pages expired in one update.
#[test]
fn expiry_beyond_the_time_of_an_update_waits_for_the_next() {
    const TILES: usize = 60;
    let folder = tempfile::tempdir().unwrap();
    let config = PagerConfig { max_tiles: TILES, expiry_time: Duration::ZERO, ..PagerConfig::default() };
    let mut run = tiles(folder.path(), TILES, config);
    run.settle(above(30.0));
    assert_eq!(run.pager.stats().resident, TILES as u64);
    slow_clock(&mut run);
    let aside = above(30.0) + DVec3::Y * 1e5;
    let mut expired = 0;
    for _ in 0..60 {
        run.frame(aside);
        let now = run.pager.stats().expired;
        assert!(now - expired <= 1, "{expired} had left before the frame, {now} after it");
        expired = now;
    }
    assert_eq!(expired, TILES as u64 / 10, "a tenth of the budget is free");
}
