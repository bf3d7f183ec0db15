//! Implicit tiling: the same tiles are drawn as from an explicit set, with the same volumes and errors.

use std::path::{Path, PathBuf};

use kit::pager::Run;
use serde_json::Value;
use terrane::formats::{SurveyOptions, survey};
use terrane::math::{Geodetic, OrientedBox, WGS84};
use terrane::pager::PagerConfig;
use terrane::scene::SlotState;
use terrane_data_gen::{ContentKind, GenArgs, OutputArgs, Tiling, WorldArgs, WorldPreset, run};

use crate::files::{PLACE, SIDE, each_tile, files_below, from_dem, heights, tiff_float32};

/// The metres by which volumes of explicit sets with trees and rocks are wider than those of implicit ones, which are quarters of
/// each other.
const WIDER_M: f64 = 12.0;

/// The name of each resident tile with the corners of its volume, and the number of leaves.
fn drawn(set: &Path, eye: Geodetic) -> (Vec<(String, OrientedBox)>, usize) {
    let mut run = Run::new(set.to_str().unwrap(), PagerConfig::default());
    run.is_globe = true;
    run.max_sse_px = 1.0;
    run.settle(WGS84.ecef(&eye));
    assert!(run.pager.errors().is_empty(), "{:?}", run.pager.errors());
    let mut tiles = Vec::new();
    for tile in run.scene.tiles() {
        let Some(slot) = run.scene.slot(tile.node).filter(|slot| matches!(slot.state, SlotState::Resident(_))) else {
            continue;
        };
        if slot.uri.ends_with("exr") || slot.uri.ends_with("glb") {
            let name = Path::new(&**slot.uri).strip_prefix(set).unwrap();
            tiles.push((name.to_str().unwrap().to_owned(), tile.bounds));
        }
    }
    tiles.sort_by(|a, b| a.0.cmp(&b.0));
    (tiles, run.stage.leaf_count())
}

/// The errors of all tiles in the tilesets of an explicit set.
fn explicit_errors(set: &Path) -> Vec<f64> {
    let mut errors = Vec::new();
    // The journal of blocks is beside the tilesets.
    let is_tileset = |name: &str| name.ends_with("json") && !name.starts_with('.');
    for (name, bytes) in files_below(set).iter().filter(|(name, _)| is_tileset(name)) {
        let tileset: Value = serde_json::from_slice(bytes).unwrap();
        each_tile(&tileset["root"], None, &mut |tile, _| {
            // A tile that stands for an external tileset is its root.
            let content = tile.get("content").unwrap_or(&tile["contents"][0]);
            if !content["uri"].as_str().unwrap().ends_with("json") {
                errors.push(tile["geometricError"].as_f64().unwrap());
            }
        });
        assert!(!errors.is_empty(), "{name}");
    }
    errors.sort_by(f64::total_cmp);
    errors
}

/// The errors of all tiles in the subtrees of an implicit set.
fn implicit_errors(set: &Path) -> Vec<f64> {
    let mut errors = Vec::new();
    for (_, bytes) in files_below(set).iter().filter(|(name, _)| name.ends_with("subtree")) {
        let length = u64::from_le_bytes(bytes[8..16].try_into().unwrap()) as usize;
        let json: Value = serde_json::from_slice(&bytes[24..24 + length]).unwrap();
        let view = json["propertyTables"][0]["properties"]["geometricError"]["values"].as_u64().unwrap() as usize;
        let number = |name: &str| json["bufferViews"][view][name].as_u64().unwrap() as usize;
        let values = &bytes[24 + length..][number("byteOffset")..][..number("byteLength")];
        errors.extend(values.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)));
    }
    errors.sort_by(f64::total_cmp);
    errors
}

/// Asserts that two sets, with their numbers of tiles, have the same contents and errors.
fn assert_same_tiles(sets: &[(u64, PathBuf); 2]) {
    let options = SurveyOptions { measures: false, ..SurveyOptions::default() };
    let verified = sets.each_ref().map(|(_, set)| {
        let verified = survey(set.to_str().unwrap(), &options, &mut |_| ()).unwrap();
        assert!(verified.failed == 0 && verified.ignored.is_empty(), "{verified:?}");
        verified.contents
    });
    assert_eq!(verified[0], verified[1]);
    let errors = explicit_errors(&sets[0].1);
    assert!(errors.len() as u64 == sets[0].0 && errors == implicit_errors(&sets[1].1));
}

