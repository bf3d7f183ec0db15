//! One pager for several scenes: one request list and one budget, but separate pages, failures and scopes. Real files,
//! no GPU.

use std::path::Path;
use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use kit::pager::{Context, PAGE_GPU_BYTES, above};
use kit::tile_sets::{WORLD_M, write_quadtree};
use terrane::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use terrane::fetch::{Limits, root_uri};
use terrane::formats::ReadOptions;
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::pager::{CompileContext, DatabasePager, PagerConfig, PagerStats};
use terrane::scene::{
    Node, NodeId, NodeKind, Page, PageId, PagedLod, PagingOptions, RangeMode, Refine, Scene, SlotState,
};

fn options(folder: &Path) -> ReadOptions {
    ReadOptions::for_root(&root_uri(folder.to_str().unwrap()).unwrap(), Limits::default())
}

/// Several scenes with one pager.
struct Several {
    scenes: Vec<Scene>,
    pager: DatabasePager,
    context: Context,
    stages: Vec<RenderStage>,
    frame: u32,
    visitor: CullVisitor,
}

impl Several {
    /// Opens scenes with the sets in these folders.
    fn of_sets(folders: &[&Path], config: PagerConfig) -> Self {
        let mut pager = DatabasePager::new(config, options(folders[0])).unwrap();
        let mut scenes = Vec::new();
        for (place, folder) in folders.iter().enumerate() {
            let uri = root_uri(folder.to_str().unwrap()).unwrap();
            let mut scene = Scene::new();
            let root = if place == 0 {
                pager.read_root(&uri)
            } else {
                pager.add_scene(scene.number(), options(folder));
                pager.read_root_of(scene.number(), &uri)
            };
            scene.add_root(root.unwrap());
            scenes.push(scene);
        }
        Self::with(scenes, pager)
    }

    fn with(scenes: Vec<Scene>, pager: DatabasePager) -> Self {
        let stages = scenes.iter().map(|_| RenderStage::new()).collect();
        Self { scenes, pager, context: Context::default(), stages, frame: 0, visitor: CullVisitor::new() }
    }

    /// Culls each scene straight down from its eye, or not at all, and then updates the pager.
    fn frame(&mut self, eyes: &[Option<DVec3>]) -> PagerStats {
        self.frame += 1;
        let mut requests: Vec<PageRequest> = Vec::new();
        for ((scene, stage), eye) in self.scenes.iter().zip(&mut self.stages).zip(eyes) {
            let Some(eye) = eye else { continue };
            let eye_from_world = DAffine3::from_translation(-*eye);
            let camera = CullCamera { eye_from_world, frame: self.frame, ..CullCamera::default() };
            self.visitor.cull(scene, &camera, stage);
            requests.extend_from_slice(&stage.requests);
        }
        self.update(&requests)
    }

    fn update(&mut self, requests: &[PageRequest]) -> PagerStats {
        let contexts: &mut [&mut dyn CompileContext] = &mut [&mut self.context];
        let mut scenes: Vec<&mut Scene> = self.scenes.iter_mut().collect();
        self.pager.update_scene_graph(&mut scenes, self.frame, f64::from(self.frame) / 60.0, requests, contexts);
        let s = *self.pager.stats();
        let ended = s.merged + s.failed + s.cancelled + s.stale + s.declined + s.dropped;
        assert_eq!(s.requested + s.retried, ended + s.waiting + s.in_flight, "{s:?}");
        assert_eq!(s.merged, s.expired + s.resident, "{s:?}");
        let pages: usize = self.scenes.iter().map(pages_in).sum();
        assert_eq!(s.resident, pages as u64, "{s:?}");
        s
    }

    fn until(&mut self, eyes: &[Option<DVec3>], what: &str, done: impl Fn(&Self) -> bool) -> PagerStats {
        let end = Instant::now() + kit::MAX_WAIT;
        while !done(self) {
            assert!(Instant::now() < end, "{what}: {:?} {:?}", self.pager.stats(), self.pager.errors());
            self.frame(eyes);
            std::thread::sleep(Duration::from_micros(200));
        }
        *self.pager.stats()
    }

    /// Runs frames until nothing is missing or in flight.
    fn settle(&mut self, eyes: &[Option<DVec3>]) -> PagerStats {
        self.frame(eyes);
        self.until(eyes, "the scenes did not settle", |r| {
            r.pager.is_idle() && r.stages.iter().all(|stage| stage.requests.is_empty())
        });
        self.frame(eyes)
    }

