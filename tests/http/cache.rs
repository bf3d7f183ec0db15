//! The cache on disk: fresh and stale entries, corrupt files, several processes, a killed process, and its size.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::{Duration, Instant};

use kit::process::test_name;
use kit::server::{Reply, Server};
use terrane::fetch::{
    CacheConfig, CacheInfo, CacheStats, CacheVerified, DiskCache, HttpClient, HttpConfig, IoError, Limits,
};
use terrane::formats::ReadOptions;
use terrane::pager::{DatabasePager, PagerConfig};

fn config(cache: CacheConfig) -> HttpConfig {
    HttpConfig { cache: Some(cache), max_retries: 0, ..HttpConfig::default() }
}

/// Returns a client like that of a new process.
struct Client(HttpClient, tokio::runtime::Runtime);

impl Client {
    fn new(cache: CacheConfig) -> Self {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        Self(HttpClient::new(&config(cache)).unwrap(), runtime)
    }

    fn at(folder: &Path) -> Self {
        Self::new(CacheConfig::new(folder))
    }

    fn offline(folder: &Path) -> Self {
        Self::new(CacheConfig { offline: true, ..CacheConfig::new(folder) })
    }

    fn try_get(&self, url: &str) -> Result<Vec<u8>, IoError> {
        self.1.block_on(async {
            let body = self.0.get(url, &Limits::default()).await?;
            self.0.flush().await;
            Ok(body.bytes)
        })
    }

    fn get(&self, url: &str) -> Vec<u8> {
        self.try_get(url).unwrap()
    }

    fn stats(&self) -> CacheStats {
        self.0.cache().unwrap().stats()
    }
}

fn cache_at(folder: &Path) -> DiskCache {
    DiskCache::open(&CacheConfig::new(folder)).unwrap()
}

/// Returns all files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.path().is_dir() {
            found.extend(files(&entry.path()));
        } else {
            found.push(entry.path());
        }
    }
    found.sort();
    found
}

const DATE: &str = "Sun, 09 Sep 2001 01:46:40 GMT";

/// Answers with the path. The first word of the path gives its caching headers.
fn server() -> Server {
    Server::start(|r| {
        let body = Reply::ok(r.path().repeat(100));
        match r.path().split('/').nth(1).unwrap() {
            "fresh" => body.with("Cache-Control", "max-age=1000"),
            "tagged" if r.header("if-none-match") == Some("\"t1\"") => Reply::new(304, ""),
            "tagged" => body.with("ETag", "\"t1\""),
            "dated" if r.header("if-modified-since") == Some(DATE) => Reply::new(304, ""),
            "dated" => body.with("Last-Modified", DATE),
            "renewed" if r.header("if-none-match") == Some("\"t1\"") => {
                Reply::new(304, "").with("Cache-Control", "max-age=1000")
            }
            "renewed" => body.with("ETag", "\"t1\""),
            "never" => body.with("Cache-Control", "no-store, max-age=1000"),
            "changing" => {
                Reply::ok(format!("body {}", r.nth)).with("ETag", format!("\"{}\"", r.nth)).with("X", r.path())
            }
            "failing" if r.nth > 0 => Reply::new(503, ""),
            "failing" => body,
            _ => body,
        }
    })
}

#[test]
fn fresh_entries_need_no_request_and_stale_ones_are_revalidated() {
    let (server, folder) = (server(), tempfile::tempdir().unwrap());
    for (path, asked, stats) in [
        // Expected (first, hits, revalidated, misses) of the second and third client.
        ("fresh/a", [1, 0, 0], [(1, 0, 0), (1, 0, 0)]),
        ("tagged/a", [1, 1, 1], [(0, 1, 0), (0, 1, 0)]),
        ("dated/a", [1, 1, 1], [(0, 1, 0), (0, 1, 0)]),
        ("renewed/a", [1, 1, 0], [(0, 1, 0), (1, 0, 0)]),
        ("never/a", [1, 1, 1], [(0, 0, 1), (0, 0, 1)]),
        ("plain/a", [1, 1, 1], [(0, 0, 1), (0, 0, 1)]),
    ] {
        let url = format!("{}/{path}", server.url);
        for i in 0..3 {
            let (client, before) = (Client::at(folder.path()), server.count());
            assert_eq!(client.get(&url), format!("/{path}").repeat(100).into_bytes(), "{path}");
            assert_eq!(server.count() - before, asked[i], "{path}, client {i}");
            let s = client.stats();
            let expected = if i == 0 { (0, 0, 1) } else { stats[i - 1] };
            assert_eq!((s.hits, s.revalidated, s.misses), expected, "{path}, client {i}");
        }
    }
    let url = format!("{}/changing/a", server.url);
    let bodies: Vec<_> = (0..3).map(|_| Client::at(folder.path()).get(&url)).collect();
    assert_eq!(bodies, [b"body 0", b"body 1", b"body 2"]);
    // Five entries are stored, two of them under different names with one body.
    assert_eq!(cache_at(folder.path()).info().unwrap().entries, 6);
}

