//! Geometry of glTF 2.0: primitive modes, accessors of every kind, scenes, external files, morph targets and skins.

use serde_json::{Value, json};
use terrane::fetch::{IoError, Limits, RootScope};
use terrane::formats::{Fetched, ReadOptions, dependencies};
use terrane::scene::Topology;

use crate::gltf_builder::*;

#[test]
fn every_primitive_mode_is_drawn() {
    for (mode, topology, indices) in [
        (0, Topology::Points, 5),
        (1, Topology::Lines, 4),
        (2, Topology::Lines, 10),
        (3, Topology::Lines, 8),
        (4, Topology::Triangles, 3),
        (5, Topology::Triangles, 9),
        (6, Topology::Triangles, 9),
    ] {
        for has_indices in [false, true] {
            let mut gltf = GltfBuilder::new();
            let positions =
                gltf.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 2.0, 1.0, 0.0]);
            let mut primitive = json!({ "attributes": { "POSITION": positions }, "mode": mode });
            if has_indices {
                primitive["indices"] = gltf.accessor(UNSIGNED_BYTE, "SCALAR", 5, &[0, 1, 2, 3, 4]).into();
            }
            gltf.draw(primitive);
            let (mesh, drawable) = gltf.read().mesh();
            // glTF numbers loops 2 and strips 3.
            assert_eq!((mesh.topology, mesh.indices.len(), mesh.vertices.len()), (topology, indices, 5), "mode {mode}");
            assert_eq!(drawable.material.unlit, topology != Topology::Triangles, "without normals");
        }
    }
}

#[test]
fn all_component_types_and_strides_are_read() {
    // Positions 0, 1 and 2 along x, in each type that KHR_mesh_quantization allows.
    for (component, normalized, one) in [
        (BYTE, false, vec![1]),
        (BYTE, true, vec![127]),
        (UNSIGNED_BYTE, false, vec![1]),
        (UNSIGNED_BYTE, true, vec![255]),
        (SHORT, false, vec![1, 0]),
        (SHORT, true, vec![255, 127]),
        (UNSIGNED_SHORT, false, vec![1, 0]),
        (UNSIGNED_SHORT, true, vec![255, 255]),
        (FLOAT, false, floats(&[1.0])),
    ] {
        for stride in [None, Some(16), Some(20)] {
            let zero = vec![0u8; one.len()];
            let corners = [[&zero; 3], [&one, &zero, &zero], [&zero, &one, &zero]];
            let mut bytes = Vec::new();
            for corner in corners {
                let begin = bytes.len();
                corner.iter().for_each(|part| bytes.extend(part.iter()));
                if let Some(stride) = stride {
                    bytes.resize(begin + stride, 0xee);
                }
            }
            let mut gltf = GltfBuilder::new();
            let view = gltf.view(&bytes, stride);
            let positions = gltf.push(
                "accessors",
                json!({ "bufferView": view, "componentType": component, "normalized": normalized, "count": 3, "type": "VEC3" }),
            );
            gltf.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
            gltf.json["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
            gltf.draw(json!({ "attributes": { "POSITION": positions } }));
            let read = gltf.read();
            let expected = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
            assert_eq!(read.positions(), expected, "type {component}, normalized {normalized}, stride {stride:?}");
            assert!(read.ignored.is_empty());
        }
    }
}

#[test]
fn sparse_accessors_replace_elements() {
    for has_base in [true, false] {
        let mut gltf = GltfBuilder::new();
        let base = gltf.view(&floats(&[9.0; 9]), None);
        let indices = gltf.view(&shorts(&[0, 2]), None);
        let values = gltf.view(&floats(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), None);
        let mut accessor = json!({ "componentType": FLOAT, "count": 3, "type": "VEC3", "sparse": {
            "count": 2,
            "indices": { "bufferView": indices, "componentType": UNSIGNED_SHORT },
            "values": { "bufferView": values },
        } });
        if has_base {
            accessor["bufferView"] = base.into();
        }
        let positions = gltf.push("accessors", accessor);
        gltf.draw(json!({ "attributes": { "POSITION": positions } }));
        let middle = if has_base { [9.0; 3] } else { [0.0; 3] };
        assert_eq!(gltf.read().positions(), [[1.0, 2.0, 3.0], middle, [4.0, 5.0, 6.0]]);
        // An index out of range, more values than elements, and values that are not there.
        let mut broken = GltfBuilder { json: gltf.json.clone(), buffer: gltf.buffer.clone() };
        let at = broken.json["bufferViews"][indices]["byteOffset"].as_u64().unwrap() as usize;
        broken.buffer[at + 2] = 3;
        assert!(broken.error().contains("sparse index 3 of 3"));
        gltf.json["accessors"][positions]["sparse"]["count"] = 4.into();
        assert!(gltf.error().contains("replaces more elements"));
        gltf.json["accessors"][positions]["sparse"]["count"] = 3.into();
        assert!(gltf.error().contains("beyond"));
    }
}

/// Regression for memory: a few bytes asked for gigabytes of zeros.
#[test]
fn accessors_without_bytes_are_bounded() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.push("accessors", json!({ "componentType": FLOAT, "count": 3, "type": "VEC3" }));
    gltf.draw(json!({ "attributes": { "POSITION": positions } }));
    assert_eq!(gltf.read().positions(), [[0.0; 3]; 3]);
    for count in [20_000_000u64, u64::from(u32::MAX), u64::MAX / 2] {
        gltf.json["accessors"][positions]["count"] = count.into();
        assert!(gltf.error().contains("vertices"), "{count}");
    }
}

