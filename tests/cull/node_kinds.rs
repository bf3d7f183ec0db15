//! Cull of the rarer node kinds: billboards, positioned state, occluders, queries, normal cones and callbacks.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::single_page::{camera, cube, cull, cull_scene, scene, slots};
use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DVec3, DVec4};
use kit::cull_scenes::{drawable, look_at};
use terrane::cull::{CullCamera, CullVisitor, PositionedTexGen, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{
    AutoScale, Billboard, BillboardMode, ClearNode, ClipNode, ConvexPlanarOccluder, CullAction, CullCallback,
    CullingMode, LightSource, LocalLights, Node, NodeKind, NormalCone, OcclusionQueryNode, ReferenceFrame, TexGenNode,
};
use terrane::state::{Light, Mode, TexGen};

#[test]
fn billboards_face_the_eye() {
    let flat = drawable(Aabb { min: DVec3::new(-1.0, 0.0, 0.0), max: DVec3::new(1.0, 0.0, 2.0) });
    let eye = DVec3::new(30.0, -40.0, 20.0);
    let look = look_at(eye, DVec3::ZERO, DVec3::Z);
    for mode in [
        BillboardMode::PointRotEye,
        BillboardMode::NoRotation,
        BillboardMode::PointRotWorld,
        BillboardMode::AxialRot { axis: DVec3::Z },
        BillboardMode::AxialRot { axis: DVec3::X },
    ] {
        let position = DVec3::new(1.0, 2.0, 3.0);
        let node = Node::new(NodeKind::Billboard(Box::new(Billboard {
            mode,
            drawables: vec![(position, flat.clone()), (DVec3::new(0.0, -500.0, 0.0), flat.clone())],
            ..Billboard::default()
        })));
        let turn = DAffine3::from_rotation_z(0.7);
        let stage = cull(Node::transform(turn, vec![node]), &look);
        assert_eq!(slots(&stage), [0], "the second billboard is behind the eye");
        let rows = stage.eye_from_drawable[stage.bins[0].leaves[0].matrix as usize];
        let apply =
            |v: DVec3, w: f64| {
                DVec3::from_array(rows.map(|r| {
                    f64::from(r[0]) * v.x + f64::from(r[1]) * v.y + f64::from(r[2]) * v.z + f64::from(r[3]) * w
                }))
            };
        let at = look.eye_from_world.transform_point3(turn.transform_point3(position));
        assert!(apply(DVec3::ZERO, 1.0).distance(at) < 1e-4);
        let (right, normal, up) = (apply(DVec3::X, 0.0), apply(DVec3::NEG_Y, 0.0), apply(DVec3::Z, 0.0));
        assert!(right.cross(-normal).distance(up) < 1e-5, "a rotation: {mode:?}");
        let to_eye = -at.normalize();
        match mode {
            BillboardMode::PointRotEye => assert!(normal.distance(DVec3::Z) + up.distance(DVec3::Y) < 1e-5),
            BillboardMode::NoRotation => {
                let to_eye_space = |v: DVec3| look.eye_from_world.transform_vector3(turn.transform_vector3(v));
                assert!(right.distance(to_eye_space(DVec3::X)) + up.distance(to_eye_space(DVec3::Z)) < 1e-5);
            }
            BillboardMode::PointRotWorld => assert!(normal.distance(to_eye) < 1e-4),
            BillboardMode::AxialRot { axis } => {
                let axis_in_eye = look.eye_from_world.transform_vector3(turn.transform_vector3(axis));
                assert!(up.distance(axis_in_eye) < 1e-5, "the z axis stays on the rotation axis");
                let best = (to_eye - axis_in_eye * axis_in_eye.dot(to_eye)).normalize();
                assert!(normal.distance(best) < 1e-4, "it faces the eye as far as the axis allows");
            }
        }
    }
}

/// Returns the scale and the depth in metres of a stage's only leaf.
fn scale_and_depth(stage: &RenderStage) -> (f64, f64) {
    let rows = stage.eye_from_drawable[stage.bins[0].leaves[0].matrix as usize];
    let column = DVec3::from_array(rows.map(|row| f64::from(row[0])));
    (column.length(), -f64::from(rows[2][3]))
}

#[test]
fn auto_scale_keeps_the_size_in_pixels_between_its_limits() {
    let shape = drawable(Aabb { min: DVec3::splat(-8.0), max: DVec3::splat(8.0) });
    let node_scale = 2.0;
    let cull_from = |distance: f64, max: f64, mode: BillboardMode| {
        let drawables = vec![(DVec3::X, shape.clone())];
        let billboard = Billboard { mode, auto_scale: Some(AutoScale { min: 0.02, max }), drawables };
        let node = Node::new(NodeKind::Billboard(Box::new(billboard)));
        let look = look_at(DVec3::new(node_scale, -distance, 0.0), DVec3::X * node_scale, DVec3::Z);
        (cull(Node::transform(DAffine3::from_scale(DVec3::splat(node_scale)), vec![node]), &look), look)
    };
    for mode in [BillboardMode::PointRotEye, BillboardMode::NoRotation, BillboardMode::PointRotWorld] {
        for distance in [10.0, 100.0, 1_000.0, 10_000.0] {
            let (stage, look) = cull_from(distance, 1.0, mode);
            let expected = (distance / look.px_per_radian()).clamp(0.02 * node_scale, node_scale);
            let (scale, depth) = scale_and_depth(&stage);
            assert!((scale / expected - 1.0).abs() < 1e-5, "{mode:?} at {distance} m: {scale} m, not {expected}");
            assert!((depth / distance - 1.0).abs() < 1e-5);
        }
    }
    // Near and far fit the drawable at its scale, not at the largest.
    let (stage, look) = cull_from(100.0, f64::INFINITY, BillboardMode::PointRotEye);
    let half = 8.0 * 100.0 / look.px_per_radian();
    let (near, far) = (stage.near_m, stage.far_m);
    assert!((near - (100.0 - half)).abs() < 0.01 && (far - (100.0 + half)).abs() < 0.01, "{near} to {far}");
}

/// Regression: the bounds were those of the drawable in the node's frame, but a billboard is scaled along the axes of the
/// screen.
#[test]
fn billboards_below_uneven_scales_are_visible_up_to_the_edge() {
    let look = look_at(DVec3::new(-100.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z);
    let is_seen = |node: Node| !slots(&cull(node, &look)).is_empty();
    // In the image the billboard extends 20 m to both sides, along y of the world.
    let flat = drawable(Aabb { min: DVec3::new(-1.0, 0.0, -1.0), max: DVec3::new(1.0, 0.0, 1.0) });
    let at = |y: f64| DAffine3::from_translation(DVec3::new(0.0, y, 0.0));
    let billboard = |y: f64| {
        let drawables = vec![(DVec3::ZERO, flat.clone())];
        let node = Node::new(NodeKind::Billboard(Box::new(Billboard { drawables, ..Billboard::default() })));
        Node::transform(at(y) * DAffine3::from_scale(DVec3::new(20.0, 1.0, 1.0)), vec![node])
    };
    let edge = (1..1000).map(f64::from).find(|y| !is_seen(Node::transform(at(*y), vec![cube(DVec3::ZERO)]))).unwrap();
    assert!(is_seen(billboard(edge + 12.0)), "{edge}");
    assert!(!is_seen(billboard(edge + 60.0)));
}

#[test]
fn lights_and_planes_are_in_eye_space_of_their_stage() {
    let light = |number, position, frame| {
        let light = Light { number, position, ..Light::default() };
        Node::new(NodeKind::LightSource(Box::new(LightSource { light, frame })))
    };
    let clip = Node {
        children: vec![cube(DVec3::ZERO)],
        ..Node::new(NodeKind::ClipNode(Box::new(ClipNode {
            planes: vec![(2, DVec4::new(0.0, 1.0, 0.0, 0.0))],
            frame: ReferenceFrame::Relative,
        })))
    };
    let up = DAffine3::from_translation(DVec3::new(0.0, 0.0, 4.0));
    let texgen = TexGen::EyeLinear(TexGen::planes([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]));
    let far_away = DAffine3::from_translation(DVec3::new(0.0, -1e6, 0.0));
    let stage = cull(
        Node::group(vec![
            Node::transform(up, vec![light(3, [1.0, 0.0, 0.0, 1.0], ReferenceFrame::Relative), clip]),
            light(1, [0.0, 1.0, 0.0, 0.0], ReferenceFrame::Relative),
            // The light lies behind the eye and still applies.
            Node::transform(far_away, vec![light(0, [0.0, 0.0, 1.0, 0.0], ReferenceFrame::Absolute)]),
            Node::new(NodeKind::TexGenNode(Box::new(TexGenNode { unit: 1, texgen }))),
            Node::new(NodeKind::ClearNode(ClearNode { color: Some([0.5; 4]) })),
        ]),
        &camera(),
    );
    let lights: Vec<_> = stage.lights.iter().map(|l| (l.light.number, l.light.position.map(|p| p.round()))).collect();
    assert_eq!(lights, [(3, [1.0, 4.0, -10.0, 1.0]), (1, [0.0, 0.0, -1.0, 0.0]), (0, [0.0, 0.0, 1.0, 0.0])]);
    let [plane] = stage.clip_planes[..] else { panic!("expected one plane") };
    assert_eq!(plane.number, 2);
    // y >= 0 in the world is a depth of more than 10 m in eye space: -z - 10 >= 0.
    assert!(plane.plane.distance(DVec4::new(0.0, 0.0, -1.0, -10.0)) < 1e-9, "{}", plane.plane);
    assert!(stage.state_sets[0].mode(Mode::ClipPlane(2)) && !stage.state_sets[0].mode(Mode::ClipPlane(1)));
    assert_eq!(stage.clear_node, Some(Some([0.5; 4])));
    let PositionedTexGen { unit: 1, texgen: TexGen::EyeLinear([s, t, r, q]), view: 0 } = stage.texgens[0] else {
        panic!("expected eye-linear coordinates")
    };
    assert!(DVec4::from_array(s.map(f64::from)).distance(DVec4::X) < 1e-6);
    assert!(DVec4::from_array(t.map(f64::from)).distance(DVec4::Y) < 1e-6);
    assert_eq!([r, q], [[0.0; 4], [0.0, 0.0, 0.0, 1.0]]);
}

#[test]
fn local_lights_belong_to_the_states_of_the_leaves_below() {
    let lamp = |x: f64| Light { position: [x, 0.0, 0.0, 1.0], number: 7, ..Light::default() };
    let lit =
        |lights: Vec<Light>, children| Node { children, ..Node::new(NodeKind::LocalLights(LocalLights { lights })) };
    let at = |x: f64| cube(DVec3::new(x, 0.0, 0.0));
    let up = DAffine3::from_translation(DVec3::new(0.0, 0.0, 4.0));
    let many = (0..20u8).map(|i| lamp(f64::from(i))).collect();
    let stage = cull(
        Node::group(vec![
            at(0.0),
            Node::transform(up, vec![lit(vec![lamp(1.0)], vec![at(0.0), lit(vec![lamp(2.0)], vec![at(1.0)])])]),
            // Behind the eye, so that its lights are not met either.
            lit(vec![lamp(3.0)], vec![cube(DVec3::new(0.0, -100.0, 0.0))]),
            lit(many, vec![lit(vec![lamp(-1.0)], vec![at(2.0)])]),
        ]),
        &camera(),
    );
    let lights_of = |range: &std::ops::Range<usize>| -> Vec<(u8, [f64; 3])> {
        let lights = &stage.local_lights[range.clone()];
        lights.iter().map(|l| (l.light.number, [0, 1, 2].map(|i| l.light.position[i].round()))).collect()
    };
    let groups: Vec<_> = stage.light_groups.iter().map(lights_of).collect();
    let (first, second) = ((0, [1.0, 4.0, -10.0]), (0, [2.0, 4.0, -10.0]));
    assert_eq!(groups[..2], [vec![first], vec![second, first]]);
    // A group has as many lights as shine on one drawable, own ones first.
    assert_eq!(groups[2..].iter().map(Vec::len).collect::<Vec<_>>(), [LocalLights::MAX; 2]);
    assert_eq!(groups[3][..2], [(0, [-1.0, 0.0, -10.0]), (0, [0.0, 0.0, -10.0])]);
    let mut leaves: Vec<_> = stage.bins.iter().flat_map(|bin| &bin.leaves).collect();
    leaves.sort_by_key(|leaf| leaf.slot.0);
    let lights: Vec<u32> = leaves.iter().map(|leaf| stage.lights_of_state[leaf.state as usize]).collect();
    assert_eq!(lights, [0, 1, 2, 4]);
}

#[test]
fn occluders_hide_nodes_behind_them_if_enabled() {
    let corners = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)].map(|(x, z)| DVec3::new(x, -4.0, z));
    let wall = |mask| {
        let occluder = ConvexPlanarOccluder { corners: corners.to_vec(), holes: vec![] };
        Node { mask, ..Node::new(NodeKind::OccluderNode(Box::new(occluder))) }
    };
    let things = || vec![cube(DVec3::ZERO), cube(DVec3::new(0.0, -6.0, 0.0)), cube(DVec3::new(5.0, 2.0, 0.0))];
    let with = |wall: Node| Node::group(things().into_iter().chain([wall]).collect());
    let stage = cull(with(wall(u32::MAX)), &camera());
    assert_eq!((slots(&stage), stage.counters.occluded), (vec![1, 2], 1));
    let mut off = camera();
    off.settings.culling = CullingMode::VIEW_FRUSTUM_SIDES;
    assert_eq!(slots(&cull(with(wall(u32::MAX)), &off)), [0, 1, 2]);
    let mut masked = camera();
    masked.settings.cull_mask = 1;
    assert_eq!(slots(&cull(with(wall(2)), &masked)), [0, 1, 2], "the camera does not see the wall");
    let switched = Node { children: vec![wall(u32::MAX)], ..Node::new(NodeKind::Switch(vec![false])) };
    assert_eq!(slots(&cull(with(switched), &camera())), [0, 1, 2]);
}

