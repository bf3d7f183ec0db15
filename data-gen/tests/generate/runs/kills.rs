//! Runs that are killed at random moments, and continued by the same command.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::files::files_below;
use crate::runs::updates::hills;
use terrane::math::random::SplitMix64;

/// Runs a command until it has been killed `kills` times, then to its end. Calls after each kill.
fn run_with_kills(command: &mut Command, kills: u32, longest: Duration, mut after_kill: impl FnMut()) {
    let mut random = SplitMix64::new(7);
    command.stdout(Stdio::null()).stderr(Stdio::piped());
    for _ in 0..kills {
        let mut run = command.spawn().unwrap();
        std::thread::sleep(longest.mul_f64((random.next_u64() % 1000) as f64 / 1000.0));
        run.kill().unwrap();
        if run.wait().unwrap().success() {
            return;
        }
        after_kill();
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Returns the time of modification of each file below the temporary folder of a run.
fn times(folder: &Path) -> Vec<(String, std::time::SystemTime)> {
    let partial = std::fs::read_dir(folder).unwrap().flatten();
    let partial = partial
        .map(|entry| entry.path())
        .find(|path| path.file_name().unwrap().to_string_lossy().starts_with(".set.partial-"));
    let Some(partial) = partial else { return Vec::new() };
    let is_tile = |name: &String| name.ends_with(".exr") || name.ends_with(".glb");
    let names = files_below(&partial).into_keys().filter(is_tile);
    names.map(|name| (name.clone(), partial.join(&name).metadata().unwrap().modified().unwrap())).collect()
}

#[test]
fn world_that_is_killed_keeps_its_complete_tiles() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, out] = ["whole", "set"].map(|name| folder.path().join(name));
    let command = |out: &Path| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
        command.arg(out).args(["--world", "islands", "--size", "40000", "--levels", "3", "--seed", "5", "--jobs", "2"]);
        command
    };
    run_with_kills(&mut command(&whole), 0, Duration::ZERO, || {});
    let mut complete = Vec::new();
    run_with_kills(&mut command(&out), 5, Duration::from_secs(4), || {
        let list = std::fs::read_dir(folder.path())
            .unwrap()
            .flatten()
            .find_map(|entry| std::fs::read_to_string(entry.path().join(".terrane-gen-journal/tiles")).ok());
        // The tiles in the list are complete; others may be made again.
        let listed: Vec<String> = list
            .iter()
            .flat_map(|list| list.lines())
            .filter_map(|line| {
                let words: Vec<&str> = line.split(' ').collect();
                (words.len() == 10).then(|| format!("{}/{}/{}.exr", words[0], words[1], words[2]))
            })
            .collect();
        complete = times(folder.path());
        complete.retain(|(name, _)| listed.contains(name));
    });
    assert!(files_below(&out) == files_below(&whole));
    for (name, time) in complete {
        assert_eq!(out.join(&name).metadata().unwrap().modified().unwrap(), time, "{name} was made again");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2, "two sets");
}

#[test]
fn set_that_is_killed_at_random_moments_has_the_bytes_of_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let dem = hills(folder.path(), "a.tif", [7.0, 46.4], 12, 1);
    let [whole, out] = ["whole", "set"].map(|name| folder.path().join(name));
    let command = |out: &Path| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
        command.arg(out).args(["--levels", "7", "--color", "none", "--jobs", "2", "--dem"]).arg(&dem);
        command
    };
    run_with_kills(&mut command(&whole), 0, Duration::ZERO, || {});
    let mut complete = Vec::new();
    run_with_kills(&mut command(&out), 6, Duration::from_secs(3), || complete = times(folder.path()));
    assert!(files_below(&out) == files_below(&whole));
    // A kill loses the tiles in work, one for each thread, and no other.
    for (name, time) in complete {
        assert_eq!(out.join(&name).metadata().unwrap().modified().unwrap(), time, "{name} was made again");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 3, "a file and two sets");
}

/// Runs the commands of the contract for batch systems: plan, shards in several processes of which some are killed, merge.
#[test]
fn shards_that_are_killed_are_continued_and_merged() {
    let folder = tempfile::tempdir().unwrap();
    let dem = [[7.0, 46.4], [7.3, 46.1], [7.1, 46.25]].map(|corner| {
        let name = format!("{}.tif", corner[0]);
        hills(folder.path(), &name, corner, 12, 1)
    });
    for content in ["height", "quantized-mesh"] {
        let out = |name: &str| folder.path().join(format!("{content}-{name}"));
        let command = |out: &Path, more: &[&str]| {
            let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
            command.arg(out).args(["--jobs", "1", "--content", content]).args(more).arg("--dem").args(&dem);
            let levels =
                if content == "height" { ["--color", "none", "--levels", "7"].as_slice() } else { &["--levels", "12"] };
            command.args(levels);
            command
        };
        run_with_kills(&mut command(&out("whole"), &[]), 0, Duration::ZERO, || {});
        let plan = || {
            let output = command(&out("set"), &["--plan", "3"]).output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            let plan: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            plan["shards"].as_array().unwrap().clone()
        };
        assert!(plan().iter().all(|shard| shard["complete"] == false));
        std::thread::scope(|scope| {
            for number in 1..=3 {
                let (command, out) = (&command, &out);
                scope.spawn(move || {
                    let shard = format!("{number}/3");
                    let kills = if number == 2 { 4 } else { 0 };
                    run_with_kills(
                        &mut command(&out("set"), &["--shard", &shard]),
                        kills,
                        Duration::from_secs(2),
                        || {},
                    );
                });
            }
        });
        assert!(plan().iter().all(|shard| shard["complete"] == true));
        run_with_kills(&mut command(&out("set"), &["--merge"]), 2, Duration::from_secs(1), || {});
        assert!(files_below(&out("set")) == files_below(&out("whole")), "{content}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 7, "three files and four sets");
}

/// Regression: Ctrl-C left a hidden folder without a word.
#[cfg(target_os = "linux")]
#[test]
fn interrupted_run_says_what_is_left() {
    use rustix::process::{Pid, Signal, kill_process};
    let folder = tempfile::tempdir().unwrap();
    for (name, signal) in [("set", Signal::INT), ("other", Signal::TERM)] {
        let out = folder.path().join(name);
        let partial = || {
            let mut entries = std::fs::read_dir(folder.path()).unwrap().flatten().map(|entry| entry.path());
            let start = format!(".{name}.partial-");
            entries.find(|path| path.file_name().unwrap().to_string_lossy().starts_with(&start))
        };
        let command = |levels: &str| {
            let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
            command.arg(&out).args(["--world", "moon", "--size", "20000", "--jobs", "1", "--levels", levels]);
            command
        };
        let run = command("5").stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        while !partial().is_some_and(|partial| partial.join("0").exists()) {
            std::thread::yield_now();
        }
        kill_process(Pid::from_child(&run), signal).unwrap();
        let output = run.wait_with_output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        let left = partial().unwrap();
        let expected = "terrane-gen: interrupted; the same command continues (parts are in";
        assert_eq!(output.status.code(), Some(130), "{text}");
        assert_eq!(text.lines().last(), Some(&*format!("{expected} {})", left.display())));
        let output = command("1").output().unwrap();
        assert!(output.status.success() && partial().is_none(), "{output:?}");
    }
}
