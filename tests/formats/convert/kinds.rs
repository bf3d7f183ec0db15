//! Sets and models of other formats: images, materials, features, heights and terrain.

use base64::Engine as _;
use glam::DVec3;
use image::{ImageFormat, Rgba, RgbaImage};
use serde_json::json;
use terrane::fetch::read_file;
use terrane::formats::{Content, ReadOptions, decode, inspect};
use terrane::scene::Page;

use super::*;
use crate::gltf_builder::*;

/// Returns the extensions of a material with another reflection and a coat.
fn layers() -> serde_json::Value {
    let map = json!({ "index": 0 });
    json!({
        "KHR_materials_clearcoat": {
            "clearcoatFactor": 0.5, "clearcoatRoughnessFactor": 0.25, "clearcoatTexture": map,
            "clearcoatNormalTexture": { "index": 0, "scale": 0.5 },
        },
        "KHR_materials_ior": { "ior": 1.25 },
        "KHR_materials_specular": {
            "specularFactor": 0.5, "specularColorFactor": [1.0, 2.0, 0.5], "specularTexture": map,
            "specularColorTexture": map,
        },
    })
}

/// A textured triangle with two houses, in the local frame of a tile.
fn houses() -> (GltfBuilder, Vec<u8>) {
    let mut png = std::io::Cursor::new(Vec::new());
    RgbaImage::from_fn(4, 2, |x, y| Rgba([x as u8, y as u8, 7, 255])).write_to(&mut png, ImageFormat::Png).unwrap();
    let png = png.into_inner();
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let uvs = gltf.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let ids = gltf.floats("SCALAR", &[1.0, 0.0, 1.0]);
    let heights = gltf.view(&floats(&[1.5, 2.5]), None);
    let image = format!("data:image/png;base64,{}", base64::prelude::BASE64_STANDARD.encode(&png));
    gltf.push("images", json!({ "uri": image }));
    gltf.push("samplers", json!({ "wrapS": 33648, "wrapT": 33071, "magFilter": 9728, "minFilter": 9729 }));
    gltf.push("textures", json!({ "source": 0, "sampler": 0 }));
    gltf.push(
        "materials",
        json!({
            "pbrMetallicRoughness": {
                "baseColorTexture": { "index": 0 }, "baseColorFactor": [0.5, 1, 1, 1], "metallicFactor": 0.25,
                "roughnessFactor": 0.5,
            },
            "alphaMode": "MASK", "alphaCutoff": 0.25, "doubleSided": true, "emissiveFactor": [0.5, 0, 0],
            "extensions": layers(),
        }),
    );
    gltf.push("materials", json!({ "extensions": { "KHR_materials_unlit": {} }, "alphaMode": "BLEND" }));
    gltf.json["extensions"] = json!({ "EXT_structural_metadata": {
        "schema": { "classes": { "c": { "properties": { "height": { "type": "SCALAR", "componentType": "FLOAT32" } } } } },
        "propertyTables": [{ "class": "c", "count": 2, "properties": { "height": { "values": heights } } }],
    } });
    gltf.json["asset"]["copyright"] = "Us".into();
    gltf.draw(json!({
        "attributes": { "POSITION": positions, "TEXCOORD_0": uvs, "_FEATURE_ID_0": ids }, "material": 0,
        "extensions": { "EXT_mesh_features": { "featureIds": [
            { "featureCount": 2, "attribute": 0, "propertyTable": 0, "label": "house" },
        ] } },
    }));
    let mesh = gltf.push(
        "meshes",
        json!({ "primitives": [{ "attributes": { "POSITION": positions }, "material": 1, "mode": 0 }] }),
    );
    let node = gltf.push("nodes", json!({ "mesh": mesh, "translation": [0, 3, 0] }));
    gltf.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(node.into());
    (gltf, png)
}

