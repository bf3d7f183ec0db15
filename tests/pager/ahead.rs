//! Prefetch: tiles that will be wanted later are loaded into free room. Real files; no GPU.

use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use kit::pager::Run;
use kit::tile_sets::{WORLD_M, write_quadtree};
use terrane::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use terrane::gpu::AdapterChoice;
use terrane::pager::{EyeMotion, MotionLooks, PagerConfig, PathLooks, frames_until};
use terrane::scene::{Node, NodeId, Page, Scene};
use terrane::viewer::{AnimationPath, ControlPoint, Viewer, ViewerConfig};

const HERE: DVec3 = DVec3::new(0.2 * WORLD_M, 0.2 * WORLD_M, 150.0);
const THERE: DVec3 = DVec3::new(0.8 * WORLD_M, 0.8 * WORLD_M, 150.0);
const ASIDE: DVec3 = DVec3::new(0.2 * WORLD_M, 0.8 * WORLD_M, 150.0);
/// A screen-space error that gives many tiles in an image.
const FINE_PX: f64 = 4.0;

/// Returns the tiles that an eye will miss in a number of frames.
fn missing_ahead(run: &Run, eye: DVec3, frames: u32) -> Vec<PageRequest> {
    let eye_from_world = DAffine3::from_translation(-eye);
    let mut camera = CullCamera { eye_from_world, frame: run.frame, ahead_frames: frames, ..CullCamera::default() };
    camera.settings.max_sse_px = run.max_sse_px;
    let mut stage = RenderStage::new();
    CullVisitor::new().cull(&run.scene, &camera, &mut stage);
    stage.requests
}

/// Returns the same tiles as prefetch requests.
fn ahead(run: &Run, eye: DVec3, frames: u32) -> Vec<PageRequest> {
    missing_ahead(run, eye, frames).iter().map(|request| request.ahead(frames)).collect()
}

/// Runs a frame at one position that prefetches for another.
fn frame(run: &mut Run) {
    let requests = ahead(run, THERE, 10);
    run.frame_with(HERE, &requests);
}

#[test]
fn prefetch_requests_follow_current_ones_in_the_same_order() {
    let page = Scene::new().add_root(Page::from_node(Node::group(Vec::new())).unwrap());
    let slot = NodeId { page, index: 0 };
    let request = |priority| PageRequest { slot, priority, error_px: 0.0, ahead_frames: 0 }.ahead(1).priority;
    let ahead: Vec<f32> = [0.0, 1.0, 16.0, 1e6, f32::MAX, f32::INFINITY].map(request).to_vec();
    assert!(ahead.iter().all(|p| *p < 0.0) && ahead.is_sorted(), "{ahead:?}");
    assert!(request(f32::NAN) < 0.0);
}

#[test]
fn no_tile_is_missing_along_an_announced_path() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let mut run = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    run.settle(HERE);
    let (before, drawn) = (*run.pager.stats(), run.stage.counters.tiles_drawn);
    assert!(!ahead(&run, THERE, 10).is_empty());
    let end = Instant::now() + kit::MAX_WAIT;
    while !ahead(&run, THERE, 10).is_empty() || run.pager.stats().in_flight > 0 {
        assert!(Instant::now() < end, "{:?}", run.pager.stats());
        frame(&mut run);
        assert!(run.pager.is_idle(), "no image lacks a tile");
        assert_eq!((run.stage.counters.wanted_missing, run.stage.counters.tiles_drawn), (0, drawn));
        std::thread::sleep(Duration::from_micros(200));
    }
    let after = *run.pager.stats();
    assert!(after.merged_ahead > 0 && after.merged - before.merged == after.merged_ahead, "{after:?}");
    run.frame(THERE);
    assert_eq!(run.stage.counters.wanted_missing, 0);
    run.frame(THERE);
    assert_eq!(run.pager.stats().loaded, after.loaded, "nothing is loaded twice");
}

#[test]
fn current_requests_precede_prefetch_which_evicts_no_visible_page() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    // The budget has room for this position and little more.
    let mut free = Run::new(folder.path().to_str().unwrap(), PagerConfig::default());
    free.settle(HERE);
    let needed = free.pager.stats().resident as usize;
    let config = PagerConfig { max_tiles: needed + needed / 2, ..PagerConfig::default() };
    let max_tiles = config.max_tiles as u64;
    let mut run = Run::new(folder.path().to_str().unwrap(), config);
    run.settle(HERE);
    for _ in 0..300 {
        frame(&mut run);
        assert_eq!(run.stage.counters.wanted_missing, 0, "visible pages stay");
        assert!(run.pager.stats().resident <= max_tiles);
        // However slow the threads are.
        run.work_until_idle();
    }
    let stats = *run.pager.stats();
    assert!(stats.loaded < 3 * max_tiles, "pages are loaded and evicted in turns: {stats:?}");
    for _ in 0..100 {
        frame(&mut run);
        run.work_until_idle();
    }
    assert_eq!(run.pager.stats().loaded, stats.loaded, "the pager settles");
    // Wanted now, the same position gets room at once.
    run.settle(THERE);
    assert_eq!(run.stage.counters.wanted_missing, 0);
}

