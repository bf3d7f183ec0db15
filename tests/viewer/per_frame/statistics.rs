//! Statistics that are switched off, the cull time of each camera, and GPU memory that is kept for some frames. wgpu's noop
//! adapter draws.

use glam::DVec3;
use terrane::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
use terrane::scene::{CullAction, CullCallback, Drawable, Material, Mesh, Node, Page, PageId};
use terrane::viewer::{Slave, ThreadingModel, Viewer, ViewerConfig};

fn viewer(frames_to_retain: u32) -> Viewer {
    let config = ViewerConfig {
        size_px: [32, 16],
        threading: ThreadingModel::DrawThreadPerContext,
        adapter: AdapterChoice::Noop,
        validation: false,
        frames_to_retain,
        ..ViewerConfig::default()
    };
    Viewer::new_offscreen(&config).unwrap()
}

fn add_ball(viewer: &mut Viewer) -> PageId {
    let ball = Drawable::new(Mesh::sphere(DVec3::ZERO, 1.0, 16).into(), Material::default());
    viewer.add_root(Page::from_node(Node::geode(vec![ball])).unwrap()).unwrap()
}

fn drawn(viewer: &mut Viewer) -> u64 {
    viewer.frame().unwrap();
    viewer.finish().unwrap();
    viewer.stats().last().unwrap().gpu_bytes
}

#[test]
fn statistics_are_kept_unless_they_are_switched_off() {
    let mut viewer = viewer(0);
    add_ball(&mut viewer);
    (0..3).for_each(|_| viewer.frame().unwrap());
    assert_eq!(viewer.stats().count(), 3);
    viewer.composite_mut().set_stats(false);
    (0..3).for_each(|_| viewer.frame().unwrap());
    viewer.finish().unwrap();
    assert!(!viewer.stats().is_on() && viewer.stats().last().is_none() && viewer.stats().count() == 0);
    viewer.composite_mut().set_stats(true);
    viewer.frame().unwrap();
    viewer.finish().unwrap();
    assert_eq!(viewer.stats().iter().map(|stats| stats.frame).collect::<Vec<_>>(), [7]);
    assert!(viewer.stats().last().unwrap().drawn);
}

#[test]
fn each_camera_has_a_cull_time() {
    for threading in ThreadingModel::ALL {
        let mut viewer = viewer(0);
        viewer.composite_mut().set_threading_model(threading).unwrap();
        // Culled by the slave only, which takes its time.
        let mut slow = Node::group(vec![]);
        slow.cull_callback = Some(CullCallback(std::sync::Arc::new(|_| {
            std::thread::sleep(std::time::Duration::from_millis(20));
            CullAction::Traverse
        })));
        slow.mask = 2;
        viewer.add_root(Page::from_node(slow).unwrap()).unwrap();
        viewer.view_mut().camera.settings.cull_mask = 1;
        let first = viewer.context();
        let traits = ContextTraits { size_px: [8, 8], ..ContextTraits::default() };
        let beside = viewer.composite_mut().open_offscreen_on(first, &traits).unwrap();
        let slave = Slave { inherit: terrane::scene::Inherit::NONE, ..Slave::new(beside) };
        let slave = viewer.add_slave(slave).unwrap();
        viewer.frame().unwrap();
        let view = viewer.view_id();
        let of = |slave| viewer.composite().cull_ms(view, slave).unwrap();
        let (master_ms, slave_ms) = (of(None).unwrap(), of(Some(slave)).unwrap());
        assert!(slave_ms >= 20.0 && master_ms < 20.0, "{threading}: {master_ms} {slave_ms}");
        let sum_ms = viewer.stats().last().unwrap().cull_ms;
        assert!((sum_ms - master_ms - slave_ms).abs() < 1e-9, "{threading}: {sum_ms}");
        viewer.remove_slave(slave).unwrap();
        assert_eq!(viewer.composite().cull_ms(view, Some(slave)).unwrap(), None);
    }
}

#[test]
fn memory_of_removed_drawables_is_kept_for_the_frames_asked_for() {
    for frames_to_retain in [0, 3] {
        let mut viewer = viewer(frames_to_retain);
        let ball = add_ball(&mut viewer);
        (0..3).for_each(|_| viewer.frame().unwrap());
        let with_ball = drawn(&mut viewer);
        assert!(viewer.remove_root(ball).is_some());
        let kept = (0..8).filter(|_| drawn(&mut viewer) == with_ball).count();
        assert_eq!(kept, frames_to_retain as usize);
        assert!(drawn(&mut viewer) < with_ball);
    }
}

#[test]
fn removed_drawables_are_flushed_and_the_policy_can_change() {
    let mut viewer = viewer(1000);
    let (first, second) = (add_ball(&mut viewer), add_ball(&mut viewer));
    (0..3).for_each(|_| viewer.frame().unwrap());
    let with_balls = drawn(&mut viewer);
    viewer.remove_root(first).unwrap();
    assert_eq!(drawn(&mut viewer), with_balls);
    viewer.composite_mut().flush_deleted_objects();
    let with_ball = drawn(&mut viewer);
    assert!(with_ball < with_balls);
    viewer.remove_root(second).unwrap();
    assert_eq!(drawn(&mut viewer), with_ball);
    viewer.composite_mut().set_frames_to_retain(0);
    assert!(drawn(&mut viewer) < with_ball);
    let context = GraphicsContext::new_offscreen(&ContextTraits {
        adapter: AdapterChoice::Noop,
        size_px: [8, 8],
        ..ContextTraits::default()
    });
    viewer.open_context(context.unwrap()).unwrap();
    viewer.frame().unwrap();
}
