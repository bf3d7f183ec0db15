//! CESIUM_primitive_outline: how outlines are read, and that they are seen without the inner edges of the triangles.

use glam::{DAffine3, DVec2, DVec3};
use image::RgbaImage;
use kit::frames::{MAGENTA, count, keep, pixel};
use kit::rig::{camera, plain, rig};
use serde_json::{Value, json};
use terrane::cull::CullCamera;
use terrane::fetch::Limits;
use terrane::formats::{Content, ReadOptions, Style, decode_noting};
use terrane::scene::{FeatureIds, Node, NodeKind, Topology};
use terrane::state::{Attribute, StateSet};

use crate::gltf_builder::*;
use crate::instances::i3dm;

const EXTENSION: &str = "CESIUM_primitive_outline";

/// The corners of a cube of 2 m, by the bits of their numbers.
fn corners() -> Vec<f32> {
    (0..8).flat_map(|corner| [0, 1, 2].map(|axis| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 })).collect()
}

/// The triangles of the cube, counter-clockwise as seen from outside.
const FACES: [u16; 36] =
    [0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5, 0, 1, 5, 0, 5, 4, 2, 6, 7, 2, 7, 3, 0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6];

/// Returns the edges of the cube: pairs of corners that differ in one axis.
fn cube_edges() -> Vec<u16> {
    let all = (0..8u16).flat_map(|a| [1, 2, 4].map(|axis| [a, a | axis]));
    all.filter(|[a, b]| a != b).flatten().collect()
}

/// Returns a white, unlit cube with these outline indices.
fn cube(edges: &[u16]) -> GltfBuilder {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &corners());
    let faces = gltf.accessor(UNSIGNED_SHORT, "SCALAR", FACES.len(), &shorts(&FACES));
    let edges = gltf.accessor(UNSIGNED_SHORT, "SCALAR", edges.len(), &shorts(edges));
    let material = gltf.push("materials", json!({ "extensions": { "KHR_materials_unlit": {} } }));
    gltf.draw(json!({
        "attributes": { "POSITION": positions }, "indices": faces, "material": material,
        "extensions": { EXTENSION: { "indices": edges } },
    }));
    gltf.json["extensionsUsed"] = json!([EXTENSION, "KHR_materials_unlit"]);
    gltf
}

fn primitive(gltf: &mut GltfBuilder) -> &mut Value {
    gltf.json.pointer_mut("/meshes/0/primitives/0").unwrap()
}

/// Returns the state sets above geodes with the topologies that they draw.
fn geodes(node: &Node) -> Vec<(Option<StateSet>, Vec<Topology>)> {
    let own = match &node.kind {
        NodeKind::Geode(drawables) => {
            let topologies = drawables.iter().map(|drawable| mesh_of(drawable).topology).collect();
            vec![(node.state_set.as_deref().cloned(), topologies)]
        }
        _ => Vec::new(),
    };
    own.into_iter().chain(node.children.iter().flat_map(geodes)).collect()
}

/// Asserts that a content draws lines, and triangles with an offset.
fn assert_outlined(node: &Node, copies: usize) {
    let geodes = geodes(node);
    let (lines, triangles): (Vec<_>, Vec<_>) = geodes.iter().partition(|(set, _)| set.is_none());
    assert!(lines.iter().all(|(_, topologies)| *topologies == [Topology::Lines]), "{geodes:?}");
    let is_offset = |set: &StateSet| matches!(set.attributes[..], [(Attribute::PolygonOffset(_), _)]);
    let is_behind = |(set, topologies): &&(Option<StateSet>, Vec<Topology>)| {
        set.as_ref().is_some_and(is_offset) && *topologies == [Topology::Triangles]
    };
    assert!(triangles.iter().all(is_behind), "{geodes:?}");
    assert_eq!([lines.len(), triangles.len()], [copies; 2]);
}

