//! Worlds as meshes: tiles that are computed alone, errors, tilings, and the forms of files.

use std::path::Path;

use serde_json::Value;
use terrane::fetch::Limits;
use terrane::formats::{Verified, verify};
use terrane_data_gen::{
    ArchiveFormat, Color, ContentKind, GenArgs, OutputArgs, TextureFormat, TileArgs, TileKey, Tiling, Triangles, World,
    WorldArgs, WorldPreset, WorldSet, run,
};

use crate::files::{each_tile, files_below, region, tileset};

fn args(out: &Path, preset: WorldPreset, size: f64, levels: u32) -> GenArgs {
    let world = WorldArgs { world: Some(preset), ..WorldArgs::default() };
    GenArgs { world, content: ContentKind::Mesh, size, levels: Some(levels), ..GenArgs::new(out) }
}

fn verified(set: &Path) -> Verified {
    verify(&set.to_string_lossy(), &Limits::default(), &mut |_| ()).unwrap()
}

/// Returns the JSON of a glb.
fn json_of(glb: &[u8]) -> Value {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&glb[20..20 + length]).unwrap()
}

/// The errors of meshes are measured against the finest tiles of the set, so that none is understated.
#[test]
fn meshes_have_measured_errors_and_the_bytes_of_tiles_computed_alone() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let args = args(&out, WorldPreset::Islands, 40_000.0, 3);
    let summary = run(&args).unwrap();
    assert_eq!((summary.tiles, summary.levels), (21, 3));
    let found = verified(&out);
    assert_eq!((found.contents, found.failed, found.ignored.len()), (21, 0, 0), "{found:?}");
    assert!(found.problems.is_empty(), "{:?}", found.problems);
    let world = World::new(WorldPreset::Islands, 1);
    let place = world.place(40_000.0);
    let set = WorldSet::square(world, place, 40_000.0, 3).with_form_of(&args);
    let errors_m = set.level_errors_m();
    for level in &found.levels {
        // Errors include that of the finest level, which the set does not show, and how far triangles are from the grid.
        let ([_, declared_m], measured_m) = (level.geometric_error_m.unwrap(), level.error_to_finest_m.unwrap_or(0.0));
        let triangles_m = if level.level == 0 { errors_m[0] } else { 0.5 * errors_m[level.level as usize - 1] };
        assert!(declared_m < measured_m + errors_m[2] + triangles_m + 1.0, "{level:?} {errors_m:?}");
    }
    for key in [TileKey::ROOT, TileKey { level: 1, x: 0, y: 1 }, TileKey { level: 2, x: 3, y: 0 }] {
        let tile = set.tile(key).unwrap();
        let file = std::fs::read(out.join(format!("{}/{}/{}.glb", key.level, key.x, key.y))).unwrap();
        assert!(file == tile.file("glb").unwrap() && tile.files.len() == 1, "{key:?}");
    }
    // Volumes that are computed alone contain the measured ones.
    let alone: Value = serde_json::from_str(&set.tileset(TileKey::ROOT).unwrap()).unwrap();
    let written = tileset(&out);
    let (alone_m, written_m) = (region(&alone["root"]), region(&written["root"]));
    assert!(alone_m[4] <= written_m[4] && written_m[5] <= alone_m[5], "{alone_m:?} {written_m:?}");
    assert!(written["asset"]["extras"].is_null(), "no extras of height sets");
    each_tile(&written["root"], None, &mut |tile, parent| {
        let Some(parent) = parent else { return };
        let error_m = |tile: &Value| tile["geometricError"].as_f64().unwrap();
        assert!(error_m(parent) >= error_m(tile));
        let (own, outer) = (region(tile), region(parent));
        assert!(own[4] >= outer[4] && own[5] <= outer[5], "{own:?} {outer:?}");
    });
}

#[test]
fn meshes_do_not_depend_on_threads_and_tilings() {
    let folder = tempfile::tempdir().unwrap();
    let make = |name: &str, jobs: usize, tiling: Tiling| {
        let out = folder.path().join(name);
        let mut args = args(&out, WorldPreset::Moon, 2_000.0, 2);
        args.world.scatter = true;
        let output = OutputArgs { tiling, ..OutputArgs::default() };
        run(&GenArgs { jobs: Some(jobs), output, color: Color::None, ..args }).unwrap();
        let found = verified(&out);
        assert_eq!(found.failed, 0, "{found:?}");
        // Rocks at an edge reach over it, and the volumes of implicit tilings are quarters of each other.
        assert!(tiling == Tiling::Implicit || found.problems.is_empty(), "{:?}", found.problems);
        files_below(&out)
    };
    let (one, three) = (make("a", 1, Tiling::Explicit), make("b", 3, Tiling::Explicit));
    assert!(one == three);
    let implicit = make("c", 2, Tiling::Implicit);
    for (name, content) in one.iter().filter(|(name, _)| name.ends_with(".glb")) {
        assert!(implicit.get(name) == Some(content), "{name}");
    }
    let root: Value = serde_json::from_slice(&implicit["tileset.json"]).unwrap();
    assert_eq!(root["root"]["contents"][1]["uri"], "{level}/{x}/{y}.scatter.glb");
    let rocks = json_of(&one["1/0/1.scatter.glb"]);
    assert_eq!(rocks["extensionsUsed"][0], "EXT_mesh_gpu_instancing", "{rocks}");
}

