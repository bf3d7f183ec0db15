//! Contents whose buffers and images are files, read as a whole set. Unusual contents, and ones with invalid parts: those
//! are left out or get their default, and are listed; the rest is drawn.

use serde_json::{Value, json};
use terrane::fetch::{IoError, Limits};
use terrane::formats::verify;
use terrane::scene::AlphaMode;

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

/// Two textured triangles with their own meshes, nodes 0 and 1, and materials.
fn pair() -> GltfBuilder {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let uvs = gltf.floats("VEC2", &[0.0; 6]);
    let indices = gltf.accessor(UNSIGNED_SHORT, "SCALAR", 3, &shorts(&[0, 1, 2]));
    gltf.push("images", json!({ "uri": data_uri(&png(1, [0, 0, 255])) }));
    gltf.push("samplers", json!({ "magFilter": 9728 }));
    gltf.push("textures", json!({ "source": 0, "sampler": 0 }));
    for material in 0..2 {
        let color = json!({ "baseColorTexture": { "index": 0 }, "baseColorFactor": [1, 0, 0, 1] });
        gltf.push("materials", json!({ "pbrMetallicRoughness": color, "alphaMode": "MASK" }));
        let attributes = json!({ "POSITION": positions, "TEXCOORD_0": uvs });
        gltf.draw(json!({ "attributes": attributes, "indices": indices, "material": material }));
    }
    gltf.json["scenes"] = json!([{ "nodes": [0, 1] }]);
    gltf
}

/// Reads the pair after a change. Returns the number of drawables, and the notes with their counts.
fn changed(pointer: &str, value: Value) -> (Read, Vec<(String, u64)>) {
    let mut gltf = pair();
    let (owner, member) = pointer.rsplit_once('/').unwrap();
    match gltf.json.pointer_mut(owner).unwrap() {
        Value::Array(list) => list[member.parse::<usize>().unwrap()] = value,
        owner => owner[member] = value,
    }
    let read = gltf.read();
    let kinds = read.ignored.iter().map(|(kind, count)| (kind.to_owned(), count)).collect();
    (read, kinds)
}

#[test]
fn whole_files_need_no_repair() {
    let read = pair().read();
    assert!(read.drawables().len() == 2 && read.ignored.is_empty(), "{:?}", read.ignored);
}

/// Regression: each of these refused the whole file.
#[test]
fn parts_that_cannot_be_drawn_are_left_out_alone() {
    for (pointer, value, kind) in [
        ("/meshes/0/primitives/0/indices", json!(9), "its indices do not exist"),
        ("/meshes/0/primitives/0/indices", json!("a"), "its indices do not exist"),
        ("/meshes/0/primitives/0/mode", json!(7), "primitive of an unknown mode"),
        ("/meshes/0/primitives/0", json!(7), "invalid primitive"),
        ("/meshes/0/primitives/0", json!({}), "invalid primitive"),
        ("/meshes/0/primitives", json!(7), "mesh that is invalid"),
        ("/meshes/0", json!("a"), "mesh that is invalid"),
        ("/nodes/0/mesh", json!(2), "mesh that does not exist"),
        ("/nodes/0/mesh", json!(-1), "mesh that does not exist"),
        ("/nodes/0/matrix", json!([1, 2, 3]), "node that is invalid"),
        ("/scenes/0/nodes", json!([1, 7]), "node that does not exist"),
        ("/scenes/0/nodes", json!(["a", 1]), "node that does not exist"),
    ] {
        let (read, kinds) = changed(pointer, value.clone());
        assert_eq!(read.drawables().len(), 1, "{pointer} {value}");
        assert!(kinds.len() == 1 && kinds[0].0.contains(kind) && kinds[0].1 == 1, "{pointer} {value}: {kinds:?}");
    }
    let (read, kinds) = changed("/meshes/0/primitives/0/attributes/POSITION", json!(9));
    let kinds: Vec<&str> = kinds.iter().map(|(kind, _)| &**kind).collect();
    let expected = ["glTF: attribute whose accessor does not exist or is invalid", "glTF: primitive without positions"];
    assert_eq!((read.drawables().len(), &kinds[..]), (1, &expected[..]));
}

