//! What the cache keeps of a URI beside its body.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::files::{self, Hash};

/// Longest file that is taken as an entry.
pub(super) const MOST_BYTES: u64 = 64 << 10;

/// Of one URI.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Entry {
    /// For people; without the values of its query.
    pub uri: String,
    /// Hash of the body, in hexadecimal.
    pub blob: String,
    /// Bytes of the body.
    pub size: u64,
    /// `Content-Encoding` of the body.
    #[serde(default)]
    pub encoding: String,
    /// Validators to ask with.
    #[serde(default)]
    pub etag: Option<String>,
    #[serde(default)]
    pub last_modified: Option<String>,
    /// Where redirects led to what they are of, without the query.
    #[serde(default)]
    pub redirected_to: Option<String>,
    /// When the server last said that it holds, seconds since 1970.
    pub checked_s: u64,
    /// For so many seconds from then it need not be asked again.
    pub fresh_for_s: u64,
}

impl Entry {
    /// The server need not be asked. A clock that has been set back makes everything stale.
    pub fn is_fresh(&self, now: SystemTime) -> bool {
        let now_s = seconds(now);
        (self.checked_s..self.checked_s.saturating_add(self.fresh_for_s)).contains(&now_s)
    }

    /// The server says that it holds, and perhaps for how long.
    pub fn checked(&mut self, now: SystemTime, fresh_for: Option<Duration>) {
        self.checked_s = seconds(now);
        self.fresh_for_s = fresh_for.map_or(self.fresh_for_s, |d| d.as_secs());
    }

    pub(super) fn blob_hash(&self) -> Option<Hash> {
        files::unhex(&self.blob)
    }

    /// A line with the hash of the rest, and the rest.
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let json = serde_json::to_vec(self).unwrap_or_default();
        let mut bytes = files::hex(&files::hash(&json)).into_bytes();
        bytes.push(b'\n');
        bytes.extend_from_slice(&json);
        bytes
    }

    /// `None` for anything that is not as it was written.
    pub(super) fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (line, json) = bytes.split_at_checked(65)?;
        let line = std::str::from_utf8(line).ok()?.strip_suffix('\n')?;
        (files::unhex(line)? == files::hash(json)).then_some(())?;
        serde_json::from_slice(json).ok()
    }
}

/// Takes any bytes as an entry whose hash is right, looks at it, and writes what it has read: for tests.
#[doc(hidden)]
pub fn fuzz_cache_entry(json: &[u8]) {
    let mut bytes = files::hex(&files::hash(json)).into_bytes();
    bytes.push(b'\n');
    bytes.extend_from_slice(json);
    if let Some(mut entry) = Entry::from_bytes(&bytes) {
        let now = SystemTime::now();
        let _ = (entry.is_fresh(now), entry.is_fresh(UNIX_EPOCH), entry.blob_hash());
        assert_eq!(Entry::from_bytes(&entry.to_bytes()).as_ref(), Some(&entry), "what is written is read");
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
    fn an_entry_is_as_written_or_none() {
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
    fn clocks_that_jump_make_stale() {
        let at = |s: u64| UNIX_EPOCH + Duration::from_secs(s);
        let mut entry = Entry::default();
        assert!(!entry.is_fresh(at(5)));
        entry.checked(at(1000), Some(Duration::from_secs(60)));
        assert_eq!([999, 1000, 1059, 1060].map(|s| entry.is_fresh(at(s))), [false, true, true, false]);
        entry.checked(at(1050), None);
        assert!(entry.is_fresh(at(1109)) && !entry.is_fresh(at(1110)));
    }
}
