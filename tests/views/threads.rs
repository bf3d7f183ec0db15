//! Threads are started and stopped, and contexts opened and closed, at random. No thread may wait forever. wgpu's noop
//! adapter draws, so that only the threads take time.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};
use terrane::state::DataVariance;

use glam::{DAffine3, DVec3};
use terrane::draw::{CameraCallbacks, CompiledDrawable, CustomDrawable, custom_geometry};
use terrane::gpu::{AdapterChoice, CompileInfo, CustomError, GraphicsContext};
use terrane::math::Aabb;
use terrane::pager::PagerConfig;
use terrane::scene::{
    CameraNode, CullAction, CullCallback, Drawable, Geometry, Material, Mesh, Node, NodeId, Page, PageId, RenderOrder,
};
use terrane::sync::{Operation, OperationThread};
use terrane::viewer::{
    CompositeViewer, ContextId, Slave, SlaveId, ThreadingModel, ViewId, Viewer, ViewerConfig, ViewerError,
};

/// The maximum number of contexts besides the first.
const MORE: usize = 3;

fn config(threading: ThreadingModel) -> ViewerConfig {
    ViewerConfig {
        size_px: [32, 32],
        threading,
        adapter: AdapterChoice::Noop,
        validation: false,
        history_frames: 64,
        max_contexts: 1 + MORE,
        ..ViewerConfig::default()
    }
}

fn context() -> GraphicsContext {
    GraphicsContext::new_offscreen(&config(ThreadingModel::SingleThreaded).traits()).unwrap()
}

fn ball(radius: f64) -> Drawable {
    Drawable::new(Geometry::Mesh(Arc::new(Mesh::sphere(DVec3::ZERO, radius, 8))), Material::default())
}

fn page(callbacks: Option<CameraCallbacks>) -> Page {
    let camera = CameraNode {
        callbacks: Some(callbacks.unwrap_or_default().hook()),
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    let nodes = vec![
        Node::transform(DAffine3::IDENTITY, vec![Node::geode(vec![ball(1.0)])]),
        Node::camera(camera, vec![Node::geode(vec![ball(0.5)])]),
    ];
    Page::from_node(Node::group(nodes)).unwrap()
}

/// Returns a camera's callbacks that panic in the call number `times`, in one context only.
fn panic_after(times: u64) -> CameraCallbacks {
    let countdown = AtomicU64::new(times);
    CameraCallbacks {
        final_draw: Some(Box::new(move |_, _| {
            assert!(countdown.fetch_sub(1, Ordering::SeqCst) != 1, "a callback that panics on purpose");
        })),
        ..CameraCallbacks::default()
    }
}

struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % n as u64) as usize
    }
}

/// Runs work that must not hang: reports the current step if one takes longer than half a minute.
fn watched(work: impl FnOnce(&AtomicU64) + Send + 'static) {
    let step = Arc::new(AtomicU64::new(0));
    let (done, is_done) = channel();
    let of_work = step.clone();
    let worker = std::thread::spawn(move || {
        work(&of_work);
        // The other end waits for it, or has timed out.
        let _ = done.send(());
    });
    let mut before = 0;
    loop {
        match is_done.recv_timeout(Duration::from_secs(30)) {
            Ok(()) => break,
            Err(RecvTimeoutError::Disconnected) => break,
            Err(RecvTimeoutError::Timeout) => {
                let now = step.load(Ordering::Relaxed);
                assert!(now != before, "step {now} waits forever");
                before = now;
            }
        }
    }
    if let Err(panic) = worker.join() {
        std::panic::resume_unwind(panic);
    }
}

/// Changes a viewer with one view, its contexts and slaves at random. Returns the sorted durations of stops and starts.
fn churn_viewer(seed: u64, switches: u64, step: &AtomicU64) -> Vec<Duration> {
    let mut random = Random(seed);
    let mut viewer = Viewer::new(context(), &config(ThreadingModel::SingleThreaded)).unwrap();
    let root = viewer.add_root(page(None)).unwrap();
    let mut contexts: Vec<ContextId> = Vec::new();
    let mut slaves: Vec<(SlaveId, ContextId)> = Vec::new();
    let mut times = Vec::new();
    let mut frames = 0;
    while step.fetch_add(1, Ordering::Relaxed) < switches {
        let model = ThreadingModel::ALL[random.below(4)];
        viewer.finish().unwrap();
        let start = Instant::now();
        viewer.composite_mut().set_threading_model(model).unwrap();
        viewer.composite_mut().start_threading().unwrap();
        times.push(start.elapsed());
        assert_eq!(viewer.composite().threading_model(), model);
        for _ in 0..random.below(4) {
            change(&mut random, &mut viewer, root, &mut contexts, &mut slaves);
            viewer.frame().unwrap();
            frames += 1;
        }
    }
    viewer.finish().unwrap();
    assert_eq!(viewer.frame_stamp().frame, frames);
    assert!(viewer.stats().iter().all(|s| s.drawn));
    times.sort_unstable();
    times
}

