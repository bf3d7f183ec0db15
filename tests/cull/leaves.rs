//! The drawables that become leaves, compared with a brute-force oracle in f64 and with the counts of the peer.

use std::collections::BTreeSet;
use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec3, DVec4};
use kit::cull_scenes::{Grid, drawable, look_at, page, state_sets};
use proptest::prelude::*;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{
    AlphaMode, CullAction, CullCallback, CullingMode, Node, NodeId, NodeKind, Page, Scene, SceneError,
};
use terrane::state::{BinDetails, SortKey, SortMode, StateSet};

fn cull(scene: &Scene, camera: &CullCamera) -> RenderStage {
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    visitor.cull(scene, camera, &mut stage);
    stage
}

fn slots(stage: &RenderStage) -> BTreeSet<u32> {
    let all: Vec<u32> = stage.bins.iter().flat_map(|b| &b.leaves).map(|l| l.slot.0).collect();
    let set: BTreeSet<u32> = all.iter().copied().collect();
    assert_eq!(set.len(), all.len(), "a duplicate leaf");
    set
}

/// A random node; sizes and positions in metres.
#[derive(Clone, Debug)]
enum Shape {
    Group(Vec<Shape>),
    Transform([f64; 7], Vec<Shape>),
    Switch(Vec<(bool, Shape)>),
    Lod([f64; 2], Vec<Shape>),
    Masked(u32, Vec<Shape>),
    Geode(Vec<([f64; 3], [f64; 3])>),
}

fn shape() -> impl Strategy<Value = Shape> {
    let number = -40.0..40.0f64;
    let geode =
        prop::collection::vec((prop::array::uniform3(number.clone()), prop::array::uniform3(0.0..4.0f64)), 0..4)
            .prop_map(Shape::Geode);
    geode.prop_recursive(6, 300, 5, move |inner| {
        let children = prop::collection::vec(inner.clone(), 0..5);
        prop_oneof![
            3 => children.clone().prop_map(Shape::Group),
            3 => (prop::array::uniform7(-1.0..1.0f64), children.clone()).prop_map(|(t, c)| Shape::Transform(t, c)),
            1 => prop::collection::vec((any::<bool>(), inner), 0..4).prop_map(Shape::Switch),
            1 => (prop::array::uniform2(0.0..150.0f64), children.clone()).prop_map(|(r, c)| Shape::Lod(r, c)),
            1 => (1u32..4, children).prop_map(|(m, c)| Shape::Masked(m, c)),
        ]
    })
}

fn affine(t: &[f64; 7]) -> DAffine3 {
    let rotation = DQuat::from_xyzw(t[0], t[1], t[2], t[3]).normalize();
    DAffine3::from_rotation_translation(rotation, 30.0 * DVec3::new(t[4], t[5], t[6]))
}

fn node(shape: &Shape) -> Node {
    let all = |children: &[Shape]| children.iter().map(node).collect::<Vec<_>>();
    match shape {
        Shape::Group(children) => Node::group(all(children)),
        Shape::Transform(t, children) => Node::transform(affine(t), all(children)),
        Shape::Switch(children) => Node {
            children: children.iter().map(|(_, c)| node(c)).collect(),
            ..Node::new(NodeKind::Switch(children.iter().map(|(on, _)| *on).collect()))
        },
        Shape::Lod([split, end], children) => {
            let ranges_m = vec![[0.0, *split], [*split, split + end]];
            Node { children: all(children), ..Node::new(NodeKind::Lod { center: DVec3::ZERO, ranges_m }) }
        }
        Shape::Masked(mask, children) => Node { mask: *mask, ..Node::group(all(children)) },
        Shape::Geode(boxes) => Node::geode(boxes.iter().map(|b| drawable(aabb(b))).collect()),
    }
}

fn aabb((center, half): &([f64; 3], [f64; 3])) -> Aabb {
    let (c, h) = (DVec3::from_array(*center), DVec3::from_array(*half));
    Aabb { min: c - h, max: c + h }
}

/// The result of the oracle for each drawable: the distance in metres that its box reaches inside the closest plane;
/// `None` if it is switched off.
struct Oracle {
    planes: Vec<DVec4>,
    eye: DVec3,
    camera: CullCamera,
    reach_m: Vec<Option<f64>>,
    /// True if a LOD distance is too close to the end of a range to decide.
    unsure: bool,
}