#[test]
fn one_eye_issues_an_occlusion_query_and_prefetch_culls_issue_none() {
    let query = OcclusionQueryNode { query_frames: 2, ..OcclusionQueryNode::default() };
    let mut node = Node::new(NodeKind::OcclusionQueryNode(Box::new(query)));
    node.children = vec![cube(DVec3::ZERO)];
    let scene = scene(Node::group(vec![node]));
    let mut eyes = [CullVisitor::new(), CullVisitor::new()];
    let mut asks = |eye: usize, frame, ahead_frames| {
        let mut stage = RenderStage::new();
        eyes[eye].cull(&scene, &CullCamera { frame, ahead_frames, ..camera() }, &mut stage);
        stage.queries.len()
    };
    assert_eq!([asks(0, 1, 0), asks(1, 1, 0)], [1, 0]);
    assert_eq!([asks(1, 3, 30), asks(0, 3, 30)], [0, 0], "prefetch culls are not drawn, so they issue no query");
    assert_eq!(
        [asks(1, 3, 0), asks(0, 3, 0), asks(0, 4, 0)],
        [0, 1, 0],
        "a prefetch cull does not use up the query of its frame"
    );
    // The first eye has not culled for a long time, so the second one issues the query.
    assert_eq!([asks(1, 200, 0), asks(0, 200, 0)], [1, 0]);
}

