//! Bounds of changed scenes: they equal those of a scene built like that, and are updated once for all changes of a
//! frame.

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use kit::cull_scenes::{drawable, look_at, page};
use proptest::prelude::*;
use terrane::cull::{CullVisitor, RenderStage};
use terrane::math::{Aabb, BoundingSphere};
use terrane::scene::{
    AutoScale, Billboard, BillboardMode, CameraNode, Drawable, Geometry, Mesh, Node, NodeId, NodeKind, Page,
    ReferenceFrame, RenderOrder, Scene,
};
use terrane::state::DataVariance;

fn cube(middle: DVec3, half_m: f64) -> Drawable {
    drawable(Aabb { min: middle - half_m, max: middle + half_m })
}

fn place(numbers: [f64; 4]) -> DAffine3 {
    let [x, y, z, turn] = numbers;
    DAffine3::from_rotation_translation(DQuat::from_rotation_z(turn), DVec3::new(x, y, z))
}

/// Returns transforms in groups in transforms, with cubes and cameras.
fn graph() -> impl Strategy<Value = Node> {
    let leaf = (-9.0..9.0f64, 0.1..4.0f64).prop_map(|(x, half_m)| Node::geode(vec![cube(DVec3::splat(x), half_m)]));
    leaf.prop_recursive(5, 60, 5, |inner| {
        let children = prop::collection::vec(inner, 0..5);
        (0..8u32, prop::array::uniform4(-30.0..30.0f64), children).prop_map(|(kind, numbers, children)| match kind {
            0 => Node::group(children),
            1 => Node::camera(CameraNode::new(RenderOrder::Nested), children),
            2 => {
                let absolute = CameraNode { frame: ReferenceFrame::Absolute, ..CameraNode::new(RenderOrder::Nested) };
                Node::camera(absolute, children)
            }
            _ => Node::transform(place(numbers), children),
        })
    })
}

#[derive(Clone, Debug)]
enum Change {
    Node(prop::sample::Index, [f64; 4]),
    Update,
    Query,
}

fn change() -> impl Strategy<Value = Change> {
    // The transform moves far away and back.
    let range = prop_oneof![4 => Just(1.0), 1 => Just(100.0)];
    let numbers = (range, prop::array::uniform4(-30.0..30.0f64)).prop_map(|(far, numbers)| numbers.map(|n| n * far));
    prop_oneof![
        8 => (any::<prop::sample::Index>(), numbers).prop_map(|(node, numbers)| Change::Node(node, numbers)),
        1 => Just(Change::Update),
        1 => Just(Change::Query),
    ]
}

fn nth(node: &mut Node, left: usize) -> Result<&mut Node, usize> {
    let mut left = match left.checked_sub(1) {
        None => return Ok(node),
        Some(left) => left,
    };
    for child in &mut node.children {
        match nth(child, left) {
            Ok(found) => return Ok(found),
            Err(rest) => left = rest,
        }
    }
    Err(left)
}

fn count(node: &Node) -> usize {
    1 + node.children.iter().map(count).sum::<usize>()
}

/// Changes a node of the graph, and of the scene that was built from it.
fn apply(scene: &mut Scene, root: &mut Node, index: usize, numbers: [f64; 4]) {
    let id = NodeId { page: scene.roots()[0], index: index as u32 };
    match &mut nth(root, index).unwrap().kind {
        NodeKind::Transform(map) => {
            *map = place(numbers);
            scene.set_transform(id, *map).unwrap();
        }
        NodeKind::Camera(camera) => {
            camera.frame = if numbers[0] > 0.0 { ReferenceFrame::Absolute } else { ReferenceFrame::Relative };
            scene.set_camera(id, (**camera).clone()).unwrap();
        }
        NodeKind::Geode(drawables) => {
            let bounds = Aabb { min: DVec3::splat(numbers[0]), max: DVec3::splat(numbers[0] + 1.0 + numbers[1].abs()) };
            let mesh = Arc::new(Mesh::cuboid(&bounds));
            drawables[0].geometry = Geometry::Mesh(mesh.clone());
            scene.set_mesh(id, 0, mesh, DataVariance::Static).unwrap();
        }
        _ => {}
    }
}

