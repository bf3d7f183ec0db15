//! Benches run to their end; what they measure is not checked.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// Runs a bench and returns the lines that it prints.
fn bench(args: &[&str]) -> Vec<Value> {
    let out = Command::new(env!("CARGO_BIN_EXE_terrane"))
        .arg("bench")
        .args(args)
        .current_dir(Path::new(env!("CARGO_TARGET_TMPDIR")))
        .output()
        .unwrap();
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// Regression: the bench of waiting requests ended with an error, because nothing made its uploads.
#[test]
fn bench_of_updates_measures_all_cases() {
    let lines = bench(&["resident", "--tiles", "100", "--requests", "100", "--secs", "0"]);
    let cases: Vec<_> = lines.iter().map(|line| line["budget"].as_str().unwrap()).collect();
    assert_eq!(
        cases,
        [
            "room to spare",
            "full",
            "requests appear",
            "camera stands",
            "camera moves",
            "answers at once",
            "camera turns"
        ]
    );
    assert!(lines.iter().all(|line| line["update_p50_us"].as_f64().unwrap() > 0.0), "{lines:?}");
}
