//! Runs that are killed and continued, shards, external tilesets, and several writers.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::files::{files_below, region, tileset};
use crate::tiffs::{Image, Values, tiff};
use terrane_data_gen::{Color, GenArgs, GenError, run};

/// Writes two small files of elevation in opposite corners of a square, so that a set of seven levels has two blocks with data and
/// few tiles.
fn corners(folder: &Path) -> Vec<PathBuf> {
    let pixel = 1e-4;
    let at = |name: &str, [west, north]: [f64; 2], seed: usize| {
        let heights = (0..40 * 40).flat_map(|k| ((k * seed % 97) as f32 + (k / 40) as f32).to_le_bytes()).collect();
        let image = Image::new([40; 2], 32, 1, heights).with(339, Values::Short(vec![3])).at([west, north], [pixel; 2]);
        let path = folder.join(name);
        // The time of modification belongs to the fingerprint of a run.
        if !path.exists() {
            fs::write(&path, tiff(vec![image])).unwrap();
        }
        path
    };
    vec![at("a.tif", [7.0, 46.0], 31), at("b.tif", [7.4, 46.4], 57)]
}

fn args(folder: &Path, out: &str) -> GenArgs {
    let dem = corners(folder);
    GenArgs { dem, levels: Some(7), color: Color::None, jobs: Some(2), ..GenArgs::new(folder.join(out)) }
}

/// Returns the files of a set; two sets are equal if these are.
fn set(path: &Path) -> BTreeMap<String, Vec<u8>> {
    files_below(path)
}

#[test]
fn large_sets_have_external_tilesets_within_their_parents_volume() {
    let folder = tempfile::tempdir().unwrap();
    let args = args(folder.path(), "set");
    let summary = run(&args).unwrap();
    let root = tileset(&args.out);
    let mut uris = Vec::new();
    let mut walk = vec![(args.out.join("tileset.json"), root["root"].clone(), 0u64)];
    while let Some((file, tile, level)) = walk.pop() {
        let uri = tile["content"]["uri"].as_str().unwrap();
        let path = file.parent().unwrap().join(uri);
        assert!(path.is_file(), "{uri} of {}", file.display());
        if uri.ends_with(".json") {
            let inner: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
            let extras = &inner["asset"]["extras"]["terrane"];
            assert_eq!(extras["level"], level);
            assert_eq!(extras["level_errors_m"], root["asset"]["extras"]["terrane"]["level_errors_m"]);
            assert_eq!(inner["root"]["boundingVolume"], tile["boundingVolume"]);
            assert_eq!(inner["root"]["geometricError"], tile["geometricError"]);
            walk.push((path, inner["root"].clone(), level));
            continue;
        }
        uris.push(path.canonicalize().unwrap());
        let outer = region(&tile);
        for child in tile["children"].as_array().into_iter().flatten() {
            let inner = region(child);
            assert!(child["geometricError"].as_f64() <= tile["geometricError"].as_f64());
            assert!(inner[4] >= outer[4] && inner[5] <= outer[5], "{inner:?} in {outer:?}");
            walk.push((file.clone(), child.clone(), level + 1));
        }
    }
    uris.sort();
    uris.dedup();
    assert_eq!(uris.len() as u64, summary.tiles);
    // The files have about 40 x 40 samples each, and the set 4097 x 4097.
    let known = 4097 * 4097 - summary.cut_samples;
    assert!((3000..3600).contains(&known), "{known}");
    let names: Vec<String> = set(&args.out).into_keys().filter(|name| name.ends_with("json")).collect();
    assert!(args.out.join("manifest.zip").is_file() && !args.out.join(".terrane-gen-journal").exists());
    assert_eq!(names, ["2/0/0.json", "2/3/3.json", "tileset.json"]);
}

#[test]
fn shards_and_any_number_of_threads_make_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let whole = args(folder.path(), "whole");
    let summary = run(&whole).unwrap();
    let expected = set(&whole.out);
    let shard = |text: &str| {
        let mut args = args(folder.path(), "parts");
        args.jobs = Some(1);
        args.sharding.shard = Some(text.parse().unwrap());
        args
    };
    let merge = || {
        let mut args = args(folder.path(), "parts");
        args.sharding.merge = true;
        run(&args)
    };
    assert!(merge().unwrap_err().to_string().contains("there are no shards beside it"));
    let first = run(&shard("3/3")).unwrap();
    assert!(first.tiles > 0 && first.out.ends_with("parts.shard-3-of-3"));
    run(&shard("1/3")).unwrap();
    let error = merge().unwrap_err().to_string();
    assert!(error.contains("options or sources: 2/3; make them with --shard"), "{error}");
    run(&shard("2/3")).unwrap();
    // A shard that is complete is not made again.
    let before = fs::metadata(first.out.join("shard.json")).unwrap().modified().unwrap();
    assert!(run(&shard("3/3")).unwrap().notes[0].contains("complete"));
    assert_eq!(fs::metadata(first.out.join("shard.json")).unwrap().modified().unwrap(), before);
    // Damage is noticed and named.
    let tile = first.out.join("6/63/63.glb");
    let bytes = fs::read(&tile).unwrap();
    fs::write(&tile, "damaged").unwrap();
    let error = merge().unwrap_err().to_string();
    assert!(error.contains("1 files are missing or changed, such as 6/63/63.glb of 3/3"), "{error}");
    fs::write(&tile, bytes).unwrap();
    let merged = merge().unwrap();
    assert_eq!(
        (merged.tiles, merged.bytes, &merged.level_errors_m),
        (summary.tiles, summary.bytes, &summary.level_errors_m)
    );
    assert!(set(&merged.out) == expected);
    let [own, other] = [&merged.out, &whole.out].map(|out| fs::read(out.join("manifest.zip")).unwrap());
    assert!(own == other, "the manifests differ");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 4, "two files and two sets");
}

