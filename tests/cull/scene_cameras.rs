//! Cull of nested cameras that show the scene: their leaves, requests and exclusions.

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DVec3};
use kit::cull_scenes::{content, drawable, look_at, page, quadtree};
use terrane::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{CameraNode, Node, PageId, ReferenceFrame, Refine, RenderOrder, Scene};

const HALF_M: f64 = 1000.0;

/// Returns a camera that looks at the tiles from near the ground.
fn near() -> CullCamera {
    CullCamera {
        clip_from_eye: proj::perspective_infinite_reverse(0.8, 1.5, 0.1),
        viewport_px: [600, 400],
        ..look_at(DVec3::new(-900.0, -900.0, 60.0), DVec3::new(-400.0, -300.0, 0.0), DVec3::Z)
    }
}

/// Returns a camera that looks away from the scene.
fn away() -> CullCamera {
    look_at(DVec3::new(0.0, 0.0, 5000.0), DVec3::new(0.0, 10.0, 9000.0), DVec3::Z)
}

fn like(camera: &CullCamera) -> CameraNode {
    let [width, height] = camera.viewport_px;
    CameraNode {
        frame: ReferenceFrame::Absolute,
        view: camera.eye_from_world,
        projection: Some(camera.clip_from_eye),
        viewport_px: Some([7, 9, width, height]),
        shows_scene: true,
        ..CameraNode::new(RenderOrder::Nested)
    }
}

/// Returns tiles, of which the coarsest are loaded, with nodes attached to them.
fn world(beside: Vec<Node>) -> Scene {
    let mut scene = Scene::new();
    let tiles = scene.add_root(page(quadtree(6, HALF_M, 64.0, Refine::Replace), 0));
    attach(&mut scene, tiles, HALF_M);
    if !beside.is_empty() {
        let moved = DAffine3::from_translation(DVec3::new(0.0, 0.0, 700.0));
        scene.add_root(page(Node::transform(moved, beside), 5000));
    }
    scene
}

fn attach(scene: &mut Scene, tiles: PageId, half_m: f64) {
    let mut missing: Vec<_> = scene.tiles().filter(|t| t.depth < 3).map(|t| (t.node, t.depth)).collect();
    missing.sort_by_key(|(node, _)| node.index);
    for (number, (slot, depth)) in missing.into_iter().enumerate() {
        assert_eq!(slot.page, tiles);
        scene.attach(slot, content(half_m / f64::from(1 << depth), 1000 + number as u32)).unwrap();
    }
}

fn cull(scene: &Scene, camera: &CullCamera) -> RenderStage {
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    (0..3).for_each(|_| visitor.cull(scene, camera, &mut stage));
    stage
}

/// Returns the slot, the position in eye space and the view of each leaf.
fn drawn(stage: &RenderStage) -> Vec<(u32, [u32; 12], u32)> {
    let leaves = stage.bins.iter().flat_map(|bin| &bin.leaves);
    let mut drawn: Vec<_> = leaves
        .map(|leaf| {
            let rows = stage.eye_from_drawable[leaf.matrix as usize];
            let bits: [u32; 12] = std::array::from_fn(|i| rows[i / 4][i % 4].to_bits());
            (leaf.slot.0, bits, stage.view_of_state[leaf.state as usize])
        })
        .collect();
    drawn.sort_unstable();
    drawn
}

/// Returns the requests independent of the scene's id: node, priority, error and frames until needed.
fn wanted(stage: &RenderStage) -> Vec<(u32, f32, f32, u32)> {
    let of = |r: &PageRequest| (r.slot.index, r.priority, r.error_px, r.ahead_frames);
    let mut wanted: Vec<_> = stage.requests.iter().map(of).collect();
    wanted.sort_by_key(|request| request.0);
    wanted
}