impl Oracle {
    fn new(camera: &CullCamera) -> Self {
        let frustum = terrane::math::Frustum::from_clip(&camera.clip_from_eye);
        let count = if camera.settings.culling.contains(CullingMode::NEAR_PLANE) { 5 } else { 4 };
        let mut planes = frustum.planes[..count].to_vec();
        planes.push(DVec4::new(0.0, 0.0, -1.0, 0.0)); // in front of the eye
        let eye = camera.eye_from_world.inverse().translation;
        Self { planes, eye, camera: *camera, reach_m: Vec::new(), unsure: false }
    }

    fn visit(&mut self, shape: &Shape, world_from_node: DAffine3, on: bool) {
        match shape {
            Shape::Group(children) => children.iter().for_each(|c| self.visit(c, world_from_node, on)),
            Shape::Transform(t, children) => {
                children.iter().for_each(|c| self.visit(c, world_from_node * affine(t), on));
            }
            Shape::Switch(children) => {
                children.iter().for_each(|(shown, c)| self.visit(c, world_from_node, on && *shown));
            }
            Shape::Lod([split, end], children) => {
                let distance = world_from_node.translation.distance(self.eye) * self.camera.settings.lod_scale;
                for limit in [*split, split + end] {
                    self.unsure |= (distance - limit).abs() < 1e-6;
                }
                for (i, child) in children.iter().enumerate() {
                    let range = [(0.0, *split), (*split, split + end)].get(i).copied();
                    let shown = range.is_some_and(|(min, max)| min <= distance && distance < max);
                    self.visit(child, world_from_node, on && shown);
                }
            }
            Shape::Masked(mask, children) => {
                let seen = mask & self.camera.settings.cull_mask != 0;
                children.iter().for_each(|c| self.visit(c, world_from_node, on && seen));
            }
            Shape::Geode(boxes) => {
                for b in boxes {
                    // The engine keeps axis-aligned boxes in the frame of the page, which is the world here.
                    let b = aabb(b).transformed(&world_from_node);
                    let reach = self.planes.iter().map(|p| {
                        let normal = self.camera.eye_from_world.matrix3.transpose() * p.truncate();
                        let d = p.truncate().dot(self.camera.eye_from_world.translation) + p.w;
                        normal.dot(b.center()) + normal.abs().dot(b.half_size()) + d
                    });
                    self.reach_m.push(on.then(|| reach.fold(f64::INFINITY, f64::min)));
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]
    #[test]
    fn leaves_equal_the_oracle(
        shape in shape(),
        eye in prop::array::uniform3(-90.0..90.0f64),
        target in prop::array::uniform3(-30.0..30.0f64),
        offset in prop_oneof![Just(0.0), Just(6_378_137.0f64)],
        mask in 1u32..4,
        mode in 0u32..4,
    ) {
        // Far from the world's origin, the origin of the page must preserve the precision.
        let shift = DAffine3::from_translation(DVec3::splat(offset));
        let mut scene = Scene::new();
        scene.add_root(page(Node::transform(shift, vec![node(&shape)]), 0));
        let eye = DVec3::from_array(eye) + DVec3::splat(offset);
        let target = DVec3::from_array(target) + DVec3::splat(offset) + DVec3::new(0.0, 0.0, 1e-3);
        let mut camera = look_at(eye, target, DVec3::new(0.1, 0.2, 1.0).normalize());
        camera.settings.culling = CullingMode(mode);
        camera.settings.cull_mask = mask;
        let mut oracle = Oracle::new(&camera);
        if !camera.settings.culling.contains(CullingMode::VIEW_FRUSTUM_SIDES) {
            oracle.planes.drain(..4);
        }
        oracle.visit(&shape, shift, true);
        prop_assume!(!oracle.unsure);
        let seen = slots(&cull(&scene, &camera));
        // The tolerance covers f32 at the size of the page (about 300 m) and the f64 rounding of the offset.
        let tolerance_m = 3e-4;
        for (i, reach_m) in oracle.reach_m.iter().enumerate() {
            match reach_m {
                None => prop_assert!(!seen.contains(&(i as u32)), "switched off, but drawn: {i}"),
                Some(r) if *r > 1e-7 => prop_assert!(seen.contains(&(i as u32)), "lost {i}, inside by {r} m"),
                Some(r) if *r < -tolerance_m => prop_assert!(!seen.contains(&(i as u32)), "extra {i}, outside by {r} m"),
                Some(_) => {}
            }
        }
    }

    /// Boxes that reach into the frustum by less than an f32 step are not culled.
    #[test]
    fn rounding_culls_no_visible_box(
        columns in prop::collection::vec((-500.0..500.0f64, 0.0..20.0f64), 8),
        inside_m in 1e-7..1e-5f64,
        height in 100.0..400.0f64,
    ) {
        // The boxes of a column have the same edge towards the left plane, whose normal has no y.
        let boxes: Vec<_> = columns
            .iter()
            .flat_map(|(x, z)| (-20..20).map(|i| ([*x, f64::from(i) * 1.7, *z], [0.3, 0.21, 0.4])).collect::<Vec<_>>())
            .collect();
        let shape = Shape::Geode(boxes);
        let mut scene = Scene::new();
        scene.add_root(page(node(&shape), 0));
        for (x, z) in &columns {
            // The left plane is 30 degrees off the axis and runs through the column's lower right edge.
            let eye_x = x + 0.3 + (height - z + 0.4) * 30f64.to_radians().tan() - inside_m;
            let eye = DVec3::new(eye_x, 0.0, height);
            let camera = look_at(eye, DVec3::new(eye_x, 0.0, 0.0), DVec3::Y);
            let mut oracle = Oracle::new(&camera);
            oracle.visit(&shape, DAffine3::IDENTITY, true);
            let seen = slots(&cull(&scene, &camera));
            for (i, reach_m) in oracle.reach_m.iter().enumerate() {
                prop_assert!(seen.contains(&(i as u32)) || reach_m.unwrap() < 1e-9, "lost {}: {:?}", i, reach_m);
            }
        }
    }

    #[test]
    fn near_and_far_planes_enclose_all_leaves(shape in shape(), eye in prop::array::uniform3(-90.0..90.0f64)) {
        let mut scene = Scene::new();
        scene.add_root(page(node(&shape), 0));
        let camera = look_at(DVec3::from_array(eye), DVec3::new(0.0, 0.0, 1e-3), DVec3::new(0.1, 0.2, 1.0));
        let stage = cull(&scene, &camera);
        prop_assert!(stage.near_m >= 0.0 && stage.near_m <= stage.far_m);
        for leaf in stage.bins.iter().flat_map(|b| &b.leaves) {
            prop_assert!(f64::from(leaf.depth) <= stage.far_m);
            prop_assert!(f64::from(leaf.depth) >= stage.near_m || leaf.depth < 0.0 || stage.near_m < 1e-3);
        }
    }

    /// The fast path for single drawables is used only while nothing may have changed the page.
    #[test]
    fn page_with_one_drawable_is_culled_like_its_nodes(
        above in prop::collection::vec(prop::option::of(prop::array::uniform7(-1.0..1.0f64)), 0..4),
        set_at in 0usize..6,
        bounds in (prop::array::uniform3(-40.0..40.0f64), prop::array::uniform3(0.0..4.0f64)),
        eye in prop::array::uniform3(-90.0..90.0f64),
        target in prop::array::uniform3(-30.0..30.0f64),
        mode in 0u32..4,
    ) {
        let set = Arc::new(StateSet::default());
        let with_set = |at: usize, node: Node| if at == set_at { node.with_state_set(set.clone()) } else { node };
        let mut root = with_set(0, Node::geode(vec![drawable(aabb(&bounds))]));
        for (at, transform) in above.iter().enumerate() {
            let children = vec![root];
            root = match transform {
                Some(t) => Node::transform(affine(t), children),
                None => Node::group(children),
            };
            root = with_set(at + 1, root);
        }
        let mut scene = Scene::new();
        let id = scene.add_root(page(root, 0));
        let mut camera = look_at(DVec3::from_array(eye), DVec3::from_array(target), DVec3::new(0.1, 0.2, 1.0));
        camera.settings.culling = CullingMode(mode);
        let (mut visitor, mut quick, mut slow) = (CullVisitor::new(), RenderStage::new(), RenderStage::new());
        visitor.cull(&scene, &camera, &mut quick);
        prop_assert!(scene.page_mut(id).is_some());
        visitor.cull(&scene, &camera, &mut slow);
        // Both paths may decide differently if the box ends at the edge of the frustum.
        let mut oracle = Oracle::new(&camera);
        let world_from_drawable = above.iter().flatten().fold(DAffine3::IDENTITY, |below, t| affine(t) * below);
        oracle.visit(&Shape::Geode(vec![bounds]), world_from_drawable, true);
        prop_assume!(oracle.reach_m[0].is_some_and(|reach_m| reach_m.abs() > 1e-3));
        let leaves = |stage: &RenderStage| stage.bins.iter().flat_map(|b| b.leaves.clone()).collect::<Vec<_>>();
        let (a, b) = (leaves(&quick), leaves(&slow));
        prop_assert_eq!(a.len(), b.len());
        for (a, b) in a.iter().zip(&b) {
            prop_assert_eq!((a.slot, a.state), (b.slot, b.state));
            prop_assert!((a.depth - b.depth).abs() < 1e-4);
            let rows = |stage: &RenderStage, matrix: u32| stage.eye_from_drawable[matrix as usize];
            for (a, b) in rows(&quick, a.matrix).iter().zip(&rows(&slow, b.matrix)) {
                prop_assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4));
            }
            let of = |stage: &RenderStage| Arc::as_ptr(&stage.state_sets[a.state as usize]);
            prop_assert_eq!(of(&quick), of(&slow));
        }
        prop_assert!((quick.near_m - slow.near_m).abs() < 1e-3 && (quick.far_m - slow.far_m).abs() < 1e-3);
        prop_assert!(b.is_empty() || quick.counters == slow.counters);
    }

    #[test]
    fn moved_transform_equals_one_built_at_the_new_position(
        shape in shape(),
        from in prop::array::uniform7(-1.0..1.0f64),
        to in prop::array::uniform7(-1.0..1.0f64),
        eye in prop::array::uniform3(-90.0..90.0f64),
    ) {
        let build = |t: &[f64; 7]| {
            let moved = Node::transform(affine(t), vec![node(&shape)]);
            page(Node::group(vec![Node::group(vec![moved]), node(&shape)]), 0)
        };
        let (mut moved, mut built) = (Scene::new(), Scene::new());
        let root = moved.add_root(build(&from));
        moved.set_transform(NodeId { page: root, index: 2 }, affine(&to)).unwrap();
        built.add_root(build(&to));
        let camera = look_at(DVec3::from_array(eye), DVec3::new(0.0, 0.0, 1e-3), DVec3::new(0.1, 0.2, 1.0));
        let (a, b) = (cull(&moved, &camera), cull(&built, &camera));
        // The origins of the pages differ, so rounding may decide differently at the edge of the frustum.
        let odd = slots(&a).symmetric_difference(&slots(&b)).count();
        prop_assert!(odd <= 1, "{odd} differ");
    }
}

/// The numbers of visited nodes, tested drawables and leaves equal those of OpenSceneGraph 3.6.5 (`osg_cull`).
#[test]
fn counts_equal_the_peer() {
    let table = [
        (1_000, "tenth", 331, 110, 110),
        (1_000, "all", 1_541, 1_000, 1_000),
        (1_000, "tilted", 1_541, 1_000, 1_000),
        (10_000, "tenth", 1_949, 1_024, 1_024),
        (10_000, "all", 14_677, 10_000, 10_000),
        (10_000, "tilted", 14_657, 9_977, 9_977),
        (100_000, "tenth", 17_321, 10_000, 10_000),
        (100_000, "all", 157_845, 100_000, 100_000),
        (100_000, "tilted", 157_845, 100_000, 100_000),
    ];
    for (cells, view, nodes, drawables, leaves) in table {
        let grid = Grid::new(cells);
        let mut scene = Scene::new();
        scene.add_root(page(grid.build(&state_sets(64, &StateSet::default())), 0));
        let camera = grid.camera(view);
        let stage = cull(&scene, &camera);
        assert_eq!(stage.counters.leaves, leaves, "{cells} {view}");
        assert_eq!(stage.counters.drawables_tested, drawables, "{cells} {view}");
        let with_shortcut = slots(&stage);

        let (mut visitor, mut stage) = (CullVisitor::visiting_all(), RenderStage::new());
        visitor.cull(&scene, &camera, &mut stage);
        assert_eq!(stage.counters.nodes_visited, nodes, "{cells} {view}");
        assert_eq!(stage.counters.drawables_tested, drawables, "{cells} {view}");
        assert_eq!(slots(&stage), with_shortcut, "{cells} {view}");
    }
}

#[test]
fn matrices_are_shared_and_correct() {
    let rotation = DAffine3::from_rotation_translation(DQuat::from_rotation_z(0.7), DVec3::new(5.0, 1.0, 0.0));
    let unit = Aabb { min: -DVec3::ONE, max: DVec3::ONE };
    let scale = DAffine3::from_scale_rotation_translation(DVec3::splat(2.0), DQuat::from_rotation_x(0.2), DVec3::Y);
    let inner = Node::transform(scale, vec![Node::geode(vec![drawable(unit), drawable(unit)])]);
    let root = Node::group(vec![
        Node::geode(vec![drawable(unit)]),
        Node::transform(rotation, vec![Node::geode(vec![drawable(unit)]), inner]),
    ]);
    let mut scene = Scene::new();
    scene.add_root(page(root, 0));
    for (eye, visitor) in [(20.0, CullVisitor::new()), (20.0, CullVisitor::visiting_all()), (8.0, CullVisitor::new())] {
        let camera = look_at(DVec3::new(3.0, -eye, 2.0), DVec3::new(2.5, 0.0, 0.0), DVec3::Z);
        let (mut visitor, mut stage) = (visitor, RenderStage::new());
        visitor.cull(&scene, &camera, &mut stage);
        let mut leaves = stage.bins[0].leaves.clone();
        leaves.sort_by_key(|l| l.slot);
        assert_eq!(leaves.len(), 4);
        assert_eq!(leaves[2].matrix, leaves[3].matrix);
        let expected = [DAffine3::IDENTITY, rotation, rotation * scale, rotation * scale];
        for (leaf, world_from_drawable) in leaves.iter().zip(expected) {
            let eye_from_drawable = camera.eye_from_world * world_from_drawable;
            let rows = stage.eye_from_drawable[leaf.matrix as usize];
            for (row, values) in rows.iter().enumerate() {
                let linear = eye_from_drawable.matrix3.row(row);
                let exact = [linear.x, linear.y, linear.z, eye_from_drawable.translation[row]];
                for (value, exact) in values.iter().zip(exact) {
                    assert!((f64::from(*value) - exact).abs() < 1e-5, "{rows:?}");
                }
            }
            assert!((f64::from(leaf.depth) + eye_from_drawable.translation.z).abs() < 1e-4);
        }
    }
}

#[test]
fn drawables_with_invalid_bounds_are_drawn_and_affect_no_others() {
    let odd = [
        Aabb::EMPTY,
        Aabb { min: DVec3::splat(f64::NAN), max: DVec3::ONE },
        Aabb { min: DVec3::NEG_INFINITY, max: DVec3::INFINITY },
        Aabb { min: DVec3::splat(-1e300), max: DVec3::splat(1e300) },
        Aabb { min: DVec3::ONE, max: -DVec3::ONE },
    ];
    let good = Aabb { min: -DVec3::ONE, max: DVec3::ONE };
    for sort in [SortMode::ByStateThenFrontToBack, SortMode::BackToFront, SortMode::FrontToBack] {
        let set = Arc::new(StateSet { bin: Some(BinDetails::new(3, sort)), ..StateSet::default() });
        let mut boxes: Vec<_> = odd.iter().map(|b| drawable(*b)).collect();
        boxes.extend((0..300).map(|_| drawable(good)));
        let mut scene = Scene::new();
        scene.add_root(page(Node::group(vec![Node::geode(boxes), Node::geode(vec![])]).with_state_set(set), 0));
        for mode in [CullingMode::DEFAULT, CullingMode::NONE, CullingMode(7)] {
            let mut camera = look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z);
            camera.settings.culling = mode;
            let stage = cull(&scene, &camera);
            assert_eq!(stage.counters.leaves, 305);
            assert!((stage.near_m - 9.0).abs() < 0.01 && (stage.far_m - 11.0).abs() < 0.01, "{}", stage.near_m);
        }
    }
}

