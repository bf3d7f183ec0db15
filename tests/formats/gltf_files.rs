//! Contents whose buffers and images are files, read as a whole set.

use serde_json::json;
use terrane::fetch::{IoError, Limits};
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

/// Regression: one such vertex took the primitive.
#[test]
fn vertices_whose_positions_are_no_numbers_take_their_triangles() {
    let drawn = |positions: &[f32], indices: &[u16], mode: u32| {
        let mut gltf = GltfBuilder::new();
        let positions = gltf.floats("VEC3", positions);
        let list = gltf.accessor(UNSIGNED_SHORT, "SCALAR", indices.len(), &shorts(indices));
        gltf.draw(json!({ "attributes": { "POSITION": positions }, "indices": list, "mode": mode }));
        gltf
    };
    let square = [f32::NAN, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, f32::INFINITY, 2.0];
    for (mode, left, left_out) in [(4, vec![1, 2, 3], 2), (5, vec![1, 2, 3], 4), (0, vec![1, 2, 3], 6)] {
        let read = drawn(&square, &[0, 4, 0, 1, 2, 3, 4, 0, 4], mode).read();
        let (mesh, _) = read.mesh();
        let mut indices = mesh.indices.to_vec();
        indices.sort_unstable();
        assert_eq!(indices, left, "mode {mode}");
        assert_eq!(read.ignored.count("glTF: triangle, line or point whose positions are not finite"), left_out);
        assert!(mesh.vertices.iter().flat_map(|vertex| vertex.position).all(f32::is_finite));
        assert_eq!((mesh.bounds.min.to_array(), mesh.bounds.max.to_array()), ([0.0; 3], [1.0, 1.0, 0.0]));
    }
    assert!(drawn(&square, &[0, 1, 2], 4).error().contains("no primitive has finite positions"));
    assert!(drawn(&[f32::NAN; 9], &[0, 1, 2], 4).error().contains("no position is finite"));
}

#[test]
fn node_with_an_invalid_transform_is_left_out_alone() {
    let mut gltf = triangle(|_, _| {});
    gltf.json["nodes"][0]["rotation"] = json!([0, 0, 0, 0]);
    assert!(gltf.read().ignored.is_empty(), "four zeros are no rotation");
    let odd = gltf.push("nodes", json!({ "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2] }));
    gltf.json["scenes"][0]["nodes"] = json!([0, odd]);
    let read = gltf.read();
    assert_eq!((read.drawables().len(), read.ignored.iter().count()), (1, 1));
    gltf.json["scenes"][0]["nodes"] = json!([odd]);
    assert!(gltf.error().contains("not affine"));
}

#[test]
fn chunks_may_be_padded_with_zeros_and_shorter_than_declared() {
    let mut gltf = triangle(|_, _| {});
    let text = |gltf: &GltfBuilder, before: &str, after: &str| -> Vec<u8> {
        let json = [before, std::str::from_utf8(&gltf.text()).unwrap(), after].concat();
        let words = [2, 20 + json.len() as u32, json.len() as u32].map(u32::to_le_bytes).concat();
        [b"glTF", &words[..], b"JSON", json.as_bytes()].concat()
    };
    for (before, after) in [("", "\0\0\0"), ("\u{feff}", ""), ("\u{feff}", " \0")] {
        assert_eq!(read(text(&gltf, before, after), Vec::new()).unwrap().drawables().len(), 1, "{after:?}");
    }
    let uri = data_uri(&gltf.buffer);
    gltf.json["buffers"] = json!([{ "byteLength": gltf.buffer.len() + 400, "uri": uri }]);
    let long = gltf.read();
    assert_eq!((long.drawables().len(), long.ignored.iter().count()), (1, 1));
}

/// Regression: a content without its only buffer counted as drawn.
#[test]
fn content_of_which_nothing_is_left_says_why() {
    let mut gltf = triangle(|_, _| {});
    gltf.json["buffers"] = json!([{ "byteLength": gltf.buffer.len(), "uri": "sub\\a.bin" }]);
    let known = |bytes: Result<Vec<u8>, IoError>| read(gltf.text(), vec![("/set/sub/a.bin".into(), bytes)]);
    assert_eq!(known(Ok(gltf.buffer.clone())).unwrap().drawables().len(), 1, "a backslash of Windows");
    let gone = known(Err(IoError::NotFound { uri: "/set/sub/a.bin".into() }));
    assert!(matches!(gone.unwrap_err(), IoError::NotFound { .. }));
}

#[test]
fn text_in_another_encoding_and_null_among_numbers_are_read() {
    let mut gltf = triangle(|_, primitive| primitive["material"] = 0.into());
    let factors = json!({ "diffuseFactor": [1, 1, 1, 1], "specularFactor": [0, null, null] });
    let extensions = json!({ "KHR_materials_pbrSpecularGlossiness": factors });
    gltf.push("materials", json!({ "name": "Z?rich", "extensions": extensions }));
    gltf.json["extensionsUsed"] = json!(["KHR_materials_pbrSpecularGlossiness"]);
    assert_eq!(gltf.read().drawables().len(), 1);
    let mut text = gltf.text();
    let at = text.iter().position(|byte| *byte == b'?').unwrap();
    text[at] = 0xfc;
    let read = read(text, Vec::new()).unwrap();
    assert_eq!((read.drawables().len(), kinds(&read).len()), (1, 1), "{:?}", kinds(&read));
}

#[test]
fn colours_of_integers_are_normalized_whatever_they_say() {
    for (component, bytes) in
        [(UNSIGNED_BYTE, [255, 51, 0].repeat(3)), (UNSIGNED_SHORT, shorts(&[65535, 13107, 0].repeat(3)))]
    {
        for normalized in [true, false] {
            let gltf = triangle(|gltf, primitive| {
                let colors = gltf.accessor(component, "VEC3", 3, &bytes);
                gltf.json["accessors"][colors]["normalized"] = normalized.into();
                primitive["attributes"]["COLOR_0"] = colors.into();
            });
            let read = gltf.read();
            assert_eq!(read.mesh().0.vertices[2].color, [255, 51, 0, 255]);
            assert_eq!(kinds(&read).len(), usize::from(!normalized));
        }
    }
}
