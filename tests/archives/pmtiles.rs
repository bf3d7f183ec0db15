//! PMTiles: a pyramid of tiles in one file, written by the `pmtiles` crate, from disk and from servers.

use std::io::Cursor;

use pmtiles::{Compression, PmTilesWriter, TileCoord, TileId, TileType};
use proptest::prelude::*;
use terrane::fetch::{FileReader, IoError, Limits};
use terrane::formats::inspect;

/// Returns the tiles of eight levels with a few gaps. One in a hundred equals its neighbours.
fn content(z: u8, x: u32, y: u32) -> Option<Vec<u8>> {
    let id = TileId::from(TileCoord::new(z, x, y).unwrap()).value();
    match id / 50 % 10 {
        3 => None,
        4 => Some(b"water".to_vec()),
        _ => Some(format!("tile {z}/{x}/{y} ").repeat(2 + id as usize % 5).into_bytes()),
    }
}

/// Enough levels for directories below the root, and few enough for none.
const MANY: u32 = 8;
const FEW: u32 = 4;

/// Returns all tiles of `levels` levels, or every n-th.
fn names(levels: u32, step: usize) -> impl Iterator<Item = (u8, u32, u32)> {
    let end = (4u64.pow(levels) - 1) / 3;
    (0..end).step_by(step).map(|id| {
        let coord = TileCoord::from(TileId::new(id).unwrap());
        (coord.z(), coord.x(), coord.y())
    })
}

fn written(levels: u32, directories: Compression, contents: Compression) -> Vec<u8> {
    let mut bytes = Vec::new();
    let writer = PmTilesWriter::new(TileType::Png).internal_compression(directories).tile_compression(contents);
    let mut writer = writer.create(Cursor::new(&mut bytes)).unwrap();
    for (z, x, y) in names(levels, 1) {
        if let Some(content) = content(z, x, y) {
            writer.add_tile(TileCoord::new(z, x, y).unwrap(), &content).unwrap();
        }
    }
    writer.finalize().unwrap();
    bytes
}

struct OnDisk(tempfile::TempDir, FileReader);

impl OnDisk {
    fn new(bytes: &[u8]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("map.pmtiles"), bytes).unwrap();
        Self(folder, FileReader::new(Limits { max_file_bytes: 1 << 20, ..Limits::default() }))
    }

    fn path(&self, name: &str) -> String {
        self.0.path().join("map.pmtiles").join(name).to_str().unwrap().to_owned()
    }

    fn read(&self, name: &str) -> Result<Vec<u8>, IoError> {
        self.1.read(&self.path(name))
    }
}

#[test]
fn all_tiles_are_found() {
    for (levels, directories, contents) in [
        (FEW, Compression::Gzip, Compression::None),
        (MANY, Compression::Gzip, Compression::Gzip),
        (MANY, Compression::None, Compression::None),
    ] {
        let bytes = written(levels, directories, contents);
        let leaves = u64::from_le_bytes(bytes[48..56].try_into().unwrap());
        assert_eq!(leaves > 0, levels == MANY);
        let disk = OnDisk::new(&bytes);
        for (z, x, y) in names(levels, if levels == MANY { 7 } else { 1 }) {
            let read = disk.read(&format!("{z}/{x}/{y}.png"));
            match content(z, x, y) {
                Some(content) => assert!(read.as_ref() == Ok(&content), "{z}/{x}/{y}"),
                None => assert!(matches!(read, Err(IoError::NotFound { .. })), "{z}/{x}/{y}"),
            }
        }
        for name in ["9/0/0", "1/2/0", "0/0", "tileset.json", "1/1/1/1"] {
            assert!(matches!(disk.read(name), Err(IoError::NotFound { .. })), "{name}");
        }
        assert!(disk.1.size(&disk.path("0/0/0")).unwrap() > 0);
        let error = inspect(disk.0.path().join("map.pmtiles").to_str().unwrap(), &Limits::default()).unwrap_err();
        assert!(error.to_string().contains("PMTiles as a tile set"), "{error}");
    }
}