/// Regression: only the lifetime of the final answer counted, so that an old target of "latest" was shown for a year.
#[test]
fn answer_is_fresh_only_as_long_as_its_redirects() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(|r| {
        let to = |status: u16| Reply::new(status, "").with("Location", if r.nth == 0 { "/v1" } else { "/v2" });
        match r.path() {
            "/latest" => to(302),
            "/for-now" => to(307).with("Cache-Control", "max-age=1000"),
            "/moved" => to(301),
            "/secret" => to(308).with("Cache-Control", "no-store"),
            path => Reply::ok(path).with("Cache-Control", "max-age=100000, immutable"),
        }
    });
    for (path, again) in [("latest", "/v2"), ("for-now", "/v1"), ("moved", "/v1"), ("secret", "/v2")] {
        let url = format!("{}/{path}", server.url);
        assert_eq!(Client::at(folder.path()).get(&url), b"/v1", "{path}");
        assert_eq!(Client::at(folder.path()).get(&url), again.as_bytes(), "{path}");
    }
}

#[test]
fn offline_sends_no_request() {
    let (server, folder) = (server(), tempfile::tempdir().unwrap());
    let url = |path: &str| format!("{}/{path}", server.url);
    let online = Client::at(folder.path());
    for path in ["tagged/a", "plain/a", "fresh/a", "failing/a", "never/a"] {
        online.get(&url(path));
    }
    assert!(online.try_get(&url("failing/a")).is_err(), "the failure is reported");
    let (before, offline) = (server.count(), Client::offline(folder.path()));
    for path in ["tagged/a", "plain/a", "fresh/a", "failing/a"] {
        assert_eq!(offline.get(&url(path)), format!("/{path}").repeat(100).into_bytes());
    }
    for path in ["never/a", "tagged/other"] {
        let error = offline.try_get(&url(path)).unwrap_err();
        assert!(matches!(error, IoError::Offline { .. }) && !error.is_transient(), "{error:?}");
    }
    assert_eq!(server.count(), before);
    assert_eq!((offline.stats().hits, offline.stats().misses), (4, 2));
}

#[test]
fn equal_bodies_are_stored_once_and_unchanged() {
    use std::io::Write as _;
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(&vec![9; 50_000]).unwrap();
    let packed = encoder.finish().unwrap();
    let size = packed.len() as u64;
    let server = Server::start(move |_| {
        Reply::ok(packed.clone()).with("Content-Encoding", "gzip").with("Cache-Control", "max-age=1000")
    });
    let folder = tempfile::tempdir().unwrap();
    let client = Client::at(folder.path());
    for i in 0..10 {
        assert_eq!(client.get(&format!("{}/{i}", server.url)), vec![9; 50_000]);
    }
    let info = cache_at(folder.path()).info().unwrap();
    assert_eq!((info.entries, info.bodies, info.fresh), (10, 1, 10));
    assert_eq!(Client::at(folder.path()).get(&format!("{}/3", server.url)), vec![9; 50_000]);
    assert_eq!((client.stats().bytes_stored, server.count()), (10 * size, 10));
}

#[test]
fn corrupt_files_are_found_and_requested_again() {
    let (server, folder) = (server(), tempfile::tempdir().unwrap());
    let url = format!("{}/fresh/a", server.url);
    let body = Client::at(folder.path()).get(&url);
    for part in ["keys", "blobs"] {
        for damage in [
            (|bytes| bytes.truncate(bytes.len() / 2)) as fn(&mut Vec<u8>),
            |bytes| bytes.clear(),
            |bytes| {
                let at = bytes.len() / 2;
                bytes[at] ^= 1;
            },
            |bytes| bytes.push(0),
        ] {
            let file = files(&folder.path().join(part)).remove(0);
            let mut bytes = std::fs::read(&file).unwrap();
            damage(&mut bytes);
            std::fs::write(&file, bytes).unwrap();
            let (client, before) = (Client::at(folder.path()), server.count());
            assert_eq!(client.get(&url), body);
            assert_eq!((client.stats().corrupt, server.count() - before), (1, 1), "{part}");
            assert_eq!(Client::at(folder.path()).get(&url), body);
            assert_eq!(server.count() - before, 1, "it is cached again");
        }
        std::fs::remove_file(files(&folder.path().join(part)).remove(0)).unwrap();
        assert_eq!(Client::at(folder.path()).get(&url), body);
    }
}

