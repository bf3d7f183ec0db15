//! KHR_lights_punctual: how lights are read, and what they light.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::frames::{keep, pixel, srgb};
use kit::rig::{Rig, camera, plain, rig};
use serde_json::{Value, json};
use terrane::fetch::Limits;
use terrane::formats::{Content, ReadOptions, decode_noting};
use terrane::scene::{Environment, LocalLights, Node, NodeKind};
use terrane::state::Light;

use crate::gltf_builder::*;
use crate::instances::i3dm;

const EXTENSION: &str = "KHR_lights_punctual";

/// Returns a document with these lights and nodes, all of them roots of the scene.
fn document(lights: Value, nodes: Value) -> GltfBuilder {
    let mut gltf = GltfBuilder::new();
    let count = nodes.as_array().unwrap().len();
    gltf.json["scenes"] = json!([{ "nodes": (0..count).collect::<Vec<_>>() }]);
    gltf.json["nodes"] = nodes;
    gltf.json["extensions"] = json!({ EXTENSION: { "lights": lights } });
    gltf.json["extensionsUsed"] = json!([EXTENSION]);
    gltf
}

/// Returns a node with a light.
fn with_light(light: Value) -> Value {
    json!({ "extensions": { EXTENSION: { "light": light } } })
}

/// Returns the lights of a content, in the frame of the file.
fn lights(read: &Read) -> Vec<Light> {
    let [Node { kind: NodeKind::LocalLights(LocalLights { lights }), .. }] = &read.node.children[..] else {
        return Vec::new();
    };
    lights.clone()
}

/// Reads one light on a node without a transform.
fn light(json: Value) -> (Option<Light>, Read) {
    let read = document(json!([json]), json!([with_light(json!(0))])).read();
    (lights(&read).first().copied(), read)
}

#[test]
fn kinds_of_lights_have_their_defaults() {
    let one = Environment::SUN_LUX.recip();
    let point = Light {
        position: [0.0, 0.0, 0.0, 1.0],
        direction: [0.0, 0.0, -1.0],
        diffuse: [one; 3],
        specular: [one; 3],
        attenuation: [0.0, 0.0, 1.0],
        ..Light::default()
    };
    assert_eq!((point.range_m, point.spot_cutoff), (f32::INFINITY, PI), "the defaults of the engine");
    assert_eq!(light(json!({ "type": "point" })).0, Some(point));
    let directional = Light { position: [0.0, 0.0, 1.0, 0.0], attenuation: [1.0, 0.0, 0.0], ..point };
    assert_eq!(light(json!({ "type": "directional" })).0, Some(directional));
    let spot = Light { spot_cutoff: FRAC_PI_4, spot_inner_cutoff: 0.0, ..point };
    for json in [json!({ "type": "spot" }), json!({ "type": "spot", "spot": {}, "range": null, "color": null })] {
        let (light, read) = light(json);
        assert_eq!((light, read.ignored.is_empty()), (Some(spot), true));
    }
}

#[test]
fn values_of_lights_are_read() {
    let (point, read) = light(json!({ "type": "point", "color": [1, 0.5, 0], "intensity": 300, "range": 20 }));
    let point = point.unwrap();
    assert_eq!((point.diffuse, point.range_m), ([300e-5, 150e-5, 0.0], 20.0));
    assert!(read.ignored.is_empty(), "{:?}", read.ignored);
    let cone = |inner: f64, outer: f64| {
        let spot = json!({ "innerConeAngle": inner, "outerConeAngle": outer });
        light(json!({ "type": "spot", "spot": spot })).0.map(|light| [light.spot_inner_cutoff, light.spot_cutoff])
    };
    assert_eq!(cone(0.2, 0.5), Some([0.2, 0.5]));
    // A right angle in single precision is a little more than one.
    assert_eq!(cone(0.0, f64::from(FRAC_PI_2)), Some([0.0, FRAC_PI_2]));
    assert_eq!(cone(0.7, 0.5), Some([0.5, 0.5]), "a sharp rim");
    assert_eq!([cone(-0.1, 0.5), cone(0.0, 0.0), cone(0.0, 1.6)], [None; 3]);
}

