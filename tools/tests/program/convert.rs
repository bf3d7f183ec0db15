//! `terrane convert`, `merge` and `crop`.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn terrane(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terrane")).args(args).output().unwrap()
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn sets_are_converted_merged_and_cropped() {
    let folder = tempfile::tempdir().unwrap();
    let (quadtree, out) = (folder.path().join("quadtree"), folder.path().join("out"));
    std::fs::create_dir(&quadtree).unwrap();
    kit::tile_sets::write_quadtree(&quadtree);
    let done = terrane(&["convert", text(&quadtree), text(&out), "--json"]);
    assert!(done.status.success(), "{done:?}");
    let report: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!((&report["source"], &report["source"]["triangles"]), (&report["written"], &341.into()));
    assert_eq!(report["files"], 342);

    // An existing set is only replaced on demand, and never one that holds the source.
    let again = terrane(&["convert", text(&quadtree), text(&out)]);
    assert_eq!(again.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&again.stderr).contains("--overwrite replaces it"), "{again:?}");
    let own = terrane(&["convert", text(&out), text(&out), "--overwrite"]);
    assert!(String::from_utf8_lossy(&own.stderr).contains("would be replaced"), "{own:?}");

    // A tile that is missing is named, and the others replace the set.
    std::fs::remove_file(quadtree.join("4_0_0.glb")).unwrap();
    let broken = terrane(&["convert", text(&quadtree), text(&out), "--overwrite", "--meshopt"]);
    let said = String::from_utf8_lossy(&broken.stdout).into_owned();
    assert_eq!(broken.status.code(), Some(1), "{broken:?}");
    assert!(
        said.contains("4_0_0.glb: not found") && said.contains(&format!("contents  {:>14} {:>14}", 340, 340)),
        "{said}"
    );
    let names = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(names, 2, "no temporary folder is left");

    let merged = folder.path().join("merged");
    let done = terrane(&["merge", text(&merged), text(&out), text(&out.join("tileset.json"))]);
    assert!(done.status.success(), "{done:?}");
    let info = terrane(&["info", text(&merged), "--verify", "--json"]);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!((&info["verified"]["contents"], &info["verified"]["failed"]), (&680.into(), &0.into()), "{info}");
    let refused = terrane(&["merge", text(&folder.path().join("x")), text(folder.path())]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("the folder has no tileset.json"), "{refused:?}");
    let model = terrane(&["merge", text(&folder.path().join("x")), text(&quadtree.join("0_0_0.glb"))]);
    assert!(String::from_utf8_lossy(&model.stderr).contains("no 3D Tiles set in a folder"), "{model:?}");
    // Regression: a pipe without a writer had no end.
    #[cfg(target_os = "linux")]
    {
        let pipe = folder.path().join("pipe");
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, mode).unwrap();
        for command in [&["info"][..], &["merge", text(&folder.path().join("x"))]] {
            let refused = terrane(&[command, &[text(&pipe)]].concat());
            assert!(String::from_utf8_lossy(&refused.stderr).contains("pipe: is not a regular file"), "{refused:?}");
        }
    }

    // A quarter of a set in a local frame, without its edges: the root, a quarter of each level, and no neighbour.
    let cropped = folder.path().join("cropped");
    let half = kit::tile_sets::WORLD_M / 2.0;
    let metres = format!("--metres=1,1,{},{}", half - 1.0, half - 1.0);
    let done = terrane(&["crop", text(&quadtree), text(&cropped), &metres, "--json"]);
    assert!(String::from_utf8_lossy(&done.stderr).contains("1 could not be read"), "one is missing: {done:?}");
    let report: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(report["written"]["levels"], serde_json::json!([1, 1, 4, 16, 63]), "{report}");
    std::fs::remove_dir_all(&cropped).unwrap();
    let bad = terrane(&["crop", text(&quadtree), text(&cropped), "--metres=1,1,0,0"]);
    assert_eq!(bad.status.code(), Some(2), "{bad:?}");

    // Nothing of a set in a local frame is over the region.
    let done = terrane(&["crop", text(&out), text(&cropped), "--region=7,46,8,47"]);
    assert_eq!(done.status.code(), Some(1), "{done:?}");
    assert!(
        !cropped.exists() && String::from_utf8_lossy(&done.stderr).contains("none overlaps the given part"),
        "{done:?}"
    );
}

/// The body of the parts is that of the whole; parts of different bodies have no place in common.
#[test]
fn sets_of_one_body_are_merged_and_others_refused() {
    let folder = tempfile::tempdir().unwrap();
    let set = |name: &str, body: &str| {
        let set = folder.path().join(name);
        std::fs::create_dir(&set).unwrap();
        kit::bodies::write_set(&set.join("tileset.json"), body, [0.3, 0.5, 0.31, 0.51, 0.0, 100.0], &[]);
        set
    };
    let (near, far, earth) = (set("near", kit::bodies::MOON), set("far", kit::bodies::MOON), set("earth", ""));
    let out = folder.path().join("moon");
    let merged = terrane(&["merge", text(&out), text(&near), text(&far)]);
    assert!(merged.status.success(), "{merged:?}");
    let info = terrane(&["info", text(&out), "--json"]);
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    let radii_m = [1_737_400.0; 3];
    let moon = serde_json::json!({ "name": "Moon", "radii_m": radii_m });
    assert_eq!((&info["body"], &info["tiles"]), (&moon, &5.into()), "{info}");
    let said = String::from_utf8(terrane(&["info", text(&out)]).stdout).unwrap();
    assert!(said.contains("body     Moon, radii 1737400 1737400 1737400 m"), "{said}");
    let mixed = terrane(&["merge", text(&folder.path().join("mixed")), text(&near), text(&earth)]);
    let said = String::from_utf8_lossy(&mixed.stderr).into_owned();
    assert_eq!(mixed.status.code(), Some(1));
    assert!(said.contains("near and ") && said.contains("different bodies: Moon, radii"), "{said}");
    assert!(said.contains("and the earth"), "{said}");
}
