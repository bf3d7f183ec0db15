//! Packed sets: read back by the library from disks and servers, and by their documented layout; damage.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use kit::server::{Reply, Server};
use terrane::fetch::{FileReader, Limits};
use terrane::formats::{Content, ReadOptions, decode_node, verify};
use terrane::scene::{Geometry, Node, NodeKind};
use terrane_data_gen::{
    ArchiveFormat, Color, ContentKind, GenArgs, GenError, OutputArgs, Sharding, TileArgs, Tiling, WorldArgs,
    WorldPreset, predict, run,
};

use crate::files::{PLACE, SIDE, TILE_SIDE, files_below, from_dem, tiff_float32, tile_heights};
use crate::runs::updates::hills;

fn packed(args: &GenArgs, name: &str) -> GenArgs {
    let output = OutputArgs { archive: Some(ArchiveFormat::Packed), ..args.output.clone() };
    GenArgs { output, out: args.out.with_file_name(name), ..args.clone() }
}

fn small(out: PathBuf) -> GenArgs {
    GenArgs { levels: Some(3), size: 10_000.0, color: Color::None, ..GenArgs::new(out) }
}

/// Returns the heights of a tile of a packed set, south row first.
fn heights(set: &Path, name: &str) -> Vec<f32> {
    let uri = set.join(name).to_string_lossy().into_owned();
    let bytes = FileReader::new(Limits::default()).read(&uri).unwrap();
    let data = r#"{"region":[0.1,0.8,0.11,0.81],"side":65,"border":1,"level":0,"errors_m":[[1,1,1,1]]}"#;
    let uri: Arc<str> = uri.into();
    let content = Content { uri: uri.clone(), bytes, reader_data: Some(data.into()), companions: Vec::new() };
    let node = decode_node(content, &ReadOptions::for_root(&uri, Limits::default())).unwrap();
    fn tile(node: &Node) -> Option<Vec<f32>> {
        if let NodeKind::Geode(drawables) = &node.kind
            && let Some(Geometry::Height(tile)) = drawables.first().map(|drawable| &drawable.geometry)
        {
            return Some(tile.heights.clone());
        }
        node.children.iter().find_map(tile)
    }
    tile(&node).unwrap()
}

/// Returns the entries of the index by their keys: offset, size, checksum, error, lowest and highest height.
fn index(bytes: &[u8]) -> BTreeMap<u64, (u64, u32, u32, f64, [f32; 2])> {
    let long = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!((&bytes[..8], word(8), long(24)), (&b"TERRPACK"[..], 1, 64));
    assert_eq!(word(60), crc32fast::hash(&bytes[..60]));
    let (count, first) = (long(16), long(32) as usize);
    let entry = |k: u64| {
        let at = first + 40 * k as usize;
        let range_m = [32, 36].map(|field| f32::from_bits(word(at + field)));
        (long(at), (long(at + 8), word(at + 16), word(at + 20), f64::from_bits(long(at + 24)), range_m))
    };
    (0..count).map(entry).collect()
}

#[test]
fn packed_sets_have_the_heights_and_errors_of_folders() {
    let folder = tempfile::tempdir().unwrap();
    let plain = small(folder.path().join("plain"));
    let wanted = run(&plain).unwrap();
    let args = packed(&plain, "set.terrane");
    let summary = run(&args).unwrap();
    assert_eq!((summary.tiles, &summary.level_errors_m), (21, &wanted.level_errors_m));
    let bytes = std::fs::read(&args.out).unwrap();
    assert_eq!(summary.bytes, bytes.len() as u64);
    assert!(summary.bytes * 3 < wanted.bytes * 2, "{} bytes, {} as EXR", summary.bytes, wanted.bytes);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "nothing else is left");
    let entries = index(&bytes);
    assert_eq!(entries.len(), 22);
    let mut before = 0;
    for (key, (offset, size, checksum, error_m, [low_m, high_m])) in entries {
        let content = &bytes[offset as usize..offset as usize + size as usize];
        assert_eq!(crc32fast::hash(content), checksum);
        if key == 0 {
            continue;
        }
        assert!(offset > before, "tiles lie in the order of their keys");
        before = offset;
        let (level, morton) = (key >> 59, key >> 8 & ((1 << 50) - 1));
        let along = |bit: u64| (0..level).map(|k| (morton >> (2 * k + bit) & 1) << k).sum::<u64>() as u32;
        let (x, y) = (along(0), along(1));
        let read = heights(&args.out, &format!("{level}/{x}/{y}.heights"));
        let exr = tile_heights(&plain.out, level as u32, x, y);
        assert!(read.chunks(TILE_SIDE).rev().flatten().eq(&exr), "{level}/{x}/{y}");
        assert!(error_m <= wanted.level_errors_m[level as usize], "{error_m}");
        let inner = (1..66).flat_map(|j| read[j * TILE_SIDE + 1..][..65].iter());
        assert!(inner.clone().all(|h| (low_m..=high_m).contains(h)), "{low_m} to {high_m}");
    }
    // Bytes do not depend on the number of threads.
    assert!(matches!(run(&args), Err(GenError::Exists(_))));
    run(&GenArgs { overwrite: true, jobs: Some(1), ..args.clone() }).unwrap();
    assert!(std::fs::read(&args.out).unwrap() == bytes);
}

