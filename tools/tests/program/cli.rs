//! The `terrane` command: exit codes, lines on stdout and stderr, files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use kit::skip::no_adapter;
use serde_json::Value;

fn terrane(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
    command.args(args).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    command.output().unwrap()
}

fn lines(bytes: &[u8]) -> Vec<String> {
    String::from_utf8_lossy(bytes).lines().map(str::to_owned).collect()
}

/// Generates a small set of height tiles.
fn tile_set(folder: &Path) -> PathBuf {
    let set = folder.join("set");
    let out = terrane(&["gen", set.to_str().unwrap(), "--levels", "3", "--seed", "7"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    set
}

fn json(file: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap()
}

#[test]
fn display_is_configured_by_arguments_and_by_the_environment() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let picture = |name: &str, more: &[&str], variable: Option<(&str, &str)>| {
        let file = folder.path().join(name);
        let mut command = Command::new(env!("CARGO_BIN_EXE_terrane"));
        command.args(["fly", set.to_str().unwrap(), "--offscreen", "--settle", "--size", "160x90"]).args(more);
        command.arg("--screenshot").arg(&file).env_remove("TERRANE_SPLIT_STEREO_HORIZONTAL_SEPARATION");
        command.envs(variable);
        let out = command.current_dir(folder.path()).output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        image::open(&file).unwrap().into_rgb8()
    };
    let split = ["--stereo", "HORIZONTAL_SPLIT"];
    let gap = ["--stereo", "HORIZONTAL_SPLIT", "--split-horizontal-separation=20"];
    let (without, said) = (picture("a.png", &split, None), picture("b.png", &gap, None));
    let set_outside = Some(("TERRANE_SPLIT_STEREO_HORIZONTAL_SEPARATION", "20"));
    assert!(without != said && said == picture("c.png", &split, set_outside));
    let last = ["--stereo", "HORIZONTAL_SPLIT", "--split-horizontal-separation", "0"];
    assert!(without == picture("d.png", &last, set_outside), "the command line takes precedence");
    // The middle columns belong to neither eye.
    assert!((0..90).all(|y| said.get_pixel(80, y).0 == said.get_pixel(80, 0).0));

    // A screen that is far away covers a smaller angle, and shows less of the set.
    let at =
        |name: &str, distance_m: &str| picture(name, &["--screen-height", "1", "--screen-distance", distance_m], None);
    let (usual, near, far) = (picture("e.png", &[], None), at("f.png", "0.5"), at("g.png", "3"));
    assert!(usual != near && near != far);
    let height = ["--screen-height", "1", "--screen-distance", "3", "--min-alpha-bits", "8"];
    assert!(far == picture("h.png", &height, None));
    assert!(far == picture("i.png", &height[..2], Some(("TERRANE_SCREEN_DISTANCE", "3"))));

    let wrong = terrane(&["fly", set.to_str().unwrap(), "--eye-separation", "far"]);
    assert_eq!((wrong.status.code(), lines(&wrong.stderr).len()), (Some(2), 1), "{wrong:?}");
    let help = lines(&terrane(&["view", "--help"]).stdout).join(" ");
    assert!(help.contains("--eye-separation") && help.contains("TERRANE_DISPLAY_TYPE"));
}

#[test]
fn invalid_arguments_exit_with_2() {
    for args in [
        &[][..],
        &["fly", "--size", "0x0"],
        &["fly", "--frames", "many"],
        &["fly", "--threading", "Twisted"],
        &["fly", "--view", "1,2"],
        &["fly", "--background", "red"],
        &["fly", "--sse", "0"],
        &["fly", "--look-ahead", "nan"],
        &["fly", "--water=-inf"],
        &["fly", "--samples", "3"],
        &["fly", "anything", "--frames", "0", "--screenshot", "x.png"],
        &["gen", "set", "--size", "5"],
        &["serve", ".", "--error-rate", "2"],
        &["serve", ".", "--latency-ms=-5"],
        &["serve", ".", "--latency-ms", "1e-4"],
        &["serve", ".", "--error-rate", "0.6", "--reset-rate", "0.6"],
        &["stress", "--minutes", "nan"],
        &["stress", "--minutes", "0"],
        &["stress", "--drawn", "101"],
        &["stress", "--frames", "0"],
        &["stress", "--jobs", "100000"],
        &["stress", "--faults", "error=0.9,reset=0.9"],
        &["stress", "http://localhost/set/", "--faults", "error=0.1"],
        &["fly", "--sun", "180,x,30"],
        &["fly", "--overlay", "http://h/{z}/{x}.png"],
        &["fly", "--sse", "-1"],
        &["stress", "--seeds", "0"],
        &["gen", "set", "--jobs", "0"],
        &["bench", "resident", "--tiles", "0"],
        &["bench", "resident", "--tiles", "18446744073709551615"],
        &["bench", "page", "--tiles", "0"],
        &["bench", "page", "--url", "localhost:8080"],
        &["bench", "page", "--frames", "0"],
        &["bench", "page", "--frames", "1"],
        &["bench", "page", "--pace", "1e-300"],
        &["bench", "cull", "--secs", "1e300"],
        &["nonsense"],
        &["view"],
        &["gen", "set", "--update"],
    ] {
        assert_eq!(terrane(args).status.code(), Some(2), "{args:?}");
    }
    assert_eq!(terrane(&["--help"]).status.code(), Some(0));
    assert_eq!(terrane(&["--version"]).status.code(), Some(0));
}

/// Regression: clap advised `-- -3` for a negative number, a header without a source was refused after a set was generated, and
/// options of planets were ignored for a folder.
#[test]
fn errors_of_arguments_say_what_is_expected() {
    for (args, expected) in [
        (&["fly", "--frames", "-3"][..], "invalid value '-3' for '--frames <N>': -3 is not in 0..=4294967295"),
        (&["fly", "--lod-fade", "-1"], "expected a number that is not below zero"),
        (&["gen", "set", "--size", "-5"], "-5 m is not within 100 m and 2,000 km"),
        (&["serve", ".", "--error-rate", "-1"], "expected a number from 0 to 1"),
        (&["fly", "--header", "hidden"], "--header needs NAME: VALUE"),
        (&["fly", "--header", "X: hidden"], "--header and --query need an http(s) URL as the source"),
        (&["info", "set", "--query", "x=hidden"], "--header and --query need an http(s) URL as the source"),
        (&["serve", ".", "--body", "mars"], "'[FOLDER]' cannot be used with '--body <BODY>'"),
        (&["serve", ".", "--tiling", "implicit"], "'[FOLDER]' cannot be used with '--tiling <TILING>'"),
        (&["stress", "--faults", "rain"], "names are latency-ms, jitter-ms"),
        (&["fly", "set", "--frames", "0"], "Usage: terrane fly"),
    ] {
        let out = terrane(args);
        let says = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(2) && says.contains(expected), "{args:?}: {says}");
        assert!(!says.contains("hidden") && !says.contains("tip:"), "{args:?}: {says}");
    }
}