#[test]
fn verify_and_clear_remove_entries() {
    let (server, folder) = (server(), tempfile::tempdir().unwrap());
    let client = Client::at(folder.path());
    for i in 0..6 {
        client.get(&format!("{}/fresh/{i}", server.url));
    }
    let cache = cache_at(folder.path());
    assert_eq!(cache.verify().unwrap(), CacheVerified { whole: 12, broken: 0, orphans: 0 });
    let (keys, blobs) = (files(&folder.path().join("keys")), files(&folder.path().join("blobs")));
    std::fs::write(&keys[0], "odd").unwrap();
    std::fs::write(&blobs[0], "odd").unwrap();
    std::fs::write(folder.path().join("blobs/notes.txt"), "not a file of the cache").unwrap();
    let verified = cache.verify().unwrap();
    assert_eq!(verified.broken, 2, "{verified:?}");
    assert!(
        verified.orphans == 1 + 1 || verified.orphans == 0,
        "one body and one entry without its other half: {verified:?}"
    );
    assert_eq!(cache.verify().unwrap().broken, 0);
    // Folders instead of files cannot be read. The other entries are still checked.
    let in_place_of = |path: &std::path::Path| {
        std::fs::remove_file(path).unwrap();
        std::fs::create_dir_all(path.join("inside")).unwrap();
    };
    let [keys, blobs] = ["keys", "blobs"].map(|part| files(&folder.path().join(part)));
    let blobs: Vec<_> = blobs.into_iter().filter(|path| !path.ends_with("notes.txt")).collect();
    let others = blobs.len() as u64 - 1;
    in_place_of(&blobs[0]);
    let verified = cache.verify().unwrap();
    assert_eq!(verified, CacheVerified { whole: 2 * others, broken: 1, orphans: 1 });
    let left: Vec<_> = files(&folder.path().join("keys"));
    assert_eq!(left.len(), keys.len() - 1);
    in_place_of(&left[0]);
    assert!(cache.clear().unwrap() > 0);
    let max_bytes = cache.max_bytes();
    assert_eq!(cache.info().unwrap(), CacheInfo { max_bytes, ..CacheInfo::default() });
    assert!(folder.path().join("blobs/notes.txt").exists(), "nothing else is removed");
}

#[test]
fn least_recently_used_entries_are_evicted_first() {
    let server = Server::start(|r| {
        let mut body = vec![0; 10_000];
        body[..r.target.len()].copy_from_slice(r.target.as_bytes());
        Reply::ok(body).with("Cache-Control", "max-age=1000")
    });
    let folder = tempfile::tempdir().unwrap();
    let small = || CacheConfig { max_bytes: Some(160_000), ..CacheConfig::new(folder.path()) };
    let client = Client::new(small());
    let url = |i: usize| format!("{}/{i}", server.url);
    for i in 0..10 {
        client.get(&url(i));
    }
    // This entry was used again, although it was written first.
    std::thread::sleep(Duration::from_millis(20));
    assert_eq!(client.get(&url(0)).len(), 10_000);
    assert_eq!(server.count(), 10);
    for i in 10..30 {
        std::thread::sleep(Duration::from_millis(2));
        client.get(&url(i));
        let info = cache_at(folder.path()).info().unwrap();
        assert!(info.bytes <= 160_000 + 10_500, "{info:?}");
    }
    assert!(client.stats().evicted > 0);
    let kept: Vec<usize> =
        (0..30).filter(|i| Client::new(CacheConfig { offline: true, ..small() }).try_get(&url(*i)).is_ok()).collect();
    assert!(kept.len() >= 10 && kept.contains(&29) && !kept.contains(&1), "{kept:?}");
    let newest: Vec<usize> = (30 - kept.len()..30).collect();
    assert_eq!(kept, newest, "the most recently used ones");
    // An entry that is large relative to the cache does not evict all others.
    let large = Server::start(|_| Reply::ok(vec![1; 30_000]).with("Cache-Control", "max-age=1000"));
    client.get(&large.url);
    assert_eq!(client.get(&large.url).len(), 30_000);
    assert_eq!((large.count(), client.stats().too_large), (2, 2));
}

