//! The root of a tile set, and the URIs that its files may refer to. Any thread.
//!
//! References must stay below the folder of the root (files), on http(s) (servers), or in its bucket (object stores).
//! So a foreign tile set can neither open local files nor misuse the user's keys for other buckets. Which servers it reaches
//! is checked when a request is sent, since that depends on their addresses. A user may let a set on disk lead outside of its
//! folder ([`Limits::allow_outside`]).

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::archive_names::{is_archive, is_pmtiles};
use super::error::IoError;
#[cfg(feature = "testing")]
use super::hung_reads::HungReads;
use super::limits::Limits;
use super::time_limit::run_within;
use super::uri::{is_http, is_remote, is_store, percent_decode, server};

/// The set of URIs that references in a tile set may lead to.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum RootScope {
    /// Files below this absolute folder.
    Folder(PathBuf),
    /// Files anywhere and any http(s) URL, for a root on disk with [`Limits::allow_outside`]. Servers are reached if they are
    /// public. What is on a server leads to servers only.
    Anywhere,
    /// Any http(s) URL, for a root on this server, as `https://host:port`. Its servers are reached if they are public or this
    /// very server.
    Server(String),
    /// Objects of one bucket, as `s3://name`.
    Bucket(String),
}

impl RootScope {
    /// Returns the scope of a tile set whose root is `root_uri`, as [`root_uri`] returned it.
    pub fn of(root_uri: &str) -> Self {
        if is_http(root_uri) {
            // The origin has no password.
            let origin = url::Url::parse(root_uri).map(|url| url.origin().ascii_serialization());
            Self::Server(origin.unwrap_or_default())
        } else if is_store(root_uri) {
            Self::Bucket(server(root_uri).to_owned())
        } else {
            // A root that is only a name, such as the ellipsoid's, refers to nothing. Overlays over it may be any file.
            let folder = Path::new(root_uri).parent().filter(|folder| !folder.as_os_str().is_empty());
            Self::Folder(folder.unwrap_or(Path::new("/")).to_path_buf())
        }
    }

    /// Returns the scope of a tile set like [`Self::of`], as far as the limits widen it.
    pub fn of_set(root_uri: &str, limits: &Limits) -> Self {
        match Self::of(root_uri) {
            Self::Folder(_) if limits.allow_outside => Self::Anywhere,
            scope => scope,
        }
    }
}

/// The root of a folder of oblique photogrammetry.
const OBLIQUE_ROOT: &str = "metadata.xml";

/// Returns true for a folder that has a metadata.xml and no tileset.json.
fn is_oblique(folder: &Path) -> bool {
    !folder.join("tileset.json").exists() && folder.join(OBLIQUE_ROOT).is_file()
}

/// Converts user input to the URI of a tile set's root. A folder, an archive, and a URL that ends in `/` or in the name of
/// an archive mean the tileset.json inside; a folder on disk without one means its metadata.xml or layer.json, if it has that.
/// Any other path or URL means itself.
///
/// # Errors
/// [`IoError`] if the source is invalid or no tile set, or if its disk does not answer within the default of
/// [`Limits::file_timeout`].
pub fn root_uri(source: &str) -> Result<Arc<str>, IoError> {
    root_uri_within(source, Limits::default().file_timeout)
}

/// Does the same as [`root_uri`], with another time limit for finding a root on a disk.
pub(crate) fn root_uri_within(source: &str, limit: Duration) -> Result<Arc<str>, IoError> {
    let no_set = |path: &str| match is_pmtiles(path) {
        true => Err(IoError::unsupported(source, "PMTiles as a tile set (its tiles are contents: NAME.pmtiles/z/x/y)")),
        false => Ok(()),
    };
    if is_remote(source) {
        let mut url = url::Url::parse(source).map_err(|e| bad(source, e.to_string()))?;
        if is_store(source) {
            check_object(source, &url)?;
        }
        no_set(url.path())?;
        if url.path().ends_with('/') || url.path().is_empty() {
            let path = format!("{}/tileset.json", url.path().trim_end_matches('/'));
            url.set_path(&path);
        } else if is_archive(url.path()) {
            url.set_path(&format!("{}/tileset.json", url.path()));
        }
        return Ok(url.as_str().into());
    }
    no_set(source)?;
    if source.is_empty() {
        return Err(bad(source, "the name of the source is empty"));
    }
    if let Some((scheme, _)) = source.split_once("://") {
        return Err(IoError::unsupported(source, format!("the scheme {scheme}://")));
    }
    let path = std::path::absolute(source).map_err(|e| bad(source, e.to_string()))?;
    let path = run_within(limit, move || root_file(path)).ok_or_else(|| IoError::file_timeout(source, limit))?;
    path.to_str().map(Arc::from).ok_or_else(|| bad(source, "the path is not UTF-8"))
}

