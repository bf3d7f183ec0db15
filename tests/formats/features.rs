//! Features of contents: ids of parts of a mesh, and property tables.

use std::path::Path;

use kit::skip::skipped;
use serde_json::{Value, json};
use terrane::fetch::{IoError, Limits, read_file, root_uri};
use terrane::formats::{Content, IgnoredLog, ReadOptions, decode, decode_noting, dependencies, verify};
use terrane::scene::{Page, PropertyValue};

use crate::gltf_builder::*;

fn options() -> ReadOptions {
    ReadOptions { keep_features: true, ..ReadOptions::for_root("/set/tileset.json", Limits::default()) }
}

fn page(bytes: Vec<u8>) -> Page {
    decode(Content { uri: URI.into(), bytes, reader_data: None, companions: Vec::new() }, &options()).unwrap()
}

/// Returns label, id and properties of each feature at a vertex.
fn at(page: &Page, drawable: u32, vertex: u32) -> Vec<(String, u32, String)> {
    let features = page.features(drawable).unwrap();
    let all = features.at_vertex(vertex).map(|feature| {
        let properties = feature.properties().into_iter().map(|(name, value)| format!("{name} {value}"));
        (feature.label.to_owned(), feature.id, properties.collect::<Vec<_>>().join("; "))
    });
    all.collect()
}

#[test]
fn mesh_features_lead_to_their_properties() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let ids = gltf.floats("SCALAR", &[1.0, 0.0, 5.0]);
    let heights = gltf.view(&floats(&[1.5, 2.5]), None);
    gltf.json["extensions"] = json!({ "EXT_structural_metadata": {
        "schema": { "classes": { "c": { "properties": { "height": { "type": "SCALAR", "componentType": "FLOAT32" } } } } },
        "propertyTables": [{ "class": "c", "count": 2, "properties": { "height": { "values": heights } } }],
    } });
    gltf.draw(json!({
        "attributes": { "POSITION": positions, "_FEATURE_ID_0": ids },
        "extensions": { "EXT_mesh_features": { "featureIds": [
            { "featureCount": 2, "attribute": 0, "propertyTable": 0, "nullFeatureId": 5, "label": "house" },
            { "featureCount": 3 },
            { "featureCount": 1, "texture": { "index": 0 } },
            { "featureCount": 1, "attribute": 7 },
        ] } },
    }));
    let read = read_with(gltf.text(), Vec::new(), &options()).unwrap();
    assert_eq!(read.ignored.count("glTF: feature ids whose texture is missing or invalid"), 1);
    assert_eq!(read.ignored.count("glTF: feature ids whose attribute is missing"), 1);
    let mut page = page(gltf.text());
    page.take_drawables();
    let feature = |label: &str, id, properties: &str| (label.to_owned(), id, properties.to_owned());
    assert_eq!(at(&page, 0, 0), [feature("house", 1, "height 2.5"), feature("", 0, "")]);
    assert_eq!(at(&page, 0, 1), [feature("house", 0, "height 1.5"), feature("", 1, "")]);
    assert_eq!(at(&page, 0, 2), [feature("", 2, "")], "the null id");
    // The schema may be in another file.
    let mut external = gltf.json.clone();
    let metadata = external["extensions"]["EXT_structural_metadata"].as_object_mut().unwrap();
    let schema = metadata.remove("schema").unwrap().to_string().into_bytes();
    metadata.insert("schemaUri".to_owned(), json!("a/s.json"));
    gltf.json = external;
    let (text, options) = (gltf.text(), options());
    let plain = ReadOptions { keep_features: false, ..options.clone() };
    let files = dependencies(URI, &text, None, &[], &options);
    assert_eq!(files.iter().map(|uri| uri.rsplit_once("/a/").unwrap().1).collect::<Vec<_>>(), ["s.json"]);
    assert!(dependencies(URI, &text, None, &[], &plain).is_empty());
    let read = |file: Result<Vec<u8>, IoError>| {
        let companions = vec![(files[0].clone(), file)];
        let content = Content { uri: URI.into(), bytes: text.clone(), reader_data: None, companions };
        let log = ReadOptions { ignored: IgnoredLog::default(), ..options.clone() };
        (decode(content, &log), log.ignored.snapshot().count("metadata: a schema that cannot be read"))
    };
    let (page, noted) = read(Ok(schema));
    assert_eq!((at(&page.unwrap(), 0, 0)[0].2.as_str(), noted), ("height 2.5", 0));
    for missing in [Err(IoError::NotFound { uri: String::new() }), Ok(b"[".to_vec())] {
        let (page, noted) = read(missing);
        assert_eq!((at(&page.unwrap(), 0, 0)[0].2.as_str(), noted), ("", 1));
    }
    // They take memory only if they are wanted.
    let content = Content { uri: URI.into(), bytes: gltf.text(), reader_data: None, companions: Vec::new() };
    assert!(decode(content, &plain).unwrap().features(0).is_none());
}

