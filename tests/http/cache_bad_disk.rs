//! The cache on a disk that is full, read-only or fails while in use, or with a clock that jumps. The flight continues,
//! and the failure is counted and reported once.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::time::{Duration, SystemTime};

use kit::pager::{Run, above};
use kit::process::test_name;
use kit::server::{Reply, Server};
use kit::skip::skipped;
use kit::tile_sets::{WORLD_M, write_quadtree};
use terrane::fetch::{CacheConfig, CacheStats, HttpClient, HttpConfig, Limits};
use terrane::pager::PagerConfig;

/// Log lines of warnings and errors.
static SAID: Mutex<Vec<String>> = Mutex::new(Vec::new());

struct Listen;

impl log::Log for Listen {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        metadata.level() <= log::Level::Warn && metadata.target().starts_with("terrane")
    }

    fn log(&self, record: &log::Record<'_>) {
        if self.enabled(record.metadata()) {
            SAID.lock().unwrap().push(record.args().to_string());
        }
    }

    fn flush(&self) {}
}

/// Serves a set of 341 tiles that may be cached for a while.
fn server() -> Server {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let read =
        |path: PathBuf| (format!("/{}", path.file_name().unwrap().to_str().unwrap()), std::fs::read(&path).unwrap());
    let files: HashMap<String, Vec<u8>> =
        std::fs::read_dir(folder.path()).unwrap().map(|e| read(e.unwrap().path())).collect();
    Server::start(move |r| match files.get(r.path()) {
        // All tiles differ, so that each needs separate space.
        Some(bytes) if r.path().ends_with(".glb") => {
            let padding = r.path().as_bytes().repeat(400);
            let mut body = bytes.clone();
            let length = (body.len() + padding.len()).next_multiple_of(4);
            // The bytes differ in a chunk of an unknown type at the end, which readers ignore.
            body.extend_from_slice(&((length - bytes.len()) as u32).to_le_bytes());
            body.extend_from_slice(b"PADD");
            body.extend_from_slice(&padding);
            body.resize(length + 8, 0);
            let all = body.len() as u32;
            body[8..12].copy_from_slice(&all.to_le_bytes());
            Reply::ok(body).with("Cache-Control", "max-age=1000").with("ETag", "\"1\"")
        }
        Some(bytes) => Reply::ok(bytes.clone()).with("Cache-Control", "max-age=1000").with("ETag", "\"1\""),
        None => Reply::new(404, ""),
    })
}

/// Loads all tiles through a cache and returns the number of drawn tiles.
fn fly(url: &str, folder: &Path) -> (u32, CacheStats) {
    let http = HttpConfig { cache: Some(CacheConfig::new(folder)), ..HttpConfig::default() };
    let mut run = Run::new(&format!("{url}/"), PagerConfig { http, ..PagerConfig::default() });
    // Each level is loaded separately. Tiles in flight need not arrive once all their replacements are loaded.
    for halvings in 0..20 {
        run.max_sse_px = 0.1 * f64::from(1 << (19 - halvings));
        run.settle(above(WORLD_M) + glam::DVec3::new(WORLD_M / 2.0, WORLD_M / 2.0, 0.0));
    }
    assert_eq!(run.pager.stats().failed, 0, "{:?}", run.pager.errors());
    // Pending writes complete and are counted before the pager ends.
    let end = std::time::Instant::now() + kit::MAX_WAIT;
    let mut stats = run.pager.cache_stats().unwrap();
    while stats.hits + stats.stored + stats.write_errors < 342 && std::time::Instant::now() < end {
        std::thread::sleep(Duration::from_millis(2));
        stats = run.pager.cache_stats().unwrap();
    }
    (run.stage.counters.tiles_drawn, stats)
}

