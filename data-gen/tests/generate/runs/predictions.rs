//! `--dry-run` and `--memory`.

use std::process::Command;

use serde_json::Value;

use crate::files::files_below;
use crate::runs::updates::hills;
use terrane_data_gen::{Color, GenArgs, GenError, RunArgs, WorldArgs, WorldPreset, predict, run};

#[test]
fn prediction_has_the_tiles_and_about_the_bytes_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let dem = vec![hills(folder.path(), "a.tif", [7.0, 46.4], 60, 1)];
    let out = folder.path().join("set");
    for color in [Color::None, Color::Natural] {
        let args = GenArgs { dem: dem.clone(), levels: Some(4), color, overwrite: true, ..GenArgs::new(&out) };
        let predicted = predict(&args).unwrap();
        let made = run(&args).unwrap();
        let tiles: Vec<u64> = predicted.levels.iter().map(|level| level.tiles).collect();
        assert_eq!((tiles, predicted.tiles), (vec![1, 4, 16, 64], made.tiles), "{color:?}");
        let share = predicted.bytes as f64 / made.bytes as f64;
        assert!((0.7..1.4).contains(&share), "{color:?}: {} of {} bytes", predicted.bytes, made.bytes);
        assert!(predicted.seconds > 0.0 && predicted.sampled_tiles < made.tiles, "{predicted:?}");
        assert!(cfg!(not(unix)) || predicted.free_bytes.is_some());
    }
}

#[test]
fn dry_run_writes_nothing_and_prints_a_table_or_json() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("below/set");
    let dry_run = |option: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
        command.arg(option).arg(&out).args(["--levels", "4", "--color", "none"]).output().unwrap()
    };
    let table = dry_run("--dry-run");
    let text = String::from_utf8(table.stdout).unwrap();
    assert!(
        table.status.success() && text.contains("    3           64") && text.contains("  all           85"),
        "{text}"
    );
    let json: Value = serde_json::from_slice(&dry_run("--dry-run=json").stdout).unwrap();
    assert_eq!((&json["tiles"], &json["levels"][3]["tiles"]), (&85.into(), &64.into()));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn dry_run_counts_only_tiles_with_data() {
    let folder = tempfile::tempdir().unwrap();
    let dem =
        vec![hills(folder.path(), "a.tif", [7.0, 46.0], 12, 1), hills(folder.path(), "b.tif", [7.4, 46.4], 12, 1)];
    let args = GenArgs { dem, levels: Some(7), color: Color::None, ..GenArgs::new(folder.path().join("set")) };
    let (predicted, made) = (predict(&args).unwrap(), run(&args).unwrap());
    // Tiles beside the data may have some as far as is known before.
    assert!((made.tiles..2 * made.tiles + 16).contains(&predicted.tiles), "{predicted:?}, {} were made", made.tiles);
}

#[test]
fn dry_run_tells_the_errors_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    std::fs::write(folder.path().join("file"), "mine").unwrap();
    let broken = folder.path().join("a.tif");
    std::fs::write(&broken, "no TIFF").unwrap();
    for args in [
        GenArgs { dem: vec![broken], ..GenArgs::new(&out) },
        GenArgs { dem: vec![folder.path().join("none.tif")], ..GenArgs::new(&out) },
        GenArgs { nodata: Some(1.0), ..GenArgs::new(&out) },
        GenArgs { levels: Some(1), ..GenArgs::new(folder.path()) },
        GenArgs { levels: Some(1), ..GenArgs::new(folder.path().join("file/set")) },
    ] {
        let errors = [predict(&args).unwrap_err(), run(&args).unwrap_err()].map(|error| error.to_string());
        assert_eq!(errors[0], errors[1]);
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn world_is_predicted() {
    let folder = tempfile::tempdir().unwrap();
    let world = WorldArgs { world: Some(WorldPreset::Moon), ..WorldArgs::default() };
    let args = GenArgs { world, size: 40_000.0, levels: Some(2), ..GenArgs::new(folder.path().join("set")) };
    let (predicted, made) = (predict(&args).unwrap(), run(&args).unwrap());
    assert_eq!(predicted.tiles, made.tiles);
    // All tiles of two levels are made. Tilesets declare measured errors, which have more or fewer digits than estimates.
    assert!(predicted.bytes.abs_diff(made.bytes) < made.bytes / 200, "{} {}", predicted.bytes, made.bytes);
}

#[test]
fn memory_changes_no_bytes_and_is_refused_if_it_is_too_small() {
    let folder = tempfile::tempdir().unwrap();
    let dem = vec![hills(folder.path(), "a.tif", [7.0, 46.4], 60, 1)];
    let of = |name: &str, memory: Option<u64>| {
        let run = RunArgs { memory, ..RunArgs::default() };
        GenArgs { dem: dem.clone(), levels: Some(3), run, ..GenArgs::new(folder.path().join(name)) }
    };
    let [whole, small] = [of("whole", None), of("small", Some(200 << 20))].map(|args| {
        run(&args).unwrap();
        files_below(&args.out)
    });
    assert!(whole == small);
    for result in [run(&of("none", Some(8 << 20))).map(drop), predict(&of("none", Some(8 << 20))).map(drop)] {
        let error = result.unwrap_err();
        assert!(matches!(&error, GenError::Argument(text) if text.contains("which needs at least")), "{error}");
    }
}