/// Regression: it drew an empty image.
#[test]
fn flight_without_frames_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let shot = folder.path().join("shot.png");
    let out = terrane(&["fly", "anything", "--offscreen", "--frames", "0", "--screenshot", shot.to_str().unwrap()]);
    let says = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(2) && says.contains("--frames 0 draws nothing; --settle"), "{says}");
    assert!(!shot.exists());
}

/// Regression: some commands were missing.
#[cfg(unix)]
#[test]
fn script_names_every_command() {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/run");
    let help = lines(&terrane(&["--help"]).stdout);
    let commands = help.iter().skip_while(|line| *line != "Commands:").skip(1);
    let commands: Vec<&str> = commands.map_while(|line| line.split_whitespace().next()).collect();
    assert!(commands.len() > 8, "{commands:?}");
    for args in [&[][..], &["nonsense", "--levels"]] {
        let out = Command::new("sh").arg(script).args(args).output().unwrap();
        let usage = lines(&out.stderr);
        assert_eq!((out.status.code(), out.stdout.len()), (Some(2), 0), "{usage:?}");
        assert_eq!(usage[0].contains("nonsense"), !args.is_empty(), "{usage:?}");
        for command in ["test"].iter().chain(&commands) {
            let has_line = usage.iter().any(|line| line.split_whitespace().next() == Some(command));
            assert!(has_line, "{command} is missing: {usage:?}");
        }
    }
}

