//! The index of 3D Tiles archives is used if it is valid, and is never required.

use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};

use md5::{Digest as _, Md5};
use proptest::prelude::*;
use terrane::fetch::{FileReader, IoError, Limits};
use zip::CompressionMethod::{Deflated, Stored};
use zip::write::{SimpleFileOptions, ZipWriter};
use zip::{CompressionMethod, ZipArchive};

/// The names in the index, as hash and offset.
type Entries = Vec<([u8; 16], u64)>;
type Change = fn(&mut Entries);

/// The content of an archive's index.
struct Making {
    change: Change,
    method: CompressionMethod,
    is_last: bool,
    options: SimpleFileOptions,
}

impl Default for Making {
    fn default() -> Self {
        let options = SimpleFileOptions::default().compression_method(Deflated);
        Self { change: |_| {}, method: Stored, is_last: true, options }
    }
}

fn in_order(entries: &mut Entries) {
    let number = |bytes: &[u8]| u64::from_le_bytes(bytes.try_into().unwrap());
    entries.sort_by_key(|(hash, _)| (number(&hash[..8]), number(&hash[8..])));
}

fn archive(files: &BTreeMap<String, Vec<u8>>, making: &Making) -> Vec<u8> {
    archive_named(files, making, str::to_owned)
}

/// An index whose names differ from those of the directory.
fn archive_named(files: &BTreeMap<String, Vec<u8>>, making: &Making, in_index: impl Fn(&str) -> String) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        writer.start_file(name, making.options).unwrap();
        writer.write_all(bytes).unwrap();
    }
    let bytes = writer.finish().unwrap().into_inner();
    let mut zip = ZipArchive::new(Cursor::new(bytes.clone())).unwrap();
    let mut entries: Entries = (0..zip.len())
        .map(|i| {
            let file = zip.by_index_raw(i).unwrap();
            (Md5::digest(in_index(&file.name().unwrap()).as_bytes()).into(), file.header_start())
        })
        .collect();
    in_order(&mut entries);
    (making.change)(&mut entries);
    let index: Vec<u8> =
        entries.iter().flat_map(|(hash, offset)| hash.iter().copied().chain(offset.to_le_bytes())).collect();
    let mut writer = ZipWriter::new_append(Cursor::new(bytes)).unwrap();
    let of_index = SimpleFileOptions::default().compression_method(making.method);
    writer.start_file("@3dtilesIndex1@", of_index).unwrap();
    writer.write_all(&index).unwrap();
    if !making.is_last {
        writer.start_file("last", making.options).unwrap();
    }
    writer.finish().unwrap().into_inner()
}

/// Enough files that the directory is larger than the end of the archive that is read first.
fn many() -> BTreeMap<String, Vec<u8>> {
    (0..3000u32)
        .map(|i| (format!("a/rather/long/name/of/a/tile/é {i}.glb"), i.to_le_bytes().repeat(100 + i as usize % 7)))
        .chain([("tileset.json".to_owned(), b"{}".to_vec())])
        .collect()
}

/// Few files, whose long names make the directory as large.
fn few() -> BTreeMap<String, Vec<u8>> {
    let name = |i: u32| format!("{}{i}", "d/".repeat(1500));
    (0..60u32).map(|i| (name(i), vec![i as u8; 50 + i as usize])).collect()
}

fn read(folder: &tempfile::TempDir, reader: &FileReader, name: &str) -> Result<Vec<u8>, IoError> {
    reader.read(folder.path().join("set.3tz").join(name).to_str().unwrap())
}

fn written(bytes: &[u8]) -> (tempfile::TempDir, FileReader) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("set.3tz"), bytes).unwrap();
    (folder, FileReader::new(Limits::default()))
}

/// The first headers of the directory are invalid.
fn without_directory(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.len() - 22;
    let start = u32::from_le_bytes(bytes[end + 16..end + 20].try_into().unwrap()) as usize;
    bytes[start] ^= 1;
    bytes
}