#[test]
fn all_forms_of_sets_are_packed_and_read_from_disks_and_servers() {
    let folder = tempfile::tempdir().unwrap();
    // Heights with a void, so that tiles on its border are meshes.
    let side = SIDE as usize;
    let mut samples: Vec<f32> = (0..side * side).map(|k| 500.0 + (k % side) as f32 + (k / side % 17) as f32).collect();
    (0..100).for_each(|k| samples[(20 + k / 10) * side + 12 + k % 10] = f32::NAN);
    let dem = from_dem(folder.path(), "dem.tif", &tiff_float32(&samples, Some(PLACE), None));
    let dem = GenArgs { levels: Some(3), ..dem };
    for (k, (content, tiling, color)) in [
        (ContentKind::Height, Tiling::Explicit, Color::Natural),
        (ContentKind::Height, Tiling::Implicit, Color::None),
        (ContentKind::Mesh, Tiling::Explicit, Color::None),
    ]
    .into_iter()
    .enumerate()
    {
        let output = OutputArgs { tiling, ..OutputArgs::default() };
        let plain = GenArgs { content, color, output, out: folder.path().join(format!("plain{k}")), ..dem.clone() };
        run(&plain).unwrap();
        let args = packed(&plain, &format!("set{k}.terrane"));
        let predicted = predict(&args).unwrap();
        let summary = run(&args).unwrap();
        assert!(predicted.tiles >= summary.tiles && predicted.bytes > summary.bytes / 4, "{predicted:?}");
        let set = args.out.to_string_lossy().into_owned();
        let limits = Limits::default();
        let wanted = verify(&plain.out.to_string_lossy(), &limits, &mut |_| ()).unwrap();
        let verified = verify(&set, &limits, &mut |_| ()).unwrap();
        assert_eq!((verified.contents, verified.failed), (wanted.contents, 0), "{verified:?}");
        let bytes = std::fs::read(&args.out).unwrap();
        let server = Server::start(move |request| Reply::ok(bytes.clone()).with("ETag", "\"1\"").ranged(request));
        let verified = verify(&format!("http://{}/set.terrane", server.host()), &limits, &mut |_| ()).unwrap();
        assert_eq!((verified.contents, verified.failed), (wanted.contents, 0), "{verified:?}");
    }
}

#[test]
fn coarser_steps_of_heights_take_fewer_bytes_and_are_declared() {
    let folder = tempfile::tempdir().unwrap();
    let samples: Vec<f32> = (0..SIDE * SIDE).map(|k| 500.0 + (k * 7919 % 1009) as f32 / 37.0).collect();
    let dem = from_dem(folder.path(), "dem.tif", &tiff_float32(&samples, Some(PLACE), None));
    let plain = GenArgs { levels: Some(3), color: Color::None, ..dem };
    let coarse = TileArgs { height_step: Some(2.0), ..TileArgs::default() };
    let coarse = GenArgs { tiles: coarse, ..packed(&plain, "coarse.terrane") };
    let [finer, coarser] = [packed(&plain, "fine.terrane"), coarse.clone()].map(|args| run(&args).unwrap());
    assert!(coarser.bytes * 3 < finer.bytes * 2, "{} bytes and {}", coarser.bytes, finer.bytes);
    for name in ["0/0/0", "2/1/3"] {
        assert!(heights(&coarse.out, &format!("{name}.heights")).iter().all(|h| h % 2.0 == 0.0));
    }
    // A height is rounded by at most half a step, and some height by nearly as much.
    let [fine_m, coarse_m] = [&finer, &coarser].map(|summary| summary.level_errors_m[2]);
    assert!((0.9..=fine_m + 1.01).contains(&coarse_m), "{coarse_m} m, {fine_m} m with fine steps");
}

#[test]
fn damage_is_an_error_of_one_tile_that_names_it_and_the_set() {
    let folder = tempfile::tempdir().unwrap();
    let args = packed(&small(folder.path().join("plain")), "set.terrane");
    run(&args).unwrap();
    let mut bytes = std::fs::read(&args.out).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&args.out, &bytes).unwrap();
    let verified = verify(&args.out.to_string_lossy(), &Limits::default(), &mut |_| ()).unwrap();
    assert_eq!((verified.contents, verified.failed), (21, 1), "{verified:?}");
    let error = format!("{:?}", verified.errors);
    assert!(error.contains("set.terrane/2/3/3.heights") && error.contains("checksum"), "{error}");
    std::fs::write(&args.out, &bytes[..100]).unwrap();
    let error = verify(&args.out.to_string_lossy(), &Limits::default(), &mut |_| ());
    let error = format!("{error:?}");
    assert!(error.contains("set.terrane"), "{error}");
    std::fs::write(&args.out, "notes").unwrap();
    let error = run(&GenArgs { overwrite: true, ..args.clone() }).unwrap_err().to_string();
    assert!(error.contains("is no archive"), "{error}");
}

