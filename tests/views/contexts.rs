//! Slave cameras, several contexts and several views: the parts together equal the whole in every threading model.
//! Needs a GPU; a software adapter suffices.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::{DAffine3, DMat4, DVec3};
use image::RgbaImage;
use kit::shapes::ball;
use kit::skip::or_skip;
use kit::tile_sets::small_set;
use kit::viewer::Settle;

use terrane::gpu::{ContextTraits, GraphicsContext};
use terrane::pager::PagerConfig;
use terrane::scene::{Inherit, Mesh, Node, NodeId, Page, ShareModes, Sky};
use terrane::state::{Attribute, DataVariance, Program, StateSet};
use terrane::viewer::{
    CompositeViewer, ContextId, KEY_COLOR, Slave, ThreadingModel, ViewArea, Viewer, ViewerConfig, ViewerError, coverage,
};

fn config(threading: ThreadingModel, size_px: [u32; 2], blocking: bool) -> ViewerConfig {
    ViewerConfig {
        size_px,
        threading,
        adapter: kit::adapter(),
        max_sse_px: 6.0,
        pager: PagerConfig { blocking, ..PagerConfig::default() },
        max_contexts: 4,
        ..ViewerConfig::default()
    }
}

fn context(size_px: [u32; 2]) -> Option<GraphicsContext> {
    let traits = ContextTraits { size_px, ..config(ThreadingModel::SingleThreaded, size_px, false).traits() };
    or_skip(GraphicsContext::new_offscreen(&traits))
}

fn page(color: [f32; 4]) -> Page {
    let balls = vec![ball(DVec3::ZERO, 1.0, color), ball(DVec3::new(1.6, 0.5, 0.9), 0.6, [0.2, 0.2, 1.0, 1.0])];
    Page::from_node(Node::group(balls)).unwrap()
}

/// Returns the number of pixels that differ by more than rounding.
fn differing(a: &RgbaImage, b: &RgbaImage) -> usize {
    assert_eq!(a.dimensions(), b.dimensions());
    let far = |a: &image::Rgba<u8>, b: &image::Rgba<u8>| a.0.iter().zip(b.0).any(|(a, b)| a.abs_diff(b) > 2);
    a.pixels().zip(b.pixels()).filter(|(a, b)| far(a, b)).count()
}

/// Returns the projection that shows `[from, to]` of the master's image (-1 to 1, left to right) in a whole image.
fn part(from: f64, to: f64) -> DMat4 {
    let scale = 2.0 / (to - from);
    DMat4::from_translation(DVec3::new(-scale * 0.5 * (from + to), 0.0, 0.0))
        * DMat4::from_scale(DVec3::new(scale, 1.0, 1.0))
}

#[test]
fn halves_of_a_context_equal_the_whole() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let size = [240, 90];
    for sky in [Sky::Atmosphere, Sky::Background([40, 90, 10])] {
        let mut expected: Option<RgbaImage> = None;
        for threading in ThreadingModel::ALL {
            let Some(context) = context(size) else { return };
            let mut viewer = Viewer::new(context, &config(threading, size, true)).unwrap();
            viewer.load(&set).unwrap();
            viewer.view_mut().environment.sky = sky;
            viewer.frame().unwrap();
            let whole = viewer.read_back().unwrap();
            // The master keeps the left half of its part. The right half is drawn by a slave in the same context.
            let context = viewer.contexts().next().unwrap();
            let [left, right] = [[0, 0, 120, 90], [120, 0, 120, 90]];
            let slave = |rect, offset| Slave {
                viewport: ViewArea::Pixels(rect),
                projection_offset: offset,
                ..Slave::new(context)
            };
            viewer.add_slave(slave(left, part(-1.0, 0.0))).unwrap();
            let on_the_right = viewer.add_slave(slave(right, part(0.0, 1.0))).unwrap();
            viewer.frame().unwrap();
            viewer.frame().unwrap();
            let halves = viewer.read_back().unwrap();
            assert!(differing(&whole, &halves) < 60, "{threading}: {} pixels differ", differing(&whole, &halves));
            assert!(*expected.get_or_insert(halves.clone()) == halves, "{threading} draws otherwise");
            // A slave can be moved and removed.
            viewer.view_mut().slave_mut(on_the_right).unwrap().projection_offset = part(-1.0, 0.0);
            viewer.frame().unwrap();
            assert!(differing(&halves, &viewer.read_back().unwrap()) > 1000);
            assert!(viewer.remove_slave(on_the_right).unwrap() && !viewer.remove_slave(on_the_right).unwrap());
            viewer.frame().unwrap();
        }
    }
}

