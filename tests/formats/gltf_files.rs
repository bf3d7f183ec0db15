//! Contents whose buffers and images are files, read as a whole set.

use serde_json::json;
use terrane::fetch::Limits;
use terrane::formats::verify;

use crate::gltf_builder::*;

const TILESET: &str = r#"{"asset":{"version":"1.1"},"geometricError":1,"root":{"geometricError":0,
    "boundingVolume":{"sphere":[0,0,0,9]},"content":{"uri":"tile.gltf"}}}"#;

#[test]
fn whole_sets_read_external_files() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let uvs = gltf.floats("VEC2", &[0.0; 6]);
    gltf.push("images", json!({ "uri": "a.png" }));
    gltf.push("textures", json!({ "source": 0 }));
    gltf.push(
        "materials",
        json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0 } }),
    );
    gltf.json["buffers"] = json!([{ "byteLength": gltf.buffer.len(), "uri": "data/a.bin" }]);
    gltf.draw(json!({ "attributes": { "POSITION": positions, "TEXCOORD_0": uvs }, "material": 0 }));
    let image = png(4, [1, 2, 3]);
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("data")).unwrap();
    for (file, bytes) in [
        ("tileset.json", TILESET.as_bytes()),
        ("tile.gltf", &gltf.text()),
        ("data/a.bin", &gltf.buffer),
        ("a.png", &image),
    ] {
        std::fs::write(folder.path().join(file), bytes).unwrap();
    }
    let source = folder.path().to_str().unwrap();
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    let all_bytes = TILESET.len() + gltf.text().len() + gltf.buffer.len() + image.len();
    assert_eq!((verified.contents, verified.failed, verified.bytes), (1, 0, all_bytes as u64));
    assert!(verified.ignored.is_empty(), "{verified:?}");
    // A missing image is listed, and the rest of the content is read.
    std::fs::remove_file(folder.path().join("a.png")).unwrap();
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (1, 0));
    assert_eq!(verified.ignored["glTF: external image that is missing"], 1);
}

/// A triangle with these further properties of its primitive.
fn triangle(add: impl FnOnce(&mut GltfBuilder, &mut serde_json::Value)) -> GltfBuilder {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let mut primitive = json!({ "attributes": { "POSITION": positions } });
    add(&mut gltf, &mut primitive);
    gltf.draw(primitive);
    gltf
}

fn kinds(read: &Read) -> Vec<(&str, u64)> {
    read.ignored.iter().collect()
}

/// Regression: animations that target no node (KHR_animation_pointer), invalid ones and cameras refused files that are
/// drawn without them.
#[test]
fn animations_and_cameras_never_refuse_a_file() {
    let mut gltf = triangle(|_, _| {});
    let pointer = json!({ "path": "pointer", "extensions": {
        "KHR_animation_pointer": { "pointer": "/materials/0/alphaCutoff" } } });
    gltf.json["extensionsRequired"] = json!(["KHR_animation_pointer"]);
    for (channel, sampler) in [
        (json!({ "sampler": 0, "target": pointer }), 0),
        (
            json!({ "sampler": 9, "target": {
        "node": 0, "path": "scale" } }),
            77,
        ),
    ] {
        gltf.json["animations"] = json!([{ "channels": [channel], "samplers": [{ "input": sampler, "output": 0 }] }]);
        let read = gltf.read();
        assert_eq!(read.mesh().0.vertices.len(), 3);
        assert_eq!(kinds(&read), [("glTF: animations (drawn at rest)", 1)]);
    }
    gltf.json["animations"] = json!([]);
    gltf.json["cameras"] = json!([{ "type": "orthographic" }]);
    gltf.json["nodes"][0]["camera"] = 0.into();
    assert_eq!(kinds(&gltf.read()), [("glTF: cameras", 1)]);
    gltf.json["cameras"] = json!([{ "name": "without a type" }]);
    assert_eq!(kinds(&gltf.read()), [("glTF: cameras", 1)]);
}

/// Regression: a converter of OpenSceneGraph's files writes indices as floats.
#[test]
fn integers_may_be_written_as_floats() {
    let gltf = triangle(|_, _| {});
    let text = String::from_utf8(gltf.text()).unwrap();
    let floats = text.replace("\"mesh\":0", "\"mesh\":0.0").replace("\"count\":3", "\"count\":3.0");
    assert_ne!(text, floats);
    assert_eq!(read(floats.clone().into_bytes(), Vec::new()).unwrap().mesh().0.vertices.len(), 3);
    let broken = floats.replace("\"count\":3.0", "\"count\":3.5");
    assert!(read(broken.into_bytes(), Vec::new()).unwrap_err().reason().contains("3.5"));
}

