//! Styled contents by their pixels. Needs a GPU; a software adapter suffices.

use std::sync::Arc;

use kit::contents::{b3dm_with_batches, pnts_with_batches};
use kit::frames::{MAGENTA, count, pixel};
use kit::rig::{plain, rig, unit_camera};
use kit::viewer::{Settle, offscreen};
use serde_json::{Value, json};
use terrane::fetch::{Limits, root_uri};
use terrane::formats::{ReadOptions, Style, UpAxis};
use terrane::pager::{DatabasePager, PagerConfig};
use terrane::scene::Node;
use terrane::state::{Attribute, LightModel, StateSet};
use terrane::viewer::{Viewer, ViewerConfig};

use crate::gltf_builder::*;

const SIDE: u32 = 64;

/// Returns a styled content. glTF is not rotated, so that it faces the camera.
fn styled(bytes: Vec<u8>, style: &Value) -> Node {
    let style = Style::from_json("style.json", style.to_string().as_bytes()).unwrap();
    let options = ReadOptions {
        style: Some(Arc::new(style)),
        gltf_up_axis: UpAxis::Z,
        ..ReadOptions::for_root("/set/tileset.json", Limits::default())
    };
    read_with(bytes, Vec::new(), &options).unwrap().node
}

/// Returns a b3dm of four squares, each a feature, that fill the image: the first two above.
fn four_squares() -> Vec<u8> {
    let mut gltf = GltfBuilder::new();
    let corner = |square: usize, [x, y]: [f32; 2]| {
        let [left, bottom] = [(square % 2) as f32 - 1.0, if square < 2 { 0.0 } else { -1.0 }];
        [left + x, bottom + y, 0.0]
    };
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    let positions: Vec<f32> = (0..4).flat_map(|i| corners.map(|at| corner(i, at)).concat()).collect();
    let positions = gltf.floats("VEC3", &positions);
    let ids: Vec<u16> = (0..24).map(|i| i / 6).collect();
    let ids = gltf.accessor(UNSIGNED_SHORT, "SCALAR", 24, &shorts(&ids));
    gltf.json["extensionsUsed"] = json!(["KHR_materials_unlit"]);
    let material = gltf.push("materials", json!({ "extensions": { "KHR_materials_unlit": {} } }));
    gltf.draw(json!({ "attributes": { "POSITION": positions, "_BATCHID": ids }, "material": material }));
    b3dm_with_batches(r#"{"BATCH_LENGTH":4}"#, r#"{"name":["red","none","glass","plain"]}"#, &gltf.glb())
}

#[test]
fn features_are_drawn_in_their_colors_by_two_calls() {
    let Some(mut rig) = rig("features_are_drawn_in_their_colors_by_two_calls") else { return };
    let style = json!({
        "show": "${name} !== 'none'",
        "color": { "conditions": [["${name} === 'red'", "color('red')"], ["${name} === 'glass'", "color('lime', 0.5)"]] },
    });
    let scene = rig.scene(styled(four_squares(), &style));
    let stats = rig.draw(&scene, &unit_camera(SIDE), &plain());
    let picture = rig.read_back();
    rig.release(scene);
    let [red, none, glass, white] = [[16, 16], [48, 16], [16, 48], [48, 48]].map(|[x, y]| pixel(&picture, x, y));
    assert_eq!([red, none, white], [[255, 0, 0], MAGENTA, [255; 3]]);
    // Half of green over magenta, added up in linear light.
    assert!(glass.iter().all(|part| part.abs_diff(188) <= 1), "{glass:?}");
    assert_eq!(count(&picture, [255, 0, 0]), 32 * 32);
    assert_eq!((stats.draw_calls, stats.leaves, stats.triangles), (2, 2, 6));
}

#[test]
fn points_have_the_size_of_the_style() {
    let Some(mut rig) = rig("points_have_the_size_of_the_style") else { return };
    let center = |at: u32| (at as f32 + 0.5) / (SIDE as f32 / 2.0) - 1.0;
    let places = [10, 30, 50].map(|at| [center(at), -center(at), 0.0]).concat();
    let table = r#"{"POINTS_LENGTH":3,"POSITION":{"byteOffset":0},"CONSTANT_RGBA":[0,0,255,255]}"#;
    let cloud = pnts_with_batches(table, &floats(&places), r#"{"size":[0,1,2]}"#);
    let lit = StateSet::default().with(Attribute::LightModel(LightModel::default()));
    for fixed_function in [None, Some(Arc::new(lit))] {
        for (size, expected) in [("1 + 4 * ${size}", 1 + 5 * 5 + 9 * 9), ("${Missing}", 3), ("1", 3), ("7", 3 * 49)] {
            let mut node = styled(cloud.clone(), &json!({ "pointSize": size }));
            node.state_set = fixed_function.clone();
            let scene = rig.scene(node);
            let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
            rig.release(scene);
            assert!(rig.renderer.take_errors().is_empty());
            assert_eq!(count(&picture, [0, 0, 255]), expected, "{size} {}", fixed_function.is_some());
            assert_eq!(pixel(&picture, 30, 30), [0, 0, 255], "{size}");
        }
    }
}

/// A pager with another style replaces the contents; the root and the camera stay.
#[test]
fn another_pager_changes_the_style_of_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.b3dm"), four_squares()).unwrap();
    let tileset = r#"{"asset":{"version":"1.0","gltfUpAxis":"Z"},"geometricError":9,"root":{"refine":"ADD","geometricError":0,
        "boundingVolume":{"box":[0,0,0,1,0,0,0,1,0,0,0,0.1]},"content":{"uri":"a.b3dm"}}}"#;
    let file = folder.path().join("tileset.json");
    std::fs::write(&file, tileset).unwrap();
    let pager = |color: &str| {
        let style = Style::from_json("style.json", json!({ "color": color }).to_string().as_bytes()).unwrap();
        PagerConfig { blocking: true, style: Some(Arc::new(style)), ..PagerConfig::default() }
    };
    let config = ViewerConfig {
        size_px: [SIDE, SIDE],
        adapter: kit::adapter(),
        pager: pager("color('red')"),
        ..ViewerConfig::default()
    };
    let Some(mut viewer) = offscreen(&config) else { return };
    viewer.load(file.to_str().unwrap()).unwrap();
    let camera = unit_camera(SIDE);
    viewer.view_mut().environment = plain();
    viewer.view_mut().camera.world_from_eye = camera.eye_from_world.inverse();
    let middle = |viewer: &mut Viewer| {
        viewer.settle(2);
        viewer.want_picture();
        viewer.frame().unwrap();
        viewer.finish().unwrap();
        let (_, picture) = viewer.take_pictures().pop().unwrap();
        pixel(&picture, SIDE / 2, SIDE / 2)
    };
    assert_eq!(middle(&mut viewer), [255, 0, 0]);
    let uri = root_uri(file.to_str().unwrap()).unwrap();
    let config = pager("color('blue')");
    let mut other = DatabasePager::new(config, ReadOptions::for_root(&uri, Limits::default())).unwrap();
    other.read_root(&uri).unwrap();
    viewer.set_pager(other).unwrap();
    assert_eq!(middle(&mut viewer), [0, 0, 255]);
}
