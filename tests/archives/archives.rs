//! Archives as folders: from disk and from servers, in all variants of zip, and with errors.

use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};
use std::path::Path;

use kit::pager::{Run, above};
use proptest::prelude::*;
use terrane::fetch::{FileReader, IoError, Limits};
use terrane::formats::inspect;
use terrane::pager::PagerConfig;
use zip::CompressionMethod::{Deflated, Stored};
use zip::write::{SimpleFileOptions, ZipWriter};

fn options() -> SimpleFileOptions {
    SimpleFileOptions::default()
}

/// Returns contents of each kind: text that compresses well, bytes that do not, an empty file.
fn contents() -> BTreeMap<String, Vec<u8>> {
    let noise: Vec<u8> = (0..20_000u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    BTreeMap::from([
        ("tileset.json".to_owned(), b"{ \"asset\": 1 }".repeat(50)),
        ("a/b c/noise.glb".to_owned(), noise),
        ("a/empty".to_owned(), Vec::new()),
        ("é/ü.bin".to_owned(), vec![7; 3000]),
    ])
}

fn zipped(files: &BTreeMap<String, Vec<u8>>, options: SimpleFileOptions) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    writer.add_directory("a/", options).unwrap();
    for (name, bytes) in files {
        writer.start_file(name, options).unwrap();
        writer.write_all(bytes).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Reads files of an archive with these bytes.
struct Archive(tempfile::TempDir);

impl Archive {
    fn new(bytes: &[u8]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("set.3tz"), bytes).unwrap();
        Self(folder)
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join("set.3tz").join(name).to_str().unwrap().to_owned()
    }

    fn read(&self, name: &str) -> Result<Vec<u8>, IoError> {
        FileReader::new(Limits { max_file_bytes: 8 << 20, ..Limits::default() }).read(&self.path(name))
    }
}

#[test]
fn all_variants_of_zip_are_read() {
    let files = contents();
    let mut shapes = vec![
        ("stored", zipped(&files, options().compression_method(Stored))),
        ("deflated", zipped(&files, options().compression_method(Deflated))),
        ("with 64-bit sizes", zipped(&files, options().large_file(true).compression_method(Deflated))),
    ];
    // The sizes follow the contents, as in a zip that was written as a stream.
    let mut writer = ZipWriter::new_stream(Vec::new());
    for (name, bytes) in &files {
        writer.start_file(name, options()).unwrap();
        writer.write_all(bytes).unwrap();
    }
    shapes.push(("streamed", writer.finish().unwrap().into_inner()));
    // The comment has the maximum length and contains the signature of the end.
    let mut writer = ZipWriter::new_append(Cursor::new(shapes[1].1.clone())).unwrap();
    writer.set_raw_comment([&b"PK\x05\x06"[..], &[b'.'; 65_000]].concat().into()).unwrap();
    shapes.push(("commented", writer.finish().unwrap().into_inner()));
    // There are more files than 16 bits can count, and the directory is longer than the end that is read first.
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for i in 0..70_000 {
        writer.start_file(format!("tiles/{i}"), options().compression_method(Stored)).unwrap();
        if i == 35_000 {
            for (name, bytes) in &files {
                writer.start_file(name, options()).unwrap();
                writer.write_all(bytes).unwrap();
            }
        }
    }
    shapes.push(("large", writer.finish().unwrap().into_inner()));
    for (shape, bytes) in shapes {
        let archive = Archive::new(&bytes);
        for (name, expected) in &files {
            assert!(archive.read(name).as_ref() == Ok(expected), "{shape}: {name}: {:?}", archive.read(name).err());
        }
        for name in ["none", "a", "a/", "tileset.json/x", "A/EMPTY", ""] {
            assert!(archive.read(name).is_err(), "{shape}: {name}");
        }
        assert!(matches!(archive.read("none"), Err(IoError::NotFound { .. })), "{shape}");
    }
}

/// Changes all local and central headers of an archive, by the offset of the method in them.
fn change_headers(mut bytes: Vec<u8>, change: impl Fn(&mut [u8])) -> Vec<u8> {
    for at in 0..bytes.len() - 30 {
        let method = match &bytes[at..at + 4] {
            b"PK\x03\x04" => at + 8,
            b"PK\x01\x02" => at + 10,
            _ => continue,
        };
        change(&mut bytes[method - 2..method + 18]);
    }
    bytes
}

#[test]
fn zstd_is_read_and_other_methods_are_errors() {
    let plain = b"heights".repeat(2000);
    let packed = ruzstd::encoding::compress_to_vec(plain.as_slice(), ruzstd::encoding::CompressionLevel::Fastest);
    let one = BTreeMap::from([("f".to_owned(), packed)]);
    let stored = zipped(&one, options().compression_method(Stored));
    let zstd = change_headers(stored.clone(), |header| {
        header[2..4].copy_from_slice(&93u16.to_le_bytes());
        header[8..12].copy_from_slice(&crc32fast::hash(&plain).to_le_bytes());
        header[16..20].copy_from_slice(&(plain.len() as u32).to_le_bytes());
    });
    assert_eq!(Archive::new(&zstd).read("f").unwrap(), plain);
    for (change, what) in [
        ((|h| h[2] = 12) as fn(&mut [u8]), "method 12"),
        (|h| h[0] |= 1, "encrypted"),
        (|h| h[8] ^= 1, "checksum"),
        (|h| h[16] ^= 1, "checksum"),
    ] {
        let error = Archive::new(&change_headers(stored.clone(), change)).read("f").unwrap_err();
        assert!(error.to_string().contains(what), "{error}");
    }
}

#[test]
fn decompression_bombs_are_refused() {
    let zeros = BTreeMap::from([("f".to_owned(), vec![0; 9 << 20])]);
    let archive = Archive::new(&zipped(&zeros, options().compression_method(Deflated)));
    assert!(matches!(archive.read("f"), Err(IoError::TooLarge { .. })));
    // The header gives less than the actual size.
    let liar = change_headers(zipped(&zeros, options()), |h| h[16..20].copy_from_slice(&100u32.to_le_bytes()));
    assert!(matches!(Archive::new(&liar).read("f"), Err(IoError::TooLarge { limit: 100, .. })));
    let many: BTreeMap<String, Vec<u8>> = (0..100).map(|i| (i.to_string(), Vec::new())).collect();
    let archive = Archive::new(&zipped(&many, options()));
    let few = FileReader::new(Limits { max_elements: 99, ..Limits::default() });
    assert!(matches!(few.read(&archive.path("1")), Err(IoError::TooLarge { .. })));
}

#[test]
fn archive_that_an_archive_refers_to_is_named() {
    let archive = Archive::new(&zipped(&contents(), options()));
    let error = archive.read("below/other.3tz/tileset.json").unwrap_err().to_string();
    assert!(error.contains("other.3tz") && error.contains("unpack the outer one"), "{error}");
    assert!(matches!(archive.read("below/tileset.json"), Err(IoError::NotFound { .. })));
}

#[test]
fn replaced_archive_is_read_again() {
    let of = |text: &str| zipped(&BTreeMap::from([("f".to_owned(), text.as_bytes().to_vec())]), options());
    let archive = Archive::new(&of("first"));
    let reader = FileReader::new(Limits::default());
    assert_eq!(reader.read(&archive.path("f")).unwrap(), b"first");
    std::fs::write(archive.0.path().join("set.3tz"), of("the second")).unwrap();
    assert_eq!(reader.read(&archive.path("f")).unwrap(), b"the second");
    assert_eq!(reader.size(&archive.path("f")).unwrap(), 10);
    std::fs::remove_file(archive.0.path().join("set.3tz")).unwrap();
    assert!(matches!(reader.read(&archive.path("f")), Err(IoError::NotFound { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// With any change of bytes, reading gives the content or an error, and never panics.
    #[test]
    fn corrupt_archives_are_errors(cut in 0usize..30_000, changes in prop::collection::vec((any::<u32>(), any::<u8>()), 0..6)) {
        let files = contents();
        let mut bytes = zipped(&files, options().compression_method(Deflated));
        // Most changes hit the directory.
        for (at, value) in &changes {
            let from_end = *at as usize % 700.min(bytes.len());
            let at = bytes.len() - 1 - from_end;
            bytes[at] = *value;
        }
        if changes.len() < 2 {
            bytes.truncate(cut.min(bytes.len()));
        }
        let archive = Archive::new(&bytes);
        for (name, expected) in &files {
            if let Ok(read) = archive.read(name) {
                prop_assert!(read == *expected, "{name}");
            }
        }
    }
}

/// Generates a set of tiles with `terrane gen`, as a folder and as an archive beside it.
fn generated(folder: &Path, archive: &str) {
    let set = folder.join("set");
    let args =
        terrane_data_gen::GenArgs { levels: Some(3), size: 5000.0, seed: 5, ..terrane_data_gen::GenArgs::new(&set) };
    terrane_data_gen::run(&args).unwrap();
    let mut files = BTreeMap::new();
    collect(&set, &set, &mut files);
    std::fs::write(folder.join(archive), zipped(&files, options().compression_method(Deflated))).unwrap();
}

fn collect(root: &Path, folder: &Path, files: &mut BTreeMap<String, Vec<u8>>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(root, &path, files);
        } else {
            let name = path.strip_prefix(root).unwrap().to_str().unwrap().to_owned();
            files.insert(name, std::fs::read(&path).unwrap());
        }
    }
}

/// Loads the whole set from above at full detail.
fn flown(source: &str, config: PagerConfig) -> Run {
    let mut run = Run::new(source, config);
    // The camera looks along the earth's axis.
    let center = run.scene.bounding_sphere().center;
    run.max_sse_px = 0.02;
    run.settle(center + above(4000.0));
    run
}

#[test]
fn generated_set_is_the_same_in_an_archive() {
    for archive in ["set.3tz", "set.zip"] {
        let folder = tempfile::tempdir().unwrap();
        generated(folder.path(), archive);
        let source = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        let (of_folder, of_archive) = (
            inspect(&source("set"), &Limits::default()).unwrap(),
            inspect(&source(archive), &Limits::default()).unwrap(),
        );
        assert!(of_folder.tiles > 20 && of_archive.errors.is_empty(), "{of_archive}");
        assert_eq!(serde_json::to_value(&of_folder).unwrap(), serde_json::to_value(&of_archive).unwrap());
        let whole = flown(&source("set"), PagerConfig::default());
        let packed = flown(&source(archive), PagerConfig::default());
        let tiles = whole.stage.counters.tiles_drawn;
        assert!(tiles > 3, "{tiles}");
        assert_eq!((packed.stage.counters.tiles_drawn, packed.pager.stats().failed), (tiles, 0));
        assert_eq!(packed.pager.stats().bytes_read, whole.pager.stats().bytes_read);
    }
}

#[cfg(feature = "http")]
mod over_http {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Arc, Mutex};
    use std::time::Duration;

    use super::*;
    use kit::server::{How, Reply, Server};
    use terrane::fetch::{CacheConfig, HttpClient, HttpConfig};

    fn client(cache: Option<&Path>) -> HttpClient {
        let cache = cache.map(CacheConfig::new);
        HttpClient::new(&HttpConfig { cache, retry_backoff: Duration::from_millis(2), ..HttpConfig::default() })
            .unwrap()
    }

    fn get(client: &HttpClient, url: &str) -> Result<Vec<u8>, IoError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let body = client.get(url, &Limits::default()).await?;
            client.flush().await;
            Ok(body.bytes)
        })
    }

    /// Serves an archive, which can be replaced, at every path and with ranges. Its tag is its length.
    fn server(bytes: Vec<u8>, headers: &'static [(&str, &str)]) -> (Server, Arc<Mutex<Vec<u8>>>) {
        let bytes = Arc::new(Mutex::new(bytes));
        let of = bytes.clone();
        let server = Server::start(move |r| {
            let bytes = of.lock().unwrap().clone();
            let tag = format!("\"{}\"", bytes.len());
            let mut reply = Reply::ok(bytes).with("ETag", tag);
            for (name, value) in headers {
                reply = reply.with(name, value);
            }
            if r.path().starts_with("/whole/") { reply } else { reply.ranged(r) }
        });
        (server, bytes)
    }

    fn many() -> BTreeMap<String, Vec<u8>> {
        (0..5000)
            .map(|i| (format!("a/rather/long/name/of/a/tile/{i}.glb"), vec![i as u8; 1000]))
            .chain(contents())
            .collect()
    }

    #[test]
    fn members_are_fetched_by_ranges() {
        let files = contents();
        let (small, _) = server(zipped(&files, options()), &[]);
        let reader = client(None);
        for (name, expected) in &files {
            let url = format!("{}/dir/set.3tz/{}?key=1", small.url, name.replace(' ', "%20"));
            assert!(get(&reader, &url).as_ref() == Ok(expected), "{name}");
        }
        let seen = small.seen();
        assert_eq!(seen.len(), 1 + files.len(), "the directory once, each file once");
        assert!(seen.iter().all(|r| r.target == "/dir/set.3tz?key=1" && r.header("range").is_some()), "{seen:?}");
        assert!(seen.iter().all(|r| r.header("accept-encoding") == Some("identity")));

        let files = many();
        let (large, _) = server(zipped(&files, options().large_file(true)), &[]);
        let reader = client(None);
        let url = |name: &str| format!("{}/set.zip/{name}", large.url);
        for i in [0, 17, 4999] {
            let name = format!("a/rather/long/name/of/a/tile/{i}.glb");
            assert!(get(&reader, &url(&name)).as_ref() == Ok(&files[&name]), "{i}");
        }
        assert_eq!(large.count(), 2 + 3, "a directory in two parts");
        // A missing file reads the directory once more.
        for name in ["none", "none", "none.glb"] {
            assert!(matches!(get(&reader, &url(name)), Err(IoError::NotFound { .. })));
            assert_eq!(large.count(), 6);
        }
    }

    #[test]
    fn concurrent_readers_share_one_read_of_the_directory() {
        let files = many();
        let (server, _) = server(zipped(&files, options()), &[]);
        let reader = client(None);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let mut tasks = tokio::task::JoinSet::new();
            for i in 0..40 {
                let (reader, url) =
                    (reader.clone(), format!("{}/set.3tz/a/rather/long/name/of/a/tile/{i}.glb", server.url));
                tasks.spawn(async move {
                    assert_eq!(reader.get(&url, &Limits::default()).await.unwrap().bytes[0], i as u8)
                });
            }
            while let Some(done) = tasks.join_next().await {
                done.unwrap();
            }
        });
        assert_eq!(server.count(), 2 + 40);
    }

    #[test]
    fn servers_without_ranges() {
        let (server, bytes) = server(zipped(&contents(), options()), &[]);
        let url = format!("{}/whole/set.3tz/tileset.json", server.url);
        assert_eq!(get(&client(None), &url).unwrap(), contents()["tileset.json"]);
        let large = BTreeMap::from([("tileset.json".to_owned(), vec![1; 6 << 20])]);
        *bytes.lock().unwrap() = zipped(&large, options().compression_method(Stored));
        let error = get(&client(None), &url).unwrap_err();
        assert!(matches!(error, IoError::Unsupported { .. }), "{error}");
    }

    #[test]
    fn servers_without_ranges_from_the_end() {
        let large = BTreeMap::from([("tileset.json".to_owned(), vec![1; 6 << 20])]);
        let bytes = zipped(&large, options().compression_method(Stored));
        for answer in ["refused", "whole", "another part"] {
            let bytes = bytes.clone();
            let server = Server::start(move |r| match r.header("range").unwrap() {
                range if range.starts_with("bytes=-") && answer == "refused" => Reply::new(400, ""),
                range if range.starts_with("bytes=-") && answer == "whole" => Reply::ok(bytes.clone()),
                // The server takes the length of the suffix for the offset of the last byte.
                range if range.starts_with("bytes=-") => {
                    let part = bytes[..=range[7..].parse().unwrap()].to_vec();
                    let range = format!("bytes 0-{}/{}", part.len() - 1, bytes.len());
                    Reply::new(206, part).with("Content-Range", range)
                }
                _ => Reply::ok(bytes.clone()).ranged(r),
            });
            let url = format!("{}/set.3tz/tileset.json", server.url);
            assert!(get(&client(None), &url).as_ref() == Ok(&large["tileset.json"]), "{answer}");
            // One request less is needed for the length.
            let requests = if answer == "another part" { 3 } else { 4 };
            assert_eq!(server.count(), requests, "{answer}");
        }
    }

    #[test]
    fn changed_archive_is_a_transient_error() {
        let of = |n: usize| {
            let files = BTreeMap::from([("a".to_owned(), vec![1; 100]), ("b".to_owned(), vec![n as u8; 1000 * n])]);
            zipped(&files, options().compression_method(Stored))
        };
        let (server, bytes) = server(of(1), &[]);
        let reader = client(None);
        let url = |name: &str| format!("{}/set.3tz/{name}", server.url);
        assert_eq!(get(&reader, &url("a")).unwrap(), vec![1; 100]);
        *bytes.lock().unwrap() = of(3);
        let error = get(&reader, &url("b")).unwrap_err();
        assert!(error.is_transient() && error.to_string().contains("changed"), "{error}");
        assert_eq!(get(&reader, &url("b")).unwrap(), vec![3; 3000]);
        *bytes.lock().unwrap() = b"the archive is gone".to_vec();
        assert!(get(&reader, &url("a")).is_err());
        assert!(matches!(get(&reader, &url("a")), Err(IoError::Invalid { .. })));
    }

    /// A web page instead of the archive is a transient failure, whether it replaces a member, the directory or parts
    /// of it. Regression: the members were lost permanently.
    #[test]
    fn web_page_instead_of_an_archive_is_a_transient_error() {
        for how in [How::Whole, How::Chunked] {
            let bytes = zipped(&contents(), options());
            let is_down = Arc::new(AtomicBool::new(false));
            let down = is_down.clone();
            let server = Server::start(move |r| {
                if down.load(Ordering::Relaxed) {
                    return Reply::ok("<!DOCTYPE html><p>Please sign in.").how(how);
                }
                Reply::ok(bytes.clone()).ranged(r)
            });
            let url = |name: &str| format!("{}/set.3tz/{name}", server.url);
            let reader = client(None);
            assert_eq!(get(&reader, &url("tileset.json")).as_ref(), Ok(&contents()["tileset.json"]));
            is_down.store(true, Ordering::Relaxed);
            for nth in 0..3 {
                let error = get(&reader, &url("tileset.json")).unwrap_err();
                assert!(error.is_transient(), "{how:?} {nth}: {error}");
            }
            is_down.store(false, Ordering::Relaxed);
            assert_eq!(get(&reader, &url("tileset.json")).as_ref(), Ok(&contents()["tileset.json"]), "{how:?}");
        }
    }

    /// Serves an archive and changes some answers: `change` gets the number of the request and the bytes to send.
    fn changing(bytes: Vec<u8>, change: impl Fn(usize, &mut Vec<u8>) + Send + Sync + 'static) -> Server {
        Server::start(move |r| {
            let mut reply = Reply::ok(bytes.clone()).with("ETag", "\"1\"").ranged(r);
            change(r.nth, &mut reply.body);
            reply
        })
    }

    /// Returns the offset of a file's checksum in the directory at the end of these bytes.
    fn checksum_of(name: &str, bytes: &[u8]) -> usize {
        let is_name =
            |at: &usize| bytes[*at..].starts_with(name.as_bytes()) && bytes[at - 46..].starts_with(b"PK\x01\x02");
        (46..bytes.len()).rev().find(is_name).unwrap() - 46 + 16
    }

    /// A bit was changed in transfer, and the directory is still valid. Regression: the affected files were lost
    /// permanently.
    #[test]
    fn corrupted_directory_is_read_again() {
        for files in [contents(), many()] {
            let flip = |nth: usize, body: &mut Vec<u8>| {
                // The directory is at the end of the first answer, or it is the second one without its end.
                if nth < 2 && body.ends_with(&[0; 2]) || nth == 1 && body.starts_with(b"PK\x01\x02") {
                    let has_it = body.windows(12).any(|w| w == b"tileset.json");
                    if has_it && body.windows(4).any(|w| w == b"PK\x01\x02") {
                        let at = checksum_of("tileset.json", body);
                        body[at] ^= 1;
                    }
                }
            };
            let server = changing(zipped(&files, options()), flip);
            let reader = client(None);
            let url = format!("{}/set.3tz/tileset.json", server.url);
            let error = get(&reader, &url).unwrap_err();
            assert!(error.is_transient() && error.to_string().contains("checksum"), "{error}");
            assert_eq!(get(&reader, &url).as_ref(), Ok(&files["tileset.json"]));
        }
    }

    /// A file that is corrupt in the archive itself does not cause a read of the directory for each retry.
    #[test]
    fn corrupt_file_rarely_rereads_the_directory() {
        let mut bytes = zipped(&contents(), options().compression_method(Stored));
        let at = bytes.windows(10).position(|w| w == [7; 10]).unwrap();
        bytes[at] = 8;
        let server = changing(bytes, |_, _| {});
        let reader = client(None);
        let url = format!("{}/set.3tz/%C3%A9/%C3%BC.bin", server.url);
        assert!((0..5).all(|_| matches!(get(&reader, &url), Err(IoError::Invalid { .. }))));
        let directories = server.seen().iter().filter(|r| r.header("range").unwrap().starts_with("bytes=-")).count();
        assert!((1..=4).contains(&directories), "{directories}");
        assert_eq!(server.count(), 5 + directories);
    }

    /// Regression: all tiles that waited for the directory failed with it permanently.
    #[test]
    fn tiles_load_although_directories_were_corrupted() {
        let glb = terrane::formats::writers::write_glb(&terrane::formats::writers::GlbMesh {
            positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            indices: vec![0, 1, 2],
            base_color: [1.0; 4],
            ..Default::default()
        });
        let files: BTreeMap<String, Vec<u8>> = (0..8).map(|i| (format!("{i}.glb"), glb.clone())).collect();
        let tile = |i: usize| {
            format!(
                r#"{{"boundingVolume":{{"sphere":[0,0,0,2]}},"geometricError":0,"content":{{"uri":"t.zip/{i}.glb"}}}}"#
            )
        };
        let children: Vec<String> = (0..8).map(tile).collect();
        let json = format!(
            r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{{"boundingVolume":{{"sphere":[0,0,0,2]}},
                "geometricError":5,"children":[{}]}}}}"#,
            children.join(",")
        );
        let bytes = zipped(&files, options().compression_method(Stored));
        let server = Server::start(move |r| {
            if r.path().ends_with("json") {
                return Reply::ok(json.clone());
            }
            let mut reply = Reply::ok(bytes.clone()).ranged(r);
            let length = reply.body.len();
            match r.nth {
                // First the end is missing, then the last header, then sizes differ.
                0 => reply.body[length - 22] ^= 1,
                1 => reply.body[length - 22 - 46 - 5] ^= 1,
                2 => reply.body = change_headers(reply.body, |header| header[12] ^= 1),
                _ => {}
            }
            reply
        });
        let mut run = Run::new(
            &format!("{}/set/", server.url),
            PagerConfig { retry_after: Duration::from_millis(2), ..PagerConfig::default() },
        );
        run.until(above(10.0), "tiles were lost", |r| r.stage.counters.tiles_drawn == 8);
        assert!(run.pager.stats().failed >= 16, "{:?}", run.pager.stats());
    }

    #[test]
    fn cache_stores_members() {
        let folder = tempfile::tempdir().unwrap();
        let files = contents();
        for (headers, requests) in [(&[][..], 1), (&[("Cache-Control", "max-age=1000")][..], 0)] {
            let (server, bytes) = server(zipped(&files, options()), headers);
            let url = |name: &str| format!("{}/set.3tz/{}", server.url, name.replace(' ', "%20"));
            let all = |reader: &HttpClient| {
                for (name, expected) in &files {
                    assert!(get(reader, &url(name)).as_ref() == Ok(expected), "{name}");
                }
            };
            all(&client(Some(folder.path())));
            assert_eq!(server.count(), 1 + files.len());
            let second = client(Some(folder.path()));
            all(&second);
            assert_eq!(server.count(), 1 + files.len() + requests, "the directory counts as valid");
            let stats = second.cache().unwrap().stats();
            assert_eq!(stats.hits + stats.revalidated, files.len() as u64);
            if requests > 0 {
                *bytes.lock().unwrap() =
                    zipped(&BTreeMap::from([("tileset.json".to_owned(), vec![b' '; 9])]), options());
                assert_eq!(get(&client(Some(folder.path())), &url("tileset.json")).unwrap(), vec![b' '; 9]);
            }
        }
    }

    #[test]
    fn generated_set_is_streamed_from_an_archive() {
        let folder = tempfile::tempdir().unwrap();
        generated(folder.path(), "set.3tz");
        let (server, _) = server(std::fs::read(folder.path().join("set.3tz")).unwrap(), &[]);
        let whole = flown(folder.path().join("set").to_str().unwrap(), PagerConfig::default());
        let packed = flown(&format!("{}/some/set.3tz", server.url), PagerConfig::default());
        let (tiles, stats) = (whole.stage.counters.tiles_drawn, *packed.pager.stats());
        assert!(tiles > 3, "{tiles}");
        assert_eq!((packed.stage.counters.tiles_drawn, stats.failed), (tiles, 0), "{:?}", packed.pager.errors());
        assert_eq!(stats.bytes_read, whole.pager.stats().bytes_read);
        assert!(stats.bytes_http > 0 && server.seen().iter().all(|r| r.target == "/some/set.3tz"));
    }
}