/// Metadata that is invalid leaves the mesh. A verification reads it and names each kind.
#[test]
fn verification_names_invalid_metadata_of_contents() {
    let height = json!({ "type": "SCALAR", "componentType": "FLOAT32" });
    let name = json!({ "type": "STRING" });
    let schema = json!({ "classes": { "c": { "properties": { "height": height, "name": name } } } });
    let model = |metadata: &dyn Fn(&mut GltfBuilder) -> Value| {
        let mut gltf = GltfBuilder::new();
        let positions = gltf.floats("VEC3", &TRIANGLE);
        let uvs = gltf.floats("VEC2", &[0.0; 6]);
        let image = gltf.push("images", json!({ "uri": "missing.png" }));
        gltf.push("textures", json!({ "source": image }));
        let metadata = metadata(&mut gltf);
        gltf.json["extensions"] = json!({ "EXT_structural_metadata": metadata });
        gltf.draw(json!({
            "attributes": { "POSITION": positions, "TEXCOORD_0": uvs },
            "extensions": { "EXT_mesh_features": { "featureIds": [
                { "featureCount": 1, "texture": { "index": 0 }, "propertyTable": 0 }, { "featureCount": 3, "propertyTable": 9 },
                { "featureCount": 3, "label": 7 },
            ] } },
        }));
        gltf.text()
    };
    let damaged = model(&|gltf| {
        let heights = gltf.view(&floats(&[1.5, 2.5]), None);
        let text = gltf.view(b"ab", None);
        let ends = gltf.view(&[0, 1, 2, 9], None);
        let strings = json!({ "values": text, "stringOffsets": ends, "stringOffsetType": "UINT8" });
        json!({ "schema": schema, "propertyTables": [
            { "class": "c", "count": 2, "properties": { "height": { "values": heights }, "name": strings } },
            { "class": "c", "count": 3, "properties": { "height": { "values": heights }, "name": strings } },
            { "class": "d", "count": 2, "properties": { "height": { "values": heights } } },
        ] })
    });
    let without_schema = model(&|gltf| {
        let heights = gltf.view(&floats(&[1.5]), None);
        json!({ "propertyTables": [{ "class": "c", "count": 1, "properties": { "height": { "values": heights } } }] })
    });
    let folder = tempfile::tempdir().unwrap();
    let bounds = json!({ "sphere": [0, 0, 0, 9] });
    let tile = |uri: &str| json!({ "boundingVolume": bounds, "geometricError": 0, "content": { "uri": uri } });
    let set = json!({ "asset": { "version": "1.1" }, "geometricError": 9, "root": {
        "boundingVolume": bounds, "geometricError": 9, "refine": "ADD", "children": [tile("a.gltf"), tile("b.gltf")],
    } });
    for (name, bytes) in
        [("a.gltf", damaged.clone()), ("b.gltf", without_schema), ("tileset.json", set.to_string().into_bytes())]
    {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let verified = verify(folder.path().to_str().unwrap(), &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (2, 0), "{verified:?}");
    let expected = [
        ("glTF: an invalid set of feature ids", 2),
        ("glTF: external image that is missing", 2),
        ("glTF: feature ids whose property table is missing", 3),
        ("glTF: feature ids whose texture is missing or invalid", 2),
        ("metadata: a property table of an unknown class", 1),
        ("metadata: a property table whose buffer view is too short", 2),
        ("metadata: a schema that is missing", 1),
    ];
    assert_eq!(verified.ignored, expected.map(|(kind, count)| (kind.to_owned(), count)).into());
    // Metadata that is not kept is not read.
    assert!(crate::gltf_builder::read(damaged, Vec::new()).unwrap().ignored.is_empty());
}

#[test]
fn b3dm_batches_have_properties() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let ids = gltf.accessor(UNSIGNED_SHORT, "SCALAR", 3, &shorts(&[1, 0, 1]));
    gltf.draw(json!({ "attributes": { "POSITION": positions, "_BATCHID": ids } }));
    let glb = gltf.glb();
    let features = br#"{"BATCH_LENGTH":2}      "#;
    let batches = br#"{"name":["a","b"],"h":{"byteOffset":0,"componentType":"UNSIGNED_BYTE","type":"SCALAR"}} "#;
    let binary = [7, 9, 0, 0, 0, 0, 0, 0];
    let mut b3dm = b"b3dm".to_vec();
    let length = 28 + features.len() + batches.len() + binary.len() + glb.len();
    for word in [1, length, features.len(), 0, batches.len(), binary.len()] {
        b3dm.extend((word as u32).to_le_bytes());
    }
    let b3dm = [&b3dm[..], features, batches, &binary, &glb].concat();
    let page = page(b3dm);
    assert_eq!(at(&page, 0, 0), [(String::new(), 1, "h 9; name b".to_owned())]);
    assert_eq!(at(&page, 0, 1), [(String::new(), 0, "h 7; name a".to_owned())]);
}