fn change(
    random: &mut Random,
    viewer: &mut Viewer,
    root: PageId,
    contexts: &mut Vec<ContextId>,
    slaves: &mut Vec<(SlaveId, ContextId)>,
) {
    match random.below(9) {
        0 if contexts.len() < MORE => {
            let opened = viewer.open_context(context()).unwrap();
            contexts.push(opened);
            slaves.push((viewer.add_slave(Slave::new(opened)).unwrap(), opened));
        }
        1 if !contexts.is_empty() => {
            let closed = contexts.swap_remove(random.below(contexts.len()));
            assert!(viewer.composite_mut().close_context(closed).unwrap());
            slaves.retain(|(_, of)| *of != closed);
        }
        2 if slaves.len() < 6 => {
            let all: Vec<_> = viewer.contexts().collect();
            let of = all[random.below(all.len())];
            slaves.push((viewer.add_slave(Slave::new(of)).unwrap(), of));
        }
        3 if !slaves.is_empty() => {
            let (slave, _) = slaves.swap_remove(random.below(slaves.len()));
            assert!(viewer.remove_slave(slave).unwrap());
        }
        4 => viewer.composite_mut().stop_threading().unwrap(),
        5 => viewer.resize([16 + random.below(32) as u32, 16 + random.below(32) as u32]).unwrap(),
        6 => {
            let variance = [DataVariance::Static, DataVariance::Dynamic][random.below(2)];
            let mesh = Arc::new(Mesh::sphere(DVec3::ZERO, 1.0, 4 + random.below(8) as u32));
            viewer.scene_mut().set_mesh(NodeId { page: root, index: 2 }, 0, mesh, variance).unwrap();
        }
        7 => viewer.composite_mut().set_threading_model(ThreadingModel::ALL[random.below(4)]).unwrap(),
        _ => {}
    }
}

/// Views and contexts are added and removed. Sometimes the whole viewer is dropped with frames in flight.
fn churn_views(seed: u64, rounds: u64, step: &AtomicU64) {
    let mut random = Random(seed);
    while step.load(Ordering::Relaxed) < rounds {
        let mut viewer = CompositeViewer::new(&config(ThreadingModel::ALL[random.below(4)])).unwrap();
        let scenes = [viewer.add_scene().unwrap(), viewer.add_scene().unwrap()];
        viewer.add_root(scenes[0], page(None)).unwrap();
        let mut contexts: Vec<ContextId> = Vec::new();
        let mut views: Vec<(ViewId, ContextId)> = Vec::new();
        for _ in 0..20 + random.below(20) {
            step.fetch_add(1, Ordering::Relaxed);
            match random.below(7) {
                0 | 1 if contexts.len() < MORE => contexts.push(viewer.open_context(context()).unwrap()),
                2 if !contexts.is_empty() => {
                    let closed = contexts.swap_remove(random.below(contexts.len()));
                    assert!(viewer.close_context(closed).unwrap());
                }
                3 | 4 if !contexts.is_empty() && views.len() < 6 => {
                    let of = contexts[random.below(contexts.len())];
                    let view = viewer.add_view(scenes[random.below(2)], of, Some([0, 0, 16, 16])).unwrap();
                    views.push((view, of));
                }
                5 if !views.is_empty() => {
                    let (view, _) = views.swap_remove(random.below(views.len()));
                    viewer.remove_view(view).unwrap();
                }
                6 => viewer.set_threading_model(ThreadingModel::ALL[random.below(4)]).unwrap(),
                _ => {}
            }
            for _ in 0..random.below(3) {
                viewer.frame().unwrap();
            }
        }
    }
}

#[test]
fn models_are_switched_and_contexts_opened_and_closed() {
    watched(|step| {
        let times = churn_viewer(1, 600, step);
        println!("stop and start: median {:?}, slowest {:?}", times[300], times[599]);
    });
}

#[test]
fn views_are_added_and_removed() {
    watched(|step| churn_views(2, 600, step));
}

