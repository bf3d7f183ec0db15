//! Occluders in pages that are merged and expire, and the views that they apply to.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DMat3, DVec3};
use kit::cull_scenes::{drawable, look_at, page};
use proptest::prelude::*;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::{Aabb, BoundingVolume, OrientedBox};
use terrane::scene::{
    CameraNode, ConvexPlanarOccluder, CullAction, CullCallback, CullingMode, Node, NodeId, NodeKind, Page, PageId,
    PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, ReferenceFrame, Refine, RenderOrder, Scene, SlotState,
};

use crate::tiles::slots_below;

fn cube(center: DVec3) -> Node {
    Node::geode(vec![drawable(Aabb { min: center - 0.5, max: center + 0.5 })])
}

/// Returns a wall of 4 x 4 m around a point, across the view of [`camera`].
fn wall_at(center: DVec3) -> Node {
    let corner = |(x, z): (f64, f64)| center + DVec3::new(x, 0.0, z);
    let corners = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)].map(corner).to_vec();
    Node::new(NodeKind::OccluderNode(Box::new(ConvexPlanarOccluder { corners, holes: vec![] })))
}

/// Returns a camera that looks along +y from 10 m in front of the origin, with z up.
fn camera() -> CullCamera {
    look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z)
}

fn slots(stage: &RenderStage) -> Vec<u32> {
    let mut slots: Vec<u32> = stage.bins.iter().flat_map(|b| b.leaves.iter().map(|l| l.slot.0)).collect();
    slots.sort_unstable();
    slots
}

fn seen(scene: &Scene, camera: &CullCamera) -> Vec<u32> {
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    for _ in 0..2 {
        visitor.cull(scene, camera, &mut stage);
    }
    slots(&stage)
}

/// Returns a tile of 200 m around a point, to which its content is moved. It is refined below a distance in metres.
fn tile_at(center: DVec3, refined_within_m: f64, refine: Refine, children: Vec<Node>) -> Node {
    let lod = PagedLod {
        bounds: BoundingVolume::Box(OrientedBox { center, half_axes: DMat3::from_diagonal(DVec3::splat(100.0)) }),
        range_mode: RangeMode::Distance { center, range_m: refined_within_m },
        refine,
        content: Some("tile".into()),
        content_transform: DAffine3::from_translation(center),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    };
    Node { children, ..Node::new(NodeKind::PagedLod(Box::new(lod))) }
}

fn slot_of(scene: &Scene, page: PageId, which: usize) -> NodeId {
    scene.slots_of_page(page).nth(which).unwrap()
}