#[test]
fn normals_of_two_components_are_left_out() {
    let gltf = triangle(|gltf, primitive| {
        let normals = gltf.floats("VEC2", &[0.0, 1.0, 0.0, 1.0, 0.0, 1.0]);
        primitive["attributes"]["NORMAL"] = normals.into();
    });
    let read = gltf.read();
    assert_eq!(read.mesh().0.vertices[0].normal, [0; 4]);
    assert_eq!(kinds(&read), [("glTF: normals that have not three components", 1)]);
}

/// The largest index of a type begins the next strip (EXT_mesh_primitive_restart).
#[test]
fn largest_index_restarts_strips_and_lines() {
    let five = [[0.0f32; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [2.0, 1.0, 0.0]].concat();
    let indices = |mode: u32, component: u32, list: Vec<u8>, count: usize| {
        let mut gltf = GltfBuilder::new();
        let positions = gltf.floats("VEC3", &five);
        let indices = gltf.accessor(component, "SCALAR", count, &list);
        gltf.json["extensionsRequired"] = json!(["EXT_mesh_primitive_restart"]);
        gltf.draw(json!({ "attributes": { "POSITION": positions }, "indices": indices, "mode": mode }));
        gltf
    };
    let list = |gltf: GltfBuilder| {
        let read = gltf.read();
        assert!(read.ignored.is_empty(), "{:?}", read.ignored);
        read.mesh().0.indices.to_vec()
    };
    assert_eq!(list(indices(3, UNSIGNED_BYTE, vec![0, 1, 255, 2, 3, 4], 6)), [0, 1, 2, 3, 3, 4]);
    assert_eq!(list(indices(5, UNSIGNED_SHORT, shorts(&[0, 1, 2, 65535, 4, 3, 2]), 7)), [0, 1, 2, 4, 3, 2]);
    let words = |list: [u32; 4]| list.iter().flat_map(|index| index.to_le_bytes()).collect();
    assert_eq!(list(indices(2, UNSIGNED_INT, words([u32::MAX, 0, 1, u32::MAX]), 4)), [0, 1, 1, 0]);
    let error = indices(3, UNSIGNED_BYTE, vec![0, 1, 255, 5], 4).error();
    assert!(error.contains("index 5 of 5"), "{error}");
    let error = indices(4, UNSIGNED_BYTE, vec![0, 1, 255], 3).error();
    assert!(error.contains("index 255 of 5"), "{error}");
    let error = indices(3, UNSIGNED_SHORT, shorts(&[0, 1, 255, 2]), 4).error();
    assert!(error.contains("index 255 of 5"), "{error}");
}

#[test]
fn hidden_nodes_are_not_drawn() {
    let mut gltf = triangle(|_, _| {});
    let visibility = |visible: bool| json!({ "KHR_node_visibility": { "visible": visible } });
    let above = gltf.push("nodes", json!({ "children": [0], "extensions": visibility(true) }));
    gltf.json["scenes"][0]["nodes"] = json!([above]);
    gltf.json["extensionsUsed"] = json!(["KHR_node_visibility"]);
    assert_eq!(gltf.read().drawables().len(), 1);
    gltf.json["nodes"][above]["extensions"] = visibility(false);
    let read = gltf.read();
    assert!(read.drawables().is_empty() && read.ignored.is_empty(), "{:?}", read.ignored);
}

/// Regression: an image that cannot be decoded, or that has no source, took its mesh or the whole file with it.
#[test]
fn image_that_cannot_be_read_leaves_the_mesh() {
    let textured = |image: serde_json::Value, view: Option<&[u8]>| {
        let mut gltf = triangle(|gltf, primitive| {
            primitive["attributes"]["TEXCOORD_0"] = gltf.floats("VEC2", &[0.0; 6]).into();
            primitive["material"] = 0.into();
        });
        let mut image = image;
        if let Some(bytes) = view {
            image["bufferView"] = gltf.view(bytes, None).into();
        }
        gltf.push("images", image);
        gltf.push("textures", json!({ "source": 0 }));
        gltf.push("materials", json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }));
        let read = gltf.read();
        (read.mesh().1.material.texture.is_some(), read.ignored.iter().count())
    };
    let image = png(4, [1, 2, 3]);
    assert_eq!(textured(json!({}), Some(&image)), (true, 0), "the bytes say what they are");
    assert_eq!(textured(json!({}), Some(&image[..40])), (false, 1));
    assert_eq!(textured(json!({}), None), (false, 1));
    assert_eq!(textured(json!({ "uri": "data:image/png;base64,!" }), None), (false, 1));
}