    fn pages(&self) -> Vec<usize> {
        self.scenes.iter().map(pages_in).collect()
    }
}

/// Returns the pages in the slots of a scene.
fn pages_in(scene: &Scene) -> usize {
    let mut open: Vec<PageId> = scene.roots().to_vec();
    let mut count = 0;
    while let Some(page) = open.pop() {
        for slot in scene.slots_of_page(page) {
            if let Some(SlotState::Resident(content)) = scene.slot(slot).map(|slot| slot.state) {
                count += 1;
                open.push(content);
            }
        }
    }
    count
}

fn over_the_world(u: f64, height_m: f64) -> DVec3 {
    DVec3::new(WORLD_M * u, WORLD_M * (0.5 + 0.3 * (9.0 * u).sin()), height_m)
}

const FAR: DVec3 = DVec3::new(0.5 * WORLD_M, 0.5 * WORLD_M, 500_000.0);

#[test]
fn handles_belong_to_their_scene() {
    let page = || Page::from_node(Node::group(vec![])).unwrap();
    let (mut one, mut other) = (Scene::new(), Scene::new());
    let (a, b) = (one.add_root(page()), other.add_root(page()));
    assert!(one.number() != other.number() && a != b && (a.slot, a.generation) == (b.slot, b.generation));
    assert!(one.page(a).is_some() && one.page(b).is_none() && other.page_mut(a).is_none());
    assert!(one.remove_root(b).is_none() && one.detach(b).is_err());
    assert!(one.slot(NodeId { page: b, index: 0 }).is_none());
}

#[test]
fn each_scene_loads_what_it_would_load_alone() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let eyes = [Some(over_the_world(0.2, 200.0)), Some(over_the_world(0.8, 900.0)), Some(FAR)];
    let alone: Vec<usize> = eyes
        .iter()
        .map(|eye| {
            let mut run = Several::of_sets(&[folder.path()], PagerConfig::default());
            run.settle(&[*eye]);
            run.pages()[0]
        })
        .collect();
    assert!(alone[0] > alone[2] && alone[2] > 0 && alone[0] != alone[1], "{alone:?}");
    let mut run = Several::of_sets(&[folder.path(); 3], PagerConfig::default());
    let stats = run.settle(&eyes);
    assert_eq!(run.pages(), alone);
    assert_eq!((stats.failed, run.pager.scenes().len()), (0, 3), "{:?}", run.pager.errors());
    assert_eq!(stats.gpu_bytes, stats.resident * PAGE_GPU_BYTES);
}

#[test]
fn one_budget_covers_all_scenes_and_evicts_the_least_recently_wanted() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let config = PagerConfig {
        max_bytes_gpu: 60 * PAGE_GPU_BYTES,
        // Half of it are the trees of the roots.
        max_bytes_cpu: 192 << 10,
        max_tiles: 50,
        expiry_time: Duration::ZERO,
        ..PagerConfig::default()
    };
    let mut run = Several::of_sets(&[folder.path(); 2], config.clone());
    let end = Instant::now() + kit::MAX_WAIT;
    for i in 0u32.. {
        let u = f64::from(i % 700) / 699.0;
        let s = run.frame(&[Some(over_the_world(u, 150.0)), Some(over_the_world(1.0 - u, 400.0))]);
        assert!(s.gpu_bytes <= config.max_bytes_gpu && s.cpu_bytes <= config.max_bytes_cpu, "frame {i}: {s:?}");
        assert!(s.resident <= config.max_tiles as u64, "frame {i}: {s:?}");
        if i >= 700 && s.expired > 50 {
            break;
        }
        assert!(Instant::now() < end, "nothing expires: {s:?}");
        std::thread::sleep(Duration::from_micros(100));
    }
    // Without a view, the pages of the second scene make room for those of the first, and vice versa.
    let eyes =
        |first: bool, u: f64| [first.then(|| over_the_world(u, 150.0)), (!first).then(|| over_the_world(u, 150.0))];
    for looked_at in [0, 1, 0] {
        let start = Instant::now();
        let mut turn = 0u32;
        while run.pages()[1 - looked_at] > 5 {
            turn += 1;
            run.frame(&eyes(looked_at == 0, f64::from(turn % 500) / 499.0));
            std::thread::sleep(Duration::from_micros(200));
            assert!(start.elapsed() < kit::MAX_WAIT, "{:?} {:?}", run.pages(), run.pager.stats());
        }
        assert!(run.pages()[looked_at] > 20, "{:?}", run.pages());
    }
}