#[test]
fn the_default_scene_is_drawn() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    gltf.draw(json!({ "attributes": { "POSITION": positions } }));
    let moved = gltf.push("nodes", json!({ "mesh": 0, "translation": [10, 0, 0] }));
    gltf.json["scenes"] = json!([{ "nodes": [0] }, { "nodes": [moved] }]);
    gltf.json["scene"] = 1.into();
    let read = gltf.read();
    assert_eq!(read.positions()[0], [10.0, 0.0, 0.0]);
    assert_eq!(read.ignored.count("glTF: scenes besides the default one"), 1);
    // Without a default the first one; without scenes all meshes.
    gltf.json.as_object_mut().unwrap().remove("scene");
    assert_eq!(gltf.read().positions()[0], [0.0; 3]);
    gltf.json.as_object_mut().unwrap().remove("scenes");
    assert_eq!(gltf.read().drawables().len(), 1);
}

/// The crate that parses glTF requires the nodes of a scene, and an index that exists.
#[test]
fn scenes_without_nodes_and_null_members_are_read() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    gltf.draw(json!({ "attributes": { "POSITION": positions }, "indices": null, "targets": null }));
    gltf.json["nodes"][0]["children"] = Value::Null;
    gltf.json["nodes"][0]["matrix"] = Value::Null;
    assert_eq!(gltf.read().positions()[1], [1.0, 0.0, 0.0]);
    gltf.json["scenes"] = json!([{ "name": "empty" }]);
    assert_eq!(gltf.read().drawables().len(), 0);
    gltf.json["scenes"] = json!([{ "nodes": [0] }]);
    gltf.json["scene"] = 1.into();
    let read = gltf.read();
    assert_eq!((read.drawables().len(), read.ignored.count("glTF: default scene that does not exist")), (1, 1));
}

#[test]
fn invalid_primitives_are_left_out() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let infinite = gltf.floats("VEC3", &[0.0, 0.0, 0.0, f32::INFINITY, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let beyond = gltf.accessor(UNSIGNED_BYTE, "SCALAR", 3, &[0, 1, 3]);
    let bad_index = json!({ "attributes": { "POSITION": positions }, "indices": beyond });
    let bad_position = json!({ "attributes": { "POSITION": infinite } });
    gltf.draw(bad_index);
    assert!(gltf.error().contains("index 3 of 3 vertices"), "nothing is left to draw");
    gltf.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(bad_position);
    assert!(gltf.error().contains("index 3 of 3 vertices"), "the first error is reported");
    let good = json!({ "attributes": { "POSITION": positions } });
    gltf.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(good);
    let read = gltf.read();
    assert_eq!(read.positions()[1], [1.0, 0.0, 0.0]);
    assert_eq!(read.ignored.count("glTF: invalid primitive that is not drawn"), 2);
}

#[test]
fn nodes_that_draw_the_same_mesh_share_it() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    gltf.draw(json!({ "attributes": { "POSITION": positions } }));
    let second = gltf.push("nodes", json!({ "mesh": 0, "translation": [1, 2, 3] }));
    gltf.json["scenes"] = json!([{ "nodes": [0, second] }]);
    let drawables = gltf.read().drawables();
    assert!(std::sync::Arc::ptr_eq(&mesh_of(&drawables[0].1), &mesh_of(&drawables[1].1)));
}

