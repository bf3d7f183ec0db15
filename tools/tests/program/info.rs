//! `terrane info`: measures, maps, and what services have.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;

fn terrane(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
    command.env_remove("CESIUM_ION_TOKEN").env_remove("GOOGLE_MAPS_API_KEY");
    command.args(args).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Generates a set of three levels from noise.
fn noise(folder: &Path, more: &[&str]) -> PathBuf {
    let set = folder.join("set");
    let out = terrane(&[&["gen", text(&set), "--levels", "3", "--seed", "7"], more].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    set
}

/// Sets of both contents keep their errors, and neighbours have the same edges.
#[test]
fn generated_sets_are_measured_without_problems() {
    for content in ["height", "mesh"] {
        let folder = tempfile::tempdir().unwrap();
        let set = noise(folder.path(), &["--content", content]);
        let out = terrane(&["info", text(&set), "--verify", "--json"]);
        let info: Value = serde_json::from_slice(&out.stdout).unwrap();
        let verified = &info["verified"];
        assert!(out.status.success(), "{content}: {verified:#}");
        assert_eq!(verified["problems"], Value::Array(Vec::new()), "{content}");
        // The heights of the terrain are those of the samples, without the skirts that the volume of the root holds.
        let tileset: Value = serde_json::from_slice(&std::fs::read(set.join("tileset.json")).unwrap()).unwrap();
        let [low, high] = [4, 5].map(|k| info["bounds"]["region"][k].as_f64().unwrap());
        let [lowest, highest] = [4, 5].map(|k| tileset["root"]["boundingVolume"]["region"][k].as_f64().unwrap());
        assert!(
            lowest + 1.0 < low && low < high && high < highest,
            "{content}: {low} to {high}, {lowest} to {highest}"
        );
        let levels = verified["levels"].as_array().unwrap();
        let finest = levels.last().unwrap();
        assert!(finest["edges"].as_u64().unwrap() > 0, "{content}: {finest}");
        let coarser = &levels[levels.len() - 2];
        let measured = coarser["error_to_finest_m"].as_f64().unwrap();
        let declared = coarser["geometric_error_m"][1].as_f64().unwrap();
        assert!(measured > 0.0, "{content}: {coarser}");
        assert!(measured <= declared, "{content}: {coarser}");
    }
}

#[test]
fn measures_are_printed_and_problems_fail() {
    let folder = tempfile::tempdir().unwrap();
    let set = noise(folder.path(), &[]);
    let out = terrane(&["info", text(&set), "--verify"]);
    let said = String::from_utf8(out.stdout).unwrap();
    assert!(out.status.success(), "{said}");
    for part in ["heights m", "to finest m", "same level m", "skirts m", "JPEG 256 x 256"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let file = set.join("tileset.json");
    let mut json: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    json["asset"]["extras"]["terrane"]["level_errors_m"] = serde_json::json!([0.2, 0.1, 0.0]);
    // Without errors at their corners, tiles have those of their level.
    std::fs::write(&file, json.to_string().replace("corner_errors_m", "left_out")).unwrap();
    let out = terrane(&["info", text(&set), "--verify"]);
    let said = String::from_utf8(out.stdout).unwrap();
    assert_eq!(out.status.code(), Some(1));
    assert!(said.contains("problem  geometricError smaller than the measured error: 5 tiles, first"), "{said}");
    assert!(String::from_utf8_lossy(&out.stderr).contains("5 problems"), "{:?}", out.stderr);
}

#[test]
fn maps_show_the_finest_level_at_each_place() {
    let folder = tempfile::tempdir().unwrap();
    let set = noise(folder.path(), &[]);
    // A quarter of the finest level is missing in the tree.
    let file = set.join("tileset.json");
    let mut json: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    json["root"]["children"][0]["children"] = Value::Array(Vec::new());
    std::fs::write(&file, json.to_string()).unwrap();
    let map = folder.path().join("map.png");
    let out = terrane(&["info", text(&set), "--json", "--map", text(&map)]);
    assert!(out.status.success(), "{out:?}");
    let info: Value = serde_json::from_slice(&out.stdout).unwrap();
    let legend = info["map"]["legend"].as_array().unwrap();
    let names: Vec<&str> = legend.iter().map(|swatch| swatch["text"].as_str().unwrap()).collect();
    assert_eq!(names, ["1", "2"], "{info}");
    let picture = image::open(&map).unwrap().into_rgb8();
    let (width, height) = picture.dimensions();
    assert_eq!(info["map"]["size"], serde_json::json!([width, height]));
    assert!(width.max(height) <= 1024 + 64);
    let count = |swatch: &Value| {
        let color = u32::from_str_radix(swatch["color"].as_str().unwrap().trim_start_matches('#'), 16).unwrap();
        let [_, r, g, b] = color.to_be_bytes();
        picture.pixels().filter(|pixel| pixel.0 == [r, g, b]).count() as f64
    };
    let share = count(&legend[0]) / (count(&legend[0]) + count(&legend[1]));
    assert!((share - 0.25).abs() < 0.01, "{share}");
    for of in ["error", "bytes"] {
        let out = terrane(&["info", text(&set), "--map", text(&map), "--map-of", of]);
        assert!(out.status.success() && String::from_utf8_lossy(&out.stdout).contains("map      "), "{out:?}");
    }
    assert_eq!(terrane(&["info", text(&set), "--map", text(&map), "--map-of", "problems"]).status.code(), Some(2));
}

#[test]
fn templates_are_described_without_their_secrets() {
    let template = "https://{s}.example.org/{z}/{x}/{y}.png?key=hidden,subdomains=a/b,levels=2-9,credit=Survey";
    let out = terrane(&["info", template]);
    let said = String::from_utf8(out.stdout).unwrap();
    assert!(out.status.success(), "{said}");
    for part in ["raster overlay (template)", "Web Mercator", "2 to 9", "256 x 256", "a, b", "credit   Survey"] {
        assert!(said.contains(part), "{part}: {said}");
    }
    assert!(!said.contains("hidden"), "{said}");
    let out = terrane(&["info", "https://example.org/{z}/{x}/{q}.png"]);
    assert_eq!(out.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&out.stderr).contains("unknown placeholder"), "{out:?}");
}