/// The body of the tests below, which run it in separate processes.
#[test]
fn flies_as_another_process() {
    let Ok(url) = std::env::var("TERRANE_TEST_DISK_URL") else { return };
    log::set_logger(&Listen).unwrap();
    log::set_max_level(log::LevelFilter::Warn);
    let folder = PathBuf::from(std::env::var_os("TERRANE_TEST_DISK_FOLDER").unwrap());
    let (tiles, stats) = fly(&url, &folder);
    println!("FLOWN {tiles} {} {} {}", stats.write_errors, stats.hits, stats.stored);
    for line in SAID.lock().unwrap().iter() {
        println!("SAID {line}");
    }
}

/// The privileges of the process that flies.
#[derive(Clone, Copy)]
enum Privileges {
    Own,
    /// The process may mount a disk that only it sees.
    Mounts,
    /// File permissions apply to the process, even if root runs the tests.
    None,
}

struct Flown {
    tiles: u32,
    write_errors: u64,
    hits: u64,
    stored: u64,
    said: Vec<String>,
}

/// Flies in a separate process for which a shell has mounted a disk; `None` if this user may not mount one.
fn flown(privileges: Privileges, make: &str, url: &str, disk: &Path, cache: &Path) -> Option<Flown> {
    let exe = std::env::current_exe().unwrap();
    let script = format!(
        "{make} || exit 77; exec {} --exact {} --nocapture",
        exe.to_str().unwrap(),
        test_name(module_path!(), "flies_as_another_process")
    );
    let mut command = match privileges {
        Privileges::Own => Command::new("sh"),
        Privileges::Mounts | Privileges::None => Command::new("unshare"),
    };
    match privileges {
        Privileges::Own => {}
        Privileges::Mounts => drop(command.args(["--map-root-user", "--mount", "sh"])),
        Privileges::None => drop(command.args(["--user", "sh"])),
    }
    command.args(["-c", &script]);
    let output =
        command.env("D", disk).env("TERRANE_TEST_DISK_URL", url).env("TERRANE_TEST_DISK_FOLDER", cache).output();
    let output = match output {
        Ok(output) => output,
        Err(error) => {
            skipped(format!("cannot mount a disk for one process: {error}"));
            return None;
        }
    };
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    if output.status.code() == Some(77) || err.contains("unshare failed") {
        skipped(format!("cannot mount a disk for one process: {}", err.trim()));
        return None;
    }
    assert!(output.status.success(), "{out}{err}");
    let line = out.lines().find_map(|l| l.split_once("FLOWN ")).unwrap_or_else(|| panic!("{out}{err}")).1;
    let numbers: Vec<u64> = line.split(' ').map(|n| n.parse().unwrap()).collect();
    let said = out.lines().filter_map(|l| l.split_once("SAID ")).map(|(_, text)| text.to_owned()).collect();
    Some(Flown { tiles: numbers[0] as u32, write_errors: numbers[1], hits: numbers[2], stored: numbers[3], said })
}

#[test]
fn full_disk_does_not_stop_a_flight() {
    let (server, disk) = (server(), tempfile::tempdir().unwrap());
    let whole = tempfile::tempdir().unwrap();
    let (tiles, stats) = fly(&server.url, whole.path());
    assert!(tiles > 20 && stats.stored == 342 && stats.write_errors == 0, "{tiles} {stats:?}");
    let full = "No space left";
    let cache = disk.path().join("cache");
    for (what, privileges, make, begins_full, why) in [
        ("fills up", Privileges::Mounts, "mount -t tmpfs -o size=600k none $D", false, full),
        (
            "is full",
            Privileges::Mounts,
            "mount -t tmpfs -o size=64k none $D && { dd if=/dev/zero of=$D/f bs=4k 2>/dev/null; true; }",
            true,
            full,
        ),
        (
            "has no place for a file",
            Privileges::Mounts,
            "mount -t tmpfs -o size=8m,nr_inodes=2 none $D && touch $D/f",
            true,
            full,
        ),
        ("takes no file larger than that", Privileges::Own, "trap '' XFSZ; ulimit -f 2", true, "too large"),
    ] {
        let Some(flown) = flown(privileges, make, &server.url, disk.path(), &cache) else { continue };
        assert_eq!(flown.tiles, tiles, "{what}");
        assert!(flown.write_errors > 20, "{what}: {}", flown.write_errors);
        assert_eq!(flown.stored == 0, begins_full, "{what}: {}", flown.stored);
        assert!(flown.said.len() == 1 && flown.said[0].contains(why), "{what}: {:?}", flown.said);
        assert!(flown.said[0].contains(cache.to_str().unwrap()), "{what}: {:?}", flown.said);
    }
}