#[test]
fn orthographic_views_ignore_distance_for_small_features() {
    let mut far = look_at(DVec3::new(0.0, -20_000.0, 0.0), DVec3::ZERO, DVec3::Z);
    far.settings.culling = CullingMode::DEFAULT | CullingMode::SMALL_FEATURE;
    assert!(slots(&cull(cube(DVec3::ZERO), &far)).is_empty());
    far.clip_from_eye = proj::orthographic(-5.0, 5.0, -5.0, 5.0, 50_000.0, 0.1);
    assert_eq!(slots(&cull(cube(DVec3::ZERO), &far)), [0]);
}

#[test]
fn camera_with_an_empty_mask_draws_nothing() {
    let mut blind = camera();
    blind.settings.cull_mask = 0;
    let wall = ConvexPlanarOccluder { corners: vec![DVec3::ZERO, DVec3::X, DVec3::Z], holes: vec![] };
    let wall = || Node::new(NodeKind::OccluderNode(Box::new(wall.clone())));
    let masked = Node { mask: 2, ..cube(DVec3::ZERO) };
    for things in [vec![cube(DVec3::ZERO), wall()], vec![cube(DVec3::ZERO), masked]] {
        let root = Node::group(things);
        assert!(!slots(&cull(root.clone(), &camera())).is_empty());
        assert!(slots(&cull(root, &blind)).is_empty());
    }
}

