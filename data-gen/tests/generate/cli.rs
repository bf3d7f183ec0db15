//! The program `terrane-gen`: exit codes, and an output that takes nothing.

use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn terrane_gen(out: &Path, args: &[&str], stdout: Stdio) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    command.arg(out).args(args).stdout(stdout).stderr(Stdio::piped()).spawn().unwrap().wait_with_output().unwrap()
}

#[test]
fn wrong_values_are_wrong_usage() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    for args in [
        ["--size", "5"],
        ["--size", "nan"],
        ["--size", "3e9"],
        ["--levels", "0"],
        ["--levels", "10"],
        ["--epsg", "2056"],
        ["--epsg", "utm"],
        ["--content", "stones"],
        ["--jobs", "0"],
        ["--jobs", "70000"],
    ] {
        let output = terrane_gen(&out, &args, Stdio::piped());
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {text}");
        assert!(text.contains(args[0]) && text.contains(args[1]), "{args:?}: {text}");
    }
    let output = terrane_gen(&out, &["--dem", "none.tif"], Stdio::piped());
    assert_eq!(output.status.code(), Some(1), "what is asked for well and fails");
    assert!(!out.exists());
    let output = terrane_gen(&out, &["--size", "100", "--levels", "1"], Stdio::piped());
    assert_eq!(output.status.code(), Some(0));
    assert!(String::from_utf8(output.stdout).unwrap().starts_with("1 tiles on 1 levels"));
}

/// It stayed for ever.
#[test]
fn leftovers_of_a_killed_run_are_removed() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("set");
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    let mut run = command.arg(&out).args(["--levels", "9"]).spawn().unwrap();
    let names = || -> Vec<_> { folder.path().read_dir().unwrap().map(|e| e.unwrap().path()).collect() };
    let start = Instant::now();
    // The mark has its text as soon as the run's own folder is there.
    while !names().iter().any(|path| path.join(".terrane-gen").metadata().is_ok_and(|mark| mark.len() > 0)) {
        assert!(start.elapsed() < Duration::from_secs(120) && run.try_wait().unwrap().is_none(), "it does not begin");
        std::thread::sleep(Duration::from_millis(5));
    }
    run.kill().unwrap();
    run.wait().unwrap();
    assert_eq!(names().len(), 1, "what it has made");
    let output = terrane_gen(&out, &["--levels", "1"], Stdio::piped());
    assert_eq!((output.status.code(), names()), (Some(0), vec![out]));
}

/// Both were a panic.
#[test]
fn an_output_that_takes_nothing_is_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = terrane_gen(&folder.path().join("a"), &["--levels", "1"], writer.into());
    assert_eq!((output.status.code(), output.stderr), (Some(0), Vec::new()), "nobody reads it: a quiet end");
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