#[test]
fn camera_draws_and_requests_like_a_view_at_its_pose() {
    let alone = cull(&world(vec![]), &near());
    assert!(alone.leaf_count() > 5 && !alone.requests.is_empty());
    let scene = world(vec![Node::camera(like(&near()), vec![])]);
    let stage = cull(&scene, &away());
    let of_view: Vec<_> = drawn(&alone).into_iter().map(|(slot, place, _)| (slot, place, 1)).collect();
    assert_eq!(drawn(&stage), of_view);
    assert_eq!(wanted(&stage), wanted(&alone));
    assert_eq!(stage.counters.tiles_drawn, alone.counters.tiles_drawn);
    let [view] = &stage.views[..] else { panic!("one camera") };
    assert!(view.shows_scene);
    assert_eq!(view.range_m, [alone.near_m, alone.far_m]);
    assert_eq!((view.viewport_px, stage.near_m, stage.far_m), (Some([7, 9, 600, 400]), 0.0, 0.0));
}

#[test]
fn relative_camera_moves_the_eye() {
    // The camera is raised by 700 m and turned about its node, as if the eye were elsewhere.
    let turn = DAffine3::from_rotation_z(0.3);
    let node = CameraNode { view: turn, shows_scene: true, ..CameraNode::new(RenderOrder::Nested) };
    let stage = cull(&world(vec![Node::camera(node, vec![])]), &near());
    let moved = CullCamera { eye_from_world: near().eye_from_world * turn, ..near() };
    let (alone, main) = (cull(&world(vec![]), &moved), cull(&world(vec![]), &near()));
    let places = |stage: &RenderStage, view: u32| -> Vec<(u32, [f32; 12])> {
        let of_view = drawn(stage).into_iter().filter(|(_, _, of)| *of == view);
        of_view.map(|(slot, bits, _)| (slot, bits.map(f32::from_bits))).collect()
    };
    assert_eq!(places(&stage, 0), places(&main, 0));
    let (found, expected) = (places(&stage, 1), places(&alone, 0));
    assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), expected.iter().map(|e| e.0).collect::<Vec<_>>());
    for ((_, found), (_, expected)) in found.iter().zip(&expected) {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-3), "{found:?} {expected:?}");
    }
}

#[test]
fn scene_cameras_are_not_drawn_in_images_of_scene_cameras() {
    let mark = |number: f64| {
        let middle = DVec3::new(-400.0, -300.0, -650.0 + number);
        Node::geode(vec![drawable(Aabb { min: middle - 5.0, max: middle + 5.0 })])
    };
    // Nodes below an absolute camera are in world coordinates.
    let below = |order: RenderOrder, number: f64| {
        let node = CameraNode { order, clear_color: None, ..like(&near()) };
        let up = DAffine3::from_translation(DVec3::new(0.0, 0.0, 650.0));
        Node::camera(node, vec![Node::transform(up, vec![mark(number)])])
    };
    let marks = |stage: &RenderStage| {
        let mut slots: Vec<_> = drawn(stage).iter().filter(|d| d.0 >= 5000).map(|d| (d.0, d.2)).collect();
        slots.sort_unstable();
        slots
    };
    let nested = RenderOrder::Nested;
    let stage = cull(&world(vec![below(nested, 0.0), below(nested, 1.0)]), &away());
    assert_eq!(marks(&stage), [(5000, 1), (5001, 2)], "each camera shows its view");
    assert_eq!(stage.views.len(), 2);
    let stage = cull(&world(vec![below(nested, 0.0), below(RenderOrder::PostRender(0), 1.0)]), &away());
    assert_eq!((marks(&stage), stage.post_render.len()), (vec![(5000, 1)], 1));
    let [after] = &stage.post_render[..] else { panic!("one") };
    assert_eq!((marks(after), after.views.len()), (vec![(5001, 0)], 0), "a nested camera is not drawn in a later one");
    // A plain camera in the scene is drawn in the image, but scene cameras below it are not.
    let inner = CameraNode { shows_scene: true, ..CameraNode::new(nested) };
    let plain = CameraNode { clear_color: None, ..CameraNode::new(RenderOrder::PostRender(0)) };
    let post = Node::camera(plain, vec![Node::camera(inner, vec![])]);
    let stage = cull(&world(vec![post, below(nested, 0.0)]), &away());
    let [of_main, of_nested] = &stage.post_render[..] else { panic!("{}", stage.post_render.len()) };
    assert_eq!((of_main.views.len(), of_nested.views.len()), (1, 0));
}
