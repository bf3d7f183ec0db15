//! Contexts that share a device: images equal those with separate devices, and everything is on the GPU once. Needs a
//! GPU; a software adapter suffices.

use std::sync::Arc;
use terrane::state::DataVariance;

use glam::{DMat4, DVec3};
use image::RgbaImage;

use terrane::gpu::{ContextTraits, GpuError, GraphicsContext};
use terrane::pager::PagerConfig;
use terrane::scene::{Mesh, Node, NodeId, Page, Sky};
use terrane::viewer::{CompositeViewer, ContextId, Slave, ThreadingModel, Viewer, ViewerConfig, ViewerError};

use kit::shapes::ball;
use kit::skip::or_skip;
use kit::tile_sets::small_set;
use kit::viewer::Settle;

const SIZE: [u32; 2] = [96, 72];

fn config(threading: ThreadingModel) -> ViewerConfig {
    ViewerConfig {
        size_px: SIZE,
        threading,
        adapter: kit::adapter(),
        max_sse_px: 6.0,
        pager: PagerConfig::default(),
        max_contexts: 4,
        ..ViewerConfig::default()
    }
}

fn traits(size_px: [u32; 2]) -> ContextTraits {
    ContextTraits { size_px, ..config(ThreadingModel::SingleThreaded).traits() }
}

fn context() -> Option<GraphicsContext> {
    or_skip(GraphicsContext::new_offscreen(&traits(SIZE)))
}

/// Returns the projection that shows the area beside the master's image.
fn beside(context: ContextId, x: f64) -> Slave {
    Slave { projection_offset: DMat4::from_translation(DVec3::new(x, 0.0, 0.0)), ..Slave::new(context) }
}

/// Draws frames until nothing is wanted any more, and a few after that.
fn settle(viewer: &mut Viewer) {
    viewer.settle(3);
    (0..3).for_each(|_| viewer.frame().unwrap());
    viewer.finish().unwrap();
}

fn pictures(viewer: &mut Viewer, contexts: &[ContextId]) -> Vec<RgbaImage> {
    contexts.iter().map(|context| viewer.composite_mut().read_back(*context).unwrap()).collect()
}

fn gpu_bytes(viewer: &Viewer) -> u64 {
    viewer.stats().last().unwrap().gpu_bytes
}

/// Opens a viewer on a set with a ball in front of it.
fn viewer(context: GraphicsContext, set: &str, threading: ThreadingModel) -> Viewer {
    let mut viewer = Viewer::new(context, &config(threading)).unwrap();
    viewer.load(set).unwrap();
    let sphere = viewer.bounds().unwrap().sphere;
    let own = ball(sphere.center, 0.2 * sphere.radius_m, [1.0, 0.0, 0.0, 1.0]);
    viewer.add_root(Page::from_node(own).unwrap()).unwrap();
    viewer
}

#[test]
fn wall_on_one_device_equals_one_on_three_and_is_uploaded_once() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let Some(first) = context() else { return };
    let mut own = viewer(first, &set, ThreadingModel::SingleThreaded);
    let mut contexts: Vec<ContextId> = own.contexts().collect();
    for x in [2.0, -2.0] {
        let other = own.open_context(context().unwrap()).unwrap();
        own.add_slave(beside(other, x)).unwrap();
        contexts.push(other);
    }
    settle(&mut own);
    let expected = pictures(&mut own, &contexts);
    assert!(expected[0] != expected[1] && expected[1] != expected[2]);
    for threading in ThreadingModel::ALL {
        let mut shared = viewer(context().unwrap(), &set, threading);
        let mut contexts: Vec<ContextId> = shared.contexts().collect();
        for x in [2.0, -2.0] {
            let other = shared.composite_mut().open_offscreen_on(contexts[0], &traits(SIZE)).unwrap();
            shared.add_slave(beside(other, x)).unwrap();
            contexts.push(other);
        }
        assert_eq!(shared.contexts().collect::<Vec<_>>(), contexts);
        settle(&mut shared);
        let found = pictures(&mut shared, &contexts);
        for (place, (found, expected)) in found.iter().zip(&expected).enumerate() {
            assert!(found == expected, "{threading}: context {place} shows something else");
        }
        assert_eq!(3 * gpu_bytes(&shared), gpu_bytes(&own), "{threading}");
        let drawn = |viewer: &Viewer| viewer.stats().last().unwrap().triangles;
        assert_eq!(drawn(&shared), drawn(&own), "{threading}");
        // Images in flight belong to the context that requested them.
        contexts.iter().for_each(|context| shared.composite_mut().want_picture(*context));
        shared.frame().unwrap();
        shared.finish().unwrap();
        for (context, expected) in contexts.iter().zip(&expected) {
            let taken = shared.composite_mut().take_pictures(*context);
            assert!(taken.len() == 1 && taken[0].1 == *expected, "{threading}: {context:?}");
        }
        // Each context is closed in turn, starting with the first. The others continue, and nothing is loaded again.
        let merged = shared.pager().unwrap().stats().merged;
        assert!(
            shared.composite_mut().close_context(contexts[0]).unwrap()
                && !shared.composite_mut().close_context(contexts[0]).unwrap()
        );
        assert!(matches!(shared.read_back(), Err(ViewerError::NoContext(_))));
        (0..2).for_each(|_| shared.frame().unwrap());
        assert!(pictures(&mut shared, &contexts[1..]) == expected[1..], "{threading}");
        assert!(shared.composite_mut().close_context(contexts[2]).unwrap());
        (0..2).for_each(|_| shared.frame().unwrap());
        assert!(pictures(&mut shared, &contexts[1..2]) == expected[1..2], "{threading}");
        assert_eq!(shared.pager().unwrap().stats().merged, merged, "{threading}");
        assert!(shared.composite_mut().close_context(contexts[1]).unwrap());
        shared.frame().unwrap();
        let gone = shared.composite_mut().open_offscreen_on(contexts[1], &traits(SIZE));
        assert!(matches!(gone, Err(ViewerError::NoContext(_))), "{threading}");
    }
}

