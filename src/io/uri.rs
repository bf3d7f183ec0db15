//! URIs: where a tile set starts, and which references inside it are followed.
//!
//! A URI is an absolute file path or an http(s) URL. What a tile set names must stay below the folder of its root
//! (files), or on http(s) (servers): a foreign tile set cannot make a client open local files.

use std::borrow::Cow;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use super::IoError;
use super::archive::is_archive;

/// What references may reach: below a folder, or anything on http(s).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RootScope {
    /// Files below this absolute folder.
    Folder(PathBuf),
    /// Any http(s) URL.
    Http,
}

impl RootScope {
    /// The scope of a tile set whose root is `root_uri`, as [`root_uri`] returned it.
    pub fn of(root_uri: &str) -> Self {
        if is_http(root_uri) {
            Self::Http
        } else {
            Self::Folder(Path::new(root_uri).parent().unwrap_or(Path::new("/")).to_path_buf())
        }
    }
}

/// True for http and https URLs.
pub fn is_http(uri: &str) -> bool {
    let lower = |prefix: &str| uri.get(..prefix.len()).is_some_and(|p| p.eq_ignore_ascii_case(prefix));
    lower("http://") || lower("https://")
}

/// A URI for errors, logs and reports: of a URL, the name and password and the values of the query are left out.
pub fn shown(uri: &str) -> Cow<'_, str> {
    if !is_http(uri) {
        return Cow::Borrowed(uri);
    }
    let (path, query) = uri.split_once('?').map_or((uri, None), |(path, query)| (path, Some(query)));
    let start = path.find("://").map_or(0, |at| at + 3);
    let end = path[start..].find('/').map_or(path.len(), |at| start + at);
    let user = path[start..end].rfind('@');
    if query.is_none() && user.is_none() {
        return Cow::Borrowed(uri);
    }
    let mut text = path[..start].to_owned();
    text.push_str(&path[user.map_or(start, |at| start + at + 1)..]);
    for (i, pair) in query.into_iter().flat_map(|q| q.split('&')).enumerate() {
        text.push(if i == 0 { '?' } else { '&' });
        // Without a name, all of it may be the token.
        let name = pair.split_once('=').map_or("", |(name, _)| name);
        text.push_str(name);
        text.push_str(if name.is_empty() { "..." } else { "=..." });
    }
    Cow::Owned(text)
}

/// What a person typed, as a URI: a folder or an archive means its tileset.json, a file itself, a URL ending in `/` or
/// in the name of an archive its tileset.json.
pub fn root_uri(source: &str) -> Result<Arc<str>, IoError> {
    if is_http(source) {
        let mut url = url::Url::parse(source).map_err(|e| bad(source, e.to_string()))?;
        if url.path().ends_with('/') {
            let path = format!("{}tileset.json", url.path());
            url.set_path(&path);
        } else if is_archive(url.path()) {
            url.set_path(&format!("{}/tileset.json", url.path()));
        }
        return Ok(url.as_str().into());
    }
    let path = std::path::absolute(source).map_err(|e| bad(source, e.to_string()))?;
    let is_inside = path.is_dir() || (path.is_file() && path.to_str().is_some_and(is_archive));
    let path = if is_inside { path.join("tileset.json") } else { path };
    path.to_str().map(Arc::from).ok_or_else(|| bad(source, "the path is not UTF-8"))
}