#[test]
fn camera_with_nan_does_not_panic() {
    let grid = Grid::new(1_000);
    let mut scene = Scene::new();
    scene.add_root(page(grid.build(&state_sets(3, &StateSet::default())), 0));
    let nan = DAffine3::from_translation(DVec3::NAN);
    let stage = cull(&scene, &CullCamera { eye_from_world: nan, ..CullCamera::default() });
    assert!(stage.near_m.is_finite() && stage.far_m.is_finite());
}

/// Returns the leaves of a scene with various depths and states, for one sort mode.
fn sorted(sort: SortMode, cells: u32) -> RenderStage {
    let set = StateSet { bin: Some(BinDetails::new(0, sort)), ..StateSet::default() };
    let grid = Grid::new(cells);
    let mut scene = Scene::new();
    scene.add_root(page(grid.build(&state_sets(7, &set)), 0));
    cull(&scene, &grid.camera("tilted"))
}

#[test]
fn bins_are_sorted_by_their_mode() {
    for cells in [100, 1_000, 10_000] {
        let traversal = sorted(SortMode::TraversalOrder, cells);
        let place = |slot: u32| traversal.bins[0].leaves.iter().position(|l| l.slot.0 == slot).unwrap();
        let order: std::collections::HashMap<u32, usize> =
            traversal.bins[0].leaves.iter().map(|l| (l.slot.0, place(l.slot.0))).take(1_000).collect();
        let all = traversal.bins[0].leaves.len();
        for sort in [
            SortMode::ByState,
            SortMode::ByStateThenFrontToBack,
            SortMode::FrontToBack,
            SortMode::BackToFront,
            SortMode::TraversalOrder,
            SortMode::ByKey(SortKey::new(|leaf| u64::MAX - u64::from(leaf.order / 3))),
        ] {
            let stage = sorted(sort, cells);
            assert_eq!(stage.bins.len(), 1);
            assert_eq!(stage.bins[0].sort, sort);
            let leaves = &stage.bins[0].leaves;
            assert_eq!(leaves.len(), all);
            assert_eq!(slots(&stage).len(), all);
            for pair in leaves.windows(2) {
                let (a, b) = (pair[0], pair[1]);
                let in_traversal = match (order.get(&a.slot.0), order.get(&b.slot.0)) {
                    (Some(a), Some(b)) => a < b,
                    _ => true,
                };
                match sort {
                    SortMode::ByState => assert!(a.state != b.state || in_traversal),
                    SortMode::ByStateThenFrontToBack => {
                        assert!(a.state != b.state || a.depth < b.depth || (a.depth == b.depth && in_traversal));
                    }
                    SortMode::FrontToBack => assert!(a.depth < b.depth || (a.depth == b.depth && in_traversal)),
                    SortMode::BackToFront => assert!(a.depth > b.depth || (a.depth == b.depth && in_traversal)),
                    SortMode::TraversalOrder => assert!(in_traversal),
                    SortMode::ByKey(_) => {}
                }
            }
            if let SortMode::ByKey(_) = sort {
                // Groups of three in the order of traversal, from back to front.
                let expected = (0..all).rev().map(|i| i / 3).collect::<Vec<_>>();
                assert_eq!(leaves.iter().map(|l| place(l.slot.0) / 3).collect::<Vec<_>>(), expected);
                assert!(leaves.windows(2).all(|p| {
                    let (a, b) = (place(p[0].slot.0), place(p[1].slot.0));
                    a / 3 > b / 3 || a < b
                }));
            }
            if matches!(sort, SortMode::ByState | SortMode::ByStateThenFrontToBack) {
                let mut runs: Vec<_> = leaves.chunk_by(|a, b| a.state == b.state).collect();
                assert_eq!(runs.len(), 7, "states together");
                let first = |state: u32| traversal.bins[0].leaves.iter().position(|l| l.state == state).unwrap();
                if sort == SortMode::ByState {
                    assert!(runs.is_sorted_by_key(|r| first(r[0].state)));
                } else {
                    runs.dedup_by_key(|r| r[0].depth);
                    assert!(runs.is_sorted_by(|a, b| a[0].depth <= b[0].depth));
                }
            }
        }
    }
}

