//! `terrane serve`, and a flight over a server with faults.

mod http2;
pub mod served;

use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::Command;
use std::time::{Duration, Instant};

use crate::serve::served::Server;
use kit::skip::no_adapter;
use serde_json::Value;
use terrane::fetch::IoError;

/// The last byte arrives no sooner than the bandwidth allows, also for a small file.
#[test]
fn small_file_takes_the_time_of_its_bandwidth() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("tile"), vec![7; 16_000]).unwrap();
    let server = Server::start(folder.path(), &["--bandwidth", "16000"]);
    let mut stream = TcpStream::connect(&server.address).unwrap();
    for _ in 0..2 {
        let start = Instant::now();
        write!(stream, "GET /tile HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        while !answer.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            stream.read_exact(&mut byte).unwrap();
            answer.push(byte[0]);
        }
        let mut body = [0; 16_000];
        stream.read_exact(&mut body).unwrap();
        assert!(start.elapsed() > Duration::from_millis(900), "{:?}", start.elapsed());
        assert_eq!(body, [7; 16_000]);
    }
}

#[test]
fn files_are_served_whole_and_in_parts() {
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    std::fs::create_dir_all(set.join("a b")).unwrap();
    let bytes: Vec<u8> = (0..100_000u32).map(|i| (i * 7) as u8).collect();
    std::fs::write(set.join("a b/tile.glb"), &bytes).unwrap();
    std::fs::write(set.join("tile.json"), "plain").unwrap();
    std::fs::write(set.join("tile.json.gz"), "packed").unwrap();
    std::fs::write(set.join("own.json"), b"\x1f\x8bpacked").unwrap();
    std::fs::write(folder.path().join("secret"), "secret").unwrap();
    let server = Server::start(&set, &[]);
    let (status, head, body) = server.ask("GET", "/a%20b/tile.glb?v=1", "");
    assert_eq!((status, body == bytes), (200, true), "{head}");
    assert!(head.contains("Content-Length: 100000") && head.contains("model/gltf-binary"), "{head}");
    let (status, head, body) = server.ask("HEAD", "/a%20b/tile.glb", "");
    assert_eq!((status, body.len()), (200, 0), "{head}");
    let (status, head, body) = server.ask("GET", "/a%20b/tile.glb", "Range: bytes=10-19\r\n");
    assert_eq!((status, &body[..]), (206, &bytes[10..20]), "{head}");
    assert!(head.contains("Content-Range: bytes 10-19/100000"), "{head}");
    assert_eq!(server.ask("GET", "/a%20b/tile.glb", "Range: bytes=100000-\r\n").0, 416);
    let tag = head.lines().find_map(|l| l.strip_prefix("ETag: ")).unwrap();
    assert_eq!(server.ask("GET", "/a%20b/tile.glb", &format!("If-None-Match: {tag}\r\n")).0, 304);
    let ask = |headers: &str| server.ask("GET", "/a%20b/tile.glb", headers).0;
    assert_eq!(ask(&format!("If-None-Match: \"other\", W/{tag}\r\n")), 304);
    assert_eq!([ask("If-None-Match: *\r\n"), ask("If-None-Match: \"other\"\r\n")], [304, 200]);
    let date = head.lines().find_map(|l| l.strip_prefix("Last-Modified: ")).unwrap();
    assert_eq!(ask(&format!("If-Modified-Since: {date}\r\n")), 304);
    assert_eq!(
        ask(&format!("If-None-Match: \"other\"\r\nIf-Modified-Since: {date}\r\n")),
        200,
        "the tag takes precedence"
    );
    assert_eq!(ask(&format!("Range: bytes=1-2\r\nIf-Range: {tag}\r\n")), 206);
    assert_eq!(ask("Range: bytes=1-2\r\nIf-Range: \"other\"\r\n"), 200);
    assert!(!head.contains("Cache-Control"), "{head}");
    assert_eq!(server.ask("GET", "/tile.json", "").2, b"plain");
    let (_, head, body) = server.ask("GET", "/tile.json", "Accept-Encoding: br, gzip\r\n");
    assert_eq!((&body[..], head.contains("Content-Encoding: gzip")), (&b"packed"[..], true));
    // `terrane gen --gzip` keeps names.
    for accepts in [true, false] {
        let header = if accepts { "Accept-Encoding: gzip\r\n" } else { "" };
        let (_, head, body) = server.ask("GET", "/own.json", header);
        assert_eq!((&body[..], head.contains("Content-Encoding: gzip")), (&b"\x1f\x8bpacked"[..], accepts));
    }
    for path in ["/none", "/", "/a%20b", "/../secret", "/%2e%2e/secret", "//etc/passwd", "/a%20b/../../secret"] {
        assert_eq!(server.ask("GET", path, "").0, 404, "{path}");
    }
    assert_eq!(server.ask("POST", "/tile.json", "").0, 405);
    assert_eq!(server.ask("GET", "/tile.json", "Range: bytes=0-0,2-2\r\n").0, 200, "several ranges are not served");
}