/// Returns the file of the root that a path names. Looks at the disk.
fn root_file(path: PathBuf) -> PathBuf {
    #[cfg(feature = "testing")]
    HungReads::wait_for_metadata(&path);
    let is_inside = path.is_dir() || (path.is_file() && path.to_str().is_some_and(is_archive));
    match is_inside {
        true if is_oblique(&path) => path.join(OBLIQUE_ROOT),
        // A folder of terrain tiles.
        true if !path.join("tileset.json").exists() && path.join("layer.json").is_file() => path.join("layer.json"),
        true => path.join("tileset.json"),
        false => path,
    }
}

/// Resolves `reference`, found in the file `base_uri`, to an absolute URI. A 3D Tiles archive means the tileset.json
/// inside it.
///
/// # Errors
/// [`IoError::Uri`] if the reference is malformed or leaves the scope, [`IoError::OutsideRefused`] if
/// [`Limits::allow_outside`] would allow it.
pub fn resolve(base_uri: &str, reference: &str, scope: &RootScope) -> Result<Arc<str>, IoError> {
    match scope {
        RootScope::Server(_) => url_on_server(base_uri, reference),
        RootScope::Bucket(bucket) => object_in(bucket, base_uri, reference),
        RootScope::Folder(folder) => {
            let outside = || IoError::OutsideRefused { uri: reference.to_owned(), folder: folder.clone() };
            if is_http(reference) {
                return Err(outside());
            }
            let path = file_beside(base_uri, reference)?;
            path.starts_with(folder).then_some(()).ok_or_else(outside)?;
            as_uri(&path, reference)
        }
        RootScope::Anywhere if is_http(base_uri) => url_on_server(base_uri, reference),
        RootScope::Anywhere if is_http(reference) => url_on_server(reference, reference),
        RootScope::Anywhere => as_uri(&file_beside(base_uri, reference)?, reference),
    }
}

/// Resolves a reference in a file on a server.
fn url_on_server(base_uri: &str, reference: &str) -> Result<Arc<str>, IoError> {
    let base = url::Url::parse(base_uri).map_err(|e| bad(base_uri, e.to_string()))?;
    let mut url = base.join(reference).map_err(|e| bad(reference, e.to_string()))?;
    if !matches!(url.scheme(), "http" | "https") {
        return Err(bad(reference, format!("scheme {} is not allowed in a tile set on a server", url.scheme())));
    }
    if base.scheme() == "https" && url.scheme() != "https" {
        return Err(bad(reference, "an open connection is not allowed in a tile set on an encrypted one"));
    }
    if is_3tz(url.path()) {
        url.set_path(&format!("{}/tileset.json", url.path()));
    }
    if let Some(from_base) = base.query().filter(|query| !query.is_empty() && url.origin() == base.origin()) {
        url.set_query(Some(&with_inherited(url.query().unwrap_or(""), from_base)));
    }
    Ok(url.as_str().into())
}

/// Resolves a reference in an object of a bucket.
fn object_in(bucket: &str, base_uri: &str, reference: &str) -> Result<Arc<str>, IoError> {
    let base = url::Url::parse(base_uri).map_err(|e| bad(base_uri, e.to_string()))?;
    let mut url = base.join(reference).map_err(|e| bad(reference, e.to_string()))?;
    // Names of objects have no query.
    url.set_query(None);
    url.set_fragment(None);
    if server(url.as_str()) != bucket {
        return Err(bad(reference, format!("leaves the tile set's bucket {bucket}")));
    }
    if is_3tz(url.path()) {
        url.set_path(&format!("{}/tileset.json", url.path()));
    }
    Ok(url.as_str().into())
}

/// Resolves a relative reference in a file on disk.
fn file_beside(base_uri: &str, reference: &str) -> Result<PathBuf, IoError> {
    let scheme = reference.split_once(':').map(|(s, _)| s);
    if scheme.is_some_and(|s| s.len() > 1 && s.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'+')) {
        return Err(bad(reference, "only relative references are allowed in a tile set on disk"));
    }
    // Windows programs write backslashes, which browsers and the URLs of servers take as slashes too.
    let path_text = reference.split(['?', '#']).next().unwrap_or(reference).replace('\\', "/");
    let decoded = percent_decode(&path_text).ok_or_else(|| bad(reference, "bad percent escape"))?;
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
            Component::RootDir | Component::Prefix(_) => return Err(bad(reference, "absolute paths are not allowed")),
        }
    }
    if is_3tz(&decoded) {
        path.push("tileset.json");
    }
    Ok(path)
}

