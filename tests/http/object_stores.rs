//! Tile sets in object stores: a local server that acts like S3, Google's or Azure's, with faults.

use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use kit::buckets::Buckets;
use kit::pager::{Run, above};
use kit::server::{How, Reply, Request, Server};
use kit::skip::skipped;
use kit::tile_sets::{WORLD_M, write_quadtree};
use terrane::fetch::{CacheConfig, HttpClient, HttpConfig, IoError, Limits, ObjectFolder, ObjectHeaders, StoreOption};
use terrane::formats::inspect_with;
use terrane::pager::PagerConfig;

const SECRET: &str = "wJalrXUtnFEMI-a-key-nobody-may-see";

fn options(of: &[(&str, &str)]) -> Vec<StoreOption> {
    of.iter().map(|(name, value)| StoreOption::new(name, value)).collect()
}

/// Returns an S3 store with fixed keys at the address of a server.
fn s3(url: &str) -> HttpConfig {
    HttpConfig {
        store_options: options(&[
            ("aws_endpoint", url),
            ("aws_allow_http", "true"),
            ("aws_access_key_id", "AKIATEST"),
            ("aws_secret_access_key", SECRET),
            ("aws_region", "eu-test-1"),
        ]),
        retry_backoff: Duration::from_millis(2),
        ..HttpConfig::default()
    }
}

fn get_with(config: &HttpConfig, uri: &str) -> Result<Vec<u8>, IoError> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let client = HttpClient::new(config)?;
        let body = client.get(uri, &Limits::default()).await?;
        client.flush().await;
        Ok(body.bytes)
    })
}

/// Serves objects by `/bucket/key`, with tags and ranges, like S3.
fn bucket(objects: BTreeMap<String, Vec<u8>>) -> Server {
    Server::start(move |r| match objects.get(r.path()) {
        Some(bytes) => {
            let tag = format!("\"{:08x}\"", bytes.iter().fold(7u32, |h, b| h.wrapping_mul(31) ^ u32::from(*b)));
            if r.header("if-none-match") == Some(&tag) {
                return Reply::new(304, "").with("ETag", tag);
            }
            let date = "Sun, 09 Sep 2001 01:46:40 GMT";
            Reply::ok(bytes.clone()).with("ETag", tag).with("Last-Modified", date).ranged(r)
        }
        None => Reply::new(404, "<Error><Code>NoSuchKey</Code></Error>"),
    })
}

fn objects_below(folder: &Path, prefix: &str) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    entries
        .map(|p| (format!("{prefix}{}", p.file_name().unwrap().to_str().unwrap()), std::fs::read(&p).unwrap()))
        .collect()
}

fn zipped(files: &BTreeMap<String, Vec<u8>>) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        writer.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

fn flown(source: &str, http: HttpConfig) -> Run {
    let mut run = Run::new(source, PagerConfig { http, ..PagerConfig::default() });
    run.max_sse_px = 0.1;
    let middle = above(WORLD_M) + glam::DVec3::new(WORLD_M / 2.0, WORLD_M / 2.0, 0.0);
    run.settle(middle);
    run
}