#[test]
fn blended_drawables_are_in_the_transparent_bin() {
    let near = Aabb { min: -DVec3::ONE, max: DVec3::ONE };
    let far = Aabb { min: DVec3::new(-1.0, 9.0, -1.0), max: DVec3::new(1.0, 11.0, 1.0) };
    let blended = |bounds| {
        let mut d = drawable(bounds);
        d.material.alpha = AlphaMode::Blend;
        d
    };
    let own = Arc::new(StateSet { bin: Some(BinDetails::new(-1, SortMode::ByState)), ..StateSet::default() });
    let mut scene = Scene::new();
    scene.add_root(page(
        Node::group(vec![
            Node::geode(vec![blended(near), drawable(near), blended(far)]),
            Node::geode(vec![blended(near)]).with_state_set(own),
        ]),
        0,
    ));
    let camera = look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z);
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    for _ in 0..3 {
        visitor.cull(&scene, &camera, &mut stage);
        let bins: Vec<(i32, Vec<u32>)> =
            stage.bins.iter().map(|b| (b.number(), b.leaves.iter().map(|l| l.slot.0).collect())).collect();
        assert_eq!(bins, [(-1, vec![3]), (0, vec![1]), (10, vec![2, 0])]);
        let state = &stage.state_sets[stage.bins[2].leaves[0].state as usize];
        assert!(state.blends() && !state.writes_depth() && state.bin() == BinDetails::TRANSPARENT);
        assert!(stage.state_sets[stage.bins[1].leaves[0].state as usize].writes_depth());
    }
}

