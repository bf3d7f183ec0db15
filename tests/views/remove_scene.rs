//! Scenes of a composite viewer that are removed while others stay. The noop adapter suffices.

use std::time::Duration;

use glam::DVec3;
use kit::process::runs_alone;
use kit::shapes::ball;
use kit::tile_sets::small_set;
use kit::viewer::Settle;
use terrane::gpu::{AdapterChoice, GraphicsContext};
use terrane::pager::{ImageSequence, SequenceImage};
use terrane::scene::Page;
use terrane::viewer::{CompositeViewer, ContextId, SceneId, ThreadingModel, ViewId, ViewerConfig, ViewerError};

/// The bytes that a device keeps for drawables without a texture.
const WHITE_TEXEL_BYTES: u64 = 4;

/// Waits up to 5 seconds until the process has pager threads, or has none. Returns false on timeout. A thread gets its
/// name shortly after its start, and leaves the system's list shortly after it was joined.
fn comes_to(has_threads: bool) -> bool {
    let is_pagers = |task: std::fs::DirEntry| {
        std::fs::read_to_string(task.path().join("comm")).is_ok_and(|name| name.starts_with("pager"))
    };
    let has = || std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten().any(is_pagers);
    (0..500).any(|_| {
        let is_so = has() == has_threads;
        if !is_so {
            std::thread::sleep(Duration::from_millis(10));
        }
        is_so
    })
}

/// Opens scenes of one set, each with a view, with one pager for all if `share` is true.
struct Scenes {
    viewer: CompositeViewer,
    context: ContextId,
    scenes: Vec<SceneId>,
    views: Vec<ViewId>,
}

impl Scenes {
    fn new(set: &str, count: usize, shared: bool, threading: ThreadingModel) -> Self {
        let config = ViewerConfig {
            size_px: [160, 120],
            adapter: AdapterChoice::Noop,
            validation: false,
            max_sse_px: 0.7,
            threading,
            ..ViewerConfig::default()
        };
        let mut viewer = CompositeViewer::new(&config).unwrap();
        let context = viewer.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
        let mut all = Self { viewer, context, scenes: Vec::new(), views: Vec::new() };
        for _ in 0..count {
            let first = all.scenes.first().copied().filter(|_| shared);
            let scene = match first {
                Some(first) => all.viewer.add_scene_with_pager_of(first),
                None => all.viewer.add_scene(),
            };
            let scene = scene.unwrap();
            all.show(scene, set);
        }
        all
    }

    /// Loads a set into an existing scene with a ball of the application, and adds a view.
    fn show(&mut self, scene: SceneId, set: &str) {
        self.viewer.load(scene, set).unwrap();
        let ball = Page::from_node(ball(DVec3::ZERO, 10.0, [1.0; 4])).unwrap();
        self.viewer.add_root(scene, ball).unwrap();
        self.scenes.push(scene);
        self.views.push(self.viewer.add_view(scene, self.context, None).unwrap());
    }

    fn pages(&self, scene: usize) -> usize {
        self.viewer.scene(self.scenes[scene]).unwrap().page_count()
    }

    /// Returns the bytes in the memory pools of the device, after releases have been processed.
    fn gpu_bytes(&mut self) -> u64 {
        (0..8).for_each(|_| self.viewer.frame().unwrap());
        self.viewer.finish().unwrap();
        self.viewer.stats().last().unwrap().gpu_bytes
    }

    /// Removes a scene with its view.
    fn remove(&mut self, place: usize) {
        self.viewer.remove_view(self.views.remove(place)).unwrap();
        self.viewer.remove_scene(self.scenes.remove(place)).unwrap();
    }
}