/// `reference`, found in the file `base_uri`, as a URI. Refuses what leaves the scope. A 3D Tiles archive means the
/// tileset.json inside it.
pub fn resolve(base_uri: &str, reference: &str, scope: &RootScope) -> Result<Arc<str>, IoError> {
    match scope {
        RootScope::Http => {
            let base = url::Url::parse(base_uri).map_err(|e| bad(base_uri, e.to_string()))?;
            let mut url = base.join(reference).map_err(|e| bad(reference, e.to_string()))?;
            if !matches!(url.scheme(), "http" | "https") {
                return Err(bad(
                    reference,
                    format!("scheme {} is not allowed in a tile set on a server", url.scheme()),
                ));
            }
            if base.scheme() == "https" && url.scheme() != "https" {
                return Err(bad(reference, "an open connection is not allowed in a tile set on an encrypted one"));
            }
            // Session tokens travel in the root's query; a child without one inherits it, at the same server only.
            if is_3tz(url.path()) {
                url.set_path(&format!("{}/tileset.json", url.path()));
            }
            if url.query().is_none() && url.origin() == base.origin() {
                url.set_query(base.query());
            }
            Ok(url.as_str().into())
        }
        RootScope::Folder(folder) => {
            let scheme = reference.split_once(':').map(|(s, _)| s);
            if scheme.is_some_and(|s| s.len() > 1 && s.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'+')) {
                return Err(bad(reference, "only relative references are allowed in a tile set on disk"));
            }
            let path_text = reference.split(['?', '#']).next().unwrap_or(reference);
            let decoded = percent_decode(path_text).ok_or_else(|| bad(reference, "bad percent escape"))?;
            let relative = Path::new(&decoded);
            if relative.is_absolute() || decoded.starts_with('\\') || decoded.contains('\0') {
                return Err(bad(reference, "absolute paths are not allowed"));
            }
            let mut path = Path::new(base_uri).parent().unwrap_or(Path::new("/")).to_path_buf();
            for component in relative.components() {
                match component {
                    Component::Normal(part) => path.push(part),
                    Component::CurDir => {}
                    Component::ParentDir => {
                        path.pop();
                    }
                    Component::RootDir | Component::Prefix(_) => {
                        return Err(bad(reference, "absolute paths are not allowed"));
                    }
                }
            }
            if is_3tz(&decoded) {
                path.push("tileset.json");
            }
            if !path.starts_with(folder) {
                return Err(bad(reference, format!("leaves the tile set's folder {}", folder.display())));
            }
            path.to_str().map(Arc::from).ok_or_else(|| bad(reference, "the path is not UTF-8"))
        }
    }
}

fn is_3tz(path: &str) -> bool {
    path.to_ascii_lowercase().ends_with(".3tz")
}

fn bad(uri: &str, reason: impl Into<String>) -> IoError {
    IoError::Uri { uri: uri.to_owned(), reason: reason.into() }
}

pub(super) fn percent_decode(text: &str) -> Option<String> {
    if !text.contains('%') {
        return Some(text.to_owned());
    }
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(b) = rest.next() {
        if b == b'%' {
            let high = char::from(rest.next()?).to_digit(16)?;
            let low = char::from(rest.next()?).to_digit(16)?;
            bytes.push((high * 16 + low) as u8);
        } else {
            bytes.push(b);
        }
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_stay_in_their_folder() {
        let scope = RootScope::of("/data/set/tileset.json");
        let ok = |r: &str| resolve("/data/set/sub/tileset.json", r, &scope);
        assert_eq!(&*ok("a%20b.glb").unwrap(), "/data/set/sub/a b.glb");
        assert_eq!(&*ok("../a.glb?x=1").unwrap(), "/data/set/a.glb");
        assert_eq!(&*ok("more.3tz").unwrap(), "/data/set/sub/more.3tz/tileset.json");
        for escape in ["../../a.glb", "/etc/passwd", "file:///etc/passwd", "http://x/y", "%2e%2e/%2e%2e/x", "%2Fetc"] {
            assert!(ok(escape).is_err(), "{escape}");
        }
    }

    #[test]
    fn secrets_are_not_shown() {
        for (uri, text) in [
            ("/data/a?b=c", "/data/a?b=c"),
            ("https://h/a.glb", "https://h/a.glb"),
            ("https://h/a.glb?key=1&v=2#f", "https://h/a.glb?key=...&v=..."),
            ("https://h/a.glb?secret", "https://h/a.glb?..."),
            ("HTTP://me:pass@h:80/a@b", "HTTP://h:80/a@b"),
            ("http://me@h", "http://h"),
        ] {
            assert_eq!(shown(uri), text);
        }
    }

    #[test]
    fn servers_stay_on_http() {
        let r = |x: &str| resolve("http://h/a/tileset.json?k=1", x, &RootScope::Http);
        assert_eq!(&*r("b.glb").unwrap(), "http://h/a/b.glb?k=1");
        assert_eq!(&*r("b.3tz").unwrap(), "http://h/a/b.3tz/tileset.json?k=1");
        assert_eq!(&*root_uri("http://h/b.3TZ?k=1").unwrap(), "http://h/b.3TZ/tileset.json?k=1");
        assert_eq!(&*r("https://other/b.glb").unwrap(), "https://other/b.glb");
        assert!(r("file:///etc/passwd").is_err());
        let get = |base: &str, reference: &str| resolve(base, reference, &RootScope::Http);
        assert_eq!(&*get("https://a/s/t.json?key=1", "x.glb").unwrap(), "https://a/s/x.glb?key=1");
        assert_eq!(&*get("https://a/t.json?key=1", "https://a:444/x.glb").unwrap(), "https://a:444/x.glb");
        assert_eq!(&*get("https://a/t.json?key=1", "https://b/x.glb").unwrap(), "https://b/x.glb");
        assert!(get("https://a/t.json?key=1", "http://a/x.glb").is_err(), "never in clear");
    }
}
