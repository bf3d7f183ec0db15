//! Metadata of tilesets, subtrees, tiles, contents and groups. Sets are made here. No GPU.

use std::path::Path;
use std::sync::Arc;

use serde_json::{Value, json};
use terrane::fetch::{Limits, read_file, root_uri};
use terrane::formats::{Content, IgnoredLog, ReadOptions, decode, decode_node, dependencies, inspect};
use terrane::scene::{Metadata, Node, NodeId, NodeKind, ReaderData, Refine, Scene, TileMetadata};

use crate::gltf_builder::data_uri;

/// The schema of all sets.
fn schema() -> Value {
    let scalar = |component: &str| json!({ "type": "SCALAR", "componentType": component });
    json!({
        "id": "s",
        "classes": {
            "city": { "properties": { "name": { "type": "STRING", "semantic": "NAME" }, "year": scalar("UINT16") } },
            "tile": { "properties": {
                "use": { "type": "ENUM", "enumType": "use", "noData": "none" },
                "sphere": { "type": "SCALAR", "array": true, "count": 4, "componentType": "FLOAT64",
                    "semantic": "TILE_BOUNDING_SPHERE" },
                "tags": { "type": "STRING", "array": true, "default": ["a"] },
            } },
        },
        "enums": { "use": { "values": [{ "name": "none", "value": 0 }, { "name": "park", "value": 7 }] } },
    })
}

fn options(root: &str) -> ReadOptions {
    ReadOptions { keep_features: true, ..ReadOptions::for_root(root, Limits::default()) }
}

fn content(uri: &str, bytes: Vec<u8>) -> Content {
    Content { uri: uri.into(), bytes, reader_data: None, companions: Vec::new() }
}

/// Returns class and values of metadata as text.
fn text(metadata: Option<&Arc<Metadata>>) -> String {
    let Some(metadata) = metadata else { return String::new() };
    let values = metadata.properties().map(|(property, value)| format!(" {}={value}", property.name));
    metadata.class().name.clone() + &values.collect::<String>()
}

/// Returns the metadata of all nodes that have some, with the content or external tileset of the node, in depth-first order.
fn all(node: &Node) -> Vec<(String, Arc<TileMetadata>)> {
    let uri = match &node.kind {
        NodeKind::PagedLod(tile) => tile.content.as_deref().unwrap_or_default(),
        NodeKind::ProxyNode(proxy) => &proxy.uri,
        _ => "",
    };
    let name = uri.rsplit('/').next().unwrap_or_default().to_owned();
    let own = node.metadata.clone().map(|metadata| (name, metadata));
    own.into_iter().chain(node.children.iter().flat_map(all)).collect()
}

fn explicit() -> Value {
    let volume = json!({ "sphere": [0, 0, 0, 9] });
    let named = |name: &str| json!({ "class": "city", "properties": { "name": name, "year": 7 } });
    let tile = |properties: Value| json!({ "class": "tile", "properties": properties });
    json!({
        "asset": { "version": "1.1" }, "geometricError": 9, "schema": schema(),
        "metadata": named("set"), "groups": [named("g0"), named("g1"), { "class": "no" }],
        "root": {
            "boundingVolume": volume, "geometricError": 5, "refine": "ADD",
            "metadata": tile(json!({ "use": "park", "sphere": [1, 2, 3, 4] })),
            "content": { "uri": "a.glb", "group": 1, "metadata": named("a") },
            "children": [
                { "boundingVolume": volume, "geometricError": 0, "metadata": tile(json!({ "use": "none" })),
                    "contents": [{ "uri": "b.glb", "group": 0 }, { "uri": "c.glb", "metadata": named("c") }] },
                { "boundingVolume": volume, "geometricError": 0,
                    "content": { "uri": "below.json", "group": 0, "metadata": named("external") } },
                { "boundingVolume": volume, "geometricError": 0, "content": { "uri": "d.glb", "group": 9 } },
                { "boundingVolume": volume, "geometricError": 0, "metadata": "x", "content": { "uri": "e.glb" } },
            ],
        },
    })
}