#[test]
fn occluder_lives_as_long_as_its_page() {
    let mut scene = Scene::new();
    let root = Node::transform(
        DAffine3::from_translation(DVec3::new(0.0, -6.0, 0.0)),
        vec![tile_at(DVec3::new(1.0, 0.0, 0.0), 0.0, Refine::Replace, vec![])],
    );
    let tiles = scene.add_root(page(root, 0));
    scene.add_root(page(cube(DVec3::ZERO), 7));
    assert_eq!(seen(&scene, &camera()), [7]);
    let slot = slot_of(&scene, tiles, 0);
    for _ in 0..3 {
        // In its page the wall is 1 m to the left. The transforms of tile and content move it in front of the cube.
        let merged = scene.attach(slot, page(wall_at(DVec3::NEG_X), 0)).unwrap();
        assert_eq!(seen(&scene, &camera()), [0; 0]);
        let beside = look_at(DVec3::new(30.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z);
        std::thread::scope(|threads| {
            // Two visitors cull the same scene.
            let views = [camera(), beside].map(|c| {
                threads.spawn({
                    let scene = &scene;
                    move || seen(scene, &c)
                })
            });
            assert_eq!(views.map(|v| v.join().unwrap()), [vec![], vec![7]]);
        });
        drop(scene.detach(merged).unwrap());
        assert_eq!(seen(&scene, &camera()), [7]);
    }
}

#[test]
fn moved_occluder_hides_leaves_behind_its_new_position() {
    let mut scene = Scene::new();
    let tiles = scene.add_root(page(tile_at(DVec3::ZERO, 0.0, Refine::Replace, vec![]), 0));
    scene.add_root(page(cube(DVec3::ZERO), 7));
    let at = |z: f64| DAffine3::from_translation(DVec3::new(0.0, -4.0, z));
    let moving = Node::transform(at(1e6), vec![wall_at(DVec3::ZERO)]);
    let merged = scene.attach(slot_of(&scene, tiles, 0), page(moving, 0)).unwrap();
    // Another page has a wall, which must not be confused with the first.
    scene.add_root(page(wall_at(DVec3::new(0.0, 1e6, 0.0)), 0));
    for (z, expected) in [(1e6, &[7][..]), (0.0, &[]), (-1e6, &[7]), (0.5, &[])] {
        scene.set_transform(NodeId { page: merged, index: 0 }, at(z)).unwrap();
        assert_eq!(seen(&scene, &camera()), expected, "{z}");
    }
}

/// Regression: each change updated all occluders of its page.
#[test]
fn occluders_are_updated_once_for_all_changes_of_a_frame() {
    let mut scene = Scene::new();
    let still = |nodes| Node::transform(DAffine3::IDENTITY, nodes);
    // The second and third transform of the page have walls.
    let far = DVec3::new(0.0, 0.0, 100.0);
    let hung = vec![still(vec![]), still(vec![wall_at(far)]), still(vec![still(vec![wall_at(far)])]), still(vec![])];
    let root = scene.add_root(page(Node::group(hung), 0));
    scene.add_root(page(cube(DVec3::ZERO), 7));
    let transforms = [1, 2, 4, 7].map(|index| NodeId { page: root, index });
    let (here, away) = (DVec3::new(0.0, -6.0, 0.0) - far, DVec3::ZERO);
    let set = |scene: &mut Scene, which: &[usize], to: DVec3| {
        for which in which {
            (0..100).for_each(|i| {
                let on_the_way = DAffine3::from_translation(to * f64::from(i) / 100.0);
                scene.set_transform(transforms[*which], on_the_way).unwrap();
            });
            scene.set_transform(transforms[*which], DAffine3::from_translation(to)).unwrap();
        }
    };
    // Changes of nodes without occluders below them have no effect.
    set(&mut scene, &[0, 3], here);
    scene.compute_bounds();
    assert_eq!((scene.fitted_occluders(), seen(&scene, &camera())), (0, vec![7]));
    for (round, which) in [&[1][..], &[2], &[1, 2]].into_iter().enumerate() {
        // The change applies at once, and after the update as well.
        set(&mut scene, which, here);
        assert_eq!(seen(&scene, &camera()), [0; 0], "{which:?}");
        scene.compute_bounds();
        scene.compute_bounds();
        assert_eq!(scene.fitted_occluders(), 4 * round as u64 + 2, "{which:?}");
        assert_eq!(seen(&scene, &camera()), [0; 0], "{which:?}");
        set(&mut scene, which, away);
        scene.compute_bounds();
        assert_eq!((scene.fitted_occluders(), seen(&scene, &camera())), (4 * round as u64 + 4, vec![7]), "{which:?}");
    }
    // A page that expires while its update is pending takes its occluders along, and another page may use its slot.
    set(&mut scene, &[1], here);
    scene.remove_root(root).unwrap();
    scene.add_root(page(Node::group(vec![wall_at(DVec3::new(0.0, -6.0, 0.0))]), 0));
    scene.compute_bounds();
    assert_eq!((scene.fitted_occluders(), seen(&scene, &camera())), (12, vec![]));
}

#[test]
fn occluder_applies_while_its_level_is_drawn() {
    let shown = |refine, range_m, child_is_there: bool| {
        let mut scene = Scene::new();
        let child = tile_at(DVec3::ZERO, 0.0, Refine::Replace, vec![]);
        let tiles = scene.add_root(page(tile_at(DVec3::ZERO, range_m, refine, vec![child]), 0));
        scene.add_root(page(Node::group(vec![cube(DVec3::Z * 40.0), cube(DVec3::Z * -40.0)]), 7));
        // The coarse tile has a wall in front of the upper cube, the fine one in front of the lower.
        let wall = |z: f64| page(wall_at(DVec3::new(0.0, -5.0, 0.5 * z)), 0);
        scene.attach(slot_of(&scene, tiles, 0), wall(40.0)).unwrap();
        if child_is_there {
            scene.attach(slot_of(&scene, tiles, 1), wall(-40.0)).unwrap();
        }
        let mut camera = camera();
        camera.clip_from_eye = proj::perspective_infinite_reverse(2.8, 1.0, 0.1);
        seen(&scene, &camera)
    };
    let (near, far) = (5.0, 50.0);
    assert_eq!(shown(Refine::Replace, near, true), [8], "too far to be refined");
    assert_eq!(shown(Refine::Replace, far, true), [7], "the fine one is drawn instead");
    assert_eq!(shown(Refine::Replace, far, false), [8], "the coarse one is still drawn");
    assert_eq!(shown(Refine::Add, far, true), [0; 0], "both");
    assert_eq!(shown(Refine::Add, near, true), [8]);
}

#[test]
fn fading_occluders_hide_nothing() {
    let mut scene = Scene::new();
    let child = tile_at(DVec3::ZERO, 0.0, Refine::Replace, vec![]);
    let tiles = scene.add_root(page(tile_at(DVec3::ZERO, 10.5, Refine::Replace, vec![child]), 0));
    scene.add_root(page(cube(DVec3::ZERO), 7));
    scene.attach(slot_of(&scene, tiles, 0), page(cube(DVec3::new(0.0, -50.0, 0.0)), 0)).unwrap();
    scene.attach(slot_of(&scene, tiles, 1), page(wall_at(DVec3::new(0.0, -4.0, 0.0)), 0)).unwrap();
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    let mut cull = |time_s: f64, y: f64| {
        let mut camera = look_at(DVec3::new(0.0, y, 0.0), DVec3::ZERO, DVec3::Z);
        camera.simulation_time_s = time_s;
        camera.settings.lod_fade_s = 0.5;
        visitor.cull(&scene, &camera, &mut stage);
        slots(&stage).contains(&7)
    };
    assert!(cull(10.0, -11.0) && cull(10.1, -11.0), "the coarse tile has no wall");
    assert!(cull(10.2, -10.0) && cull(10.3, -10.0) && cull(10.4, -10.0), "the fine one fades in");
    cull(10.6, -10.0);
    cull(10.8, -10.0);
    assert!(!cull(10.9, -10.0), "its fade has ended");
    assert!(cull(11.0, -11.0), "it goes");
    cull(20.0, -10.0);
    assert!(!cull(20.1, -10.0), "immediately after a jump in time");
}

#[test]
fn masks_switches_levels_and_callbacks_apply_to_occluders() {
    let (front, behind) = (DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO);
    let is_seen = |root: Node| {
        let mut scene = Scene::new();
        let tiles = scene.add_root(page(Node::group(vec![tile_at(behind, 0.0, Refine::Replace, vec![])]), 0));
        scene.add_root(page(cube(behind), 7));
        scene.attach(slot_of(&scene, tiles, 0), page(root, 0)).unwrap();
        let mut camera = camera();
        camera.settings.cull_mask = 1;
        seen(&scene, &camera) == [7]
    };
    assert!(!is_seen(Node::group(vec![wall_at(front)])));
    assert!(is_seen(Node { mask: 2, ..Node::group(vec![wall_at(front)]) }));
    let switch = |shown| Node { children: vec![wall_at(front)], ..Node::new(NodeKind::Switch(vec![shown])) };
    assert!(!is_seen(switch(true)) && is_seen(switch(false)));
    let lod = |range_m| {
        let kind = NodeKind::Lod { center: DVec3::ZERO, ranges_m: vec![[50.0, 60.0], range_m] };
        Node { children: vec![Node::group(vec![]), wall_at(front)], ..Node::new(kind) }
    };
    assert!(!is_seen(lod([5.0, 15.0])) && is_seen(lod([11.0, 15.0])));
    let asked = |skips: bool| {
        let callback = CullCallback(Arc::new(move |info| {
            assert!(info.eye_in_page.distance(DVec3::new(0.0, -10.0, 0.0)) < 1e-6);
            if skips { CullAction::Skip } else { CullAction::Traverse }
        }));
        Node { cull_callback: Some(callback), ..Node::group(vec![wall_at(front)]) }
    };
    assert!(!is_seen(asked(false)) && is_seen(asked(true)));
    // An absolute transform keeps the wall ten metres in front of the eye.
    let absolute = NodeKind::AbsoluteTransform(DAffine3::from_rotation_x(-std::f64::consts::FRAC_PI_2));
    let absolute = Node { children: vec![wall_at(DVec3::new(0.0, 6.0, 0.0))], ..Node::new(absolute) };
    assert!(!is_seen(Node::transform(DAffine3::from_translation(DVec3::splat(500.0)), vec![absolute])));
}

#[test]
fn views_have_separate_occluders() {
    let (front, behind) = (DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO);
    let camera_node = |order, children: Vec<Node>| {
        let camera = CameraNode { frame: ReferenceFrame::Relative, ..CameraNode::new(order) };
        Node { children, ..Node::new(NodeKind::Camera(Box::new(camera))) }
    };
    let cull = |root: Node, content: Option<Node>| {
        let mut scene = Scene::new();
        let root = scene.add_root(page(root, 10));
        if let Some(content) = content {
            scene.attach(slot_of(&scene, root, 0), page(content, 20)).unwrap();
        }
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        visitor.cull(&scene, &camera(), &mut stage);
        let before = stage.pre_render.first().map(slots).unwrap_or_default();
        (slots(&stage), before)
    };
    let with = |order, inside: Vec<Node>, beside: Vec<Node>| {
        Node::group([camera_node(order, inside)].into_iter().chain(beside).collect())
    };
    let (nested, before) = (RenderOrder::Nested, RenderOrder::PreRender(0));
    let group = |nodes: &[DVec3]| nodes.iter().map(|c| cube(*c)).collect::<Vec<_>>();
    // A wall beside the nested camera hides nothing in its image, and a wall inside it nothing in the other image.
    let outer_wall = |order| cull(with(order, group(&[behind]), vec![wall_at(front), cube(behind)]), None);
    assert_eq!(outer_wall(nested).0, [10]);
    assert_eq!(outer_wall(before), (vec![], vec![10]));
    let inner_wall = |order| cull(with(order, vec![wall_at(front), cube(behind)], group(&[behind])), None);
    assert_eq!(inner_wall(nested).0, [10, 11]);
    assert_eq!(inner_wall(before), (vec![11], vec![]));
    // The same with both in tiles.
    let tile = || tile_at(behind, 0.0, Refine::Replace, vec![]);
    let tile_inside = |order, beside| cull(with(order, vec![tile(), cube(behind)], beside), Some(wall_at(front)));
    assert_eq!(tile_inside(before, group(&[behind])), (vec![11], vec![]));
    assert_eq!(tile_inside(nested, group(&[behind])).0, [10, 11]);
    let content = |order| cull(with(order, vec![tile()], vec![wall_at(front), cube(behind)]), Some(cube(behind)));
    assert_eq!(content(nested).0, [20]);
    assert_eq!(content(before), (vec![], vec![20]));
    // Below a projection with parallel rays, no occluders are used.
    let projection = NodeKind::Projection(proj::orthographic(-10.0, 10.0, -10.0, 10.0, 100.0, 0.1));
    let projection = Node { children: vec![tile(), cube(behind)], ..Node::new(projection) };
    let root = Node::group(vec![projection, wall_at(front), cube(behind)]);
    assert_eq!(cull(root, Some(cube(behind))).0, [10, 20]);
}

/// A random tile: its wall, in tenths of its size, and the position of its cube.
#[derive(Clone, Debug)]
struct Tile {
    refine: Refine,
    is_external: bool,
    wall: Option<(f64, f64, f64, f64)>,
    cube: (f64, f64, f64),
    children: Vec<Tile>,
}

fn tiles() -> impl Strategy<Value = Tile> {
    let unit = || -0.8..0.8f64;
    let wall = prop::option::weighted(0.7, (unit(), unit(), 0.2..1.0f64, 0.0..3.2f64));
    let refine = prop_oneof![3 => Just(Refine::Replace), 1 => Just(Refine::Add)];
    let own = (refine, prop::bool::weighted(0.15), wall, (unit(), unit(), unit()));
    let leaf = own.clone().prop_map(|(refine, _, wall, cube)| Tile {
        refine,
        is_external: false,
        wall,
        cube,
        children: vec![],
    });
    leaf.prop_recursive(4, 60, 4, move |inner| {
        (own.clone(), prop::collection::vec(inner, 1..5)).prop_map(|((refine, is_external, wall, cube), children)| {
            Tile { refine, is_external, wall, cube, children }
        })
    })
}

/// The oracle's record of a tile: the box of its cube and the corners of its wall, in world coordinates.
struct Known {
    cube: Aabb,
    wall: Option<[DVec3; 4]>,
}

struct World {
    scene: Scene,
    root: PageId,
    tiles: BTreeMap<String, (Tile, DVec3, f64)>,
}

impl World {
    fn new(root: &Tile) -> Self {
        let mut scene = Scene::new();
        let mut tiles = BTreeMap::new();
        let node = Self::build(root, DVec3::ZERO, 512.0, "r", &mut tiles);
        // The position in the world differs from that in the page.
        let root = scene.add_root(page(Node::transform(Self::world_from_tiles(), vec![node]), 0));
        Self { scene, root, tiles }
    }

    fn world_from_tiles() -> DAffine3 {
        DAffine3::from_rotation_z(0.3) * DAffine3::from_translation(DVec3::new(100.0, -50.0, 10.0))
    }

    fn build(
        tile: &Tile,
        center: DVec3,
        half_m: f64,
        name: &str,
        tiles: &mut BTreeMap<String, (Tile, DVec3, f64)>,
    ) -> Node {
        tiles.insert(name.to_owned(), (tile.clone(), center, half_m));
        let half_axes = DMat3::from_diagonal(DVec3::splat(half_m));
        let bounds = BoundingVolume::Box(OrientedBox { center, half_axes });
        if tile.is_external {
            Self::build_children(tile, center, half_m, name, tiles);
            return Node::new(NodeKind::ProxyNode(Box::new(ProxyNode {
                uri: name.into(),
                bounds: bounds.bounding_sphere(),
                content_transform: DAffine3::IDENTITY,
                loading: ProxyLoading::DeferToPager,
            })));
        }
        let geometric_error_m = if tile.children.is_empty() { 0.0 } else { 0.05 * half_m };
        let mut node = Node::new(NodeKind::PagedLod(Box::new(PagedLod {
            bounds,
            range_mode: RangeMode::ScreenSpaceError { geometric_error_m },
            refine: tile.refine,
            content: Some(name.into()),
            content_transform: DAffine3::from_translation(center),
            reader_data: None,
            request_volume: None,
            paging: PagingOptions::default(),
        })));
        node.children = Self::build_children(tile, center, half_m, name, tiles);
        node
    }

    fn build_children(
        tile: &Tile,
        center: DVec3,
        half_m: f64,
        name: &str,
        tiles: &mut BTreeMap<String, (Tile, DVec3, f64)>,
    ) -> Vec<Node> {
        let places = [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)];
        let children = tile.children.iter().zip(places).enumerate();
        let child = |(i, (child, (x, y)))| {
            let middle = center + half_m * DVec3::new(x, y, 0.0);
            Self::build(child, middle, 0.5 * half_m, &format!("{name}/{i}"), tiles)
        };
        children.map(child).collect()
    }

    /// Returns the wall and the cube around the tile's centre. The wall is upright and within the tile's bounds.
    fn parts(tile: &Tile, half_m: f64) -> (DVec3, f64, Option<[DVec3; 4]>) {
        let (x, y, z) = tile.cube;
        let cube = half_m * DVec3::new(x, y, z);
        let wall = tile.wall.map(|(x, y, size, turn)| {
            let (along, middle) = (DVec3::new(turn.cos(), turn.sin(), 0.0), half_m * DVec3::new(x, y, 0.0) * 0.2);
            let (along, up) = (along * half_m * size * 0.8, DVec3::Z * half_m * size);
            [middle - along - up, middle + along - up, middle + along + up, middle - along + up]
        });
        (cube, 0.05 * half_m, wall)
    }

    /// Returns two drawables at the slots `2 * n` and `2 * n + 1`: the cube, and one without a bound, which is always
    /// drawn.
    fn content(&self, name: &str) -> Page {
        let (tile, center, half_m) = &self.tiles[name];
        if tile.is_external {
            let children = Self::build_children(tile, *center, *half_m, name, &mut BTreeMap::new());
            return page(Node::group(children), 0);
        }
        let (cube, half, wall) = Self::parts(tile, *half_m);
        let own = Node::geode(vec![
            drawable(Aabb { min: cube - half, max: cube + half }),
            drawable(Aabb { min: DVec3::NAN, max: DVec3::NAN }),
        ]);
        let occluder = |corners: [DVec3; 4]| {
            let occluder = ConvexPlanarOccluder { corners: corners.to_vec(), holes: vec![] };
            Node::new(NodeKind::OccluderNode(Box::new(occluder)))
        };
        page(Node::group([own].into_iter().chain(wall.map(occluder)).collect()), 2 * self.number(name))
    }

    fn number(&self, name: &str) -> u32 {
        self.tiles.keys().position(|k| k == name).unwrap() as u32
    }

    fn known(&self) -> Vec<Known> {
        let world = |center: &DVec3, p: DVec3| Self::world_from_tiles().transform_point3(*center + p);
        let known = |(tile, center, half_m): &(Tile, DVec3, f64)| {
            let (cube, half, wall) = Self::parts(tile, *half_m);
            // The corners of the rotated box are tested; its box in the world contains them.
            let corners = Aabb { min: cube - half, max: cube + half }.corners();
            let cube = Aabb::from_points(corners.map(|c| world(center, c)));
            Known { cube, wall: wall.map(|w| w.map(|c| world(center, c))) }
        };
        self.tiles.values().map(known).collect()
    }
}

