//! Meshes at many positions: EXT_mesh_gpu_instancing and i3dm.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use kit::contents::cmpt_bytes;
use serde_json::json;
use terrane::fetch::{IoError, Limits};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::formats::{Content, Fetched, ReadOptions, decode, decode_noting, dependencies};
use terrane::scene::{Drawable, Node, NodeKind, Page};

use crate::gltf_builder::*;

/// Returns a glTF whose only node draws a triangle at several positions.
fn instanced(component: u32, normalized: bool, rotations: &[u8]) -> GltfBuilder {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let node = gltf.draw(json!({ "attributes": { "POSITION": positions } }));
    let translations = gltf.floats("VEC3", &[10.0, 0.0, 0.0, 0.0, 20.0, 0.0]);
    let scales = gltf.floats("VEC3", &[1.0, 1.0, 1.0, 2.0, 3.0, 4.0]);
    let rotations = gltf.accessor(component, "VEC4", 2, rotations);
    gltf.json["accessors"][rotations]["normalized"] = normalized.into();
    let ids = gltf.accessor(UNSIGNED_SHORT, "SCALAR", 2, &shorts(&[7, 8]));
    gltf.json["nodes"][node]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": {
        "TRANSLATION": translations, "ROTATION": rotations, "SCALE": scales, "_FEATURE_ID_0": ids,
    } } });
    gltf.json["nodes"][node]["translation"] = json!([100, 0, 0]);
    gltf.json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
    gltf.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    gltf
}

/// Rounds coordinates, so that -0 and quantized rotations compare equal.
fn rounded(p: DVec3) -> [f64; 3] {
    p.to_array().map(|x| (x * 100.0).round() / 100.0 + 0.0)
}

#[test]
fn gltf_instances_share_one_mesh() {
    // The second instance is turned by a quarter around z.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    for (component, normalized, rotations) in [
        (FLOAT, false, floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, half, half])),
        (BYTE, true, vec![0, 0, 0, 127, 0, 0, 90, 90]),
        (SHORT, true, shorts(&[0, 0, 0, 32767, 0, 0, 23170, 23170])),
    ] {
        let read = instanced(component, normalized, &rotations).read();
        let drawables = read.drawables();
        assert_eq!(drawables.len(), 2);
        assert!(Arc::ptr_eq(&mesh_of(&drawables[0].1), &mesh_of(&drawables[1].1)));
        let corner = |i: usize| rounded(drawables[i].0.transform_point3(DVec3::X));
        assert_eq!([corner(0), corner(1)], [[111.0, 0.0, 0.0], [100.0, 22.0, 0.0]]);
        assert!(read.ignored.is_empty(), "{:?}", read.ignored);
    }
}

#[test]
fn faulty_instances_are_refused() {
    let good = instanced(FLOAT, false, &floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]));
    assert_eq!(good.read().drawables().len(), 2, "a rotation of zeros counts as none");
    let path = "/nodes/0/extensions/EXT_mesh_gpu_instancing";
    for (attributes, why) in [
        (json!({}), "no attributes"),
        (json!({ "TRANSLATION": 99 }), "does not exist"),
        (json!({ "TRANSLATION": -1 }), "does not exist"),
        (json!({ "TRANSLATION": 0, "SCALE": 2 }), "different lengths"),
        (json!({ "TRANSLATION": 3 }), "wrong type"),
    ] {
        let mut gltf = GltfBuilder { json: good.json.clone(), buffer: good.buffer.clone() };
        gltf.json.pointer_mut(path).unwrap()["attributes"] = attributes;
        assert!(gltf.error().contains(why), "{why}: {}", gltf.error());
    }
    // An accessor without bytes may have any count.
    let mut gltf = GltfBuilder { json: good.json.clone(), buffer: good.buffer };
    let many = gltf.push("accessors", json!({ "componentType": FLOAT, "type": "VEC3", "count": 4_000_000_000u64 }));
    gltf.json.pointer_mut(path).unwrap()["attributes"] = json!({ "TRANSLATION": many });
    assert!(gltf.error().contains("primitives"));
}

/// Returns a glb with a triangle and no textures.
fn model() -> Vec<u8> {
    write_glb(&GlbMesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    })
}

pub fn i3dm(table: &str, binary: &[u8], format: u32, body: &[u8]) -> Vec<u8> {
    let mut table = table.as_bytes().to_vec();
    table.resize(table.len().next_multiple_of(8), b' ');
    let mut out = b"i3dm".to_vec();
    let length = 32 + table.len() + binary.len() + body.len();
    for word in [1, length as u32, table.len() as u32, binary.len() as u32, 0, 0, format] {
        out.extend(word.to_le_bytes());
    }
    [out, table, binary.to_vec(), body.to_vec()].concat()
}

