//! Real 3D Tiles, drawn and compared with CesiumJS from the same view: triangles, points, and the covered share of the
//! image. The files are beside a developer's checkout; without them the test is skipped with a message.

use std::path::Path;
use std::process::Command;

use kit::skip::{no_adapter, skipped};
use serde_json::Value;

/// Tile sets with unsupported features, and the words that their error must contain.
const REFUSED: &[(&str, &str)] = &[
    ("Compressed/balloon_ktx2.json", "KHR_texture_basisu"),
    ("Compressed/box_draco.json", "KHR_draco_mesh_compression"),
    ("Compressed/box_meshopt.json", "EXT_meshopt_compression"),
    ("GpuInstancesMetadata/tileset.json", "EXT_mesh_gpu_instancing"),
    ("ImplicitTileset/tileset_1.0.json", "3DTILES_implicit_tiling"),
    ("ImplicitTileset/tileset_1.1.json", "implicit tiling"),
    ("SparseImplicitQuadtree/tileset.json", "implicit tiling"),
];

#[test]
fn sample_tile_sets_are_drawn_like_in_cesium() {
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/samples/3d-tiles");
    let Ok(text) = std::fs::read(samples.join("expected.json")) else {
        return skipped(format!("no sample tile sets at {}", samples.display()));
    };
    if no_adapter() {
        return;
    }
    let expected: Value = serde_json::from_slice(&text).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let report_file = folder.path().join("report.json");
    let mut compared = 0;
    for case in expected["cases"].as_array().unwrap() {
        let file = case["file"].as_str().unwrap();
        let out = Command::new(env!("CARGO_BIN_EXE_terrane"))
            .args(["fly", samples.join(file).to_str().unwrap(), "--offscreen", "--settle", "--sse", "1"])
            .args(["--size", "640x360", "--background", "000000", "--report", report_file.to_str().unwrap()])
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        if let Some((_, why)) = REFUSED.iter().find(|(name, _)| *name == file) {
            let report = std::fs::read_to_string(&report_file).unwrap_or_default();
            assert!(said.contains(why) || report.contains(why), "{file} is refused by name: {said} {report}");
            let _ = std::fs::remove_file(&report_file);
            continue;
        }
        assert!(out.status.success(), "{file}: {said}");
        let report: Value = serde_json::from_slice(&std::fs::read(&report_file).unwrap()).unwrap();
        let (ours, cesium) = (&report["settled"], &case["cesium"]);
        let count = |v: &Value| v.as_u64().unwrap();
        assert_eq!(count(&ours["triangles"]), count(&cesium["tri"]), "{file}: triangles");
        assert_eq!(count(&ours["points"]), count(&cesium["pts"]), "{file}: points");
        let (own, other) = (ours["coverage"].as_f64().unwrap(), cesium["cov"].as_f64().unwrap());
        assert!((own - other).abs() < 0.001, "{file}: covers {own}, in CesiumJS {other}");
        std::fs::remove_file(&report_file).unwrap();
        compared += 1;
    }
    assert!(compared >= 10, "{compared} tile sets were compared");
}