#[test]
fn parts_that_are_invalid_get_their_default() {
    for (pointer, value, kind) in [
        ("/materials/0/alphaMode", json!("GLASS"), "unknown alphaMode"),
        ("/materials/0/alphaMode", json!(7), "unknown alphaMode"),
        ("/materials/0/normalTexture", json!({ "index": 3 }), "texture that does not exist"),
        ("/materials/0/pbrMetallicRoughness/baseColorTexture", json!({ "index": 3 }), "texture that does not exist"),
        ("/materials/0/pbrMetallicRoughness/baseColorFactor", json!([1, 1]), "property that is invalid"),
        ("/materials/0/doubleSided", json!("yes"), "property that is invalid"),
        ("/materials/0", json!(7), "material that is invalid"),
        ("/meshes/0/primitives/0/material", json!(2), "material that does not exist"),
        ("/meshes/0/primitives/0/attributes/TEXCOORD_0", json!(9), "attribute whose accessor"),
        ("/meshes/0/primitives/0/targets", json!([{ "POSITION": 9 }]), "attribute whose accessor"),
        ("/meshes/0/weights", json!("a"), "weights of morph targets"),
        ("/nodes/0/skin", json!(0), "skin that does not exist"),
        ("/nodes/0/children", json!([7]), "node that does not exist"),
        ("/nodes/0/children", json!(7), "list of nodes"),
        ("/nodes/0/weights", json!("a"), "property of a node"),
        ("/textures/0/source", json!(4), "image that does not exist"),
        ("/textures/0/sampler", json!(4), "sampler that does not exist"),
        ("/samplers/0/magFilter", json!(1), "unknown filter or wrap mode"),
        ("/samplers/0/wrapS", json!(1), "unknown filter or wrap mode"),
        ("/images/0/bufferView", json!(99), "image whose bufferView"),
        ("/skins", json!([{}]), "skin that is invalid"),
        ("/scene", json!(4), "default scene that does not exist"),
        ("/asset", json!(4), "asset without a valid version"),
        ("/extensionsUsed", json!(4), "member of the document that is invalid"),
    ] {
        let (read, kinds) = changed(pointer, value.clone());
        assert_eq!(read.drawables().len(), 2, "{pointer} {value}");
        assert!(
            kinds[0].0.contains(kind) || kinds.iter().any(|(of, _)| of.contains(kind)),
            "{pointer} {value}: {kinds:?}"
        );
    }
    let (read, _) = changed("/materials/0/alphaMode", json!("GLASS"));
    let materials: Vec<_> = read.drawables().into_iter().map(|(_, drawable)| drawable.material).collect();
    assert_eq!((materials[0].alpha, materials[1].alpha), (AlphaMode::Opaque, AlphaMode::Mask(0.5)));
    assert!(materials.iter().all(|material| material.texture.is_some() && material.base_color == [1.0, 0.0, 0.0, 1.0]));
    let (read, _) = changed("/materials/0/pbrMetallicRoughness/baseColorTexture", json!({ "index": 3 }));
    assert!(read.drawables()[0].1.material.texture.is_none() && read.drawables()[1].1.material.texture.is_some());
}

/// All drawables need the accessor.
#[test]
fn file_of_which_nothing_is_left_says_why() {
    for (pointer, value, why) in [
        ("/accessors/0/componentType", json!(5124), "accessors[0] is invalid"),
        ("/accessors/0/type", json!("VEC9"), "accessors[0] is invalid"),
        ("/accessors/0/count", json!(-3), "accessors[0] is invalid: invalid value"),
        ("/accessors/0/bufferView", json!(44), "accessors[0] is invalid"),
        ("/accessors/0/sparse", json!({ "count": 1 }), "accessors[0] is invalid"),
        ("/bufferViews/0/buffer", json!(3), "bufferViews[0] is invalid"),
        ("/accessors", json!([]), "accessor"),
        ("/accessors", json!(7), "accessor"),
    ] {
        let mut gltf = pair();
        let (owner, member) = pointer.rsplit_once('/').unwrap();
        gltf.json.pointer_mut(owner).unwrap()[member] = value.clone();
        let error = gltf.error();
        assert!(error.contains(why), "{pointer} {value}: {error}");
    }
}

