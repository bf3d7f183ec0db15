//! The times at which ProxyNodes are loaded: visible to a camera, immediately, or on request. Real files; no GPU.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use kit::pager::Run;
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::gpu::AdapterChoice;
use terrane::math::BoundingSphere;
use terrane::pager::PagerConfig;
use terrane::scene::{Node, NodeId, NodeKind, Page, PageId, ProxyLoading, ProxyNode, Scene, SceneError, SlotState};
use terrane::viewer::{Viewer, ViewerConfig};

/// Returns a triangle, and one proxy for it of each kind behind the camera. The file of another proxy does not exist.
fn nodes(folder: &Path) -> Vec<Node> {
    let mesh = GlbMesh {
        positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    };
    std::fs::write(folder.join("mesh.glb"), write_glb(&mesh)).unwrap();
    let place = DVec3::new(0.0, 0.0, 100.0);
    let proxy = |loading, name: &str| {
        Node::new(NodeKind::ProxyNode(Box::new(ProxyNode {
            uri: Arc::from(folder.join(name).display().to_string()),
            bounds: BoundingSphere::new(place, 5.0),
            content_transform: DAffine3::from_translation(place),
            loading,
        })))
    };
    vec![
        proxy(ProxyLoading::Immediately, "mesh.glb"),
        proxy(ProxyLoading::Never, "mesh.glb"),
        proxy(ProxyLoading::DeferToPager, "mesh.glb"),
        proxy(ProxyLoading::Immediately, "missing.glb"),
    ]
}

/// Opens the same scene in a viewer.
fn proxies(folder: &Path, blocking: bool, max_tiles: usize) -> (Viewer, PageId) {
    let config = ViewerConfig {
        size_px: [64, 64],
        adapter: AdapterChoice::Noop,
        validation: false,
        pager: PagerConfig { blocking, expiry_time: Duration::ZERO, max_tiles, ..PagerConfig::default() },
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer.page_files_in(folder).unwrap();
    let root = viewer.add_root(Page::from_node(Node::group(nodes(folder))).unwrap()).unwrap();
    // The camera looks down, away from the proxies.
    viewer.view_mut().camera.world_from_eye = DAffine3::IDENTITY;
    (viewer, root)
}

fn settle(viewer: &mut Viewer) {
    let end = Instant::now() + kit::MAX_WAIT;
    viewer.frame().unwrap();
    while !viewer.is_settled() {
        assert!(Instant::now() < end, "{:?}", viewer.pager().unwrap().stats());
        viewer.frame().unwrap();
    }
}

fn states(viewer: &Viewer, root: PageId) -> Vec<&'static str> {
    states_in(viewer.scene(), root)
}

fn states_in(scene: &Scene, root: PageId) -> Vec<&'static str> {
    let of = |node: NodeId| match scene.slot(node).unwrap().state {
        SlotState::Empty => "empty",
        SlotState::Failed => "failed",
        SlotState::Resident(_) => "there",
    };
    scene.slots_of_page(root).map(of).collect()
}

/// Immediate proxies need no camera, and deferred ones load on request.
#[test]
fn proxies_are_loaded_at_the_time_of_their_kind() {
    for blocking in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let (mut viewer, root) = proxies(folder.path(), blocking, 2);
        settle(&mut viewer);
        assert_eq!(states(&viewer, root), ["there", "empty", "empty", "failed"], "blocking {blocking}");
        let stats = *viewer.pager().unwrap().stats();
        assert_eq!((stats.requested, stats.failed), (2, 1), "the missing one is not requested repeatedly");
        // The budget is exhausted, and the proxy is not visible.
        (0..20).for_each(|_| viewer.frame().unwrap());
        assert_eq!(states(&viewer, root)[0], "there");
        let never = viewer.scene().slots_of_page(root).nth(1).unwrap();
        viewer.scene_mut().load_proxy(never).unwrap();
        settle(&mut viewer);
        assert_eq!(viewer.pager().unwrap().stats().loaded, 2);
        (0..20).for_each(|_| viewer.frame().unwrap());
        assert_eq!(states(&viewer, root), ["there", "empty", "empty", "failed"], "it expires like others");
    }
}