/// A program without a size limit keeps the larger cache of an earlier one. Regression: it evicted entries.
#[test]
fn size_of_the_cache_is_remembered() {
    let folder = tempfile::tempdir().unwrap();
    let size =
        |max_bytes| DiskCache::open(&CacheConfig { max_bytes, ..CacheConfig::new(folder.path()) }).unwrap().max_bytes();
    let usual = 2 << 30;
    assert_eq!(size(None), usual);
    assert_eq!([Some(9_000_000_000), None, Some(5000), None].map(size), [9_000_000_000, 9_000_000_000, 5000, 5000]);
    std::fs::write(folder.path().join("limit"), "much").unwrap();
    assert_eq!([None, Some(77), None].map(size), [usual, 77, 77]);
    assert_eq!(cache_at(folder.path()).info().unwrap().max_bytes, 77);
    // A folder with only that file is a cache whose creation was interrupted.
    std::fs::remove_file(folder.path().join("terrane-cache")).unwrap();
    assert_eq!(size(None), 77);
}

/// Tags of different servers are different, even if their text is equal.
#[test]
fn validators_are_sent_only_to_their_server() {
    let place = |name: &'static str| {
        Server::start(move |r| match r.header("if-none-match") {
            Some("\"1\"") => Reply::new(304, ""),
            _ => Reply::ok(name).with("ETag", "\"1\""),
        })
    };
    let (old, new, folder) = (place("old"), place("new"), tempfile::tempdir().unwrap());
    let urls = [&old, &old, &new, &new].map(|server| server.url.clone());
    // The URL is signed anew each time.
    let redirecting = Server::start(move |r| {
        Reply::new(302, "").with("Location", format!("{}/tile?signature={}", urls[r.nth], r.nth))
    });
    let allowed_hosts = [&old, &new].map(|server| server.host().parse().unwrap()).to_vec();
    let config = HttpConfig { allowed_hosts, ..config(CacheConfig::new(folder.path())) };
    let client = || Client(HttpClient::new(&config).unwrap(), Client::at(folder.path()).1);
    let bodies = [(); 4].map(|()| client().get(&format!("{}/a", redirecting.url)));
    assert_eq!(bodies, [b"old", b"old", b"new", b"new"].map(|body| body.to_vec()));
    let asked_with = |server: &Server| {
        server.seen().iter().map(|r| r.header("if-none-match").map(str::to_owned)).collect::<Vec<_>>()
    };
    let tag = || Some("\"1\"".to_owned());
    assert_eq!((asked_with(&old), asked_with(&new)), (vec![None, tag()], vec![None, tag()]));
    assert!(asked_with(&redirecting).iter().all(Option::is_none));
}

/// "Not modified" counts for a server's concurrency limit. Regression: the limit stayed at eight.
#[test]
fn not_modified_answers_raise_the_concurrency_limit() {
    let (server, folder) = (server(), tempfile::tempdir().unwrap());
    let client = Client::at(folder.path());
    let asked = |path: &str| {
        let url = format!("{}/{path}/a", server.url);
        client.get(&url);
        let body = client.1.block_on(client.0.get(&url, &Limits::default())).unwrap();
        (body.asked, body.network_bytes > 0)
    };
    assert_eq!(["never", "tagged", "fresh"].map(asked), [(true, true), (true, false), (false, false)]);
}

#[test]
fn uses_of_entries_are_remembered() {
    let server = Server::start(|r| {
        let mut body = vec![0; 10_000];
        body[..r.target.len()].copy_from_slice(r.target.as_bytes());
        Reply::ok(body).with("Cache-Control", "max-age=1000")
    });
    let folder = tempfile::tempdir().unwrap();
    let small = || CacheConfig { max_bytes: Some(130_000), ..CacheConfig::new(folder.path()) };
    let url = |i: usize| format!("{}/{i}", server.url);
    let client = Client::new(small());
    for i in 0..10 {
        client.get(&url(i));
        std::thread::sleep(Duration::from_millis(5));
    }
    client.get(&url(0));
    for i in 10..14 {
        client.get(&url(i));
    }
    let offline = Client::new(CacheConfig { offline: true, ..small() });
    assert!(offline.try_get(&url(0)).is_ok(), "written first, but used last");
    assert!(offline.try_get(&url(1)).is_err());
}