/// Regression: eviction followed a write, which a full disk refuses, so that old entries stayed forever.
#[test]
fn cache_evicts_entries_on_a_full_disk() {
    let (server, disk) = (server(), tempfile::tempdir().unwrap());
    let cache = disk.path().join("cache");
    // The disk holds unused bodies and has no free space.
    let old = "mount -t tmpfs -o size=1m none $D && mkdir -p $D/cache/blobs/aa $D/cache/tmp && \
        printf 'terrane cache 1\\n' > $D/cache/terrane-cache && \
        for i in $(seq 300); do head -c 4096 /dev/zero > $D/cache/blobs/aa/$(printf 'aa%062d' $i) || break; done \
        2>/dev/null; true";
    let Some(flown) = flown(Privileges::Mounts, old, &server.url, disk.path(), &cache) else { return };
    // A tenth of the disk is freed at once.
    assert!(flown.stored >= 5, "{} {}", flown.stored, flown.write_errors);
}

#[test]
fn read_only_cache_is_read() {
    let server = server();
    for (privileges, make, restore, why) in [
        (Privileges::Mounts, "mount --bind $D $D && mount -o remount,ro,bind $D", "true", "Read-only"),
        (Privileges::None, "chmod -R a-w $D", "chmod -R u+w $D", "ermission denied"),
    ] {
        let disk = tempfile::tempdir().unwrap();
        let (tiles, _) = fly(&server.url, disk.path());
        let asked = server.count();
        let fly = || {
            let flown = flown(privileges, make, &server.url, disk.path(), disk.path());
            let restored = Command::new("sh").args(["-c", restore]).env("D", disk.path()).status();
            assert!(restored.unwrap().success());
            flown
        };
        let Some(flown) = fly() else { continue };
        assert_eq!((flown.tiles, flown.hits, flown.write_errors), (tiles, 342, 0), "{why}: {:?}", flown.said);
        assert_eq!((server.count(), flown.said.len()), (asked, 0), "fresh entries are not requested");
        // Without entries everything is fetched, nothing can be stored, and that is reported once.
        for part in ["keys", "blobs"] {
            std::fs::remove_dir_all(disk.path().join(part)).unwrap();
        }
        let Some(flown) = fly() else { continue };
        assert_eq!((flown.tiles, flown.hits, flown.stored, flown.write_errors), (tiles, 0, 0, 342));
        assert!(flown.said.len() == 1 && flown.said[0].contains(why), "{:?}", flown.said);
    }
}

/// Run by the test below in a process to which permissions apply.
#[test]
fn opens_as_another_process() {
    let Some(cache) = std::env::var_os("TERRANE_TEST_CLOSED_FOLDER").map(PathBuf::from) else { return };
    let config = HttpConfig { cache: Some(CacheConfig::new(&cache)), ..HttpConfig::default() };
    let error = HttpClient::new(&config).map(|_| ()).unwrap_err();
    assert!(error.uri() == cache.to_str().unwrap() && error.reason().contains("ermission denied"), "{error}");
    println!("REFUSED");
}

#[test]
fn permission_denied_is_reported_before_the_flight() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = tempfile::tempdir().unwrap();
    std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(0o500)).unwrap();
    let mut command = Command::new("unshare");
    command
        .arg("--user")
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", &test_name(module_path!(), "opens_as_another_process")]);
    let output = command.arg("--nocapture").env("TERRANE_TEST_CLOSED_FOLDER", folder.path().join("cache")).output();
    let text =
        output.as_ref().map_or(String::new(), |o| String::from_utf8_lossy(&[&*o.stdout, &*o.stderr].concat()).into());
    if output.is_err() || text.contains("unshare failed") {
        skipped(format!("cannot start a process without privileges: {}", text.trim()));
        return;
    }
    assert!(text.contains("REFUSED"), "{text}");
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let paths = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    paths.flat_map(|p| if p.is_dir() { files(&p) } else { vec![p] }).collect()
}