#[test]
fn clusters_that_face_away_are_culled() {
    let cone = NormalCone { control_point: DVec3::ZERO, normal: DVec3::Y, min_cosine: -0.5, radius_m: 1.0 };
    let mut away = drawable(Aabb { min: DVec3::splat(-0.5), max: DVec3::splat(0.5) });
    away.cluster = Some(cone);
    let mut toward = away.clone();
    toward.cluster = Some(NormalCone { normal: DVec3::NEG_Y, ..cone });
    let root = || Node::geode(vec![away.clone(), toward.clone()]);
    assert_eq!(slots(&cull(root(), &camera())), [1]);
    let turned = Node::transform(DAffine3::from_rotation_z(std::f64::consts::PI), vec![root()]);
    assert_eq!(slots(&cull(turned, &camera())), [0]);
    let mut off = camera();
    off.settings.culling = CullingMode::VIEW_FRUSTUM_SIDES;
    assert_eq!(slots(&cull(root(), &off)), [0, 1]);
}

/// Regression: the position of the eye was used, which has no meaning in an orthographic view.
#[test]
fn clusters_face_away_from_the_direction_of_orthographic_views() {
    let cone = |normal| NormalCone { control_point: DVec3::ZERO, normal, min_cosine: -0.1, radius_m: 1.0 };
    let with = |normal| {
        let mut drawable = drawable(Aabb { min: DVec3::splat(-0.5), max: DVec3::splat(0.5) });
        drawable.cluster = Some(cone(normal));
        drawable
    };
    // The camera looks along +y from y = -10, so facing clusters have normals along -y.
    let mut flat = camera();
    flat.clip_from_eye = proj::orthographic(-40.0, 40.0, -40.0, 40.0, 100.0, -100.0);
    // Positions around the eye. From a point, the second and the fourth cluster would face away.
    let positions = [DVec3::ZERO, DVec3::new(0.0, -30.0, 0.0), DVec3::new(0.0, 30.0, 0.0), DVec3::new(30.0, -9.0, 0.0)];
    let root = |normal: DVec3| {
        let at = |position: DVec3| {
            let geode = Node::geode(vec![with(normal)]);
            Node::transform(DAffine3::from_translation(position), vec![geode])
        };
        Node::group(positions.map(at).into())
    };
    let facing = DVec3::new(-0.1, -1.0, 0.0).normalize();
    assert_eq!(slots(&cull(root(facing), &flat)), [0, 1, 2, 3]);
    assert!(slots(&cull(root(-facing), &flat)).is_empty());
}

