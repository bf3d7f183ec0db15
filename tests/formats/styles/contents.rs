//! Styles that apply to contents: b3dm, glTF, i3dm, pnts.

use std::sync::Arc;

use kit::contents::{b3dm_with_batches, pnts_bytes, pnts_with_batches};
use serde_json::{Value, json};
use terrane::fetch::Limits;
use terrane::formats::{ReadOptions, Style};
use terrane::scene::{AlphaMode, Drawable, Topology};

use crate::gltf_builder::*;

fn options(style: &Value) -> ReadOptions {
    let style = Style::from_json("style.json", style.to_string().as_bytes()).unwrap();
    ReadOptions {
        style: Some(Arc::new(style)),
        keep_features: true,
        ..ReadOptions::for_root("/set/tileset.json", Limits::default())
    }
}

fn styled(bytes: Vec<u8>, style: &Value) -> Vec<Drawable> {
    let read = read_with(bytes, Vec::new(), &options(style)).unwrap();
    read.node_drawables()
}

/// Returns a glTF of four triangles with ids 0 to 3, side by side along x.
fn triangles(id_attribute: &str) -> (GltfBuilder, Value) {
    let mut gltf = GltfBuilder::new();
    let corner = |i: usize| (0..3).flat_map(move |k| [i as f32 + TRIANGLE[3 * k], TRIANGLE[3 * k + 1], 0.0]);
    let positions = gltf.floats("VEC3", &(0..4).flat_map(corner).collect::<Vec<f32>>());
    let ids: Vec<u16> = (0..12).map(|i| i / 3).collect();
    let ids = gltf.accessor(UNSIGNED_SHORT, "SCALAR", 12, &shorts(&ids));
    (gltf, json!({ "attributes": { "POSITION": positions, id_attribute: ids } }))
}

