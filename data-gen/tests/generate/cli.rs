//! The program `terrane-gen`: exit codes, killed runs, and a standard output that cannot be written.

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn terrane_gen(out: &Path, args: &[&str], stdout: Stdio) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    command.arg(out).args(args).stdout(stdout).stderr(Stdio::piped()).spawn().unwrap().wait_with_output().unwrap()
}

#[test]
fn invalid_values_are_usage_errors() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    for args in [
        ["--size", "5"],
        ["--size", "nan"],
        ["--size", "3e9"],
        ["--levels", "0"],
        ["--levels", "25"],
        ["--epsg", "4978"],
        ["--epsg", "utm"],
        ["--content", "stones"],
        ["--jobs", "0"],
        ["--jobs", "70000"],
        ["--size", "-5"],
        // Regression: what is found after clap exited with 1.
        ["--nodata", "3"],
    ] {
        let output = terrane_gen(&out, &args, Stdio::piped());
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {text}");
        let is_named = text.contains(args[1]) || text.contains("no effect");
        assert!(text.contains(args[0]) && is_named, "{args:?}: {text}");
    }
    let output = terrane_gen(&out, &["--dem", "none.tif"], Stdio::piped());
    assert_eq!(output.status.code(), Some(1), "valid arguments, but the file is missing");
    assert!(!out.exists());
    let output = terrane_gen(&out, &["--size", "100", "--levels", "1"], Stdio::piped());
    assert_eq!(output.status.code(), Some(0));
    assert!(String::from_utf8(output.stdout).unwrap().starts_with("1 tiles on 1 levels"));
}

/// Regression: the temporary folder of a killed run was never removed.
#[test]
fn folder_of_a_killed_run_is_removed_by_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    let mut run = command.arg(&out).args(["--levels", "9"]).spawn().unwrap();
    let names = || -> Vec<_> { folder.path().read_dir().unwrap().map(|e| e.unwrap().path()).collect() };
    let start = Instant::now();
    // The run has begun once the marker file has its text.
    while !names().iter().any(|path| path.join(".terrane-gen").metadata().is_ok_and(|marker| marker.len() > 0)) {
        assert!(
            start.elapsed() < Duration::from_secs(120) && run.try_wait().unwrap().is_none(),
            "the run did not begin within 120 s"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    run.kill().unwrap();
    run.wait().unwrap();
    assert_eq!(names().len(), 1, "only the temporary folder is left");
    let output = terrane_gen(&out, &["--levels", "1"], Stdio::piped());
    assert_eq!((output.status.code(), names()), (Some(0), vec![out]));
}

/// Regression: a closed pipe and a full device both caused a panic.
#[test]
fn closed_or_full_standard_output_does_not_panic() {
    let folder = tempfile::tempdir().unwrap();
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = terrane_gen(&folder.path().join("a"), &["--levels", "1"], writer.into());
    assert_eq!((output.status.code(), output.stderr), (Some(0), Vec::new()), "a closed pipe is not an error");
    #[cfg(target_os = "linux")]
    {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let output = terrane_gen(&folder.path().join("b"), &["--levels", "1"], full.into());
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.starts_with("terrane-gen: standard output: ") && text.lines().count() == 1, "{text}");
        assert!(folder.path().join("b/tileset.json").is_file());
    }
}