#[test]
fn proxy_without_bounds_has_those_of_its_content() {
    let folder = tempfile::tempdir().unwrap();
    let mut node = nodes(folder.path()).swap_remove(2);
    let NodeKind::ProxyNode(proxy) = &mut node.kind else { panic!("a proxy") };
    proxy.bounds = BoundingSphere::EVERYTHING;
    let page = Page::from_node(Node::group(vec![node])).unwrap();
    let mut run = Run::of_page(page, folder.path().to_str().unwrap(), PagerConfig::default());
    // The camera looks down, and the content is above it.
    run.settle(DVec3::ZERO);
    assert_eq!(states_in(&run.scene, run.scene.roots()[0]), ["there"]);
    assert_eq!(run.stage.leaf_count(), 0);
    run.frame(DVec3::new(0.0, 0.0, 110.0));
    assert_eq!(run.stage.leaf_count(), 1);
    run.frame(DVec3::new(0.0, 500.0, 110.0));
    assert_eq!(run.stage.leaf_count(), 0);
    assert_eq!(run.pager.stats().expired, 0, "it is in use");
}

/// Regression: they were not requested again, because no camera sees them.
#[test]
fn immediate_proxy_is_loaded_again_after_expiry() {
    let folder = tempfile::tempdir().unwrap();
    let page = Page::from_node(Node::group(nodes(folder.path()))).unwrap();
    let mut run = Run::of_page(page, folder.path().to_str().unwrap(), PagerConfig::default());
    let (root, away) = (run.scene.roots()[0], DVec3::ZERO);
    run.settle(away);
    let never = run.scene.slots_of_page(root).nth(1).unwrap();
    run.scene.load_proxy(never).unwrap();
    run.settle(away);
    assert_eq!(states_in(&run.scene, root), ["there", "there", "empty", "failed"]);
    // The scene is like one in a new context, which has nothing uploaded.
    run.pager.page_anew(&mut run.scene, &mut [&mut run.context]);
    assert_eq!(states_in(&run.scene, root), ["empty", "empty", "empty", "failed"]);
    run.settle(away);
    assert_eq!(states_in(&run.scene, root), ["there", "there", "empty", "failed"]);
    // The state is that before the first frame.
    run.pager.clear(&mut run.scene, &mut [&mut run.context]);
    assert_eq!(states_in(&run.scene, root), ["empty", "empty", "empty", "empty"]);
    run.settle(away);
    assert_eq!(states_in(&run.scene, root), ["there", "empty", "empty", "failed"]);
    assert_eq!(run.pager.stats().failed, 2, "the missing one is requested once more");
}

/// An explicit request to load is honoured. Regression: it had no effect.
#[test]
fn failed_proxies_are_retried_for_the_application() {
    let folder = tempfile::tempdir().unwrap();
    let (mut viewer, root) = proxies(folder.path(), false, 30);
    settle(&mut viewer);
    let missing = viewer.scene().slots_of_page(root).nth(3).unwrap();
    viewer.scene_mut().load_proxy(missing).unwrap();
    settle(&mut viewer);
    assert_eq!(states(&viewer, root)[3], "failed");
    assert_eq!(viewer.pager().unwrap().stats().failed, 2);
    std::fs::copy(folder.path().join("mesh.glb"), folder.path().join("missing.glb")).unwrap();
    viewer.scene_mut().load_proxy(missing).unwrap();
    settle(&mut viewer);
    assert_eq!(states(&viewer, root), ["there", "empty", "empty", "there"]);
}

#[test]
fn requests_of_the_application_are_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let (mut viewer, root) = proxies(folder.path(), false, 30);
    settle(&mut viewer);
    let [_, never, defer, _] = viewer.scene().slots_of_page(root).collect::<Vec<_>>().try_into().unwrap();
    viewer.scene_mut().load_proxy(never).unwrap();
    settle(&mut viewer);
    assert_eq!(states(&viewer, root), ["there", "there", "empty", "failed"], "{:?}", viewer.pager().unwrap().stats());
    let refused = viewer.scene_mut().load_proxy(never);
    assert!(matches!(refused, Err(SceneError::SlotTaken { .. })), "{refused:?}");
    let group = NodeId { page: root, index: 0 };
    assert!(matches!(viewer.scene_mut().load_proxy(group), Err(SceneError::NotASlot { .. })));
    viewer.scene_mut().load_proxy(defer).unwrap();
    settle(&mut viewer);
    assert_eq!(states(&viewer, root), ["there", "there", "there", "failed"]);
}
