//! Archives as folders: 3D Tiles archives (`.3tz`), plain zip and PMTiles, without unpacking them. A URI goes on inside:
//! `set.3tz/tileset.json`, `imagery.pmtiles/3/1/2.png`.
//!
//! The directory at the end is read once, or the much smaller index of a 3D Tiles archive; a member by one piece from the middle: of a file on the file threads
//! ([`LocalArchive`]), from a server by range requests (`src/io/http/archive.rs`). What is here does no I/O of its own
//! besides.

mod directory;
mod index;
mod local;
mod local_tiles;
mod member;
pub(crate) mod pmtiles;

use std::hash::Hash;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use lru::LruCache;

use super::{IoError, Limits};

#[cfg(feature = "http")]
pub(crate) use directory::{DAMAGED, Directory, End, Member, Span, TAIL_BYTES};
pub use index::fuzz_index;
#[cfg(feature = "http")]
pub(crate) use index::{Index, own_header};
use local::LocalArchive;
use local_tiles::LocalTiles;
#[cfg(feature = "http")]
pub(crate) use member::{SLACK_BYTES, check, data_of, piece_of, unpack};

/// True for the name of an archive that may hold a tile set.
pub(crate) fn is_archive(name: &str) -> bool {
    ends_with(name, ".3tz") || ends_with(name, ".zip")
}

/// True for the name of a PMTiles file.
pub(crate) fn is_pmtiles(name: &str) -> bool {
    ends_with(name, ".pmtiles")
}

fn ends_with(name: &str, extension: &str) -> bool {
    let end = name.len().checked_sub(extension.len()).and_then(|at| name.get(at..));
    end.is_some_and(|end| end.eq_ignore_ascii_case(extension))
}

/// Archives whose directories a reader keeps.
pub(crate) const KEPT_ARCHIVES: NonZeroUsize = NonZeroUsize::new(64).expect("not zero");
/// Bytes of these directories together; of the archive that was used last it is kept all the same.
pub(crate) const KEPT_BYTES: usize = 256 << 20;

/// Lets those go that were not used for longest, until all have no more than so much together, or one is left.
pub(crate) fn trim<K: Hash + Eq, V>(kept: &mut LruCache<K, V>, most: usize, size: impl Fn(&V) -> usize) {
    if kept.len() < 2 {
        return;
    }
    let mut all: usize = kept.iter().map(|(_, value)| size(value)).sum();
    while all > most && kept.len() > 1 {
        all -= kept.pop_lru().map_or(0, |(_, value)| size(&value));
    }
}

/// An archive in a file, of either kind.
#[derive(Debug)]
pub(crate) enum Local {
    Zip(LocalArchive),
    Tiles(LocalTiles),
}

impl Local {
    pub fn open(path: &Path, limits: &Limits) -> Result<Self, IoError> {
        if path.to_str().is_some_and(is_pmtiles) {
            return LocalTiles::open(path, limits).map(Self::Tiles);
        }
        LocalArchive::open(path, limits).map(Self::Zip)
    }

    /// Bytes of what is kept of it.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Zip(archive) => archive.bytes(),
            Self::Tiles(tiles) => tiles.bytes(),
        }
    }

    pub fn is_current(&self) -> bool {
        match self {
            Self::Zip(archive) => archive.is_current(),
            Self::Tiles(tiles) => tiles.is_current(),
        }
    }

    /// The file of that name, decompressed. `uri` is what errors name.
    pub fn read(&self, uri: &str, name: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        match self {
            Self::Zip(archive) => archive.read(uri, name, limits),
            Self::Tiles(tiles) => tiles.read(uri, name, limits),
        }
    }

    /// Bytes of the file of that name.
    pub fn size(&self, uri: &str, name: &str, limits: &Limits) -> Result<u64, IoError> {
        match self {
            Self::Zip(archive) => archive.size(uri, name, limits),
            Self::Tiles(tiles) => tiles.size(uri, name, limits),
        }
    }
}