/// Asserts that the same tiles are drawn of two sets, with the same volumes to some metres, and returns their names.
fn assert_drawn_alike(sets: &[(u64, PathBuf); 2], eye: Geodetic, within_m: f64) -> Vec<String> {
    let [explicit, implicit] = sets.each_ref().map(|(_, set)| drawn(set, eye));
    assert!(!explicit.0.is_empty() && explicit.1 > 0);
    if within_m < WIDER_M {
        assert_eq!((explicit.1, explicit.0.len()), (implicit.1, implicit.0.len()), "{eye:?}");
    }
    // A wider volume is nearer, so that more may be drawn of an explicit set.
    for b in &implicit.0 {
        let a = explicit.0.iter().find(|a| a.0 == b.0);
        let a = a.unwrap_or_else(|| panic!("{eye:?}: {b:?} is drawn of the implicit set only"));
        assert!(a.1.center.distance(b.1.center) < within_m, "{a:?} {b:?}");
        assert!(a.1.half_axes.abs_diff_eq(b.1.half_axes, within_m), "{a:?} {b:?}");
    }
    explicit.0.into_iter().map(|(name, _)| name).collect()
}

#[test]
fn implicit_worlds_are_drawn_like_explicit_ones() {
    let folder = tempfile::tempdir().unwrap();
    let (longitude, latitude) = (8f64.to_radians(), 30f64.to_radians());
    let sets = [Tiling::Explicit, Tiling::Implicit].map(|tiling| {
        let args = GenArgs {
            world: WorldArgs {
                world: Some(WorldPreset::Moon),
                center: Some([8.0, 30.0]),
                scatter: true,
                ..WorldArgs::default()
            },
            levels: Some(4),
            size: 3_000.0,
            output: OutputArgs { tiling, ..OutputArgs::default() },
            ..GenArgs::new(folder.path().join(format!("{tiling:?}")))
        };
        (run(&args).unwrap().tiles, args.out)
    });
    assert_same_tiles(&sets);
    let mut rocks = 0;
    for height_m in [-800.0, 1_500.0, 20_000.0] {
        let names = assert_drawn_alike(&sets, Geodetic { longitude, latitude, height_m }, WIDER_M);
        rocks += names.iter().filter(|name| name.ends_with("glb")).count();
    }
    assert!(rocks > 0, "no second contents are seen");
}

#[test]
fn implicit_sets_are_drawn_like_explicit_ones() {
    let folder = tempfile::tempdir().unwrap();
    // Data in a corner only, so that most of seven levels is empty and the tiles on the border of the data are meshes.
    let samples: Vec<f32> = heights()
        .into_iter()
        .enumerate()
        .map(|(k, h)| {
            let [i, j] = [k as u32 % SIDE, k as u32 / SIDE];
            if i < 8 && j + 8 >= SIDE { h } else { -9999.0 }
        })
        .collect();
    let dem = tiff_float32(&samples, Some(PLACE), Some("-9999"));
    for (content, levels) in [(ContentKind::Height, 7), (ContentKind::Mesh, 6)] {
        let sets = [Tiling::Explicit, Tiling::Implicit].map(|tiling| {
            let args = GenArgs {
                content,
                levels: Some(levels),
                output: OutputArgs { tiling, ..OutputArgs::default() },
                out: folder.path().join(format!("{content:?}-{tiling:?}")),
                ..from_dem(folder.path(), "dem.tif", &dem)
            };
            (run(&args).unwrap().tiles, args.out)
        });
        assert_eq!(sets[0].0, sets[1].0);
        assert_same_tiles(&sets);
        let mut finest = 0;
        for height_m in [1_000.0, 40_000.0] {
            let [west, south, east, _] = PLACE.bounds();
            let (longitude, latitude) = (west + 0.15 * (east - west), south + 0.15 * (east - west));
            let explicit = assert_drawn_alike(&sets, Geodetic { longitude, latitude, height_m }, 1e-3);
            finest += explicit.iter().filter(|name| name.starts_with(&format!("{}/", levels - 1))).count();
        }
        assert!(finest > 0, "the finest level is seen");
    }
}
