//! Height tiles in implicit tiling: each has its part of the root, the error of its level and its image. No GPU.

use kit::subtrees::{Scheme, Subtree};
use serde_json::{Value, json};
use terrane::fetch::Limits;
use terrane::formats::inspect;
use terrane::math::BoundingVolume;
use terrane::scene::{PagedLod, RangeMode};

use super::implicit::Found;

const EXTRAS: &str = r#"{"terrane":{"content":"height","side":5,"border":1,"level_errors_m":[40,20,10,5]}}"#;

/// Writes a set of three levels in subtrees of two, below an explicit root.
fn write(folder: &std::path::Path, scheme: Scheme, volume: Value, extras: Value) {
    let implicit = json!({
        "boundingVolume": volume, "geometricError": 999, "refine": "REPLACE", "extras": { "terrane": extras },
        "content": { "uri": "c/{level}_{x}_{y}.exr" },
        "implicitTiling": { "subdivisionScheme": scheme.name(), "subtreeLevels": 2, "availableLevels": 3,
            "subtrees": { "uri": "{level}_{x}_{y}.subtree" } },
    });
    let extras: Value = serde_json::from_str(EXTRAS).unwrap();
    let region = json!({ "region": [0.1, 0.2, 0.9, 0.6, 0, 100] });
    let set = json!({
        "asset": { "version": "1.1", "extras": extras }, "geometricError": 999,
        "root": { "boundingVolume": region, "geometricError": 999, "children": [implicit] },
    });
    std::fs::write(folder.join("tileset.json"), set.to_string()).unwrap();
    let mut top = Subtree::new(scheme, 2, 1);
    top.fill();
    top.add_child([3, 1, 0]);
    std::fs::write(folder.join("0_0_0.subtree"), top.binary()).unwrap();
    let mut below = Subtree::new(scheme, 2, 1);
    below.add_tile(0, [0, 0, 0]);
    below.add_content(0, 0, [0, 0, 0]);
    std::fs::write(folder.join("2_3_1.subtree"), below.binary()).unwrap();
}

fn tile<'a>(found: &'a Found, name: &str) -> (&'a PagedLod, Value) {
    let tile = found.contents.iter().find(|(uri, _)| uri.ends_with(name)).map(|(_, tile)| tile).unwrap();
    let data = tile.reader_data.as_ref().and_then(|data| data.text()).expect("the data of a height tile");
    (tile, serde_json::from_str(data).unwrap())
}

fn numbers(list: &Value) -> Vec<f64> {
    list.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

#[test]
fn each_tile_has_its_part_of_the_region_and_the_error_of_its_level() {
    let folder = tempfile::tempdir().unwrap();
    let volume = json!({ "region": [0.1, 0.2, 0.9, 0.6, 0, 100] });
    write(folder.path(), Scheme::Quadtree, volume, json!({ "imagery": "i/{level}/{x}/{y}.jpg" }));
    let found = Found::of(folder.path());
    assert!(found.errors.is_empty(), "{:?}", found.errors);
    assert_eq!(found.contents.len(), 6);
    for (name, region, errors_m, level, image) in [
        ("c/0_0_0.exr", [0.1, 0.2, 0.9, 0.6], vec![20.0, 40.0], 1, "i/0/0/0.jpg"),
        ("c/1_1_0.exr", [0.5, 0.2, 0.9, 0.4], vec![10.0, 20.0, 40.0], 2, "i/1/1/0.jpg"),
        ("c/2_3_1.exr", [0.7, 0.3, 0.9, 0.4], vec![5.0, 10.0, 20.0, 40.0], 3, "i/2/3/1.jpg"),
    ] {
        let (tile, data) = tile(&found, name);
        let got = numbers(&data["region"]);
        assert!(got.iter().zip(region).all(|(got, expected)| (got - expected).abs() < 1e-12), "{name}: {got:?}");
        let got: Vec<Vec<f64>> = data["errors_m"].as_array().unwrap().iter().map(numbers).collect();
        let wanted: Vec<Vec<f64>> = errors_m.iter().map(|error_m| vec![*error_m; 4]).collect();
        assert_eq!((got, data["level"].as_u64()), (wanted, Some(level)), "{name}");
        assert_eq!(tile.range_mode, RangeMode::ScreenSpaceError { geometric_error_m: errors_m[0] }, "{name}");
        assert!(data["imagery"].as_str().unwrap().ends_with(image), "{name}: {data}");
        let BoundingVolume::Region(bounds) = tile.bounds else { panic!("a region") };
        assert!((bounds.west - region[0]).abs() < 1e-12 && bounds.max_height_m == 100.0, "{name}: {bounds:?}");
    }
    let source = folder.path().to_str().unwrap();
    let info = inspect(source, &Limits::default()).unwrap();
    assert_eq!((info.format.as_str(), info.contents), ("3D Tiles with heights", 6));
}

#[test]
fn each_tile_has_its_part_of_the_plane() {
    let folder = tempfile::tempdir().unwrap();
    let volume = json!({ "box": [40, 20, 0, 40, 0, 0, 0, 20, 0, 0, 0, 100] });
    write(folder.path(), Scheme::Quadtree, volume, json!({ "plane": [0, 0, 80, 40] }));
    let found = Found::of(folder.path());
    assert!(found.errors.is_empty(), "{:?}", found.errors);
    for (name, plane) in [("c/0_0_0.exr", [0.0, 0.0, 80.0, 40.0]), ("c/2_3_1.exr", [60.0, 10.0, 80.0, 20.0])] {
        let (_, data) = tile(&found, name);
        assert_eq!((numbers(&data["plane"]), &data["imagery"]), (plane.to_vec(), &Value::Null), "{name}");
    }
}

#[test]
fn heights_in_an_octree_or_without_a_place_are_refused() {
    let region = json!({ "region": [0.1, 0.2, 0.9, 0.6, 0, 100] });
    let volume = json!({ "box": [40, 20, 0, 40, 0, 0, 0, 20, 0, 0, 0, 100] });
    for (scheme, volume, reason) in [
        (Scheme::Octree, region, "an octree of height tiles"),
        (Scheme::Quadtree, volume, "a height tile needs a region, or a plane"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), scheme, volume, json!({}));
        let info = inspect(folder.path().to_str().unwrap(), &Limits::default()).unwrap();
        assert!(info.errors.iter().any(|error| error.reason.contains(reason)), "{info}");
    }
}