#[test]
fn meshes_of_worlds_have_the_forms_of_other_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let make = |name: &str, change: &dyn Fn(&mut GenArgs)| {
        let mut args = args(&folder.path().join(name), WorldPreset::Alps, 20_000.0, 1);
        change(&mut args);
        run(&args).unwrap();
        let glb = std::fs::read(args.out.join("0/0/0.glb")).unwrap();
        (json_of(&glb), glb.len())
    };
    let count = |json: &Value| {
        json["accessors"][json["meshes"][0]["primitives"][0]["indices"].as_u64().unwrap() as usize]["count"]
            .as_u64()
            .unwrap()
    };
    let uses = |json: &Value, name: &str| json["extensionsUsed"].to_string().contains(name);
    let (tin, tin_bytes) = make("tin", &|_| ());
    assert!(uses(&tin, "KHR_mesh_quantization") && uses(&tin, "EXT_meshopt_compression"), "{tin}");
    assert_eq!(tin["images"][0]["mimeType"], "image/jpeg");
    // The mesh has its place on the earth.
    assert_eq!(tin["nodes"][0]["matrix"].as_array().unwrap().len(), 16);
    let (grid, _) = make("grid", &|args| args.tiles.triangles = Triangles::Grid);
    assert_eq!(count(&grid), 3 * (2 * 64 * 64 + 2 * 4 * 64));
    assert!(count(&tin) < count(&grid), "{} {}", count(&tin), count(&grid));
    let (floats, _) = make("floats", &|args| args.float_vertices = true);
    assert!(floats["extensionsUsed"].is_null(), "{floats}");
    let (plain, plain_bytes) = make("plain", &|args| args.tiles.no_meshopt = true);
    assert!(!uses(&plain, "meshopt") && tin_bytes < plain_bytes, "{tin_bytes} {plain_bytes}");
    let (webp, _) = make("webp", &|args| args.tiles.texture = TextureFormat::Webp);
    assert_eq!((webp["images"][0]["mimeType"].as_str(), uses(&webp, "EXT_texture_webp")), (Some("image/webp"), true));
    let (bare, _) = make("bare", &|args| {
        args.color = Color::None;
        args.tiles.normal_maps = true;
    });
    assert_eq!(bare["images"].as_array().unwrap().len(), 1, "the normal map");
    assert!(bare["materials"][0]["normalTexture"].is_object(), "{bare}");
}

/// The sea is smooth, and the land is rough.
#[test]
fn water_of_meshes_is_smooth() {
    let pbr = |center: [f64; 2], size: f64| {
        let world = World::new(WorldPreset::Islands, 1);
        let form = GenArgs { content: ContentKind::Mesh, ..GenArgs::new("") };
        let set = WorldSet::square(world, center, size, 1).with_form_of(&form);
        let glb = set.tile(TileKey::ROOT).unwrap();
        let json = json_of(glb.file("glb").unwrap());
        json["materials"][0]["pbrMetallicRoughness"].clone()
    };
    let place = World::new(WorldPreset::Islands, 1).place(40_000.0);
    let coast = pbr(place, 40_000.0);
    assert!(coast["roughnessFactor"] == 1.0 && coast["metallicRoughnessTexture"]["index"] == 1, "{coast}");
    let sides = (0..40).map(|k| pbr([place[0] + 0.01 * f64::from(k), place[1]], 500.0));
    let sea = sides.filter(|pbr| pbr["metallicRoughnessTexture"].is_null()).find(|pbr| pbr["roughnessFactor"] != 1.0);
    assert!(sea.is_some_and(|sea| (sea["roughnessFactor"].as_f64().unwrap() - 0.2).abs() < 1e-6));
}

#[test]
fn images_of_worlds_of_heights_have_the_format_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let make = |name: &str, change: &dyn Fn(&mut GenArgs)| {
        let mut args = args(&folder.path().join(name), WorldPreset::Moon, 20_000.0, 1);
        args.content = ContentKind::Height;
        change(&mut args);
        run(&args).unwrap();
        assert_eq!(verified(&args.out).failed, 0);
        (files_below(&args.out).into_keys().collect::<Vec<_>>(), tileset(&args.out))
    };
    let (files, set) = make("png", &|args| args.tiles.texture = TextureFormat::Png);
    assert_eq!(
        (files.len(), set["root"]["extras"]["terrane"]["imagery"].as_str()),
        (3, Some("0/0/0.png")),
        "{files:?}"
    );
    let (files, set) = make("bare", &|args| args.color = Color::None);
    assert_eq!((files.len(), set["root"]["extras"]["terrane"]["imagery"].is_null()), (2, true), "{files:?}");
}