/// A state set below the same parent is one state, in all pages.
#[test]
fn states_are_identified_by_state_set_and_parent() {
    let unit = Aabb { min: -DVec3::ONE, max: DVec3::ONE };
    let (a, b) = (Arc::new(StateSet::default()), Arc::new(StateSet::default()));
    let leaf = |set: &Arc<StateSet>| Node::geode(vec![drawable(unit)]).with_state_set(set.clone());
    let mut scene = Scene::new();
    scene.add_root(page(Node::group(vec![leaf(&a), leaf(&b), leaf(&a), leaf(&b).with_state_set(a.clone())]), 0));
    scene.add_root(page(Node::group(vec![leaf(&a), Node::group(vec![leaf(&a)]).with_state_set(b)]), 4));
    let stage = cull(&scene, &look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z));
    let mut leaves = stage.bins[0].leaves.clone();
    leaves.sort_by_key(|l| l.slot);
    let states: Vec<u32> = leaves.iter().map(|l| l.state).collect();
    assert_eq!(states[0], states[2]);
    assert_eq!(states[0], states[3]);
    assert_eq!(states[0], states[4]);
    assert_ne!(states[0], states[1]);
    assert_ne!(states[5], states[0]);
    assert_ne!(states[5], states[1]);
    assert_eq!(stage.state_sets.len(), 3, "only states with leaves");
}