#[test]
fn tiles_contents_groups_and_tilesets_have_metadata() {
    let options = options("/set/tileset.json");
    let node = decode_node(content("/set/tileset.json", explicit().to_string().into_bytes()), &options).unwrap();
    let found = all(&node);
    let found: Vec<_> = found
        .iter()
        .map(|(name, m)| {
            let parts = [&m.tileset, &m.tile, &m.content, &m.group].map(|part| text(part.as_ref()));
            format!("{name}: {}", parts.join(" | "))
        })
        .collect();
    assert_eq!(found, [
        "a.glb: city name=set year=7 | tile sphere=[1, 2, 3, 4] tags=[a] use=park | city name=a year=7 | city name=g1 year=7",
        ": | tile sphere=null tags=[a] use=null |  | ",
        "b.glb:  |  |  | city name=g0 year=7",
        "c.glb:  |  | city name=c year=7 | ",
        "below.json:  |  | city name=external year=7 | city name=g0 year=7",
    ].map(|line| line.replace(": |", ":  |")));
    let ignored = options.ignored.snapshot();
    for kind in ["metadata of an unknown class", "metadata: a group that the tileset lacks"] {
        assert!(ignored.count(kind) > 0, "{ignored:?}");
    }
    // By API, and counted in the size of the page. Without the option nothing is kept.
    let page = |options: &ReadOptions| {
        decode(content("/set/tileset.json", explicit().to_string().into_bytes()), options).unwrap()
    };
    let plain = ReadOptions { keep_features: false, ignored: IgnoredLog::default(), ..options.clone() };
    assert!(page(&options).size_bytes() > page(&plain).size_bytes() + 500);
    assert!(plain.ignored.snapshot().is_empty(), "{:?}", plain.ignored.snapshot());
    for (options, is_kept) in [(&options, true), (&plain, false)] {
        let mut scene = Scene::new();
        let root = scene.add_root(page(options));
        let metadata = scene.metadata(NodeId { page: root, index: 0 });
        let sphere = metadata.and_then(|m| m.tile.as_ref()?.value_by_semantic("TILE_BOUNDING_SPHERE")?.as_numbers());
        assert_eq!(sphere, is_kept.then(|| vec![1.0, 2.0, 3.0, 4.0]));
        assert!(scene.metadata(NodeId { page: root, index: 99 }).is_none());
    }
}