/// One bit of a file's name in the directory differs.
fn with_changed_name(mut bytes: Vec<u8>, name: &str) -> Vec<u8> {
    let at = bytes.windows(name.len()).rposition(|w| w == name.as_bytes()).unwrap();
    bytes[at] ^= 2;
    bytes
}

fn is_damaged(error: &IoError) -> bool {
    matches!(error, IoError::Invalid { reason, .. } if reason.contains("damaged archive"))
}

/// Regression: the file was reported as missing.
#[test]
fn file_whose_name_was_corrupted_is_found() {
    let files = BTreeMap::from(["a.glb", "b.glb", "tileset.json"].map(|name| (name.to_owned(), b"content".to_vec())));
    let (folder, reader) = written(&with_changed_name(archive(&files, &Making::default()), "b.glb"));
    let error = read(&folder, &reader, "b.glb").unwrap_err();
    assert!(is_damaged(&error) && !error.is_transient(), "{error:?}");
    assert_eq!(read(&folder, &reader, "a.glb").unwrap(), b"content");
    assert!(matches!(read(&folder, &reader, "none.glb"), Err(IoError::NotFound { .. })));
    // Files that are found through the index are not affected.
    let files = many();
    let (name, content) = files.first_key_value().unwrap();
    let (folder, reader) = written(&with_changed_name(archive(&files, &Making::default()), name));
    assert_eq!(read(&folder, &reader, name).as_ref(), Ok(content));
    assert!(matches!(read(&folder, &reader, "none.glb"), Err(IoError::NotFound { .. })));
}

/// Some programs write names with backslashes or a leading slash. Regression: those files were reported as missing.
#[test]
fn names_in_the_style_of_other_systems_are_found() {
    let plain = |name: &str| name.replace('\\', "/").trim_start_matches('/').to_owned();
    // The directory is within the end of the archive that is read first, or larger than that.
    for further in [0, 4000] {
        let names = ["a\\b.glb", "/c/d.glb", "\\e.glb", "f.glb"].map(str::to_owned);
        let further = (0..further).map(|i| format!("z/one of many files/{i}"));
        let files: BTreeMap<String, Vec<u8>> =
            names.iter().cloned().chain(further).map(|name| (name.clone(), plain(&name).into_bytes())).collect();
        let of_index = archive_named(&files, &Making::default(), plain);
        for bytes in [of_index, archive(&files, &Making { is_last: false, ..Making::default() })] {
            let (folder, reader) = written(&bytes);
            for name in &names {
                assert_eq!(read(&folder, &reader, &plain(name)), Ok(plain(name).into_bytes()), "{name}");
            }
            assert!(matches!(read(&folder, &reader, "b.glb"), Err(IoError::NotFound { .. })));
        }
    }
    let files = BTreeMap::from(["g/h.glb", "g\\h.glb"].map(|name| (name.to_owned(), name.as_bytes().to_vec())));
    let (folder, reader) = written(&archive(&files, &Making { is_last: false, ..Making::default() }));
    for (name, content) in &files {
        assert_eq!(read(&folder, &reader, name).as_ref(), Ok(content), "an exact name takes precedence");
    }
}

/// If two files share a name, index and directory agree. Regression: the index had the first and the directory the
/// last.
#[test]
fn index_with_a_duplicate_name_is_ignored() {
    let files = many();
    let twice = |entries: &mut Entries| {
        // An index entry has another file's offset. The directory decides.
        let hash: [u8; 16] = Md5::digest("a/rather/long/name/of/a/tile/é 7.glb".as_bytes()).into();
        let at = entries.iter().position(|e| e.0 == hash).unwrap();
        entries[if at == 0 { 1 } else { at - 1 }].0 = hash;
    };
    let bytes = without_directory(archive(&files, &Making { change: twice, ..Making::default() }));
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("set.3tz"), bytes).unwrap();
    let reader = FileReader::new(Limits::default());
    let error = read(&folder, &reader, "tileset.json").unwrap_err();
    assert!(error.to_string().contains("directory"), "the invalid directory was read: {error}");
}