#[test]
fn set_is_streamed_from_a_bucket_and_from_an_archive_in_it() {
    let folder = tempfile::tempdir().unwrap();
    write_quadtree(folder.path());
    let whole = flown(folder.path().to_str().unwrap(), HttpConfig::default());
    let tiles = whole.stage.counters.tiles_drawn;
    assert!(tiles > 20, "{tiles}");
    let archive = zipped(&objects_below(folder.path(), ""));
    let mut objects = objects_below(folder.path(), "/tiles/a set/");
    objects = objects.into_iter().map(|(key, bytes)| (key.replace(' ', "%20"), bytes)).collect();
    objects.insert("/tiles/sets/one.3tz".to_owned(), archive);
    let server = bucket(objects);
    for source in ["s3://tiles/a set/", "s3://tiles/sets/one.3tz"] {
        let before = server.count();
        let run = flown(source, s3(&server.url));
        let stats = *run.pager.stats();
        assert_eq!((run.stage.counters.tiles_drawn, stats.failed), (tiles, 0), "{:?}", run.pager.errors());
        assert_eq!(stats.bytes_read, whole.pager.stats().bytes_read);
        assert!(stats.bytes_http > 0);
        for request in &server.seen()[before..] {
            let signed = request.header("authorization").unwrap();
            assert!(signed.starts_with("AWS4-HMAC-SHA256 Credential=AKIATEST/"), "{signed}");
            assert!(signed.contains("/eu-test-1/s3/aws4_request") && !format!("{request:?}").contains(SECRET));
            assert_eq!(request.header("range").is_some(), source.ends_with(".3tz"));
        }
    }
    let info = inspect_with("s3://tiles/a set", &Limits::default(), s3(&server.url));
    assert!(info.is_err(), "a key without a slash is an object");
    let info = inspect_with("s3://tiles/a set/", &Limits::default(), s3(&server.url)).unwrap();
    assert!(info.errors.is_empty() && info.tiles > 300, "{info}");
}

#[test]
fn requests_without_keys_are_not_signed() {
    let server = bucket(BTreeMap::from([("/open/a.glb".to_owned(), vec![5; 9])]));
    let of = [("aws_endpoint", server.url.as_str()), ("aws_allow_http", "true"), ("aws_skip_signature", "true")];
    let config = HttpConfig { store_options: options(&of), ..HttpConfig::default() };
    assert_eq!(get_with(&config, "s3://open/a.glb").unwrap(), [5; 9]);
    assert_eq!(server.seen()[0].header("authorization"), None);
}

/// Returns true, and skips the test, if the environment has keys.
fn has_keys_in_environment() -> bool {
    let found = std::env::vars_os().find(|(name, _)| {
        let name = name.to_string_lossy().to_uppercase();
        ["AWS_", "GOOGLE_", "AZURE_", "GCE_METADATA", "SERVICE_ACCOUNT"].iter().any(|p| name.starts_with(p))
    });
    if let Some((name, _)) = &found {
        skipped(format!("the environment has keys: {} is set", name.to_string_lossy()));
    }
    found.is_some()
}

#[test]
fn without_keys_no_metadata_service_is_contacted() {
    if has_keys_in_environment() {
        return;
    }
    let server = Server::start(|_| Reply::ok(vec![5; 9]).with("ETag", "\"1\""));
    let url = server.url.as_str();
    for (scheme, of) in [
        ("s3", vec![("aws_endpoint", url), ("aws_allow_http", "true")]),
        ("gs", vec![("google_base_url", url), ("google_allow_http", "true")]),
        (
            "az",
            vec![("azure_storage_endpoint", url), ("azure_allow_http", "true"), ("azure_storage_account_name", "a")],
        ),
    ] {
        let before = server.count();
        // A request to any other server would wait for an unreachable address.
        let config = HttpConfig { store_options: options(&of), ..HttpConfig::default() };
        // The quickest, since a busy machine may take long for one.
        let times = (0..3).map(|_| {
            let start = std::time::Instant::now();
            assert_eq!(get_with(&config, &format!("{scheme}://open/a.glb")).unwrap(), [5; 9]);
            start.elapsed()
        });
        let quickest = times.min().unwrap();
        assert!(quickest < Duration::from_secs(1), "{scheme}: {quickest:?}");
        let seen = server.seen().split_off(before);
        assert_eq!(seen.len(), 3, "{scheme}: {seen:?}");
        assert!(seen.iter().all(|request| request.header("authorization").is_none()), "{scheme}: {seen:?}");
    }
}

