//! Settings of culls: the number of occluders, inherited clamps of near and far, clusters of backs; dynamic leaves, and states
//! that a visitor forgets.

use std::sync::Arc;

use crate::single_page::{camera, cube, cull, cull_scene, scene, slots};
use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DMat4, DVec3, DVec4};
use kit::cull_scenes::{look_at, page};
use kit::shapes::quad;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::scene::{
    CameraNode, ClampProjection, ComputeNearFar, ConvexPlanarOccluder, CullSettings, CullingMode, Inherit, Node,
    NodeKind, RenderOrder, Scene,
};
use terrane::state::{
    Attribute, CullFace, DataVariance, FrontFace, Mode, StateSet, StateValue, TextureBinding, TextureFormat,
    TextureObject,
};

/// Returns a wall of 4 x 4 m across the view of [`camera`].
fn wall(center: DVec3) -> Node {
    let corner = |(x, z): (f64, f64)| center + DVec3::new(x, 0.0, z);
    let corners = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)].map(corner).to_vec();
    Node::new(NodeKind::OccluderNode(Box::new(ConvexPlanarOccluder { corners, holes: vec![] })))
}

#[test]
fn as_many_occluders_are_used_as_the_settings_say() {
    let walls = || {
        // The left wall is nearer, so its solid angle is larger.
        let walls = vec![wall(DVec3::new(2.0, 0.0, 0.0)), wall(DVec3::new(-2.0, -1.0, 0.0))];
        let behind = [3.0, -3.0].map(|x| cube(DVec3::new(x, 5.0, 0.0)));
        Node::group(walls.into_iter().chain(behind).collect())
    };
    let mut camera = camera();
    for (max_occluders, seen) in [(0, vec![0, 1]), (1, vec![0]), (2, vec![]), (16, vec![])] {
        camera.settings.max_occluders = max_occluders;
        assert_eq!(slots(&cull(walls(), &camera)), seen, "at most {max_occluders}");
    }
    // A camera in the graph inherits the number, or has its own.
    for (inherit, seen) in [(Inherit::ALL, vec![0, 1]), (Inherit::NONE, vec![])] {
        camera.settings.max_occluders = 0;
        let own = CameraNode {
            projection: Some(camera.clip_from_eye),
            settings: CullSettings::default(),
            inherit,
            ..CameraNode::new(RenderOrder::PreRender(0))
        };
        let stage = cull(Node::camera(own, vec![walls()]), &camera);
        assert_eq!(slots(&stage.pre_render[0]), seen);
    }
}

#[test]
fn cameras_inherit_the_clamp_of_near_and_far() {
    let mut camera = camera();
    camera.settings.compute_near_far = ComputeNearFar::BoundingVolumes;
    camera.settings.near_far_ratio = 0.0;
    camera.clip_from_eye = proj::perspective(1.0, 1.0, 1e5, 0.1);
    let near_of = |m: &DMat4| {
        // With reversed depth, the near plane has depth 1.
        let depth = |distance_m: f64| {
            let clip = *m * DVec4::new(0.0, 0.0, -distance_m, 1.0);
            clip.z / clip.w
        };
        (1..200).map(|step| f64::from(step) * 0.1).find(|distance_m| depth(*distance_m) <= 1.0).unwrap()
    };
    let near = |inherit, clamp_projection| {
        let below = CameraNode {
            projection: Some(camera.clip_from_eye),
            inherit,
            settings: camera.settings,
            clamp_projection,
            ..CameraNode::new(RenderOrder::PreRender(0))
        };
        let scene = scene(Node::camera(below, vec![cube(DVec3::ZERO)]));
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        visitor.clamp_projection = Some(|near_m, far_m| (near_m.min(2.0), far_m * 10.0));
        visitor.cull(&scene, &camera, &mut stage);
        near_of(&stage.pre_render[0].camera.clip_from_eye)
    };
    let nearer: Option<ClampProjection> = Some(|near_m, far_m| (near_m.min(5.0), far_m));
    assert!((near(Inherit::ALL, None) - 2.0).abs() < 0.2);
    assert!((near(Inherit::NONE, None) - 9.5).abs() < 0.4);
    assert!((near(Inherit::ALL, nearer) - 5.0).abs() < 0.3);
}