#[test]
fn root_that_cannot_be_loaded_exits_with_1_and_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let broken = folder.path().join("tileset.json");
    std::fs::write(&broken, "{\n \"asset\": [\n").unwrap();
    for source in [folder.path().join("missing").to_str().unwrap(), broken.to_str().unwrap()] {
        let out = terrane(&["fly", source, "--offscreen", "--frames", "1"]);
        let stderr = lines(&out.stderr);
        assert_eq!((out.status.code(), stderr.len()), (Some(1), 1), "{stderr:?}");
        assert!(stderr[0].starts_with("terrane fly: "), "{stderr:?}");
    }
    let out = terrane(&["fly", "anything", "--path", "no/such.path", "--offscreen"]);
    assert_eq!(out.status.code(), Some(1));
    let says = lines(&out.stderr).join(" ");
    assert!(says.matches("no/such.path").count() == 1 && says.matches("os error").count() == 1, "{says}");
    for option in ["--report", "--selection", "--screenshot"] {
        let out = terrane(&["fly", "anything", "--offscreen", option, folder.path().to_str().unwrap()]);
        let says = lines(&out.stderr).join(" ");
        assert!(out.status.code() == Some(1) && says.contains("is a folder"), "{says}");
    }
    let empty = tempfile::tempdir().unwrap();
    let points = folder.path().join("points.las");
    std::fs::write(&points, "LASF rest").unwrap();
    for (source, reason) in [
        (empty.path().to_str().unwrap(), "has no tileset.json, layer.json or metadata.xml"),
        (points.to_str().unwrap(), "no known format: it begins with [4c, 41, 53, 46] (\"LASF\")"),
        ("ftp://example.org/set", "scheme ftp:// is not supported"),
        ("", "the name of the source is empty"),
    ] {
        for command in [&["info", source][..], &["fly", source, "--offscreen"]] {
            let says = lines(&terrane(command).stderr);
            assert!(says.len() == 1 && says[0].contains(reason), "{says:?}");
        }
    }
}

/// Regression: files with the names of other formats held PNG.
#[test]
fn image_of_another_format_is_refused() {
    let out = terrane(&["fly", "anything", "--offscreen", "--screenshot", "shot.WebP"]);
    let says = lines(&out.stderr).join(" ");
    assert!(out.status.code() == Some(1) && says.contains("written as PNG or JPEG"), "{says}");
}

/// Regression: the summary named the missing display although the user asked for a flight without one.
#[test]
fn summary_says_why_the_flight_is_offscreen() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let flight = |more: &[&str]| {
        let args = [&["fly", set.to_str().unwrap(), "--settle", "--size", "32x18"], more].concat();
        lines(&terrane(&args).stdout)
    };
    let (asked, forced) = (flight(&["--offscreen"]), flight(&[]));
    assert!(asked[0].contains("32x18 offscreen on "), "{asked:?}");
    assert!(forced[0].contains("offscreen, as there is no display, on "), "{forced:?}");
    assert!(asked[4].contains("settled on") && asked[4].contains(" triangles, "), "{asked:?}");
}

/// The error names the file and the reason. Regression: it named neither.
#[test]
fn image_that_cannot_be_written_is_named() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let (file, set) = (folder.path().join("file"), set.to_str().unwrap());
    std::fs::write(&file, "in the way").unwrap();
    let inside = file.join("frames");
    let inside = inside.to_str().unwrap();
    let out = terrane(&["fly", set, "--offscreen", "--frames", "40", "--size", "32x32", "--frames-dir", inside]);
    let stderr = lines(&out.stderr);
    assert_eq!((out.status.code(), stderr.len()), (Some(1), 1), "{stderr:?}");
    assert!(stderr[0].starts_with("terrane fly: ") && stderr[0].contains(inside), "{stderr:?}");
    // Regression: the last bytes were lost silently.
    #[cfg(target_os = "linux")]
    {
        let out = terrane(&["fly", set, "--offscreen", "--settle", "--size", "32x32", "--screenshot", "/dev/full"]);
        let stderr = lines(&out.stderr);
        assert_eq!((out.status.code(), stderr.len()), (Some(1), 1), "{stderr:?}");
        assert!(stderr[0].starts_with("terrane fly: /dev/full: "), "{stderr:?}");
    }
}