/// Nodes with masks, callbacks or switches are culled like others. Regression: they were never culled.
#[test]
fn small_features_are_culled_if_enabled() {
    let small = Aabb { min: -DVec3::splat(0.001), max: DVec3::splat(0.001) };
    let geode = || Node::geode(vec![drawable(small)]);
    let asked = CullCallback(Arc::new(|_| CullAction::Traverse));
    let kinds: [(&str, Node); 6] = [
        ("geode", geode()),
        ("of a layer", Node { mask: 1, ..geode() }),
        ("group of one of a layer", Node::group(vec![Node { mask: 1, ..geode() }])),
        ("with a callback", Node { cull_callback: Some(asked), ..geode() }),
        ("switch", Node { children: vec![geode()], ..Node::new(NodeKind::Switch(vec![true])) }),
        ("culling is off", Node { culling_active: false, ..geode() }),
    ];
    for (name, node) in kinds {
        let mut scene = Scene::new();
        scene.add_root(page(Node::group(vec![node]), 0));
        let mut camera = look_at(DVec3::new(0.0, -100.0, 0.0), DVec3::ZERO, DVec3::Z);
        assert_eq!(cull(&scene, &camera).counters.leaves, 1, "{name}");
        camera.settings.culling = CullingMode::DEFAULT | CullingMode::SMALL_FEATURE;
        assert_eq!(cull(&scene, &camera).counters.leaves, u32::from(name == "culling is off"), "{name}");
    }
}

#[test]
fn graphs_that_are_too_deep_are_refused() {
    let mut deep = Node::group(vec![]);
    for _ in 0..100_000 {
        deep = Node::group(vec![deep]);
    }
    assert!(matches!(Page::from_node(deep), Err(SceneError::TooDeep { .. })));
}