#[test]
fn options_change_what_a_shard_is() {
    let folder = tempfile::tempdir().unwrap();
    let mut args = args(folder.path(), "set");
    args.sharding.shard = Some("1/1".parse().unwrap());
    run(&args).unwrap();
    let other = GenArgs { nodata: Some(7.0), ..args };
    assert!(matches!(run(&other), Err(GenError::Exists(_))));
    let mut merge = other;
    (merge.sharding.shard, merge.sharding.merge) = (None, true);
    assert!(run(&merge).unwrap_err().to_string().contains("of other options or sources: 1/1"));
}

/// Starts the program with the options of [`args`].
fn start(folder: &Path, out: &Path, more: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    command.arg(out).args(["--levels", "7", "--color", "none", "--jobs", "2"]).args(more);
    command.arg("--dem").args(corners(folder)).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits until a file exists whose path from a folder with the prefix `.set.partial-` is `path`, or the program ends.
fn wait_for(folder: &Path, path: &str, run: &mut Child) -> Option<PathBuf> {
    let start = Instant::now();
    loop {
        for entry in fs::read_dir(folder).unwrap().flatten() {
            let found = entry.path().join(path);
            if entry.file_name().to_string_lossy().starts_with(".set.partial-") && found.is_file() {
                return Some(found);
            }
        }
        if run.try_wait().unwrap().is_some() {
            return None;
        }
        assert!(start.elapsed() < Duration::from_secs(120), "no {path} within 120 s");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn killed_run_is_continued_by_the_same_command() {
    let folder = tempfile::tempdir().unwrap();
    let whole = args(folder.path(), "whole");
    run(&whole).unwrap();
    let out = folder.path().join("set");
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    command.arg(&out).args(["--levels", "7", "--color", "none", "--jobs", "2", "--dem"]).args(&whole.dem);
    let mut killed = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let block = wait_for(folder.path(), ".terrane-gen-journal/2/0/0", &mut killed);
    killed.kill().unwrap();
    killed.wait().unwrap();
    if let Some(block) = block {
        let made = block.ancestors().nth(4).unwrap().join("6/0/0.glb");
        let before = fs::metadata(&made).unwrap().modified().unwrap();
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(fs::metadata(out.join("6/0/0.glb")).unwrap().modified().unwrap(), before, "made again");
    }
    assert!(set(&out) == set(&whole.out));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 4, "two files and two sets");
}

#[test]
fn second_writer_of_a_set_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let mut first = start(folder.path(), &out, &["--voids", "fill"]);
    let marker = wait_for(folder.path(), ".terrane-gen", &mut first);
    // The text is written when the marker is locked.
    while marker.as_ref().is_some_and(|path| fs::read(path).is_ok_and(|text| text.is_empty())) {
        std::thread::sleep(Duration::from_millis(1));
    }
    let error = run(&GenArgs { levels: Some(1), ..GenArgs::new(&out) }).unwrap_err();
    first.kill().unwrap();
    first.wait().unwrap();
    assert!(marker.is_some() && matches!(error, GenError::Busy(_) | GenError::Exists(_)), "{error}");
}

#[test]
fn plan_lists_each_block_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = start(folder.path(), &folder.path().join("set"), &["--plan", "3"]);
    assert!(child.wait().unwrap().success());
    let plan: Value = serde_json::from_reader(child.stdout.take().unwrap()).unwrap();
    let shards = plan["shards"].as_array().unwrap();
    let subtrees: Vec<&str> = shards
        .iter()
        .flat_map(|shard| shard["subtrees"].as_array().unwrap())
        .map(|name| name.as_str().unwrap())
        .collect();
    assert_eq!((shards.len(), subtrees), (3, vec!["2/0/0", "2/3/3"]));
    assert_eq!((&shards[1]["shard"], &plan["levels"]), (&"2/3".into(), &7.into()));
    assert!(!folder.path().join("set").exists());
}

#[cfg(unix)]
#[test]
fn target_that_cannot_be_written_is_a_clear_error() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "mine").unwrap();
    let error = run(&GenArgs { levels: Some(1), ..GenArgs::new(file.join("set")) }).unwrap_err().to_string();
    assert!(error.contains("file"), "{error}");
    assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
}
