//! [`CacheKeys`]: the key of a URI's entry, which depends on who asks. Any thread.
//!
//! A server may answer each user differently, so the credentials that a request carries are part of its key, as a keyed hash
//! (HMAC-SHA256). The secret of that hash is made at random once for each cache folder: from the name of an entry alone, no
//! one can test guesses of a password. Requests without credentials have the plain SHA-256 hash of their URI as key.

use std::borrow::Cow;
use std::fmt;
use std::sync::OnceLock;

use ring::hmac;
use url::Url;

use super::files::{self, Files, Hash};

/// The location and the credentials that a client has for the object stores of one scheme.
#[derive(Clone, Default, PartialEq, Eq)]
pub(crate) struct StoreAsker {
    /// `s3`, `gs` or `az`.
    pub scheme: &'static str,
    /// The location of the store, unless it is the scheme's default. Equal buckets and keys of different stores differ.
    pub location: Option<String>,
    /// The credentials that sign requests; empty if requests are not signed.
    pub credentials: Vec<u8>,
}

/// The credentials that a client sends. Debug output has none of them.
#[derive(Clone, Default)]
pub(crate) struct Asker {
    /// Credentials by the origin of http(s) URLs: scheme, host and port.
    pub origins: Vec<(String, Vec<u8>)>,
    pub stores: Vec<StoreAsker>,
}

impl Asker {
    fn store(&self, uri: &str) -> Option<&StoreAsker> {
        let (scheme, _) = uri.split_once("://")?;
        self.stores.iter().find(|store| scheme.eq_ignore_ascii_case(store.scheme))
    }

    /// Returns the credentials that a request for a URI carries; empty for none. User name and password of a URL are part of
    /// the URI, so that one byte stands for them here.
    fn credentials(&self, uri: &str) -> Vec<u8> {
        if let Some(store) = self.store(uri) {
            return store.credentials.clone();
        }
        if self.origins.is_empty() && !uri.contains('@') {
            return Vec::new();
        }
        let Ok(url) = Url::parse(uri) else { return Vec::new() };
        let origin = url.origin().ascii_serialization();
        let of_origin = self.origins.iter().find(|(of, _)| *of == origin);
        let mut credentials = of_origin.map(|(_, credentials)| credentials.clone()).unwrap_or_default();
        if !url.username().is_empty() || url.password().is_some() {
            credentials.push(b'@');
        }
        credentials
    }
}

impl fmt::Debug for Asker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Asker").finish_non_exhaustive()
    }
}

/// Computes the keys of one client.
#[derive(Debug, Default)]
pub(super) struct CacheKeys {
    asker: Asker,
    /// Read with the first key that needs it.
    secret: OnceLock<hmac::Key>,
}

impl CacheKeys {
    pub fn new(asker: Asker) -> Self {
        Self { asker, secret: OnceLock::new() }
    }

    /// Returns the key of a URI.
    pub fn key(&self, files: &Files, uri: &str) -> Hash {
        let uri = uri.split('#').next().unwrap_or(uri);
        let location = self.asker.store(uri).and_then(|store| store.location.as_ref());
        let what = match location {
            // The `#` separates them, since the fragment of the URI is cut off.
            Some(location) => Cow::Owned(format!("{uri}#{location}")),
            None => Cow::Borrowed(uri),
        };
        let credentials = self.asker.credentials(uri);
        if credentials.is_empty() {
            return files::hash(what.as_bytes());
        }
        let secret = self.secret.get_or_init(|| hmac::Key::new(hmac::HMAC_SHA256, &files.secret()));
        let mut context = hmac::Context::with_key(secret);
        // The length separates the two.
        context.update(&(what.len() as u64).to_le_bytes());
        context.update(what.as_bytes());
        context.update(&credentials);
        let mut key = Hash::default();
        key.copy_from_slice(context.sign().as_ref());
        key
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asker(origin: &str, credentials: &[u8]) -> Asker {
        Asker { origins: vec![(origin.to_owned(), credentials.to_vec())], stores: Vec::new() }
    }

    #[test]
    fn keys_depend_on_who_asks() {
        let folder = tempfile::tempdir().unwrap();
        let files = Files::open(folder.path()).unwrap();
        let key = |asker: &Asker, uri: &str| CacheKeys::new(asker.clone()).key(&files, uri);
        let (nobody, one, two) = (Asker::default(), asker("http://h", b"1"), asker("http://h", b"2"));
        let plain = files::hash(b"http://h/a");
        // Existing caches stay valid.
        assert_eq!(key(&nobody, "http://h/a#part"), plain);
        assert_eq!(key(&one, "http://other/a"), files::hash(b"http://other/a"), "these credentials are not for it");
        assert_eq!(key(&one, "http://h/a"), key(&one, "http://h/a#part"), "equal in each process");
        let keys = [plain, key(&one, "http://h/a"), key(&two, "http://h/a"), key(&one, "http://h/b")];
        assert!((1..4).all(|i| !keys[..i].contains(&keys[i])));
        assert_ne!(
            key(&nobody, "http://me:pass@h/a"),
            files::hash(b"http://me:pass@h/a"),
            "a password is hashed with the secret"
        );
        assert_ne!(key(&nobody, "http://me:pass@h/a"), key(&nobody, "http://me:word@h/a"));
        assert_eq!(key(&nobody, "http://h/a@b"), files::hash(b"http://h/a@b"));
    }

    #[test]
    fn stores_differ_by_location_and_credentials() {
        let folder = tempfile::tempdir().unwrap();
        let files = Files::open(folder.path()).unwrap();
        let key = |location: Option<&str>, credentials: &[u8]| {
            let location = location.map(str::to_owned);
            let store = StoreAsker { scheme: "s3", location, credentials: credentials.to_vec() };
            let asker = Asker { stores: vec![store], ..Asker::default() };
            CacheKeys::new(asker).key(&files, "S3://b/a")
        };
        assert_eq!(key(None, b""), files::hash(b"S3://b/a"));
        assert_eq!(key(Some("http://h"), b""), files::hash(b"S3://b/a#http://h"));
        let keys = [key(None, b""), key(None, b"1"), key(None, b"2"), key(Some("http://h"), b"1")];
        assert!((1..4).all(|i| !keys[..i].contains(&keys[i])));
    }

    #[test]
    fn secret_is_made_once_for_each_folder() {
        let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let key = |folder: usize| {
            let files = Files::open(folders[folder].path()).unwrap();
            CacheKeys::new(asker("http://h", b"1")).key(&files, "http://h/a")
        };
        assert_eq!(key(0), key(0));
        assert_ne!(key(0), key(1));
    }
}