fn as_uri(path: &Path, reference: &str) -> Result<Arc<str>, IoError> {
    path.to_str().map(Arc::from).ok_or_else(|| bad(reference, "the path is not UTF-8"))
}

/// Adds to a query the parameters of the referring file's query that it lacks. Access keys of the root and session tokens
/// are passed on to all files of a tile set in this way, as CesiumJS does and its servers expect.
fn with_inherited(own: &str, from_base: &str) -> String {
    let name = |pair: &str| pair.split('=').next().unwrap_or_default().to_owned();
    let own_names: Vec<String> = own.split('&').map(name).collect();
    let inherited = from_base.split('&').filter(|pair| !own_names.contains(&name(pair)));
    let pairs: Vec<&str> = own.split('&').chain(inherited).filter(|pair| !pair.is_empty()).collect();
    pairs.join("&")
}

/// Checks that only a bucket precedes the object's key, and that no query follows. Credentials are taken from the
/// environment instead.
fn check_object(source: &str, url: &url::Url) -> Result<(), IoError> {
    let has_bucket = url.host_str().is_some_and(|host| !host.is_empty());
    if !has_bucket || !url.username().is_empty() || url.password().is_some() || url.port().is_some() {
        return Err(bad(source, "not of the form scheme://bucket/key"));
    }
    if url.query().is_some() || url.fragment().is_some() {
        return Err(bad(source, "an object's name has no query"));
    }
    Ok(())
}

fn is_3tz(path: &str) -> bool {
    path.to_ascii_lowercase().ends_with(".3tz")
}

