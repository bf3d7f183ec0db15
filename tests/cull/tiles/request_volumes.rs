//! Tiles for eyes inside request volumes (`viewerRequestVolume`): requests, drawing and intersections. No GPU.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use kit::cull_scenes::{look_at, square_box};
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::{BoundingSphere, BoundingVolume};
use terrane::scene::{
    DrawSlot, Drawable, Environment, Geometry, Intersection, IntersectionVisitor, LineSegmentIntersector, Material,
    Mesh, MeshVertex, Node, NodeId, NodeKind, Page, PageId, PagedLod, PagingOptions, RangeMode, Refine, Scene,
    SlotState, SunShadows, Topology,
};

/// Returns a square of a plane, 50 m to each side of a point.
fn tile(center: DVec3, content: &str) -> PagedLod {
    PagedLod {
        bounds: BoundingVolume::Box(square_box(center, 50.0)),
        range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
        refine: Refine::Replace,
        content: Some(content.into()),
        content_transform: DAffine3::from_translation(center),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    }
}

fn node(tile: PagedLod) -> Node {
    Node::new(NodeKind::PagedLod(Box::new(tile)))
}

fn within(radius_m: f64, center: DVec3) -> Option<BoundingVolume> {
    Some(BoundingVolume::Sphere(BoundingSphere::new(center, radius_m)))
}

/// Returns a square of 100 m that is drawn and can be intersected.
fn square() -> Page {
    let corner = |x: f32, y: f32| MeshVertex { position: [x, y, 0.0], ..MeshVertex::default() };
    let corners = vec![corner(-50.0, -50.0), corner(50.0, -50.0), corner(50.0, 50.0), corner(-50.0, 50.0)];
    let mesh = Mesh::new(corners, vec![0, 1, 2, 0, 2, 3], Topology::Triangles);
    let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default());
    let mut page = Page::from_node(Node::geode(vec![drawable])).unwrap();
    page.set_draw_slots(0, vec![DrawSlot(0)]);
    page
}

fn tileset(root: Node) -> Page {
    Page::from_node(root).unwrap()
}

const LEFT: DVec3 = DVec3::new(-50.0, 0.0, 0.0);
const RIGHT: DVec3 = DVec3::new(50.0, 0.0, 0.0);

/// Returns a tile whose content is a square in its middle, with two children side by side.
fn parent_of(right: PagedLod, refine: Refine) -> Scene {
    let parent = PagedLod {
        bounds: BoundingVolume::Box(square_box(DVec3::ZERO, 100.0)),
        range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 1e3 },
        refine,
        ..tile(DVec3::ZERO, "parent")
    };
    let mut scene = Scene::new();
    scene.add_root(tileset(node(parent).with_child(node(tile(LEFT, "left"))).with_child(node(right))));
    scene
}

/// Returns a tile with a child whose request volume contains eyes within 500 m.
fn with_a_near_child(refine: Refine) -> Scene {
    parent_of(PagedLod { request_volume: within(500.0, DVec3::ZERO), ..tile(RIGHT, "right") }, refine)
}

/// Returns a tile with a child that is an external tileset.
fn with_a_tileset(refine: Refine) -> Scene {
    parent_of(tile(RIGHT, "set"), refine)
}

/// Returns the external tileset with its frame. Its request volume contains eyes within 500 m of the world's origin.
fn near_tileset() -> Page {
    tileset(node(PagedLod { request_volume: within(500.0, -RIGHT), ..tile(DVec3::ZERO, "right") }))
}

/// Returns the content of most tiles.
fn plain(uri: &str) -> Page {
    if uri == "set" { near_tileset() } else { square() }
}

fn from_above(height_m: f64) -> CullCamera {
    look_at(DVec3::new(0.0, -10.0, height_m), DVec3::ZERO, DVec3::Z)
}

/// Culls once and returns the URIs of requested and of drawn tiles.
fn cull(scene: &Scene, camera: &CullCamera) -> (Vec<String>, Vec<String>) {
    let mut stage = RenderStage::new();
    CullVisitor::new().cull(scene, camera, &mut stage);
    let uri = |slot: NodeId| scene.slot(slot).unwrap().uri.to_string();
    let mut asked: Vec<_> = stage.requests.iter().map(|request| uri(request.slot)).collect();
    asked.sort();
    let contents = [("left", LEFT), ("parent", DVec3::ZERO), ("right", RIGHT)];
    let name = |rows: &[[f32; 4]; 3]| {
        let in_world = camera.eye_from_world.inverse().transform_point3(DVec3::from_array(rows.map(|r| r[3].into())));
        contents.iter().find(|(_, center)| center.distance(in_world) < 1.0).unwrap().0.to_string()
    };
    let mut drawn: Vec<_> = stage.eye_from_drawable.iter().map(name).collect();
    drawn.sort();
    (asked, drawn)
}