/// Contents that are replaced together have their metadata at the nodes inside of the page.
#[test]
fn contents_that_are_replaced_together_keep_their_metadata() {
    let mut set = explicit();
    let mut contents = set["root"]["children"][0]["contents"].take();
    for content in contents.as_array_mut().unwrap() {
        let uri = format!("data:,{}", r#"{"asset":{"version":"2.0"}}"#.replace('"', "%22"));
        content["uri"] = uri.into();
    }
    let volume = json!({ "sphere": [0, 0, 0, 9] });
    set["root"]["content"] = Value::Null;
    set["root"]["contents"] = contents;
    set["root"]["refine"] = "REPLACE".into();
    set["root"]["children"] = json!([{ "boundingVolume": volume, "geometricError": 0, "content": { "uri": "e.glb" } }]);
    let options = options("/set/tileset.json");
    let root = decode_node(content("/set/tileset.json", set.to_string().into_bytes()), &options).unwrap();
    let NodeKind::PagedLod(tile) = root.kind else { panic!("a tile") };
    assert!(root.metadata.unwrap().tile.is_some());
    let joined = Content { reader_data: tile.reader_data, ..content(&tile.content.unwrap(), Vec::new()) };
    let joined = decode_node(joined, &options).unwrap();
    let parts = joined.children.iter().map(|child| child.metadata.clone().unwrap()).collect::<Vec<_>>();
    assert_eq!(
        (text(parts[0].group.as_ref()), text(parts[0].content.as_ref())),
        ("city name=g0 year=7".into(), String::new())
    );
    assert_eq!(text(parts[1].content.as_ref()), "city name=c year=7");
}

/// The extension of 1.0 has other names, and groups with names.
#[test]
fn metadata_of_1_0_is_read() {
    for tileset in ["tileset", "metadata"] {
        let set = json!({
            "asset": { "version": "1.0" }, "geometricError": 9,
            "extensionsUsed": ["3DTILES_metadata"],
            "extensions": { "3DTILES_metadata": {
                "schema": schema(), "groups": { "g": { "class": "city", "properties": { "name": "g" } } },
                tileset: { "class": "city", "properties": { "name": "set" } },
            } },
            "root": {
                "boundingVolume": { "sphere": [0, 0, 0, 9] }, "geometricError": 0, "refine": "ADD",
                "extensions": { "3DTILES_metadata": { "class": "tile", "properties": { "use": "park" } } },
                "content": { "uri": "a.glb", "extensions": { "3DTILES_metadata": { "group": "g" } } },
            },
        });
        let options = options("/set/tileset.json");
        let root = decode_node(content("/set/tileset.json", set.to_string().into_bytes()), &options).unwrap();
        let metadata = root.metadata.unwrap();
        let name = |of: &Option<Arc<Metadata>>| of.as_ref().unwrap().value("name").unwrap().to_string();
        assert_eq!((name(&metadata.tileset), name(&metadata.group)), ("set".into(), "g".into()));
        assert_eq!(metadata.tile.as_ref().unwrap().value("use").unwrap().as_str(), Some("park"));
        assert!(metadata.content.is_none() && options.ignored.snapshot().is_empty());
    }
}

/// An implicit set of a root and two of its children, whose metadata is in an external buffer.
struct Implicit {
    folder: tempfile::TempDir,
}

impl Implicit {
    fn new() -> Self {
        let mut schema = schema();
        let classes = schema["classes"].as_object_mut().unwrap();
        let scalar = |component: &str, semantic: &str| json!({ "type": "SCALAR", "componentType": component, "semantic": semantic });
        classes["tile"]["properties"]["refine"] = scalar("UINT8", "TILE_REFINE");
        classes["tile"]["properties"]["map"] =
            json!({ "type": "MAT4", "componentType": "FLOAT32", "semantic": "TILE_TRANSFORM" });
        classes.insert(
            "content".into(),
            json!({ "properties": {
            "group": scalar("UINT8", "CONTENT_GROUP_ID"),
            "uri": { "type": "STRING", "semantic": "CONTENT_URI", "noData": "" },
        } }),
        );
        let set = json!({
            "asset": { "version": "1.1" }, "geometricError": 9, "schema": schema,
            "groups": [{ "class": "city", "properties": { "name": "g0" } }, { "class": "city", "properties": { "name": "g1" } }],
            "root": {
                "boundingVolume": { "box": [0, 0, 0, 8, 0, 0, 0, 8, 0, 0, 0, 8] }, "geometricError": 8, "refine": "REPLACE",
                "content": { "uri": "c/{level}_{x}_{y}.glb", "group": 0 },
                "implicitTiling": { "subdivisionScheme": "QUADTREE", "subtreeLevels": 2, "availableLevels": 2,
                    "subtrees": { "uri": "all.subtree" } },
            },
        });
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("tileset.json"), set.to_string()).unwrap();
        let implicit = Self { folder };
        implicit.write_subtree(|_| {});
        implicit
    }

    /// Writes the subtree: the root and its first and last child, of which only the children have content.
    fn write_subtree(&self, change: impl Fn(&mut Value)) {
        let (mut buffer, mut views) = (Vec::new(), Vec::new());
        let mut view = |bytes: &[u8]| {
            buffer.resize(buffer.len().next_multiple_of(8), 0);
            views.push(json!({ "buffer": 1, "byteOffset": buffer.len(), "byteLength": bytes.len() }));
            buffer.extend_from_slice(bytes);
            views.len() + 1
        };
        let numbers = |numbers: &[u32]| numbers.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<_>>();
        let uses = view(&[7, 0, 0, 0, 7, 0]);
        let spheres = [[1.0_f64, 2.0, 3.0, 4.0], [5.0; 4], [6.0; 4]];
        let spheres = view(&spheres.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>());
        let (tags, tag_ends, tag_rows) = (view(b"xyyz"), view(&numbers(&[0, 1, 3, 4])), view(&numbers(&[0, 2, 2, 3])));
        let refine = view(&[0, 1, 1]);
        let maps = view(&[0; 3 * 64]);
        let (groups, uris, uri_ends) = (view(&[1, 0]), view(b"../other/x.glb"), view(&numbers(&[0, 0, 14])));
        std::fs::write(self.folder.path().join("meta.bin"), &buffer).unwrap();
        // The bits of the root and of children 0 and 3, and without the root.
        let bits = data_uri(&[0b1_0011, 0, 0, 0, 0, 0, 0, 0, 0b1_0010]);
        let mut json = json!({
            "buffers": [{ "byteLength": 9, "uri": bits }, { "byteLength": buffer.len(), "uri": "meta.bin" }],
            "bufferViews": [{ "buffer": 0, "byteOffset": 0, "byteLength": 1 }, { "buffer": 0, "byteOffset": 8, "byteLength": 1 }],
            "tileAvailability": { "bitstream": 0 }, "contentAvailability": [{ "bitstream": 1 }],
            "childSubtreeAvailability": { "constant": 0 },
            "tileMetadata": 0, "contentMetadata": [1],
            "subtreeMetadata": { "class": "city", "properties": { "name": "subtree" } },
            "propertyTables": [
                { "class": "tile", "count": 3, "properties": {
                    "use": { "values": uses }, "sphere": { "values": spheres }, "refine": { "values": refine },
                    "tags": { "values": tags, "stringOffsets": tag_ends, "arrayOffsets": tag_rows },
                    "map": { "values": maps },
                } },
                { "class": "content", "count": 2, "properties": {
                    "group": { "values": groups }, "uri": { "values": uris, "stringOffsets": uri_ends },
                } },
            ],
        });
        json["bufferViews"].as_array_mut().unwrap().extend(views);
        change(&mut json);
        std::fs::write(self.folder.path().join("all.subtree"), json.to_string()).unwrap();
    }

    /// Reads the root tile of the subtree.
    fn read(&self, options: &ReadOptions) -> Node {
        let root = root_uri(self.folder.path().to_str().unwrap()).unwrap();
        let read = |uri: &str, reader_data: Option<ReaderData>| {
            let bytes = read_file(uri, &options.limits).unwrap();
            let others = dependencies(uri, &bytes, reader_data.as_ref(), &[], options);
            let companions = others.into_iter().map(|uri| (uri.clone(), read_file(&uri, &options.limits))).collect();
            decode_node(Content { uri: uri.into(), bytes, reader_data, companions }, options).unwrap()
        };
        let NodeKind::PagedLod(tile) = read(&root, None).kind else { panic!("a tile") };
        read(&tile.content.unwrap(), tile.reader_data).children.remove(0)
    }

    fn options(&self) -> ReadOptions {
        options(&root_uri(self.folder.path().to_str().unwrap()).unwrap())
    }
}