#[test]
fn faults_are_the_same_for_the_same_seed() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("f"), vec![b'x'; 1000]).unwrap();
    let rates = ["--error-rate", "0.2", "--truncate-rate", "0.2", "--corrupt-rate", "0.2", "--reset-rate", "0.2"];
    let fates = |seed: &str| {
        let server = Server::start(folder.path(), &[&rates[..], &["--seed", seed]].concat());
        (0..60)
            .map(|_| {
                let (status, _, body) = server.ask("GET", "/f", "");
                (status, body.len(), body.iter().filter(|b| **b != b'x').count())
            })
            .collect::<Vec<_>>()
    };
    let first = fates("3");
    assert_eq!(first, fates("3"));
    assert_ne!(first, fates("4"));
    for (what, seen) in
        [("whole", (200, 1000, 0)), ("half", (200, 500, 0)), ("corrupted", (200, 1000, 1)), ("reset", (0, 0, 0))]
    {
        assert!(first.contains(&seen), "{what}: {first:?}");
    }
    for status in [429, 500, 503] {
        assert!(first.iter().any(|f| f.0 == status), "{status}: {first:?}");
    }
}

/// Each range of a file has separate faults. Regression: they depended on the order of arrival.
#[test]
fn faults_of_files_and_ranges_do_not_depend_on_the_order() {
    let folder = tempfile::tempdir().unwrap();
    (0..8).for_each(|k| std::fs::write(folder.path().join(format!("{k}")), vec![b'x'; 1000]).unwrap());
    let whole = (0..8).map(|k| (format!("/{k}"), String::new()));
    let part = |k: usize| ("/0".to_owned(), format!("Range: bytes={}-{}\r\n", 100 * k, 100 * k + 99));
    let all: Vec<(String, String)> = whole.chain((0..10).map(part)).collect();
    let rates = ["--error-rate", "0.2", "--truncate-rate", "0.2", "--corrupt-rate", "0.2", "--page-rate", "0.2"];
    // The fault of each first, second, ... request, in an order that differs between runs.
    let fates = |order: &dyn Fn(usize, usize) -> usize| {
        let server = Server::start(folder.path(), &rates);
        let mut met = vec![Vec::new(); all.len()];
        for time in 0..6 {
            for nth in 0..all.len() {
                let place = order(time, nth);
                let (path, range) = &all[place];
                met[place].push(server.ask("GET", path, range));
            }
        }
        met
    };
    let count = all.len();
    let first = fates(&|_, nth| nth);
    assert_eq!(first, fates(&|_, nth| count - 1 - nth));
    // 18 and 5 have no common divisor.
    assert_eq!(first, fates(&|time, nth| (5 * nth + 7 * time) % count));
    let well = |(status, _, body): &(u16, String, Vec<u8>)| *status < 300 && body.iter().all(|b| *b == b'x');
    let again = first.iter().filter(|met| !well(&met[0]) && met[1..].iter().any(well)).count();
    assert!(again > 4, "later requests for failed ones succeed: {again}");
}

