//! Benches run to their end; what they measure is not checked.

use std::path::Path;
use std::process::Command;

use kit::osg_files::{VERSION, geode, osgt, triangle};
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

/// OSG's own files are found level by level: each names those below it.
#[test]
fn bench_of_paging_loads_files_of_osg() {
    let folder = tempfile::tempdir().unwrap();
    let all = geode(10, "", &[triangle(11, "")]);
    let level = |below: &str| {
        format!(
            "osg::PagedLOD {{ UniqueID 1 CenterMode USER_DEFINED_CENTER UserCenter 32768 32768 0 50000
            RangeList 2 {{ 2e6 1e30 \n 0 2e6 }} RangeDataList 2 {{ \"\" \n \"{below}\" }} PriorityList 2 {{ 0 1 0 1 }}
            Children 1 {{ {all} }} }}"
        )
    };
    for (name, root) in [("root.osgb", level("1.osgb")), ("1.osgb", level("2.osgb")), ("2.osgb", all.clone())] {
        std::fs::write(folder.path().join(name), osgt(VERSION, &root)).unwrap();
    }
    let lines = bench(&["page", "--osgb", folder.path().to_str().unwrap(), "--frames", "2", "--pace", "0"]);
    let first = &lines[0];
    assert_eq!((&first["phase"], &first["label"]), (&"converge_start".into(), &"osgb".into()));
    assert!(first["converged"] == true && first["read_failures"] == 0, "{first}");
    assert!(first["files_merged"].as_u64() >= Some(2), "{first}");
}