/// The archive that a path goes into, and the way inside it, where there is such a file.
pub(crate) fn split_path(path: &str) -> Option<(PathBuf, String)> {
    let archive = Path::new(path).ancestors().skip(1).find(|p| {
        p.file_name().and_then(|n| n.to_str()).is_some_and(|n| is_archive(n) || is_pmtiles(n))
            && std::fs::metadata(p).is_ok_and(|m| m.is_file())
    })?;
    let inside = Path::new(path).strip_prefix(archive).ok()?;
    let parts: Vec<&str> = inside.iter().map(|part| part.to_str()).collect::<Option<_>>()?;
    Some((archive.to_path_buf(), parts.join("/")))
}

/// The URL of the archive that a URL goes into, with its query, and the way inside it.
#[cfg(feature = "http")]
pub(crate) fn split_url(url: &str) -> Option<(String, String)> {
    let end = url.find(['?', '#']).unwrap_or(url.len());
    let (path, rest) = url.split_at(end);
    let start = path.find("://").map_or(0, |at| at + 3);
    let slashes = path.match_indices('/').map(|(at, _)| at).filter(|at| *at >= start);
    let slash = slashes.into_iter().find(|at| path.get(start..*at).is_some_and(is_inner_archive))?;
    let (archive, inside) = (path.get(..slash)?, path.get(slash + 1..)?);
    if inside.is_empty() {
        return None;
    }
    let query = rest.split('#').next().unwrap_or("");
    Some((format!("{archive}{query}"), super::uri::percent_decode(inside)?))
}

/// The last part of `host/path` is an archive, and it is not the host.
#[cfg(feature = "http")]
fn is_inner_archive(path: &str) -> bool {
    path.rsplit_once('/').is_some_and(|(_, name)| is_archive(name) || is_pmtiles(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(feature = "http")]
    fn urls_that_go_into_archives() {
        let split = |url: &str| split_url(url).map(|(a, m)| format!("{a} {m}"));
        for (url, expected) in [
            ("http://h/a/set.3tz/tileset.json", Some("http://h/a/set.3tz tileset.json")),
            ("http://h/SET.ZIP/a%20b/c.glb?key=1#f", Some("http://h/SET.ZIP?key=1 a b/c.glb")),
            ("http://h/set.3tz", None),
            ("http://h/set.3tz/", None),
            ("http://h.zip/a.glb", None),
            ("http://h.zip/a.zip/b.zip/c", Some("http://h.zip/a.zip b.zip/c")),
            ("http://h/a.glb?from=/x.zip/y", None),
            ("http://h/.3tz/a", Some("http://h/.3tz a")),
            ("http://h/a.PMTiles/1/0/1.png?k=1", Some("http://h/a.PMTiles?k=1 1/0/1.png")),
        ] {
            assert_eq!(split(url).as_deref(), expected, "{url}");
        }
    }

    #[test]
    fn the_archive_used_last_is_kept_whatever_its_size() {
        let mut kept = LruCache::new(KEPT_ARCHIVES);
        let mut put = |name, size| {
            kept.put(name, size);
            trim(&mut kept, 100, |size| *size);
            kept.iter().map(|(name, _)| *name).collect::<String>()
        };
        assert_eq!((put('a', 60), put('b', 40), put('c', 1)), ("a".into(), "ba".into(), "cb".into()));
        assert_eq!((put('d', 500), put('e', 1)), ("d".into(), "e".into()));
    }

    #[test]
    fn paths_that_go_into_archives() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        std::fs::write(path("set.3tz"), "x").unwrap();
        std::fs::create_dir(path("folder.zip")).unwrap();
        assert_eq!(split_path(&path("set.3tz/a/b.glb")), Some((path("set.3tz").into(), "a/b.glb".to_owned())));
        for name in ["set.3tz", "folder.zip/a.glb", "none.zip/a.glb", "a.glb"] {
            assert_eq!(split_path(&path(name)), None, "{name}");
        }
        assert!(!is_archive("zip") && !is_archive("é.3t") && is_archive("é.3Tz"));
    }
}