fn options() -> ReadOptions {
    ReadOptions::for_root("/set/tileset.json", Limits::default())
}

fn content(bytes: Vec<u8>, companions: Vec<Fetched>) -> Content {
    Content { uri: "/set/a/trees.i3dm".into(), bytes, reader_data: None, companions }
}

/// Returns the drawables with their transforms to the tile's frame.
fn instances(bytes: Vec<u8>, companions: Vec<Fetched>) -> Result<Vec<(DAffine3, Drawable)>, IoError> {
    fn collect(node: &Node, above: DAffine3, found: &mut Vec<(DAffine3, Drawable)>) {
        let map = match &node.kind {
            NodeKind::Transform(map) => above * *map,
            _ => above,
        };
        if let NodeKind::Geode(drawables) = &node.kind {
            found.extend(drawables.iter().map(|drawable| (map, drawable.clone())));
        }
        node.children.iter().for_each(|child| collect(child, map, found));
    }
    let (node, _) = decode_noting(content(bytes, companions), &options())?;
    let mut found = Vec::new();
    collect(&node, DAffine3::IDENTITY, &mut found);
    Ok(found)
}

/// Returns where the model's origin, x axis and y axis (up) lie in the tile's frame.
fn frames(found: &[(DAffine3, Drawable)]) -> Vec<[[f64; 3]; 3]> {
    let frame = |(map, _): &(DAffine3, Drawable)| {
        [map.translation, map.transform_vector3(DVec3::X), map.transform_vector3(DVec3::Y)].map(rounded)
    };
    found.iter().map(frame).collect()
}

