//! Contents with volumes of their own (`content.boundingVolume`): requests and drawing. No GPU.

use std::sync::Arc;

use glam::DVec3;
use kit::cull_scenes::look_at;
use terrane::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use terrane::fetch::Limits;
use terrane::formats::{Content, ReadOptions, decode};
use terrane::scene::{
    DrawSlot, Drawable, Geometry, Material, Mesh, MeshVertex, Node, Page, Scene, SlotState, Topology,
};

/// The volume around the contents of the tests: the right part of a tile of 200 m.
const RIGHT: &str = r#"{"box":[80,0,0, 20,0,0, 0,20,0, 0,0,1]}"#;

fn tile(refine: &str, error: u32, content: &str, volume: &str, children: &str) -> String {
    format!(
        r#"{{"boundingVolume":{{"box":[0,0,0, 100,0,0, 0,100,0, 0,0,1]}},"refine":"{refine}","geometricError":{error},
        "content":{{"uri":"{content}","boundingVolume":{volume}}},"children":[{children}]}}"#
    )
}

fn set_of(root: &str) -> Scene {
    let uri = Arc::from("/set/tileset.json");
    let bytes = format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":9999,"root":{root}}}"#).into_bytes();
    let options = ReadOptions::for_root(&uri, Limits::default());
    let page = decode(Content { uri, bytes, reader_data: None, companions: Vec::new() }, &options).unwrap();
    let mut scene = Scene::new();
    scene.add_root(page);
    scene
}

/// Returns a square that fills the whole tile, whatever volume is declared for it.
fn square() -> Page {
    let corner = |x: f32, y: f32| MeshVertex { position: [x, y, 0.0], ..MeshVertex::default() };
    let corners = vec![corner(-100., -100.), corner(100., -100.), corner(100., 100.), corner(-100., 100.)];
    let mesh = Mesh::new(corners, vec![0, 1, 2, 0, 2, 3], Topology::Triangles);
    let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), Material::default());
    let mut page = Page::from_node(Node::geode(vec![drawable])).unwrap();
    page.set_draw_slots(0, vec![DrawSlot(0)]);
    page
}

/// Returns a camera 20 m above a point of the ground, which sees some 12 m to each side of it.
fn above(x: f64) -> CullCamera {
    look_at(DVec3::new(x, 0.0, 20.0), DVec3::new(x, 0.0, 0.0), DVec3::Y)
}

fn cull(scene: &Scene, camera: &CullCamera) -> RenderStage {
    let mut stage = RenderStage::new();
    CullVisitor::new().cull(scene, camera, &mut stage);
    stage
}

/// Returns the names of requested contents, sorted.
fn requested(scene: &Scene, camera: &CullCamera) -> Vec<String> {
    let name = |request: &PageRequest| scene.slot(request.slot).unwrap().uri.trim_start_matches("/set/").to_owned();
    let mut names: Vec<String> = cull(scene, camera).requests.iter().map(name).collect();
    names.sort();
    names
}

fn attach(scene: &mut Scene, name: &str) {
    let slots: Vec<_> = scene.roots().iter().flat_map(|root| scene.slots_of_page(*root)).collect();
    let slot = slots.into_iter().find(|slot| scene.slot(*slot).unwrap().uri.ends_with(name)).unwrap();
    assert!(scene.attach(slot, square()).is_ok());
    assert!(matches!(scene.slot(slot).unwrap().state, SlotState::Resident(_)));
}

/// Contents were requested wherever their tile was in view, and drawn beyond the volume that their set declares.
#[test]
fn content_out_of_sight_is_neither_requested_nor_drawn() {
    let far_child = r#"{"boundingVolume":{"sphere":[0,0,0,100]},"geometricError":0,"content":{"uri":"child.glb"}}"#;
    let cases = [
        ("leaf", tile("ADD", 0, "own.glb", RIGHT, "")),
        ("ADD", tile("ADD", 0, "own.glb", RIGHT, far_child)),
        ("REPLACE", tile("REPLACE", 0, "own.glb", RIGHT, far_child)),
        ("sphere", tile("REPLACE", 0, "own.glb", r#"{"sphere":[80,0,0,20]}"#, far_child)),
    ];
    for (case, root) in cases {
        let mut scene = set_of(&root);
        assert!(requested(&scene, &above(-80.0)).is_empty(), "{case}");
        assert_eq!(requested(&scene, &above(80.0)), ["own.glb"], "{case}");
        attach(&mut scene, "own.glb");
        assert_eq!(cull(&scene, &above(-80.0)).leaf_count(), 0, "{case}");
        assert_eq!(cull(&scene, &above(80.0)).leaf_count(), 1, "{case}");
    }
}

/// A tile is replaced when all its children are ready. Without this request it would be drawn for good.
#[test]
fn content_that_a_tile_above_waits_for_is_requested() {
    let leaf = |name: &str| {
        format!(r#"{{"boundingVolume":{{"sphere":[0,0,0,100]}},"geometricError":0,"content":{{"uri":"{name}.glb"}}}}"#)
    };
    let child = tile("REPLACE", 0, "child.glb", RIGHT, &leaf("below"));
    let mut scene = set_of(&tile("REPLACE", 999, "top.glb", RIGHT, &format!("{child},{}", leaf("other"))));
    attach(&mut scene, "top.glb");
    let stage = cull(&scene, &above(-80.0));
    assert_eq!(requested(&scene, &above(-80.0)), ["child.glb", "other.glb"]);
    let priority = |name: &str| {
        let of_name = |request: &&PageRequest| scene.slot(request.slot).unwrap().uri.ends_with(name);
        stage.requests.iter().find(of_name).unwrap().priority
    };
    assert!(priority("child.glb") < priority("other.glb"), "what is in sight comes first");
}

/// Regression: an unusual member must not refuse a tile.
#[test]
fn invalid_volume_of_a_content_is_left_out() {
    for volume in ["7", r#"{"box":[1]}"#, "{}", "null"] {
        let scene = set_of(&tile("ADD", 0, "own.glb", volume, ""));
        assert_eq!(requested(&scene, &above(-80.0)), ["own.glb"], "{volume}");
    }
}
