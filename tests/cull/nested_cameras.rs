//! Cull of cameras, projections and absolute transforms in the scene graph.

use std::sync::Arc;

use crate::single_page::{camera, cube, cull, cull_scene, origin_in_eye, scene, slots};
use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DVec3};
use kit::cull_scenes::look_at;
use terrane::cull::{CullCamera, CullVisitor, PositionedLight, RenderStage};
use terrane::scene::{
    Attachment, CameraNode, CameraTarget, CullSettings, Inherit, LightSource, Node, NodeKind, ReferenceFrame,
    RenderOrder, TexGenNode,
};
use terrane::state::{Light, StateSet, TexGen, TextureFormat, TextureObject};

#[test]
fn projection_applies_only_below_its_node() {
    // A cube 8 m to the right of the axis, at 10 m: outside of 60 degrees, inside of 120.
    let right = DVec3::new(8.0, 0.0, 0.0);
    let wide = NodeKind::Projection(proj::perspective_infinite_reverse(120f64.to_radians(), 1.0, 0.1));
    let mut projection = Node::new(wide);
    projection.children = vec![cube(right), cube(DVec3::ZERO)];
    let stage = cull(Node::group(vec![cube(right), projection, cube(right), cube(DVec3::ZERO)]), &camera());
    assert_eq!(slots(&stage), [1, 2, 4]);
    assert_eq!(stage.views.len(), 1);
    let view_of = |slot: u32| {
        let leaf = stage.bins[0].leaves.iter().find(|l| l.slot.0 == slot).unwrap();
        stage.view_of_state[leaf.state as usize]
    };
    assert_eq!([1, 2, 4].map(view_of), [1, 1, 0]);
}

#[test]
fn nested_projections_restore_the_outer_one() {
    let wide = |children| Node {
        children,
        ..Node::new(NodeKind::Projection(proj::perspective_infinite_reverse(2.0, 1.0, 0.1)))
    };
    // The inner projection is reached before the outer one has its first leaf.
    let root = wide(vec![wide(vec![cube(DVec3::ZERO)]), cube(DVec3::ZERO)]);
    let stage = cull(Node::group(vec![root, cube(DVec3::ZERO)]), &camera());
    let leaf_views: Vec<u32> = (0..3)
        .map(|slot| {
            let leaf = stage.bins[0].leaves.iter().find(|l| l.slot.0 == slot).unwrap();
            stage.view_of_state[leaf.state as usize]
        })
        .collect();
    assert_eq!(leaf_views, [2, 1, 0]);
}

#[test]
fn absolute_transforms_are_relative_to_the_eye() {
    let hud = Node {
        children: vec![
            cube(DVec3::ZERO),
            Node::transform(DAffine3::from_translation(DVec3::X), vec![cube(DVec3::ZERO)]),
        ],
        ..Node::new(NodeKind::AbsoluteTransform(DAffine3::from_translation(DVec3::new(0.0, 0.0, -5.0))))
    };
    let moved = Node::transform(DAffine3::from_translation(DVec3::new(500.0, 3.0, 1.0)), vec![hud]);
    // The eye looks away from the other nodes.
    let away = look_at(DVec3::new(0.0, 1000.0, 0.0), DVec3::new(0.0, 2000.0, 0.0), DVec3::Z);
    let stage = cull(Node::group(vec![cube(DVec3::ZERO), moved]), &away);
    assert_eq!(slots(&stage), [1, 2]);
    assert!(origin_in_eye(&stage, 1).distance(DVec3::new(0.0, 0.0, -5.0)) < 1e-5);
    assert!(origin_in_eye(&stage, 2).distance(DVec3::new(1.0, 0.0, -5.0)) < 1e-5);
}

