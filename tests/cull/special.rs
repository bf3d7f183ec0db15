//! The rarer node kinds in cull: cameras, projections, absolute transforms, billboards, positioned state, occluders,
//! normal cones, callbacks, near and far.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DMat4, DVec3, DVec4};
use kit::cull_scenes::{drawable, look_at, page};
use terrane::cull::{CullCamera, CullVisitor, CullingMode, PositionedLight, PositionedTexGen, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{
    Attachment, Billboard, BillboardMode, CameraNode, CameraTarget, ClearNode, ClipNode, ComputeNearFar,
    ConvexPlanarOccluder, CullAction, CullCallback, CullSettings, Inherit, LightSource, Node, NodeKind, NormalCone,
    OcclusionQueryNode, ReferenceFrame, RenderOrder, Scene, TexGenNode,
};
use terrane::state::{Light, Mode, StateSet, TexGen, TextureFormat, TextureObject};

fn cube(center: DVec3) -> Node {
    Node::geode(vec![drawable(Aabb { min: center - 0.5, max: center + 0.5 })])
}

/// Looking along +y from 10 m before the origin, z up.
fn camera() -> CullCamera {
    look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z)
}

fn scene(root: Node) -> Scene {
    let mut scene = Scene::new();
    scene.add_root(page(root, 0));
    scene
}

fn cull(root: Node, camera: &CullCamera) -> RenderStage {
    cull_scene(&scene(root), camera)
}

fn cull_scene(scene: &Scene, camera: &CullCamera) -> RenderStage {
    let mut stage = RenderStage::new();
    let mut visitor = CullVisitor::new();
    for _ in 0..3 {
        visitor.cull(scene, camera, &mut stage);
    }
    stage
}

fn slots(stage: &RenderStage) -> Vec<u32> {
    let mut slots: Vec<u32> = stage.bins.iter().flat_map(|b| b.leaves.iter().map(|l| l.slot.0)).collect();
    slots.sort_unstable();
    slots
}

/// Returns a leaf's origin in eye space.
fn origin_in_eye(stage: &RenderStage, slot: u32) -> DVec3 {
    let leaf = stage.bins.iter().flat_map(|b| &b.leaves).find(|l| l.slot.0 == slot).unwrap();
    let rows = stage.eye_from_drawable[leaf.matrix as usize];
    DVec3::new(f64::from(rows[0][3]), f64::from(rows[1][3]), f64::from(rows[2][3]))
}