#[test]
fn clearing_or_removing_a_scene_does_not_affect_others() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let eyes = [Some(over_the_world(0.3, 300.0)), Some(over_the_world(0.6, 300.0))];
    let mut run = Several::of_sets(&[folder.path(); 2], PagerConfig::default());
    run.settle(&eyes);
    let before = run.pages();
    // First everything is loaded, then requests are in flight.
    for is_on_the_way in [false, true] {
        if is_on_the_way {
            run.frame(&[Some(over_the_world(0.7, 100.0)), Some(over_the_world(0.1, 100.0))]);
        }
        let others = run.pager.request_states().filter(|(slot, _)| slot.page.scene == run.scenes[1].number()).count();
        run.pager.clear(&mut run.scenes[0], &mut [&mut run.context]);
        assert_eq!(run.pages()[0], 0);
        assert!(run.pages()[1] >= before[1]);
        let of = |scene: usize| {
            let number = run.scenes[scene].number();
            run.pager.request_states().filter(|(slot, _)| slot.page.scene == number).count()
        };
        assert_eq!((of(0), of(1)), (0, others));
        assert_eq!(run.pager.stats().gpu_bytes, run.pages()[1] as u64 * PAGE_GPU_BYTES);
        run.settle(&eyes);
        assert!(run.pages()[0] >= before[0] && run.pages()[1] >= before[1]);
    }
    let kept = run.pages()[1];
    let mut gone = run.scenes.remove(0);
    run.stages.remove(0);
    run.pager.remove_scene(&mut gone, &mut [&mut run.context]);
    assert_eq!((pages_in(&gone), run.pages(), run.pager.scenes().len()), (0, vec![kept], 1));
    run.settle(&eyes[1..]);
    // It may be added again. Before that it is not served.
    run.scenes.push(gone);
    run.stages.push(RenderStage::new());
    let eyes = [eyes[1], eyes[0]];
    for _ in 0..20 {
        run.frame(&eyes);
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(run.pages()[1] == 0 && !run.stages[1].requests.is_empty() && run.pager.is_idle());
    run.pager.add_scene(run.scenes[1].number(), options(folder.path()));
    run.settle(&eyes);
    assert_eq!(run.pages()[1], before[0]);
}

/// The scenes have slots with the same pages and indices in the same frames.
#[test]
fn failure_in_one_scene_does_not_affect_the_other() {
    let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
    folders.iter().for_each(|folder| _ = write_quadtree(folder.path()));
    let broken = folders[0].path().join("1_0_0.glb");
    std::fs::remove_file(&broken).unwrap();
    let config = PagerConfig { retry_after: Duration::from_secs(3600), ..PagerConfig::default() };
    let mut run = Several::of_sets(&[folders[0].path(), folders[1].path()], config);
    let eye = Some(over_the_world(0.5, 200.0));
    run.until(&[eye, eye], "it was not loaded", |r| {
        r.pager.is_idle() && r.stages[1].requests.is_empty() && r.pager.stats().failed == 1
    });
    let errors = run.pager.errors();
    assert!(errors.len() == 1 && errors[0].uri.ends_with("1_0_0.glb"), "{errors:?}");
    let failed = |scene: &Scene| {
        let root = scene.roots()[0];
        scene.slots_of_page(root).filter(|slot| scene.slot(*slot).unwrap().state == SlotState::Failed).count()
    };
    assert_eq!((failed(&run.scenes[0]), failed(&run.scenes[1])), (1, 0));
    // Clearing a scene forgets its failures.
    run.pager.clear(&mut run.scenes[1], &mut [&mut run.context]);
    assert_eq!(failed(&run.scenes[0]), 1);
    write_quadtree(folders[0].path());
    run.pager.clear(&mut run.scenes[0], &mut [&mut run.context]);
    run.settle(&[eye, eye]);
    assert_eq!((failed(&run.scenes[0]), run.pages()[0]), (0, run.pages()[1]));
}

