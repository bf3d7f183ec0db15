//! Tilesets with unusual members: each spoils at most its own tile. No GPU.

use std::path::Path;
use std::sync::Arc;

use base64::Engine as _;
use glam::{DAffine3, DVec3};
use kit::skip::skipped;
use terrane::fetch::{Limits, root_uri};
use terrane::formats::writers::{GlbMesh, write_glb};
use terrane::formats::{Content, ReadOptions, decode_node, decode_noting, inspect, verify};
use terrane::math::BoundingVolume;
use terrane::scene::{Geometry, Node, NodeKind, PagedLod, RangeMode, ReaderData, Refine};

const SET: &str = "/set/tileset.json";
const SPHERE: &str = r#""boundingVolume":{"sphere":[0,0,0,5]}"#;

fn options() -> ReadOptions {
    ReadOptions::for_root(SET, Limits::default())
}

fn read(json: &str) -> Node {
    let content = Content { uri: SET.into(), bytes: json.into(), reader_data: None, companions: Vec::new() };
    decode_node(content, &options()).unwrap()
}

fn tileset(root: &str) -> Node {
    read(&format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":40,"root":{root}}}"#))
}

fn lod(node: &Node) -> &PagedLod {
    let NodeKind::PagedLod(lod) = &node.kind else { panic!("a tile") };
    lod
}

fn error_m(lod: &PagedLod) -> f64 {
    let RangeMode::ScreenSpaceError { geometric_error_m } = lod.range_mode else { panic!("by error") };
    geometric_error_m
}

/// Decodes the content of a tile that needs no file, or one with these bytes.
fn content_of(tile: &PagedLod, bytes: Vec<u8>) -> Result<Node, String> {
    let uri = tile.content.clone().unwrap();
    let is_whole = tile.reader_data.as_ref().is_some_and(ReaderData::is_whole_content);
    let bytes = if is_whole { Vec::new() } else { bytes };
    let content = Content { uri, bytes, reader_data: tile.reader_data.clone(), companions: Vec::new() };
    decode_node(content, &options()).map_err(|error| error.to_string())
}

fn glb() -> Vec<u8> {
    write_glb(&GlbMesh {
        positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 3.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    })
}

/// The last vertex of the only drawable.
fn last_vertex(node: &Node) -> DVec3 {
    fn find(node: &Node, above: DAffine3) -> Option<DVec3> {
        let here = if let NodeKind::Transform(map) = node.kind { above * map } else { above };
        if let NodeKind::Geode(drawables) = &node.kind
            && let Geometry::Mesh(mesh) = &drawables[0].geometry
        {
            let [x, y, z] = mesh.vertices[2].position.map(f64::from);
            return Some(here.transform_point3(DVec3::new(x, y, z)));
        }
        node.children.iter().find_map(|child| find(child, here))
    }
    find(node, DAffine3::IDENTITY).unwrap()
}

#[test]
fn null_is_as_absent() {
    let nulls = r#""viewerRequestVolume":null,"refine":null,"transform":null,"contents":null,"extras":null,
        "extensions":null,"implicitTiling":null,"metadata":null"#;
    let node = read(&format!(
        r#"{{"asset":{{"version":"1.0","gltfUpAxis":null,"extras":null}},"geometricError":null,"extensionsUsed":null,
        "extensionsRequired":null,"schema":null,"extensions":null,"properties":null,"root":{{{SPHERE},"geometricError":7,{nulls},
        "content":null,"children":[null,{{"boundingVolume":{{"sphere":[0,0,0,5],"box":null,"region":null,"extensions":null}},
        "geometricError":null,{nulls},"content":{{"uri":"a.glb","boundingVolume":null}},"children":null}}]}}}}"#
    ));
    assert_eq!((error_m(lod(&node)), node.children.len(), lod(&node).content.as_deref()), (7.0, 1, None));
    let child = lod(&node.children[0]);
    assert_eq!((child.content.as_deref(), child.refine, error_m(child)), (Some("/set/a.glb"), Refine::Replace, 7.0));
    assert!(node.children[0].children.is_empty());
}