#[test]
fn named_metadata_service_is_contacted_with_a_short_timeout() {
    if has_keys_in_environment() {
        return;
    }
    let store = bucket(BTreeMap::from([("/b/a.glb".to_owned(), vec![5; 9])]));
    let with = |metadata: &str| HttpConfig {
        store_options: options(&[
            ("aws_endpoint", &store.url),
            ("aws_allow_http", "true"),
            ("aws_metadata_endpoint", metadata),
        ]),
        max_retries: 0,
        ..HttpConfig::default()
    };
    let cloud = Server::start(|r| match r.path() {
        "/latest/api/token" => Reply::ok("token"),
        "/latest/meta-data/iam/security-credentials/" => Reply::ok("role"),
        "/latest/meta-data/iam/security-credentials/role" => Reply::ok(
            r#"{"AccessKeyId":"AKIAROLE","SecretAccessKey":"secret","Token":"t","Expiration":"2199-01-01T00:00:00Z"}"#,
        ),
        _ => Reply::new(404, ""),
    });
    assert_eq!(get_with(&with(&cloud.url), "s3://b/a.glb").unwrap(), [5; 9]);
    let signed = store.seen()[0].header("authorization").unwrap().to_owned();
    assert!(signed.contains("Credential=AKIAROLE/"), "{signed}");

    let silent = Server::start(|_| Reply::ok("").how(How::Silent));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let client = HttpClient::new(&with(&silent.url)).unwrap();
        let start = std::time::Instant::now();
        for _ in 0..20 {
            let error = client.get("s3://b/a.glb", &Limits::default()).await.unwrap_err();
            assert!(matches!(error, IoError::Network { .. }) && error.to_string().contains("metadata"), "{error}");
        }
        // The keys are requested once, not for each object.
        assert!(start.elapsed() < Duration::from_secs(20), "{:?}", start.elapsed());
    });
    assert_eq!((silent.count(), store.count()), (1, 1));
}

#[test]
fn caches_separate_stores() {
    let folder = tempfile::tempdir().unwrap();
    let stores = [1u8, 2].map(|n| {
        bucket(BTreeMap::from([("/b/tile.glb".to_owned(), vec![n; 500]), ("/tiles/tile.glb".to_owned(), vec![n; 500])]))
    });
    let cached = |http: HttpConfig, offline| HttpConfig {
        cache: Some(CacheConfig { offline, ..CacheConfig::new(folder.path()) }),
        ..http
    };
    let azure = |url: &str| HttpConfig {
        store_options: options(&[
            ("azure_storage_endpoint", url),
            ("azure_allow_http", "true"),
            ("azure_storage_account_name", "account"),
            ("azure_skip_signature", "true"),
        ]),
        ..HttpConfig::default()
    };
    for offline in [false, true] {
        for (store, n) in stores.iter().zip([1u8, 2]) {
            let from = |config, uri| get_with(&cached(config, offline), uri).unwrap();
            assert_eq!(from(s3(&store.url), "s3://b/tile.glb"), [n; 500], "offline {offline}");
            assert_eq!(from(azure(&store.url), "az://tiles/tile.glb"), [n; 500], "offline {offline}");
        }
    }
    let third = s3("http://127.0.0.1:1");
    assert!(matches!(get_with(&cached(third, true), "s3://b/tile.glb"), Err(IoError::Offline { .. })));
}