#[test]
fn cache_that_cannot_be_written_is_not_used() {
    let (server, folder) = (server(), tempfile::tempdir().unwrap());
    let cache = folder.path().join("cache");
    let url = format!("{}/fresh/a", server.url);
    let body = Client::at(&cache).get(&url);
    std::fs::remove_dir_all(cache.join("tmp")).unwrap();
    // Nothing can be created below a file.
    std::fs::write(cache.join("tmp"), "").unwrap();
    let client = Client::at(&cache);
    assert_eq!(client.get(&url), body, "existing entries can be read");
    assert_eq!(client.get(&format!("{}/fresh/b", server.url)), b"/fresh/b".repeat(100));
    assert_eq!((client.stats().hits, client.stats().write_errors), (1, 1));
    // A folder with other files is not changed.
    let home = tempfile::tempdir().unwrap();
    std::fs::write(home.path().join("letter"), "dear").unwrap();
    let error = HttpClient::new(&config(CacheConfig::new(home.path()))).unwrap_err();
    assert!(matches!(error, IoError::File { .. }), "{error:?}");
}

#[test]
fn secrets_are_not_written_to_disk() {
    let (server, folder) = (server(), tempfile::tempdir().unwrap());
    let credential = terrane::fetch::Credential::query(&server.url, "key", "hidden1").unwrap();
    let config = HttpConfig { credentials: vec![credential], ..config(CacheConfig::new(folder.path())) };
    let client = HttpClient::new(&config).unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        client.get(&format!("{}/fresh/a?session=hidden2", server.url), &Limits::default()).await.unwrap();
        client.flush().await;
    });
    assert!(server.seen()[0].target.contains("hidden1") && server.seen()[0].target.contains("hidden2"));
    let all = files(folder.path());
    assert!(all.len() >= 3);
    for file in all {
        let bytes = std::fs::read(&file).unwrap();
        assert!(!bytes.windows(6).any(|w| w == b"hidden"), "{}", file.display());
    }
}

/// The body of the two tests below, which run it in separate processes.
#[test]
fn another_process() {
    let Some(folder) = std::env::var_os("CACHE_FOLDER") else { return };
    let url = std::env::var("CACHE_URL").unwrap();
    let client = Client::new(CacheConfig { max_bytes: Some(400_000), ..CacheConfig::new(folder) });
    let [turns, paths] =
        ["CACHE_TURNS", "CACHE_PATHS"].map(|name| std::env::var(name).unwrap().parse::<usize>().unwrap());
    for i in 0..turns {
        let path = format!("/{}", i * 7 % paths);
        let body = client.get(&format!("{url}{path}"));
        assert_eq!(body, content(&path), "{path}");
    }
}

fn content(path: &str) -> Vec<u8> {
    path.bytes().cycle().take(10_000 + path.len() * 100).collect()
}

/// Starts processes that each make `turns` requests, in turn for `paths` bodies of about 10 kB.
fn processes(folder: &Path, url: &str, count: usize, [turns, paths]: [usize; 2]) -> Vec<std::process::Child> {
    (0..count)
        .map(|_| {
            Command::new(std::env::current_exe().unwrap())
                .args(["--exact", &test_name(module_path!(), "another_process"), "--test-threads", "1"])
                .env("CACHE_FOLDER", folder)
                .env("CACHE_URL", url)
                .env("CACHE_TURNS", turns.to_string())
                .env("CACHE_PATHS", paths.to_string())
                .stdout(std::process::Stdio::null())
                .spawn()
                .unwrap()
        })
        .collect()
}

fn content_server() -> Server {
    Server::start(|r| Reply::ok(content(&r.target)).with("Cache-Control", "max-age=1000"))
}

#[test]
fn several_processes_share_one_cache() {
    let (server, folder) = (content_server(), tempfile::tempdir().unwrap());
    for mut child in processes(folder.path(), &server.url, 4, [300, 60]) {
        assert!(child.wait().unwrap().success());
    }
    let cache = cache_at(folder.path());
    let info = cache.info().unwrap();
    // The size may exceed the limit by a sixteenth and one body for each process.
    assert!(info.bytes < 400_000 + 4 * (25_000 + 11_000), "{info:?}");
    let verified = cache.verify().unwrap();
    assert_eq!(verified.broken, 0, "{verified:?}");
    assert!(verified.whole > 20, "{verified:?}");
}