#[test]
fn removed_scene_frees_only_its_own_resources() {
    if runs_alone(module_path!(), "removed_scene_frees_only_its_own_resources") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    for model in ThreadingModel::ALL {
        for shared in [false, true] {
            let mut of_one = Scenes::new(&set, 1, shared, model);
            of_one.viewer.settle(3);
            let bytes = of_one.gpu_bytes();
            let of_pager = of_one.viewer.pager(of_one.scenes[0]).unwrap().unwrap().stats().gpu_bytes;
            drop(of_one);
            let mut three = Scenes::new(&set, 3, shared, model);
            three.viewer.settle(3);
            let (first, pages) = (three.scenes[0], three.pages(1));
            // A scene with a view cannot be removed, and nothing changes.
            let refused = three.viewer.remove_scene(first);
            assert!(matches!(refused, Err(ViewerError::SceneInUse { scene, views: 1 }) if scene == first));
            assert_eq!([three.pages(0), three.pages(2)], [pages, pages]);
            three.remove(0);
            assert!(matches!(three.viewer.scene(first), Err(ViewerError::NoScene(of)) if of == first));
            assert!(matches!(three.viewer.remove_scene(first), Err(ViewerError::NoScene(_))));
            assert!(three.viewer.scenes().eq(three.scenes.iter().copied()));
            three.viewer.settle(1);
            for (place, view) in three.views.iter().enumerate() {
                assert_eq!(three.viewer.scene_of(*view).unwrap(), three.scenes[place]);
                assert_eq!(three.pages(place), pages);
            }
            // The last scene but one is removed, so that every index changes.
            three.remove(0);
            three.viewer.settle(1);
            let stats = *three.viewer.pager(three.scenes[0]).unwrap().unwrap().stats();
            assert_eq!((three.pages(0), stats.resident as usize), (pages, pages - 2), "{model} {shared}");
            assert_eq!((three.gpu_bytes(), stats.gpu_bytes), (bytes, of_pager), "{model} {shared}");
            assert_eq!(stats.failed, 0, "{model} {shared}");
            // A new scene has an id that was never used, and loads its tiles.
            let scene = three.viewer.add_scene().unwrap();
            assert!(scene > three.scenes[0]);
            three.show(scene, &set);
            three.viewer.settle(3);
            assert_eq!([three.pages(0), three.pages(1)], [pages, pages]);
            three.remove(0);
            three.remove(0);
            assert!(comes_to(false) && three.viewer.scenes().next().is_none(), "{model} {shared}");
            assert_eq!(three.gpu_bytes(), WHITE_TEXEL_BYTES, "{model} {shared}");
            assert!(three.viewer.draw_errors().is_empty());
        }
    }
}

/// Pending uploads of a removed scene are dropped: neither kept, nor used for a later scene with its number.
#[test]
fn scene_is_removed_while_it_loads() {
    if runs_alone(module_path!(), "scene_is_removed_while_it_loads") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    for shared in [false, true] {
        let mut two = Scenes::new(&set, 2, shared, ThreadingModel::DrawThreadPerContext);
        for frames in (0..8).rev() {
            (0..frames).for_each(|_| two.viewer.frame().unwrap());
            two.remove(1);
            let scene = match shared {
                true => two.viewer.add_scene_with_pager_of(two.scenes[0]).unwrap(),
                false => two.viewer.add_scene().unwrap(),
            };
            two.show(scene, &set);
        }
        two.viewer.settle(3);
        let mut new = Scenes::new(&set, 2, shared, ThreadingModel::DrawThreadPerContext);
        new.viewer.settle(3);
        assert_eq!([two.pages(0), two.pages(1)], [new.pages(0), new.pages(1)]);
        assert_eq!(two.gpu_bytes(), new.gpu_bytes(), "{shared}");
        two.remove(0);
        two.remove(0);
        assert_eq!(two.gpu_bytes(), WHITE_TEXEL_BYTES);
    }
}

#[test]
fn image_pager_of_a_scene_ends_with_it() {
    if runs_alone(module_path!(), "image_pager_of_a_scene_ends_with_it") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let mut none = Scenes::new("", 0, false, ThreadingModel::SingleThreaded);
    assert!(comes_to(false));
    let scene = none.viewer.add_scene().unwrap();
    let images = vec![SequenceImage::File(folder.path().join("none.png").display().to_string().into())];
    none.viewer.add_image_sequence(scene, &ImageSequence::new("clouds", images)).unwrap();
    none.viewer.frame().unwrap();
    assert!(none.viewer.image_pager(scene).unwrap().is_some() && (comes_to(true) || cfg!(not(target_os = "linux"))));
    none.viewer.remove_scene(scene).unwrap();
    assert!(comes_to(false));
}