/// Sets of several blocks and of shards have the bytes of a single run.
#[test]
fn shards_are_merged_into_one_packed_set() {
    let folder = tempfile::tempdir().unwrap();
    // Four of the 16 blocks of the finest layer have data, two in each shard.
    let dem = [[7.0, 46.0], [7.4, 46.0], [7.0, 46.4], [7.4, 46.4]];
    let dem = dem.iter().enumerate().map(|(k, corner)| hills(folder.path(), &format!("{k}.tif"), *corner, 8, k as u32));
    let plain = GenArgs {
        levels: Some(7),
        dem: dem.collect(),
        color: Color::None,
        ..GenArgs::new(folder.path().join("plain"))
    };
    let whole = packed(&plain, "whole.terrane");
    let summary = run(&whole).unwrap();
    assert!(summary.tiles > 4 * 21, "{summary:?}");
    let merged = packed(&plain, "merged.terrane");
    for number in 1..=2 {
        let sharding = Sharding { shard: format!("{number}/2").parse().ok(), ..Sharding::default() };
        run(&GenArgs { sharding, ..merged.clone() }).unwrap();
    }
    run(&GenArgs { sharding: Sharding { merge: true, ..Sharding::default() }, ..merged.clone() }).unwrap();
    assert!(std::fs::read(&merged.out).unwrap() == std::fs::read(&whole.out).unwrap());
    assert_eq!(files_below(folder.path()).len(), 4 + 2, "shards and unfinished files are removed");
    // Tiles, and the blocks with data.
    assert!(index(&std::fs::read(&whole.out).unwrap()).len() as u64 > summary.tiles + 4);
}

#[test]
fn contradictions_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let plain = small(folder.path().join("plain"));
    let args = packed(&plain, "a.terrane");
    let steps = |step_m: f64| TileArgs { height_step: Some(step_m), ..TileArgs::default() };
    for (args, part) in [
        (GenArgs { tiles: steps(1.0), ..args.clone() }, "--height-step has no effect without --dem"),
        (
            GenArgs { tiles: steps(f64::NAN), dem: vec!["a.tif".into()], ..args.clone() },
            "--height-step must be 0.002 to",
        ),
        (packed(&plain, "a.3tz"), "--archive packed: the name of"),
        (
            GenArgs { content: ContentKind::QuantizedMesh, color: Color::Natural, ..args.clone() },
            "--archive is not supported with --content quantized-mesh",
        ),
    ] {
        let error = run(&args).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn worlds_are_packed_with_their_heights_colours_and_trees() {
    let folder = tempfile::tempdir().unwrap();
    let world = WorldArgs { world: Some(WorldPreset::Moon), scatter: true, ..WorldArgs::default() };
    for tiling in [Tiling::Explicit, Tiling::Implicit] {
        let output = OutputArgs { tiling, ..OutputArgs::default() };
        let plain = GenArgs {
            world: world.clone(),
            output,
            color: Color::Natural,
            size: 2_000.0,
            levels: Some(2),
            ..GenArgs::new(folder.path().join("plain"))
        };
        let plain = GenArgs { overwrite: true, ..plain };
        let wanted = run(&plain).unwrap();
        let args = packed(&plain, "world.terrane");
        let summary = run(&args).unwrap();
        assert_eq!((summary.tiles, &summary.level_errors_m), (wanted.tiles, &wanted.level_errors_m));
        for (level, x, y) in [(0, 0, 0), (1, 1, 0)] {
            let read = heights(&args.out, &format!("{level}/{x}/{y}.heights"));
            assert!(
                read.chunks(TILE_SIDE).rev().flatten().eq(&tile_heights(&plain.out, level, x, y)),
                "{level}/{x}/{y}"
            );
        }
        let limits = Limits::default();
        let [own, other] =
            [&args.out, &plain.out].map(|set| verify(&set.to_string_lossy(), &limits, &mut |_| ()).unwrap());
        assert_eq!((own.contents, own.failed, other.failed), (other.contents, 0, 0), "{own:?}");
        let of = index(&std::fs::read(&args.out).unwrap());
        let errors: Vec<f64> = of.values().map(|entry| entry.3).filter(|error_m| *error_m > 0.0).collect();
        assert!(!errors.is_empty() && errors.iter().all(|error_m| *error_m <= wanted.level_errors_m[0]), "{errors:?}");
    }
}