/// Regression: an image that a source has twice was counted twice, and the set that has it once was reported as different.
#[test]
fn equal_images_count_once() {
    let folder = tempfile::tempdir().unwrap();
    let (mut gltf, png) = houses();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let uvs = gltf.floats("VEC2", &[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
    let image = format!("data:image/png;base64,{}", base64::prelude::BASE64_STANDARD.encode(&png));
    let source = gltf.push("images", json!({ "uri": image }));
    let texture = gltf.push("textures", json!({ "source": source, "sampler": 0 }));
    let look = json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": texture }, "metallicFactor": 0 } });
    let material = gltf.push("materials", look);
    let primitive = json!({ "attributes": { "POSITION": positions, "TEXCOORD_0": uvs }, "material": material });
    let mesh = gltf.push("meshes", json!({ "primitives": [primitive] }));
    let node = gltf.push("nodes", json!({ "mesh": mesh }));
    gltf.json["scenes"][0]["nodes"].as_array_mut().unwrap().push(node.into());
    let file = folder.path().join("houses.gltf");
    std::fs::write(&file, gltf.text()).unwrap();
    let converted = converted(&file, &folder.path().join("out"));
    assert_eq!((converted.source.textures, converted.source.triangles), (1, 2));
    assert_eq!(converted.source, converted.written);
}

#[test]
fn images_materials_and_features_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (gltf, png) = houses();
    let file = folder.path().join("houses.gltf");
    std::fs::write(&file, gltf.text()).unwrap();
    let out = folder.path().join("out");
    let converted = converted(&file, &out);
    let counts = &converted.source;
    assert_eq!((counts.triangles, counts.points, counts.textures, counts.texture_pixels), (1, 3, 1, 8));
    assert!(converted.left_out.is_empty(), "{:?}", converted.left_out);
    let root = &tileset(&out)["root"];
    let glb = std::fs::read(out.join(root["content"]["uri"].as_str().unwrap())).unwrap();
    assert!(glb.windows(png.len()).any(|window| window == png), "the file of the image is in the glb as it was");
    let json = glb_json(&out, root);
    let material = &json["materials"][0];
    assert_eq!((&material["alphaMode"], &material["alphaCutoff"]), (&json!("MASK"), &json!(0.25)));
    assert_eq!((&material["doubleSided"], &material["emissiveFactor"]), (&json!(true), &json!([0.5, 0.0, 0.0])));
    let pbr = &material["pbrMetallicRoughness"];
    assert_eq!((&pbr["metallicFactor"], &pbr["roughnessFactor"]), (&json!(0.25), &json!(0.5)));
    assert_eq!(pbr["baseColorFactor"], json!([0.5, 1.0, 1.0, 1.0]));
    assert_eq!(material["extensions"], layers());
    for name in layers().as_object().unwrap().keys() {
        assert!(json["extensionsUsed"].as_array().unwrap().contains(&json!(name)), "{name}");
    }
    let sampler = json!({ "wrapS": 33648, "wrapT": 33071, "magFilter": 9728, "minFilter": 9729 });
    assert_eq!((&json["samplers"][0], &json["asset"]["copyright"]), (&sampler, &json!("Us")));
    assert!(json["materials"][1]["extensions"].get("KHR_materials_unlit").is_some());

    // The features lead to their properties, and the drawables lie where they did.
    let page = |uri: &str| -> Page {
        let options = ReadOptions { keep_features: true, ..ReadOptions::for_root(uri, Limits::default()) };
        let bytes = read_file(uri, &Limits::default()).unwrap();
        decode(Content { uri: uri.into(), bytes, reader_data: None, companions: Vec::new() }, &options).unwrap()
    };
    let written = page(out.join(root["content"]["uri"].as_str().unwrap()).to_str().unwrap());
    let of_vertex = |vertex| {
        let features = written.features(0).unwrap();
        features.at_vertex(vertex).map(|f| (f.label.to_owned(), f.id, f.properties()[0].1.as_f64())).collect::<Vec<_>>()
    };
    assert_eq!(of_vertex(0), [("house".to_owned(), 1, Some(2.5))]);
    assert_eq!(of_vertex(1), [("house".to_owned(), 0, Some(1.5))]);
    let (found, expected) = (written.bounding_sphere(), page(file.to_str().unwrap()).bounding_sphere());
    assert!(found.center.distance(expected.center) < 1e-6 && (found.radius_m - expected.radius_m).abs() < 1e-6);
}

/// Compressed contents hold the same, with every kind of primitive.
#[test]
fn meshopt_keeps_everything() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("houses.gltf");
    std::fs::write(&file, houses().0.text()).unwrap();
    let options = ConvertOptions { meshopt: true, threads: Some(1), ..ConvertOptions::default() };
    let out = folder.path().join("out");
    let counts = converted_with(&file, &out, &options).source;
    assert_eq!((counts.triangles, counts.points, counts.texture_pixels), (1, 3, 8));
    let json = glb_json(&out, &tileset(&out)["root"]);
    assert!(json["extensionsRequired"].as_array().unwrap().contains(&json!("EXT_meshopt_compression")), "{json}");
}