#[test]
fn context_added_to_the_device_shows_everything_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    for threading in ThreadingModel::ALL {
        let Some(first) = context() else { return };
        let mut viewer = viewer(first, &set, threading);
        settle(&mut viewer);
        let before = viewer.read_back().unwrap();
        let (requested, bytes) = (viewer.pager().unwrap().stats().requested, gpu_bytes(&viewer));
        let contexts: Vec<_> = viewer.contexts().collect();
        let later = viewer.composite_mut().open_offscreen_on(contexts[0], &traits(SIZE)).unwrap();
        viewer.add_slave(Slave::new(later)).unwrap();
        viewer.frame().unwrap();
        assert!(
            viewer.composite_mut().read_back(later).unwrap() == before,
            "{threading}: its first frame lacks something"
        );
        assert!(viewer.read_back().unwrap() == before, "{threading}");
        assert_eq!((viewer.pager().unwrap().stats().requested, gpu_bytes(&viewer)), (requested, bytes));
        // Sizes belong to each context. An image that is too large is an error of its context.
        viewer.resize_context(later, [48, 100]).unwrap();
        viewer.frame().unwrap();
        assert_eq!(viewer.composite_mut().read_back(later).unwrap().dimensions(), (48, 100));
        assert!(viewer.read_back().unwrap() == before, "{threading}");
        let huge = viewer.composite_mut().open_offscreen_on(later, &traits([1 << 20, 8]));
        assert!(matches!(huge, Err(ViewerError::Gpu(GpuError::TargetSize { .. }))), "{threading}");
        viewer.frame().unwrap();
        assert!(viewer.read_back().unwrap() == before, "{threading}");
    }
}

#[test]
fn lost_device_is_reopened_with_all_its_contexts() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    for threading in ThreadingModel::ALL {
        let Some(first) = context() else { return };
        let mut viewer = viewer(first, &set, threading);
        let mut contexts: Vec<_> = viewer.contexts().collect();
        contexts.push(viewer.composite_mut().open_offscreen_on(contexts[0], &traits(SIZE)).unwrap());
        contexts.push(viewer.open_context(context().unwrap()).unwrap());
        viewer.add_slave(beside(contexts[1], 2.0)).unwrap();
        viewer.add_slave(beside(contexts[2], -2.0)).unwrap();
        settle(&mut viewer);
        let before = pictures(&mut viewer, &contexts);
        viewer.composite_mut().lose_device(contexts[1]).unwrap();
        // The frames in flight when the device is lost, and the one that reports it.
        (0..4).for_each(|_| viewer.frame().unwrap());
        settle(&mut viewer);
        let after = pictures(&mut viewer, &contexts);
        for (place, (after, before)) in after.iter().zip(&before).enumerate() {
            assert!(after == before, "{threading}: context {place} has changed");
        }
    }
}