/// Returns how far inside the shadow of a wall a point is, relative to its distance. Negative values are outside.
fn depth_in_shadow(eye: DVec3, wall: &[DVec3; 4], point: DVec3) -> f64 {
    let middle = wall.iter().sum::<DVec3>() / 4.0;
    let normal = (wall[1] - wall[0]).cross(wall[3] - wall[0]).normalize();
    let away = normal * normal.dot(middle - eye).signum();
    let mut least = (point - middle).dot(away);
    for i in 0..4 {
        let (a, b) = (wall[i] - eye, wall[(i + 1) % 4] - eye);
        let side = a.cross(b).normalize_or_zero();
        let inward = side * side.dot(middle - eye).signum();
        least = least.min((point - eye).dot(inward));
    }
    least
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]

    /// Culled leaves are behind an occluder whose page is drawn, and leaves well behind one are culled.
    #[test]
    fn leaves_behind_occluders_of_drawn_pages_are_hidden(
        tree in tiles(),
        eye in (-900.0..900.0f64, -900.0..900.0f64, -200.0..400.0f64),
        changes in prop::collection::vec((0usize..1000, 0u32..4), 60),
    ) {
        let tree = Tile { is_external: false, ..tree };
        let mut world = World::new(&tree);
        let known = world.known();
        let eye = DVec3::new(eye.0, eye.1, eye.2);
        let camera = look_at(eye, World::world_from_tiles().translation, DVec3::new(0.1, 0.2, 1.0));
        let mut visitor = CullVisitor::new();
        let mut leaves = |scene: &Scene, culling| {
            let mut camera = camera;
            camera.settings.culling = culling;
            let mut stage = RenderStage::new();
            visitor.cull(scene, &camera, &mut stage);
            slots(&stage)
        };
        for some in changes.chunks(20) {
            for (which, what) in some {
                let slots = slots_below(&world.scene, world.root);
                let slot = slots[which % slots.len()];
                let info = world.scene.slot(slot).unwrap();
                match info.state {
                    SlotState::Resident(page) if *what == 0 && world.scene.is_expirable(page) => {
                        world.scene.detach(page).unwrap();
                    }
                    SlotState::Empty => {
                        let content = world.content(&info.uri.clone());
                        world.scene.attach(slot, content).unwrap();
                    }
                    _ => {}
                }
            }
            let drawn = leaves(&world.scene, CullingMode::NONE);
            let without = leaves(&world.scene, CullingMode::VIEW_FRUSTUM_SIDES);
            let with = leaves(&world.scene, CullingMode::VIEW_FRUSTUM_SIDES | CullingMode::SHADOW_OCCLUSION);
            prop_assert!(with.iter().all(|leaf| without.contains(leaf)));
            let is_drawn = |number: usize| drawn.contains(&(2 * number as u32 + 1));
            let walls: Vec<_> = (0..known.len()).filter(|i| is_drawn(*i)).filter_map(|i| known[i].wall).collect();
            for cube in without.iter().filter(|leaf| *leaf % 2 == 0) {
                let corners = known[*cube as usize / 2].cube.corners();
                let (tile, _, half_m) = world.tiles.values().nth(*cube as usize / 2).unwrap();
                let (center, half, _) = World::parts(tile, *half_m);
                let tile_center = world.tiles.values().nth(*cube as usize / 2).unwrap().1;
                let own_corners = Aabb { min: center - half, max: center + half }
                    .corners()
                    .map(|c| World::world_from_tiles().transform_point3(tile_center + c));
                let least = |corners: &[DVec3; 8], wall: &[DVec3; 4]| {
                    corners.iter().map(|c| depth_in_shadow(eye, wall, *c)).fold(f64::INFINITY, f64::min)
                };
                let slack = 1e-2;
                if with.contains(cube) {
                    let is_ahead = corners.iter().all(|c| camera.eye_from_world.transform_point3(*c).z < -0.1);
                    let deepest = walls.iter().map(|w| least(&corners, w)).fold(f64::NEG_INFINITY, f64::max);
                    // At most sixteen occluders that intersect the frustum are used.
                    prop_assert!(deepest < slack || walls.len() > 16 || !is_ahead, "{cube} is behind a wall by {deepest}");
                } else {
                    let deepest = walls.iter().map(|w| least(&own_corners, w)).fold(f64::NEG_INFINITY, f64::max);
                    prop_assert!(deepest > -slack, "{cube} is visible by {deepest}");
                }
            }
        }
    }
}