#[test]
fn wall_of_three_contexts_is_one_wide_image() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let (size, wide) = ([96, 72], [288, 72]);
    let Some(of_wide) = context(wide) else { return };
    let mut one = Viewer::new(of_wide, &config(ThreadingModel::SingleThreaded, wide, true)).unwrap();
    one.load(&set).unwrap();
    let pose = one.view().camera.world_from_eye;
    // The middle third has a third of the wide image's width, in tangents.
    let fovy = one.view().camera.fovy(wide);
    one.frame().unwrap();
    let expected = one.read_back().unwrap();
    let mut first: Option<Vec<RgbaImage>> = None;
    for threading in ThreadingModel::ALL {
        let mut viewer = Viewer::new(context(size).unwrap(), &config(threading, size, true)).unwrap();
        viewer.load(&set).unwrap();
        viewer.view_mut().camera.world_from_eye = pose;
        viewer.view_mut().camera.field_of_view = terrane::viewer::FieldOfView::Vertical(fovy);
        let shift = |x: f64| DMat4::from_translation(DVec3::new(x, 0.0, 0.0));
        let mut contexts: Vec<ContextId> = viewer.contexts().collect();
        for x in [2.0, -2.0] {
            let context = viewer.open_context(context(size).unwrap()).unwrap();
            viewer.add_slave(Slave { projection_offset: shift(x), ..Slave::new(context) }).unwrap();
            contexts.push(context);
        }
        let too_many = (0..2).map(|_| viewer.open_context(context(size).unwrap())).last().unwrap();
        assert!(matches!(too_many, Err(ViewerError::TooManyContexts { limit: 4 })));
        viewer.settle(3);
        let pictures: Vec<_> = contexts.iter().map(|c| viewer.composite_mut().read_back(*c).unwrap()).collect();
        let [middle, left, right] = &pictures[..] else { panic!() };
        let mut wall = RgbaImage::new(wide[0], wide[1]);
        for (x, picture) in [left, middle, right].into_iter().enumerate() {
            image::imageops::replace(&mut wall, picture, x as i64 * 96, 0);
        }
        assert!(differing(&wall, &expected) < 60, "{threading}: {} pixels differ", differing(&wall, &expected));
        assert!(*first.get_or_insert_with(|| pictures.clone()) == pictures, "{threading} draws otherwise");
        // The window in the middle is closed, and the others continue.
        assert!(
            viewer.composite_mut().close_context(contexts[0]).unwrap()
                && !viewer.composite_mut().close_context(contexts[0]).unwrap()
        );
        assert!(matches!(viewer.read_back(), Err(ViewerError::NoContext(_))));
        viewer.frame().unwrap();
        viewer.frame().unwrap();
        assert!(
            viewer.composite_mut().read_back(contexts[1]).unwrap() == pictures[1],
            "{threading}: the wall has changed"
        );
    }
}

#[test]
fn context_added_later_shows_everything() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let size = [120, 90];
    for threading in ThreadingModel::ALL {
        let Some(of_first) = context(size) else { return };
        let mut viewer = Viewer::new(of_first, &config(threading, size, false)).unwrap();
        viewer.load(&set).unwrap();
        let bounds = *viewer.bounds().unwrap();
        let (at, radius) = (bounds.sphere.center, 0.2 * bounds.sphere.radius_m);
        viewer.add_root(Page::from_node(ball(at, radius, [1.0, 0.0, 0.0, 1.0])).unwrap()).unwrap();
        let settle = |viewer: &mut Viewer| {
            viewer.settle(1);
            // The last upload is drawn.
            (0..4).for_each(|_| viewer.frame().unwrap());
        };
        settle(&mut viewer);
        let before = viewer.read_back().unwrap();
        let later = viewer.open_context(context(size).unwrap()).unwrap();
        viewer.add_slave(Slave::new(later)).unwrap();
        viewer.frame().unwrap();
        settle(&mut viewer);
        assert!(viewer.read_back().unwrap() == before, "{threading}: the first context shows something else");
        assert!(
            viewer.composite_mut().read_back(later).unwrap() == before,
            "{threading}: the second context shows something else"
        );
        let first = viewer.context();
        viewer.composite_mut().close_context(first).unwrap();
        settle(&mut viewer);
        assert!(viewer.composite_mut().read_back(later).unwrap() == before);
    }
}