/// Returns a tileset in a tileset, whose content is at `reference`.
fn write_nested(folder: &Path, reference: &str) {
    write_quadtree(folder);
    let bounds = r#""boundingVolume":{"sphere":[0,0,0,100]},"geometricError":0"#;
    let set = |uri: &str| {
        format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{{bounds},"refine":"REPLACE","content":{{"uri":"{uri}"}}}}}}"#
        )
    };
    std::fs::write(folder.join("tileset.json"), set("inner.json")).unwrap();
    std::fs::write(folder.join("inner.json"), set(reference)).unwrap();
}

#[test]
fn sets_can_only_refer_to_their_own_scope() {
    let both = tempfile::tempdir().unwrap();
    let [open, sly] = ["open", "sly"].map(|name| both.path().join(name));
    for folder in [&open, &sly] {
        std::fs::create_dir_all(folder).unwrap();
    }
    write_nested(&open, "0_0_0.glb");
    write_nested(&sly, "../open/0_0_0.glb");
    let eye = Some(above(300.0));
    // This holds in any order of loading, and for pagers of either scene.
    for folders in [[&open, &sly], [&sly, &open]] {
        let folders = folders.map(|folder| &**folder);
        let mut run = Several::of_sets(&folders, PagerConfig::default());
        run.until(&[eye, eye], "it was not loaded", |r| {
            let stats = r.pager.stats();
            r.pager.is_idle() && stats.loaded >= 3 && stats.failed >= 1
        });
        run.frame(&[eye, eye]);
        let pages_of = |name: &Path| run.pages()[folders.iter().position(|of| *of == name).unwrap()];
        let errors = run.pager.errors();
        assert_eq!(pages_of(&open), 2, "{errors:?}");
        assert!(pages_of(&sly) < 2 && errors.len() == 1 && errors[0].uri.contains("0_0_0.glb"), "{errors:?}");
    }
}

/// Returns tiles side by side, all with the same file.
fn many(folder: &Path, count: usize) -> Page {
    let tile = |_| {
        let node = PagedLod {
            bounds: BoundingVolume::Sphere(BoundingSphere::new(DVec3::ZERO, 10.0)),
            range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
            refine: Refine::Replace,
            content: Some(folder.join("0_0_0.glb").display().to_string().into()),
            content_transform: DAffine3::IDENTITY,
            reader_data: None,
            request_volume: None,
            paging: PagingOptions::default(),
        };
        Node::new(NodeKind::PagedLod(Box::new(node)))
    };
    Page::from_node(Node::group((0..count).map(tile).collect())).unwrap()
}

/// Regression: all requests of a moving camera had a higher priority than any of the other scene.
#[test]
fn busy_scene_leaves_requests_to_the_other() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    const MANY: usize = 3000;
    const FEW: usize = 20;
    let config = PagerConfig { file_threads: 1, decode_threads: 1, ..PagerConfig::default() };
    let mut pager = DatabasePager::new(config, options(folder.path())).unwrap();
    let scenes = [MANY, FEW].map(|count| {
        let mut scene = Scene::new();
        scene.add_root(many(folder.path(), count));
        pager.add_scene(scene.number(), options(folder.path()));
        scene
    });
    let requests: Vec<PageRequest> = scenes
        .iter()
        .zip([1000.0, 1.0])
        .flat_map(|(scene, priority)| {
            scene.slots_of_page(scene.roots()[0]).map(move |slot| PageRequest {
                slot,
                priority,
                error_px: priority,
                ahead_frames: 0,
            })
        })
        .collect();
    let mut run = Several::with(scenes.into(), pager);
    let start = Instant::now();
    while run.pages()[1] < FEW {
        run.frame += 1;
        run.update(&requests);
        std::thread::sleep(Duration::from_micros(300));
        assert!(start.elapsed() < kit::MAX_WAIT, "{:?}", run.pages());
    }
    let busy = run.pages()[0];
    assert!(busy < MANY / 3, "{busy} of the other scene were loaded first");
    assert!(busy >= FEW, "requests with higher priority get more slots: {busy}");
}

#[test]
fn blocking_mode_waits_for_all_scenes() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let config = PagerConfig { blocking: true, ..PagerConfig::default() };
    let mut run = Several::of_sets(&[folder.path(); 2], config);
    let eyes = [Some(over_the_world(0.3, 300.0)), Some(over_the_world(0.6, 300.0))];
    for frame in 0..20 {
        let stats = run.frame(&eyes);
        assert_eq!((stats.waiting, stats.in_flight), (0, 0), "frame {frame}");
        if run.stages.iter().all(|stage| stage.requests.is_empty()) {
            assert!(run.pages().iter().all(|count| *count > 4), "{:?}", run.pages());
            return;
        }
    }
    panic!("levels are loaded one after the other: {:?}", run.pages());
}