fn b3dm() -> Vec<u8> {
    let (mut gltf, primitive) = triangles("_BATCHID");
    gltf.draw(primitive);
    let batches = r#"{"Height":[10,80,150,null],"name":["hut","house","tower","ruin"]}"#;
    b3dm_with_batches(r#"{"BATCH_LENGTH":4}"#, batches, &gltf.glb())
}

/// Returns the positions along x of the triangles or points of a drawable, with the colours of their first vertices.
fn parts(drawable: &Drawable) -> Vec<(f32, [u8; 4])> {
    let mesh = mesh_of(drawable);
    let step = if mesh.topology == Topology::Points { 1 } else { 3 };
    let first = mesh.indices.chunks(step).map(|primitive| mesh.vertices[primitive[0] as usize]);
    first.map(|vertex| (vertex.position[0], vertex.color)).collect()
}

#[test]
fn features_of_a_b3dm_are_hidden_and_colored() {
    let style = json!({
        "show": "${name} !== 'ruin'",
        "color": { "conditions": [
            ["${Height} > 100", "color('red', 0.5)"],
            ["${Height} > 50", "rgb(0, 188, 255)"],
            ["true", "color('white')"],
        ] },
    });
    let drawables = styled(b3dm(), &style);
    let [opaque, transparent] = &drawables[..] else { panic!("{} drawables", drawables.len()) };
    assert_eq!(parts(opaque), [(0.0, [255; 4]), (1.0, [0, 128, 255, 255])], "linear");
    assert_eq!(parts(transparent), [(2.0, [255, 0, 0, 128])]);
    assert_eq!((opaque.material.alpha, transparent.material.alpha), (AlphaMode::Opaque, AlphaMode::Blend));
    // The hidden triangle takes no memory and does not count in the bounds.
    assert_eq!((mesh_of(opaque).vertices.len(), mesh_of(transparent).vertices.len()), (6, 3));
    assert_eq!([opaque, transparent].map(|drawable| drawable.bounds().max.x), [2.0, 3.0]);
    // Picking still finds the features.
    let name = |drawable: &Drawable, vertex| {
        let feature = drawable.features.as_ref().unwrap().at_vertex(vertex).next().unwrap().properties();
        feature.iter().map(|(_, value)| value.to_string()).collect::<Vec<_>>().join(" ")
    };
    assert_eq!([name(opaque, 4), name(transparent, 0)], ["80 house", "150 tower"]);
}

#[test]
fn one_color_for_all_features_keeps_the_mesh() {
    let plain = styled(b3dm(), &json!({}));
    let red = styled(b3dm(), &json!({ "color": "color('red')" }));
    let glass = styled(b3dm(), &json!({ "color": "${Height} > 1000 ? color('red') : color('white', 0.25)" }));
    assert_eq!([plain.len(), red.len(), glass.len()], [1; 3]);
    assert_eq!(mesh_of(&red[0]), mesh_of(&plain[0]));
    assert_eq!(red[0].material.base_color, [1.0, 0.0, 0.0, 1.0]);
    assert_eq!(red[0].material.alpha, AlphaMode::Opaque);
    assert_eq!((glass[0].material.base_color, glass[0].material.alpha), ([1.0, 1.0, 1.0, 0.25], AlphaMode::Blend));
    assert_eq!(mesh_of(&glass[0]), mesh_of(&plain[0]));
}

#[test]
fn values_that_are_missing_leave_features_as_they_are() {
    let plain = styled(b3dm(), &json!({}));
    for style in [
        json!({ "show": "${Missing}", "color": "${Missing}" }),
        json!({ "color": "${Height} + 'a'", "show": "unknown(${Height})" }),
        json!({ "color": { "conditions": [["${Height} > 1000", "color('red')"]] }, "pointSize": 3 }),
    ] {
        let drawables = styled(b3dm(), &style);
        assert_eq!((drawables.len(), parts(&drawables[0])), (1, parts(&plain[0])), "{style}");
        assert_eq!(drawables[0].material, plain[0].material, "{style}");
    }
    assert!(styled(b3dm(), &json!({ "show": "false" })).is_empty());
    assert!(styled(b3dm(), &json!({ "color": "color('red', 0)" })).is_empty());
    // The height of the fourth feature is null.
    assert_eq!(styled(b3dm(), &json!({ "show": "${Height} > 0" }))[0].bounds().max.x, 3.0);
}

#[test]
fn features_are_removed_unless_they_are_kept() {
    let kept = options(&json!({ "color": "${Height} > 50 ? color('red') : color('blue')" }));
    let options = ReadOptions { keep_features: false, ..kept.clone() };
    let features = |options| {
        let read = read_with(b3dm(), Vec::new(), options).unwrap().node_drawables();
        (read[0].features.is_some(), parts(&read[0]).len())
    };
    assert_eq!((features(&kept), features(&options)), ((true, 4), (false, 4)));
}

#[test]
fn what_a_style_asks_for_in_vain_is_noted() {
    let style = json!({ "labelText": "${name}", "show": "isClass('a')", "color": "color() * ${tiles3d_tileset_time}" });
    let read = read_with(b3dm(), Vec::new(), &options(&style)).unwrap();
    for kind in ["style: member labelText", "style: function isClass", "style: variable tiles3d_tileset_time"] {
        assert_eq!(read.ignored.count(kind), 1, "{kind}: {:?}", read.ignored);
    }
}

#[test]
fn features_of_a_gltf_have_the_colors_of_their_property_table() {
    let (mut gltf, mut primitive) = triangles("_FEATURE_ID_0");
    let heights = gltf.view(&floats(&[1.0, 2.0, 3.0]), None);
    gltf.json["extensions"] = json!({ "EXT_structural_metadata": {
        "schema": { "classes": { "c": { "properties": { "h": { "type": "SCALAR", "componentType": "FLOAT32" } } } } },
        "propertyTables": [{ "class": "c", "count": 3, "properties": { "h": { "values": heights } } }],
    } });
    primitive["extensions"] = json!({ "EXT_mesh_features": { "featureIds": [
        { "featureCount": 3, "attribute": 0, "propertyTable": 0, "nullFeatureId": 3 },
    ] } });
    let material = gltf.push("materials", json!({ "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.5, 0.5, 1] } }));
    primitive["material"] = material.into();
    gltf.draw(primitive);
    let drawables = styled(gltf.text(), &json!({ "color": "vec4(${h} - 1, 0, 3 - ${h}, 1)", "show": "${h} !== 2" }));
    assert_eq!(drawables.len(), 1);
    // The null id is no feature, and keeps its colour, even if all features have one.
    let red = styled(gltf.text(), &json!({ "color": "color('red')" }));
    let colors: Vec<[u8; 4]> = parts(&red[0]).into_iter().map(|(_, color)| color).collect();
    assert_eq!(colors, [[255, 0, 0, 255], [255, 0, 0, 255], [255, 0, 0, 255], [255; 4]]);
    // Colours of the style are clamped.
    let expected = [(0.0, [0, 0, 255, 255]), (2.0, [255, 0, 0, 255]), (3.0, [255; 4])];
    assert_eq!(parts(&drawables[0]), expected);
    assert_eq!(drawables[0].material.base_color, [0.5, 0.5, 0.5, 1.0], "the material still applies");
}

#[test]
fn nodes_that_draw_one_mesh_share_the_styled_mesh() {
    let (mut gltf, primitive) = triangles("_BATCHID");
    let node = gltf.draw(primitive);
    let other = gltf.push("nodes", json!({ "mesh": 0, "translation": [0, 5, 0] }));
    gltf.json["scenes"] = json!([{ "nodes": [node, other] }]);
    let b3dm = b3dm_with_batches(r#"{"BATCH_LENGTH":4}"#, r#"{"h":[1,2,3,4]}"#, &gltf.glb());
    let drawables = styled(b3dm, &json!({ "color": "rgb(${h}, 0, 0)" }));
    assert_eq!(drawables.len(), 2);
    assert!(Arc::ptr_eq(&mesh_of(&drawables[0]), &mesh_of(&drawables[1])));
}

#[test]
fn instances_get_colors_and_share_their_mesh() {
    let table = r#"{"INSTANCES_LENGTH":3,"POSITION":{"byteOffset":0}}"#;
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    gltf.draw(json!({ "attributes": { "POSITION": positions } }));
    let mut i3dm = crate::instances::i3dm(table, &floats(&[0.0; 9]), 1, &gltf.text());
    let batches = br#"{"kind":["oak","elm","ash"]}"#;
    let model_at = i3dm.len() - gltf.text().len();
    i3dm.splice(model_at..model_at, batches.iter().copied());
    let length = i3dm.len() as u32;
    i3dm[8..12].copy_from_slice(&length.to_le_bytes());
    i3dm[20..24].copy_from_slice(&(batches.len() as u32).to_le_bytes());
    let style = json!({
        "show": "${kind} !== 'ash'", "color": "${kind} =~ regExp('^o') ? color('lime') : color('blue', 0.5)",
    });
    let drawables = styled(i3dm, &style);
    let colors: Vec<_> = drawables.iter().map(|drawable| drawable.material.base_color).collect();
    assert_eq!(colors, [[0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.5]]);
    assert!(Arc::ptr_eq(&mesh_of(&drawables[0]), &mesh_of(&drawables[1])));
}

/// Returns the feature table of three points along x with colours.
fn points() -> (&'static str, Vec<u8>) {
    let mut binary = floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0]);
    binary.extend([255, 255, 255, 0, 255, 0, 255, 0, 0]);
    binary.extend([0, 1, 1]);
    (r#"{"POINTS_LENGTH":3,"RTC_CENTER":[10,0,0],"POSITION":{"byteOffset":0},"RGB":{"byteOffset":36}"#, binary)
}

#[test]
fn points_see_their_position_and_color() {
    let (table, binary) = points();
    let cloud = pnts_bytes(&[table, "}"].concat(), &binary);
    let style = json!({
        "show": "${POSITION}.x < 2 && ${POSITION_ABSOLUTE}.x >= 10 && ${NORMAL} === undefined",
        "color": "${COLOR} * color('cyan')",
    });
    let drawables = styled(cloud.clone(), &style);
    // The colour replaces that of the point, which is white and lime.
    assert_eq!(parts(&drawables[0]), [(0.0, [0, 255, 255, 255]), (1.0, [0, 255, 0, 255])]);
    let blue = styled(cloud, &json!({ "color": "color('blue')" }));
    assert_eq!(parts(&blue[0]).iter().map(|(_, color)| *color).collect::<Vec<_>>(), [[0, 0, 255, 255]; 3]);
}

#[test]
fn points_have_the_properties_of_their_batch_or_their_own() {
    let (table, binary) = points();
    let with_ids =
        [table, r#","BATCH_LENGTH":2,"BATCH_ID":{"byteOffset":45,"componentType":"UNSIGNED_BYTE"}}"#].concat();
    let style = json!({ "color": "${class} === 'wall' ? color('yellow') : color('white', 0.5)" });
    let drawables = styled(pnts_with_batches(&with_ids, &binary, r#"{"class":["roof","wall"]}"#), &style);
    let [walls, roof] = &drawables[..] else { panic!("{} drawables", drawables.len()) };
    // The colour of a batch is multiplied by that of the point.
    assert_eq!(parts(walls), [(1.0, [0, 255, 0, 255]), (2.0, [255, 0, 0, 255])]);
    assert_eq!((parts(roof), roof.material.alpha), (vec![(0.0, [255, 255, 255, 128])], AlphaMode::Blend));

    let own = pnts_with_batches(&[table, "}"].concat(), &binary, r#"{"heat":[3,7,5]}"#);
    let drawables =
        styled(own, &json!({ "show": "${heat} > 4", "color": "${heat} > 6 ? color('red') : color('blue')" }));
    assert_eq!(parts(&drawables[0]), [(1.0, [255, 0, 0, 255]), (2.0, [0, 0, 255, 255])]);
}

#[test]
fn points_with_a_size_become_squares() {
    let (table, binary) = points();
    let cloud = pnts_with_batches(&[table, "}"].concat(), &binary, r#"{"heat":[3,7,200]}"#);
    let style = json!({ "show": "${heat} > 4", "pointSize": "${heat}" });
    let drawables = styled(cloud, &style);
    let [drawable] = &drawables[..] else { panic!("{} drawables", drawables.len()) };
    let mesh = mesh_of(drawable);
    assert_eq!((mesh.topology, mesh.vertices.len(), mesh.indices.len()), (Topology::Squares, 8, 12));
    let corners: Vec<[f32; 2]> = mesh.vertices.iter().map(|vertex| vertex.uv).collect();
    assert_eq!(corners[..4], [[-3.5, -3.5], [3.5, -3.5], [-3.5, 3.5], [3.5, 3.5]]);
    assert_eq!(corners[4], [-32.0; 2], "sizes are limited to 64 pixels");
    assert_eq!((mesh.bounds.min.x, mesh.bounds.max.x), (1.0, 2.0));
    // Each corner leads to the feature of its point.
    let features = drawable.features.as_ref().unwrap();
    let ids: Vec<u32> = (0..8).map(|vertex| features.at_vertex(vertex).next().unwrap().id).collect();
    assert_eq!(ids, [1, 1, 1, 1, 2, 2, 2, 2]);
}