/// Returns the number of shadow casters of a scene with one cascade.
fn casters(scene: &Scene, camera: &CullCamera) -> u32 {
    let shadows = Some(SunShadows { cascades: 1, ..SunShadows::default() });
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    visitor.environment =
        Some(Environment { sun_direction: DVec3::Z, up_in_world: DVec3::Z, shadows, ..Environment::default() });
    visitor.cull(scene, camera, &mut stage);
    stage.counters.shadow_leaves
}

/// Attaches requested tiles until there are no requests, and returns the drawn tiles.
fn settle(scene: &mut Scene, camera: &CullCamera, load: &dyn Fn(&str) -> Page) -> Vec<String> {
    for frame in 1..20 {
        let mut stage = RenderStage::new();
        CullVisitor::new().cull(scene, &CullCamera { frame, ..*camera }, &mut stage);
        if stage.requests.is_empty() {
            return cull(scene, camera).1;
        }
        for request in &stage.requests {
            let page = load(scene.slot(request.slot).unwrap().uri);
            assert!(scene.attach(request.slot, page).is_ok());
        }
    }
    panic!("does not settle: {:?}", cull(scene, camera));
}

/// Returns the squares that rays straight down through their middles intersect, as seen from an eye.
fn met(scene: &Scene, camera: &CullCamera) -> Vec<String> {
    let mut visitor = IntersectionVisitor::as_seen_from(camera.eye_point());
    let mut met = Vec::new();
    for (name, x) in [("left", -75.0), ("parent", 0.0), ("right", 75.0)] {
        let place = DVec3::new(x, 1.0, 0.0);
        let mut line = LineSegmentIntersector::new(place + DVec3::Z, place - DVec3::Z);
        visitor.traverse(scene, &mut line);
        let page = |hit: &Intersection| hit.node().unwrap().page;
        let uri = |page: PageId| scene.slot(scene.slot_of(page).unwrap()).unwrap().uri.to_string();
        met.extend(line.intersections().iter().map(|hit| uri(page(hit))).filter(|uri| uri == name));
    }
    met
}

#[test]
fn tile_is_wanted_only_inside_its_request_volume() {
    let mut scene = Scene::new();
    scene.add_root(tileset(node(PagedLod {
        request_volume: within(100.0, DVec3::ZERO),
        ..tile(DVec3::ZERO, "parent")
    })));
    let at = |distance_m: f64| look_at(DVec3::new(0.0, 0.0, distance_m), DVec3::ZERO, DVec3::Y);
    assert_eq!(cull(&scene, &at(101.0)), (vec![], vec![]), "not requested");
    assert_eq!(settle(&mut scene, &at(99.0), &plain), ["parent"]);
    assert_eq!(met(&scene, &at(99.0)), ["parent"]);
    assert!(settle(&mut scene, &at(101.0), &plain).is_empty(), "not drawn although it is loaded");
    assert!(met(&scene, &at(101.0)).is_empty());
}

/// From outside of the volume the parent is drawn, because the near child would leave a hole. That holds after any
/// earlier view, and for the request volume of an external tileset's root.
#[test]
fn tile_is_not_replaced_outside_of_a_childs_request_volume() {
    let [far, near] = [600.0, 400.0].map(from_above);
    for with_a_near_one in [with_a_near_child, with_a_tileset] {
        for (refine, inside, outside) in [
            (Refine::Replace, &["left", "right"][..], &["parent"][..]),
            (Refine::Add, &["left", "parent", "right"], &["left", "parent"]),
        ] {
            let (mut flown, mut new) = (with_a_near_one(refine), with_a_near_one(refine));
            assert_eq!(settle(&mut flown, &far, &plain), outside, "{refine:?}");
            assert_eq!(settle(&mut flown, &near, &plain), inside, "{refine:?}");
            assert_eq!(met(&flown, &near), inside, "{refine:?}");
            for scene in [&mut flown, &mut new] {
                assert_eq!(settle(scene, &far, &plain), outside, "{refine:?}");
                assert_eq!(met(scene, &far), outside, "{refine:?}");
            }
        }
    }
}

/// The root of a tileset is another tileset, whose root has the volume.
#[test]
fn request_volume_is_known_through_nested_tilesets() {
    let load = |uri: &str| match uri {
        "set" => tileset(node(tile(DVec3::ZERO, "inner"))),
        "inner" => near_tileset(),
        _ => square(),
    };
    let mut scene = with_a_tileset(Refine::Replace);
    assert_eq!(settle(&mut scene, &from_above(400.0), &load), ["left", "right"]);
    assert_eq!(settle(&mut scene, &from_above(600.0), &load), ["parent"]);
}