/// Regression: prefetch waited until the frame that needed the page, which then got room at once.
#[test]
fn prefetch_for_the_next_frames_may_use_the_last_tenth() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let set = folder.path().to_str().unwrap();
    // The eye is high enough for many tiles in an image.
    let [here, there] = [HERE, THERE].map(|eye| eye + 500.0 * DVec3::Z);
    let mut free = Run::new(set, PagerConfig::default());
    free.max_sse_px = 0.25 * FINE_PX;
    free.settle(here);
    let needed = free.pager.stats().resident as usize;
    let max_tiles = needed + needed / 12;
    assert!(max_tiles > needed + 1, "{needed}");
    for (frames, comes) in [(20, false), (4, false), (3, true), (1, true)] {
        let mut run = Run::new(set, PagerConfig { max_tiles, ..PagerConfig::default() });
        run.max_sse_px = 0.25 * FINE_PX;
        run.settle(here);
        for _ in 0..30 {
            let requests = ahead(&run, there, frames);
            run.frame_with(here, &requests);
            run.work_until_idle();
            assert_eq!(run.stage.counters.wanted_missing, 0, "visible pages stay");
            assert!(run.pager.stats().resident <= max_tiles as u64);
        }
        let stats = *run.pager.stats();
        assert_eq!(stats.merged_ahead > 0, comes, "{frames}: {stats:?}");
        assert!(stats.loaded < 2 * max_tiles as u64, "{frames}: {stats:?}");
    }
}

/// A budget of so few tiles that pages are evicted all the time during a flight.
fn little_room(set: &str) -> usize {
    let mut here = Run::new(set, PagerConfig::default());
    here.max_sse_px = FINE_PX;
    here.settle(HERE);
    4 * here.pager.stats().resident as usize
}

/// Flies with a fast disk and given prefetch requests in each frame. Returns the number of tiles missing in its frames
/// and that of loaded tiles.
fn flown(
    set: &str,
    max_tiles: usize,
    frames: u32,
    eye: impl Fn(u32) -> DVec3,
    mut ahead: impl FnMut(&Run, u32) -> Vec<PageRequest>,
) -> (u32, u64) {
    // An update does all that it can, however slow the machine is.
    let (update_time, merge_time) = (Duration::from_secs(60), Duration::from_secs(60));
    // With one thread of each kind pages arrive in the order of their priorities.
    let (file_threads, decode_threads) = (1, 1);
    let config =
        PagerConfig { max_tiles, update_time, merge_time, file_threads, decode_threads, ..PagerConfig::default() };
    let mut run = Run::new(set, config);
    run.max_sse_px = FINE_PX;
    run.settle(eye(0));
    let (mut missing, loaded) = (0, run.pager.stats().loaded);
    for frame in 0..frames {
        let requests = ahead(&run, frame);
        run.frame_with(eye(frame), &requests);
        missing += run.stage.counters.wanted_missing;
        run.work_until_idle();
        assert!(run.pager.stats().resident <= max_tiles as u64);
    }
    (missing, run.pager.stats().loaded - loaded)
}

/// Prefetches along a known path.
fn flight(set: &str, max_tiles: usize, frames: u32, ahead_frames: f64) -> (u32, u64) {
    let eye = |at: f64| HERE.lerp(THERE, (at / f64::from(frames)).min(1.0));
    let mut looks = PathLooks::default();
    let ahead = |run: &Run, frame: u32| {
        let now = f64::from(frame);
        looks.start_frame(now);
        while let Some(at) = looks.next(ahead_frames, 1.0) {
            let found = missing_ahead(run, eye(at), frames_until(at - now, 1.0));
            looks.found(&found);
        }
        looks.requests(1.0).collect()
    };
    flown(set, max_tiles, frames, |frame| eye(f64::from(frame)), ahead)
}

