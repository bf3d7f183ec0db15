//! `terrane stress`: some seeds pass, a seed gives the same flight each time, and failures are reported.

use std::io::{BufRead as _, BufReader};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

fn stress(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_terrane")).arg("stress").args(arguments).output().unwrap()
}

/// Generates a small set. Dropping the first value removes its folder.
fn set() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let args = terrane_data_gen::GenArgs { levels: Some(4), size: 20_000.0, ..terrane_data_gen::GenArgs::new(&out) };
    terrane_data_gen::run(&args).unwrap();
    let out = out.display().to_string();
    (folder, out)
}

#[test]
fn some_seeds_pass() {
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().join("report.json");
    let out = stress(&["--seeds", "12", "--frames", "25", "--report", report.to_str().unwrap()]);
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(out.status.success(), "{said}{}", String::from_utf8_lossy(&out.stderr));
    assert!(said.lines().count() == 13 && said.contains("12 seeds, 0 failed"), "{said}");
    let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
    let seeds = report["seeds"].as_array().unwrap();
    assert_eq!((seeds.len(), report["failed"].as_u64()), (12, Some(0)));
    assert!(seeds.iter().all(|s| s["frames"].as_u64().unwrap() > 25), "{report}");
    // Tiles come from disk, and over all protocols of the server.
    let ways: std::collections::BTreeSet<&str> = seeds.iter().map(|s| s["way"].as_str().unwrap()).collect();
    assert_eq!(ways.into_iter().collect::<Vec<_>>(), ["disk", "h2", "h2c", "http/1.1", "tls/1.1"]);
    assert!(seeds.iter().map(|s| s["merged"].as_u64().unwrap()).sum::<u64>() > 50, "{report}");
}

#[test]
fn seed_gives_the_same_flight_each_time() {
    let (_folder, set) = set();
    let fly = |seed: &str| -> Value {
        let out = stress(&[&set, "--seed", seed, "--frames", "20", "--drawn", "0", "--as-json"]);
        assert!(out.status.success());
        serde_json::from_slice(&out.stdout).unwrap()
    };
    let (first, again, other) = (fly("7"), fly("7"), fly("8"));
    assert_eq!(first["failures"], Value::Array(Vec::new()), "{first}");
    for what in ["plan", "way", "drawing"] {
        assert_eq!(first[what], again[what], "{what}");
    }
    assert_ne!(first["plan"], other["plan"]);
}

/// Failures of a remote server are no failures of the flight, and credentials are in no report.
#[test]
fn failures_of_a_remote_server_are_allowed() {
    let (folder, set) = set();
    std::fs::write(format!("{set}/1/0/0.exr"), "no heights").unwrap();
    let mut server = Command::new(env!("CARGO_BIN_EXE_terrane"))
        .args(["serve", &set, "--port", "0"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim().rsplit("http://").next().unwrap();
    let (url, file) = (format!("http://me:hidden@{address}?key=hidden"), folder.path().join("report.json"));
    let out = stress(&[&url, "--seed", "3", "--frames", "30", "--drawn", "0", "--report", file.to_str().unwrap()]);
    let (said, report) = (String::from_utf8_lossy(&out.stdout).into_owned(), std::fs::read_to_string(file).unwrap());
    server.kill().unwrap();
    server.wait().unwrap();
    assert!(out.status.success() && !said.contains(" 0 failed"), "{said}");
    assert!(report.contains(address) && !report.contains("hidden"), "{report}");
}

/// A seed that fails by faults of the network fails again, by the same tiles in the same frame. These seeds have budgets that
/// are large enough.
#[test]
fn failure_by_the_network_is_repeated() {
    let (_folder, set) = set();
    // A reset or a cut answer may end other requests of the connection.
    let faults = ["--faults", "error=0.3,corrupt=0.2"];
    let failures = |seed: &str| {
        let options = ["--seed", seed, "--frames", "30", "--drawn", "0", "--blocking", "--strict"];
        let out = stress(&[&[set.as_str()], &options[..], &faults].concat());
        let said = String::from_utf8_lossy(&out.stdout).into_owned();
        assert_eq!(out.status.code(), Some(1), "{said}");
        said.lines().filter(|line| line.starts_with("    frame ")).map(str::to_owned).collect::<Vec<_>>()
    };
    for seed in ["3", "6"] {
        let first = failures(seed);
        assert!(first.iter().any(|failure| failure.contains("faults kept tiles from loading")), "{first:?}");
        assert_eq!(failures(seed), first, "seed {seed}");
    }
}

#[test]
fn failures_are_reported() {
    // The contents of the set are corrupt on disk, so no fault explains their failures.
    let (_folder, set) = set();
    let tiles = std::fs::read_dir(&set).unwrap().map(|entry| entry.unwrap().path());
    let mut broken = 0;
    let mut open: Vec<_> = tiles.collect();
    while let Some(path) = open.pop() {
        if path.is_dir() {
            open.extend(std::fs::read_dir(path).unwrap().map(|entry| entry.unwrap().path()));
        } else if path.extension().is_some_and(|e| e == "exr") {
            std::fs::write(path, b"no heights").unwrap();
            broken += 1;
        }
    }
    assert!(broken > 4);
    // The first seed that reads from disk.
    let out = stress(&[&set, "--seeds", "12", "--frames", "20", "--drawn", "0", "--faults", "none"]);
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    assert_eq!(out.status.code(), Some(1), "{said}");
    assert!(said.contains("FAILED disk") && said.contains("a valid file failed to load"), "{said}");
    // The failed seed fails again, with the same requests.
    let line = said.lines().find_map(|line| line.trim().strip_prefix("repeat: terrane stress ")).unwrap();
    let again: Vec<&str> = line.split(' ').collect();
    let (out, plan) = (stress(&again), said.split("    plan ").nth(1).unwrap());
    let once_more = String::from_utf8_lossy(&out.stdout);
    assert!(out.status.code() == Some(1) && once_more.contains("a valid file failed to load"), "{line}: {once_more}");
    let out = stress(&[&again[..], &["--as-json"]].concat());
    let report: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(report["plan"].as_str(), plan.lines().next(), "{line}");

    // A report that cannot be written is an error before the flight.
    let out = stress(&[&set, "--seeds", "2", "--frames", "5", "--report", &set]);
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.code() == Some(1) && out.stdout.is_empty() && said.contains(&set), "{said}");

    // Regression: the error was that of the local server.
    let out = stress(&["/no/such/set", "--seed", "1"]);
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.code() == Some(1) && said.starts_with("terrane stress: /no/such/set: "), "{said}");
    for (arguments, word) in [(&["--drawn", "101"][..], "--drawn"), (&["--minutes=-1"], "--minutes")] {
        let out = stress(arguments);
        assert!(!out.status.success() && String::from_utf8_lossy(&out.stderr).contains(word));
    }
    assert_eq!(stress(&["--faults", "rain=1"]).status.code(), Some(2));
}