#[test]
fn google_and_azure_have_their_request_formats() {
    let set = zipped(&BTreeMap::from([("tileset.json".to_owned(), vec![b' '; 300_000])]));
    let google = {
        let set = set.clone();
        Server::start(move |r| Reply::ok(set.clone()).with("ETag", "\"1\"").ranged(r))
    };
    let of = [
        ("google_base_url", google.url.as_str()),
        ("google_allow_http", "true"),
        ("google_bearer_token", "ya29.token"),
    ];
    let config = HttpConfig { store_options: options(&of), ..HttpConfig::default() };
    assert_eq!(get_with(&config, "gs://tiles/a/b.3tz/tileset.json").unwrap().len(), 300_000);
    let seen = google.seen();
    assert!(seen.iter().all(|r| r.path().starts_with("/tiles/a")), "{seen:?}");
    assert!(seen.iter().all(|r| r.header("authorization") == Some("Bearer ya29.token")), "{seen:?}");

    // Azure does not support suffix ranges, so they are not requested.
    let azure = Server::start(move |r| Reply::ok(set.clone()).with("ETag", "\"1\"").ranged(r));
    let of = [
        ("azure_storage_endpoint", azure.url.as_str()),
        ("azure_allow_http", "true"),
        ("azure_storage_account_name", "account"),
        ("azure_storage_account_key", "c2VjcmV0"),
    ];
    let config = HttpConfig { store_options: options(&of), ..HttpConfig::default() };
    assert_eq!(get_with(&config, "az://tiles/a/b.3tz/tileset.json").unwrap().len(), 300_000);
    for request in azure.seen() {
        assert!(request.path().ends_with("/tiles/a/b.3tz"), "{request:?}");
        assert!(request.header("authorization").unwrap().starts_with("SharedKey account:"), "{request:?}");
        assert!(!request.header("range").unwrap().starts_with("bytes=-"), "{request:?}");
    }
}

#[test]
fn cache_stores_objects() {
    let folder = tempfile::tempdir().unwrap();
    let server = bucket(BTreeMap::from([("/b/tile.glb".to_owned(), vec![1; 5000])]));
    let config = |offline| HttpConfig {
        cache: Some(CacheConfig { offline, ..CacheConfig::new(folder.path()) }),
        ..s3(&server.url)
    };
    for _ in 0..3 {
        assert_eq!(get_with(&config(false), "s3://b/tile.glb").unwrap(), [1; 5000]);
    }
    let seen = server.seen();
    let conditions: Vec<bool> = seen.iter().map(|r| r.header("if-none-match").is_some()).collect();
    assert_eq!(conditions, [false, true, true]);
    assert!(seen[1].header("if-modified-since").is_some());
    let signed = seen[1].header("authorization").unwrap();
    assert!(signed.contains("if-none-match"), "the request is signed: {signed}");
    assert_eq!(get_with(&config(true), "s3://b/tile.glb").unwrap(), [1; 5000]);
    assert!(matches!(get_with(&config(true), "s3://b/other.glb"), Err(IoError::Offline { .. })));
    assert_eq!(server.count(), 3);
    let kept: Vec<u8> = walk(folder.path()).into_iter().flat_map(|p| std::fs::read(p).unwrap()).collect();
    assert!(!kept.windows(SECRET.len()).any(|w| w == SECRET.as_bytes()));
}

fn walk(folder: &Path) -> Vec<std::path::PathBuf> {
    let paths = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    paths.flat_map(|p| if p.is_dir() { walk(&p) } else { vec![p] }).collect()
}

/// Checks the error and the number of requests of a fault after which the server answers or closes the connection.
fn fault(answer: impl Fn(&Request) -> Reply + Send + Sync + 'static) -> (Result<Vec<u8>, IoError>, usize) {
    fault_within(Duration::from_secs(60), answer)
}

fn fault_within(
    timeout: Duration,
    answer: impl Fn(&Request) -> Reply + Send + Sync + 'static,
) -> (Result<Vec<u8>, IoError>, usize) {
    let server = Server::start(answer);
    let config = HttpConfig { first_byte_timeout: timeout, read_timeout: timeout, ..s3(&server.url) };
    let result = get_with(&config, "s3://b/dir/tile.glb");
    if let Err(error) = &result {
        assert_eq!(error.uri(), "s3://b/dir/tile.glb");
        assert!(error.to_string().starts_with("s3://b/dir/tile.glb: ") && !error.to_string().contains(SECRET));
    }
    (result, server.count())
}