#[test]
fn memory_of_a_closed_context_is_not_counted() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let size = [120, 90];
    // Some tiles share contents, others do not.
    for sharing in [ShareModes::STATIC, ShareModes::NONE] {
        let Some(of_first) = context(size) else { return };
        let mut config = config(ThreadingModel::DrawThreadPerContext, size, false);
        config.pager.sharing = sharing;
        let mut viewer = Viewer::new(of_first, &config).unwrap();
        viewer.load(&set).unwrap();
        let settle = |viewer: &mut Viewer| {
            viewer.settle(1);
            *viewer.pager().unwrap().stats()
        };
        let one = settle(&mut viewer);
        let later = viewer.open_context(context(size).unwrap()).unwrap();
        viewer.add_slave(Slave::new(later)).unwrap();
        let both = settle(&mut viewer);
        assert!(one.gpu_bytes > 0 && one.resident == both.resident, "{one:?} {both:?}");
        assert_eq!(both.gpu_bytes, 2 * one.gpu_bytes);
        let first = viewer.context();
        viewer.composite_mut().close_context(first).unwrap();
        // The context is closed at once, and after some frames.
        assert_eq!(viewer.pager().unwrap().stats().gpu_bytes, one.gpu_bytes);
        let left = settle(&mut viewer);
        assert_eq!((left.gpu_bytes, left.resident, left.expired), (one.gpu_bytes, one.resident, both.expired));
        assert_eq!(left.shared_gpu_bytes_saved, one.shared_gpu_bytes_saved);
        // Nothing is left when the pages are removed.
        viewer.clear_pages();
        let none = *viewer.pager().unwrap().stats();
        assert_eq!((none.gpu_bytes, none.shared_gpu_bytes_saved), (0, 0));
    }
}

#[test]
fn slaves_have_separate_settings() {
    let size = [120, 90];
    let Some(of_first) = context(size) else { return };
    let mut viewer = Viewer::new(of_first, &config(ThreadingModel::DrawThreadPerContext, size, false)).unwrap();
    let masked = Node { mask: 1, ..ball(DVec3::ZERO, 1.0, [1.0, 0.0, 0.0, 1.0]) };
    viewer.add_root(Page::from_node(masked).unwrap()).unwrap();
    viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
    viewer.view_mut().environment.fog.enabled = false;
    let (a, b) = (context(size).unwrap(), context(size).unwrap());
    let (a, b) = (viewer.open_context(a).unwrap(), viewer.open_context(b).unwrap());
    let mut blind = Slave::new(a);
    blind.settings.cull_mask = 2;
    let of_master = viewer.add_slave(blind).unwrap();
    viewer.add_slave(Slave { context: b, inherit: Inherit::NONE, ..blind }).unwrap();
    viewer.settle(4);
    let master = viewer.read_back().unwrap();
    assert!(viewer.composite_mut().read_back(a).unwrap() == master, "settings inherited are the master's");
    assert_eq!(
        coverage(&viewer.composite_mut().read_back(b).unwrap(), KEY_COLOR),
        0.0,
        "a separate mask hides everything"
    );
    // The slave has another eye, 10 km beside the master.
    viewer.view_mut().slave_mut(of_master).unwrap().view_offset =
        DAffine3::from_translation(DVec3::new(10_000.0, 0.0, 0.0));
    viewer.frame().unwrap();
    assert_eq!(coverage(&viewer.composite_mut().read_back(a).unwrap(), KEY_COLOR), 0.0);
    viewer.view_mut().slave_mut(of_master).unwrap().view_offset = DAffine3::from_translation(DVec3::splat(f64::NAN));
    viewer.frame().unwrap();
    assert!(viewer.composite_mut().read_back(a).unwrap() == master, "an invalid offset is ignored");
}