fn get(client: &HttpClient, runtime: &tokio::runtime::Runtime, url: &str) -> Vec<u8> {
    runtime.block_on(async {
        let body = client.get(url, &Limits::default()).await.unwrap();
        client.flush().await;
        body.bytes
    })
}

#[test]
fn entries_that_become_corrupt_in_use_are_requested_again() {
    let server = Server::start(|r| Reply::ok(r.path().repeat(300)).with("Cache-Control", "max-age=1000"));
    let folder = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let http = HttpConfig { cache: Some(CacheConfig::new(folder.path())), ..HttpConfig::default() };
    let client = HttpClient::new(&http).unwrap();
    let names: Vec<String> = (0..20).map(|i| format!("/tile-{i}")).collect();
    for turn in 0..30usize {
        for (i, name) in names.iter().enumerate() {
            assert_eq!(get(&client, &runtime, &format!("{}{name}", server.url)), name.repeat(300).as_bytes());
            // After each answer another file is damaged, never the marker.
            let found: Vec<PathBuf> =
                ["keys", "blobs"].iter().flat_map(|part| files(&folder.path().join(part))).collect();
            let Some(path) = found.get((turn * 7 + i * 13) % found.len().max(1)) else { continue };
            match (turn + i) % 6 {
                0 => std::fs::write(path, "").unwrap(),
                1 => std::fs::write(path, [0xff; 4000]).unwrap(),
                2 => std::fs::remove_file(path).unwrap(),
                3 => {
                    std::fs::remove_file(path).unwrap();
                    std::fs::create_dir(path).unwrap();
                }
                4 => {
                    let mut bytes = std::fs::read(path).unwrap_or_default();
                    if let Some(byte) = bytes.last_mut() {
                        *byte ^= 1;
                    }
                    let _ = std::fs::write(path, bytes);
                }
                _ => drop(std::fs::remove_dir_all(path.parent().unwrap())),
            }
        }
    }
    let stats = client.cache().unwrap().stats();
    assert!(stats.corrupt > 20 && stats.hits > 20 && stats.misses > 20, "{stats:?}");
}

#[test]
fn any_file_times_are_accepted() {
    let server = Server::start(|r| Reply::ok(r.path().repeat(2000)).with("Cache-Control", "max-age=1000"));
    let folder = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let small = CacheConfig { max_bytes: Some(200_000), ..CacheConfig::new(folder.path()) };
    let http = HttpConfig { cache: Some(small), ..HttpConfig::default() };
    let year = Duration::from_secs(365 * 24 * 3600);
    for (turn, time) in
        [SystemTime::now() + 50 * year, SystemTime::UNIX_EPOCH, SystemTime::now() - 30 * year].into_iter().enumerate()
    {
        let client = HttpClient::new(&http).unwrap();
        for i in 0..40 {
            let name = format!("/tile-{turn}-{i}");
            assert_eq!(get(&client, &runtime, &format!("{}{name}", server.url)), name.repeat(2000).as_bytes());
        }
        let last = format!("{}/tile-{turn}-39", server.url);
        let asked = server.count();
        get(&client, &runtime, &last);
        assert_eq!(server.count(), asked, "the last entry is found");
        let parts = ["keys", "blobs"].map(|part| files(&folder.path().join(part)));
        let bytes: u64 = parts.iter().flatten().map(|p| p.metadata().unwrap().len()).sum();
        assert!(bytes <= 220_000, "{bytes}");
        for path in files(folder.path()) {
            std::fs::File::options().write(true).open(path).unwrap().set_modified(time).unwrap();
        }
        get(&client, &runtime, &last);
        assert_eq!(server.count(), asked, "and with any file time");
    }
}