#[test]
fn meshes_of_worlds_are_archived_and_packed_and_some_options_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (name, archive) in [("a.3tz", ArchiveFormat::ThreeTz), ("a.terrane", ArchiveFormat::Packed)] {
        let args = args(&folder.path().join(name), WorldPreset::Moon, 20_000.0, 1);
        let output = OutputArgs { archive: Some(archive), ..OutputArgs::default() };
        let args = GenArgs { output, color: Color::None, ..args };
        run(&args).unwrap();
        let found = verified(&args.out);
        assert_eq!((found.contents, found.failed, found.problems.len()), (1, 0, 0), "{found:?}");
        let mut scattered = GenArgs { overwrite: true, size: 1_000.0, ..args };
        scattered.world.scatter = true;
        run(&scattered).unwrap();
        let found = verified(&scattered.out);
        assert_eq!((found.contents, found.failed, found.problems.len()), (2, 0, 0), "{found:?}");
    }
    let heights = |tiles: TileArgs| GenArgs {
        tiles,
        content: ContentKind::Height,
        ..args(&folder.path().join("b"), WorldPreset::Moon, 20_000.0, 1)
    };
    for (tiles, part) in [
        (TileArgs { no_meshopt: true, ..TileArgs::default() }, "--no-meshopt"),
        (TileArgs { triangles: Triangles::Grid, ..TileArgs::default() }, "--mesh"),
        (TileArgs { normal_maps: true, ..TileArgs::default() }, "--normal-maps"),
    ] {
        let error = run(&heights(tiles)).unwrap_err().to_string();
        assert!(error.contains(part) && error.contains("--content mesh"), "{error}");
    }
}

/// Terrain for globes samples a world on its own tiling.
#[test]
fn worlds_are_terrain_for_globes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let world = WorldArgs { world: Some(WorldPreset::Moon), center: Some([8.0, 30.0]), ..WorldArgs::default() };
    let content = ContentKind::QuantizedMesh;
    let args = GenArgs { world, content, size: 40_000.0, levels: Some(9), ..GenArgs::new(&out) };
    let summary = run(&args).unwrap();
    let set = WorldSet::square(World::new(WorldPreset::Moon, 1), [8f64, 30.0].map(f64::to_radians), 40_000.0, 3);
    let heights_m = set.heights_m(TileKey::ROOT);
    let [low, high] = heights_m.iter().fold([f32::MAX, f32::MIN], |[low, high], h| [low.min(*h), high.max(*h)]);
    let [low_m, high_m] = [summary.min_height_m, summary.max_height_m];
    // The samples lie 610 m and 620 m apart.
    assert!((low_m - f64::from(low)).abs() < 150.0 && (high_m - f64::from(high)).abs() < 150.0, "{low_m} {low}");
    let found = verified(&out);
    assert_eq!((found.failed, found.problems.len()), (0, 0), "{found:?}");
    let layer = |args: &GenArgs| -> Value {
        serde_json::from_slice(&std::fs::read(args.out.join("layer.json")).unwrap()).unwrap()
    };
    assert_eq!(layer(&args)["extensions"], serde_json::json!(["octvertexnormals"]), "no water on the moon");
    let mut scattered = GenArgs { overwrite: true, ..args.clone() };
    scattered.world.scatter = true;
    assert!(run(&scattered).unwrap_err().to_string().contains("--scatter"));
    // Tiles of the sea and of land have one number for their water, those of coasts one for each of 256 x 256 cells.
    let world = WorldArgs { world: Some(WorldPreset::Islands), ..WorldArgs::default() };
    let isles = GenArgs { world, levels: Some(10), out: folder.path().join("isles"), ..args };
    run(&isles).unwrap();
    assert_eq!(layer(&isles)["extensions"], serde_json::json!(["octvertexnormals", "watermask"]));
    let found = verified(&isles.out);
    assert_eq!((found.failed, found.ignored.len(), found.problems.len()), (0, 0, 0), "{found:?}");
    let sizes: Vec<usize> = files_below(&isles.out).into_values().map(|file| file.len()).collect();
    assert!(sizes.iter().any(|size| *size > 65_536) && sizes.iter().any(|size| *size < 10_000), "{sizes:?}");
    // The planet continues beyond the set. The last extension: its number, its length, and the water of each cell.
    let far = std::fs::read(isles.out.join("0/0/0.terrain")).unwrap();
    let (head, mask) = far[far.len() - 65_541..].split_at(5);
    assert_eq!(head, [2, 0, 0, 1, 0]);
    assert!(mask.contains(&0) && mask.contains(&255), "an ocean and islands");
}