#[test]
fn views_have_separate_scenes_or_share_one() {
    let size = [200, 80];
    let mut first: Option<(RgbaImage, RgbaImage)> = None;
    for threading in ThreadingModel::ALL {
        let Some(of_first) = context(size) else { return };
        let mut viewer = CompositeViewer::new(&config(threading, size, false)).unwrap();
        let main = viewer.open_context(of_first).unwrap();
        let other = viewer.open_context(context(size).unwrap()).unwrap();
        let (red, green) = (viewer.add_scene().unwrap(), viewer.add_scene().unwrap());
        let root = viewer.add_root(red, page([1.0, 0.0, 0.0, 1.0])).unwrap();
        let left = viewer.add_view(red, main, Some([0, 0, 100, 80])).unwrap();
        let right = viewer.add_view(green, main, Some([100, 0, 100, 80])).unwrap();
        let shared = viewer.add_view(red, other, None).unwrap();
        viewer.add_root(green, page([0.0, 1.0, 0.0, 1.0])).unwrap();
        for (view, sky) in [(left, [255, 255, 0]), (right, [0, 255, 255]), (shared, KEY_COLOR)] {
            let view = viewer.view_mut(view).unwrap();
            view.environment.sky = Sky::Background(sky);
            view.environment.fog.enabled = false;
            view.camera.look_at(DVec3::new(0.0, -6.0, 0.0), DVec3::ZERO, DVec3::Z);
        }
        viewer.settle(5);
        viewer.finish().unwrap();
        let (both, alone) = (viewer.read_back(main).unwrap(), viewer.read_back(other).unwrap());
        assert_eq!(both.get_pixel(50, 40).0, [255, 0, 0, 255]);
        assert_eq!(both.get_pixel(150, 40).0, [0, 255, 0, 255]);
        assert_eq!(both.get_pixel(2, 2).0, [255, 255, 0, 255]);
        assert_eq!(both.get_pixel(197, 77).0, [0, 255, 255, 255]);
        assert_eq!(alone.get_pixel(100, 40).0, [255, 0, 0, 255]);
        assert_eq!(alone.get_pixel(0, 0).0, [255, 0, 255, 255]);
        let pictures = (both.clone(), alone);
        assert!(*first.get_or_insert_with(|| pictures.clone()) == pictures, "{threading} draws otherwise");

        // A change of a scene is visible in all its views and in no others.
        let far = DAffine3::from_translation(DVec3::new(0.0, 0.0, 1e6));
        for index in [1, 3] {
            viewer.scene_mut(red).unwrap().set_transform(NodeId { page: root, index }, far).unwrap();
        }
        viewer.frame().unwrap();
        let (moved, moved_alone) = (viewer.read_back(main).unwrap(), viewer.read_back(other).unwrap());
        assert_eq!(moved.get_pixel(50, 40).0, [255, 255, 0, 255]);
        assert_eq!(moved.get_pixel(150, 40).0, [0, 255, 0, 255]);
        assert_eq!(coverage(&moved_alone, KEY_COLOR), 0.0);
        let mesh = Arc::new(Mesh::sphere(DVec3::new(0.0, 0.0, -1e6), 1.0, 24));
        let geode = NodeId { page: root, index: 2 };
        viewer.scene_mut(red).unwrap().set_mesh(geode, 0, mesh, DataVariance::Static).unwrap();
        viewer.frame().unwrap();
        assert_eq!(viewer.read_back(main).unwrap().get_pixel(50, 40).0, [255, 0, 0, 255]);
        assert_eq!(viewer.read_back(other).unwrap().get_pixel(100, 40).0, [255, 0, 0, 255]);

        viewer.remove_view(right).unwrap();
        assert!(matches!(viewer.view_mut(right), Err(ViewerError::NoView(_))));
        viewer.frame().unwrap();
        let without = viewer.read_back(main).unwrap();
        assert_eq!(without.get_pixel(150, 40).0, [0, 0, 0, 255], "no view draws there any more");
        viewer.close_context(main).unwrap();
        viewer.frame().unwrap();
        assert_eq!(viewer.read_back(other).unwrap().get_pixel(100, 40).0, [255, 0, 0, 255]);
    }
}

