//! Tests that need a separate process: they count its threads, install its logger or start its one recording.

use std::process::Command;

/// Names the test that the process was started for.
const ALONE: &str = "TERRANE_TEST_ALONE";

/// Runs a test of the calling module alone in a new process, and panics with the output if it fails there.
///
/// Returns true in the calling process, where the test is then done, and false in the new process, which must run it.
/// `module` is the caller's `module_path!()`.
pub fn runs_alone(module: &str, test: &str) -> bool {
    let name = test_name(module, test);
    if std::env::var(ALONE).is_ok_and(|alone| alone == name) {
        return false;
    }
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", &name, "--nocapture"])
        .env(ALONE, &name)
        .output()
        .unwrap();
    let [stdout, stderr] = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes));
    assert!(output.status.success(), "{name} in a separate process: {}\n{stdout}{stderr}", output.status);
    assert!(stdout.contains("1 passed"), "no test is called {name}: {stdout}");
    true
}

/// Returns the name that the test harness gives a test: its path without the crate.
pub fn test_name(module: &str, test: &str) -> String {
    match module.split_once("::") {
        Some((_, module)) => format!("{module}::{test}"),
        None => test.to_owned(),
    }
}