#[test]
fn web_pages_silence_and_caching_headers_are_sent() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("f"), "content").unwrap();
    let page = Server::start(folder.path(), &["--page-rate", "1"]);
    let (status, head, body) = page.ask("GET", "/f", "");
    assert!(status == 200 && head.contains("text/html") && body.starts_with(b"<!doctype"), "{head}");
    let wait = Server::start(folder.path(), &["--error-rate", "1", "--retry-after", "7"]);
    assert!(wait.ask("GET", "/f", "").1.contains("Retry-After: 7"));
    let fresh = Server::start(folder.path(), &["--max-age", "60"]);
    assert!(fresh.ask("GET", "/f", "").1.contains("Cache-Control: max-age=60"));
    let silent = Server::start(folder.path(), &["--silent-rate", "1"]);
    let mut stream = TcpStream::connect(&silent.address).unwrap();
    stream.write_all(b"GET /f HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    assert!(stream.read(&mut [0; 8]).is_err(), "no answer arrives, and the connection stays open");
}

/// Regression: the connection was closed in order, which clients see differently.
#[test]
fn reset_is_a_connection_reset() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("f"), vec![b'x'; 1000]).unwrap();
    let server = Server::start(folder.path(), &["--reset-rate", "1"]);
    let mut lengths = std::collections::BTreeSet::new();
    for _ in 0..20 {
        let mut stream = TcpStream::connect(&server.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream.write_all(b"GET /f HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        let error = stream.read_to_end(&mut answer).unwrap_err();
        assert_eq!(error.kind(), std::io::ErrorKind::ConnectionReset);
        lengths.insert(answer.iter().filter(|b| **b == b'x').count());
    }
    assert_eq!(lengths.into_iter().collect::<Vec<_>>(), [0, 500], "before the first byte, and half way");
    // The received bytes.
    let uri = terrane::fetch::root_uri(&format!("http://{}/f", server.address)).unwrap();
    let mut config = terrane::pager::PagerConfig::default();
    config.http.max_retries = 0;
    let options = terrane::formats::ReadOptions::for_root(&uri, terrane::fetch::Limits::default());
    let mut pager = terrane::pager::DatabasePager::new(config, options).unwrap();
    for _ in 0..20 {
        let error = pager.read_root(&uri).err().unwrap();
        assert!(matches!(&error, IoError::Network { reason, .. } if reason.contains("reset")), "{error:?}");
    }
}

/// Answers are not sent sooner than configured. How much later depends on the machine.
#[test]
fn answers_have_the_configured_latency() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("f"), "content").unwrap();
    for (options, requests, min_ms) in
        [(&["--latency-ms", "150"][..], 3, 450), (&["--jitter-ms", "100"], 10, 200), (&["--latency-ms", "0"], 1, 0)]
    {
        let server = Server::start(folder.path(), options);
        let start = Instant::now();
        assert!((0..requests).all(|_| server.ask("GET", "/f", "").2 == b"content"));
        assert!(start.elapsed() >= Duration::from_millis(min_ms), "{options:?}: {:?}", start.elapsed());
    }
}

#[test]
fn stalled_answer_stops_half_way_and_keeps_the_connection() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("f"), vec![b'x'; 1000]).unwrap();
    let server = Server::start(folder.path(), &["--stall-rate", "1"]);
    let mut stream = TcpStream::connect(&server.address).unwrap();
    stream.write_all(b"GET /f HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    while answer.iter().filter(|b| **b == b'x').count() < 500 {
        let mut byte = [0];
        stream.read_exact(&mut byte).unwrap();
        answer.push(byte[0]);
    }
    assert!(String::from_utf8_lossy(&answer).contains("Content-Length: 1000"));
    stream.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    let kind = stream.read(&mut [0; 8]).unwrap_err().kind();
    assert!(matches!(kind, std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut), "{kind:?}");
}

#[test]
fn invalid_arguments_are_reported() {
    for (arguments, code, word) in [
        (&["serve", "/no/such/folder"][..], 1, "/no/such/folder"),
        (&["serve", ".", "--error-rate", "0.6", "--reset-rate", "0.6"], 2, "rates are 1.2 together"),
    ] {
        let out = Command::new(env!("CARGO_BIN_EXE_terrane")).args(arguments).output().unwrap();
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(code), "{said}");
        assert!(said.lines().next().is_some_and(|line| line.contains(word)), "{said}");
    }
}