/// Two sets are on one server, each with a separate key, and a third one has no key.
#[cfg(feature = "http")]
#[test]
fn each_scene_sends_its_own_credentials() {
    use kit::server::{Reply, Server};
    use terrane::fetch::{Credential, HttpConfig};

    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let root = folder.path().to_owned();
    let server = Server::start(move |request| {
        // Paths have the form /SET/FILE.
        let name = request.path().rsplit('/').next().unwrap().to_owned();
        std::fs::read(root.join(name)).map_or_else(|_| Reply::new(404, ""), Reply::ok)
    });
    let with_key = |key: Option<&str>| {
        let key = key.map(|key| Credential::header(&server.url, "authorization", key).unwrap());
        HttpConfig { credentials: key.into_iter().collect(), ..HttpConfig::default() }
    };
    let of_set = |set: &str| {
        let uri = root_uri(&format!("{}/{set}/tileset.json", server.url)).unwrap();
        (ReadOptions::for_root(&uri, Limits::default()), uri)
    };
    let config = PagerConfig { http: with_key(Some("key of a")), ..PagerConfig::default() };
    let (scope, uri) = of_set("a");
    let mut pager = DatabasePager::new(config, scope).unwrap();
    let mut scenes = vec![Scene::new()];
    scenes[0].add_root(pager.read_root(&uri).unwrap());
    for (set, key) in [("b", Some("key of b")), ("c", None), ("d", Some("key of b"))] {
        let (mut scene, (scope, uri)) = (Scene::new(), of_set(set));
        pager.add_scene_with_http(scene.number(), scope, &with_key(key)).unwrap();
        scene.add_root(pager.read_root_of(scene.number(), &uri).unwrap());
        scenes.push(scene);
    }
    let mut run = Several::with(scenes, pager);
    let eyes = [0.2, 0.4, 0.6, 0.8].map(|u| Some(over_the_world(u, 900.0)));
    run.settle(&eyes);
    assert!(run.pages().iter().all(|count| *count > 4) && run.pager.stats().failed == 0);
    let requests = server.seen();
    for (set, key) in [("a", Some("key of a")), ("b", Some("key of b")), ("c", None), ("d", Some("key of b"))] {
        let of: Vec<_> = requests.iter().filter(|r| r.path().starts_with(&format!("/{set}/"))).collect();
        assert!(of.len() > 5, "{set}");
        assert!(of.iter().all(|request| request.header("authorization") == key), "{set}: {of:?}");
    }
}

/// Regression: each scene requested each tile of its own accord.
#[cfg(feature = "http")]
#[test]
fn scenes_with_one_set_share_requests_in_flight() {
    use kit::server::{Reply, Server};

    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let root = folder.path().to_owned();
    let server = Server::start(move |request| {
        let mut reply = Reply::ok(std::fs::read(root.join(request.path().trim_start_matches('/'))).unwrap());
        reply.delay = Duration::from_millis(50);
        reply
    });
    let uri = root_uri(&format!("{}/tileset.json", server.url)).unwrap();
    let options = || ReadOptions::for_root(&uri, Limits::default());
    let mut pager = DatabasePager::new(PagerConfig::default(), options()).unwrap();
    let mut scenes = vec![Scene::new(), Scene::new()];
    for scene in &mut scenes {
        pager.add_scene(scene.number(), options());
        scene.add_root(pager.read_root_of(scene.number(), &uri).unwrap());
    }
    let mut run = Several::with(scenes, pager);
    run.settle(&[Some(over_the_world(0.4, 900.0)); 2]);
    let pages = run.pages();
    assert!(pages[0] > 4 && pages[0] == pages[1] && run.pager.stats().failed == 0, "{pages:?}");
    // A few are not at the same time.
    assert!(server.count() < pages[0] + pages[0] / 2, "{} requests for {pages:?} pages", server.count());
}

