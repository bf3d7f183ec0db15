//! Scenes of a composite viewer that share a pager. The noop adapter suffices.

use std::time::{Duration, Instant};

use kit::tile_sets::small_set;
use kit::viewer::Settle;
use terrane::gpu::{AdapterChoice, GraphicsContext};
use terrane::pager::DatabasePager;
use terrane::viewer::{
    ArrangedViews, Arrangement, CompositeViewer, ContextId, SceneId, ThreadingModel, ViewFrom, ViewId, ViewerConfig,
};

fn config(blocking: bool) -> ViewerConfig {
    let mut config = ViewerConfig {
        size_px: [160, 120],
        adapter: AdapterChoice::Noop,
        validation: false,
        max_contexts: 3,
        max_sse_px: 0.7,
        ..ViewerConfig::default()
    };
    config.pager.blocking = blocking;
    config
}

/// The initial heights of cameras, and those from which they want more tiles, in metres.
const FAR_M: f64 = 25_000.0;
const NEAR_M: f64 = 9000.0;

struct Two {
    viewer: CompositeViewer,
    context: ContextId,
    scenes: [SceneId; 2],
    views: [ViewId; 2],
}

/// Opens two scenes of a set with equal views.
fn two(set: &str, shared: bool, config: &ViewerConfig) -> Two {
    let mut viewer = CompositeViewer::new(config).unwrap();
    let context = viewer.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
    let first = viewer.add_scene().unwrap();
    let second = if shared { viewer.add_scene_with_pager_of(first).unwrap() } else { viewer.add_scene().unwrap() };
    let scenes = [first, second];
    let views = scenes.map(|scene| {
        viewer.load(scene, set).unwrap();
        viewer.add_view(scene, context, None).unwrap()
    });
    let mut two = Two { viewer, context, scenes, views };
    (0..2).for_each(|view| two.look(view, FAR_M));
    two
}

impl Two {
    fn pager(&self, scene: usize) -> &DatabasePager {
        self.viewer.pager(self.scenes[scene]).unwrap().unwrap()
    }

    fn pages(&self, scene: usize) -> usize {
        self.viewer.scene(self.scenes[scene]).unwrap().page_count() - 1
    }

    /// Returns the bytes in the memory pools of the devices, after everything was drawn.
    fn gpu_bytes(&mut self) -> u64 {
        self.viewer.frame().unwrap();
        self.viewer.finish().unwrap();
        self.viewer.stats().last().unwrap().gpu_bytes
    }

    fn look(&mut self, view: usize, range_m: f64) {
        let bounds = *self.viewer.bounds(self.scenes[view]).unwrap().unwrap();
        let pose = bounds.first_camera(&ViewFrom { range_m: Some(range_m), ..ViewFrom::default() });
        self.viewer.view_mut(self.views[view]).unwrap().camera.world_from_eye = pose;
    }
}

#[test]
fn two_views_of_two_scenes_settle_with_one_pager() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let mut alone = two(&set, false, &config(false));
    alone.viewer.settle(3);
    for model in ThreadingModel::ALL {
        let mut both = two(&set, true, &ViewerConfig { threading: model, ..config(false) });
        assert!(both.viewer.shares_pager(both.scenes[0], both.scenes[1]).unwrap());
        assert!(!alone.viewer.shares_pager(alone.scenes[0], alone.scenes[1]).unwrap());
        both.viewer.settle(3);
        assert_eq!([both.pages(0), both.pages(1)], [alone.pages(0), alone.pages(1)]);
        assert!(std::ptr::eq(both.pager(0), both.pager(1)) && !std::ptr::eq(alone.pager(0), alone.pager(1)));
        assert_eq!(both.pager(0).stats().resident as usize, both.pages(0) + both.pages(1));
        assert_eq!(both.pager(0).stats().failed, 0);
    }
}