#[test]
fn files_are_found_without_the_directory() {
    let files = many();
    for options in [Making::default().options, SimpleFileOptions::default().compression_method(Stored).large_file(true)]
    {
        let bytes = archive(&files, &Making { options, ..Making::default() });
        let (folder, reader) = written(&without_directory(bytes));
        for (name, expected) in &files {
            assert!(read(&folder, &reader, name).as_ref() == Ok(expected), "{name}");
        }
        // Files missing in the index are found through the directory.
        let error = read(&folder, &reader, "none.glb").unwrap_err();
        assert!(matches!(&error, IoError::Invalid { .. }) && error.to_string().contains("directory"), "{error}");
    }
    let (folder, reader) = written(&archive(&files, &Making::default()));
    assert!(matches!(read(&folder, &reader, "none.glb"), Err(IoError::NotFound { .. })));
    assert!(matches!(read(&folder, &reader, "a"), Err(IoError::NotFound { .. })));
}

#[test]
fn wrong_index_is_not_needed() {
    let files = few();
    let wrong: [(&str, Change); 6] = [
        ("another order", |entries| entries.reverse()),
        ("one missing", |entries| entries.truncate(entries.len() - 1)),
        ("one entry too many", |entries| entries.push(([255; 16], 0))),
        ("other places", |entries| {
            let offset = entries[0].1;
            entries.iter_mut().for_each(|e| e.1 = offset);
        }),
        ("places outside", |entries| entries[7].1 = u64::MAX),
        ("other hashes", |entries| {
            entries.iter_mut().for_each(|e| e.0[3] ^= 1);
            in_order(entries);
        }),
    ];
    let mut all: Vec<(&str, Making)> =
        wrong.into_iter().map(|(what, change)| (what, Making { change, ..Making::default() })).collect();
    all.push(("compressed", Making { method: Deflated, ..Making::default() }));
    all.push(("not last", Making { is_last: false, ..Making::default() }));
    for (what, making) in all {
        let (folder, reader) = written(&archive(&files, &making));
        for (name, expected) in &files {
            assert!(read(&folder, &reader, name).as_ref() == Ok(expected), "{what}");
        }
        assert!(matches!(read(&folder, &reader, "none"), Err(IoError::NotFound { .. })), "{what}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(if kit::long_tests() { 96 } else { 12 }))]

    /// With any corruption, a file has its content or reading fails.
    #[test]
    fn corrupt_archives_are_errors(
        cut in prop::option::of(0.0f64..1.0),
        changes in prop::collection::vec((0.0f64..1.0, any::<u8>()), 0..40),
    ) {
        let files = few();
        let mut bytes = archive(&files, &Making::default());
        let length = bytes.len();
        // Most of the archive is names; the last quarter has index and directory.
        for (at, value) in changes {
            let at = (length as f64 * (0.4 + 0.6 * at)) as usize;
            bytes[at.min(length - 1)] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate((length as f64 * cut) as usize);
        }
        let (folder, reader) = written(&bytes);
        for (name, expected) in &files {
            if let Ok(read) = read(&folder, &reader, name) {
                prop_assert!(read == *expected);
            }
        }
    }
}

#[cfg(feature = "http")]
mod over_http {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use kit::server::{Reply, Server};
    use terrane::fetch::{HttpClient, HttpConfig};

    fn server(bytes: Vec<u8>) -> Server {
        Server::start(move |r| Reply::ok(bytes.clone()).with("ETag", "\"1\"").ranged(r))
    }

    /// Returns the contents of the files, and the number of bytes read.
    fn get(server: &Server, names: &[&String]) -> (Vec<Result<Vec<u8>, IoError>>, u64) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let client = HttpClient::new(&HttpConfig { max_retries: 0, ..HttpConfig::default() }).unwrap();
        let mut network_bytes = 0;
        let mut get = |name: &String| {
            let url = format!("{}/set.3tz/{}", server.url, name.replace(' ', "%20"));
            let body = runtime.block_on(client.get(&url, &Limits::default()));
            body.map(|body| {
                network_bytes += body.network_bytes;
                body.bytes
            })
        };
        (names.iter().map(|name| get(name)).collect(), network_bytes)
    }

    #[test]
    fn index_replaces_the_directory() {
        let files = many();
        // The last file is followed by the former directory.
        let names: Vec<&String> = files.keys().step_by(500).take(6).collect();
        let expected: Vec<Result<Vec<u8>, IoError>> = names.iter().map(|n| Ok(files[*n].clone())).collect();
        let indexed = archive(&files, &Making::default());
        let mut bytes_that_came = Vec::new();
        // Without the index, another file is the last.
        for bytes in [without_directory(indexed), archive(&files, &Making { is_last: false, ..Making::default() })] {
            let server = server(bytes);
            let (read, bytes) = get(&server, &names);
            assert!(read == expected);
            assert_eq!(server.count(), 2 + names.len(), "{:?}", server.seen());
            bytes_that_came.push(bytes);
        }
        let [with, without] = bytes_that_came[..] else { unreachable!() };
        let tail = 128 << 10;
        assert!(with < tail + 24 * 3001 + 20_000 && without > tail + 80 * 3000, "{with} {without}");
    }

    #[test]
    fn wrong_index_costs_one_read_of_the_directory() {
        let files = many();
        let lie = |entries: &mut Entries| {
            let offset = entries[0].1;
            entries.iter_mut().for_each(|e| e.1 = offset);
        };
        let server = server(archive(&files, &Making { change: lie, ..Making::default() }));
        let names: Vec<&String> = files.keys().step_by(400).collect();
        let (read, _) = get(&server, &names);
        for (name, read) in names.iter().zip(read) {
            assert!(read.as_ref() == Ok(&files[*name]), "{name}");
        }
        // Requests: the end, the index, the file it points at, the directory once, each file once.
        assert!(server.count() <= 4 + names.len(), "{}", server.count());
        let missing = "none.glb".to_owned();
        assert!(matches!(get(&server, &[&missing]).0[0], Err(IoError::NotFound { .. })));
    }

    /// Regression: the name counted as missing for as long as the directory was cached.
    #[test]
    fn corrupted_name_is_read_again() {
        let files = BTreeMap::from(["a.glb", "b.glb", "c.glb"].map(|name| (name.to_owned(), b"content".to_vec())));
        let (name, none) = ("b.glb".to_owned(), "none.glb".to_owned());
        // With an index, and without one like a plain zip.
        for is_last in [true, false] {
            let good = archive(&files, &Making { is_last, ..Making::default() });
            let bent = with_changed_name(good.clone(), &name);
            let count = AtomicUsize::new(0);
            let server = Server::start(move |r| {
                let is_first = count.fetch_add(1, Ordering::Relaxed) == 0;
                Reply::ok(if is_first { bent.clone() } else { good.clone() }).with("ETag", "\"1\"").ranged(r)
            });
            let (got, _) = get(&server, &[&name, &name, &none, &none]);
            let error = got[0].as_ref().unwrap_err();
            assert!(is_damaged(error) && error.is_doubtful(), "{error:?}");
            assert_eq!(got[1].as_deref(), Ok(&b"content"[..]));
            assert!(got[2..].iter().all(|got| matches!(got, Err(IoError::NotFound { .. }))), "{got:?}");
            // Requests: the end, the same again, and the file. Without an index, directories are read twice before a
            // file is missing.
            let requests = if is_last { 3 } else { 5 };
            assert_eq!(server.count(), requests, "{:?}", server.seen());
        }
    }
}