fn sphere(scene: &Scene, index: usize) -> Option<BoundingSphere> {
    scene.node_sphere(NodeId { page: scene.roots()[0], index: index as u32 })
}

fn assert_same(a: Option<BoundingSphere>, b: Option<BoundingSphere>) {
    match (a, b) {
        (Some(a), Some(b)) => {
            // Stored bounds are relative to the middle of the page's graph.
            let near = 1e-5 * (1.0 + a.radius_m + a.center.length()) + 4e-3;
            assert!(a.center.distance(b.center) < near && (a.radius_m - b.radius_m).abs() < near, "{a:?} {b:?}");
        }
        (a, b) => assert_eq!(a.is_some(), b.is_some()),
    }
}

/// Returns the drawn leaves of a view that is this many times as wide and high.
fn drawn(scene: &Scene, times: f64) -> BTreeSet<u32> {
    let mut stage = RenderStage::new();
    let mut camera = look_at(DVec3::new(0.0, -40.0, 0.0), DVec3::ZERO, DVec3::Z);
    camera.clip_from_eye = DMat4::from_scale(DVec3::new(1.0 / times, 1.0 / times, 1.0)) * camera.clip_from_eye;
    CullVisitor::new().cull(scene, &camera, &mut stage);
    stage.bins.iter().flat_map(|b| b.leaves.iter().map(|l| l.slot.0)).collect()
}