#[test]
fn invalid_lights_are_noted_and_do_not_shine() {
    for json in [
        json!({}),
        json!({ "type": 7 }),
        json!({ "type": "area" }),
        json!(7),
        json!({ "type": "point", "intensity": -1 }),
        json!({ "type": "point", "intensity": 1e300 }),
        json!({ "type": "point", "color": [1, -1, 0] }),
        json!({ "type": "point", "color": [1, 1] }),
        json!({ "type": "point", "range": 0 }),
        json!({ "type": "point", "range": -3 }),
        json!({ "type": "point", "range": 1e-300 }),
        json!({ "type": "spot", "spot": 3 }),
    ] {
        let (light, read) = light(json.clone());
        assert_eq!((light, read.ignored.count("glTF: invalid light")), (None, 1), "{json}");
        assert_eq!(read.ignored.iter().count(), 1, "{json}: {:?}", read.ignored);
    }
    let huge = light(json!({ "type": "point", "intensity": 1e12, "range": 1e300 })).0.unwrap();
    assert_eq!((huge.diffuse, huge.range_m), ([1e7; 3], f32::INFINITY));
}

#[test]
fn nodes_with_lights_that_do_not_exist_are_noted() {
    let none = "glTF: light that does not exist";
    for index in [json!(1), json!(-1), json!("0"), json!(null), json!(u64::MAX)] {
        let read = document(json!([{ "type": "point" }]), json!([with_light(index.clone()), {}])).read();
        assert_eq!((lights(&read).len(), read.ignored.count(none)), (0, 1), "{index}");
    }
    for extensions in [json!(null), json!({}), json!({ EXTENSION: null }), json!({ EXTENSION: { "lights": 3 } })] {
        let mut gltf = document(json!([]), json!([with_light(json!(0))]));
        gltf.json["extensions"] = extensions.clone();
        let read = gltf.read();
        assert_eq!((lights(&read).len(), read.ignored.count(none)), (0, 1), "{extensions}");
    }
    let mut required = document(json!([{ "type": "point" }]), json!([with_light(json!(0))]));
    required.json["extensionsRequired"] = json!([EXTENSION]);
    assert_eq!(lights(&required.read()).len(), 1);
}

#[test]
fn lights_have_the_place_and_direction_of_their_nodes() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // A quarter turn around y: negative z becomes negative x. The scale is that of a parent far away.
    let mut child = with_light(json!(0));
    (child["rotation"], child["translation"]) = (json!([0, half, 0, half]), json!([1, 2, 3]));
    let parent = json!({ "children": [1], "scale": [2, 2, 2], "translation": [6_000_000.25, 0, 0] });
    let place = |kind: &str| {
        let mut gltf = document(json!([{ "type": kind, "range": 5 }]), json!([parent, child]));
        gltf.json["scenes"] = json!([{ "nodes": [0] }]);
        let [light] = lights(&gltf.read())[..] else { panic!("one light") };
        assert_eq!(light.range_m, 5.0);
        (light.position, light.direction.map(|part| part.round() + 0.0))
    };
    assert_eq!(place("spot"), ([6_000_002.25, 4.0, 6.0, 1.0], [-1.0, 0.0, 0.0]));
    let ([x, y, z, w], _) = place("directional");
    assert_eq!([x, y, z, w].map(|part| part.round() + 0.0), [1.0, 0.0, 0.0, 0.0], "towards the light");
    // A node without extent has a position, but no direction.
    for (kind, count) in [("point", 1), ("spot", 0), ("directional", 0)] {
        let mut node = with_light(json!(0));
        node["scale"] = json!([0, 0, 0]);
        let read = document(json!([{ "type": kind }]), json!([node])).read();
        assert_eq!(lights(&read).len(), count, "{kind}");
        assert_eq!(read.ignored.count("glTF: light of a node without extent"), 1 - count as u64, "{kind}");
    }
}

#[test]
fn first_lights_of_a_document_are_kept() {
    let nodes: Vec<Value> = (0..20).map(|_| with_light(json!(0))).collect();
    let read = document(json!([{ "type": "point" }]), json!(nodes)).read();
    assert_eq!(lights(&read).len(), LocalLights::MAX);
    assert_eq!(read.ignored.count("glTF: lights beyond the first 16 of a glTF"), 4);
}

