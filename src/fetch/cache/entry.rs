//! [`Entry`]: the metadata that the cache stores for each URI.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::files::{self, Hash};

/// The maximum size of the file of an entry.
pub(super) const MAX_BYTES: u64 = 64 << 10;

/// Metadata of the cached body of one URI.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Entry {
    /// The URI without the values of its query, for people who look into the file.
    pub uri: String,
    /// SHA-256 hash of the body in hexadecimal.
    pub blob: String,
    /// Size of the body in bytes.
    pub size: u64,
    /// `Content-Encoding` of the body as stored.
    #[serde(default)]
    pub encoding: String,
    /// Validator for `If-None-Match`.
    #[serde(default)]
    pub etag: Option<String>,
    /// Validator for `If-Modified-Since`.
    #[serde(default)]
    pub last_modified: Option<String>,
    /// The URL after redirects that the validators belong to, without its query.
    #[serde(default)]
    pub redirected_to: Option<String>,
    /// The time at which the server last confirmed the body, in seconds since 1970.
    pub checked_s: u64,
    /// The number of seconds after `checked_s` for which the server need not be asked.
    pub fresh_for_s: u64,
}

impl Entry {
    /// Returns true if the server need not be asked. A clock that was set back makes all entries stale.
    pub fn is_fresh(&self, now: SystemTime) -> bool {
        let now_s = seconds(now);
        (self.checked_s..self.checked_s.saturating_add(self.fresh_for_s)).contains(&now_s)
    }

    /// Records that the server confirmed the body, and for how long if it said so.
    pub fn checked(&mut self, now: SystemTime, fresh_for: Option<Duration>) {
        self.checked_s = seconds(now);
        self.fresh_for_s = fresh_for.map_or(self.fresh_for_s, |d| d.as_secs());
    }

    pub(super) fn blob_hash(&self) -> Option<Hash> {
        files::unhex(&self.blob)
    }

    /// Serializes the entry: a line with the hash of the rest, then JSON.
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let json = serde_json::to_vec(self).unwrap_or_default();
        let mut bytes = files::hex(&files::hash(&json)).into_bytes();
        bytes.push(b'\n');
        bytes.extend_from_slice(&json);
        bytes
    }

    /// Parses the result of [`Self::to_bytes`]. Returns `None` if a byte has changed.
    pub(super) fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (line, json) = bytes.split_at_checked(65)?;
        let line = std::str::from_utf8(line).ok()?.strip_suffix('\n')?;
        (files::unhex(line)? == files::hash(json)).then_some(())?;
        serde_json::from_slice(json).ok()
    }
}

/// Parses any bytes as an entry with the right hash, and writes and parses the result again. Entry point of the fuzz tests.
#[cfg(feature = "testing")]
pub fn fuzz_cache_entry(json: &[u8]) {
    let mut bytes = files::hex(&files::hash(json)).into_bytes();
    bytes.push(b'\n');
    bytes.extend_from_slice(json);
    if let Some(mut entry) = Entry::from_bytes(&bytes) {
        let now = SystemTime::now();
        let _ = (entry.is_fresh(now), entry.is_fresh(UNIX_EPOCH), entry.blob_hash());
        assert_eq!(Entry::from_bytes(&entry.to_bytes()).as_ref(), Some(&entry), "a written entry is read back");
        entry.checked(now, None);
        assert!(entry.fresh_for_s == 0 || entry.is_fresh(now));
    }
    let _ = Entry::from_bytes(json);
}

fn seconds(time: SystemTime) -> u64 {
    time.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_entries_are_rejected() {
        let entry = Entry {
            uri: "http://h/a".to_owned(),
            blob: files::hex(&files::hash(b"x")),
            size: 1,
            etag: Some("\"1\"".to_owned()),
            ..Entry::default()
        };
        let bytes = entry.to_bytes();
        assert_eq!(Entry::from_bytes(&bytes), Some(entry));
        for at in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[at] ^= 1;
            assert_eq!(Entry::from_bytes(&changed), None, "bit at {at}");
            assert_eq!(Entry::from_bytes(&bytes[..at]), None, "cut at {at}");
        }
    }

    #[test]
    fn entries_are_stale_if_the_clock_was_set_back() {
        let at = |s: u64| UNIX_EPOCH + Duration::from_secs(s);
        let mut entry = Entry::default();
        assert!(!entry.is_fresh(at(5)));
        entry.checked(at(1000), Some(Duration::from_secs(60)));
        assert_eq!([999, 1000, 1059, 1060].map(|s| entry.is_fresh(at(s))), [false, true, true, false]);
        entry.checked(at(1050), None);
        assert!(entry.is_fresh(at(1109)) && !entry.is_fresh(at(1110)));
    }
}