/// Run by `cargo test --release --test views -- --ignored --nocapture ten_thousand`. `SEED` sets the first seed.
#[test]
#[ignore = "takes a minute"]
fn ten_thousand_switches() {
    let seed = std::env::var("SEED").map_or(7, |seed| seed.parse().unwrap());
    watched(move |step| {
        let start = Instant::now();
        let times = churn_viewer(seed, 10_000, step);
        let [median, nearly_all, slowest] = [5_000, 9_990, 9_999].map(|i: usize| times[i].as_secs_f64() * 1e3);
        println!("10,000 switches in {:?}", start.elapsed());
        println!("stop and start: median {median:.2} ms, 99.9 % {nearly_all:.2} ms, slowest {slowest:.2} ms");
        assert!(slowest < 50.0);
        step.store(0, Ordering::Relaxed);
        churn_views(seed, 10_000, step);
    });
}

#[test]
fn thread_that_panics_is_an_error_and_nothing_waits_for_it() {
    for threading in &ThreadingModel::ALL[1..] {
        watched(move |_| {
            let mut viewer = Viewer::new(context(), &config(*threading)).unwrap();
            let other = viewer.open_context(context()).unwrap();
            viewer.add_slave(Slave::new(other)).unwrap();
            // Some frames after the start.
            viewer.add_root(page(Some(panic_after(9)))).unwrap();
            let error = (0..200).find_map(|_| viewer.frame().err()).expect("the panic is reported");
            assert!(matches!(error, ViewerError::DrawThreadStopped), "{error}");
            assert!(viewer.frame().is_err(), "the error stays");
            // The viewer is dropped after one context was closed.
        });
    }
}

/// Regression: a thread that was released while the object still existed could send it a value that was never received.
#[test]
fn wait_for_a_panicked_thread_drops_its_object_first() {
    struct Owned(Arc<AtomicU64>);
    impl Drop for Owned {
        fn drop(&mut self) {
            self.0.store(1, Ordering::SeqCst);
        }
    }
    struct Panics {
        gone: Arc<AtomicU64>,
        seen: Sender<bool>,
    }
    impl Operation<Owned> for Panics {
        fn name(&self) -> &str {
            "panics"
        }
        fn run(&self, _: &mut Owned) {
            panic!("an operation that panics on purpose");
        }
        fn release(&self) {
            self.seen.send(self.gone.load(Ordering::SeqCst) == 1).unwrap();
        }
    }
    let gone = Arc::new(AtomicU64::new(0));
    let (seen, was_gone) = channel();
    let operation: Arc<dyn Operation<Owned>> = Arc::new(Panics { gone: gone.clone(), seen });
    let thread = OperationThread::start("dies", Owned(gone), [operation]).unwrap();
    assert!(was_gone.recv_timeout(Duration::from_secs(30)).unwrap());
    assert!(thread.join().is_err());
}

/// Changing or paging the scene after a thread's panic does not panic.
#[test]
fn scene_can_be_changed_after_a_thread_has_panicked() {
    let folder = tempfile::tempdir().unwrap();
    for round in 0..20 {
        for threading in &ThreadingModel::ALL[1..] {
            let folder = folder.path().to_owned();
            watched(move |_| {
                let mut viewer = Viewer::new(context(), &config(*threading)).unwrap();
                let other = viewer.open_context(context()).unwrap();
                viewer.add_slave(Slave::new(other)).unwrap();
                viewer.page_files_in(&folder).unwrap();
                viewer.on_update(Box::new(|_, _| {}));
                let root = viewer.add_root(page(Some(panic_after(2 + round % 7)))).unwrap();
                let error = (0..200).find_map(|_| viewer.frame().err()).expect("the panic is reported");
                assert!(matches!(error, ViewerError::DrawThreadStopped), "{error}");
                viewer.scene_mut();
                viewer.work_until(Instant::now() + Duration::from_millis(1));
                let _ = viewer.add_root(page(None));
                viewer.remove_root(root);
                assert!(viewer.frame().is_err());
                // A wait for a frame in flight returns an error instead of hanging. Without the panicked thread the
                // others continue.
                let _ = viewer.open_context(context());
                let _ = viewer.composite_mut().set_threading_model(ThreadingModel::SingleThreaded);
                assert!(viewer.frame().is_err());
                for id in viewer.contexts().collect::<Vec<_>>() {
                    viewer.composite_mut().close_context(id).unwrap();
                }
                viewer.frame().unwrap();
                viewer.scene_mut();
            });
        }
    }
}