/// The volume outlives the expiry of the tileset. Otherwise it would be loaded again and again from outside.
#[test]
fn request_volume_stays_known_when_its_tileset_expires() {
    let mut scene = with_a_tileset(Refine::Replace);
    settle(&mut scene, &from_above(400.0), &plain);
    let resident = |scene: &Scene, uri: &str| {
        let tile = scene.tiles().find(|tile| scene.slot(tile.node).is_some_and(|slot| **slot.uri == *uri)).unwrap();
        match scene.slot(tile.node).unwrap().state {
            SlotState::Resident(page) => page,
            state => panic!("{uri}: {state:?}"),
        }
    };
    for uri in ["right", "set"] {
        let page = resident(&scene, uri);
        assert!(scene.detach(page).is_ok());
    }
    let nothing: Vec<String> = Vec::new();
    assert_eq!(cull(&scene, &from_above(600.0)), (nothing, vec!["parent".into()]));
    assert_eq!(cull(&scene, &from_above(400.0)), (vec!["set".into()], vec!["parent".into()]));
    // The replacement has no request volume.
    let other = |uri: &str| if uri == "set" { tileset(node(tile(DVec3::ZERO, "right"))) } else { square() };
    assert_eq!(settle(&mut scene, &from_above(400.0), &other), ["left", "right"]);
    assert_eq!(settle(&mut scene, &from_above(600.0), &other), ["left", "right"]);
}

/// There is no hole either while the tile fades in or is loaded again. Drawn tiles can be intersected.
#[test]
fn children_stand_in_for_a_tile_outside_of_a_request_volume() {
    for with_a_near_one in [with_a_near_child, with_a_tileset] {
        let mut scene = with_a_near_one(Refine::Replace);
        settle(&mut scene, &from_above(600.0), &plain);
        settle(&mut scene, &from_above(400.0), &plain);
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        let mut drawn = |scene: &Scene, frame: u32, height_m: f64, simulation_time_s: f64| {
            let mut camera = CullCamera { frame, simulation_time_s, ..from_above(height_m) };
            camera.settings.lod_fade_s = 0.1;
            visitor.cull(scene, &camera, &mut stage);
            (stage.eye_from_drawable.len(), stage.requests.len())
        };
        assert_eq!(drawn(&scene, 1, 400.0, 0.0), (2, 0));
        assert_eq!(drawn(&scene, 2, 400.0, 0.02), (2, 0));
        assert_eq!(drawn(&scene, 3, 600.0, 0.04), (3, 0), "the tile and both children, each in its share of pixels");
        assert_eq!(drawn(&scene, 4, 600.0, 0.20), (1, 0));
        let parent = scene.slots_of_page(scene.roots()[0]).next().unwrap();
        let SlotState::Resident(page) = scene.slot(parent).unwrap().state else { panic!() };
        scene.detach(page).unwrap();
        let standing_in = (vec!["parent".into()], vec!["left".into(), "right".into()]);
        assert_eq!(cull(&scene, &from_above(600.0)), standing_in);
        assert_eq!(met(&scene, &from_above(600.0)), ["left", "right"]);
        assert_eq!(casters(&scene, &from_above(600.0)), 2, "drawn tiles cast shadows");
    }
}

/// Lines passed through where cull draws the content above a tileset, since a tile of the tileset failed.
#[test]
fn content_above_a_tileset_is_met_where_a_tile_of_the_tileset_failed() {
    let near = from_above(400.0);
    let mut scene = with_a_tileset(Refine::Replace);
    for frame in 1..5 {
        let mut stage = RenderStage::new();
        CullVisitor::new().cull(&scene, &CullCamera { frame, ..near }, &mut stage);
        for request in &stage.requests {
            let uri = scene.slot(request.slot).unwrap().uri.to_string();
            match uri == "right" {
                true => scene.set_failed(request.slot, true),
                false => assert!(scene.attach(request.slot, plain(&uri)).is_ok()),
            }
        }
    }
    let mut stage = RenderStage::new();
    CullVisitor::new().cull(&scene, &CullCamera { frame: 5, ..near }, &mut stage);
    assert_eq!((stage.requests.len(), stage.counters.stand_ins), (0, 1));
    let mut line = LineSegmentIntersector::new(DVec3::new(40.0, 1.0, 1.0), DVec3::new(40.0, 1.0, -1.0));
    IntersectionVisitor::as_seen_from(near.eye_point()).traverse(&scene, &mut line);
    let page = |hit: &Intersection| hit.node().unwrap().page;
    let uris: Vec<_> = line.intersections().iter().map(|hit| scene.slot_of(page(hit)).unwrap()).collect();
    let uris: Vec<_> = uris.into_iter().map(|slot| scene.slot(slot).unwrap().uri.to_string()).collect();
    assert_eq!(uris, ["parent"], "once");
}