/// Returns a textured triangle whose buffer and image are files.
fn with_files() -> (GltfBuilder, Vec<u8>, Vec<u8>) {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let uvs = gltf.floats("VEC2", &[0.0; 6]);
    gltf.push("images", json!({ "uri": "img/a%20b.png" }));
    gltf.push("textures", json!({ "source": 0 }));
    gltf.push(
        "materials",
        json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0 } }),
    );
    gltf.json["buffers"] = json!([{ "byteLength": gltf.buffer.len(), "uri": "a.bin" }]);
    gltf.draw(json!({ "attributes": { "POSITION": positions, "TEXCOORD_0": uvs }, "material": 0 }));
    let buffer = gltf.buffer.clone();
    (gltf, buffer, png(4, [200, 30, 10]))
}

#[test]
fn external_buffers_and_images_are_fetched() {
    let (gltf, buffer, image) = with_files();
    let options = ReadOptions::for_root("/set/tileset.json", Limits::default());
    let wanted = dependencies(URI, &gltf.text(), None, &[], &options);
    assert_eq!(wanted, ["/set/a.bin".into(), "/set/img/a b.png".into()]);
    let fetched: Vec<Fetched> = vec![(wanted[0].clone(), Ok(buffer)), (wanted[1].clone(), Ok(image))];
    assert!(dependencies(URI, &gltf.text(), None, &fetched, &options).is_empty());
    let read = read(gltf.text(), fetched).unwrap();
    let (mesh, drawable) = read.mesh();
    assert_eq!((mesh.vertices.len(), drawable.material.texture.unwrap().mips[0][..3].to_vec()), (3, vec![200, 30, 10]));
    assert!(read.ignored.is_empty(), "{:?}", read.ignored);
    // References that leave the folder are not fetched.
    let text = String::from_utf8(gltf.text()).unwrap();
    for foreign in ["../../etc/passwd", "/etc/passwd", "http://other/a.bin"] {
        let wanted = dependencies(URI, text.replace("a.bin", foreign).as_bytes(), None, &[], &options);
        assert_eq!(wanted, ["/set/img/a b.png".into()]);
    }
    let on_server = ReadOptions { root: RootScope::of("http://h/"), ..options };
    let wanted = dependencies("http://h/s/t.gltf?k=1", text.as_bytes(), None, &[], &on_server);
    assert_eq!(wanted[0], "http://h/s/a.bin?k=1".into());
}