#[test]
fn replaced_file_is_read_again() {
    let disk = OnDisk::new(&written(FEW, Compression::Gzip, Compression::None));
    assert!(disk.read("0/0/0").is_ok());
    let mut bytes = Vec::new();
    let mut writer = PmTilesWriter::new(TileType::Png).create(Cursor::new(&mut bytes)).unwrap();
    writer.add_tile(TileCoord::new(0, 0, 0).unwrap(), b"other").unwrap();
    writer.finalize().unwrap();
    std::fs::write(disk.0.path().join("map.pmtiles"), bytes).unwrap();
    assert_eq!(disk.read("0/0/0").unwrap(), b"other");
    assert!(matches!(disk.read("1/0/0"), Err(IoError::NotFound { .. })));
}

/// Returns a file with one directory, which is both root and leaf.
fn of_directory(version: u8, packing: u8, directory: &[u8], tiles: u64) -> Vec<u8> {
    let mut bytes = vec![0u8; 127];
    bytes[..7].copy_from_slice(b"PMTiles");
    bytes[7] = version;
    let size = directory.len() as u64;
    for (at, value) in [(8, 127), (16, size), (40, 127), (48, size), (56, 127), (64, tiles)] {
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
    }
    (bytes[97], bytes[98]) = (packing, 1);
    bytes.extend_from_slice(directory);
    bytes
}

#[test]
fn errors_name_the_problem() {
    let bomb = {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        std::io::Write::write_all(&mut encoder, &vec![0; 2 << 20]).unwrap();
        encoder.finish().unwrap()
    };
    for (bytes, part) in [
        (of_directory(3, 1, &[1, 0, 0, 5, 1], 9), "nested too deeply"),
        (of_directory(3, 1, &[1, 0, 0, 6, 1], 9), "out of the file"),
        (of_directory(3, 1, &[1, 0, 1, 9, 2], 9), "out of the file"),
        (of_directory(3, 1, &[1, 0, 1, 9, 1], 9), "ends early"),
        (of_directory(3, 1, &[1, 0, 1, 0, 1], 9), "broken directory"),
        (of_directory(3, 1, &[1, 0, 1, 9, 0], 9), "broken directory"),
        (of_directory(3, 1, &[2, 0, 0, 1, 1, 5, 5, 1, 1], 9), "broken directory"),
        (of_directory(3, 1, &[0xff, 0xff, 0xff, 0x7f], 9), "limit"),
        (of_directory(3, 1, &[9], 9), "broken directory"),
        (of_directory(3, 2, &bomb, 9), "limit"),
        (of_directory(3, 1, &[1, 0, 1, 0x80, 0x80, 0x80, 0x80, 1, 1], 1 << 40), "limit"),
        (of_directory(3, 7, &[0], 9), "compression"),
        (of_directory(2, 1, &[0], 9), "version 2"),
        (of_directory(3, 1, &[0], 9)[..100].to_vec(), "ends early"),
        (b"PMTiles".to_vec(), "ends early"),
        (Vec::new(), "magic"),
    ] {
        let error = OnDisk::new(&bytes).read("0/0/0").unwrap_err();
        assert!(error.to_string().contains(part), "{part}: {error}");
    }
    assert!(matches!(OnDisk::new(&of_directory(3, 1, &[0], 9)).read("0/0/0"), Err(IoError::NotFound { .. })));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// With any corruption, reading gives bytes or an error.
    #[test]
    fn corrupt_files_are_errors(
        cut in prop::option::of(0usize..40_000),
        changes in prop::collection::vec((0usize..40_000, any::<u8>()), 1..30),
    ) {
        static WHOLE: std::sync::LazyLock<Vec<u8>> =
            std::sync::LazyLock::new(|| written(MANY, Compression::None, Compression::None));
        let mut bytes = WHOLE.clone();
        for (at, value) in changes {
            // Half of the changes hit the header.
            let at = if at % 2 == 0 { at % 127 } else { at };
            bytes[at] = value;
        }
        bytes.truncate(cut.unwrap_or(bytes.len()));
        let disk = OnDisk::new(&bytes);
        for (z, x, y) in names(MANY, 911) {
            if let Err(error) = disk.read(&format!("{z}/{x}/{y}")) {
                prop_assert!(!error.reason().is_empty());
            }
        }
    }
}

#[cfg(feature = "http")]
mod over_http {
    use super::*;
    use kit::server::{Reply, Server};
    use terrane::fetch::{CacheConfig, HttpClient, HttpConfig};

    fn server(bytes: Vec<u8>) -> Server {
        Server::start(move |r| Reply::ok(bytes.clone()).with("ETag", format!("\"{}\"", bytes.len())).ranged(r))
    }