#[test]
fn flight_writes_a_report() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (report, shot, selection, pictures) = (at("report.json"), at("shot.png"), at("drawn.json"), at("frames"));
    let out = terrane(&[
        "fly",
        set.to_str().unwrap(),
        // Twelve frames may be over before a tile is merged otherwise.
        "--blocking",
        "--frames",
        "12",
        "--size",
        "160x90",
        "--report",
        &report,
        "--screenshot",
        &shot,
        "--selection",
        &selection,
        "--frames-dir",
        &pictures,
    ]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert_eq!(lines(&out.stdout).len(), 5, "{}", String::from_utf8_lossy(&out.stdout));
    assert!(lines(&out.stdout)[0].contains("no display"));
    let report = json(Path::new(&report));
    assert_eq!(report["frames"], 12);
    assert_eq!(report["size"], serde_json::json!([160, 90]));
    assert_eq!(report["threading"], "DrawThreadPerContext");
    assert_eq!(report["errors"], serde_json::json!([]));
    assert!(report["settled"].is_null() && report["holes"].is_null());
    assert!(report["frame_ms"]["median"].as_f64().unwrap() > 0.0);
    assert!(report["tiles"]["merged"].as_u64().unwrap() > 0);
    assert!(report["bytes"]["read"].as_u64().unwrap() > 0);
    let size = |file: &str| image::image_dimensions(file).unwrap();
    assert_eq!(size(&shot), (160, 90));
    assert_eq!(std::fs::read_dir(&pictures).unwrap().count(), 12);
    assert!(json(Path::new(&selection))["selectedContent"].is_array());
}

#[test]
fn flight_writes_no_file_unless_asked() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let out = Command::new(env!("CARGO_BIN_EXE_terrane"))
        .args(["fly", set.to_str().unwrap(), "--frames", "11", "--size", "64x36", "--threading", "SingleThreaded"])
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("WAYLAND_SOCKET")
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    assert!(lines(&out.stdout)[0].starts_with("flew    11 frames of 64x36 offscreen"), "{:?}", lines(&out.stdout));
    assert!(lines(&out.stdout)[4].contains("no files written"), "{:?}", lines(&out.stdout));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "only the tile set");
}

#[test]
fn flight_that_draws_nothing_fails() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let bare = folder.path().join("bare");
    std::fs::create_dir(&bare).unwrap();
    std::fs::copy(set.join("tileset.json"), bare.join("tileset.json")).unwrap();
    let out =
        terrane(&["fly", bare.to_str().unwrap(), "--offscreen", "--frames", "3", "--size", "64x36", "--blocking"]);
    let errors = lines(&out.stderr);
    assert_eq!((out.status.code(), errors.len()), (Some(1), 2), "{errors:?}");
    assert!(errors[0].starts_with("error: ") && errors[0].contains("not found"), "{errors:?}");
    assert!(errors[1].contains("nothing was drawn"), "{errors:?}");
    assert_eq!(lines(&out.stdout).len(), 5);
}

#[test]
fn options_without_effect_together_are_errors() {
    for (args, names) in [
        (&["gen", "out", "--dem", "a.tif", "--size", "5000"][..], ["--size", "--dem"]),
        (&["gen", "out", "--dem", "a.tif", "--seed", "2"], ["--seed", "--dem"]),
        (&["gen", "out", "--epsg", "4326"], ["--epsg", "--dem"]),
        (&["gen", "out", "--float-vertices"], ["--float-vertices", "--content mesh"]),
        (&["fly", "set", "--offscreen", "--stats"], ["--offscreen", "--stats"]),
        (&["fly", "set", "--offscreen", "--max-fps", "30"], ["--offscreen", "--max-fps"]),
        (&["fly", "set", "--offscreen", "--no-vsync"], ["--offscreen", "--no-vsync"]),
        (&["fly", "set", "--offscreen", "--beside", "1"], ["--offscreen", "--beside"]),
        (&["fly", "set", "--check-holes", "--background", "ff0000"], ["--check-holes", "--background"]),
    ] {
        let out = terrane(args);
        let error = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(!out.status.success() && names.iter().all(|name| error.contains(name)), "{args:?}: {error}");
    }
    let large = terrane(&["fly", "set", "--size", "20000x10"]);
    assert!(String::from_utf8_lossy(&large.stderr).contains("20000 px, the limit is 8192 px"));
}