/// With two pagers, each counts the content of the memory pools once.
#[test]
fn equal_contents_of_two_scenes_are_shared_and_count_once() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let mut one = two(&set, true, &config(false));
    one.viewer.remove_view(one.views[1]).unwrap();
    one.viewer.settle(3);
    let (of_one, in_one) = (one.pager(0).stats().gpu_bytes, one.gpu_bytes());
    let mut both = two(&set, true, &config(false));
    both.viewer.settle(3);
    let (s, in_both) = (*both.pager(0).stats(), both.gpu_bytes());
    assert!(of_one > 0 && s.resident == 2 * one.pager(0).stats().resident);
    assert_eq!((s.gpu_bytes, in_both), (of_one, in_one), "{s:?}");
    assert!(s.shared_gpu_bytes_saved >= of_one, "{s:?}");
    // A tile that expires in one scene stays in the other.
    both.viewer.clear_pages(both.scenes[0]).unwrap();
    both.viewer.view_mut(both.views[0]).unwrap().camera.settings.cull_mask = 0;
    both.viewer.settle(4);
    let s = *both.pager(0).stats();
    assert_eq!((both.pages(0), both.gpu_bytes(), s.gpu_bytes), (0, in_one, of_one), "{s:?}");
}

#[test]
fn cleared_scene_loads_again_and_the_other_stays() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let mut both = two(&set, true, &config(false));
    both.viewer.settle(3);
    let before = [both.pages(0), both.pages(1)];
    both.viewer.clear_pages(both.scenes[1]).unwrap();
    assert_eq!([both.pages(0), both.pages(1)], [before[0], 0]);
    assert!(!both.viewer.is_settled());
    both.viewer.settle(1);
    assert_eq!([both.pages(0), both.pages(1)], before);
    // Another set replaces that of one scene. The pager continues with the pages of the other.
    let merged = both.pager(0).stats().merged;
    both.viewer.clear_pages(both.scenes[1]).unwrap();
    let root = both.viewer.scene(both.scenes[1]).unwrap().roots()[0];
    assert!(both.viewer.remove_root(both.scenes[1], root).unwrap().is_some());
    both.viewer.load(both.scenes[1], &set).unwrap();
    both.look(1, FAR_M);
    assert_eq!(both.pages(0), before[0]);
    both.viewer.settle(1);
    assert_eq!([both.pages(0), both.pages(1)], before);
    assert!(both.pager(1).stats().merged > merged);
}

#[test]
fn budget_is_shared_by_both_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let mut config = config(false);
    let mut free = two(&set, true, &config);
    free.viewer.settle(3);
    let wanted = free.pages(0) + free.pages(1);
    assert!(wanted >= 10, "{wanted}");
    config.pager.max_tiles = wanted - 3;
    let mut both = two(&set, true, &config);
    let start = Instant::now();
    while both.viewer.check_need_to_do_frame() {
        both.viewer.frame().unwrap();
        both.viewer.work_until(Instant::now() + Duration::from_millis(2));
        let s = both.pager(0).stats();
        assert!(s.resident <= config.pager.max_tiles as u64, "{s:?}");
        assert!(start.elapsed() < Duration::from_secs(60), "it never pauses: {s:?}");
    }
    assert!(!both.viewer.is_settled(), "some pages have no room");
    // When one view looks away, there is room for the other.
    both.look(1, 1e7);
    both.viewer.settle(1);
    assert!(both.pages(0) >= free.pages(0), "{}", both.pages(0));
}

#[test]
fn blocking_mode_has_all_scenes_in_the_first_frame() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let mut free = two(&set, true, &config(false));
    free.viewer.settle(3);
    let mut both = two(&set, true, &config(true));
    both.viewer.frame().unwrap();
    assert!(both.viewer.is_settled(), "{:?}", both.pager(0).stats());
    assert_eq!([both.pages(0), both.pages(1)], [free.pages(0), free.pages(1)]);
    both.look(0, NEAR_M);
    both.viewer.frame().unwrap();
    assert_eq!(both.viewer.stats().last().unwrap().wanted_missing, 0);
    assert!(both.pages(0) > free.pages(0), "{} {}", both.pages(0), free.pages(0));
}

