//! Operations of the application: once for each context, in update, and on the threads of contexts, cameras and uploads.
//! wgpu's noop adapter draws.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use terrane::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
use terrane::scene::{Node, Page};
use terrane::sync::Operation;
use terrane::viewer::{Slave, ThreadingModel, Viewer, ViewerConfig, ViewerError};

/// The names of the threads on which an operation ran, in order.
#[derive(Clone, Default)]
struct Ran(Arc<Mutex<Vec<String>>>);

impl Ran {
    fn note(&self) {
        let name = thread::current().name().unwrap_or_default().to_owned();
        self.0.lock().unwrap().push(name);
    }

    fn take(&self) -> Vec<String> {
        std::mem::take(&mut self.0.lock().unwrap())
    }
}

/// Notes the thread and the size of each context.
struct Realize {
    ran: Ran,
    sizes_px: Mutex<Vec<[u32; 2]>>,
}

impl Operation<GraphicsContext> for Realize {
    fn name(&self) -> &str {
        "realize"
    }

    fn run(&self, context: &mut GraphicsContext) {
        self.ran.note();
        self.sizes_px.lock().unwrap().push(context.size_px());
    }
}

fn config(threading: ThreadingModel) -> ViewerConfig {
    ViewerConfig {
        size_px: [32, 16],
        threading,
        adapter: AdapterChoice::Noop,
        validation: false,
        max_contexts: 3,
        ..ViewerConfig::default()
    }
}

/// A viewer with a slave in a second context.
fn viewer(config: &ViewerConfig) -> Viewer {
    let mut viewer = Viewer::new_offscreen(config).unwrap();
    viewer.add_root(Page::from_node(Node::group(vec![])).unwrap()).unwrap();
    let beside = viewer.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
    viewer.add_slave(Slave::new(beside)).unwrap();
    viewer
}

fn main_thread() -> String {
    thread::current().name().unwrap_or_default().to_owned()
}

#[test]
fn realize_operation_runs_once_for_each_context() {
    let realize = Arc::new(Realize { ran: Ran::default(), sizes_px: Mutex::default() });
    let threading = ThreadingModel::DrawThreadPerContext;
    let config = ViewerConfig { realize_operation: Some(realize.clone()), ..config(threading) };
    let mut viewer = viewer(&config);
    assert_eq!(realize.ran.take(), [main_thread(), main_thread()]);
    // A context that shares a device is realized too.
    let first = viewer.context();
    let traits = ContextTraits { size_px: [8, 4], ..config.traits() };
    viewer.composite_mut().open_offscreen_on(first, &traits).unwrap();
    (0..3).for_each(|_| viewer.frame().unwrap());
    viewer.finish().unwrap();
    assert_eq!(*realize.sizes_px.lock().unwrap(), [[32, 16], [32, 16], [8, 4]]);
    assert_eq!(realize.ran.take(), [main_thread()], "frames do not run it");
    // A new device has nothing of what the operation has made. Both contexts of the lost one get it again.
    viewer.composite_mut().lose_device(first).unwrap();
    (0..3).for_each(|_| viewer.frame().unwrap());
    viewer.finish().unwrap();
    assert_eq!(realize.sizes_px.lock().unwrap()[3..], [[32, 16], [8, 4]]);
}

#[test]
fn realize_starts_the_threads_without_a_frame() {
    let mut viewer = viewer(&config(ThreadingModel::DrawThreadPerContext));
    assert!(!viewer.is_realized());
    viewer.realize().unwrap();
    assert!(viewer.is_realized() && viewer.frame_stamp().frame == 0 && viewer.stats().count() == 0);
    let ran = Ran::default();
    let noted = ran.clone();
    let context = viewer.context();
    viewer.composite().context_operations(context).unwrap().add_fn("note", false, move |_| noted.note());
    viewer.frame().unwrap();
    viewer.finish().unwrap();
    assert_eq!((viewer.frame_stamp().frame, ran.take()), (1, vec!["draw 0".to_owned()]));
    let empty = terrane::viewer::CompositeViewer::new(&config(ThreadingModel::SingleThreaded)).unwrap().realize();
    assert!(matches!(empty, Err(ViewerError::Setting(_))), "{empty:?}");
}

#[test]
fn update_operations_run_once_a_frame_until_they_are_removed() {
    let mut viewer = viewer(&config(ThreadingModel::SingleThreaded));
    let (kept, once) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
    let (of_kept, of_once, view) = (kept.clone(), once.clone(), viewer.view_id());
    let operations = viewer.update_operations().clone();
    operations.add_fn("fly", true, move |viewer| {
        of_kept.fetch_add(1, Ordering::Relaxed);
        viewer.view_mut(view).unwrap().camera.world_from_eye.translation.x += 1.0;
    });
    let from_thread = operations.clone();
    thread::spawn(move || from_thread.add_fn("once", false, move |_| _ = of_once.fetch_add(1, Ordering::Relaxed)))
        .join()
        .unwrap();
    (0..3).for_each(|_| viewer.frame().unwrap());
    assert_eq!((kept.load(Ordering::Relaxed), once.load(Ordering::Relaxed)), (3, 1));
    assert!(viewer.check_need_to_do_frame(), "an operation that is kept needs frames");
    operations.remove("fly");
    (0..3).for_each(|_| viewer.frame().unwrap());
    assert_eq!(kept.load(Ordering::Relaxed), 3);
    assert_eq!(viewer.view().camera.eye().x, 3.0);
    assert!(operations.is_empty());
}