#[test]
fn on_a_known_path_the_page_needed_last_is_evicted() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let set = folder.path().to_str().unwrap();
    let max_tiles = little_room(set);
    let (missing, loaded) = flight(set, max_tiles, 40, 0.0);
    assert!(missing > 40, "the flight is too slow: {missing}");
    for ahead_frames in [4.0, 10.0, 30.0] {
        let (missing_ahead, loaded_ahead) = flight(set, max_tiles, 40, ahead_frames);
        assert!(3 * missing_ahead < missing, "{ahead_frames} frames ahead: {missing_ahead} missing, else {missing}");
        assert!(10 * loaded_ahead < 14 * loaded, "{ahead_frames} frames ahead: {loaded_ahead} loaded, {loaded} needed");
    }
}

/// Prefetches along a path that is not announced.
fn unannounced_flight(
    set: &str,
    max_tiles: usize,
    frames: u32,
    looks: bool,
    path: &dyn Fn(f64) -> DVec3,
) -> (u32, u64) {
    let eye = |frame: u32| path(f64::from(frame) / f64::from(frames));
    let (mut motion, mut guesses) = (EyeMotion::default(), MotionLooks::default());
    let ahead = |run: &Run, frame: u32| {
        let (now_s, here) = (f64::from(frame) / 60.0, DAffine3::from_translation(eye(frame)));
        motion.observe(now_s, &here);
        guesses.start_frame(now_s, &here, &motion);
        while looks && let Some((then, frames)) = guesses.next(1.0, &motion) {
            guesses.found(&missing_ahead(run, then.translation, frames), &motion);
        }
        guesses.requests(&motion).collect()
    };
    flown(set, max_tiles, frames, eye, ahead)
}

#[test]
fn tiles_ahead_of_a_motion_are_loaded_before_they_are_visible() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let set = folder.path().to_str().unwrap();
    let max_tiles = little_room(set);
    let middle = 0.5 * (HERE + THERE);
    let straight = |at: f64| HERE.lerp(THERE, at);
    let round = |at: f64| {
        let (sin, cos) = (std::f64::consts::TAU * at).sin_cos();
        middle + 0.3 * WORLD_M * DVec3::new(-cos, sin, 0.0)
    };
    let bounding = |at: f64| HERE.lerp(THERE, at) + DVec3::Z * 40.0 * (40.0 * at).sin();
    let paths: [(&str, &dyn Fn(f64) -> DVec3); 3] =
        [("straight", &straight), ("round", &round), ("up and down", &bounding)];
    for (name, eye) in paths {
        let (missing, loaded) = unannounced_flight(set, max_tiles, 60, false, eye);
        let (missing_ahead, loaded_ahead) = unannounced_flight(set, max_tiles, 60, true, eye);
        assert!(missing > 40, "{name}: the flight is too slow: {missing}");
        assert!(3 * missing_ahead < missing, "{name}: {missing_ahead} missing, else {missing}");
        assert!(10 * loaded_ahead < 13 * loaded, "{name}: {loaded_ahead} loaded, {loaded} needed");
    }
}

#[test]
fn room_for_a_prefetch_is_made_in_the_frame_that_requests_it() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let set = folder.path().to_str().unwrap();
    // The budget is full of pages that were visible before; they are evicted only for lack of room.
    let seen = |config| {
        let mut run = Run::new(set, PagerConfig { expiry_time: Duration::MAX, ..config });
        for eye in [ASIDE, 0.5 * (ASIDE + THERE), 0.5 * (HERE + ASIDE), HERE] {
            run.settle(eye);
        }
        run
    };
    let max_tiles = seen(PagerConfig::default()).pager.stats().resident as usize;
    let mut run = seen(PagerConfig { max_tiles, ..PagerConfig::default() });
    for _ in 0..10 {
        run.frame(HERE);
    }
    let before = *run.pager.stats();
    assert_eq!(before.resident, max_tiles as u64);
    let requests = ahead(&run, THERE, 1);
    run.frame_with(HERE, &requests);
    run.work_until_idle();
    let after = *run.pager.stats();
    assert!(after.merged_ahead > before.merged_ahead && after.expired > before.expired, "{after:?}");
}

#[test]
fn prefetch_keeps_the_limit_of_requests_in_flight() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let mut run =
        Run::new(folder.path().to_str().unwrap(), PagerConfig { ahead_in_flight: 2, ..PagerConfig::default() });
    run.settle(HERE);
    for _ in 0..50 {
        frame(&mut run);
        assert!(run.pager.stats().in_flight <= 2, "{:?}", run.pager.stats());
    }
    // With a limit of 0 nothing is prefetched, and nothing is evicted for it, with any free room.
    run.settle(THERE);
    let max_tiles = run.pager.stats().resident as usize;
    // No page expires by its age.
    let off = PagerConfig { ahead_in_flight: 0, max_tiles, expiry_time: Duration::MAX, ..PagerConfig::default() };
    let mut run = Run::new(folder.path().to_str().unwrap(), off);
    run.settle(HERE);
    for _ in 0..20 {
        run.frame(ASIDE);
    }
    run.settle(HERE);
    let before = *run.pager.stats();
    assert!(before.resident > 1);
    for _ in 0..25 {
        frame(&mut run);
    }
    let after = *run.pager.stats();
    assert_eq!((after.loaded, after.expired), (before.loaded, before.expired));
}

