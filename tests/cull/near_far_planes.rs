//! Near and far planes that follow the visible leaves, and culling by them.

use crate::single_page::{camera, cube, cull, scene, slots};
use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DMat4, DVec3, DVec4};
use kit::cull_scenes::drawable;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{CameraNode, ComputeNearFar, CullingMode, Node, RenderOrder};

#[test]
fn near_and_far_planes_follow_the_visible_leaves() {
    let mut camera = camera();
    camera.settings.compute_near_far = ComputeNearFar::BoundingVolumes;
    camera.settings.near_far_ratio = 0.0;
    let root =
        || Node::group(vec![cube(DVec3::ZERO), cube(DVec3::new(0.0, 50.0, 0.0)), cube(DVec3::new(900.0, 0.0, 0.0))]);
    // The visible leaves span 9.5 m to 60.5 m; the one outside of the view has no effect.
    let depth = |m: &DMat4, distance_m: f64| {
        let clip = *m * DVec4::new(0.0, 0.0, -distance_m, 1.0);
        clip.z / clip.w
    };
    camera.clip_from_eye = proj::perspective(1.0, 1.0, 1e5, 0.1);
    let m = cull(root(), &camera).camera.clip_from_eye;
    assert!(depth(&m, 9.5) <= 1.0 && depth(&m, 9.0) > 1.0 && depth(&m, 60.5) >= 0.0 && depth(&m, 63.0) < 0.0);
    // A callback changes the range.
    let scene = scene(root());
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    visitor.clamp_projection = Some(|near_m, far_m| (near_m.min(2.0), far_m * 10.0));
    visitor.cull(&scene, &camera, &mut stage);
    assert!((depth(&stage.camera.clip_from_eye, 1.96) - 1.0).abs() < 1e-9);
    // Without visible leaves, and with invalid bounds, the projection does not change.
    let empty = cull(Node::group(vec![]), &camera);
    assert_eq!(empty.camera.clip_from_eye, camera.clip_from_eye);
    let broken = Node::geode(vec![drawable(Aabb { min: DVec3::NAN, max: DVec3::NAN })]);
    let stage = cull(Node::group(vec![broken, cube(DVec3::ZERO)]), &camera);
    assert_eq!(stage.bins[0].leaves.len(), 2);
    assert!(stage.camera.clip_from_eye.is_finite() && depth(&stage.camera.clip_from_eye, 10.0) > 0.0);
}

/// Regression: such geometry was culled by the initial near plane, and appeared when it crossed that.
#[test]
fn geometry_nearer_than_the_near_plane_moves_it() {
    let mut camera = camera();
    camera.clip_from_eye = proj::perspective(1.0, 1.0, 1e5, 2.0);
    let things = || {
        let at = |y| {
            Node::geode(vec![drawable(
                Aabb { min: DVec3::splat(-0.2), max: DVec3::splat(0.2) }
                    .transformed(&DAffine3::from_translation(DVec3::Y * y)),
            )])
        };
        // One metre in front of the eye, ten metres, and one metre behind it.
        Node::group(vec![at(-9.0), at(0.0), at(-11.0)])
    };
    assert_eq!(slots(&cull(things(), &camera)), [1]);
    camera.settings.compute_near_far = ComputeNearFar::BoundingVolumes;
    camera.settings.near_far_ratio = 0.0;
    for orthographic in [false, true] {
        if orthographic {
            camera.clip_from_eye = proj::orthographic(-5.0, 5.0, -5.0, 5.0, 1e5, 2.0);
        }
        let stage = cull(things(), &camera);
        assert_eq!(slots(&stage), [0, 1], "{orthographic}");
        let clip = stage.camera.clip_from_eye * DVec4::new(0.0, 0.0, -0.8, 1.0);
        assert!(clip.z <= clip.w * (1.0 + 1e-6), "{orthographic}: {clip}");
    }
}