/// Regression: such trees were refused.
#[test]
fn nodes_with_several_parents_are_drawn_once() {
    const KIND: &str = "glTF: node with several parents (drawn below one of them)";
    let moved = |children: Value| json!({ "translation": [5, 0, 0], "children": children });
    for (nodes, roots, removed, expected) in [
        (vec![moved(json!([0])), json!({ "children": [0, 1] })], json!([2, 3]), 1, [[5.0, 0.0, 0.0], [0.0; 3]]),
        (vec![moved(json!([0, 0, 1]))], json!([2]), 1, [[5.0, 0.0, 0.0]; 2]),
        // A scene that lists all nodes, a child before its parent.
        (vec![moved(json!([0, 1]))], json!([0, 1, 2]), 2, [[5.0, 0.0, 0.0]; 2]),
        (vec![moved(json!([0, 1]))], json!([2, 2]), 1, [[5.0, 0.0, 0.0]; 2]),
        // The parent is in no scene.
        (vec![moved(json!([0]))], json!([0, 1]), 0, [[0.0; 3]; 2]),
    ] {
        let mut gltf = pair();
        nodes.into_iter().for_each(|node| _ = gltf.push("nodes", node));
        gltf.json["scenes"] = json!([{ "nodes": roots }]);
        let read = gltf.read();
        let places: Vec<_> = read.drawables().iter().map(|(map, _)| map.translation.to_array()).collect();
        assert_eq!((&places[..], read.ignored.count(KIND)), (&expected[..], removed), "{roots}");
    }
    // A circle is cut.
    let mut gltf = pair();
    gltf.push("nodes", json!({ "children": [0, 1, 3] }));
    gltf.push("nodes", json!({ "children": [2] }));
    for roots in [json!([2]), json!([3]), json!([2, 3])] {
        gltf.json["scenes"] = json!([{ "nodes": roots }]);
        let read = gltf.read();
        assert_eq!(read.drawables().len(), 2, "{roots}");
        assert_eq!(read.ignored.count("glTF: node that is its own ancestor"), 1, "{roots}");
    }
}

/// Regression: one node whose instances or skin are invalid refused the whole file.
#[test]
fn invalid_instances_and_skins_take_their_mesh_alone() {
    let (read, kinds) = changed("/nodes/0/extensions", json!({ "EXT_mesh_gpu_instancing": { "attributes": {} } }));
    assert_eq!(read.drawables().len(), 1);
    assert_eq!(kinds, [("glTF: instances that are not drawn because they are invalid".to_owned(), 1)]);
    let mut gltf = pair();
    gltf.push("skins", json!({ "joints": [1], "inverseBindMatrices": 0 }));
    gltf.json["nodes"][0]["skin"] = 0.into();
    let read = gltf.read();
    assert_eq!(read.drawables().len(), 1);
    assert_eq!(read.ignored.count("glTF: mesh that is not drawn because its skin is invalid"), 1);
}

/// An invalid attribute leaves the others.
#[test]
fn attributes_of_the_wrong_length_are_left_out() {
    let mut gltf = pair();
    let short = gltf.floats("VEC3", &[0.0; 6]);
    for name in ["NORMAL", "COLOR_0"] {
        gltf.json["meshes"][0]["primitives"][0]["attributes"][name] = short.into();
    }
    let read = gltf.read();
    assert_eq!(read.drawables().len(), 2);
    assert_eq!(mesh_of(&read.drawables()[0].1).vertices[0].color, [255; 4]);
    let kinds: Vec<_> = read.ignored.iter().collect();
    let note = |name: &str| format!("glTF: {name} of the wrong type or length (drawn without it)");
    assert_eq!(kinds, [(&*note("COLOR_0"), 1), (&*note("NORMAL"), 1)]);
}