/// Operations on contexts and cameras run on the threads that draw and cull, one time in each frame if they are kept.
#[test]
fn operations_run_on_the_thread_of_their_object_in_every_model() {
    const FRAMES: usize = 3;
    use ThreadingModel as M;
    for (model, draws, culls) in [
        (M::SingleThreaded, None, None),
        (M::CullDrawThreadPerContext, Some("draw 1"), Some("draw 1")),
        (M::DrawThreadPerContext, Some("draw 1"), None),
        (M::CullThreadPerCameraDrawThreadPerContext, Some("draw 1"), Some("cull 1")),
    ] {
        let mut viewer = viewer(&config(model));
        let beside = viewer.contexts().nth(1).unwrap();
        let slave = viewer.view().slaves().next().map(|(id, _)| id);
        let (drawn, drawn_once, culled) = (Ran::default(), Ran::default(), Ran::default());
        let (kept, once, camera) = (drawn.clone(), drawn_once.clone(), culled.clone());
        let of_context = viewer.composite().context_operations(beside).unwrap().clone();
        of_context.add_fn("kept", true, move |context| {
            assert_eq!(context.size_px(), [32, 16]);
            kept.note();
        });
        of_context.add_fn("once", false, move |_| once.note());
        let of_camera = viewer.composite().camera_operations(viewer.view_id(), slave).unwrap().unwrap().clone();
        of_camera.add_fn("kept", true, move |_| camera.note());
        (0..FRAMES).for_each(|_| viewer.frame().unwrap());
        // Camera operations have run when their frame ends.
        let thread_of = |name: Option<&str>| name.map_or_else(main_thread, str::to_owned);
        assert_eq!(culled.take(), vec![thread_of(culls); FRAMES], "{model}");
        viewer.finish().unwrap();
        assert_eq!(drawn.take(), vec![thread_of(draws); FRAMES], "{model}");
        assert_eq!(drawn_once.take(), [thread_of(draws)], "{model}");
        // They stay with their object when the threads change.
        viewer.composite_mut().set_threading_model(M::SingleThreaded).unwrap();
        viewer.frame().unwrap();
        viewer.finish().unwrap();
        assert_eq!((drawn.take(), culled.take()), (vec![main_thread()], vec![main_thread()]), "{model}");
        of_context.remove("kept");
        viewer.frame().unwrap();
        viewer.finish().unwrap();
        assert_eq!(drawn.take(), Vec::<String>::new(), "{model}");
        // An image between two frames is no frame.
        of_context.add_fn("once", false, |_| panic!("ran outside of a frame"));
        viewer.picture().unwrap();
        of_context.remove_all();
    }
}

#[test]
fn compile_operations_run_on_the_compile_thread_if_there_is_one() {
    for compile_contexts in [false, true] {
        let config = ViewerConfig { compile_contexts, ..config(ThreadingModel::DrawThreadPerContext) };
        let mut viewer = viewer(&config);
        let (kept, once) = (Ran::default(), Ran::default());
        let (of_kept, of_once) = (kept.clone(), once.clone());
        let context = viewer.context();
        let operations = viewer.composite().compile_operations(context).unwrap().clone();
        operations.add_fn("kept", true, move |_| of_kept.note());
        operations.add_fn("once", false, move |device| {
            let size = wgpu::BufferDescriptor {
                label: Some("of an operation"),
                size: 64,
                usage: wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            };
            assert_eq!(device.create_buffer(&size).size(), 64);
            of_once.note();
        });
        let patience = Instant::now() + Duration::from_secs(20);
        let mut runs = Vec::new();
        while runs.len() < 3 && Instant::now() < patience {
            viewer.frame().unwrap();
            viewer.finish().unwrap();
            runs.extend(kept.take());
        }
        let thread = if compile_contexts { "compile" } else { "draw 0" };
        assert!(runs.len() >= 3 && runs.iter().all(|ran| ran == thread), "{compile_contexts}: {runs:?}");
        assert_eq!(once.take(), [thread]);
        operations.remove("kept");
        assert!(operations.is_empty());
    }
}

#[test]
fn contexts_are_ordered_by_screen_and_position() {
    let mut viewer = Viewer::new_offscreen(&config(ThreadingModel::SingleThreaded)).unwrap();
    let first = viewer.context();
    let mut open = |screen: u32, position_px: [i32; 2], shares_device: bool| {
        let traits =
            ContextTraits { screen, position_px, size_px: [4, 4], ..config(ThreadingModel::default()).traits() };
        match shares_device {
            true => viewer.composite_mut().open_offscreen_on(first, &traits).unwrap(),
            false => viewer.open_context(GraphicsContext::new_offscreen(&traits).unwrap()).unwrap(),
        }
    };
    let second_screen = open(1, [-5, 0], true);
    let right = open(0, [100, -7], false);
    assert!(viewer.contexts().eq([first, right, second_screen]));
    viewer.composite_mut().close_context(second_screen).unwrap();
    let traits = ContextTraits { position_px: [-100, 0], ..config(ThreadingModel::default()).traits() };
    let left = viewer.composite_mut().open_offscreen_on(first, &traits).unwrap();
    assert!(viewer.contexts().eq([left, first, right]));
}