/// Regression: its update waited forever for the uploads of its tiles.
#[test]
fn blocking_mode_does_not_wait_for_a_thread_that_panics_in_an_upload() {
    struct Panics;
    impl CustomDrawable for Panics {
        fn name(&self) -> &str {
            "panics"
        }

        fn bounds(&self) -> Aabb {
            Aabb { min: DVec3::NEG_ONE, max: DVec3::ONE }
        }

        fn compile(&self, _: &CompileInfo<'_>) -> Result<Box<dyn CompiledDrawable>, CustomError> {
            panic!("a drawable that panics on purpose");
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let set = kit::tile_sets::small_set(folder.path());
    for threading in &ThreadingModel::ALL[1..] {
        let set = set.clone();
        watched(move |_| {
            let pager = PagerConfig { blocking: true, ..PagerConfig::default() };
            let mut viewer = Viewer::new(context(), &ViewerConfig { pager, ..config(*threading) }).unwrap();
            viewer.load(&set).unwrap();
            let drawable = Drawable::new(custom_geometry(Panics), Material::default());
            viewer.add_root(Page::from_node(Node::geode(vec![drawable])).unwrap()).unwrap();
            let error = viewer.frame().expect_err("the panic is reported");
            assert!(matches!(error, ViewerError::DrawThreadStopped), "{error}");
        });
    }
}

/// Regression: closing the first context of a dead device closed all of them except for their cameras, and no frame was
/// drawn again.
#[test]
fn contexts_of_a_dead_device_are_closed_one_by_one() {
    for threading in &ThreadingModel::ALL[1..] {
        watched(move |_| {
            let mut viewer = Viewer::new(context(), &config(*threading)).unwrap();
            let main = viewer.contexts().next().unwrap();
            let second = viewer.composite_mut().open_offscreen_on(main, &config(*threading).traits()).unwrap();
            viewer.add_slave(Slave::new(second)).unwrap();
            viewer.add_root(page(Some(panic_after(9)))).unwrap();
            let error = (0..200).find_map(|_| viewer.frame().err()).expect("the panic is reported");
            assert!(matches!(error, ViewerError::DrawThreadStopped), "{error}");
            assert!(
                viewer.composite_mut().close_context(main).unwrap()
                    && !viewer.composite_mut().close_context(main).unwrap()
            );
            assert!(viewer.frame().is_err(), "{threading}: the other context is still open");
            assert!(
                viewer.composite_mut().close_context(second).unwrap()
                    && !viewer.composite_mut().close_context(second).unwrap()
            );
            viewer.frame().unwrap();
            assert_eq!(viewer.contexts().count() + viewer.view().slaves().count(), 0);
        });
    }
}

/// Regression: the remaining stages were sent to removed cameras, and with the second panic the last one waited
/// forever.
#[test]
fn view_survives_a_panic_in_the_cameras_of_others() {
    watched(|_| {
        let mut viewer =
            CompositeViewer::new(&config(ThreadingModel::CullThreadPerCameraDrawThreadPerContext)).unwrap();
        let shared = viewer.open_context(context()).unwrap();
        let views = [5, 15, u64::MAX].map(|times| {
            let countdown = AtomicU64::new(times);
            let callback = CullCallback(Arc::new(move |_| {
                assert!(countdown.fetch_sub(1, Ordering::SeqCst) != 1, "a callback that panics on purpose");
                CullAction::Traverse
            }));
            let node = Node { cull_callback: Some(callback), ..Node::geode(vec![ball(1.0)]) };
            let scene = viewer.add_scene().unwrap();
            viewer.add_root(scene, Page::from_node(node).unwrap()).unwrap();
            viewer.add_view(scene, shared, Some([0, 0, 16, 16])).unwrap()
        });
        for dead in &views[..2] {
            let error = (0..200).find_map(|_| viewer.frame().err()).expect("the panic is reported");
            assert!(matches!(error, ViewerError::DrawThreadStopped), "{error}");
            viewer.remove_view(*dead).unwrap();
        }
        for _ in 0..20 {
            viewer.frame().unwrap();
        }
        viewer.finish().unwrap();
        assert_eq!(viewer.views().count(), 1);
    });
}

#[test]
fn automatic_selection_depends_on_contexts_and_cores() {
    let mut viewer = Viewer::new(context(), &config(ThreadingModel::AutomaticSelection)).unwrap();
    viewer.frame().unwrap();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let from_environment = ThreadingModel::from_environment().unwrap();
    let expected = |contexts, cameras| {
        let best = ThreadingModel::suggest_best(contexts, cameras, cores);
        from_environment.filter(|m| *m != ThreadingModel::AutomaticSelection).unwrap_or(best)
    };
    assert_eq!(viewer.composite().threading_model(), expected(1, 1));
    let other = viewer.open_context(context()).unwrap();
    viewer.add_slave(Slave::new(other)).unwrap();
    viewer.frame().unwrap();
    assert_eq!(viewer.composite().threading_model(), expected(2, 2));
}
