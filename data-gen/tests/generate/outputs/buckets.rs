//! Sets that are written into buckets of a server that acts like S3. Keys and address come from the environment.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use kit::buckets::Buckets;
use kit::server::{How, Reply, Request};

use crate::files::files_below;
use crate::runs::updates::hills;

/// Returns the command that writes a small set; its scratch files are made in `folder`.
fn command(buckets: &Buckets, folder: &Path, out: &str, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    command.arg(out).args(["--levels", "3", "--size", "10000", "--jobs", "2"]).args(more);
    command.envs(buckets.environment()).env("TMPDIR", folder);
    command
}

fn generate(buckets: &Buckets, folder: &Path, out: &str, more: &[&str]) -> Output {
    command(buckets, folder, out, more).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Returns the files of a set in a bucket.
fn set(buckets: &Buckets, prefix: &str) -> BTreeMap<String, Vec<u8>> {
    let objects = buckets.objects().into_iter();
    objects.filter_map(|(key, object)| Some((key.strip_prefix(prefix)?.to_owned(), object.body))).collect()
}

fn plain(folder: &Path, more: &[&str]) -> BTreeMap<String, Vec<u8>> {
    let out = folder.join("plain");
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    command.arg(&out).args(["--levels", "3", "--size", "10000", "--jobs", "2", "--overwrite"]).args(more);
    assert!(command.output().unwrap().status.success());
    files_below(&out)
}

fn is_empty(folder: &Path) -> bool {
    std::fs::read_dir(folder).unwrap().next().is_none()
}

#[test]
fn bucket_has_the_files_of_a_folder_and_the_root_is_written_last() {
    let [folder, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let buckets = Buckets::start(|_| None);
    let out = "s3://tiles/a/set";
    let output = generate(&buckets, scratch.path(), out, &["--content", "mesh", "--gzip"]);
    assert!(output.status.success(), "{}", said(&output));
    assert!(String::from_utf8_lossy(&output.stdout).contains(": s3://tiles/a/set"), "{output:?}");
    assert!(set(&buckets, "/tiles/a/set/") == plain(folder.path(), &["--content", "mesh", "--gzip"]));
    assert!(is_empty(scratch.path()), "scratch files are left");
    let puts: Vec<Request> = buckets.server.seen().into_iter().filter(|request| request.method == "PUT").collect();
    assert!(puts[0].path().ends_with("/.terrane-gen-probe") && puts.len() > 20);
    assert_eq!(puts[puts.len() - 1].path(), "/tiles/a/set/tileset.json");
    let root = &buckets.objects()["/tiles/a/set/tileset.json"];
    assert_eq!((&*root.content_type, root.encoding.as_deref()), ("application/json", Some("gzip")));

    // The set is replaced only if asked for; other objects stay.
    let refused = generate(&buckets, scratch.path(), out, &[]);
    assert!(refused.status.code() == Some(1) && said(&refused).contains("already exists"), "{}", said(&refused));
    let before = buckets.server.count();
    let output = generate(&buckets, scratch.path(), "s3://tiles/a/other", &[]);
    assert!(output.status.success(), "{}", said(&output));
    assert!(buckets.server.count() > before);
    let output = generate(&buckets, scratch.path(), out, &["--overwrite"]);
    assert!(output.status.success(), "{}", said(&output));
    let expected = plain(folder.path(), &[]);
    assert!(set(&buckets, "/tiles/a/set/") == expected && set(&buckets, "/tiles/a/other/") == expected);
    // The old root left first.
    let seen = buckets.server.seen();
    let removed = seen.iter().filter(|request| request.method == "DELETE" && request.path().contains("/a/set/"));
    let removed: Vec<&str> = removed.map(Request::path).filter(|path| !path.ends_with("-probe")).collect();
    assert_eq!(removed[0], "/tiles/a/set/tileset.json");
    let output = generate(&buckets, scratch.path(), "s3://tiles/a", &["--overwrite"]);
    assert!(said(&output).contains("holds no tile set"), "{}", said(&output));
    assert!(is_empty(scratch.path()), "scratch files are left");
}

#[test]
fn archive_is_one_object() {
    let [folder, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let buckets = Buckets::start(|_| None);
    let out = "s3://tiles/sets/alps.3tz";
    for more in [&["--archive", "3tz"][..], &["--archive", "3tz", "--overwrite"]] {
        let output = generate(&buckets, scratch.path(), out, more);
        assert!(output.status.success(), "{}", said(&output));
    }
    let refused = generate(&buckets, scratch.path(), out, &["--archive", "3tz"]);
    assert!(said(&refused).contains("already exists"), "{}", said(&refused));
    let objects = buckets.objects();
    assert_eq!(objects.keys().collect::<Vec<_>>(), ["/tiles/sets/alps.3tz"]);
    let local = folder.path().join("alps.3tz");
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    command.arg(&local).args(["--levels", "3", "--size", "10000", "--archive", "3tz"]);
    assert!(command.output().unwrap().status.success());
    assert!(objects["/tiles/sets/alps.3tz"].body == std::fs::read(local).unwrap());
}

#[test]
fn bucket_that_refuses_is_one_error_before_work_starts() {
    let scratch = tempfile::tempdir().unwrap();
    let denied = "<Error><Code>AccessDenied</Code><Message>no writing here</Message></Error>";
    let buckets = Buckets::start(move |request| match &*request.method {
        "PUT" if request.path().starts_with("/none") => {
            Some(Reply::new(404, "<Error><Code>NoSuchBucket</Code><Message>no such bucket</Message></Error>"))
        }
        "PUT" => Some(Reply::new(403, denied)),
        _ => None,
    });
    let output = generate(&buckets, scratch.path(), "s3://tiles/set", &[]);
    let text = said(&output);
    assert_eq!((output.status.code(), buckets.server.count(), text.trim().lines().count()), (Some(1), 1, 1), "{text}");
    assert!(text.contains("s3://tiles/set/.terrane-gen-probe: the store refuses access"), "{text}");
    assert!(text.contains("AccessDenied: no writing here") && !text.contains("a-key-nobody"), "{text}");
    let output = generate(&buckets, scratch.path(), "s3://none/set", &[]);
    assert!(
        said(&output).contains("s3://none/set/.terrane-gen-probe: ") && said(&output).contains("NoSuchBucket"),
        "{}",
        said(&output)
    );
    for (out, more, expected) in [
        ("https://h/set", &[][..], "sets are written to folders and to s3://"),
        ("s3://tiles/set", &["--update"], "--update has no effect without --dem"),
        ("s3://", &[], "s3://: expected the address of a bucket"),
        ("s3://tiles/set?a", &[], "expected the address of a bucket"),
    ] {
        let output = generate(&buckets, scratch.path(), out, more);
        assert!(said(&output).contains(expected), "{out}: {}", said(&output));
    }
    assert!(is_empty(scratch.path()), "scratch files are left");
}

/// The same command continues, and uploads only what is not there.
#[test]
fn failed_upload_is_continued() {
    let [folder, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let (fails, puts) = (Arc::new(AtomicBool::new(true)), Arc::new(AtomicUsize::new(0)));
    let (failing, count) = (fails.clone(), puts.clone());
    let buckets = Buckets::start(move |request| {
        if request.method != "PUT" {
            return None;
        }
        let number = count.fetch_add(1, Ordering::Relaxed);
        match number {
            // Failures that pass.
            3 => Some(Reply::new(503, "")),
            5 => Some(Reply::new(500, "").how(How::Reset)),
            _ if number > 20 && failing.load(Ordering::Relaxed) => Some(Reply::new(400, "")),
            _ => None,
        }
    });
    let output = generate(&buckets, scratch.path(), "s3://tiles/set", &[]);
    assert!(
        output.status.code() == Some(1) && said(&output).contains("the same command continues"),
        "{}",
        said(&output)
    );
    let expected = plain(folder.path(), &[]);
    let before = set(&buckets, "/tiles/set/");
    assert!(before.len() > 10 && !before.contains_key("tileset.json"), "{:?}", before.keys());
    fails.store(false, Ordering::Relaxed);
    puts.store(100, Ordering::Relaxed);
    let output = generate(&buckets, scratch.path(), "s3://tiles/set", &[]);
    assert!(output.status.success(), "{}", said(&output));
    assert!(set(&buckets, "/tiles/set/") == expected && is_empty(scratch.path()));
    let sent = puts.load(Ordering::Relaxed) - 100;
    assert_eq!(sent, 1 + expected.len() - before.len(), "the probe and the files that were missing");
}

#[test]
fn killed_upload_is_continued() {
    let [folder, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let stalls = Arc::new(AtomicBool::new(true));
    let (stalling, count) = (stalls.clone(), AtomicUsize::new(0));
    let buckets = Buckets::start(move |request| {
        let is_put = request.method == "PUT";
        let is_late = is_put && count.fetch_add(1, Ordering::Relaxed) > 10 && stalling.load(Ordering::Relaxed);
        is_late.then(|| Reply::new(200, "").how(How::Silent))
    });
    let mut command = command(&buckets, scratch.path(), "s3://tiles/set", &[]);
    let mut killed = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    while buckets.server.seen().iter().filter(|request| request.method == "PUT").count() < 12 {
        assert!(killed.try_wait().unwrap().is_none());
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert!(!set(&buckets, "/tiles/set/").contains_key("tileset.json"));
    stalls.store(false, Ordering::Relaxed);
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    assert!(set(&buckets, "/tiles/set/") == plain(folder.path(), &[]) && is_empty(scratch.path()));
}

/// Runs the program on elevation files.
fn from_files(buckets: &Buckets, folder: &Path, out: &str, dem: &[PathBuf], more: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    command.arg(out).args(["--jobs", "2"]).args(more);
    for dem in dem {
        command.arg("--dem").arg(dem);
    }
    command.envs(buckets.environment()).env("TMPDIR", folder).output().unwrap()
}

/// Returns the files of the set that a run in a folder makes.
fn fresh(folder: &Path, dem: &[PathBuf], more: &[&str]) -> BTreeMap<String, Vec<u8>> {
    let out = folder.join("fresh");
    let mut command = Command::new(env!("CARGO_BIN_EXE_terrane-gen"));
    command.arg(&out).args(["--jobs", "2", "--overwrite"]).args(more);
    for dem in dem {
        command.arg("--dem").arg(dem);
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    files_below(&out)
}

/// Kept tiles are neither read nor written, and the others replace those of the old set.
#[test]
fn update_in_a_bucket_sends_only_what_has_changed() {
    let [folder, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let buckets = Buckets::start(|_| None);
    let sets = [
        ("globe", 72, &["--content", "quantized-mesh", "--gzip", "--levels", "11"][..]),
        ("mesh", 12, &["--content", "mesh", "--color", "none", "--gzip", "--aligned"]),
    ];
    // Blocks of meshes take long.
    for (name, side, more) in sets.into_iter().take(if kit::long_tests() { 2 } else { 1 }) {
        let out = format!("s3://tiles/{name}");
        let at = |name: &str, west: f64, seed: u32| hills(folder.path(), name, [west, 46.0], side, seed);
        let dem = [at("a.tif", 7.0, 1), at("b.tif", 20.0, 2)];
        let run = |more: &[&str]| from_files(&buckets, scratch.path(), &out, &dem, more);
        let made = run(more);
        assert!(made.status.success(), "{}", said(&made));
        at("b.tif", 20.0, 3);
        let before = buckets.server.count();
        let updated = run(&[more, &["--update"]].concat());
        assert!(updated.status.success(), "{}", said(&updated));
        let seen = buckets.server.seen();
        let sent = seen[before..].iter().filter(|request| request.method == "PUT").count();
        let mut own = set(&buckets, &format!("/tiles/{name}/"));
        assert!(own.remove("manifest.zip").is_some());
        let expected = fresh(folder.path(), &dem, more);
        assert!(own == expected, "{:?} {:?}", own.keys(), expected.keys());
        assert!(sent < expected.len(), "{sent} of {} files were sent", expected.len());
        assert!(is_empty(scratch.path()), "scratch files are left");
    }
}

#[test]
fn shards_in_a_bucket_merge_to_the_bytes_of_one_run() {
    let [folder, scratch] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let dem = [([7.0, 46.0], "a.tif"), ([7.4, 46.4], "b.tif")].map(|(at, name)| hills(folder.path(), name, at, 8, 1));
    let buckets = Buckets::start(|_| None);
    let run = |more: &[&str]| {
        let more = [&["--levels", "7", "--content", "mesh", "--color", "none"], more].concat();
        from_files(&buckets, scratch.path(), "s3://tiles/a/set", &dem, &more)
    };
    let done = run(&["--shard", "1/2"]);
    assert!(done.status.success(), "{}", said(&done));
    let again = run(&["--shard", "1/2"]);
    assert!(again.status.success() && said(&again).contains("was complete"), "{again:?}");
    let refused = run(&["--merge"]);
    assert!(said(&refused).contains("2/2; make them with --shard"), "{}", said(&refused));
    let plan = run(&["--plan", "2"]);
    let plan: serde_json::Value = serde_json::from_slice(&plan.stdout).unwrap();
    assert_eq!([0, 1].map(|shard| plan["shards"][shard]["complete"].as_bool()), [Some(true), Some(false)], "{plan}");
    assert!(run(&["--shard", "2/2"]).status.success());
    let merged = run(&["--merge"]);
    assert!(merged.status.success(), "{}", said(&merged));
    let mut own = set(&buckets, "/tiles/a/set/");
    assert!(own.remove("manifest.zip").is_some());
    assert!(own == fresh(folder.path(), &dem, &["--levels", "7", "--content", "mesh", "--color", "none"]));
    assert!(set(&buckets, "/tiles/a/set.shard").is_empty(), "shards are removed");
    assert!(is_empty(scratch.path()), "scratch files are left");
}