#[test]
fn a_projection_holds_below_it_only() {
    // Something 8 m to the right of the axis at 10 m: outside of 60 degrees, inside of 120.
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
fn views_nest_and_end() {
    let wide = |children| Node {
        children,
        ..Node::new(NodeKind::Projection(proj::perspective_infinite_reverse(2.0, 1.0, 0.1)))
    };
    // The inner one is met before the outer one has its first leaf.
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
fn absolute_transforms_are_in_the_eyes_frame() {
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
    // Its content does not count for the outer range: 9.5 to 10.5 m.
    assert!((stage.near_m - 9.5).abs() < 1e-3 && (stage.far_m - 10.5).abs() < 1e-3);
    // Relative: below what is above.
    let mut relative = CameraNode::new(RenderOrder::Nested);
    relative.view = DAffine3::from_translation(DVec3::new(1.0, 0.0, 0.0));
    let stage = cull(Node::camera(relative, vec![cube(DVec3::ZERO)]), &camera());
    assert!(origin_in_eye(&stage, 0).distance(DVec3::new(1.0, 0.0, -10.0)) < 1e-5);
}

#[test]
fn cameras_before_and_after_have_stages_of_their_own() {
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
    let [first, second] = &stage.pre_render[..] else { panic!("two") };
    assert_eq!((slots(first), slots(&first.pre_render[0]), slots(second)), (vec![5], vec![4], vec![2]));
    assert_eq!(second.state_sets[0].color, [1.0, 0.0, 0.0, 1.0], "state is inherited");
    assert_eq!(second.camera.viewport_px, [64, 32]);
    assert_eq!((stage.post_render.len(), slots(&stage.post_render[0])), (1, vec![0, 1]));
    assert_eq!(stage.counters.leaves, 1 + 1 + 1 + 1 + 2);
}

#[test]
fn stages_inherit_lights_where_they_shine() {
    let lamp = |number, z| {
        let light = Light { number, position: [0.0, 0.0, z, 1.0], ..Light::default() };
        Node::new(NodeKind::LightSource(Box::new(LightSource { light, frame: ReferenceFrame::Relative })))
    };
    let mut other = CameraNode::new(RenderOrder::PreRender(0));
    other.frame = ReferenceFrame::Absolute;
    other.view = look_at(DVec3::new(50.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z).eye_from_world;
    let below = Node::camera(other, vec![cube(DVec3::ZERO), lamp(2, 9.0)]);
    // Met after the camera, and all the same.
    let stage = cull(Node::group(vec![below, lamp(1, 4.0), lamp(2, 5.0)]), &camera());
    let of = |stage: &RenderStage| {
        // The last light with a number counts.
        let place = |l: &PositionedLight| (l.light.number, l.light.position.map(f64::round));
        stage.lights.iter().map(place).collect::<std::collections::BTreeMap<_, _>>().into_iter().collect::<Vec<_>>()
    };
    assert_eq!(of(&stage), [(1, [0.0, 4.0, -10.0, 1.0]), (2, [0.0, 5.0, -10.0, 1.0])]);
    assert_eq!(of(&stage.pre_render[0]), [(1, [0.0, 4.0, -50.0, 1.0]), (2, [0.0, 9.0, -50.0, 1.0])]);
}

#[test]
fn cameras_inside_themselves_end() {
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

#[test]
fn billboards_face_the_eye() {
    let flat = drawable(Aabb { min: DVec3::new(-1.0, 0.0, 0.0), max: DVec3::new(1.0, 0.0, 2.0) });
    let eye = DVec3::new(30.0, -40.0, 20.0);
    let look = look_at(eye, DVec3::ZERO, DVec3::Z);
    for mode in [
        BillboardMode::PointRotEye,
        BillboardMode::PointRotWorld,
        BillboardMode::AxialRot { axis: DVec3::Z },
        BillboardMode::AxialRot { axis: DVec3::X },
    ] {
        let position = DVec3::new(1.0, 2.0, 3.0);
        let node = Node::new(NodeKind::Billboard(Box::new(Billboard {
            mode,
            drawables: vec![(position, flat.clone()), (DVec3::new(0.0, -500.0, 0.0), flat.clone())],
        })));
        let turn = DAffine3::from_rotation_z(0.7);
        let stage = cull(Node::transform(turn, vec![node]), &look);
        assert_eq!(slots(&stage), [0], "the other is behind the eye");
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
            BillboardMode::PointRotWorld => assert!(normal.distance(to_eye) < 1e-4),
            BillboardMode::AxialRot { axis } => {
                let axis_in_eye = look.eye_from_world.transform_vector3(turn.transform_vector3(axis));
                assert!(up.distance(axis_in_eye) < 1e-5, "its z stays on the axis");
                let best = (to_eye - axis_in_eye * axis_in_eye.dot(to_eye)).normalize();
                assert!(normal.distance(best) < 1e-4, "as near to the eye as that allows");
            }
        }
    }
}

/// The bounds were those of the drawable in the node's frame, whose scales it has along the screen's axes.
#[test]
fn billboards_below_uneven_scales_stay_while_they_are_in_sight() {
    let look = look_at(DVec3::new(-100.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z);
    let is_seen = |node: Node| !slots(&cull(node, &look)).is_empty();
    // 20 m to both sides in the image, which are y of the world.
    let flat = drawable(Aabb { min: DVec3::new(-1.0, 0.0, -1.0), max: DVec3::new(1.0, 0.0, 1.0) });
    let at = |y: f64| DAffine3::from_translation(DVec3::new(0.0, y, 0.0));
    let billboard = |y: f64| {
        let drawables = vec![(DVec3::ZERO, flat.clone())];
        let node = Node::new(NodeKind::Billboard(Box::new(Billboard { mode: BillboardMode::PointRotEye, drawables })));
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
            // Behind the eye, and shining all the same.
            Node::transform(far_away, vec![light(0, [0.0, 0.0, 1.0, 0.0], ReferenceFrame::Absolute)]),
            Node::new(NodeKind::TexGenNode(Box::new(TexGenNode { unit: 1, texgen }))),
            Node::new(NodeKind::ClearNode(ClearNode { color: Some([0.5; 4]) })),
        ]),
        &camera(),
    );
    let lights: Vec<_> = stage.lights.iter().map(|l| (l.light.number, l.light.position.map(|p| p.round()))).collect();
    assert_eq!(lights, [(3, [1.0, 4.0, -10.0, 1.0]), (1, [0.0, 0.0, -1.0, 0.0]), (0, [0.0, 0.0, 1.0, 0.0])]);
    let [plane] = stage.clip_planes[..] else { panic!("one") };
    assert_eq!(plane.number, 2);
    // y >= 0 in the world is deeper than 10 m: -z - 10 >= 0.
    assert!(plane.plane.distance(DVec4::new(0.0, 0.0, -1.0, -10.0)) < 1e-9, "{}", plane.plane);
    assert!(stage.state_sets[0].mode(Mode::ClipPlane(2)) && !stage.state_sets[0].mode(Mode::ClipPlane(1)));
    assert_eq!(stage.clear_node, Some(Some([0.5; 4])));
    let PositionedTexGen { unit: 1, texgen: TexGen::EyeLinear([s, t, r, q]), view: 0 } = stage.texgens[0] else {
        panic!("eye linear")
    };
    assert!(DVec4::from_array(s.map(f64::from)).distance(DVec4::X) < 1e-6);
    assert!(DVec4::from_array(t.map(f64::from)).distance(DVec4::Y) < 1e-6);
    assert_eq!([r, q], [[0.0; 4], [0.0, 0.0, 0.0, 1.0]]);
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
    assert_eq!([asks(1, 3, 30), asks(0, 3, 30)], [0, 0], "what nobody draws has no answer");
    assert_eq!([asks(1, 3, 0), asks(0, 3, 0), asks(0, 4, 0)], [0, 1, 0], "and takes nobody's turn");
    // The first has not come for long.
    assert_eq!([asks(1, 200, 0), asks(0, 200, 0)], [1, 0]);
}

#[test]
fn parallel_rays_make_nothing_smaller() {
    let mut far = look_at(DVec3::new(0.0, -20_000.0, 0.0), DVec3::ZERO, DVec3::Z);
    far.settings.culling = CullingMode::DEFAULT | CullingMode::SMALL_FEATURE;
    assert!(slots(&cull(cube(DVec3::ZERO), &far)).is_empty());
    far.clip_from_eye = proj::orthographic(-5.0, 5.0, -5.0, 5.0, 50_000.0, 0.1);
    assert_eq!(slots(&cull(cube(DVec3::ZERO), &far)), [0]);
}

#[test]
fn a_camera_with_no_mask_sees_nothing() {
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
fn faces_that_look_away_are_dropped() {
    let cone = NormalCone { control_point: DVec3::ZERO, normal: DVec3::Y, least_cosine: -0.5, radius_m: 1.0 };
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

/// They were computed from the eye's position, which an orthographic view does not have.
#[test]
fn faces_look_away_from_parallel_rays() {
    let cone = |normal| NormalCone { control_point: DVec3::ZERO, normal, least_cosine: -0.1, radius_m: 1.0 };
    let with = |normal| {
        let mut drawable = drawable(Aabb { min: DVec3::splat(-0.5), max: DVec3::splat(0.5) });
        drawable.cluster = Some(cone(normal));
        drawable
    };
    // Looks along +y, from y = -10; what faces it looks along -y.
    let mut flat = camera();
    flat.clip_from_eye = proj::orthographic(-40.0, 40.0, -40.0, 40.0, 100.0, -100.0);
    // Beside the eye, behind it, and beyond: seen from a point, the second and fourth would look away.
    let places = [DVec3::ZERO, DVec3::new(0.0, -30.0, 0.0), DVec3::new(0.0, 30.0, 0.0), DVec3::new(30.0, -9.0, 0.0)];
    let root = |normal: DVec3| {
        let at = |place: DVec3| {
            let geode = Node::geode(vec![with(normal)]);
            Node::transform(DAffine3::from_translation(place), vec![geode])
        };
        Node::group(places.map(at).into())
    };
    let facing = DVec3::new(-0.1, -1.0, 0.0).normalize();
    assert_eq!(slots(&cull(root(facing), &flat)), [0, 1, 2, 3]);
    assert!(slots(&cull(root(-facing), &flat)).is_empty());
}

#[test]
fn callbacks_decide_and_inactive_nodes_are_not_culled() {
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

/// Drawables that are larger than their bounds say, as a program may make them: here simply outside, behind the eye, far
/// too small and behind an occluder.
#[test]
fn inactive_nodes_are_not_culled() {
    let aside = DVec3::new(100.0, 0.0, 0.0);
    let behind_eye = DVec3::new(0.0, -100.0, 0.0);
    let bounds = |center: DVec3, half: f64| Aabb { min: center - half, max: center + half };
    let kinds = |active: bool| {
        let of = |node: Node| Node { culling_active: active, ..node };
        let billboard = Billboard {
            mode: BillboardMode::PointRotEye,
            drawables: vec![(aside, drawable(bounds(DVec3::ZERO, 0.5)))],
        };
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

/// It once moved the page's origin half way to it, whose f32 error enlarged all boxes and pushed the near plane away.
#[test]
fn a_stray_vertex_does_not_affect_its_neighbours() {
    let mut camera = camera();
    camera.settings.compute_near_far = ComputeNearFar::BoundingVolumes;
    let things = || vec![cube(DVec3::ZERO), cube(DVec3::new(0.0, 50.0, 0.0)), cube(DVec3::new(900.0, 0.0, 0.0))];
    let alone = cull(Node::group(things()), &camera);
    assert_eq!(slots(&alone), [0, 1]);
    for far_m in [1e12, 1e20, 1e35] {
        let astray = Aabb { min: DVec3::splat(-0.5), max: DVec3::new(0.5, far_m, far_m) };
        let with = cull(Node::group([things(), vec![Node::geode(vec![drawable(astray)])]].concat()), &camera);
        assert_eq!(slots(&with), [0, 1, 3], "it is drawn, whatever is seen of it");
        assert_eq!(with.camera.clip_from_eye, alone.camera.clip_from_eye, "{far_m}");
        let gone = Node::transform(DAffine3::from_translation(DVec3::splat(far_m * 1e5)), vec![cube(DVec3::ZERO)]);
        let with = cull(Node::group([things(), vec![gone]].concat()), &camera);
        assert_eq!(slots(&with)[..2], [0, 1], "{far_m}");
        assert_eq!(with.camera.clip_from_eye, alone.camera.clip_from_eye, "{far_m}");
    }
}

#[test]
fn near_and_far_follow_the_kept_leaves() {
    let mut camera = camera();
    camera.settings.compute_near_far = ComputeNearFar::BoundingVolumes;
    camera.settings.near_far_ratio = 0.0;
    let root =
        || Node::group(vec![cube(DVec3::ZERO), cube(DVec3::new(0.0, 50.0, 0.0)), cube(DVec3::new(900.0, 0.0, 0.0))]);
    // From 9.5 m to 60.5 m; what is outside does not count.
    let depth = |m: &DMat4, distance_m: f64| {
        let clip = *m * DVec4::new(0.0, 0.0, -distance_m, 1.0);
        clip.z / clip.w
    };
    camera.clip_from_eye = proj::perspective(1.0, 1.0, 1e5, 0.1);
    let m = cull(root(), &camera).camera.clip_from_eye;
    assert!(depth(&m, 9.5) <= 1.0 && depth(&m, 9.0) > 1.0 && depth(&m, 60.5) >= 0.0 && depth(&m, 63.0) < 0.0);
    // A callback decides instead.
    let scene = scene(root());
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    visitor.clamp_projection = Some(|near_m, far_m| (near_m.min(2.0), far_m * 10.0));
    visitor.cull(&scene, &camera, &mut stage);
    assert!((depth(&stage.camera.clip_from_eye, 1.96) - 1.0).abs() < 1e-9);
    // Nothing seen, or nonsense: as given.
    let empty = cull(Node::group(vec![]), &camera);
    assert_eq!(empty.camera.clip_from_eye, camera.clip_from_eye);
    let broken = Node::geode(vec![drawable(Aabb { min: DVec3::NAN, max: DVec3::NAN })]);
    let stage = cull(Node::group(vec![broken, cube(DVec3::ZERO)]), &camera);
    assert_eq!(stage.bins[0].leaves.len(), 2);
    assert!(stage.camera.clip_from_eye.is_finite() && depth(&stage.camera.clip_from_eye, 10.0) > 0.0);
}

/// It was culled by the near plane as given, and came in where it crossed that.
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
        // A metre before the eye, ten, and a metre behind it.
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

/// Things that are compared by depth are so in one projection.
#[test]
fn cameras_that_keep_the_projection_have_near_and_far_in_common() {
    let like = |order, clear_depth| {
        let node = CameraNode { clear_depth, clear_color: None, ..CameraNode::new(order) };
        // Nearer, and farther, than all other leaves.
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
        assert!(apart.near_m > 9.0 && apart.post_render[0].near_m < 5.0, "each has depths of its own");
    }
}

#[test]
fn parallel_rays_begin_at_the_near_plane() {
    let mut camera = camera();
    camera.clip_from_eye = proj::orthographic(-5.0, 5.0, -5.0, 5.0, 50.0, -20.0);
    let behind = || cube(DVec3::new(0.0, -20.0, 0.0));
    assert_eq!(slots(&cull(behind(), &camera)), [0]);
    assert!(slots(&cull(cube(DVec3::new(0.0, -40.0, 0.0)), &camera)).is_empty());
    camera.clip_from_eye = CullCamera::default().clip_from_eye;
    camera.settings.culling = CullingMode::NONE;
    assert!(slots(&cull(behind(), &camera)).is_empty());
}

/// A Lod that is between two levels: the second cull comes before its fade has ended.
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
    // Below a camera with its own stage, each level has its part of the pixels.
    let over = |lod| Node::camera(CameraNode::new(RenderOrder::PostRender(0)), vec![lod]);
    let stage = fading(over, || vec![cube(DVec3::ZERO)]);
    let below = &stage.post_render[0];
    let bands: Vec<u32> = below.bins[0].leaves.iter().map(|l| below.fade_of_state[l.state as usize]).collect();
    assert!(bands.len() == 2 && bands[0] != bands[1] && !bands.contains(&0), "{bands:?}");
    // Siblings after an inner projection, and after the Lod, are drawn with the outer projection.
    let projection = || NodeKind::Projection(proj::perspective_infinite_reverse(1.2, 1.0, 0.1));
    let with = |children| Node { children, ..Node::new(projection()) };
    let around = |lod| with(vec![lod, cube(DVec3::new(1.0, 0.0, 0.0))]);
    let stage = fading(around, || vec![with(vec![cube(DVec3::ZERO)]), cube(DVec3::new(-1.0, 0.0, 0.0))]);
    let view_of = |slot: u32| {
        let leaf = stage.bins.iter().flat_map(|b| &b.leaves).find(|l| l.slot.0 == slot).unwrap();
        (stage.view_of_state[leaf.state as usize], stage.fade_of_state[leaf.state as usize] != 0)
    };
    assert_eq!([0, 1, 2, 3].map(view_of), [(1, true), (2, true), (1, true), (1, false)]);
}

#[test]
fn the_last_light_with_a_number_counts_and_texture_planes_are_inherited() {
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

#[test]
fn a_far_plane_culls_where_asked() {
    let mut camera = camera();
    camera.clip_from_eye = proj::perspective(1.0, 1.0, 100.0, 0.1);
    let root = || Node::group(vec![cube(DVec3::ZERO), cube(DVec3::new(0.0, 200.0, 0.0))]);
    assert_eq!(slots(&cull(root(), &camera)), [0, 1]);
    camera.settings.culling = CullingMode::VIEW_FRUSTUM;
    assert_eq!(slots(&cull(root(), &camera)), [0]);
    camera.settings.culling = CullingMode::ENABLE_ALL;
    assert_eq!(slots(&cull(root(), &camera)), [0]);
    camera.clip_from_eye = proj::perspective_infinite_reverse(1.0, 1.0, 0.1);
    assert_eq!(slots(&cull(root(), &camera)), [0, 1], "infinitely far: no such plane");
}
