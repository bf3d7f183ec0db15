//! Filling the cache: selection by region and levels, continuing after a stop, and failures.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use kit::server::{Reply, Request, Server};
use terrane::fetch::{CacheConfig, DiskCache, HttpConfig, IoError};
use terrane::formats::{FillOptions, Filled, fill};
use terrane::math::{Region, WGS84};

/// A tree of four levels over 8 x 8 degrees from 0 N 0 E. Each tile has four children. The eastern half of level 1 is
/// in external tilesets.
fn tile(level: u32, x: u32, y: u32, of_its_own: bool) -> String {
    let degrees = 8.0 / f64::from(1 << level);
    let [west, south] = [x, y].map(|i| (f64::from(i) * degrees).to_radians());
    let [east, north] = [x + 1, y + 1].map(|i| (f64::from(i) * degrees).to_radians());
    let region = format!(r#""boundingVolume":{{"region":[{west},{south},{east},{north},0,100]}},"geometricError":9"#);
    if level == 1 && x == 1 && !of_its_own {
        return format!(r#"{{{region},"content":{{"uri":"east{y}EXTENSION"}}}}"#);
    }
    let children: Vec<String> =
        (0..4).filter(|_| level < 3).map(|i| tile(level + 1, 2 * x + i % 2, 2 * y + i / 2, false)).collect();
    format!(r#"{{{region},"content":{{"uri":"{level}/{x}/{y}.glb"}},"children":[{}]}}"#, children.join(","))
}

fn set() -> Server {
    set_called(".json")
}

/// Serves a set whose inner tilesets have names with this extension.
fn set_called(extension: &'static str) -> Server {
    Server::start(move |r| answer(r, extension))
}

/// Returns the answer of a server with the set.
fn answer(r: &Request, extension: &str) -> Reply {
    let tileset = |root: String| {
        let root = root.replace("EXTENSION", extension);
        Reply::ok(format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":99,"root":{root}}}"#)).with("ETag", "\"t\"")
    };
    if r.header("if-none-match") == Some("\"t\"") {
        return Reply::new(304, "");
    }
    match r.path() {
        "/set/tileset.json" => tileset(tile(0, 0, 0, false)),
        path if path == format!("/set/east0{extension}") => tileset(tile(1, 1, 0, true)),
        path if path == format!("/set/east1{extension}") => tileset(tile(1, 1, 1, true)),
        path if path.ends_with(".glb") => {
            Reply::ok(path.repeat(50)).with("ETag", "\"t\"").with("Cache-Control", "max-age=1000")
        }
        _ => Reply::new(404, ""),
    }
}

fn config(folder: &Path) -> HttpConfig {
    HttpConfig { cache: Some(CacheConfig::new(folder)), max_retries: 0, ..HttpConfig::default() }
}

fn filled(server: &Server, folder: &Path, options: &FillOptions) -> Filled {
    fill(&format!("{}/set/", server.url), &config(folder), options, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn paths(server: &Server) -> BTreeSet<String> {
    server.seen().iter().map(|r| r.target.trim_start_matches("/set/").to_owned()).collect()
}

const CONTENTS: u64 = 1 + 4 + 16 + 64;
const TILESETS: u64 = 3;

#[test]
fn whole_set_is_filled_and_kept() {
    let (server, folder) = (set(), tempfile::tempdir().unwrap());
    let all = FillOptions::default();
    let first = filled(&server, folder.path(), &all);
    assert_eq!((first.fetched, first.found, first.failed), (CONTENTS + TILESETS, CONTENTS + TILESETS, 0));
    assert_eq!((first.cache.stored, server.count() as u64), (CONTENTS + TILESETS, CONTENTS + TILESETS));
    let again = filled(&server, folder.path(), &all);
    assert_eq!((again.kept, again.fetched, again.bytes), (CONTENTS + TILESETS, 0, 0));
    assert_eq!(server.count() as u64, CONTENTS + TILESETS, "no requests are sent");
    let refreshed = filled(&server, folder.path(), &FillOptions { refresh: true, ..all });
    assert_eq!((refreshed.kept, refreshed.bytes), (CONTENTS + TILESETS, 0), "all entries are still valid");
    assert_eq!(server.count() as u64, 2 * (CONTENTS + TILESETS));
    let verified = DiskCache::open(&CacheConfig::new(folder.path())).unwrap().verify().unwrap();
    assert_eq!((verified.broken, verified.orphans), (0, 0));
}

/// Regression: the fill stopped at such tilesets and treated them as contents.
#[test]
fn tilesets_with_any_name_are_filled() {
    for extension in ["", ".tileset", ".v2"] {
        let (server, folder) = (set_called(extension), tempfile::tempdir().unwrap());
        let all = FillOptions::default();
        let first = filled(&server, folder.path(), &all);
        assert_eq!((first.fetched, first.failed), (CONTENTS + TILESETS, 0), "{extension}");
        let again = filled(&server, folder.path(), &all);
        assert_eq!((again.kept, again.bytes), (CONTENTS + TILESETS, 0), "{extension}");
        // Tilesets above the selected levels are fetched to find them.
        let (server, folder) = (set_called(extension), tempfile::tempdir().unwrap());
        filled(&server, folder.path(), &FillOptions { levels: 3..=3, ..FillOptions::default() });
        let east =
            |path: &String| path.starts_with("3/") && path.split('/').nth(1).unwrap().parse::<u32>().unwrap() >= 4;
        assert_eq!(paths(&server).iter().filter(|path| east(path)).count(), 0, "their roots are one level below");
        let deeper = filled(&server, folder.path(), &FillOptions { levels: 4..=4, ..FillOptions::default() });
        assert_eq!(deeper.fetched, 32);
        assert_eq!(paths(&server).iter().filter(|path| east(path)).count(), 32, "{extension}");
    }
}

/// Regression: a kept entry counted as unused since its arrival, and was evicted before entries that were never used.
#[test]
fn kept_entries_count_as_used() {
    let (server, folder) = (set(), tempfile::tempdir().unwrap());
    filled(&server, folder.path(), &FillOptions::default());
    let long_ago = SystemTime::now() - Duration::from_secs(24 * 3600);
    let mut files = Vec::new();
    for part in ["keys", "blobs"] {
        for sub in std::fs::read_dir(folder.path().join(part)).unwrap() {
            files.extend(std::fs::read_dir(sub.unwrap().path()).unwrap().map(|file| file.unwrap().path()));
        }
    }
    for file in &files {
        std::fs::File::options().write(true).open(file).unwrap().set_modified(long_ago).unwrap();
    }
    filled(&server, folder.path(), &FillOptions::default());
    let is_used = |file: &PathBuf| std::fs::metadata(file).unwrap().modified().unwrap() > long_ago;
    assert_eq!(files.len() as u64, 2 * (CONTENTS + TILESETS));
    assert!(files.iter().all(is_used));
}

/// Regression: a second run did not continue below models that the first one had cached.
#[test]
fn files_of_cached_models_are_filled() {
    let tries = std::sync::atomic::AtomicU32::new(0);
    let server = Server::start(move |request| match request.path() {
        "/set/tileset.json" => Reply::ok(
            r#"{"asset":{"version":"1.1"},"geometricError":9,"root":{"geometricError":0,
            "boundingVolume":{"sphere":[0,0,0,9]},"content":{"uri":"trees.i3dm"}}}"#,
        ),
        "/set/trees.i3dm" => Reply::ok(instances_of("tree.gltf")),
        "/set/tree.gltf" if tries.fetch_add(1, std::sync::atomic::Ordering::Relaxed) == 0 => Reply::new(503, ""),
        "/set/tree.gltf" => Reply::ok(r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4,"uri":"tree.bin"}]}"#),
        "/set/tree.bin" => Reply::ok("1234"),
        _ => Reply::new(404, ""),
    });
    let folder = tempfile::tempdir().unwrap();
    let first = filled(&server, folder.path(), &FillOptions::default());
    assert_eq!((first.fetched, first.failed), (2, 1), "{first:?}");
    let second = filled(&server, folder.path(), &FillOptions::default());
    assert_eq!((second.kept, second.fetched, second.failed), (2, 2, 0), "{second:?}");
    assert_eq!(paths(&server), ["tileset.json", "trees.i3dm", "tree.bin", "tree.gltf"].map(String::from).into());
}

/// Returns an i3dm with one instance of a model in another file.
fn instances_of(model: &str) -> Vec<u8> {
    let mut bytes = b"i3dm".to_vec();
    let table = br#"{"INSTANCES_LENGTH":1,"POSITION":{"byteOffset":0}}      "#;
    let length = 32 + table.len() + 12 + model.len();
    for word in [1, length, table.len(), 12, 0, 0, 0] {
        bytes.extend((word as u32).to_le_bytes());
    }
    [&bytes[..], table, &[0; 12], model.as_bytes()].concat()
}

#[test]
fn levels_and_regions_select_tiles() {
    let degrees = |west: f64, south: f64, east: f64, north: f64| {
        let [west, south, east, north] = [west, south, east, north].map(f64::to_radians);
        Some(Region { west, south, east, north, min_height_m: 0.0, max_height_m: 0.0, ellipsoid: WGS84 })
    };
    for (levels, region, expected) in [
        (0..=0, None, vec!["0/0/0.glb"]),
        (1..=1, None, vec!["1/0/0.glb", "1/0/1.glb"]),
        (0..=9, degrees(0.1, 0.1, 0.9, 0.9), vec!["0/0/0.glb", "1/0/0.glb", "2/0/0.glb", "3/0/0.glb"]),
        (3..=3, degrees(0.5, 0.5, 1.5, 0.9), vec!["3/0/0.glb", "3/1/0.glb"]),
        // The root of an external tileset is one level below the tile that refers to it.
        (2..=3, degrees(7.5, 7.5, 30.0, 30.0), vec!["1/1/1.glb", "2/3/3.glb", "east1.json"]),
        (0..=9, degrees(50.0, 0.0, 51.0, 1.0), vec![]),
    ] {
        let (server, folder) = (set(), tempfile::tempdir().unwrap());
        let done =
            filled(&server, folder.path(), &FillOptions { levels: levels.clone(), region, ..FillOptions::default() });
        let mut expected: BTreeSet<String> = expected.into_iter().map(str::to_owned).collect();
        expected.insert("tileset.json".to_owned());
        assert_eq!(paths(&server), expected, "{levels:?} {region:?}");
        assert_eq!(done.fetched, expected.len() as u64);
    }
}

#[test]
fn stopped_fill_loses_nothing() {
    let (server, folder) = (set(), tempfile::tempdir().unwrap());
    let url = format!("{}/set/", server.url);
    let options = FillOptions { in_flight: 4, ..FillOptions::default() };
    let stopped = fill(&url, &config(folder.path()), &options, &mut |filled| {
        if filled.fetched >= 30 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
    .unwrap();
    assert!(stopped.stopped && stopped.fetched < 40, "{stopped:?}");
    let rest = filled(&server, folder.path(), &options);
    assert!(!rest.stopped);
    assert!(rest.kept >= stopped.fetched, "{rest:?}");
    assert_eq!(rest.kept + rest.fetched, CONTENTS + TILESETS);
    let asked = server.count() as u64;
    assert!(asked <= CONTENTS + TILESETS + 4, "each file once, except for cancelled ones: {asked}");
}

#[test]
fn stop_does_not_wait_for_the_server() {
    let server = Server::start(|r| match r.path() {
        "/set/tileset.json" => Reply::ok(format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":99,"root":{}}}"#,
            r#"{"boundingVolume":{"sphere":[0,0,0,1]},"geometricError":9,"content":{"uri":"a.glb"}}"#
        )),
        _ => Reply::new(503, "").with("Retry-After", "300"),
    });
    let folder = tempfile::tempdir().unwrap();
    let config = HttpConfig { max_retries: 2, ..config(folder.path()) };
    let start = Instant::now();
    let stopped = fill(&format!("{}/set/", server.url), &config, &FillOptions::default(), &mut |_| {
        if server.count() == 2 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })
    .unwrap();
    assert!(start.elapsed() < Duration::from_secs(100), "the server asks for five minutes");
    assert_eq!((stopped.stopped, stopped.fetched, stopped.failed), (true, 1, 0), "{stopped:?}");
}

/// A tile with several contents is one tile. Its contents have the same level, and its children are one level deeper.
#[test]
fn several_contents_have_one_level() {
    let tile = |names: [&str; 2], children: &str| {
        let [a, b] = names.map(|name| format!(r#"{{"uri":"{name}.glb"}}"#));
        format!(
            r#"{{"boundingVolume":{{"sphere":[0,0,0,1]}},"geometricError":9,"refine":"ADD","contents":[{a},{b}],
            "children":[{children}]}}"#
        )
    };
    let root = tile(["0a", "0b"], &tile(["1a", "1b"], &tile(["2a", "2b"], "")));
    let tileset = format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":99,"root":{root}}}"#);
    for level in 0..=2 {
        let (answer, folder) = (tileset.clone(), tempfile::tempdir().unwrap());
        let server = Server::start(move |r| match r.path() {
            "/set/tileset.json" => Reply::ok(answer.clone()),
            _ => Reply::ok("a content"),
        });
        filled(&server, folder.path(), &FillOptions { levels: level..=level, ..FillOptions::default() });
        let expected = ["tileset.json".to_owned(), format!("{level}a.glb"), format!("{level}b.glb")];
        assert_eq!(paths(&server), BTreeSet::from(expected), "level {level}");
    }
}

#[test]
fn failures_are_reported_and_retried() {
    let server = Server::start(move |r| match r.path() {
        "/set/2/1/1.glb" if r.nth == 0 => Reply::new(503, ""),
        "/set/east1.json" if r.nth == 0 => Reply::ok("<html>"),
        _ => answer(r, ".json"),
    });
    let folder = tempfile::tempdir().unwrap();
    let first = filled(&server, folder.path(), &FillOptions::default());
    assert_eq!((first.failed, first.errors.len()), (2, 2), "{:?}", first.errors);
    let again = filled(&server, folder.path(), &FillOptions::default());
    assert_eq!((again.failed, again.kept + again.fetched), (0, CONTENTS + TILESETS), "{:?}", again.errors);
    assert_eq!(again.kept, first.fetched);
}

/// A tileset that is referenced twice is filled for the levels of both references. One that contains itself ends.
#[test]
fn tileset_with_several_references_is_filled_for_each() {
    let tile = |below: &str| format!(r#"{{"boundingVolume":{{"sphere":[0,0,0,1]}},"geometricError":9,{below}}}"#);
    let content = |uri: &str| format!(r#""content":{{"uri":"{uri}"}}"#);
    let tileset = |root: String| format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":99,"root":{root}}}"#);
    let second = tile(&content("part.json"));
    let root = tileset(tile(&format!(r#"{},"children":[{second}]"#, content("part.json"))));
    let below = [tile(&content("b.glb")), tile(&content("tileset.json"))].join(",");
    let part = tileset(tile(&format!(r#"{},"children":[{below}]"#, content("a.glb"))));
    let server = Server::start(move |r| match r.path() {
        "/set/tileset.json" => Reply::ok(root.clone()),
        "/set/part.json" => Reply::ok(part.clone()),
        _ => Reply::ok("a content"),
    });
    // The root of the part has level 1 in one reference and level 2 in the other.
    for (levels, contents) in [(1..=1, &["a.glb"][..]), (2..=2, &["a.glb", "b.glb"]), (3..=3, &["b.glb"])] {
        let (folder, before) = (tempfile::tempdir().unwrap(), server.count());
        let done = filled(&server, folder.path(), &FillOptions { levels: levels.clone(), ..FillOptions::default() });
        let asked = server.seen()[before..].iter().map(|r| r.target.replace("/set/", "")).collect::<Vec<_>>();
        let expected = contents.iter().chain(&["part.json", "tileset.json"]).map(|s| (*s).to_owned());
        let (asked_once, expected) = (BTreeSet::from_iter(asked.clone()), BTreeSet::from_iter(expected));
        assert_eq!((asked_once, asked.len()), (expected.clone(), expected.len()), "{levels:?}");
        assert_eq!((done.fetched, done.found, done.failed), (expected.len() as u64, done.fetched, 0), "{levels:?}");
    }
}

/// Regression: an entry behind a redirect outlived the redirect.
#[test]
fn freshness_is_limited_by_redirects() {
    for (status, control, expected) in
        [(301, "", (1, 1)), (302, "", (1, 0)), (301, "no-cache", (1, 0)), (301, "no-store", (0, 0))]
    {
        let server = Server::start(move |r| {
            match r.path() {
            "/set/tileset.json" if r.nth == 0 => Reply::new(301, "").with("Location", "/there.json"),
            "/set/tileset.json" => {
                Reply::new(status, "").with("Location", "/there.json").with("Cache-Control", control)
            }
            _ if r.header("if-none-match") == Some("\"t\"") => Reply::new(304, ""),
            _ => Reply::ok(
                r#"{"asset":{"version":"1.1"},"geometricError":9,"root":{"boundingVolume":{"sphere":[0,0,0,1]},"geometricError":9}}"#,
            )
            .with("ETag", "\"t\"")
            .with("Cache-Control", "max-age=3600"),
        }
        });
        let folder = tempfile::tempdir().unwrap();
        let kept = || {
            let info = DiskCache::open(&CacheConfig::new(folder.path())).unwrap().info().unwrap();
            (info.entries, info.fresh)
        };
        filled(&server, folder.path(), &FillOptions::default());
        assert_eq!(kept(), (1, 1));
        let again = filled(&server, folder.path(), &FillOptions { refresh: true, ..FillOptions::default() });
        assert_eq!((again.kept, again.bytes), (1, 0), "it is still fresh");
        assert_eq!(kept(), expected, "{status} {control}");
    }
}

#[test]
fn sets_that_cannot_be_filled_are_errors() {
    let (server, folder) = (set(), tempfile::tempdir().unwrap());
    let mut go_on = |_: &Filled| ControlFlow::Continue(());
    let options = FillOptions::default();
    let error = fill("/data/set", &config(folder.path()), &options, &mut go_on).unwrap_err();
    assert!(matches!(error, IoError::Uri { .. }), "{error}");
    let url = format!("{}/set/", server.url);
    assert!(matches!(fill(&url, &HttpConfig::default(), &options, &mut go_on), Err(IoError::Uri { .. })));
    let none = format!("{}/none/", server.url);
    assert!(matches!(fill(&none, &config(folder.path()), &options, &mut go_on), Err(IoError::NotFound { .. })));
}

/// Schemas decide about the volumes of tiles: they are fetched before the tiles below, and one that is missing is reported.
#[test]
fn schemas_in_other_files_are_filled() {
    for is_missing in [false, true] {
        let server = Server::start(move |r| {
            let tileset = |schema: &str, content: &str| {
                Reply::ok(format!(
                    r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"schemaUri":"schema/{schema}.json",
                    "root":{{"geometricError":1,"boundingVolume":{{"sphere":[0,0,0,9]}},"content":{{"uri":"{content}"}}}}}}"#
                ))
            };
            match r.path() {
                "/set/tileset.json" => tileset("a", "below"),
                "/set/below" => tileset("b", "c.glb"),
                "/set/c.glb" => Reply::ok("c"),
                "/set/schema/a.json" | "/set/schema/b.json" if !is_missing => Reply::ok(r#"{"classes":{}}"#),
                _ => Reply::new(404, ""),
            }
        });
        let folder = tempfile::tempdir().unwrap();
        let done = filled(&server, folder.path(), &FillOptions::default());
        let all = ["tileset.json", "below", "c.glb", "schema/a.json", "schema/b.json"];
        assert_eq!(paths(&server), all.map(str::to_owned).into());
        assert_eq!((done.fetched, done.failed), (3, if is_missing { 2 } else { 0 }), "{:?}", done.errors);
        assert!(done.errors.iter().all(|(uri, _)| uri.contains("/schema/")), "{:?}", done.errors);
    }
}
