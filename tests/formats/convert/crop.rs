//! Cropping: what stays of a set, byte for byte.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::{Value, json};
use terrane::fetch::Limits;
use terrane::formats::{ConvertError, ConvertOptions, crop, verify};
use terrane::math::{Region, WGS84};

use super::tileset;

/// Returns the files below a folder by their names.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn add(folder: &Path, prefix: &str, out: &mut BTreeMap<String, Vec<u8>>) {
        for entry in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap()) {
            let name = format!("{prefix}{}", entry.file_name().to_str().unwrap());
            if entry.path().is_dir() {
                add(&entry.path(), &format!("{name}/"), out);
            } else {
                out.insert(name, std::fs::read(entry.path()).unwrap());
            }
        }
    }
    let mut out = BTreeMap::new();
    add(folder, "", &mut out);
    out
}

#[test]
fn contents_are_copied_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let (set, out) = (folder.path().join("set"), folder.path().join("out"));
    std::fs::create_dir(&set).unwrap();
    kit::tile_sets::write_quadtree(&set);
    let half = kit::tile_sets::WORLD_M / 2.0;
    let rectangle_m = Some([1.0, 1.0, half - 1.0, half - 1.0]);
    let options = ConvertOptions { rectangle_m, ..ConvertOptions::default() };
    let cropped = crop(set.to_str().unwrap(), &out, &options, &mut |_| {}).unwrap();
    assert_eq!(cropped.written.levels, [1, 1, 4, 16, 64]);
    assert_eq!((cropped.copied, cropped.files, cropped.source == cropped.written), (86, 87, true), "{cropped:?}");
    let (source, own) = (files(&set), files(&out));
    assert!(own.iter().all(|(name, bytes)| name == "tileset.json" || source[name] == *bytes));
    assert_eq!(own.values().map(|bytes| bytes.len() as u64).sum::<u64>(), cropped.bytes);
    let verified = verify(out.to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (86, 0), "{:?}", verified.errors);
    // Compression is another content.
    let options = ConvertOptions { meshopt: true, ..options };
    let converted = crop(set.to_str().unwrap(), &folder.path().join("converted"), &options, &mut |_| {}).unwrap();
    assert_eq!((converted.copied, &converted.written.levels), (0, &cropped.written.levels));
}

fn tile([west, east]: [f64; 2], more: Value) -> Value {
    let region = [west, 45.0, east, 46.0].map(f64::to_radians);
    let mut tile = json!({ "geometricError": 1, "boundingVolume": { "region": [region[0], region[1], region[2], region[3], 0, 9] } });
    more.as_object().unwrap().iter().for_each(|(name, value)| tile[name] = value.clone());
    tile
}

fn write_set(path: &Path, root: Value) {
    let extras = json!({ "terrane": { "content": "height", "side": 65, "border": 1, "level_errors_m": [9, 4, 1] } });
    let set = json!({ "asset": { "version": "1.1", "extras": extras }, "geometricError": 9, "root": root });
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, set.to_string()).unwrap();
}

/// The files of tiles outside are left out; what a tile needs beside its content comes along, and extras stay.
#[test]
fn tilesets_lose_the_tiles_outside_and_keep_everything_else() {
    let folder = tempfile::tempdir().unwrap();
    let (set, out) = (folder.path().join("set"), folder.path().join("out"));
    let heights = |name: &str| json!({ "content": { "uri": format!("{name}.exr") }, "extras": { "terrane": { "imagery": format!("{name}.jpg") } } });
    let external = |side: &str| json!({ "content": { "uri": format!("{side}/part.json") } });
    let model = tile([7.0, 7.5], json!({ "contents": [{ "uri": "m/a%20b.gltf" }, { "uri": "missing.glb" }] }));
    let mut root = tile([7.0, 9.0], heights("0"));
    root["children"] = json!([tile([7.0, 8.0], external("west")), tile([8.0, 9.0], external("east")), model, 5]);
    write_set(&set.join("tileset.json"), root);
    let mut west = tile([7.0, 8.0], heights("../1"));
    west["children"] = json!([tile([7.0, 7.5], heights("2")), tile([7.5, 8.0], heights("3"))]);
    write_set(&set.join("west/part.json"), west);
    write_set(&set.join("east/part.json"), tile([8.0, 9.0], heights("4")));
    for name in ["0", "1", "west/2", "west/3", "east/4"] {
        std::fs::write(set.join(format!("{name}.exr")), format!("heights {name}")).unwrap();
        std::fs::write(set.join(format!("{name}.jpg")), format!("colours {name}")).unwrap();
    }
    std::fs::create_dir(set.join("m")).unwrap();
    let gltf = r#"{"asset":{"version":"2.0"},"buffers":[{"uri":"b.bin","byteLength":3}]}"#;
    std::fs::write(set.join("m/a b.gltf"), gltf).unwrap();
    std::fs::write(set.join("m/b.bin"), "abc").unwrap();
    let [west, south, east, north] = [7.1, 45.2, 7.4, 45.4].map(f64::to_radians);
    let region = Region { west, south, east, north, min_height_m: 0.0, max_height_m: 0.0, ellipsoid: WGS84 };
    let options = ConvertOptions { region: Some(region), ..ConvertOptions::default() };
    let cropped = crop(set.to_str().unwrap(), &out, &options, &mut |_| {}).unwrap();
    assert_eq!((cropped.failed, &*cropped.written.levels), (1, &[1, 2, 1][..]), "{cropped:?}");
    assert!(cropped.errors[0].0.ends_with("missing.glb"), "{cropped:?}");
    let (source, own) = (files(&set), files(&out));
    let expected = [
        "0.exr",
        "0.jpg",
        "1.exr",
        "1.jpg",
        "m/a b.gltf",
        "m/b.bin",
        "tileset.json",
        "west/2.exr",
        "west/2.jpg",
        "west/part.json",
    ];
    assert_eq!(own.keys().collect::<Vec<_>>(), expected);
    assert!(own.iter().all(|(name, bytes)| name.ends_with(".json") || source[name] == *bytes));
    let read = |name: &str| -> Value { serde_json::from_slice(&own[name]).unwrap() };
    let before: Value = serde_json::from_slice(&source["west/part.json"]).unwrap();
    let after = read("west/part.json");
    assert_eq!((&after["asset"], &after["root"]["extras"]), (&before["asset"], &before["root"]["extras"]));
    assert_eq!(after["root"]["children"], json!([before["root"]["children"][0]]));
    assert_eq!(tileset(&out)["root"]["children"].as_array().unwrap().len(), 3, "one child is no tile, as before");
    // Nothing lies far away.
    let options = ConvertOptions { region: Some(Region { west: 1.0, east: 1.1, ..region }), ..options };
    let none = crop(set.to_str().unwrap(), &folder.path().join("none"), &options, &mut |_| {});
    assert!(matches!(none, Err(ConvertError::Nothing { .. })), "{none:?}");
}