#[test]
fn settled_image_is_complete() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (report, selection, shot) = (at("report.json"), at("drawn.json"), at("shot.png"));
    let out = terrane(&[
        "fly",
        set.to_str().unwrap(),
        "--offscreen",
        "--settle",
        "--size",
        "160x90",
        "--report",
        &report,
        "--selection",
        &selection,
        "--screenshot",
        &shot,
        "--background",
        "1a334d",
    ]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let report = json(Path::new(&report));
    let settled = &report["settled"];
    assert!(settled["tiles"].as_u64().unwrap() > 0 && settled["triangles"].as_u64().unwrap() > 100);
    let coverage = settled["coverage"].as_f64().unwrap();
    assert!((0.05..1.0).contains(&coverage), "{coverage}");
    assert!(report["converge_s"].as_f64().unwrap() > 0.0);
    let drawn = json(Path::new(&selection));
    let drawn = drawn["selectedContent"].as_array().unwrap();
    assert_eq!(drawn.len() as u64, settled["contents"].as_u64().unwrap());
    assert!(drawn.iter().all(|uri| set.join(uri.as_str().unwrap()).is_file()), "{drawn:?}");
    // The corner is sky, exactly in the given background.
    assert_eq!(image::open(shot).unwrap().into_rgb8().get_pixel(0, 0).0, [0x1a, 0x33, 0x4d]);
}

#[test]
fn missing_tile_is_reported_and_the_flight_continues() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let missing = set.join("1/0/0.exr");
    std::fs::remove_file(&missing).unwrap();
    let report = folder.path().join("report.json");
    let out = terrane(&[
        "fly",
        set.to_str().unwrap(),
        "--settle",
        "--sse",
        "0.5",
        "--size",
        "160x90",
        "--report",
        report.to_str().unwrap(),
    ]);
    assert_eq!(out.status.code(), Some(0), "{}", String::from_utf8_lossy(&out.stderr));
    assert_eq!(lines(&out.stdout).len(), 5);
    assert!(lines(&out.stderr).iter().any(|line| line.starts_with("error: ") && line.contains("1/0/0.exr")));
    let report = json(&report);
    let errors = report["errors"].as_array().unwrap();
    assert_eq!(errors.len(), 1, "{errors:?}");
    assert!(errors[0]["uri"].as_str().unwrap().ends_with("1/0/0.exr"));
    assert!(errors[0]["count"].as_u64().unwrap() >= 1 && report["tiles"]["failed"].as_u64().unwrap() >= 1);
}

#[test]
fn holes_are_counted() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let report = folder.path().join("report.json");
    let (source, written) = (set.to_str().unwrap(), report.to_str().unwrap());
    let args = ["fly", source, "--frames", "20", "--size", "160x90", "--check-holes", "--report", written];
    // Without --blocking, the first frames are drawn before the coarsest tile is there.
    for more in [&["--blocking"][..], &[]] {
        let out = terrane(&[&args, more].concat());
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        assert_eq!(json(&report)["holes"], 0, "{more:?}");
    }
}