#[test]
fn outlines_are_lines_beside_their_triangles() {
    let mut gltf = cube(&[0, 1, 1, 3, 3, 1]);
    gltf.json["extensionsRequired"] = json!([EXTENSION]);
    let read = gltf.read();
    assert!(read.ignored.is_empty(), "{:?}", read.ignored);
    assert_outlined(&read.node, 1);
    let drawables = read.drawables();
    let (_, lines) = drawables.iter().find(|(_, drawable)| mesh_of(drawable).topology == Topology::Lines).unwrap();
    let mesh = mesh_of(lines);
    let place = |index: &u32| mesh.vertices[*index as usize].position;
    let places: Vec<_> = mesh.indices.iter().map(place).collect();
    let [a, b, c] = [[-1.0, -1.0, -1.0], [1.0, -1.0, -1.0], [1.0, 1.0, -1.0]];
    assert_eq!(places, [a, b, b, c, c, b]);
    assert_eq!(mesh.vertices.len(), 3, "only the vertices of lines");
    assert_eq!((lines.material.base_color, lines.material.unlit), ([0.0, 0.0, 0.0, 1.0], true));
    // Without edges, nothing changes.
    let read = cube(&[]).read();
    assert_eq!(geodes(&read.node), [(None, vec![Topology::Triangles])]);
}

#[test]
fn invalid_outlines_are_noted_and_the_triangles_drawn() {
    let with = |extension: Value| {
        let mut gltf = cube(&[0, 1]);
        let wrong = gltf.floats("SCALAR", &[0.0, 1.0]);
        let vectors = gltf.floats("VEC3", &[0.0; 6]);
        assert_eq!([wrong, vectors], [3, 4]);
        primitive(&mut gltf)["extensions"][EXTENSION] = extension;
        gltf
    };
    let mut files: Vec<GltfBuilder> = [json!(null), json!({}), json!(7), json!({ "indices": null })]
        .into_iter()
        .chain([json!(99), json!(-1), json!("2"), json!(3), json!(4)].map(|index| json!({ "indices": index })))
        .map(with)
        .collect();
    files.extend([cube(&[0, 8]), cube(&[0, 1, 2])]);
    for gltf in files {
        let read = gltf.read();
        assert_eq!(read.ignored.count("glTF: invalid outline"), 1, "{:?}", read.ignored);
        assert_eq!(geodes(&read.node), [(None, vec![Topology::Triangles])]);
    }
    let mut missing = cube(&[0, 1]);
    let buffer =
        missing.push("buffers", json!({ "byteLength": missing.buffer.len(), "uri": data_uri(&missing.buffer) }));
    missing.push("buffers", json!({ "byteLength": 4, "uri": "lost.bin" }));
    let view = missing.push("bufferViews", json!({ "buffer": buffer + 1, "byteLength": 4 }));
    missing.json["accessors"][2]["bufferView"] = view.into();
    let read = missing.read();
    let kind = "glTF: outline that is not drawn because its buffer is missing";
    assert_eq!((read.ignored.count(kind), read.drawables().len()), (1, 1), "{:?}", read.ignored);
    let mut lines = cube(&[0, 1]);
    primitive(&mut lines)["mode"] = 1.into();
    let read = lines.read();
    let kind = "glTF: outline of a primitive without triangles";
    assert_eq!((read.ignored.count(kind), read.drawables().len()), (1, 1), "{:?}", read.ignored);
}

#[test]
fn instances_have_outlines() {
    let mut gltf = cube(&cube_edges());
    let translations = gltf.floats("VEC3", &[0.0, 0.0, 0.0, 5.0, 0.0, 0.0]);
    let attributes = json!({ "attributes": { "TRANSLATION": translations } });
    gltf.json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": attributes });
    assert_outlined(&gltf.read().node, 2);
    let table = r#"{"INSTANCES_LENGTH":3,"POSITION":{"byteOffset":0}}"#;
    let bytes = i3dm(table, &floats(&[0.0; 9]), 1, &cube(&cube_edges()).glb());
    assert_outlined(&read(bytes, Vec::new()).unwrap().node, 3);
    // Nodes that draw one mesh share it.
    let mut twice = cube(&cube_edges());
    twice.json["scenes"] = json!([{ "nodes": [0, 1] }]);
    twice.push("nodes", json!({ "mesh": 0, "translation": [9, 0, 0] }));
    let node = twice.read().node;
    assert_outlined(&node, 2);
    let drawables = Read { node, ignored: Default::default() }.drawables();
    let lines: Vec<_> = drawables.iter().map(|(_, d)| mesh_of(d)).filter(|m| m.topology == Topology::Lines).collect();
    assert!(std::sync::Arc::ptr_eq(&lines[0], &lines[1]));
}