#[test]
fn views_of_a_composite_viewer_share_a_device() {
    for threading in ThreadingModel::ALL {
        let Some(first) = context() else { return };
        let mut viewer = CompositeViewer::new(&config(threading)).unwrap();
        let main = viewer.open_context(first).unwrap();
        let other = viewer.open_offscreen_on(main, &traits([60, 50])).unwrap();
        let (red, green) = (viewer.add_scene().unwrap(), viewer.add_scene().unwrap());
        let page = |color| Page::from_node(Node::group(vec![ball(DVec3::ZERO, 1.0, color)])).unwrap();
        let root = viewer.add_root(red, page([1.0, 0.0, 0.0, 1.0])).unwrap();
        viewer.add_root(green, page([0.0, 1.0, 0.0, 1.0])).unwrap();
        let views =
            [(red, main), (green, other)].map(|(scene, context)| viewer.add_view(scene, context, None).unwrap());
        for (view, sky) in views.into_iter().zip([[255, 255, 0], [0, 255, 255]]) {
            let view = viewer.view_mut(view).unwrap();
            view.environment.sky = Sky::Background(sky);
            view.environment.fog.enabled = false;
            view.camera.look_at(DVec3::new(0.0, -6.0, 0.0), DVec3::ZERO, DVec3::Z);
        }
        viewer.settle(5);
        let both = [viewer.read_back(main).unwrap(), viewer.read_back(other).unwrap()];
        assert_eq!(both[0].dimensions(), (SIZE[0], SIZE[1]));
        assert_eq!((both[0].get_pixel(48, 36).0, both[0].get_pixel(1, 1).0), ([255, 0, 0, 255], [255, 255, 0, 255]));
        assert_eq!((both[1].get_pixel(30, 25).0, both[1].get_pixel(1, 1).0), ([0, 255, 0, 255], [0, 255, 255, 255]));
        // In each context, draw reads shared data before the next update.
        for step in 0..6 {
            let mesh = Arc::new(Mesh::sphere(DVec3::new(0.0, 0.0, f64::from(step % 2) * 1e6), 1.0, 24));
            let geode = NodeId { page: root, index: 2 };
            viewer.scene_mut(red).unwrap().set_mesh(geode, 0, mesh, DataVariance::Dynamic).unwrap();
            viewer.frame().unwrap();
            let shows = viewer.read_back(main).unwrap().get_pixel(48, 36).0;
            assert_eq!(shows, if step % 2 == 0 { [255, 0, 0, 255] } else { [255, 255, 0, 255] }, "{threading}: {step}");
            assert!(viewer.read_back(other).unwrap() == both[1], "{threading}: {step}");
        }
        viewer.close_context(main).unwrap();
        viewer.frame().unwrap();
        assert!(viewer.read_back(other).unwrap() == both[1], "{threading}");
    }
}

#[test]
fn contexts_open_and_close_in_any_order_with_any_model() {
    let Some(first) = context() else { return };
    let mut viewer = Viewer::new(first, &config(ThreadingModel::SingleThreaded)).unwrap();
    viewer.add_root(Page::from_node(ball(DVec3::ZERO, 1.0, [1.0, 0.0, 0.0, 1.0])).unwrap()).unwrap();
    viewer.settle(3);
    let expected = viewer.read_back().unwrap();
    let first = viewer.contexts().next().unwrap();
    let mut state = 0x2545_f491_4f6c_dd1d_u64;
    let mut below = |n: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % n as u64) as usize
    };
    for step in 0..120 {
        let open: Vec<_> = viewer.contexts().collect();
        match below(5) {
            0 if open.len() < 4 => {
                let on = open[below(open.len())];
                let context = viewer.composite_mut().open_offscreen_on(on, &traits(SIZE)).unwrap();
                viewer.add_slave(Slave::new(context)).unwrap();
            }
            1 if open.len() < 4 && step % 3 == 0 => {
                let context = viewer.open_context(context().unwrap()).unwrap();
                viewer.add_slave(Slave::new(context)).unwrap();
            }
            2 => {
                let context = open[below(open.len())];
                if context != first {
                    assert!(viewer.composite_mut().close_context(context).unwrap());
                }
            }
            _ => viewer.composite_mut().set_threading_model(ThreadingModel::ALL[below(4)]).unwrap(),
        }
        // Also for features that a separate device lacks.
        viewer.settle(3);
        for context in viewer.contexts().collect::<Vec<_>>() {
            assert!(
                viewer.composite_mut().read_back(context).unwrap() == expected,
                "step {step}: {context:?} shows something else"
            );
        }
    }
}