#[test]
fn i3dm_positions_scales_and_directions() {
    // Two positions, scales, scales by axis, ups and rights.
    let numbers = [
        1.0f32, 2.0, 3.0, 4.0, 5.0, 6.0, // 0: positions
        2.0, 3.0, // 24: scales
        1.0, 1.0, 1.0, 1.0, 10.0, 1.0, // 32: scales by axis
        0.0, 1.0, 0.0, 0.0, 0.0, 1.0, // 56: up
        1.0, 0.0, 0.0, 0.0, 1.0, 0.0, // 80: right
    ];
    let mut binary = floats(&numbers);
    // 104: up and right folded: y and x, then z and y.
    binary.extend(shorts(&[32768, 65535, 32768, 32768, 65535, 32768, 32768, 65535]));
    let read = |rest: &str| {
        let table = format!(r#"{{"INSTANCES_LENGTH":2,"POSITION":{{"byteOffset":0}}{rest}}}"#);
        frames(&instances(i3dm(&table, &binary, 1, &model()), Vec::new()).unwrap())
    };
    let [one, two] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
    let (x, z) = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    // The model is y-up, the tile z-up.
    assert_eq!(read(""), [[one, x, z], [two, x, z]]);
    assert_eq!(read(r#","SCALE":{"byteOffset":24}"#)[1], [two, [3.0, 0.0, 0.0], [0.0, 0.0, 3.0]]);
    // Scales by axis are of the instance's frame, in which the model's up is z.
    let by_axis = read(r#","SCALE":{"byteOffset":24},"SCALE_NON_UNIFORM":{"byteOffset":32}"#);
    assert_eq!(by_axis[1], [two, [3.0, 0.0, 0.0], [0.0, 0.0, 3.0]]);
    let plain = r#","NORMAL_UP":{"byteOffset":56},"NORMAL_RIGHT":{"byteOffset":80}"#;
    let folded = r#","NORMAL_UP_OCT32P":{"byteOffset":104},"NORMAL_RIGHT_OCT32P":{"byteOffset":112}"#;
    for directions in [plain, folded] {
        // Right is x and up is y of the instance's frame; the model's up is right x up.
        assert_eq!(read(directions), [[one, x, z], [two, [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]], "{directions}");
    }
    let moved = read(r#","RTC_CENTER":[1000000,0,0]"#);
    assert_eq!(moved[0], [[1_000_001.0, 2.0, 3.0], x, z]);
}

#[test]
fn i3dm_quantized_positions_and_east_north_up() {
    let mut binary = shorts(&[0, 65535, 0, 65535, 0, 65535, 0, 0]);
    binary.extend(shorts(&[3, 4]));
    let table = r#"{"INSTANCES_LENGTH":2,"POSITION_QUANTIZED":{"byteOffset":0},"QUANTIZED_VOLUME_OFFSET":[6378137,0,0],"QUANTIZED_VOLUME_SCALE":[10,20,30],"EAST_NORTH_UP":true,"BATCH_ID":{"byteOffset":16,"componentType":"UNSIGNED_SHORT"}}"#;
    let found = frames(&instances(i3dm(table, &binary, 1, &model()), Vec::new()).unwrap());
    // At longitude and latitude 0, east is y, north z and up x.
    assert_eq!(found[0][0], [6_378_137.0, 20.0, 0.0]);
    assert_eq!(found[1][0], [6_378_147.0, 0.0, 30.0]);
    assert_eq!(found[1][1..], [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
    // The centre of the earth has no directions.
    let table_of_center = r#"{"INSTANCES_LENGTH":1,"POSITION":{"byteOffset":0},"EAST_NORTH_UP":true}"#;
    let center = frames(&instances(i3dm(table_of_center, &floats(&[0.0; 3]), 1, &model()), Vec::new()).unwrap());
    assert_eq!(center[0], [[0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let broken = table.replace(r#""QUANTIZED_VOLUME_SCALE":[10,20,30],"#, "");
    assert!(instances(i3dm(&broken, &binary, 1, &model()), Vec::new()).is_err());
}

/// The specification allows lists of numbers in the JSON of a feature table. CesiumJS reads them.
#[test]
fn i3dm_columns_may_be_lists_in_the_json() {
    let table = r#"{"INSTANCES_LENGTH":2,"POSITION":[1,2,3,4,5,6],"SCALE":{"byteOffset":0},"BATCH_ID":[7,8],
        "NORMAL_UP":[0,1,0,0,0,1],"NORMAL_RIGHT":[1,0,0,0,1,0]}"#;
    let read = |table: &str| frames(&instances(i3dm(table, &floats(&[2.0, 3.0]), 1, &model()), Vec::new()).unwrap());
    let [one, two] = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]];
    assert_eq!([read(table)[0], read(table)[1]].map(|[origin, ..]| origin), [one, two]);
    assert_eq!(read(table)[1][1], [0.0, 3.0, 0.0]);
    let single = r#"{"INSTANCES_LENGTH":1,"POSITION":[1,2,3],"SCALE":[5]}"#;
    assert_eq!(read(single)[0], [one, [5.0, 0.0, 0.0], [0.0, 0.0, 5.0]], "a list of one number is no offset");
    let short = r#"{"INSTANCES_LENGTH":1,"POSITION":[1,2]}"#;
    let error = instances(i3dm(short, &[], 1, &model()), Vec::new()).unwrap_err().to_string();
    assert!(error.contains("POSITION has 2 numbers, too few for 1 rows"), "{error}");
    let odd = instances(i3dm(r#"{"INSTANCES_LENGTH":"x"}"#, &[], 1, &model()), Vec::new()).unwrap_err().to_string();
    assert!(odd.contains("neither what its name says nor a byteOffset"), "{odd}");
}

/// Regression: a list in the JSON that was too short, and a column of the binary part, read into the list behind it.
#[test]
fn short_i3dm_columns_are_refused_by_name() {
    for (columns, named) in [
        (r#""POSITION":[1,2,3,4,5],"SCALE":[5,6]"#, "POSITION has 5 numbers"),
        (r#""POSITION":[1,2,3,4,5,6],"SCALE":[5],"SCALE_NON_UNIFORM":[1,1,1,1,1,1]"#, "SCALE has 1 numbers"),
        (r#""POSITION":[1,2,3,4,5,6],"BATCH_ID":[]"#, "BATCH_ID has 0 numbers"),
        (r#""POSITION":[1,2,3,4,5,6],"SCALE":{"byteOffset":4}"#, "SCALE has 4 bytes"),
    ] {
        let table = format!(r#"{{"INSTANCES_LENGTH":2,{columns}}}"#);
        let bytes = i3dm(&table, &floats(&[2.0, 3.0]), 1, &model());
        let error = instances(bytes, Vec::new()).unwrap_err().reason();
        assert!(error.contains(named) && error.contains("2 rows"), "{error}");
    }
}

/// Regression: a vector tile in a composite took the mesh beside it.
#[test]
fn unsupported_tile_of_a_composite_leaves_the_others() {
    let vector = [b"vctr", &1_u32.to_le_bytes()[..], &16_u32.to_le_bytes(), &[0; 4]].concat();
    let mesh = i3dm(r#"{"INSTANCES_LENGTH":1,"POSITION":[1,2,3]}"#, &[], 1, &model());
    let (node, ignored) =
        decode_noting(content(cmpt_bytes(&[vector.clone(), mesh.clone()]), Vec::new()), &options()).unwrap();
    assert_eq!(node.children.len(), 1);
    let kinds: Vec<&str> = ignored.iter().map(|(kind, _)| kind).collect();
    assert!(kinds.len() == 1 && kinds[0].contains("vector tile"), "{kinds:?}");
    assert!(decode(content(cmpt_bytes(&[vector]), Vec::new()), &options()).is_err());
    assert!(decode(content(cmpt_bytes(&[mesh, b"pnts".repeat(4)]), Vec::new()), &options()).is_err());
}

#[test]
fn i3dm_with_an_external_model() {
    let table = r#"{"INSTANCES_LENGTH":1,"POSITION":{"byteOffset":0}}"#;
    let bytes = i3dm(table, &floats(&[1.0, 2.0, 3.0]), 0, b"../models/tree%201.gltf \0\0");
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    gltf.draw(json!({ "attributes": { "POSITION": positions } }));
    gltf.json["buffers"] = json!([{ "byteLength": gltf.buffer.len(), "uri": "tree.bin" }]);
    // A loader asks until it has everything.
    let mut known: Vec<Fetched> = Vec::new();
    let mut rounds = Vec::new();
    loop {
        let wanted = dependencies("/set/a/trees.i3dm", &bytes, None, &known, &options());
        let Some(uri) = wanted.first().cloned() else { break };
        let file = if uri.ends_with(".gltf") { gltf.text() } else { gltf.buffer.clone() };
        known.push((uri.clone(), Ok(file)));
        rounds.push((wanted.len(), uri.to_string()));
    }
    assert_eq!(rounds, [(1, "/set/models/tree 1.gltf".to_owned()), (1, "/set/models/tree.bin".to_owned())]);
    let found = instances(bytes.clone(), known).unwrap();
    assert_eq!((found.len(), found[0].0.translation), (1, DVec3::new(1.0, 2.0, 3.0)));
    let gone = instances(bytes, Vec::new()).unwrap_err();
    assert!(matches!(gone, IoError::NotFound { uri } if uri == "/set/models/tree 1.gltf"));
}

#[test]
fn broken_i3dm_are_refused() {
    let table = r#"{"INSTANCES_LENGTH":1,"POSITION":{"byteOffset":0}}"#;
    let whole = i3dm(table, &floats(&[1.0, 2.0, 3.0]), 1, &model());
    for length in 0..whole.len() {
        assert!(instances(whole[..length].to_vec(), Vec::new()).is_err(), "{length}");
    }
    for table in [
        r#"{"INSTANCES_LENGTH":2,"POSITION":{"byteOffset":0}}"#,
        r#"{"INSTANCES_LENGTH":18446744073709551615,"POSITION":{"byteOffset":0}}"#,
        r#"{"INSTANCES_LENGTH":1,"POSITION":{"byteOffset":18446744073709551615}}"#,
        r#"{"INSTANCES_LENGTH":1}"#,
        r#"{"POSITION":{"byteOffset":0}}"#,
        r#"{"INSTANCES_LENGTH":1,"POSITION":{"byteOffset":0},"SCALE":{"byteOffset":12}}"#,
        r#"{"INSTANCES_LENGTH":1,"POSITION":{"byteOffset":0},"RTC_CENTER":[1,2]}"#,
    ] {
        let error = instances(i3dm(table, &floats(&[1.0, 2.0, 3.0]), 1, &model()), Vec::new()).unwrap_err();
        assert!(error.reason().contains("i3dm"), "{table}: {error}");
    }
    let nan = i3dm(table, &floats(&[f32::NAN, 2.0, 3.0]), 1, &model());
    assert!(instances(nan, Vec::new()).unwrap_err().reason().contains("not finite"));
    assert!(instances(i3dm(table, &floats(&[0.0; 3]), 2, &model()), Vec::new()).is_err());
}

/// Regression for memory: each instance counted the whole mesh.
#[test]
fn a_shared_mesh_counts_once_in_a_page() {
    let count = 1000;
    let table = format!(r#"{{"INSTANCES_LENGTH":{count},"POSITION":{{"byteOffset":0}}}}"#);
    let positions = floats(&vec![1.0; 3 * count]);
    let big = write_glb(&GlbMesh {
        positions: (0..30_000).map(|i| [i as f32, (i % 7) as f32, 0.0]).collect(),
        indices: (0..30_000).collect(),
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    let options = ReadOptions { build_kd_trees: true, ..options() };
    let page: Page = decode(content(i3dm(&table, &positions, 1, &big), Vec::new()), &options).unwrap();
    assert_eq!(page.drawable_count(), count);
    assert!(page.size_bytes() < 10 << 20, "{}", page.size_bytes());
}