    fn get(client: &HttpClient, urls: &[String]) -> Vec<Result<Vec<u8>, IoError>> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let mut tasks = tokio::task::JoinSet::new();
            for (i, url) in urls.iter().cloned().enumerate() {
                let client = client.clone();
                tasks.spawn(async move { (i, client.get(&url, &Limits::default()).await) });
            }
            let mut all = tasks.join_all().await;
            client.flush().await;
            all.sort_by_key(|(i, _)| *i);
            all.into_iter().map(|(_, body)| body.map(|b| b.bytes)).collect()
        })
    }

    #[test]
    fn each_directory_and_each_tile_is_one_request() {
        let server = server(written(MANY, Compression::None, Compression::Gzip));
        let near: Vec<(u8, u32, u32)> = (0..256).map(|i| (7, i % 16, i / 16)).collect();
        let urls: Vec<String> =
            near.iter().map(|(z, x, y)| format!("{}/map.pmtiles/{z}/{x}/{y}.png?key=1", server.url)).collect();
        let client = HttpClient::new(&HttpConfig::default()).unwrap();
        let there = near.iter().filter(|(z, x, y)| content(*z, *x, *y).is_some()).count();
        assert!(there > 100 && there < 256, "{there}");
        for ((z, x, y), read) in near.iter().zip(get(&client, &urls)) {
            assert_eq!(read.ok(), content(*z, *x, *y), "{z}/{x}/{y}");
        }
        let seen = server.seen();
        assert!(seen.iter().all(|r| r.target == "/map.pmtiles?key=1" && r.header("range").is_some()));
        // Neighbours on the Hilbert curve are in one directory or in two.
        let directories = seen.len() - 1 - there;
        assert!((1..=2).contains(&directories), "{directories}");
    }

    /// Returns the offset of the first tile's size in an uncompressed directory. Ids, runs, sizes and offsets follow
    /// its length.
    fn first_size(directory: &[u8]) -> usize {
        let mut ends = (0..directory.len()).filter(|at| directory[*at] < 0x80);
        let end = ends.next().unwrap();
        let count = (0..=end).rev().fold(0, |n, at| n << 7 | usize::from(directory[at] & 0x7f));
        ends.nth(2 * count - 1).unwrap() + 1
    }

    /// One directory below the root cannot be read, another one can.
    #[test]
    fn corrupted_directory_is_read_again() {
        for packing in [Compression::Gzip, Compression::None] {
            let bytes = written(MANY, packing, Compression::Gzip);
            let leaves = u64::from_le_bytes(bytes[40..48].try_into().unwrap());
            let server = Server::start(move |r| {
                let mut reply = Reply::ok(bytes.clone()).with("ETag", "\"1\"").ranged(r);
                let is_first = r.nth == 1 && r.header("range").unwrap().starts_with(&format!("bytes={leaves}-"));
                if is_first {
                    let at = if packing == Compression::Gzip { 15 } else { first_size(&reply.body) };
                    reply.body[at] ^= 4;
                }
                reply
            });
            let client = HttpClient::new(&HttpConfig::default()).unwrap();
            let url = [format!("{}/map.pmtiles/0/0/0", server.url)];
            let error = get(&client, &url).remove(0).unwrap_err();
            assert!(error.is_transient() && matches!(error, IoError::Invalid { .. }), "{packing:?}: {error}");
            assert_eq!(get(&client, &url).remove(0).ok(), content(0, 0, 0), "{packing:?}");
        }
    }

    #[test]
    fn cache_stores_tiles() {
        let folder = tempfile::tempdir().unwrap();
        let server = server(written(FEW, Compression::Gzip, Compression::None));
        let urls: Vec<String> = (0..4).map(|i| format!("{}/map.pmtiles/2/{i}/1", server.url)).collect();
        let client = |offline| {
            let cache = Some(CacheConfig { offline, ..CacheConfig::new(folder.path()) });
            HttpClient::new(&HttpConfig { cache, ..HttpConfig::default() }).unwrap()
        };
        let first = get(&client(false), &urls);
        assert!(first.iter().all(Result::is_ok) && server.count() == 1 + 4);
        assert!(get(&client(false), &urls) == first);
        assert_eq!(server.count(), 5 + 1, "the header counts as valid");
        assert!(get(&client(true), &urls) == first && server.count() == 6);
    }
}