/// Regression: each frame requested the failed tiles of the other scene again, whatever its cameras saw.
#[cfg(feature = "http")]
#[test]
fn clearing_a_scene_requests_nothing_of_others() {
    use kit::server::{Reply, Server};
    use terrane::fetch::HttpConfig;

    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let root = folder.path().to_owned();
    let server = Server::start(move |request| {
        let name = request.path().rsplit('/').next().unwrap().to_owned();
        match name.ends_with(".json") || !request.path().starts_with("/b/") {
            true => std::fs::read(root.join(name)).map_or_else(|_| Reply::new(404, ""), Reply::ok),
            false => Reply::new(503, ""),
        }
    });
    let http = HttpConfig { max_retries: 0, ..HttpConfig::default() };
    let config = PagerConfig { http, retry_after: Duration::from_millis(20), ..PagerConfig::default() };
    let of_set = |set: &str| {
        let uri = root_uri(&format!("{}/{set}/tileset.json", server.url)).unwrap();
        (ReadOptions::for_root(&uri, Limits::default()), uri)
    };
    let (scope, uri) = of_set("a");
    let mut pager = DatabasePager::new(config, scope).unwrap();
    let mut scenes = vec![Scene::new(), Scene::new()];
    scenes[0].add_root(pager.read_root(&uri).unwrap());
    let (scope, uri) = of_set("b");
    pager.add_scene(scenes[1].number(), scope);
    let root = pager.read_root_of(scenes[1].number(), &uri).unwrap();
    scenes[1].add_root(root);
    let mut run = Several::with(scenes, pager);
    let eye = Some(over_the_world(0.3, 900.0));
    run.until(&[eye, eye], "nothing fails", |r| r.pager.stats().failed > 0 && r.pages()[0] > 4);
    run.until(&[eye, None], "the other requests are not cancelled", |r| r.pager.is_idle());
    run.pager.clear(&mut run.scenes[0], &mut [&mut run.context]);
    let before = run.frame(&[None, None]);
    for _ in 0..300 {
        run.frame(&[None, None]);
        std::thread::sleep(Duration::from_millis(1));
    }
    let after = *run.pager.stats();
    assert_eq!((after.retried, after.requested), (before.retried, before.requested));
}

/// Pages that the application removes are not counted. Regression: they were counted until the pager ended.
#[test]
fn removed_pages_are_not_counted() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let eyes = [Some(over_the_world(0.3, 300.0))];
    let mut run = Several::of_sets(&[folder.path()], PagerConfig::default());
    run.settle(&eyes);
    let mut open: Vec<PageId> = run.scenes[0].roots().to_vec();
    let mut leaf = None;
    while let Some(page) = open.pop() {
        for slot in run.scenes[0].slots_of_page(page) {
            if let Some(SlotState::Resident(content)) = run.scenes[0].slot(slot).map(|slot| slot.state) {
                leaf = if run.scenes[0].is_expirable(content) { Some(content) } else { leaf };
                open.push(content);
            }
        }
    }
    run.scenes[0].detach(leaf.unwrap()).unwrap();
    run.pager.clear(&mut run.scenes[0], &mut [&mut run.context]);
    let s = run.update(&[]);
    assert_eq!((s.resident, s.cpu_bytes, s.gpu_bytes), (0, 0, 0));
    run.settle(&eyes);
}

/// Regression: sums of such limits overflowed, and channels of that capacity were allocated.
#[test]
fn maximum_values_mean_no_limit() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let config = PagerConfig {
        http_in_flight: usize::MAX,
        http_in_flight_max: usize::MAX,
        ahead_in_flight: usize::MAX,
        max_bytes_cpu: u64::MAX,
        max_bytes_gpu: u64::MAX,
        max_tiles: usize::MAX,
        expiry_frames: u32::MAX,
        expiry_time: Duration::MAX,
        stale_time: Duration::MAX,
        abort_time: Duration::MAX,
        merge_time: Duration::MAX,
        update_time: Duration::MAX,
        retry_after: Duration::MAX,
        ..PagerConfig::default()
    };
    let mut run = Several::of_sets(&[folder.path()], config);
    let eyes = [Some(over_the_world(0.3, 900.0))];
    run.frame(&eyes);
    let requests: Vec<PageRequest> = run.stages[0].requests.iter().map(|request| request.ahead(u32::MAX)).collect();
    assert!(!requests.is_empty());
    run.update(&requests);
    run.settle(&eyes);
    assert!(run.pages()[0] > 4);
}