#[test]
fn viewer_prefetches_on_an_announced_path_and_by_the_eyes_motion() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let pose = DAffine3::from_translation;
    for announced in [true, false] {
        let config = ViewerConfig {
            size_px: [64, 64],
            adapter: AdapterChoice::Noop,
            validation: false,
            // The set is large enough for the motion below.
            look_ahead_s: if announced { 1e3 } else { 1e6 },
            ..ViewerConfig::default()
        };
        let mut viewer = Viewer::new_offscreen(&config).unwrap();
        viewer.load(folder.path().to_str().unwrap()).unwrap();
        viewer.view_mut().camera.world_from_eye = pose(HERE);
        if announced {
            let points =
                [HERE, THERE].map(|eye| ControlPoint::from_pose(if eye == HERE { 0.0 } else { 0.5 }, &pose(eye)));
            viewer.view_mut().announced = Some(AnimationPath::new(points.to_vec()).unwrap());
        }
        let end = Instant::now() + kit::MAX_WAIT;
        let ahead = |viewer: &Viewer| viewer.pager().unwrap().stats().merged_ahead;
        while ahead(&viewer) == 0 {
            assert!(Instant::now() < end, "nothing was prefetched: {:?}", viewer.pager().unwrap().stats());
            if !announced {
                // The motion is slow, and long enough for a great distance.
                let crawled_m = 1.5e-3 * viewer.frame_stamp().reference_time_s;
                viewer.view_mut().camera.world_from_eye = pose(HERE + DVec3::X * crawled_m);
            }
            // Time on the path is the wall clock's, and its start is as good as any.
            let time_s = 1e-3 * viewer.frame_stamp().reference_time_s;
            viewer.frame_at(time_s).unwrap();
        }
        // A resting camera requests nothing more, and the pager settles.
        viewer.view_mut().announced = None;
        while !viewer.is_settled() {
            assert!(Instant::now() < end);
            viewer.frame_at(0.0).unwrap();
        }
    }
    let still =
        ViewerConfig { size_px: [64, 64], adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() };
    let mut viewer = Viewer::new_offscreen(&still).unwrap();
    viewer.load(folder.path().to_str().unwrap()).unwrap();
    viewer.view_mut().camera.world_from_eye = pose(HERE);
    while !viewer.is_settled() {
        viewer.frame_at(0.0).unwrap();
    }
    for _ in 0..30 {
        viewer.frame_at(0.0).unwrap();
    }
    assert_eq!(viewer.pager().unwrap().stats().merged_ahead, 0);
}

/// Regression: a new path was used only after all moments of the old one had been looked at.
#[test]
fn new_path_is_used_at_once() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let config = ViewerConfig {
        size_px: [64, 64],
        adapter: AdapterChoice::Noop,
        validation: false,
        look_ahead_s: 1e6,
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer.load(folder.path().to_str().unwrap()).unwrap();
    viewer.view_mut().camera.world_from_eye = DAffine3::from_translation(HERE);
    // The time of the application, in which levels fade, hardly passes here.
    viewer.view_mut().camera.settings.lod_fade_s = 0.0;
    let path = |end: DVec3| {
        let point = |at_s: f64, eye| ControlPoint::from_pose(at_s, &DAffine3::from_translation(eye));
        AnimationPath::new(vec![point(0.0, HERE), point(500.0, end)]).unwrap()
    };
    let end = Instant::now() + kit::MAX_WAIT;
    let ahead = |viewer: &Viewer| viewer.pager().unwrap().stats().merged_ahead;
    let frame = |viewer: &mut Viewer| {
        assert!(Instant::now() < end, "{:?}", viewer.pager().unwrap().stats());
        let time_s = 1e-3 * viewer.frame_stamp().reference_time_s;
        viewer.frame_at(time_s).unwrap();
    };
    viewer.view_mut().announced = Some(path(HERE + DVec3::X));
    for _ in 0..20 {
        frame(&mut viewer);
    }
    while !viewer.is_settled() {
        frame(&mut viewer);
    }
    assert_eq!(ahead(&viewer), 0);
    viewer.view_mut().announced = Some(path(THERE));
    while ahead(&viewer) == 0 {
        frame(&mut viewer);
    }
}