#[test]
fn callbacks_can_skip_nodes_and_inactive_culling_visits_them() {
    let asked = Arc::new(AtomicU32::new(0));
    let count = asked.clone();
    let mut skipped = cube(DVec3::ZERO);
    skipped.cull_callback = Some(CullCallback(Arc::new(move |info| {
        count.fetch_add(1, Ordering::Relaxed);
        assert!((info.distance_m - 10.0).abs() < 1e-6 && info.eye_in_page.distance(DVec3::new(0.0, -10.0, 0.0)) < 1e-6);
        if info.frame == 7 { CullAction::Skip } else { CullAction::Traverse }
    })));
    let root = scene(Node::group(vec![cube(DVec3::ZERO), skipped]));
    assert_eq!(slots(&cull_scene(&root, &camera())), [0, 1]);
    assert_eq!(slots(&cull_scene(&root, &CullCamera { frame: 7, ..camera() })), [0]);
    assert_eq!(asked.load(Ordering::Relaxed), 6);

    let outside = DVec3::new(100.0, 0.0, 0.0);
    let seen = |active| {
        let node = Node { culling_active: active, ..Node::group(vec![]) };
        let counters = cull(Node::group(vec![node, cube(outside)]), &camera()).counters;
        counters.nodes_visited
    };
    assert!(seen(false) > seen(true));
}

/// Programs may need this for drawables that are larger than their bounds. Here they lie outside of the view, behind the
/// eye and behind an occluder, or are too small.
#[test]
fn nodes_with_inactive_culling_are_never_culled() {
    let aside = DVec3::new(100.0, 0.0, 0.0);
    let behind_eye = DVec3::new(0.0, -100.0, 0.0);
    let bounds = |center: DVec3, half: f64| Aabb { min: center - half, max: center + half };
    let kinds = |active: bool| {
        let of = |node: Node| Node { culling_active: active, ..node };
        let billboard =
            Billboard { drawables: vec![(aside, drawable(bounds(DVec3::ZERO, 0.5)))], ..Billboard::default() };
        let corner = |x, z| DVec3::new(x, 3.0, z);
        let corners = vec![corner(-5.0, -5.0), corner(5.0, -5.0), corner(5.0, 5.0), corner(-5.0, 5.0)];
        let wall = ConvexPlanarOccluder { corners, holes: vec![] };
        Node::group(vec![
            of(Node::geode(vec![drawable(bounds(aside, 0.5)), drawable(bounds(behind_eye, 0.5))])),
            of(Node::geode(vec![drawable(bounds(DVec3::ZERO, 1e-5))])),
            Node::group(vec![of(cube(DVec3::new(0.0, 8.0, 0.0)))]),
            of(Node::new(NodeKind::Billboard(Box::new(billboard)))),
            Node::new(NodeKind::OccluderNode(Box::new(wall))),
        ])
    };
    let mut camera = camera();
    camera.settings.culling = CullingMode::ENABLE_ALL;
    assert!(slots(&cull(kinds(true), &camera)).is_empty());
    assert_eq!(slots(&cull(kinds(false), &camera)), [0, 1, 2, 3, 4]);
    camera.settings.cull_mask = 0;
    assert!(slots(&cull(kinds(false), &camera)).is_empty());
}