#[test]
fn nested_cameras_have_view_and_projection() {
    let mut nested = CameraNode::new(RenderOrder::Nested);
    nested.frame = ReferenceFrame::Absolute;
    nested.view = DAffine3::from_translation(DVec3::new(0.0, 0.0, -3.0));
    nested.projection = Some(proj::perspective_infinite_reverse(1.0, 1.0, 0.1));
    nested.viewport_px = Some([5, 6, 70, 80]);
    let root = Node::group(vec![
        cube(DVec3::ZERO),
        Node::transform(
            DAffine3::from_translation(DVec3::new(0.0, 0.0, 77.0)),
            vec![Node::camera(nested, vec![cube(DVec3::ZERO)])],
        ),
    ]);
    let stage = cull(root, &camera());
    assert_eq!(slots(&stage), [0, 1]);
    assert!(origin_in_eye(&stage, 1).distance(DVec3::new(0.0, 0.0, -3.0)) < 1e-5);
    assert_eq!(stage.views[0].viewport_px, Some([5, 6, 70, 80]));
    // Its content does not change the outer range of 9.5 to 10.5 m.
    assert!((stage.near_m - 9.5).abs() < 1e-3 && (stage.far_m - 10.5).abs() < 1e-3);
    // The view of a relative camera is applied after that of its parent.
    let mut relative = CameraNode::new(RenderOrder::Nested);
    relative.view = DAffine3::from_translation(DVec3::new(1.0, 0.0, 0.0));
    let stage = cull(Node::camera(relative, vec![cube(DVec3::ZERO)]), &camera());
    assert!(origin_in_eye(&stage, 0).distance(DVec3::new(1.0, 0.0, -10.0)) < 1e-5);
}

#[test]
fn pre_and_post_render_cameras_have_separate_stages() {
    let texture = TextureObject::target("mirror", [64, 32], TextureFormat::Rgba8Srgb);
    let target =
        Arc::new(CameraTarget { colors: vec![Attachment::new(texture)], samples: 1, ..CameraTarget::default() });
    let of = |order, settings: CullSettings, inherit| CameraNode {
        target: Some(target.clone()),
        settings,
        inherit,
        projection: Some(proj::perspective_infinite_reverse(1.0, 2.0, 0.1)),
        ..CameraNode::new(order)
    };
    let shared = || cube(DVec3::ZERO);
    let mut hidden = cube(DVec3::ZERO);
    hidden.mask = 2;
    let masked = CullSettings { cull_mask: 1, ..CullSettings::default() };
    let red = Arc::new(StateSet { color: Some([1.0, 0.0, 0.0, 1.0]), ..StateSet::default() });
    let inner = Node::camera(of(RenderOrder::PreRender(0), masked, Inherit::NONE), vec![shared()]);
    let root = Node::group(vec![
        Node::camera(of(RenderOrder::PostRender(5), masked, Inherit::ALL), vec![shared(), hidden.clone()]),
        Node::camera(of(RenderOrder::PreRender(2), masked, Inherit::NONE), vec![shared(), hidden]).with_state_set(red),
        Node::camera(of(RenderOrder::PreRender(-1), masked, Inherit::ALL), vec![inner, shared()]),
        shared(),
    ]);
    let scene = scene(root);
    let stage = cull_scene(&scene, &camera());
    assert_eq!(slots(&stage), [6]);
    let orders: Vec<i32> = stage.pre_render.iter().map(|s| s.target.order).collect();
    assert_eq!(orders, [-1, 2]);
    let [first, second] = &stage.pre_render[..] else { panic!("expected two stages") };
    assert_eq!((slots(first), slots(&first.pre_render[0]), slots(second)), (vec![5], vec![4], vec![2]));
    assert_eq!(second.state_sets[0].color, [1.0, 0.0, 0.0, 1.0], "state is inherited");
    assert_eq!(second.camera.viewport_px, [64, 32]);
    assert_eq!((stage.post_render.len(), slots(&stage.post_render[0])), (1, vec![0, 1]));
    assert_eq!(stage.counters.leaves, 1 + 1 + 1 + 1 + 2);
}