#[test]
fn faults_are_typed_and_transient_ones_are_retried() {
    let good = || Reply::ok(vec![3; 4000]).with("ETag", "\"1\"");
    let (result, count) = fault(|_| Reply::new(404, "<Error/>"));
    assert!(matches!(result, Err(IoError::NotFound { .. })) && count == 1, "{result:?}");
    let (result, count) = fault(|_| Reply::new(403, "<Error><Code>AccessDenied</Code></Error>"));
    assert!(matches!(result, Err(IoError::Status { status: 403, .. })) && count == 1, "{result:?}");
    for first in [Reply::new(503, "<Error><Code>SlowDown</Code></Error>"), good().how(How::Cut), Reply::new(429, "")] {
        let (result, count) = fault(move |r| if r.nth == 0 { first.clone() } else { good() });
        assert_eq!((result, count), (Ok(vec![3; 4000]), 2));
    }
    let (result, count) = fault(move |_| good().how(How::Cut));
    assert!(matches!(result, Err(IoError::Network { .. })) && count == 3, "{result:?}");
    let (result, count) = fault(|_| Reply::new(500, ""));
    assert!(matches!(result, Err(IoError::Status { status: 500, .. })) && count == 3, "{result:?}");
    let (result, _) = fault(|_| Reply::new(503, "").with("Retry-After", 3600));
    let retry_after = result.unwrap_err().retry_after();
    assert_eq!(retry_after, Some(Duration::from_secs(3600)));
    for how in [How::Silent, How::Stall] {
        let (result, _) = fault_within(Duration::from_millis(200), move |_| good().how(how));
        assert!(matches!(result, Err(IoError::Timeout { .. })), "{result:?}");
    }
    // A redirect to another host is not followed, because the keys are not for it.
    let (result, count) = fault(|_| Reply::new(301, "").with("Location", "http://127.0.0.1:1/elsewhere"));
    assert!(matches!(result, Err(IoError::Status { status: 301, .. })) && count == 1, "{result:?}");
}

#[test]
fn wrong_store_options_are_reported() {
    let server = bucket(BTreeMap::new());
    let closed = HttpConfig {
        store_options: options(&[
            ("aws_endpoint", &server.url),
            ("aws_access_key_id", "AKIATEST"),
            ("aws_secret_access_key", SECRET),
        ]),
        max_retries: 0,
        ..HttpConfig::default()
    };
    let unknown = HttpConfig { store_options: options(&[("aws_colour", SECRET)]), ..HttpConfig::default() };
    let nobody = s3("http://127.0.0.1:1");
    for (config, uri, part) in [
        (&closed, "s3://b/key", "unencrypted connection"),
        (&unknown, "s3://b/key", "aws_colour"),
        (&s3(&server.url), "s3://b/a//b", "empty"),
        (&s3(&server.url), "s3://b/%zz", "escape"),
        (&nobody, "s3://b/key", "refused"),
    ] {
        let error = get_with(config, uri).unwrap_err();
        assert_eq!(error.uri(), uri);
        let text = error.to_string();
        assert!(text.contains(part) && !text.contains(SECRET), "{text}");
    }
    assert_eq!(server.count(), 0);
}

#[test]
fn set_in_a_bucket_cannot_refer_to_other_buckets() {
    let secret = tempfile::NamedTempFile::new().unwrap();
    let local = secret.path().to_str().unwrap();
    let elsewhere = Server::start(|_| Reply::ok("x"));
    for reference in
        [format!("file://{local}"), "s3://other/key".to_owned(), format!("{}/a.glb", elsewhere.url), "//other/a".into()]
    {
        let set = format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{"refine":"ADD","geometricError":1,
                "boundingVolume":{{"sphere":[0,0,0,9]}},"content":{{"uri":"{reference}"}}}}}}"#
        );
        let server = bucket(BTreeMap::from([("/b/tileset.json".to_owned(), set.into_bytes())]));
        let info = inspect_with("s3://b/", &Limits::default(), s3(&server.url));
        let text = match info {
            Ok(info) => format!("{:?}", info.errors),
            Err(error) => error.to_string(),
        };
        assert!(text.contains("leaves the tile set's bucket s3://b"), "{reference}: {text}");
        assert_eq!((server.count(), elsewhere.count()), (1, 0));
    }
    // An absolute path is a path in the bucket.
    let set = r#"{"asset":{"version":"1.1"},"geometricError":9,"root":{"refine":"ADD","geometricError":1,
        "boundingVolume":{"sphere":[0,0,0,9]},"content":{"uri":"/etc/passwd"}}}"#;
    let server = bucket(BTreeMap::from([("/b/tileset.json".to_owned(), set.as_bytes().to_vec())]));
    let mut run = Run::new("s3://b/", PagerConfig { http: s3(&server.url), ..PagerConfig::default() });
    run.frame(above(20.0));
    run.until(above(20.0), "no answer", |run| !run.pager.errors().is_empty());
    let errors = run.pager.errors();
    assert!(errors[0].uri.contains("s3://b/etc/passwd") && errors[0].reason.contains("not found"), "{errors:?}");
}