/// Depths are comparable only within one projection.
#[test]
fn cameras_with_the_same_projection_share_near_and_far_planes() {
    let like = |order, clear_depth| {
        let node = CameraNode { clear_depth, clear_color: None, ..CameraNode::new(order) };
        // One cube is nearer than all other leaves, one farther.
        Node::camera(node, vec![cube(DVec3::new(0.0, -5.0, 0.0)), cube(DVec3::new(0.0, 90.0, 0.0))])
    };
    for fitted in [ComputeNearFar::BoundingVolumes, ComputeNearFar::Off] {
        let mut camera = camera();
        camera.clip_from_eye = proj::perspective(1.0, 1.0, 1e5, 0.1);
        camera.settings.compute_near_far = fitted;
        camera.settings.near_far_ratio = 0.0;
        let all = vec![cube(DVec3::ZERO), cube(DVec3::new(0.0, -5.0, 0.0)), cube(DVec3::new(0.0, 90.0, 0.0))];
        let plain = cull(Node::group(all), &camera);
        let nested = cull(Node::group(vec![cube(DVec3::ZERO), like(RenderOrder::Nested, true)]), &camera);
        let over = cull(Node::group(vec![cube(DVec3::ZERO), like(RenderOrder::PostRender(0), false)]), &camera);
        let apart = cull(Node::group(vec![cube(DVec3::ZERO), like(RenderOrder::PostRender(0), true)]), &camera);
        for stage in [&nested, &over] {
            assert_eq!((stage.near_m, stage.far_m), (plain.near_m, plain.far_m));
            assert_eq!(stage.camera.clip_from_eye, plain.camera.clip_from_eye);
        }
        assert_eq!(nested.views[0].clip_from_eye, plain.camera.clip_from_eye);
        assert_eq!(over.post_render[0].camera.clip_from_eye, plain.camera.clip_from_eye);
        assert!(apart.near_m > 9.0 && apart.post_render[0].near_m < 5.0, "each has a separate range");
    }
}

#[test]
fn orthographic_views_start_at_the_near_plane() {
    let mut camera = camera();
    camera.clip_from_eye = proj::orthographic(-5.0, 5.0, -5.0, 5.0, 50.0, -20.0);
    let behind = || cube(DVec3::new(0.0, -20.0, 0.0));
    assert_eq!(slots(&cull(behind(), &camera)), [0]);
    assert!(slots(&cull(cube(DVec3::new(0.0, -40.0, 0.0)), &camera)).is_empty());
    camera.clip_from_eye = CullCamera::default().clip_from_eye;
    camera.settings.culling = CullingMode::NONE;
    assert!(slots(&cull(behind(), &camera)).is_empty());
}

#[test]
fn far_plane_culls_only_if_enabled() {
    let mut camera = camera();
    camera.clip_from_eye = proj::perspective(1.0, 1.0, 100.0, 0.1);
    let root = || Node::group(vec![cube(DVec3::ZERO), cube(DVec3::new(0.0, 200.0, 0.0))]);
    assert_eq!(slots(&cull(root(), &camera)), [0, 1]);
    camera.settings.culling = CullingMode::VIEW_FRUSTUM;
    assert_eq!(slots(&cull(root(), &camera)), [0]);
    camera.settings.culling = CullingMode::ENABLE_ALL;
    assert_eq!(slots(&cull(root(), &camera)), [0]);
    camera.clip_from_eye = proj::perspective_infinite_reverse(1.0, 1.0, 0.1);
    assert_eq!(slots(&cull(root(), &camera)), [0, 1], "an infinite projection has no far plane");
}

/// Regression: such a vertex moved the page's origin half way to it. The f32 error there enlarged all boxes and moved
/// the near plane.
#[test]
fn stray_vertex_does_not_move_the_near_plane() {
    let mut camera = camera();
    camera.settings.compute_near_far = ComputeNearFar::BoundingVolumes;
    let things = || vec![cube(DVec3::ZERO), cube(DVec3::new(0.0, 50.0, 0.0)), cube(DVec3::new(900.0, 0.0, 0.0))];
    let alone = cull(Node::group(things()), &camera);
    assert_eq!(slots(&alone), [0, 1]);
    for far_m in [1e12, 1e20, 1e35] {
        let astray = Aabb { min: DVec3::splat(-0.5), max: DVec3::new(0.5, far_m, far_m) };
        let with = cull(Node::group([things(), vec![Node::geode(vec![drawable(astray)])]].concat()), &camera);
        assert_eq!(slots(&with), [0, 1, 3], "the drawable with the stray vertex is drawn");
        assert_eq!(with.camera.clip_from_eye, alone.camera.clip_from_eye, "{far_m}");
        let gone = Node::transform(DAffine3::from_translation(DVec3::splat(far_m * 1e5)), vec![cube(DVec3::ZERO)]);
        let with = cull(Node::group([things(), vec![gone]].concat()), &camera);
        assert_eq!(slots(&with)[..2], [0, 1], "{far_m}");
        assert_eq!(with.camera.clip_from_eye, alone.camera.clip_from_eye, "{far_m}");
    }
}