#[test]
fn missing_files_leave_the_rest_visible() {
    let (gltf, buffer, image) = with_files();
    let gone = |uri: &str| Err(IoError::NotFound { uri: uri.to_owned() });
    let files =
        |buffer, image| -> Vec<Fetched> { vec![("/set/a.bin".into(), buffer), ("/set/img/a b.png".into(), image)] };
    let without_image = read(gltf.text(), files(Ok(buffer.clone()), gone("i"))).unwrap();
    assert!(without_image.mesh().1.material.texture.is_none());
    assert_eq!(without_image.ignored.count("glTF: external image that is missing"), 1);
    // Another mesh has its vertices in the text.
    let mut gltf = gltf;
    let own = data_uri(&floats(&TRIANGLE));
    gltf.json["buffers"].as_array_mut().unwrap().push(json!({ "byteLength": 36, "uri": own }));
    let view = gltf.push("bufferViews", json!({ "buffer": 1, "byteLength": 36 }));
    let positions =
        gltf.push("accessors", json!({ "bufferView": view, "componentType": FLOAT, "count": 3, "type": "VEC3" }));
    gltf.json["meshes"][0]["primitives"]
        .as_array_mut()
        .unwrap()
        .push(json!({ "attributes": { "POSITION": positions } }));
    for companions in [files(gone("b"), Ok(image.clone())), Vec::new()] {
        let without_buffer = read(gltf.text(), companions).unwrap();
        assert_eq!(without_buffer.drawables().len(), 1);
        assert_eq!(without_buffer.ignored.count("glTF: external buffer that is missing"), 1);
    }
    // A retry may bring it.
    let late = || Err(IoError::Status { uri: "b".into(), status: 503, retry_after: None });
    assert!(read(gltf.text(), files(late(), Ok(image))).unwrap_err().is_transient());
    assert!(read(gltf.text(), files(Ok(buffer[..20].to_vec()), gone("i"))).is_err(), "a truncated buffer");
}

