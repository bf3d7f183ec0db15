//! Real 3D Tiles, drawn and compared with CesiumJS from the same view: triangles, points, and the covered share of the
//! image. The files are beside a developer's checkout; without them the test is skipped with a message.

use std::path::Path;
use std::process::Command;

use kit::skip::{no_adapter, skipped};
use serde_json::Value;

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
        assert!(out.status.success(), "{file}: {said}");
        let report: Value = serde_json::from_slice(&std::fs::read(&report_file).unwrap()).unwrap();
        let (ours, cesium) = (&report["settled"], &case["cesium"]);
        let count = |v: &Value| v.as_u64().unwrap();
        // CesiumJS counts the triangles of one instance.
        let instances = if file.contains("GpuInstances") { 10 } else { 1 };
        assert_eq!(count(&ours["triangles"]), instances * count(&cesium["tri"]), "{file}: triangles");
        assert_eq!(count(&ours["points"]), count(&cesium["pts"]), "{file}: points");
        let (own, other) = (ours["coverage"].as_f64().unwrap(), cesium["cov"].as_f64().unwrap());
        assert!((own - other).abs() < 0.001, "{file}: covers {own}, in CesiumJS {other}");
        std::fs::remove_file(&report_file).unwrap();
        compared += 1;
    }
    assert!(compared >= 17, "{compared} tile sets were compared");
}