#[test]
fn leaves_below_dynamic_state_are_counted() {
    let dynamic = || Arc::new(StateSet { data_variance: DataVariance::Dynamic, ..StateSet::default() });
    let named = || Arc::new(StateSet { name: "below".into(), ..StateSet::default() });
    let below = cube(DVec3::X).with_state_set(named());
    let root = Node::group(vec![
        cube(DVec3::ZERO),
        Node::group(vec![cube(DVec3::NEG_X), below]).with_state_set(dynamic()),
        cube(DVec3::new(900.0, 0.0, 0.0)).with_state_set(dynamic()),
    ]);
    let scene = scene(root);
    for _ in 0..2 {
        let counters = cull_scene(&scene, &camera()).counters;
        assert_eq!((counters.leaves, counters.dynamic_leaves), (3, 2));
    }
}

#[test]
fn forgotten_states_release_their_textures() {
    let texture = TextureObject::target("texture", [8, 8], TextureFormat::Rgba8);
    let set = StateSet::default().with(Attribute::Texture(0, TextureBinding::new(texture.clone())));
    let mut scene = Scene::new();
    let root = scene.add_root(page(cube(DVec3::ZERO).with_state_set(Arc::new(set)), 0));
    scene.add_root(page(cube(DVec3::X), 1));
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    visitor.cull(&scene, &camera(), &mut stage);
    assert_eq!(slots(&stage), [0, 1]);
    drop(scene.remove_root(root));
    visitor.cull(&scene, &camera(), &mut stage);
    assert!(Arc::strong_count(&texture) > 1, "kept for culls that meet the state again");
    visitor.prune_states();
    visitor.cull(&scene, &camera(), &mut stage);
    assert_eq!((slots(&stage), Arc::strong_count(&texture)), (vec![1], 1));
}

/// Returns a camera that sees the fronts of [`quad`]s, or their backs.
fn seeing(fronts: bool) -> CullCamera {
    look_at(DVec3::new(0.0, 0.0, if fronts { 10.0 } else { -10.0 }), DVec3::ZERO, DVec3::Y)
}

#[test]
fn clusters_of_backs_are_culled_where_their_state_culls_them() {
    let one = || quad([0.0; 3], [0.5; 2], [1.0; 4]).with_cluster_culling();
    let off = StateSet::default().with_mode(Mode::CullFace, StateValue::OFF);
    let fronts = StateSet::default().with(Attribute::CullFace(CullFace::Front));
    let clockwise = StateSet::default().with(Attribute::FrontFace(FrontFace::Clockwise));
    for count in [1, 2] {
        let geode = || Node::geode((0..count).map(|_| one()).collect());
        // A page with one drawable has a shorter way; a transform mirrors no cone.
        let moved = || Node::transform(DAffine3::from_scale(DVec3::new(2.0, 1.0, 1.0)), vec![geode()]);
        let all: Vec<u32> = (0..count).collect();
        for node in [&geode as &dyn Fn() -> Node, &moved] {
            assert_eq!(slots(&cull(node(), &seeing(true))), all);
            assert_eq!(slots(&cull(node(), &seeing(false))), [0; 0]);
            for set in [&off, &fronts, &clockwise] {
                let stage = cull(node().with_state_set(Arc::new(set.clone())), &seeing(false));
                assert_eq!(slots(&stage), all, "{set:?}");
            }
            let mut without = seeing(false);
            without.settings.culling = CullingMode(without.settings.culling.0 & !CullingMode::CLUSTER.0);
            assert_eq!(slots(&cull(node(), &without)), all);
        }
    }
}

#[test]
fn the_set_of_openscenegraph_culls_small_features() {
    let mut camera = camera();
    let far = || Node::group(vec![cube(DVec3::ZERO), cube(DVec3::new(0.0, 9_000.0, 0.0))]);
    assert_eq!(slots(&cull(far(), &camera)), [0, 1]);
    camera.settings.culling = CullingMode::REFERENCE;
    assert_eq!(slots(&cull(far(), &camera)), [0]);
}