/// A flight over a faulty server: tiles that load are drawn, the others are reported, and the image has no hole.
#[test]
fn flight_over_a_faulty_server_has_no_holes() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    let made = Command::new(env!("CARGO_BIN_EXE_terrane"))
        .args(["gen", set.to_str().unwrap(), "--levels", "3", "--size", "5000"])
        .output()
        .unwrap();
    assert!(made.status.success());
    let rates = ["--error-rate", "0.1", "--truncate-rate", "0.1", "--reset-rate", "0.1"];
    let waits = ["--latency-ms", "5", "--jitter-ms", "10"];
    let certificate = folder.path().join("certificate.pem").to_str().unwrap().to_owned();
    let trusted = ["--ca-file", &certificate];
    for (speaks, asks) in [
        (&[][..], &[][..]),
        (&["--http2"], &["--http2"]),
        (&["--tls", &certificate], &trusted),
        (&["--tls", &certificate, "--http1"], &trusted),
    ] {
        let server = Server::start(&set, &[&rates[..], &waits, speaks].concat());
        let report = folder.path().join("report.json");
        let out = Command::new(env!("CARGO_BIN_EXE_terrane"))
            .args(["fly", &format!("{}tileset.json", server.url), "--offscreen", "--settle"])
            .args(["--size", "160x90", "--sse", "0.02", "--report", report.to_str().unwrap()])
            .args(asks)
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert!(out.status.success(), "{speaks:?}: {}", String::from_utf8_lossy(&out.stderr));
        let report: Value = serde_json::from_slice(&std::fs::read(report).unwrap()).unwrap();
        let tiles = &report["tiles"];
        let (loaded, failed) = (tiles["loaded"].as_u64().unwrap(), tiles["failed"].as_u64().unwrap());
        assert!(loaded > 10, "{speaks:?}: {report}");
        let errors = report["errors"].as_array().unwrap();
        assert_eq!(errors.iter().map(|e| e["count"].as_u64().unwrap()).sum::<u64>(), failed, "{speaks:?}");
        assert!(report["settled"]["coverage"].as_f64().unwrap() > 0.1, "{speaks:?}: {report}");
    }
}

#[test]
fn flight_over_http_writes_a_trace() {
    if no_adapter() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = folder.path().join("set");
    let args = terrane_data_gen::GenArgs { levels: Some(3), seed: 7, ..terrane_data_gen::GenArgs::new(&set) };
    terrane_data_gen::run(&args).unwrap();
    let server = Server::start(&set, &["--error-rate", "0.2", "--seed", "5"]);
    let file = folder.path().join("trace.json");
    let out = Command::new(env!("CARGO_BIN_EXE_terrane"))
        .args(["fly", &format!("http://{}/tileset.json", server.address), "--offscreen", "--settle", "--frames", "30"])
        .args(["--size", "64x64", "--trace", file.to_str().unwrap()])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let json: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    let events = json["traceEvents"].as_array().unwrap();
    let named = |name: &str| events.iter().filter(|e| e["name"] == name).collect::<Vec<_>>();
    assert!(named("thread_name").iter().any(|e| e["args"]["name"] == "main"));
    assert!(named("frame").len() >= 30 && !named("decode").is_empty());
    // One thread fetches several files at a time, so their spans are on separate tracks, not on that of the thread.
    let fetches = named("fetch");
    assert!(!fetches.is_empty() && fetches.iter().all(|e| e["ph"] == "b" || e["ph"] == "e"));
    let mut open: std::collections::BTreeMap<&str, i32> = std::collections::BTreeMap::new();
    for event in events.iter().filter(|e| e["ph"] == "b" || e["ph"] == "e") {
        let depth = open.entry(event["id"].as_str().unwrap()).or_default();
        *depth += if event["ph"] == "b" { 1 } else { -1 };
        assert!((0..=2).contains(depth), "{event}");
    }
    assert!(!open.is_empty() && open.values().all(|depth| *depth == 0), "all requests end");
    let unwritable = folder.path().join("none/trace.json");
    let out = Command::new(env!("CARGO_BIN_EXE_terrane"))
        .args(["fly", set.to_str().unwrap(), "--offscreen", "--frames", "1", "--size", "16x16"])
        .args(["--trace", unwritable.to_str().unwrap()])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert_eq!(out.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&out.stderr).contains("none/trace.json"));
}
