//! Contents whose buffers and images are files, read as a whole set.

use serde_json::json;
use terrane::fetch::Limits;
use terrane::formats::verify;

use crate::gltf_builder::*;

const TILESET: &str = r#"{"asset":{"version":"1.1"},"geometricError":1,"root":{"geometricError":0,
    "boundingVolume":{"sphere":[0,0,0,9]},"content":{"uri":"tile.gltf"}}}"#;

#[test]
fn whole_sets_read_external_files() {
    let mut gltf = GltfBuilder::new();
    let positions = gltf.floats("VEC3", &TRIANGLE);
    let uvs = gltf.floats("VEC2", &[0.0; 6]);
    gltf.push("images", json!({ "uri": "a.png" }));
    gltf.push("textures", json!({ "source": 0 }));
    gltf.push(
        "materials",
        json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0 } }),
    );
    gltf.json["buffers"] = json!([{ "byteLength": gltf.buffer.len(), "uri": "data/a.bin" }]);
    gltf.draw(json!({ "attributes": { "POSITION": positions, "TEXCOORD_0": uvs }, "material": 0 }));
    let image = png(4, [1, 2, 3]);
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("data")).unwrap();
    for (file, bytes) in [
        ("tileset.json", TILESET.as_bytes()),
        ("tile.gltf", &gltf.text()),
        ("data/a.bin", &gltf.buffer),
        ("a.png", &image),
    ] {
        std::fs::write(folder.path().join(file), bytes).unwrap();
    }
    let source = folder.path().to_str().unwrap();
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    let all_bytes = TILESET.len() + gltf.text().len() + gltf.buffer.len() + image.len();
    assert_eq!((verified.contents, verified.failed, verified.bytes), (1, 0, all_bytes as u64));
    assert!(verified.ignored.is_empty(), "{verified:?}");
    // A missing image is listed, and the rest of the content is read.
    std::fs::remove_file(folder.path().join("a.png")).unwrap();
    let verified = verify(source, &Limits::default(), &mut |_| {}).unwrap();
    assert_eq!((verified.contents, verified.failed), (1, 0));
    assert_eq!(verified.ignored["glTF: external image that is missing"], 1);
}