/// Checks that both draw the same, except for leaves at the edge of the image: bounds are rounded by the precision of
/// their page's frame.
fn assert_drawn_alike(a: &Scene, b: &Scene) {
    for (some, other) in [(a, b), (b, a)] {
        let (inner, outer) = (drawn(some, 1.0 - 1e-3), drawn(other, 1.0 + 1e-3));
        assert!(inner.is_subset(&outer), "{inner:?} {outer:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn changed_bounds_equal_those_of_a_new_scene(graph in graph(), changes in prop::collection::vec(change(), 1..40)) {
        let mut root = Node::group(vec![graph]);
        let mut scene = Scene::new();
        scene.add_root(page(root.clone(), 0));
        let nodes = count(&root);
        for change in changes {
            match change {
                Change::Node(node, numbers) => apply(&mut scene, &mut root, node.index(nodes), numbers),
                Change::Update => scene.compute_bounds(),
                Change::Query => {
                    let mut anew = Scene::new();
                    anew.add_root(page(root.clone(), 0));
                    // Queries before the update return the new values.
                    let before: Vec<_> = (0..nodes).map(|node| sphere(&scene, node)).collect();
                    let whole = scene.bounding_sphere();
                    assert_drawn_alike(&scene, &anew);
                    for (node, before) in before.iter().enumerate() {
                        assert_same(*before, sphere(&anew, node));
                    }
                    scene.compute_bounds();
                    let after: Vec<_> = (0..nodes).map(|node| sphere(&scene, node)).collect();
                    prop_assert_eq!(before, after);
                    prop_assert_eq!(whole, scene.bounding_sphere());
                    assert_drawn_alike(&scene, &anew);
                }
            }
        }
    }
}

#[test]
fn moving_siblings_updates_their_ancestors_once() {
    let siblings = |count: u32| {
        let child = || Node::transform(DAffine3::IDENTITY, vec![Node::geode(vec![cube(DVec3::ZERO, 1.0)])]);
        let group = Node::group((0..count).map(|_| child()).collect());
        let mut scene = Scene::new();
        // The group is in two groups, and each child is two nodes.
        let root = scene.add_root(page(Node::group(vec![Node::group(vec![group])]), 0));
        let fitted = |scene: &Scene| scene.page(root).unwrap().fitted_spheres();
        (0..3)
            .map(|frame| {
                let before = fitted(&scene);
                for child in 0..count {
                    let to = DVec3::new(f64::from(child), f64::from(frame + 1), 0.0);
                    let node = NodeId { page: root, index: 3 + 2 * child };
                    scene.set_transform(node, DAffine3::from_translation(to)).unwrap();
                }
                scene.compute_bounds();
                scene.compute_bounds();
                fitted(&scene) - before
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(siblings(1000), [2003; 3]);
    assert_eq!(siblings(1), [5; 3]);
}

#[test]
fn removed_page_takes_its_pending_bounds_along() {
    let mut scene = Scene::new();
    let moved = Node::transform(DAffine3::IDENTITY, vec![Node::geode(vec![cube(DVec3::ZERO, 1.0)])]);
    let id = scene.add_root(page(Node::group(vec![moved]), 0));
    let to = DAffine3::from_translation(DVec3::X * 100.0);
    scene.set_transform(NodeId { page: id, index: 1 }, to).unwrap();
    let whole = scene.bounding_sphere();
    let taken: Page = scene.remove_root(id).unwrap();
    assert_eq!(taken.bounding_sphere(), whole);
    assert!((whole.center.x - 100.0).abs() < 1e-3 && whole.radius_m < 2.0);
    scene.compute_bounds();
    let again = scene.add_root(taken);
    let fitted = scene.page(again).unwrap().fitted_spheres();
    scene.compute_bounds();
    assert_eq!(scene.page(again).unwrap().fitted_spheres(), fitted);
}

#[test]
fn levels_of_detail_enclose_their_content() {
    let place = DAffine3::from_translation(DVec3::new(100.0, 20.0, 0.0));
    let children = vec![Node::transform(place, vec![Node::geode(vec![cube(DVec3::new(0.0, 0.0, 5.0), 1.0)])])];
    let lod = Node::lod(vec![[0.0, 50.0]], children);
    let center = match &lod.kind {
        NodeKind::Lod { center, .. } => *center,
        other => panic!("{other:?}"),
    };
    assert!(center.distance(DVec3::new(100.0, 20.0, 5.0)) < 1e-3, "{center}");
    assert!(lod.bounding_sphere().center.distance(center) < 1e-3);
    let mut scene = Scene::new();
    scene.add_root(page(lod, 0));
    let seen = |eye: DVec3| {
        let mut stage = RenderStage::new();
        CullVisitor::new().cull(&scene, &look_at(eye, center, DVec3::Z), &mut stage);
        stage.leaf_count()
    };
    assert_eq!([seen(center + DVec3::X * 49.0), seen(center + DVec3::X * 51.0)], [1, 0]);
    let empty = Node::lod(vec![[0.0, 50.0]], vec![Node::group(vec![])]);
    assert!(matches!(empty.kind, NodeKind::Lod { center: DVec3::ZERO, .. }));
}

/// A drawable of constant size on the screen has no bounds. What lies beside it is still what a first view shows.
#[test]
fn page_with_unbounded_parts_has_the_sphere_of_the_others() {
    let auto_scale = Some(AutoScale { min: 0.0, max: f64::INFINITY });
    let drawables = vec![(DVec3::new(0.0, 8.0, 0.0), cube(DVec3::ZERO, 1.0))];
    let sign =
        Node::new(NodeKind::Billboard(Box::new(Billboard { mode: BillboardMode::PointRotEye, auto_scale, drawables })));
    let place = DAffine3::from_translation(DVec3::new(100.0, 20.0, 0.0));
    let house = Node::geode(vec![cube(DVec3::new(0.0, -8.0, 0.0), 1.0)]);
    let page = page(Node::transform(place, vec![Node::group(vec![sign]), house]), 0);
    let sphere = page.bounding_sphere();
    assert!(sphere.center.distance(DVec3::new(100.0, 20.0, 0.0)) < 2.0, "{sphere:?}");
    assert!(sphere.radius_m > 8.0 && sphere.radius_m < 11.0, "{sphere:?}");
}