#[test]
fn instances_are_features() {
    let table = r#"{"INSTANCES_LENGTH":2,"POSITION":{"byteOffset":0},"BATCH_ID":{"byteOffset":24,"componentType":"UNSIGNED_BYTE"}}"#;
    let mut binary = floats(&[0.0; 6]);
    binary.extend([1, 0]);
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    gltf.draw(json!({ "attributes": { "POSITION": positions } }));
    let mut i3dm = crate::instances::i3dm(table, &binary, 1, &gltf.text());
    // A batch table between the feature table and the model.
    let batches = br#"{"kind":["oak","elm"]}"#;
    let model_at = i3dm.len() - gltf.text().len();
    i3dm.splice(model_at..model_at, batches.iter().copied());
    let length = i3dm.len() as u32;
    i3dm[8..12].copy_from_slice(&length.to_le_bytes());
    i3dm[20..24].copy_from_slice(&(batches.len() as u32).to_le_bytes());
    let page = page(i3dm);
    assert_eq!(at(&page, 0, 0), [(String::new(), 1, "kind elm".to_owned())]);
    assert_eq!(at(&page, 1, 2), [(String::new(), 0, "kind oak".to_owned())]);
}

/// A file that others wrote: ten instances with a property table.
#[test]
fn the_sample_with_instance_features_has_its_strings() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../shared/samples/3d-tiles/GpuInstancesMetadata/GpuInstancesMetadata.gltf");
    let Some(path) = file.to_str().filter(|_| file.exists()) else {
        return skipped(format!("no sample at {}", file.display()));
    };
    let uri = root_uri(path).unwrap();
    let options = ReadOptions { keep_features: true, ..ReadOptions::for_root(&uri, Limits::default()) };
    let bytes = read_file(&uri, &options.limits).unwrap();
    let (node, ignored) =
        decode_noting(Content { uri, bytes, reader_data: None, companions: Vec::new() }, &options).unwrap();
    assert!(ignored.iter().all(|(kind, _)| kind.contains("metallic")), "{ignored:?}");
    let page = Page::from_node(node).unwrap();
    assert_eq!(page.drawable_count(), 10);
    let mut ids = Vec::new();
    for drawable in 0..10 {
        let features = page.features(drawable).unwrap();
        let [feature] = features.at_vertex(0).collect::<Vec<_>>()[..] else { panic!("one feature") };
        assert_eq!(feature.table.unwrap().row_count, 10);
        let value = feature.table.unwrap().value("example_STRING", feature.id as usize).unwrap();
        assert!(matches!(&value, PropertyValue::Text(text) if !text.is_empty()), "{value:?}");
        ids.push(feature.id);
    }
    ids.sort_unstable();
    assert_eq!(ids, (0..10).collect::<Vec<_>>());
}