#[test]
fn killed_process_leaves_no_corrupt_entries() {
    let (server, folder) = (content_server(), tempfile::tempdir().unwrap());
    for round in 0..6 {
        // There are enough bodies that requests never end, even if each round is killed before the first eviction.
        let mut children = processes(folder.path(), &server.url, 2, [1_000_000, 600]);
        let before = server.count();
        while server.count() < before + 20 {
            std::thread::sleep(Duration::from_millis(1));
            assert!(children.iter_mut().all(|c| c.try_wait().unwrap().is_none()), "round {round}");
        }
        std::thread::sleep(Duration::from_millis(3 * round));
        for mut child in children {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
    let client = Client::new(CacheConfig { max_bytes: Some(400_000), ..CacheConfig::new(folder.path()) });
    for i in 0..60 {
        let path = format!("/{i}");
        assert_eq!(client.get(&format!("{}{path}", server.url)), content(&path));
    }
    assert_eq!(client.stats().corrupt, 0);
    assert_eq!(cache_at(folder.path()).verify().unwrap().broken, 0);
}

/// Serves a set of one tile, and counts its requests.
fn one_tile(first_is_a_page: bool) -> Server {
    let glb = terrane::formats::writers::write_glb(&terrane::formats::writers::GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..terrane::formats::writers::GlbMesh::default()
    });
    Server::start(move |r| {
        let kept = |body: Vec<u8>| Reply::ok(body).with("Cache-Control", "max-age=1000");
        match r.path() {
            "/tileset.json" => kept(
                br#"{"asset":{"version":"1.1"},"geometricError":9,"root":{"boundingVolume":{"sphere":[0,0,0,2]},
                    "geometricError":0,"content":{"uri":"a.glb"}}}"#
                    .to_vec(),
            ),
            "/a.glb" if first_is_a_page && r.nth == 0 => kept(b"<html>Please log in</html>".to_vec()),
            "/a.glb" => kept(glb.clone()),
            _ => Reply::new(404, ""),
        }
    })
}

fn fly(server: &Server, folder: &Path) -> kit::pager::Run {
    let config = PagerConfig { http: config(CacheConfig::new(folder)), max_tries: Some(1), ..PagerConfig::default() };
    let mut run = kit::pager::Run::new(&format!("{}/", server.url), config);
    run.settle(kit::pager::above(10.0));
    run
}

#[test]
fn second_flight_sends_no_requests() {
    let (server, folder) = (one_tile(false), tempfile::tempdir().unwrap());
    let first = fly(&server, folder.path());
    assert_eq!((first.stage.counters.tiles_drawn, server.count()), (1, 2));
    drop(first);
    let second = fly(&server, folder.path());
    assert_eq!((second.stage.counters.tiles_drawn, server.count()), (1, 2));
    let (stats, cache) = (second.pager.stats(), second.pager.cache_stats().unwrap());
    assert_eq!((stats.bytes_http, cache.hits, cache.misses), (0, 2, 0));
    assert!(stats.bytes_read > 0);
}

#[test]
fn html_pages_with_status_200_are_not_cached() {
    let (server, folder) = (one_tile(true), tempfile::tempdir().unwrap());
    let first = fly(&server, folder.path());
    assert_eq!((first.pager.stats().failed, first.stage.counters.tiles_drawn), (1, 0));
    drop(first);
    let second = fly(&server, folder.path());
    assert_eq!((second.pager.stats().failed, second.stage.counters.tiles_drawn), (0, 1));
}

/// Regression: every start failed from the cache until the page became stale.
#[test]
fn root_that_is_no_tileset_is_not_cached() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(|r| {
        let set = r#"{"asset":{"version":"1.1"},"geometricError":9,"root":{"boundingVolume":{"sphere":[0,0,0,2]},
            "geometricError":0}}"#;
        let body = if r.nth == 0 { "<html>Please log in</html>" } else { set };
        Reply::ok(body).with("Cache-Control", "max-age=1000")
    });
    let uri: Arc<str> = format!("{}/tileset.json", server.url).into();
    let read = || {
        let config = PagerConfig { http: config(CacheConfig::new(folder.path())), ..PagerConfig::default() };
        let mut pager = DatabasePager::new(config, ReadOptions::for_root(&uri, Limits::default())).unwrap();
        pager.read_root(&uri).map(drop)
    };
    // Bodies are written on a separate thread.
    assert!(read().is_err());
    let until = Instant::now() + kit::MAX_WAIT;
    while let Err(error) = read() {
        assert!(Instant::now() < until, "{error}");
        assert!(server.count() < 20, "{error}");
    }
}