#[test]
fn lights_of_instanced_models_are_noted() {
    let positions: Vec<u8> = floats(&[0.0; 6]);
    let table = r#"{"INSTANCES_LENGTH":2,"POSITION":{"byteOffset":0}}"#;
    let mut model = document(json!([{ "type": "point" }]), json!([with_light(json!(0))]));
    let vertices = model.floats("VEC3", &TRIANGLE);
    let mesh = model.push("meshes", json!({ "primitives": [{ "attributes": { "POSITION": vertices } }] }));
    model.json["nodes"][0]["mesh"] = mesh.into();
    let bytes = i3dm(table, &positions, 1, &model.glb());
    let options = ReadOptions::for_root("/set/tileset.json", Limits::default());
    let content = Content { uri: URI.into(), bytes, reader_data: None, companions: Vec::new() };
    let (node, ignored) = decode_noting(content, &options).unwrap();
    assert_eq!(ignored.count("i3dm: lights of the model"), 1, "{ignored:?}");
    assert_eq!(Read { node, ignored }.node_drawables().len(), 2);
}

/// Adds a wall in the plane z = `z` that faces +z, from `min` to `max` in x and y. Returns its node.
fn add_wall(gltf: &mut GltfBuilder, min: [f32; 2], max: [f32; 2], z: f32, material: Value) -> usize {
    let ([x0, y0], [x1, y1]) = (min, max);
    let positions = gltf.floats("VEC3", &[x0, y0, z, x1, y0, z, x1, y1, z, x0, y1, z]);
    let normals = gltf.floats("VEC3", &[0.0, 0.0, 1.0].repeat(4));
    let indices = gltf.accessor(UNSIGNED_SHORT, "SCALAR", 6, &shorts(&[0, 1, 2, 0, 2, 3]));
    let material = gltf.push("materials", material);
    let primitive = json!({
        "attributes": { "POSITION": positions, "NORMAL": normals }, "indices": indices, "material": material,
    });
    let mesh = gltf.push("meshes", json!({ "primitives": [primitive] }));
    gltf.push("nodes", json!({ "mesh": mesh }))
}

fn matte() -> Value {
    json!({ "pbrMetallicRoughness": { "metallicFactor": 0, "roughnessFactor": 1 } })
}

/// Returns a document with one wall, 4 m wide around the origin, and a light on a node with a transform.
fn lit_wall(light: Value, transform: Value, material: Value) -> GltfBuilder {
    let mut node = with_light(json!(0));
    node.as_object_mut().unwrap().extend(transform.as_object().unwrap().clone());
    let mut gltf = document(json!([light]), json!([node]));
    let wall = add_wall(&mut gltf, [-2.0, -2.0], [2.0, 2.0], 0.0, material);
    gltf.json["scenes"] = json!([{ "nodes": [0, wall] }]);
    gltf
}

/// Draws a content in the dark, seen along negative z of the file from a distance at which the image is 4 m wide.
fn seen(rig: &mut Rig, read: Read) -> RgbaImage {
    let scene = rig.scene(read.node);
    let eye_m = 2.0 / 0.5f64.tan();
    let view = camera([128; 2], DVec3::new(0.0, -eye_m, 0.0), DVec3::ZERO, DVec3::Z);
    let dark = Environment { sun_color: [0.0; 3], ambient_color: [0.0; 3], ..plain() };
    let picture = rig.picture(&scene, &view, &dark);
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    picture
}

/// Returns the pixel at a point of the wall, metres from its middle.
fn at(picture: &RgbaImage, x: f32, y: f32) -> [u8; 3] {
    pixel(picture, (64.0 + 32.0 * x) as u32, (64.0 - 32.0 * y) as u32)
}

fn assert_near(got: [u8; 3], linear: [f32; 3]) {
    let want = linear.map(|value| srgb(value.into()));
    assert!(got.iter().zip(want).all(|(got, want)| got.abs_diff(want) <= 3), "{got:?} instead of {want:?}");
}