/// Returns the cube whose lower half (corners 0 to 3) is feature 0 and whose upper half is feature 1, read by options.
fn cube_of_features(options: &ReadOptions) -> Read {
    let mut gltf = cube(&cube_edges());
    let ids = gltf.accessor(UNSIGNED_BYTE, "SCALAR", 8, &[0, 0, 0, 0, 1, 1, 1, 1]);
    let primitive = primitive(&mut gltf);
    primitive["attributes"]["_FEATURE_ID_0"] = ids.into();
    primitive["extensions"]["EXT_mesh_features"] = json!({ "featureIds": [{ "featureCount": 2, "attribute": 0 }] });
    let content = Content { uri: URI.into(), bytes: gltf.text(), reader_data: None, companions: Vec::new() };
    let (node, ignored) = decode_noting(content, options).unwrap();
    Read { node, ignored }
}

#[test]
fn outlines_belong_to_the_features_of_their_triangles() {
    let options = ReadOptions { keep_features: true, ..ReadOptions::for_root("/set/tileset.json", Limits::default()) };
    let drawables = cube_of_features(&options).drawables();
    let (_, lines) = drawables.iter().find(|(_, drawable)| mesh_of(drawable).topology == Topology::Lines).unwrap();
    let [set] = &lines.features.as_ref().unwrap().sets[..] else { panic!("one set") };
    let FeatureIds::PerVertex(ids) = &set.ids else { panic!("by vertex") };
    let mesh = mesh_of(lines);
    assert_eq!(ids.len(), 8);
    assert!(mesh.vertices.iter().zip(ids.iter()).all(|(vertex, id)| (vertex.position[2] > 0.0) == (*id == 1)));
    // A style that hides everything hides the outlines too.
    let style = Style::from_json("style.json", br#"{ "show": "false" }"#).unwrap();
    let hidden = ReadOptions { style: Some(std::sync::Arc::new(style)), ..options };
    assert!(cube_of_features(&hidden).drawables().is_empty());
}

/// A visible edge of the cube in the image, pixels.
struct Edge {
    from: DVec2,
    to: DVec2,
}

impl Edge {
    /// Returns the distance from a point.
    fn distance(&self, point: DVec2) -> f64 {
        let along = self.to - self.from;
        let part = ((point - self.from).dot(along) / along.length_squared()).clamp(0.0, 1.0);
        point.distance(self.from + part * along)
    }
}

/// Returns the edges of the cube that a camera sees: those of faces that are turned to it.
fn visible_edges(view: &CullCamera, eye: DVec3) -> Vec<Edge> {
    let corner = |c: u16| DVec3::from_array([0, 1, 2].map(|axis| if c >> axis & 1 == 1 { 1.0 } else { -1.0 }));
    let size = f64::from(view.viewport_px[0]);
    let in_image = |c: u16| {
        let clip = view.clip_from_eye * view.eye_from_world.transform_point3(corner(c)).extend(1.0);
        DVec2::new(0.5 + 0.5 * clip.x / clip.w, 0.5 - 0.5 * clip.y / clip.w) * size
    };
    let edges = cube_edges();
    let is_seen = |pair: &&[u16]| {
        let middle = 0.5 * (corner(pair[0]) + corner(pair[1]));
        // The coordinates of the middle that are not 0 are those of the two faces.
        (0..3).any(|axis| middle[axis] != 0.0 && middle[axis] * eye[axis] > 1.0)
    };
    let seen = edges.as_chunks::<2>().0.iter().map(|pair| &pair[..]).filter(is_seen);
    seen.map(|pair| Edge { from: in_image(pair[0]), to: in_image(pair[1]) }).collect()
}

fn is_black(picture: &RgbaImage, x: i64, y: i64) -> bool {
    let is_inside = (0..i64::from(picture.width())).contains(&x) && (0..i64::from(picture.height())).contains(&y);
    is_inside && pixel(picture, x as u32, y as u32) == [0; 3]
}

#[test]
fn edges_are_seen_from_all_sides_without_inner_edges() {
    let Some(mut rig) = rig("edges_are_seen_from_all_sides_without_inner_edges") else { return };
    let scene = rig.scene(cube(&cube_edges()).read().node);
    let eyes = [
        [3.0, 2.0, 1.5],
        [-2.0, 3.0, -1.0],
        [4.0, 1.2, 1.1],
        [-1.1, -1.3, 5.0],
        [1.5, 1.02, -1.5],
        [40.0, 30.0, 20.0],
        [-3.0, 1.01, 400.0],
        [5.0, 0.3, 0.2],
        [0.0, -3.0, 0.0],
    ];
    for (number, eye) in eyes.into_iter().enumerate() {
        let eye = DVec3::from_array(eye);
        let up = if eye.x == 0.0 { DVec3::X } else { DVec3::Z };
        let mut view = camera([256; 2], eye, DVec3::ZERO, up);
        // The cube has about the same size in all images.
        let zoom = eye.length() / 4.0;
        view.clip_from_eye.x_axis *= zoom.max(1.0);
        view.clip_from_eye.y_axis *= zoom.max(1.0);
        let picture = rig.picture(&scene, &view, &plain());
        keep(&format!("outline_{number}"), &picture);
        let edges = visible_edges(&view, eye);
        assert!(edges.len() >= 4);
        let (mut black, mut white) = (0, 0);
        for (x, y, p) in picture.enumerate_pixels() {
            let at = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            if p.0[..3] == [0; 3] {
                black += 1;
                // A hidden edge may be seen for one pixel from its corner on.
                assert!(edges.iter().any(|edge| edge.distance(at) < 1.5), "{number}: a line at {x}, {y}");
            } else if p.0[..3] != MAGENTA {
                white += 1;
            }
        }
        assert!(white > 3_000, "{number}: {white} pixels of faces, {black} of lines");
        // Each pixel along the longer axis of an edge has its line.
        for Edge { from, to } in &edges {
            let along = *to - *from;
            let steps = along.abs().max_element();
            for step in 1..steps as u32 {
                let at = *from + along * f64::from(step) / steps;
                let (x, y) = (at.x.floor() as i64, at.y.floor() as i64);
                let is_outside = !(1..255).contains(&x) || !(1..255).contains(&y);
                let around = (-1..2).flat_map(|dx| (-1..2).map(move |dy| (x + dx, y + dy)));
                let is_there = around.into_iter().any(|(x, y)| is_black(&picture, x, y));
                assert!(is_outside || is_there, "{number}: no line at {x}, {y}");
            }
        }
    }
    rig.release(scene);
    assert!(rig.renderer.take_errors().is_empty());
}

/// Far from the origin, and hidden by another thing, an outline behaves like its triangles.
#[test]
fn outlines_are_hidden_by_what_is_in_front() {
    let Some(mut rig) = rig("outlines_are_hidden_by_what_is_in_front") else { return };
    let origin = DVec3::new(6.4e6, 100.0, -200.0);
    let cube = cube(&cube_edges()).read().node;
    let wall = kit::shapes::quad([0.0, 0.0, 1.05], [3.0, 3.0], [0.0, 1.0, 0.0, 1.0]);
    let mut black = |nodes: Vec<Node>| {
        let scene = rig.scene(Node::transform(DAffine3::from_translation(origin), nodes));
        let view = camera([128; 2], origin + DVec3::new(0.5, 0.3, 5.0), origin, DVec3::Y);
        let picture = rig.picture(&scene, &view, &plain());
        rig.release(scene);
        count(&picture, [0; 3])
    };
    assert!(black(vec![cube.clone()]) > 200);
    assert_eq!(black(vec![cube, Node::geode(vec![wall])]), 0);
}