#[test]
fn stages_inherit_lights_at_their_world_positions() {
    let lamp = |number, z| {
        let light = Light { number, position: [0.0, 0.0, z, 1.0], ..Light::default() };
        Node::new(NodeKind::LightSource(Box::new(LightSource { light, frame: ReferenceFrame::Relative })))
    };
    let mut other = CameraNode::new(RenderOrder::PreRender(0));
    other.frame = ReferenceFrame::Absolute;
    other.view = look_at(DVec3::new(50.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z).eye_from_world;
    let below = Node::camera(other, vec![cube(DVec3::ZERO), lamp(2, 9.0)]);
    // The lights come after the camera in the scene, and still apply to it.
    let stage = cull(Node::group(vec![below, lamp(1, 4.0), lamp(2, 5.0)]), &camera());
    let of = |stage: &RenderStage| {
        // The last light with a number wins.
        let numbered = |l: &PositionedLight| (l.light.number, l.light.position.map(f64::round));
        stage.lights.iter().map(numbered).collect::<std::collections::BTreeMap<_, _>>().into_iter().collect::<Vec<_>>()
    };
    assert_eq!(of(&stage), [(1, [0.0, 4.0, -10.0, 1.0]), (2, [0.0, 5.0, -10.0, 1.0])]);
    assert_eq!(of(&stage.pre_render[0]), [(1, [0.0, 4.0, -50.0, 1.0]), (2, [0.0, 9.0, -50.0, 1.0])]);
}

#[test]
fn depth_of_nested_cameras_is_limited() {
    let mut node = cube(DVec3::ZERO);
    for _ in 0..40 {
        node = Node::camera(CameraNode::new(RenderOrder::PreRender(0)), vec![node]);
    }
    let stage = cull(node, &camera());
    let mut depth = 0;
    let mut at = &stage;
    while let [below] = &at.pre_render[..] {
        (at, depth) = (below, depth + 1);
    }
    assert_eq!(depth, 9);
}

/// Returns the stage of a `Lod` between two levels, before its fade has ended.
fn fading(root: impl Fn(Node) -> Node, inside: impl Fn() -> Vec<Node>) -> RenderStage {
    let mut lod = Node::new(NodeKind::Lod { center: DVec3::ZERO, ranges_m: vec![[0.0, 10.0], [10.0, 1e9]] });
    lod.children = vec![cube(DVec3::ZERO), Node::group(inside())];
    let scene = scene(root(lod));
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    for (frame, time_s, distance_m) in [(1, 1.0, 9.0), (2, 1.1, 9.0), (3, 1.2, 11.0)] {
        let eye = look_at(DVec3::new(0.0, -distance_m, 0.0), DVec3::ZERO, DVec3::Z);
        visitor.cull(&scene, &CullCamera { frame, simulation_time_s: time_s, ..eye }, &mut stage);
    }
    stage
}

#[test]
fn lods_fade_below_cameras_and_around_projections() {
    // Below a camera with a separate stage, each level is drawn to its share of the pixels.
    let over = |lod| Node::camera(CameraNode::new(RenderOrder::PostRender(0)), vec![lod]);
    let stage = fading(over, || vec![cube(DVec3::ZERO)]);
    let below = &stage.post_render[0];
    let bands: Vec<u32> = below.bins[0].leaves.iter().map(|l| below.part_of_state[l.state as usize]).collect();
    assert!(bands.len() == 2 && bands[0] != bands[1] && !bands.contains(&0), "{bands:?}");
    // Siblings after an inner projection, and those after the `Lod`, are drawn with the outer projection.
    let projection = || NodeKind::Projection(proj::perspective_infinite_reverse(1.2, 1.0, 0.1));
    let with = |children| Node { children, ..Node::new(projection()) };
    let around = |lod| with(vec![lod, cube(DVec3::new(1.0, 0.0, 0.0))]);
    let stage = fading(around, || vec![with(vec![cube(DVec3::ZERO)]), cube(DVec3::new(-1.0, 0.0, 0.0))]);
    let view_of = |slot: u32| {
        let leaf = stage.bins.iter().flat_map(|b| &b.leaves).find(|l| l.slot.0 == slot).unwrap();
        (stage.view_of_state[leaf.state as usize], stage.part_of_state[leaf.state as usize] != 0)
    };
    assert_eq!([0, 1, 2, 3].map(view_of), [(1, true), (2, true), (1, true), (1, false)]);
}

#[test]
fn last_light_with_a_number_wins_and_texture_planes_are_inherited() {
    let light = |red: f32| {
        let light = Light { number: 1, diffuse: [red, 0.0, 0.0], ..Light::default() };
        Node::new(NodeKind::LightSource(LightSource { light, frame: ReferenceFrame::Relative }.into()))
    };
    let planes = TexGen::EyeLinear(TexGen::planes([1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]));
    let texgen = Node::new(NodeKind::TexGenNode(Box::new(TexGenNode { unit: 2, texgen: planes })));
    let below = Node::camera(CameraNode::new(RenderOrder::PostRender(0)), vec![light(0.75), cube(DVec3::ZERO)]);
    let stage = cull(Node::group(vec![light(0.25), light(0.5), texgen, below]), &camera());
    let reds = |stage: &RenderStage| stage.lights.iter().map(|l| l.light.diffuse[0]).collect::<Vec<_>>();
    assert_eq!((reds(&stage), reds(&stage.post_render[0])), (vec![0.25, 0.5], vec![0.25, 0.5, 0.75]));
    assert_eq!(stage.post_render[0].texgens, stage.texgens);
}