#[test]
fn spellings_of_old_converters_are_read() {
    for version in ["\"0.0\"", "\"1.0\"", "1.0", "1.1"] {
        let node = read(&format!(
            r#"{{"asset":{{"version":{version}}},"geometricError":"40","root":{{{SPHERE},"geometricError":"7.5","refine":"add",
            "content":{{"url":"a.b3dm"}}}}}}"#
        ));
        assert_eq!((error_m(lod(&node)), lod(&node).refine), (7.5, Refine::Add), "{version}");
        assert_eq!(lod(&node).content.as_deref(), Some("/set/a.b3dm"));
    }
    // Members that are not needed to draw the set.
    let node = read(&format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":1,"extensionsUsed":"none","extensionsRequired":[7],
        "extensions":[],"root":{{{SPHERE},"geometricError":7,"extensions":"none","content":{{"uri":"a.glb"}}}}}}"#
    ));
    assert_eq!(lod(&node).content.as_deref(), Some("/set/a.glb"));
    let node = tileset(&format!(r#"{{{SPHERE},"refine":"sideways","children":[{{{SPHERE}}}]}}"#));
    assert_eq!((error_m(lod(&node)), error_m(lod(&node.children[0]))), (40.0, 40.0), "errors are inherited");
    assert_eq!(lod(&node).refine, Refine::Replace);
}

/// Each of these refused the whole set.
#[test]
fn invalid_tiles_fail_alone() {
    let good = format!(r#"{{{SPHERE},"geometricError":1,"content":{{"uri":"good.glb"}}}}"#);
    for (bad, reason) in [
        (format!(r#"{{{SPHERE},"geometricError":"much"}}"#), "geometricError NaN"),
        ("7".to_owned(), "neither box, region nor sphere"),
        (r#"{"boundingVolume":"large","geometricError":1}"#.to_owned(), "neither box, region nor sphere"),
        (format!(r#"{{{SPHERE},"geometricError":1,"children":{{}}}}"#), "neither box, region nor sphere"),
        (format!(r#"{{{SPHERE},"geometricError":1,"content":"a.glb"}}"#), "content without a uri"),
        (format!(r#"{{{SPHERE},"geometricError":1,"contents":{{"uri":"a.glb"}}}}"#), "content without a uri"),
        (format!(r#"{{{SPHERE},"geometricError":1,"implicitTiling":7}}"#), "an implicit root is a sphere"),
        (r#"{"geometricError":1}"#.to_owned(), "neither box, region nor sphere"),
        (r#"{"boundingVolume":{"box":[1,2,3]},"geometricError":1}"#.to_owned(), "bounding box"),
        (r#"{"boundingVolume":{"sphere":"large"},"geometricError":1}"#.to_owned(), "bounding sphere"),
        (r#"{"boundingVolume":{"sphere":[0,0,null,1]},"geometricError":1}"#.to_owned(), "bounding sphere"),
        (format!(r#"{{{SPHERE},"geometricError":1,"transform":[1,2,3]}}"#), "transform of 3 numbers"),
        (format!(r#"{{{SPHERE},"geometricError":1,"viewerRequestVolume":{{}}}}"#), "neither box"),
        (format!(r#"{{{SPHERE},"geometricError":1,"content":{{}}}}"#), "content without a uri"),
        (format!(r#"{{{SPHERE},"geometricError":1,"content":{{"uri":7}}}}"#), ""),
        (format!(r#"{{{SPHERE},"geometricError":1,"content":{{"uri":"file:///etc/a"}}}}"#), "tileset.json"),
        (format!(r#"{{{SPHERE},"geometricError":1,"content":{{"uri":"data:;base64,?"}}}}"#), "base64"),
    ] {
        let node =
            tileset(&format!(r#"{{{SPHERE},"geometricError":9,"refine":"ADD","children":[{good},{bad},{good}]}}"#));
        let [first, spoilt, last] = &node.children[..] else { panic!("three tiles") };
        assert!([first, last].iter().all(|tile| lod(tile).content.as_deref() == Some("/set/good.glb")), "{bad}");
        if reason.is_empty() {
            assert_eq!(lod(spoilt).content.as_deref(), Some("/set/7"), "a number is text");
            continue;
        }
        // The children of a tile may be what is invalid.
        let spoilt = spoilt.children.first().unwrap_or(spoilt);
        let error = content_of(lod(spoilt), Vec::new()).err().unwrap_or_default();
        assert!(error.contains(reason), "{bad}: {error}");
    }
}

/// Browsers take the last of repeated members. Writers give leaves negative errors.
#[test]
fn negative_errors_and_repeated_members_are_read() {
    let text = format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":1,"geometricError":40,"root":{{{SPHERE},"refine":"ADD","refine":"REPLACE",
        "geometricError":-1,"content":{{"uri":"no.glb","uri":"a.glb"}},"children":[{{{SPHERE},
        "geometricError":-2,"content":{{"uri":"b.glb"}}}}]}}}}"#
    );
    let content = Content { uri: SET.into(), bytes: text.into(), reader_data: None, companions: Vec::new() };
    let (node, ignored) = decode_noting(content, &options()).unwrap();
    assert_eq!((error_m(lod(&node)), error_m(lod(&node.children[0]))), (0.0, 0.0));
    assert_eq!((lod(&node).content.as_deref(), lod(&node).refine), (Some("/set/a.glb"), Refine::Replace));
    assert_eq!(ignored.count("geometricError that is negative, and taken as 0"), 2);
}

/// Browsers replace characters that are not UTF-8. Programs on Windows write names in the encoding of their country.
#[test]
fn text_in_another_encoding_is_read() {
    let text = format!(
        r#"{{"asset":{{"version":"1.1","extras":"Z?rich"}},"geometricError":1,"root":{{{SPHERE},"geometricError":0,
        "content":{{"uri":"a.glb"}}}}}}"#
    );
    let mut bytes = text.into_bytes();
    let at = bytes.iter().position(|byte| *byte == b'?').unwrap();
    bytes[at] = 0xfc;
    let content = Content { uri: SET.into(), bytes, reader_data: None, companions: Vec::new() };
    let (node, ignored) = decode_noting(content, &options()).unwrap();
    assert_eq!(lod(&node).content.as_deref(), Some("/set/a.glb"));
    assert_eq!(ignored.count("tileset: text that is not UTF-8"), 1);
    // The error of a tileset that is no JSON is that of its parser.
    let text = r#"{"asset":{"version":"1.1"},"geometricError":NaN}"#;
    let content = Content { uri: SET.into(), bytes: text.into(), reader_data: None, companions: Vec::new() };
    let error = decode_node(content, &options()).unwrap_err().to_string();
    assert!(error.contains("NaN at line 1 column"), "{error}");
}

#[test]
fn corners_of_regions_may_be_mixed_up_or_beyond_the_antimeridian() {
    let region = |numbers: [f64; 6]| {
        let node = tileset(&format!(r#"{{"boundingVolume":{{"region":{numbers:?}}},"geometricError":1}}"#));
        let BoundingVolume::Region(region) = lod(&node).bounds else { panic!("a region") };
        [region.west, region.south, region.east, region.north, region.min_height_m, region.max_height_m]
            .map(|x| (x * 1e6).round() / 1e6)
    };
    assert_eq!(region([0.1, 0.4, 0.2, 0.3, 90.0, 10.0]), [0.1, 0.3, 0.2, 0.4, 10.0, 90.0]);
    assert_eq!(region([3.1, 0.3, 3.2, 0.4, 0.0, 1.0]), [3.1, 0.3, -3.083185, 0.4, 0.0, 1.0]);
    assert_eq!(region([4.0, 0.3, 4.1, 0.4, 0.0, 1.0]), [-2.283185, 0.3, -2.183185, 0.4, 0.0, 1.0]);
    assert_eq!(region([-3.2, 0.3, -3.1, 0.4, 0.0, 1.0]), [3.083185, 0.3, -3.1, 0.4, 0.0, 1.0]);
    let turn = std::f64::consts::TAU;
    let [west, _, east, ..] = region([0.0, -1.5, turn - 5e-7, 1.5, 0.0, 1.0]);
    assert!(east - west > turn - 2e-6, "a whole parallel: {west} to {east}");
    assert_eq!(region([3.0, 0.3, -3.0, 0.4, 0.0, 1.0]), [3.0, 0.3, -3.0, 0.4, 0.0, 1.0]);
}

#[test]
fn contents_may_be_in_the_tileset() {
    let data = base64::engine::general_purpose::STANDARD.encode(glb());
    for reference in [format!("data:;base64,{data}"), format!("DATA:model/gltf-binary;base64,{data}")] {
        let node = tileset(&format!(r#"{{{SPHERE},"geometricError":0,"content":{{"uri":"{reference}"}}}}"#));
        let tile = lod(&node);
        assert!(tile.content.as_deref().unwrap().len() < 60, "the name of the content is not its bytes");
        assert_eq!(last_vertex(&content_of(tile, Vec::new()).unwrap()), DVec3::new(0.0, -3.0, 2.0));
    }
    // A tileset in a tileset.
    let inner = format!(
        r#"{{"asset":{{"version":"1.1"}},"geometricError":1,"root":{{{SPHERE},"geometricError":1,"content":{{"uri":"x.glb"}}}}}}"#
    );
    let data = base64::engine::general_purpose::STANDARD.encode(inner);
    let node = tileset(&format!(
        r#"{{{SPHERE},"geometricError":0,"content":{{"uri":"data:application/json;base64,{data}"}}}}"#
    ));
    let inner = content_of(lod(&node), Vec::new()).unwrap();
    assert_eq!(lod(&inner).content.as_deref(), Some("/set/x.glb"));
}

/// Sets of old converters lay on their side.
#[test]
fn the_up_axis_of_the_set_is_obeyed() {
    for (axis, expected) in [
        ("\"X\"", [-3.0, 2.0, 0.0]),
        ("\"Y\"", [0.0, -3.0, 2.0]),
        ("\"y\"", [0.0, -3.0, 2.0]),
        ("\"Z\"", [0.0, 2.0, 3.0]),
        ("\"z\"", [0.0, 2.0, 3.0]),
        ("null", [0.0, -3.0, 2.0]),
        ("7", [0.0, -3.0, 2.0]),
    ] {
        let node = read(&format!(
            r#"{{"asset":{{"version":"1.0","gltfUpAxis":{axis}}},"geometricError":1,"root":{{{SPHERE},"geometricError":0,
            "contents":[{{"uri":"a.glb"}},{{"uri":"b.glb"}}]}}}}"#
        ));
        assert_eq!(node.children.len(), 2);
        for child in &node.children {
            let vertex = last_vertex(&content_of(lod(child), glb()).unwrap());
            assert!(vertex.distance(DVec3::from_array(expected)) < 1e-12, "{axis}: {vertex}");
        }
    }
}

#[test]
fn several_contents_of_1_0_are_read() {
    for member in ["contents", "content"] {
        let node = tileset(&format!(
            r#"{{{SPHERE},"geometricError":0,"extensions":{{"3DTILES_multiple_contents":{{"{member}":[{{"uri":"a.glb"}},{{"url":"b.pnts"}}]}}}}}}"#
        ));
        let names: Vec<&str> = node.children.iter().map(|child| lod(child).content.as_deref().unwrap()).collect();
        assert_eq!(names, ["/set/a.glb", "/set/b.pnts"], "{member}");
    }
}

/// Files that failed once, made for this purpose. They lie beside a developer's checkout; elsewhere this says so.
#[test]
fn collected_cases_are_read() {
    let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/samples/cases");
    if !cases.is_dir() {
        return skipped(format!("no cases at {}", cases.display()));
    }
    for (case, contents, failed) in [
        ("content-data-uri", 2, 0),
        ("one-bad-uri-drops-the-set", 2, 1),
        ("tileset-null-members", 1, 0),
        ("gltf-up-axis-z", 1, 0),
    ] {
        let folder = cases.join(case);
        let source = folder.to_str().unwrap();
        let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
        assert_eq!((verified.contents, verified.failed), (contents, failed), "{case}: {verified:?}");
        let info = inspect(source, &Limits::default()).unwrap();
        assert_eq!(info.failed, failed, "{case}: {info}");
        assert!(
            info.errors.iter().all(|error| error.reason.contains("tileset.json") && error.reason.len() < 300),
            "{info}"
        );
    }
    // The tower stands in its box.
    let root = root_uri(cases.join("gltf-up-axis-z").to_str().unwrap()).unwrap();
    let options = ReadOptions::for_root(&root, Limits::default());
    let load = |uri: &Arc<str>, reader_data| {
        let bytes = std::fs::read(&**uri).unwrap();
        decode_node(Content { uri: uri.clone(), bytes, reader_data, companions: Vec::new() }, &options).unwrap()
    };
    let set = load(&root, None);
    fn tile_with_content(node: &Node) -> Option<&PagedLod> {
        let own = if let NodeKind::PagedLod(tile) = &node.kind { Some(&**tile) } else { None };
        own.filter(|tile| tile.content.is_some()).or_else(|| node.children.iter().find_map(tile_with_content))
    }
    let tile = tile_with_content(&set).unwrap();
    let tower = load(tile.content.as_ref().unwrap(), tile.reader_data.clone());
    let tower = tower.bounding_sphere();
    let volume = tile.bounds.oriented_box().unwrap();
    assert!(volume.distance_to(tower.center) < 1e-6, "{volume:?} {tower:?}");
}

/// Each kind of property that is left out is named once.
#[test]
fn ignored_members_of_tilesets_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let json = format!(
        r#"{{"asset":{{"version":"1.1","gltfUpAxis":"W"}},"schemaUri":"schema.json","geometricError":1,
        "extensionsUsed":["3DTILES_ellipsoid","3DTILES_implicit_tiling","KHR_draco_mesh_compression"],
        "root":{{{SPHERE},"geometricError":1}}}}"#
    );
    std::fs::write(folder.path().join("tileset.json"), json).unwrap();
    let source = folder.path().to_str().unwrap();
    let expected =
        ["asset.gltfUpAxis W", "metadata: a schema that cannot be read", "tileset extension 3DTILES_ellipsoid"];
    let info = inspect(source, &Limits::default()).unwrap();
    assert_eq!(info.ignored, expected.map(|kind| (kind.to_owned(), 1)).into());
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!(verified.ignored, info.ignored);
    // The schema is missing.
    for (failed, errors) in [(info.failed, info.errors), (verified.failed, verified.errors)] {
        assert!(failed == 1 && errors[0].uri.ends_with("/schema.json"), "{errors:?}");
    }
}