const HEADERS: ObjectHeaders = ObjectHeaders { content_type: "application/zip", is_gzip: false };

#[test]
fn objects_are_written_in_parts_listed_and_removed() {
    let fails = AtomicBool::new(true);
    // The second part fails once for a reason that passes.
    let buckets = Buckets::start(move |request| {
        let is_second = request.target.contains("partNumber=2");
        (is_second && fails.swap(false, Ordering::Relaxed)).then(|| Reply::new(503, ""))
    });
    let folder = ObjectFolder::open("s3://tiles/a/sets/", &s3(&buckets.server.url)).unwrap();
    let file = tempfile::NamedTempFile::new().unwrap();
    let bytes: Vec<u8> = (0..40u32 << 20).map(|k| (k >> 12 ^ k) as u8).collect();
    std::fs::write(file.path(), &bytes).unwrap();
    assert_eq!(folder.write_file("big one.3tz", file.path(), HEADERS).unwrap(), 40 << 20);
    folder.write("b/c.json", b"{}".to_vec(), HEADERS).unwrap();
    let objects = buckets.objects();
    assert_eq!(objects.keys().collect::<Vec<_>>(), ["/tiles/a/sets/b/c.json", "/tiles/a/sets/big%20one.3tz"]);
    assert!(objects["/tiles/a/sets/big%20one.3tz"].body == bytes);
    assert_eq!(objects["/tiles/a/sets/b/c.json"].content_type, "application/zip");
    let list = folder.list("b").unwrap();
    assert_eq!((list.objects, list.folders), (vec!["c.json".to_owned()], Vec::new()));
    assert_eq!(folder.list("").unwrap().folders, ["b"]);
    assert!(folder.has("b/c.json").unwrap() && !folder.has("b/d.json").unwrap());
    folder.remove("b/c.json").unwrap();
    folder.remove("b/c.json").unwrap();
    assert_eq!(buckets.objects().len(), 1);
}

#[test]
fn failed_parts_are_removed() {
    let buckets = Buckets::start(|request| request.target.contains("partNumber=2").then(|| Reply::new(403, "")));
    let folder = ObjectFolder::open("s3://tiles", &s3(&buckets.server.url)).unwrap();
    let file = tempfile::NamedTempFile::new().unwrap();
    file.as_file().set_len(33 << 20).unwrap();
    let error = folder.write_file("a.3tz", file.path(), HEADERS).unwrap_err();
    assert!(matches!(&error, IoError::Refused { uri, .. } if uri == "s3://tiles/a.3tz"), "{error:?}");
    assert!(buckets.objects().is_empty(), "{:?}", buckets.objects().keys());
    for (uri, reason) in
        [("https://h/a", "address of a bucket"), ("s3:///a", "address of a bucket"), ("s3://b/../c", "..")]
    {
        let error = ObjectFolder::open(uri, &HttpConfig::default()).unwrap_err().to_string();
        assert!(error.contains(reason), "{uri}: {error}");
    }
}