#[test]
fn drawing_on_demand_pauses_and_wakes_with_a_shared_pager() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let mut both = two(&set, true, &config(false));
    let rest = |both: &mut Two| {
        let start = Instant::now();
        while both.viewer.check_need_to_do_frame() {
            both.viewer.frame().unwrap();
            both.viewer.work_until(Instant::now() + Duration::from_millis(2));
            assert!(start.elapsed() < Duration::from_secs(60), "it never pauses");
        }
    };
    rest(&mut both);
    assert!(both.viewer.is_settled());
    let before = both.pages(1);
    // While paused, missing tiles do not load and drawing stops. Resuming wakes it.
    both.viewer.pager_mut(both.scenes[0]).unwrap().unwrap().set_paused(true);
    both.look(1, NEAR_M);
    both.viewer.frame().unwrap();
    rest(&mut both);
    assert_eq!(both.pages(1), before);
    both.viewer.pager_mut(both.scenes[1]).unwrap().unwrap().set_paused(false);
    assert!(both.viewer.check_need_to_do_frame());
    rest(&mut both);
    assert!(both.viewer.is_settled() && both.pages(1) > before);
}

#[test]
fn contexts_open_and_close_with_a_shared_pager() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let config = config(false);
    let mut both = two(&set, true, &config);
    both.viewer.settle(3);
    let (before, bytes) = ([both.pages(0), both.pages(1)], both.pager(0).stats().gpu_bytes);
    let other = both.viewer.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
    let view = both.viewer.add_view(both.scenes[1], other, None).unwrap();
    both.viewer.settle(3);
    assert_eq!([both.pages(0), both.pages(1)], before);
    assert_eq!(both.pager(0).stats().gpu_bytes, 2 * bytes, "once on each device");
    both.viewer.remove_view(view).unwrap();
    both.viewer.close_context(other).unwrap();
    both.viewer.settle(3);
    assert_eq!(both.pager(0).stats().gpu_bytes, bytes);
    assert!(both.viewer.contexts().eq([both.context]));
    assert!(both.viewer.draw_errors().is_empty());
}

#[test]
fn file_of_views_configures_a_shared_pager() {
    let folder = tempfile::tempdir().unwrap();
    small_set(folder.path());
    let file = folder.path().join("views.json");
    for (text, shares) in [(r#""share_pager": true,"#, true), (r#""share_pager": false,"#, false), ("", false)] {
        let views = r#""views": [{"scene": "a"}, {"scene": "b"}, {}]}"#;
        std::fs::write(&file, format!(r#"{{"scenes": {{"a": "set", "b": "set"}}, {text} {views}"#)).unwrap();
        let Arrangement::Views(setup) = Arrangement::read(&file).unwrap() else { panic!("no views") };
        let config = config(true);
        let roots = setup.read_roots(&config.pager).unwrap();
        let mut arranged = ArrangedViews::new_offscreen(&setup, &config, roots, None).unwrap();
        let scenes: Vec<SceneId> = arranged.views.iter().map(|view| arranged.viewer.scene_of(*view).unwrap()).collect();
        assert_eq!(arranged.own_scene, Some(scenes[2]));
        for other in &scenes[1..] {
            assert_eq!(arranged.viewer.shares_pager(scenes[0], *other).unwrap(), shares);
        }
        // The application's pages load their files in their own scope.
        arranged.viewer.page_files_in(scenes[2], folder.path()).unwrap();
        let pagers = if shares { 3 } else { 1 };
        assert_eq!(arranged.viewer.pager(scenes[2]).unwrap().unwrap().scenes().len(), pagers);
        arranged.viewer.settle(2);
    }
}
