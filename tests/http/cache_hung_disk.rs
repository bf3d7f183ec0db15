//! The cache on a disk that hangs: a pipe in place of an entry, whose opening waits for a writer. Contents are loaded without
//! the cache meanwhile.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use kit::pager::{Run, above};
use kit::server::{Reply, Server};
use kit::tile_sets::{WORLD_M, write_quadtree};
use terrane::fetch::{CacheConfig, HttpClient, HttpConfig, IoError, Limits};
use terrane::pager::PagerConfig;

const LIMIT: Duration = Duration::from_secs(1);

fn config(folder: &Path) -> HttpConfig {
    config_within(folder, LIMIT)
}

fn config_within(folder: &Path, disk_timeout: Duration) -> HttpConfig {
    let cache = CacheConfig { disk_timeout, ..CacheConfig::new(folder) };
    HttpConfig { cache: Some(cache), max_retries: 0, ..HttpConfig::default() }
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let paths = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
    paths.flat_map(|p| if p.is_dir() { files(&p) } else { vec![p] }).collect()
}

/// Replaces all entries of a cache by pipes, and returns their paths.
fn hang(folder: &Path) -> Vec<PathBuf> {
    let entries = files(&folder.join("keys"));
    for entry in &entries {
        std::fs::remove_file(entry).unwrap();
        assert!(Command::new("mkfifo").arg(entry).status().unwrap().success());
    }
    entries
}

/// Ends the reads of a pipe; there must be one.
fn release(pipe: &Path) {
    drop(std::fs::File::options().write(true).open(pipe).unwrap());
}

#[test]
fn contents_are_loaded_without_a_cache_that_hangs() {
    let server = Server::start(|r| Reply::ok(r.path().repeat(100)).with("Cache-Control", "max-age=1000"));
    let folder = tempfile::tempdir().unwrap();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    let get = |client: &HttpClient, path: &str| {
        let url = format!("{}{path}", server.url);
        runtime.block_on(async {
            let body = client.get(&url, &Limits::default()).await?;
            client.flush().await;
            assert_eq!(body.bytes, path.repeat(100).into_bytes());
            Ok::<_, IoError>(body)
        })
    };
    get(&HttpClient::new(&config_within(folder.path(), kit::MAX_WAIT)).unwrap(), "/a").unwrap();
    let pipes = hang(folder.path());
    let (client, asked) = (HttpClient::new(&config(folder.path())).unwrap(), server.count());
    get(&client, "/a").unwrap();
    let begun = Instant::now();
    for i in 0..40 {
        get(&client, &format!("/{i}")).unwrap();
    }
    assert!(begun.elapsed() < 30 * LIMIT, "only the first request waits: {:?}", begun.elapsed());
    assert_eq!(server.count() - asked, 41);
    let stats = client.cache().unwrap().stats();
    assert!(stats.stored == 0 && stats.bypassed >= 81, "each read and each write: {stats:?}");
    // The disk comes back.
    release(&pipes[0]);
    let end = Instant::now() + kit::MAX_WAIT;
    while client.cache().unwrap().stats().hits == 0 {
        get(&client, "/a").unwrap();
        assert!(Instant::now() < end);
        std::thread::sleep(Duration::from_millis(5));
    }
    // Without a server there is an error instead of a wait.
    hang(folder.path());
    let mut offline = config(folder.path());
    offline.cache.as_mut().unwrap().offline = true;
    let error = get(&HttpClient::new(&offline).unwrap(), "/a").unwrap_err();
    assert!(matches!(error, IoError::Timeout { phase: "reading the cache", .. }), "{error}");
    release(&pipes[0]);
}

/// Regression: the end of the pager waited for the threads that hung.
#[test]
fn hung_cache_stops_neither_a_flight_nor_its_end() {
    let set = tempfile::tempdir().unwrap();
    write_quadtree(set.path());
    let root = set.path().to_owned();
    let server = Server::start(move |r| match std::fs::read(root.join(r.path().trim_start_matches('/'))) {
        Ok(bytes) => Reply::ok(bytes).with("Cache-Control", "max-age=1000"),
        Err(_) => Reply::new(404, ""),
    });
    let folder = tempfile::tempdir().unwrap();
    let fly = |disk_timeout: Duration| {
        let http = config_within(folder.path(), disk_timeout);
        let mut run = Run::new(&format!("{}/", server.url), PagerConfig { http, ..PagerConfig::default() });
        run.settle(above(WORLD_M) + glam::DVec3::new(WORLD_M / 2.0, WORLD_M / 2.0, 0.0));
        (run.stage.counters.tiles_drawn, run.pager.cache_stats().unwrap())
    };
    let (tiles, stats) = fly(kit::MAX_WAIT);
    assert!(tiles > 0 && stats.bypassed == 0);
    hang(folder.path());
    let (tiles_without, stats) = fly(LIMIT);
    assert_eq!((tiles_without, stats.hits), (tiles, 0));
    assert!(stats.bypassed > 0, "{stats:?}");
}