#[test]
fn lost_device_is_replaced_and_everything_is_drawn_again() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let size = [120, 90];
    for threading in ThreadingModel::ALL {
        let Some(context) = context(size) else { return };
        let mut viewer = Viewer::new(context, &config(threading, size, false)).unwrap();
        viewer.load(&set).unwrap();
        let own = Node::transform(
            viewer.view().camera.world_from_eye,
            vec![ball(DVec3::new(0.0, 0.0, -9.0), 2.0, [1.0, 0.0, 0.0, 1.0])],
        );
        viewer.add_root(Page::from_node(own).unwrap()).unwrap();
        let settle = |viewer: &mut Viewer| {
            // The frames in flight when the device is lost, and the one that reports it.
            viewer.settle(4);
            viewer.frame().unwrap();
            viewer.frame().unwrap();
            viewer.read_back().unwrap()
        };
        let before = settle(&mut viewer);
        assert_eq!(before.get_pixel(60, 45).0, [255, 0, 0, 255], "the application's own");
        let context = viewer.contexts().next().unwrap();
        viewer.composite_mut().lose_device(context).unwrap();
        let after = settle(&mut viewer);
        assert_eq!(differing(&before, &after), 0, "{threading}");
        // A second loss immediately after is an error, and no panic.
        viewer.composite_mut().lose_device(context).unwrap();
        let failed = (0..4).find_map(|_| viewer.frame().err()).or_else(|| viewer.finish().err());
        assert!(viewer.frame_stamp().frame > 60 || failed.is_some(), "{threading}");
    }
}

#[test]
fn requested_images_are_read_back_though_a_device_is_lost() {
    let size = [64, 48];
    for threading in ThreadingModel::ALL {
        let Some(of_first) = context(size) else { return };
        let mut viewer = Viewer::new(of_first, &config(threading, size, false)).unwrap();
        viewer.add_root(page([1.0, 0.0, 0.0, 1.0])).unwrap();
        viewer.settle(2);
        let came = Arc::new(AtomicU32::new(0));
        for frame in 0..20 {
            if frame == 5 {
                let context = viewer.context();
                viewer.composite_mut().lose_device(context).unwrap();
            }
            let came = came.clone();
            viewer.actions().capture(Box::new(move |_, _| {
                came.fetch_add(1, Ordering::Relaxed);
            }));
            viewer.frame().unwrap();
        }
        (0..10).for_each(|_| viewer.frame().unwrap());
        viewer.finish().unwrap();
        assert_eq!(came.load(Ordering::Relaxed), 20, "{threading}");
    }
}

/// Nothing moves, but a requested image needs frames until it is read back.
#[test]
fn requested_image_needs_a_frame() {
    let size = [64, 48];
    for threading in ThreadingModel::ALL {
        let Some(of_first) = context(size) else { return };
        let mut viewer = Viewer::new(of_first, &config(threading, size, false)).unwrap();
        viewer.add_root(page([1.0, 0.0, 0.0, 1.0])).unwrap();
        viewer.settle(8);
        let frames_needed = |viewer: &mut Viewer| {
            let mut frames = 0;
            while viewer.check_need_to_do_frame() {
                viewer.frame().unwrap();
                frames += 1;
                assert!(frames < 1000, "{threading}: never rests");
            }
            frames
        };
        frames_needed(&mut viewer);
        let came = Arc::new(AtomicU32::new(0));
        let told = came.clone();
        viewer.actions().capture(Box::new(move |_, _| {
            told.fetch_add(1, Ordering::Relaxed);
        }));
        assert!(frames_needed(&mut viewer) > 0 && came.load(Ordering::Relaxed) == 1, "{threading}");
    }
}

#[test]
fn errors_of_a_redrawn_frame_are_reported_and_frames_are_counted() {
    let size = [64, 48];
    let Some(of_first) = context(size) else { return };
    let config = ViewerConfig { history_frames: 10, ..config(ThreadingModel::SingleThreaded, size, false) };
    let mut viewer = Viewer::new(of_first, &config).unwrap();
    let plain = Arc::new(StateSet::default());
    let ball = ball(DVec3::ZERO, 1.0, [1.0; 4]).with_state_set(plain.clone());
    let root = viewer.add_root(Page::from_node(ball).unwrap()).unwrap();
    for _ in 0..25 {
        viewer.frame().unwrap();
    }
    let report = viewer.report().unwrap();
    assert_eq!((report.frames, report.errors.len()), (25, 0));
    let broken = StateSet::default().with(Attribute::Program(Program::new("broken", "fn vs_main() {")));
    assert!(viewer.scene_mut().replace_state_set(root, &plain, Arc::new(broken)));
    viewer.picture().unwrap();
    viewer.frame().unwrap();
    let errors = viewer.report().unwrap().errors;
    assert!(errors.len() == 1 && errors[0].reason.contains("broken"), "{errors:?}");
}

