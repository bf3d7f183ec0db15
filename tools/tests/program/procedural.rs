//! `terrane serve --procedural`: a planet whose tiles are made when they are requested.

use std::path::Path;
use std::process::Command;

use crate::serve::served::Server;
use kit::skip::no_adapter;
use serde_json::Value;
use terrane::math::MARS;
use terrane_data_gen::{ContentKind, GenArgs, TileKey, World, WorldPreset, WorldSet};

#[test]
fn tiles_are_those_of_the_library_and_other_paths_are_missing() {
    let server = Server::start(Path::new(""), &["--procedural", "canyon", "--seed", "4"]);
    let set = WorldSet::globe(World::new(WorldPreset::Canyon, 4), 22);
    let key = TileKey { level: 17, x: 70_000, y: 90_000 };
    let tile = set.tile(key).unwrap();
    let (status, head, body) = server.ask("GET", "/17/70000/90000.exr", "");
    assert!(status == 200 && body == tile.file("exr").unwrap(), "{head}");
    let jpeg = tile.file("jpg").unwrap();
    let (status, head, body) = server.ask("GET", "/17/70000/90000.jpg", "");
    assert!(status == 200 && body == jpeg && head.contains("image/jpeg"), "{head}");
    let (_, head, body) = server.ask("GET", "/17/70000/90000.jpg", "Range: bytes=2-5\r\n");
    assert!(head.contains("206") && body == jpeg[2..6], "{head}");
    let tag = head.lines().find_map(|l| l.strip_prefix("ETag: ")).unwrap();
    assert_eq!(server.ask("GET", "/17/70000/90000.jpg", &format!("If-None-Match: {tag}\r\n")).0, 304);
    let (_, _, body) = server.ask("GET", "/tileset.json", "");
    let tileset: Value = serde_json::from_slice(&body).unwrap();
    assert_eq!(tileset["root"]["content"]["uri"], "0/0/0.exr");
    for path in
        ["/", "/22/0/0.exr", "/1/2/0.exr", "/1/01/0.exr", "/2/0/0.json", "/0/0/0.json", "/1/0/0.png", "/1/0.exr"]
    {
        assert_eq!(server.ask("GET", path, "").0, 404, "{path}");
    }
}

#[test]
fn planet_with_implicit_tiling_has_subtrees_instead_of_tilesets() {
    let server = Server::start(Path::new(""), &["--procedural", "canyon", "--seed", "4", "--tiling", "implicit"]);
    let set = WorldSet::globe(World::new(WorldPreset::Canyon, 4), 22);
    let (_, _, body) = server.ask("GET", "/tileset.json", "");
    let tileset: Value = serde_json::from_slice(&body).unwrap();
    assert_eq!(tileset["root"]["implicitTiling"]["availableLevels"], 22, "{tileset}");
    assert_eq!(tileset["root"]["content"]["uri"], "{level}/{x}/{y}.exr");
    let (status, _, body) = server.ask("GET", "/subtrees/15/700/900.subtree", "");
    let (_, expected) = set.subtree(TileKey { level: 15, x: 700, y: 900 }).unwrap();
    assert!(status == 200 && body == expected);
    for path in ["/subtrees/3/0/0.subtree", "/15/700/900.subtree", "/subtrees/15/700/900.exr", "/3/0/0.json"] {
        assert_eq!(server.ask("GET", path, "").0, 404, "{path}");
    }
}

#[test]
fn rocks_are_served_on_fine_levels_with_scatter() {
    let server = Server::start(Path::new(""), &["--procedural", "moon", "--scatter"]);
    let set = WorldSet::globe(World::new(WorldPreset::Moon, 1), 22).with_scatter();
    let key = TileKey { level: 14, x: 9_000, y: 9_000 };
    let tile = set.tile(key).unwrap();
    let rocks = tile.file("glb").unwrap();
    let (status, head, body) = server.ask("GET", "/14/9000/9000.glb", "");
    assert!(status == 200 && body == rocks && head.contains("model/gltf-binary"), "{head}");
    assert_eq!(server.ask("GET", "/12/2000/2000.glb", "").0, 404, "cells of 76 m have none");
}

#[test]
fn planet_lies_on_the_body_that_is_named() {
    let server = Server::start(Path::new(""), &["--procedural", "mars", "--body", "mars"]);
    let (_, _, body) = server.ask("GET", "/tileset.json", "");
    let tileset: Value = serde_json::from_slice(&body).unwrap();
    assert_eq!(tileset["extensions"]["3DTILES_ellipsoid"]["radii"][2], 3_376_200.0, "{tileset}");
    let tile =
        WorldSet::globe(World::on(WorldPreset::Mars, 1, MARS), 22).tile(TileKey { level: 17, x: 70_000, y: 90_000 });
    let (status, _, body) = server.ask("GET", "/17/70000/90000.exr", "");
    assert!(status == 200 && body == tile.unwrap().file("exr").unwrap());
}

#[test]
fn meshes_of_a_planet_are_those_of_the_library() {
    let options = ["--procedural", "moon", "--scatter", "--content", "mesh"];
    let server = Server::start(Path::new(""), &options);
    let form = GenArgs { content: ContentKind::Mesh, ..GenArgs::new("") };
    let set = WorldSet::globe(World::new(WorldPreset::Moon, 1), 22).with_form_of(&form).with_scatter();
    let tile = set.tile(TileKey { level: 14, x: 9_000, y: 9_000 }).unwrap();
    for extension in ["glb", "scatter.glb"] {
        let (status, head, body) = server.ask("GET", &format!("/14/9000/9000.{extension}"), "");
        assert!(status == 200 && body == tile.file(extension).unwrap() && head.contains("model/gltf-binary"), "{head}");
    }
    let (_, _, body) = server.ask("GET", "/12/2250/2250.json", "");
    let tileset: Value = serde_json::from_slice(&body).unwrap();
    assert_eq!(tileset["root"]["content"]["uri"], "../../12/2250/2250.glb");
    for path in ["/14/9000/9000.exr", "/14/9000/9000.jpg", "/12/2250/2250.scatter.glb", "/14/9000.scatter/9000.glb"] {
        assert_eq!(server.ask("GET", path, "").0, 404, "{path}");
    }
}

#[test]
fn planet_is_flown_over() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (report, picture) = (folder.path().join("report.json"), folder.path().join("picture.png"));
    let server = Server::start(Path::new(""), &["--procedural", "moon"]);
    let flown = Command::new(env!("CARGO_BIN_EXE_terrane"))
        .args(["fly", &format!("{}tileset.json", server.url), "--offscreen", "--settle", "--size", "96x64", "--report"])
        .arg(&report)
        .arg("--screenshot")
        .arg(&picture)
        .output()
        .unwrap();
    let errors = String::from_utf8_lossy(&flown.stderr);
    assert!(flown.status.success(), "{errors}");
    assert!(!errors.contains("failed"), "{errors}");
    let image = image::open(&picture).unwrap().to_rgb8();
    // The moon is grey, and fills the middle of the picture.
    let [r, g, b] = image.get_pixel(48, 32).0;
    assert!(r > 20 && r.abs_diff(g) < 40 && g.abs_diff(b) < 40, "{r} {g} {b}");
}