fn bad(uri: &str, reason: impl Into<String>) -> IoError {
    IoError::Uri { uri: uri.to_owned(), reason: reason.into() }
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
        assert_eq!(&*ok("..\\images\\a.png").unwrap(), "/data/set/images/a.png");
        for escape in [
            "..\\..\\a.glb",
            "\\etc\\passwd",
            "\\\\host\\a",
            "../../a.glb",
            "/etc/passwd",
            "file:///etc/passwd",
            "http://x/y",
            "%2e%2e/%2e%2e/x",
            "%2Fetc",
        ] {
            assert!(ok(escape).is_err(), "{escape}");
        }
    }

    #[test]
    fn sets_on_disk_lead_outside_if_they_may() {
        let root = "/data/set/tileset.json";
        let limits = Limits { allow_outside: true, ..Limits::default() };
        let scope = RootScope::of_set(root, &limits);
        assert_eq!(scope, RootScope::Anywhere);
        for remote in ["http://h/t.json", "s3://b/t.json"] {
            assert_eq!(RootScope::of_set(remote, &limits), RootScope::of(remote), "{remote}");
        }
        let ok = |reference: &str| resolve(root, reference, &scope);
        assert_eq!(&*ok("../models/a.glb").unwrap(), "/data/models/a.glb");
        assert_eq!(&*ok("http://h/a b.glb?k=1").unwrap(), "http://h/a%20b.glb?k=1");
        assert_eq!(&*ok("https://h/a.3tz").unwrap(), "https://h/a.3tz/tileset.json");
        for odd in ["/etc/passwd", "file:///etc/passwd", "s3://b/x", "data:,x"] {
            assert!(ok(odd).is_err(), "{odd}");
        }
        // Others write what is on a server.
        let below = |reference: &str| resolve("https://h/s/t.json", reference, &scope);
        assert_eq!(&*below("../../../a.glb").unwrap(), "https://h/a.glb");
        assert!(below("file:///etc/passwd").is_err() && below("http://h/a").is_err());
        for (reference, narrow) in [("../a.glb", RootScope::of(root)), ("http://h/a.glb", RootScope::of(root))] {
            let error = resolve(root, reference, &narrow).unwrap_err();
            assert!(error.to_string().contains("--allow-outside allows it"), "{error}");
        }
    }

    /// Regression: images on disk over the ellipsoid were refused.
    #[test]
    fn name_without_a_folder_covers_all_files() {
        assert_eq!(RootScope::of("globe"), RootScope::Folder("/".into()));
    }

    #[test]
    fn root_that_cannot_be_one_says_why() {
        for (source, reason) in [("", "empty"), ("ftp://h/a", "scheme ftp://")] {
            let error = root_uri(source).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn objects_stay_in_their_bucket() {
        let root = root_uri("s3://Tiles_1/set/").unwrap();
        assert_eq!(&*root, "s3://Tiles_1/set/tileset.json");
        assert_eq!(&*root_uri("S3://b").unwrap(), "s3://b/tileset.json");
        assert_eq!(&*root_uri("gs://b/a.3tz").unwrap(), "gs://b/a.3tz/tileset.json");
        assert_eq!(&*root_uri("az://b/a b.json").unwrap(), "az://b/a%20b.json");
        assert!(matches!(root_uri("/d/a.pmtiles"), Err(IoError::Unsupported { .. })));
        assert!(matches!(root_uri("http://h/a.pmtiles?k=1"), Err(IoError::Unsupported { .. })));
        for odd in ["s3://", "s3:///key", "s3://me@b/key", "s3://b:80/key", "s3://b/key?x=1"] {
            assert!(root_uri(odd).is_err(), "{odd}");
        }
        let scope = RootScope::of(&root);
        assert_eq!(scope, RootScope::Bucket("s3://Tiles_1".to_owned()));
        let ok = |r: &str| resolve("s3://Tiles_1/set/sub/tileset.json", r, &scope);
        assert_eq!(&*ok("a b.glb?v=1#x").unwrap(), "s3://Tiles_1/set/sub/a%20b.glb");
        assert_eq!(&*ok("../../../../a.glb").unwrap(), "s3://Tiles_1/a.glb");
        assert_eq!(&*ok("/more.3tz").unwrap(), "s3://Tiles_1/more.3tz/tileset.json");
        assert_eq!(&*ok("s3://Tiles_1/x").unwrap(), "s3://Tiles_1/x");
        for escape in
            ["s3://other/x", "s3://tiles_1/x", "//other/x", "gs://Tiles_1/x", "s3://k@Tiles_1/x", "s3://Tiles_1:8/x"]
        {
            assert!(ok(escape).is_err(), "{escape}");
        }
        for other in ["file:///etc/passwd", "https://h/x", "data:,x", "C:\\x"] {
            assert!(ok(other).is_err(), "{other}");
        }
        assert!(resolve("http://h/t.json", "s3://b/x", &RootScope::of("http://h/")).is_err());
        assert!(resolve("/d/t.json", "s3://b/x", &RootScope::Folder("/d".into())).is_err());
    }

    #[test]
    fn servers_stay_on_http() {
        let scope = RootScope::of("http://me:pass@h/a/tileset.json?k=1");
        assert_eq!(scope, RootScope::Server("http://h".to_owned()));
        let r = |x: &str| resolve("http://h/a/tileset.json?k=1", x, &scope);
        assert_eq!(&*r("b.glb").unwrap(), "http://h/a/b.glb?k=1");
        assert_eq!(&*r("b.3tz").unwrap(), "http://h/a/b.3tz/tileset.json?k=1");
        assert_eq!(&*root_uri("http://h/b.3TZ?k=1").unwrap(), "http://h/b.3TZ/tileset.json?k=1");
        assert_eq!(&*r("https://other/b.glb").unwrap(), "https://other/b.glb");
        for file in ["file:///etc/passwd", "FILE:/etc/passwd", "file:passwd", "C:\\x", "c:/x", "data:,x", "jar:file:/x"]
        {
            assert!(r(file).is_err(), "{file}");
        }
        assert_eq!(&*r("/etc/passwd").unwrap(), "http://h/etc/passwd?k=1", "a path is one of the server");
        let get = |base: &str, reference: &str| resolve(base, reference, &scope);
        assert_eq!(&*get("https://a/s/t.json?key=1", "x.glb").unwrap(), "https://a/s/x.glb?key=1");
        assert_eq!(&*get("https://a/t.json?key=1", "https://a:444/x.glb").unwrap(), "https://a:444/x.glb");
        assert_eq!(&*get("https://a/t.json?key=1", "https://b/x.glb").unwrap(), "https://b/x.glb");
        assert!(get("https://a/t.json?key=1", "http://a/x.glb").is_err(), "never in clear");
        for (base, reference, query) in [
            ("?key=1", "x.json?session=a%20b", "?session=a%20b&key=1"),
            ("?session=s&key=1", "x.glb", "?session=s&key=1"),
            ("?session=s&key=1", "x.glb?session=t", "?session=t&key=1"),
            ("?key=1&key=2&v", "x.glb?v=3&", "?v=3&key=1&key=2"),
            ("?", "x.glb?a", "?a"),
            ("", "x.glb?a=1&a=2", "?a=1&a=2"),
            ("", "x.glb", ""),
        ] {
            let path = reference.split('?').next().unwrap();
            let whole = get(&format!("https://a/t.json{base}"), reference).unwrap();
            assert_eq!(&*whole, format!("https://a/{path}{query}"), "{base} {reference}");
        }
    }
}
