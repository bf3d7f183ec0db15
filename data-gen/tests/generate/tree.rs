//! Tests the generated tree and what `--overwrite` replaces.

use std::fs;

use crate::files::{each_tile, files_below, region, tileset};
use terrane_data_gen::{ContentKind, GenArgs, run};

fn small(out: std::path::PathBuf) -> GenArgs {
    GenArgs { levels: Some(3), size: 20_000.0, jobs: Some(1), ..GenArgs::new(out) }
}

#[test]
fn a_failed_run_keeps_the_existing_set() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    run(&GenArgs { levels: Some(1), ..small(out.clone()) }).unwrap();
    let before = files_below(&out);
    let args = GenArgs { overwrite: true, dem: vec![folder.path().join("none.tif")], ..small(out.clone()) };
    run(&args).unwrap_err();
    assert!(files_below(&out) == before);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

/// Only tile sets are replaced, and only if they contain none of the source files.
#[test]
fn only_tile_sets_without_sources_are_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("notes");
    fs::create_dir_all(out.join("below")).unwrap();
    fs::write(out.join("notes.txt"), "mine").unwrap();
    for place in [out.clone(), out.join("below/..")] {
        run(&GenArgs { levels: Some(1), overwrite: true, ..small(place) }).unwrap_err();
        assert_eq!(fs::read_to_string(out.join("notes.txt")).unwrap(), "mine");
    }
    let set = folder.path().join("set");
    run(&GenArgs { levels: Some(1), ..small(set.clone()) }).unwrap();
    let inside = set.join("elevation.tif");
    fs::write(&inside, "a model").unwrap();
    run(&GenArgs { dem: vec![inside.clone()], overwrite: true, ..small(set.clone()) }).unwrap_err();
    assert!(inside.is_file());
    run(&GenArgs { levels: Some(1), overwrite: true, ..small(set.join("../set")) }).unwrap();
    assert!(set.join("tileset.json").is_file() && !inside.exists());
}

#[test]
fn errors_decrease_and_volumes_are_nested() {
    let folder = tempfile::tempdir().unwrap();
    for content in [ContentKind::Height, ContentKind::Mesh] {
        let args = GenArgs { content, overwrite: true, ..small(folder.path().join("set")) };
        run(&args).unwrap();
        let set = tileset(&args.out);
        let error = |tile: &serde_json::Value| tile["geometricError"].as_f64().unwrap();
        assert!(error(&set) >= error(&set["root"]));
        let mut tiles = 0;
        each_tile(&set["root"], None, &mut |tile, parent| {
            tiles += 1;
            assert!(args.out.join(tile["content"]["uri"].as_str().unwrap()).is_file());
            if tile["children"].is_null() {
                // Vertices of meshes are rounded to 65,535 steps, and their triangles deviate from the grid; heights are exact.
                let is_mesh = content == ContentKind::Mesh;
                assert!(if is_mesh { error(tile) > 0.01 } else { error(tile) == 0.0 }, "{}", error(tile));
            }
            let own = region(tile);
            assert!(own[0] < own[2] && own[1] < own[3] && own[4] < own[5], "{own:?}");
            let Some(parent) = parent else { return };
            assert!(error(parent) > error(tile), "{} not above {}", error(parent), error(tile));
            let outer = region(parent);
            for k in 0..2 {
                assert!(own[k] >= outer[k] - 1e-12 && own[k + 2] <= outer[k + 2] + 1e-12, "{own:?} in {outer:?}");
            }
            assert!(own[5] <= outer[5]);
        });
        assert_eq!(tiles, 21);
    }
}