fn tile_of(node: &Node) -> &terrane::scene::PagedLod {
    let NodeKind::PagedLod(tile) = &node.kind else { panic!("a tile") };
    tile
}

#[test]
fn tables_of_subtrees_are_the_metadata_of_tiles_and_contents() {
    let set = Implicit::new();
    let options = set.options();
    let root = set.read(&options);
    let parts = |node: &Node| {
        let m = node.metadata.clone().unwrap();
        [&m.tile, &m.content, &m.group].map(|part| text(part.as_ref()))
    };
    let map = format!("map=[{}]", ["0"; 16].join(", "));
    let of_tile = |refine: u8, sphere: &str, tags: &str, usage: &str| {
        format!("tile {map} refine={refine} sphere=[{sphere}] tags=[{tags}] use={usage}")
    };
    assert_eq!(parts(&root), [of_tile(0, "1, 2, 3, 4", "x, yy", "park"), String::new(), String::new()]);
    assert_eq!(text(root.metadata.as_ref().unwrap().subtree.as_ref()), "city name=subtree year=null");
    let group = |name: &str| format!("city name={name} year=null");
    let [first, last] = &root.children[..] else { panic!("two children") };
    assert_eq!(parts(first), [of_tile(1, "5, 5, 5, 5", "", "null"), "content group=1 uri=null".into(), group("g1")]);
    assert_eq!(
        parts(last),
        [of_tile(1, "6, 6, 6, 6", "z", "park"), "content group=0 uri=../other/x.glb".into(), group("g0")]
    );
    // The matrices are no transforms.
    let kind = "metadata: an invalid value of a volume, error, refinement or transform";
    assert_eq!(options.ignored.snapshot().count(kind), 3);
    // The page counts what it keeps.
    let page = |root: &Node| terrane::scene::Page::from_node(root.clone()).unwrap().size_bytes();
    let plain = set.read(&ReadOptions { keep_features: false, ..options.clone() });
    assert!(all(&plain).is_empty() && page(&root) > page(&plain) + 1000);
    let info = inspect(set.folder.path().to_str().unwrap(), &Limits::default()).unwrap();
    // The contents are missing.
    assert_eq!((info.tiles, info.tiles_with_metadata, info.failed), (3, 3, 2), "{info}");
}