#[test]
fn point_light_lights_a_near_wall_and_not_a_far_one() {
    let Some(mut rig) = rig("point_light_lights_a_near_wall_and_not_a_far_one") else { return };
    let mut drawn = |range: Value| {
        let light = json!({ "type": "point", "intensity": 40_000, "range": range, "color": [1, 0.5, 0.25] });
        let mut node = with_light(json!(0));
        node["translation"] = json!([0, 0, 1]);
        let mut gltf = document(json!([light]), json!([node]));
        let near = add_wall(&mut gltf, [-2.0, -2.0], [0.0, 2.0], 0.0, matte());
        let far = add_wall(&mut gltf, [0.0, -20.0], [20.0, 20.0], -19.0, matte());
        gltf.json["scenes"] = json!([{ "nodes": [0, near, far] }]);
        seen(&mut rig, gltf.read())
    };
    let endless = drawn(json!(null));
    keep("point_light", &endless);
    // 40,000 candela are 40,000 lux at 1 m, which is 0.4 of the sun.
    assert_near(at(&endless, -0.05, 0.0), [0.4, 0.2, 0.1]);
    // At 45 degrees twice the square of the distance, and the cosine.
    assert_near(at(&endless, -1.0, 0.0), [0.4, 0.2, 0.1].map(|part| part / 8f32.sqrt()));
    let far = at(&endless, 0.1, 0.0);
    assert!((1..=6).contains(&far[0]), "0.001 of the sun: {far:?}");
    let ending = drawn(json!(2.0));
    assert_near(at(&ending, -0.05, 0.0), [0.4, 0.2, 0.1].map(|part| part * (1.0 - 0.0625)));
    assert_near(at(&ending, -1.0, 0.0), [0.4, 0.2, 0.1].map(|part| part / 8f32.sqrt() * 0.75));
    assert_eq!([at(&ending, -1.8, 0.0), at(&ending, 0.1, 0.0)], [[0; 3]; 2], "beyond the range");
}

#[test]
fn spot_light_has_a_cone() {
    let Some(mut rig) = rig("spot_light_has_a_cone") else { return };
    // 2 m in front of the wall, the cone has a radius of 1 m on it.
    let (inner, outer) = (0.25f64.atan(), 0.5f64.atan());
    let spot = json!({ "innerConeAngle": inner, "outerConeAngle": outer });
    let light = json!({ "type": "spot", "intensity": 200_000, "spot": spot });
    let picture = seen(&mut rig, lit_wall(light, json!({ "translation": [0, 0, 2] }), matte()).read());
    keep("spot_light", &picture);
    assert_near(at(&picture, 0.0, 0.0), [0.5; 3]);
    assert_near(at(&picture, 0.45, 0.0), [0.5 * (4.0f32 / 4.2025).powf(1.5); 3]);
    let share = |radius: f32| {
        let cosine = |radius: f32| 2.0 / (4.0 + radius * radius).sqrt();
        let inside = (cosine(radius) - cosine(1.0)) / (cosine(0.5) - cosine(1.0));
        inside * inside * 0.5 * cosine(radius).powi(3)
    };
    for (x, y) in [(0.75, 0.0), (0.0, -0.75), (-0.6, 0.6)] {
        assert_near(at(&picture, x, y), [share((x * x + y * y).sqrt() + 0.01); 3]);
    }
    for (x, y) in [(1.05, 0.0), (0.0, 1.05), (-0.75, -0.75)] {
        assert_eq!(at(&picture, x, y), [0; 3]);
    }
}