#[test]
fn info_is_printed_as_json() {
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let out = terrane(&["info", set.to_str().unwrap(), "--json"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let info: Value = serde_json::from_slice(&out.stdout).unwrap();
    for name in ["format", "version", "tiles", "contents", "levels", "bytes", "extensions", "bounds", "errors"] {
        assert!(info.get(name).is_some(), "{name} is missing");
    }
    assert_eq!(info["levels"].as_array().unwrap().len(), 3);
    // Imagery belongs to the tiles: its bytes count, and missing files are reported.
    let mut files = vec![set.clone()];
    while let Some(folder) = files.iter().position(|path| path.is_dir()) {
        let folder = files.swap_remove(folder);
        files.extend(std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()));
    }
    let bytes: u64 = files.iter().map(|file| file.metadata().unwrap().len()).sum();
    assert_eq!((info["bytes"].as_u64(), info["errors"].as_array().map(Vec::len)), (Some(bytes), Some(0)), "{files:?}");
    let is_picture = |file: &&std::path::PathBuf| file.extension().is_some_and(|e| e == "jpg" || e == "png");
    std::fs::remove_file(files.iter().find(is_picture).unwrap()).unwrap();
    let out = terrane(&["info", set.to_str().unwrap(), "--json"]);
    let info: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(info["errors"].as_array().map(Vec::len), Some(1), "{info}");
    assert!(terrane(&["info", "no/such/set"]).status.code() == Some(1));
}

#[test]
fn info_lists_the_metadata_of_a_tile_set() {
    let folder = tempfile::tempdir().unwrap();
    let volume = serde_json::json!({ "sphere": [0, 0, 0, 9] });
    let set = serde_json::json!({
        "asset": { "version": "1.1" }, "geometricError": 9,
        "schema": { "id": "s", "classes": { "city": { "properties": { "name": { "type": "STRING" } } }, "none": {} } },
        "metadata": { "class": "city", "properties": { "name": "Berlin" } },
        "groups": vec![serde_json::json!({ "class": "city", "properties": { "name": "trees" } }); 22],
        "root": {
            "boundingVolume": volume, "geometricError": 5, "refine": "ADD",
            "children": [
                { "boundingVolume": volume, "geometricError": 0, "metadata": { "class": "none" } },
                { "boundingVolume": volume, "geometricError": 0 },
            ],
        },
    });
    let file = folder.path().join("tileset.json");
    std::fs::write(&file, set.to_string()).unwrap();
    let text = String::from_utf8(terrane(&["info", file.to_str().unwrap()]).stdout).unwrap();
    for line in [
        "metadata classes city, none",
        "metadata tileset, class city, name = \"Berlin\"",
        "metadata group 19, class city, name = \"trees\"",
        "metadata and 2 more groups",
        "metadata 2 tiles have metadata",
    ] {
        assert!(text.lines().any(|found| found == line), "{line}: {text}");
    }
    assert!(!text.contains("group 20"), "{text}");
}

#[test]
fn info_describes_a_single_model() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("triangle.gltf");
    let json = serde_json::json!({
        "asset": { "version": "2.0" },
        "extensionsUsed": ["EXT_never_heard_of"],
        "buffers": [{ "byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA" }],
        "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
        "nodes": [{ "mesh": 0 }],
        "scenes": [{ "nodes": [0] }],
    });
    std::fs::write(&model, json.to_string()).unwrap();
    let out = terrane(&["info", "--verify", model.to_str().unwrap()]);
    let text = String::from_utf8(out.stdout).unwrap();
    assert!(out.status.success(), "{text}");
    let expected =
        ["format   glTF (JSON)", "1 drawables, 3 vertices, 1 triangles", "1 contents", "EXT_never_heard_of: 1"];
    assert!(expected.iter().all(|part| text.contains(part)), "{text}");
    let other = folder.path().join("other.json");
    std::fs::write(&other, "[]").unwrap();
    assert_eq!(terrane(&["info", other.to_str().unwrap()]).status.code(), Some(1));
}

#[test]
fn info_verifies_all_contents_with_the_option() {
    let folder = tempfile::tempdir().unwrap();
    let set = tile_set(folder.path());
    let verified = || {
        let out = terrane(&["info", set.to_str().unwrap(), "--json", "--verify"]);
        let info: Value = serde_json::from_slice(&out.stdout).unwrap();
        (out.status.code(), info["contents"].clone(), info["verified"].clone())
    };
    let (code, contents, whole) = verified();
    assert_eq!((code, &whole["contents"], &whole["failed"]), (Some(0), &contents, &Value::from(0)), "{whole}");
    assert!(whole["bytes"].as_u64().unwrap() > 10_000);
    std::fs::write(set.join("1/0/0.exr"), "no heights").unwrap();
    let (code, _, broken) = verified();
    assert_eq!((code, &broken["contents"], &broken["failed"]), (Some(1), &contents, &Value::from(1)));
    assert!(broken["errors"][0]["uri"].as_str().unwrap().ends_with("0.exr"), "{broken}");
    // Without the option the contents are not checked.
    assert!(terrane(&["info", set.to_str().unwrap()]).status.success());
}