#[test]
fn refinement_and_references_of_metadata_replace_those_of_the_tree() {
    let set = Implicit::new();
    // With and without metadata that is kept.
    for keep_features in [true, false] {
        let options = ReadOptions { keep_features, ..set.options() };
        let scope = set.folder.path().join("set");
        std::fs::create_dir_all(scope).unwrap();
        let root = set.read(&options);
        let [first, last] = &root.children[..] else { panic!("two children") };
        let refine = [&root, first, last].map(|node| tile_of(node).refine);
        assert_eq!(refine, [Refine::Add, Refine::Replace, Refine::Replace]);
        let uri = tile_of(first).content.clone().unwrap();
        assert!(uri.ends_with("/c/1_0_0.glb"), "{uri}");
        // A reference that leaves the folder of the set fails its tile alone.
        let refused = tile_of(last);
        assert!(refused.reader_data.as_ref().is_some_and(ReaderData::is_whole_content), "{refused:?}");
        let reader_data = refused.reader_data.clone();
        let error = decode_node(Content { reader_data, ..content("/x", Vec::new()) }, &options).unwrap_err();
        assert!(error.to_string().contains("other/x.glb"), "{error}");
    }
    // Inside of the folder it is the content.
    let offsets = |json: &mut Value| {
        let uris = json["propertyTables"][1]["properties"]["uri"]["values"].as_u64().unwrap() as usize;
        let begin = json["bufferViews"][uris]["byteOffset"].as_u64().unwrap() + 3;
        json["bufferViews"][uris]["byteOffset"] = begin.into();
        json["bufferViews"][uris]["byteLength"] = 11.into();
        let ends = json["propertyTables"][1]["properties"]["uri"]["stringOffsets"].as_u64().unwrap() as usize;
        json["bufferViews"][ends]["buffer"] = 2.into();
        json["bufferViews"][ends]["byteOffset"] = 0.into();
        json["buffers"]
            .as_array_mut()
            .unwrap()
            .push(json!({ "byteLength": 12, "uri": data_uri(&[0, 0, 0, 0, 0, 0, 0, 0, 11, 0, 0, 0]) }));
    };
    set.write_subtree(offsets);
    let root = set.read(&set.options());
    let uri = tile_of(&root.children[1]).content.clone().unwrap();
    let folder = Path::new(&*uri).parent().unwrap().parent().unwrap().canonicalize().unwrap();
    assert!(uri.ends_with("/other/x.glb") && folder == set.folder.path().canonicalize().unwrap(), "{uri}");
}

/// Tiles do not fail without metadata that has no effect on them.
#[test]
fn missing_buffers_and_invalid_tables_leave_the_tiles() {
    let set = Implicit::new();
    let plain = |json: &mut Value| {
        // Nothing in the external buffer has an effect.
        json["propertyTables"][0]["properties"] = json!({ "use": { "values": 2 } });
        json["contentMetadata"] = json!([]);
    };
    set.write_subtree(plain);
    std::fs::remove_file(set.folder.path().join("meta.bin")).unwrap();
    let options = set.options();
    let root = set.read(&options);
    assert_eq!((root.children.len(), text(root.metadata.unwrap().tile.as_ref())), (2, "tile tags=[a]".to_owned()));
    assert_eq!(options.ignored.snapshot().count("metadata: a buffer of a subtree that is missing"), 1);
    for change in [
        |json: &mut Value| json["tileMetadata"] = "x".into(),
        |json: &mut Value| json["tileMetadata"] = 9.into(),
        |json: &mut Value| json["contentMetadata"] = json!({ "a": 1 }),
        |json: &mut Value| json["subtreeMetadata"] = json!([7]),
        |json: &mut Value| json["propertyTables"][0]["count"] = 1.into(),
        |json: &mut Value| json["propertyTables"][0]["properties"]["sphere"]["values"] = 99.into(),
        |json: &mut Value| json["propertyTables"][1]["class"] = "no".into(),
    ] {
        set.write_subtree(change);
        assert_eq!(set.read(&set.options()).children.len(), 2);
    }
}

/// A set that others wrote: metadata of the tileset, of tiles, contents and groups.
#[test]
fn the_sample_with_all_granularities_has_metadata() {
    let file =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/samples/3d-tiles/MetadataGranularities/tileset.json");
    let Some(path) = file.to_str().filter(|_| file.exists()) else {
        return kit::skip::skipped(format!("no sample at {}", file.display()));
    };
    let uri = root_uri(path).unwrap();
    let options = options(&uri);
    let bytes = read_file(&uri, &options.limits).unwrap();
    let root = decode_node(content(&uri, bytes), &options).unwrap();
    let found = all(&root);
    assert_eq!(
        text(found[0].1.tileset.as_ref()),
        "exampleTilesetMetadataClass author=Cesium date=2022-03-21 tileCount=4"
    );
    let count = |part: fn(&TileMetadata) -> bool| found.iter().filter(|(_, metadata)| part(metadata)).count();
    assert_eq!(
        (count(|m| m.tile.is_some()), count(|m| m.content.is_some()), count(|m| m.group.is_some())),
        (4, 20, 20)
    );
    assert!(options.ignored.snapshot().is_empty(), "{:?}", options.ignored.snapshot());
}