#[test]
fn meshes_that_were_not_kept_change_in_place() {
    let size = [64, 48];
    let Some(of_first) = context(size) else { return };
    let base = config(ThreadingModel::SingleThreaded, size, false);
    let mut viewer = Viewer::new(of_first, &ViewerConfig { keep_drawables: false, ..base }).unwrap();
    let root = viewer.add_root(page([1.0, 0.0, 0.0, 1.0])).unwrap();
    viewer.settle(2);
    let before = viewer.read_back().unwrap();
    let second = viewer.open_context(context(size).unwrap()).unwrap();
    viewer.add_slave(Slave::new(second)).unwrap();
    viewer.settle(2);
    let geode = NodeId { page: root, index: 2 };
    let away = Arc::new(Mesh::sphere(DVec3::new(0.0, 0.0, -1e6), 1.0, 24));
    viewer.scene_mut().set_mesh(geode, 0, away, DataVariance::Static).unwrap();
    viewer.frame().unwrap();
    assert!(differing(&before, &viewer.read_back().unwrap()) > 100, "the first context has the mesh");
}

#[test]
fn device_lost_between_frames_is_no_error_for_waits() {
    let size = [120, 90];
    for threading in ThreadingModel::ALL {
        let Some(of_first) = context(size) else { return };
        let mut viewer = Viewer::new(of_first, &config(threading, size, false)).unwrap();
        viewer.add_root(page([1.0, 0.0, 0.0, 1.0])).unwrap();
        let drawn = |viewer: &mut Viewer| {
            // The frames in flight, the one that reports the loss, and those that upload.
            viewer.settle(8);
            viewer.finish().unwrap();
            viewer.read_back().unwrap()
        };
        let before = drawn(&mut viewer);
        let main = viewer.context();
        let is_lost = |got: Result<RgbaImage, ViewerError>| {
            matches!(got, Err(ViewerError::Gpu(terrane::gpu::GpuError::DeviceLost { .. })))
        };
        // With nothing in flight there is no image, repeatedly, and no wait fails.
        viewer.composite_mut().lose_device(main).unwrap();
        for _ in 0..2 {
            viewer.finish().unwrap();
            assert!(is_lost(viewer.read_back()), "{threading}");
        }
        assert!(drawn(&mut viewer) == before, "{threading}");
        (0..70).for_each(|_| viewer.frame().unwrap());
        // A frame in flight is waited for; another context and another model notice the loss too.
        viewer.composite_mut().lose_device(main).unwrap();
        viewer.frame().unwrap();
        viewer.finish().unwrap();
        viewer.finish().unwrap();
        let _ = viewer.read_back();
        let other = viewer.open_context(context(size).unwrap()).unwrap();
        viewer.add_slave(Slave::new(other)).unwrap();
        viewer.composite_mut().set_threading_model(ThreadingModel::SingleThreaded).unwrap();
        assert!(
            drawn(&mut viewer) == before && viewer.composite_mut().read_back(other).unwrap() == before,
            "{threading}"
        );
        // A loss too soon after the last one is an error of each frame until enough time has passed.
        viewer.composite_mut().lose_device(main).unwrap();
        let failed = (0..3).filter(|_| viewer.frame().is_err()).count();
        assert_eq!(failed, 3, "{threading}");
        viewer.finish().unwrap();
        assert!(is_lost(viewer.read_back()), "{threading}");
        let recovered = (0..70).position(|_| viewer.frame().is_ok()).unwrap();
        assert!(recovered > 30, "{threading}: {recovered}");
        assert!(drawn(&mut viewer) == before, "{threading}");
    }
}

#[test]
fn threads_bound_to_cores_draw_the_same() {
    let mut pictures = Vec::new();
    for cpu_affinity in [false, true] {
        let size = [96, 72];
        let Some(context) = context(size) else { return };
        let threading = ThreadingModel::CullThreadPerCameraDrawThreadPerContext;
        let config = ViewerConfig { cpu_affinity, vsync: false, ..config(threading, size, true) };
        let mut viewer = Viewer::new(context, &config).unwrap();
        viewer.add_root(page([0.9, 0.3, 0.1, 1.0])).unwrap();
        viewer.settle(3);
        pictures.push(viewer.read_back().unwrap());
    }
    assert!(coverage(&pictures[0], KEY_COLOR) > 0.5 && pictures[0] == pictures[1]);
}
