//! Names of archives, and splitting a path or URL into an archive and a member.

use std::path::{Path, PathBuf};

#[cfg(feature = "http")]
use super::uri::percent_decode;
#[cfg(all(feature = "http", feature = "testing"))]
use super::uri::{is_remote, server, shown};

/// Returns true for the name of an archive that may hold a tile set (`.3tz`, `.zip`, `.terrane`).
pub(crate) fn is_archive(name: &str) -> bool {
    ends_with(name, ".3tz") || ends_with(name, ".zip") || is_packed(name)
}

/// Returns true for the name of a packed set.
pub(crate) fn is_packed(name: &str) -> bool {
    ends_with(name, ".terrane")
}

/// Returns true for the name of a PMTiles file.
pub(crate) fn is_pmtiles(name: &str) -> bool {
    ends_with(name, ".pmtiles")
}

fn ends_with(name: &str, extension: &str) -> bool {
    let end = name.len().checked_sub(extension.len()).and_then(|at| name.get(at..));
    end.is_some_and(|end| end.eq_ignore_ascii_case(extension))
}

/// Splits a path into an existing archive file and the name of a member inside it. Looks at the file system.
pub(crate) fn split_path(path: &str) -> Option<(PathBuf, String)> {
    let archive = Path::new(path).ancestors().skip(1).find(|p| {
        p.file_name().and_then(|n| n.to_str()).is_some_and(|n| is_archive(n) || is_pmtiles(n))
            && std::fs::metadata(p).is_ok_and(|m| m.is_file())
    })?;
    let inside = Path::new(path).strip_prefix(archive).ok()?;
    let parts: Vec<&str> = inside.iter().map(|part| part.to_str()).collect::<Option<_>>()?;
    Some((archive.to_path_buf(), parts.join("/")))
}

/// Splits a URL into the URL of an archive, with the query, and the decoded name of a member inside it.
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
    Some((format!("{archive}{query}"), percent_decode(inside)?))
}

/// Returns true if the last part of `host/path` is the name of an archive and is not the host.
#[cfg(feature = "http")]
fn is_inner_archive(path: &str) -> bool {
    path.rsplit_once('/').is_some_and(|(_, name)| is_archive(name) || is_pmtiles(name))
}

/// Runs the text operations on URIs on any text and checks their guarantees. Entry point of the fuzz tests.
#[cfg(all(feature = "http", feature = "testing"))]
pub fn fuzz_url(uri: &str) {
    let (shown, split) = (shown(uri), split_url(uri));
    if !is_remote(uri) {
        return;
    }
    assert!(uri.starts_with(server(uri)));
    if let Some((archive, _)) = split {
        assert_eq!(server(&archive), server(uri));
    }
    // No password and no token may remain in the shown form of a valid URL.
    if url::Url::parse(uri).is_ok()
        && let Ok(url) = url::Url::parse(&shown)
    {
        assert!(url.username().is_empty() && url.password().is_none(), "{uri:?}: {shown}");
        let query = url.query().unwrap_or_default();
        assert!(query.split('&').all(|pair| pair.is_empty() || pair.ends_with("...")), "{uri:?}: {shown}");
    }
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
