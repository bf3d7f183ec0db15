//! Occlusion queries: nodes that the adapter reports as hidden are not drawn, and are drawn again when visible.

use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::cull::CullCamera;
use terrane::scene::{CameraNode, Node, NodeId, NodeKind, OcclusionQueryNode, ReferenceFrame, RenderOrder, Scene};

const SIDE: u32 = 64;

fn no_errors(rig: &mut Rig) {
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}

#[test]
fn queries_hide_occluded_nodes_and_show_them_again() {
    let Some(mut rig) = rig("queries_hide_occluded_nodes_and_show_them_again") else { return };
    let rig = &mut *rig;
    let query = OcclusionQueryNode { query_frames: 1, failures_to_hide: 2, ..OcclusionQueryNode::default() };
    let results = query.results.clone();
    let mut hidden = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
    hidden.children = vec![Node::geode(vec![quad([0.0, 0.0, -3.0], [0.2; 2], [0.0, 1.0, 0.0, 1.0])])];
    let wall = Node {
        children: vec![Node::geode(vec![quad([0.0; 3], [0.9; 2], [1.0, 0.0, 0.0, 1.0])])],
        ..Node::new(NodeKind::Switch(vec![true]))
    };
    let mut scene = rig.scene(Node::group(vec![hidden, wall]));
    let root = scene.roots()[0];
    let leaves = |rig: &mut Rig, scene: &Scene, frame| {
        rig.draw(scene, &CullCamera { frame, ..unit_camera(SIDE) }, &plain());
        rig.stage.leaf_count()
    };
    assert_eq!(leaves(rig, &scene, 1), 2, "drawn until the query has a result");
    let mut frame = 1;
    while leaves(rig, &scene, frame) == 2 {
        frame += 1;
        assert!(frame < 200, "never hidden: {} failures", results.failures());
    }
    assert!(results.failures() >= 2 && results.samples() == 0);
    // Without the wall, the hidden node is drawn again.
    scene.set_switch(NodeId { page: root, index: 3 }, 0, false).unwrap();
    while leaves(rig, &scene, frame) == 0 {
        frame += 1;
        assert!(frame < 400, "the node was not drawn again");
    }
    assert!(results.samples() > 0 && results.failures() == 0);
    rig.release(scene);
    no_errors(rig);
}

/// There are more queries than fit into a frame. Nodes without a query are drawn, whatever their last result.
#[test]
fn nodes_without_a_free_query_are_drawn() {
    let Some(mut rig) = rig("nodes_without_a_free_query_are_drawn") else { return };
    let rig = &mut *rig;
    const NODES: usize = 1200;
    let mut all = Vec::new();
    for _ in 0..NODES {
        let query = OcclusionQueryNode { query_frames: 1, failures_to_hide: 1, ..OcclusionQueryNode::default() };
        let mut node = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
        node.children = vec![Node::geode(vec![quad([0.0, 0.0, -3.0], [0.2; 2], [0.0, 1.0, 0.0, 1.0])])];
        all.push(node);
    }
    let wall = Node {
        children: vec![Node::geode(vec![quad([0.0; 3], [0.9; 2], [1.0, 0.0, 0.0, 1.0])])],
        ..Node::new(NodeKind::Switch(vec![true]))
    };
    // The result of the wall, which is drawn first, is known.
    all.insert(0, wall);
    let mut scene = rig.scene(Node::group(all));
    let root = scene.roots()[0];
    let mut frame = 0;
    let mut leaves = |rig: &mut Rig, scene: &Scene| {
        frame += 1;
        assert!(frame < 400, "never");
        rig.draw(scene, &CullCamera { frame, ..unit_camera(SIDE) }, &plain());
        rig.stage.leaf_count()
    };
    while leaves(rig, &scene) > NODES - 1024 + 1 {}
    scene.set_switch(NodeId { page: root, index: 1 }, 0, false).unwrap();
    while leaves(rig, &scene) < NODES {}
    rig.release(scene);
    no_errors(rig);
}

/// A nested camera with a viewport compares with the depth inside that viewport.
#[test]
fn queries_below_a_nested_camera_use_its_viewport() {
    let Some(mut rig) = rig("queries_below_a_nested_camera_use_its_viewport") else { return };
    let rig = &mut *rig;
    for (wall_x, is_seen) in [(-0.5, true), (0.5, false)] {
        let query = OcclusionQueryNode { query_frames: 1, failures_to_hide: 2, ..OcclusionQueryNode::default() };
        let results = query.results.clone();
        let mut asked = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
        asked.children = vec![Node::geode(vec![quad([0.0, 0.0, -3.0], [0.2; 2], [0.0, 1.0, 0.0, 1.0])])];
        let eye = unit_camera(SIDE);
        let right_half = CameraNode {
            frame: ReferenceFrame::Absolute,
            view: eye.eye_from_world,
            projection: Some(eye.clip_from_eye),
            viewport_px: Some([SIDE / 2, 0, SIDE / 2, SIDE]),
            ..CameraNode::new(RenderOrder::Nested)
        };
        // In the whole image it would cover the left or the right half.
        let wall = Node::geode(vec![quad([wall_x, 0.0, 0.0], [0.5, 1.0], [1.0, 0.0, 0.0, 1.0])]);
        let scene = rig.scene(Node::group(vec![wall, Node::camera(right_half, vec![asked])]));
        let mut frame = 0;
        while results.failures() < 2 && results.samples() == 0 {
            frame += 1;
            rig.draw(&scene, &CullCamera { frame, ..unit_camera(SIDE) }, &plain());
            assert!(frame < 400, "the query had no result");
        }
        assert_eq!(results.samples() > 0, is_seen, "{} samples", results.samples());
        rig.release(scene);
    }
    no_errors(rig);
}

/// A threshold of several samples hides what shows fewer, where the adapter counts them. Elsewhere it hides nothing that is
/// visible, and is reported.
#[test]
fn threshold_of_samples_hides_nothing_that_shows_more() {
    let Some(mut rig) = rig("threshold_of_samples_hides_nothing_that_shows_more") else { return };
    let rig = &mut *rig;
    // The box of the square covers about 60 pixels, and half of it is behind the wall.
    for (threshold, has_enough) in [(4, true), (1_000, false)] {
        let query = OcclusionQueryNode {
            query_frames: 1,
            failures_to_hide: 2,
            visibility_threshold: threshold,
            ..OcclusionQueryNode::default()
        };
        let results = query.results.clone();
        let mut asked = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
        asked.children = vec![Node::geode(vec![quad([0.0, 0.0, -3.0], [0.2; 2], [0.0, 1.0, 0.0, 1.0])])];
        let wall = Node::geode(vec![quad([0.5, 0.0, 0.0], [0.5, 1.0], [1.0, 0.0, 0.0, 1.0])]);
        let scene = rig.scene(Node::group(vec![asked, wall]));
        let mut frame = 0;
        while results.failures() < 2 && (results.samples() == 0 || frame < 12) {
            frame += 1;
            rig.draw(&scene, &CullCamera { frame, ..unit_camera(SIDE) }, &plain());
            assert!(frame < 400, "the query had no result");
        }
        assert!(results.samples() > 0, "it is visible");
        let is_reported = rig.renderer.take_errors().iter().any(|error| error.contains("OcclusionQueryNode"));
        let counts_samples = results.samples() > 1;
        assert_eq!(is_reported, !counts_samples, "{} samples", results.samples());
        assert_eq!(results.failures() == 0, has_enough || !counts_samples, "{} samples", results.samples());
        rig.release(scene);
    }
}