#[test]
fn morph_targets_apply_their_default_weights() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let normals = gltf.floats("VEC3", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let up = gltf.floats("VEC3", &[0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let tilt = gltf.floats("VEC3", &[2.0, 0.0, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let node = gltf.draw(json!({
        "attributes": { "POSITION": positions, "NORMAL": normals },
        "targets": [{ "POSITION": up, "NORMAL": tilt }, { "POSITION": up }],
    }));
    assert_eq!(gltf.read().positions()[0], [0.0; 3], "without weights");
    gltf.json["meshes"][0]["weights"] = json!([0.5, 0.25]);
    let read = gltf.read();
    let (mesh, _) = read.mesh();
    assert_eq!(read.positions()[..2], [[0.0, 0.0, 1.5], [1.0, 0.0, 0.0]]);
    assert_eq!((mesh.vertices[0].normal, mesh.vertices[1].normal), ([127, 0, 0, 0], [0, 0, 127, 0]));
    assert_eq!(mesh.bounds.max.z, 1.5);
    // Weights of a node replace those of the mesh.
    gltf.json["nodes"][node]["weights"] = json!([0.0, 1.0]);
    assert_eq!(gltf.read().positions()[0], [0.0, 0.0, 2.0]);
    gltf.json["accessors"][up]["count"] = 2.into();
    assert!(gltf.error().contains("morph target"));
}

#[test]
fn skins_are_drawn_at_rest() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let joints = gltf.accessor(UNSIGNED_BYTE, "VEC4", 3, &[0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0]);
    let weights = gltf.floats("VEC4", &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.0, 0.0]);
    let node = gltf.draw(json!({ "attributes": { "POSITION": positions, "JOINTS_0": joints, "WEIGHTS_0": weights } }));
    // The second joint is below the first; both are far away, and the transform of the mesh's node does not count.
    let second = gltf.push("nodes", json!({ "translation": [0, 0, 5] }));
    let first = gltf.push("nodes", json!({ "translation": [4000000, 0, 0], "children": [second] }));
    gltf.push("skins", json!({ "joints": [first, second] }));
    gltf.json["nodes"][node]["skin"] = 0.into();
    gltf.json["nodes"][node]["translation"] = json!([0, 77, 0]);
    gltf.json["scenes"] = json!([{ "nodes": [node, first] }]);
    let far = 4_000_000.0;
    assert_eq!(gltf.read().positions(), [[far, 0.0, 0.0], [far + 1.0, 0.0, 5.0], [far, 1.0, 2.5]]);
    // Inverse bind matrices: the joints were at z = 1 when the mesh was bound.
    let mut binds = [0.0f32; 32];
    for joint in [0, 16] {
        (0..4).for_each(|i| binds[joint + 5 * i] = 1.0);
        binds[joint + 14] = -1.0;
    }
    let inverse = gltf.floats("MAT4", &binds);
    gltf.json["skins"][0]["inverseBindMatrices"] = inverse.into();
    assert_eq!(gltf.read().positions(), [[far, 0.0, -1.0], [far + 1.0, 0.0, 4.0], [far, 1.0, 1.5]]);
    gltf.json["accessors"][inverse]["count"] = 1.into();
    assert!(gltf.error().contains("fewer inverseBindMatrices"));
}

#[test]
fn texture_coordinates_follow_the_texture() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let first = gltf.floats("VEC2", &[0.5; 6]);
    let second = gltf.accessor(UNSIGNED_SHORT, "VEC2", 3, &shorts(&[0, 0, 65535, 0, 0, 65535]));
    gltf.json["accessors"][second]["normalized"] = true.into();
    gltf.push("images", json!({ "uri": data_uri(&png(2, [1, 2, 3])) }));
    gltf.push("textures", json!({ "source": 0 }));
    let texture = json!({ "index": 0, "texCoord": 1 });
    gltf.push("materials", json!({ "pbrMetallicRoughness": { "baseColorTexture": texture, "metallicFactor": 0 } }));
    gltf.draw(json!({
        "attributes": { "POSITION": positions, "TEXCOORD_0": first, "TEXCOORD_1": second }, "material": 0,
    }));
    let uvs = |gltf: &GltfBuilder| -> Vec<[f32; 2]> {
        gltf.read().mesh().0.vertices.iter().map(|v| v.uv.map(|x| (x * 1e4).round() / 1e4)).collect()
    };
    assert_eq!(uvs(&gltf), [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]);
    // A quarter turn after doubling u, then a shift: as the sample viewer and three.js draw it.
    let transform = json!({ "offset": [0.25, 0.5], "rotation": std::f64::consts::FRAC_PI_2, "scale": [2, 1] });
    let material = "/materials/0/pbrMetallicRoughness/baseColorTexture/extensions";
    let texture = "/materials/0/pbrMetallicRoughness/baseColorTexture";
    gltf.json.pointer_mut(texture).unwrap()["extensions"] = json!({ "KHR_texture_transform": transform });
    assert_eq!(uvs(&gltf), [[0.25, 0.5], [0.25, -1.5], [1.25, 0.5]]);
    gltf.json.pointer_mut(material).unwrap()["KHR_texture_transform"]["texCoord"] = 0.into();
    assert_eq!(uvs(&gltf)[0], [0.75, -0.5]);
}

#[test]
fn harmless_violations_are_accepted() {
    let mut gltf = GltfBuilder::new();
    // Bounds are missing or odd; a primitive has no positions; names of attributes are unknown.
    let positions = gltf.floats("VEC3", &TRIANGLE);
    gltf.json["accessors"][positions]["min"] = json!(["x"]);
    let other = gltf.floats("SCALAR", &[1.0; 3]);
    gltf.draw(json!({ "attributes": { "POSITION": positions, "ODD": other } }));
    gltf.json["meshes"][0]["primitives"].as_array_mut().unwrap().push(json!({ "attributes": { "NORMAL": positions } }));
    let read = gltf.read();
    assert_eq!(read.drawables().len(), 1);
    assert_eq!(read.ignored.count("glTF: primitive without positions"), 1);
}

/// Culls leave out meshes of which they would see only the backs.
#[test]
fn single_sided_meshes_get_the_cone_of_their_normals() {
    let cluster = |double_sided: bool, cluster_culling: bool| {
        let mut gltf = GltfBuilder::new();
        let positions = gltf.floats("VEC3", &TRIANGLE);
        gltf.push("materials", json!({ "doubleSided": double_sided }));
        gltf.draw(json!({ "attributes": { "POSITION": positions }, "material": 0 }));
        let options = ReadOptions { cluster_culling, ..ReadOptions::for_root("/set/tileset.json", Limits::default()) };
        read_with(gltf.text(), Vec::new(), &options).unwrap().mesh().1.cluster
    };
    let cone = cluster(false, true).expect("one triangle has one direction");
    // The triangle lies in the plane of x and y.
    assert!(cone.normal.z.abs() > 0.99, "{cone:?}");
    assert!(cluster(true, true).is_none(), "both sides are seen");
    assert!(cluster(false, false).is_none(), "on request");
}