/// Tiles keep volumes, errors, refinement and transforms; a tree of several files becomes one.
#[test]
fn tilesets_keep_their_tree() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.gltf"), houses().0.text()).unwrap();
    let translation = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1];
    let volume = json!({ "box": [0, 0, 0, 9, 0, 0, 0, 9, 0, 0, 0, 9] });
    let child = json!({
        "boundingVolume": volume, "geometricError": 1, "refine": "ADD", "content": { "uri": "a.gltf" },
        "viewerRequestVolume": { "sphere": [0, 0, 0, 50] },
        "children": [{ "boundingVolume": volume, "geometricError": 0, "content": { "uri": "b/more.json" } }],
    });
    let root = json!({
        "boundingVolume": volume, "geometricError": 8, "refine": "REPLACE", "transform": translation,
        "content": { "uri": "a.gltf" }, "children": [child],
    });
    let set = |root| json!({ "asset": { "version": "1.0" }, "geometricError": 20, "root": root }).to_string();
    std::fs::create_dir(folder.path().join("b")).unwrap();
    std::fs::write(folder.path().join("tileset.json"), set(root)).unwrap();
    let more = json!({ "boundingVolume": volume, "geometricError": 0, "content": { "uri": "../a.gltf" } });
    std::fs::write(folder.path().join("b/more.json"), set(more)).unwrap();
    let out = folder.path().join("out");
    assert_eq!(converted(folder.path(), &out).source.levels, [1, 1, 1]);
    let root = &tileset(&out)["root"];
    assert_eq!((&root["geometricError"], &root["refine"]), (&json!(8.0), &json!("REPLACE")));
    assert_eq!(root["transform"], json!(translation.map(f64::from)));
    assert_eq!(root["boundingVolume"]["box"], json!([0, 0, 0, 9, 0, 0, 0, 9, 0, 0, 0, 9].map(f64::from)));
    let child = &root["children"][0];
    assert_eq!(
        (&child["refine"], &child["geometricError"], child.get("transform")),
        (&json!("ADD"), &json!(1.0), None)
    );
    assert_eq!(child["viewerRequestVolume"]["sphere"], json!([0.0, 0.0, 0.0, 50.0]));
    assert_eq!(child["children"][0]["geometricError"], 0.0);
}

/// Height tiles and quantized meshes become meshes that lie where they were drawn.
#[test]
fn heights_and_terrain_become_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let set = kit::tile_sets::small_set(folder.path());
    let heights = folder.path().join("heights");
    let counts = converted(Path::new(&set), &heights).source;
    let cells = 64 * 64 * 2 + 4 * 64 * 2;
    assert_eq!((counts.levels.as_slice(), counts.triangles), (&[1, 4, 16][..], 21 * cells));
    let center = |path: &str| DVec3::from_array(inspect(path, &Limits::default()).unwrap().bounds.center);
    let moved_m = center(&set).distance(center(heights.to_str().unwrap()));
    assert!(moved_m < 100.0, "{moved_m} m");
    assert!(tileset(&heights)["root"]["boundingVolume"].get("region").is_some());

    // The western half has no file: nothing stands for it.
    let terrain = folder.path().join("terrain");
    std::fs::create_dir(&terrain).unwrap();
    kit::quantized::write_set(&terrain, 2, |[level, x, _]| x >= 1 << level, |_, _| 100.0);
    let converted = converted(&terrain, &folder.path().join("from terrain"));
    // Each tile of the earth is a content above its page: the ellipsoid until the file is there.
    assert_eq!(converted.source.levels, [1, 1, 4], "{:?}", converted.left_out);
}

/// Sets of others, as far as they are complete.
#[test]
fn samples_of_3d_tiles_keep_what_they_hold() {
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/samples/3d-tiles");
    if !samples.is_dir() {
        return kit::skip::skipped(format!("no files at {}", samples.display()));
    }
    let folder = tempfile::tempdir().unwrap();
    for (name, contents) in [
        ("SparseImplicitQuadtree", 32),
        ("GpuInstancesMetadata", 1),
        ("ReplaceTileset", 6),
        ("MultipleContents", 2),
        ("TilesetWithRequestVolume", 6),
    ] {
        let converted = converted(&samples.join(name), &folder.path().join(name));
        assert_eq!((converted.failed, converted.source.contents()), (0, contents), "{name}: {:?}", converted.errors);
    }
}