#[test]
fn direction_of_lights_follows_their_nodes() {
    let Some(mut rig) = rig("direction_of_lights_follows_their_nodes") else { return };
    let mut drawn = |light: Value, transform: Value| seen(&mut rig, lit_wall(light, transform, matte()).read());
    let directional = || json!({ "type": "directional", "intensity": 50_000 });
    let around_y = |degrees: f64| {
        let (sin, cos) = (0.5 * degrees.to_radians()).sin_cos();
        json!({ "rotation": [0, sin, 0, cos], "scale": [3, 3, 3], "translation": [7, 8, 9] })
    };
    for (degrees, cosine) in [(0.0, 1.0), (60.0, 0.5), (-60.0, 0.5), (120.0, 0.0), (180.0, 0.0)] {
        assert_near(at(&drawn(directional(), around_y(degrees)), 0.5, 0.5), [0.5 * cosine; 3]);
    }
    // A spot that is turned by 45 degrees around y shines to the left.
    let spot = json!({ "type": "spot", "intensity": 200_000, "spot": { "outerConeAngle": 0.3 } });
    let mut turned = around_y(45.0);
    turned["translation"] = json!([1, 0, 2]);
    let picture = drawn(spot, turned);
    assert!(at(&picture, -1.0, 0.0)[0] > 80 && at(&picture, 1.0, 0.0) == [0; 3]);
    // The same by a matrix.
    let turn = DAffine3::from_translation(DVec3::new(1.0, 0.0, 2.0)) * DAffine3::from_rotation_y(45f64.to_radians());
    let columns = glam::DMat4::from(turn).to_cols_array();
    let spot = json!({ "type": "spot", "intensity": 200_000, "spot": { "outerConeAngle": 0.3 } });
    assert_eq!(drawn(spot, json!({ "matrix": columns })), picture);
}

#[test]
fn lights_are_mirrored_by_surfaces() {
    let Some(mut rig) = rig("lights_are_mirrored_by_surfaces") else { return };
    let mut drawn = |metallic: f32, roughness: f32| {
        let factors = json!({
            "baseColorFactor": [0.8, 0.2, 0.1, 1], "metallicFactor": metallic, "roughnessFactor": roughness,
        });
        let light = json!({ "type": "point", "intensity": 40_000 });
        let material = json!({ "pbrMetallicRoughness": factors });
        let picture = seen(&mut rig, lit_wall(light, json!({ "translation": [0, 0, 1] }), material).read());
        keep(&format!("surface_{metallic}_{roughness}"), &picture);
        [at(&picture, 0.02, 0.0), at(&picture, 1.2, 0.0)]
    };
    let [glossy, beside] = drawn(0.0, 0.3);
    assert!(glossy.iter().all(|part| *part > 160), "a white highlight: {glossy:?}");
    assert!(beside[0] > 60 && beside[0] > 2 * beside[2], "the surface's own colour beside it: {beside:?}");
    let [glossy, _] = drawn(1.0, 0.6);
    assert!(
        glossy[0] > 150 && 3 * u32::from(glossy[2]) < 2 * u32::from(glossy[0]),
        "metal tints its highlight: {glossy:?}"
    );
    let [_, beside] = drawn(1.0, 0.3);
    assert!(beside[0] < 20, "metal has no diffuse reflection: {beside:?}");
    let [rough, _] = drawn(0.0, 1.0);
    assert!(rough[0] > 2 * rough[2] && rough[0] < 200, "{rough:?}");
}

/// A glTF's lights do not light another content, whatever the order.
#[test]
fn lights_light_their_own_content_alone() {
    let Some(mut rig) = rig("lights_light_their_own_content_alone") else { return };
    let content = |min_x: f32, color: Option<[f32; 3]>| {
        let lights = color.map(|color| json!({ "type": "directional", "intensity": 100_000, "color": color }));
        let mut gltf = document(
            json!(lights.as_slice()),
            json!([if lights.is_some() { with_light(json!(0)) } else { json!({}) }]),
        );
        let wall = add_wall(&mut gltf, [min_x, -2.0], [min_x + 1.0, 2.0], 0.0, matte());
        gltf.json["scenes"] = json!([{ "nodes": [0, wall] }]);
        gltf.read().node
    };
    let colors = [Some([1.0, 0.0, 0.0]), None, Some([0.0, 1.0, 0.0]), Some([0.0, 0.0, 1.0])];
    let nodes = colors.iter().zip([-2.0, -1.0, 0.0, 1.0]).map(|(color, x)| content(x, *color));
    let node = Node::group(nodes.collect());
    let read = Read { node, ignored: Default::default() };
    let picture = seen(&mut rig, read);
    let got = [-1.5, -0.5, 0.5, 1.5].map(|x| at(&picture, x, 0.5));
    assert_eq!(got, [[255, 0, 0], [0; 3], [0, 255, 0], [0, 0, 255]]);
}
