//! [`RemoteIdentity`]: recognizes whether an archive on a server is still the one whose directory was read.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::part::{Part, PartReader, range_of};
use crate::fetch::archive::span::Span;
use crate::fetch::archive::zip::MAX_HEADER_BYTES;
use crate::fetch::cache::Entry;
use crate::fetch::{IoError, Limits};

/// After an answer with the archive's validator, all cached members with this validator are valid for this time.
const VALIDATOR_HOLDS_FOR: Duration = Duration::from_secs(60);

/// Size and validator of an archive when its directory was read. Shared by the requests of a client.
#[derive(Debug)]
pub(super) struct RemoteIdentity {
    file_bytes: u64,
    etag: Option<String>,
    /// The time of the last request whose answer had this validator. Locked briefly.
    seen_at: Mutex<Instant>,
    /// Set once the archive is known to have changed, or its directory to be damaged. Its directory must then be read again.
    is_stale: AtomicBool,
}

impl RemoteIdentity {
    /// Creates the identity of the archive that a part came from.
    pub fn of(part: &Part) -> Self {
        Self {
            file_bytes: part.file_bytes,
            etag: part.etag(),
            seen_at: Mutex::new(part.requested_at),
            is_stale: AtomicBool::new(false),
        }
    }

    pub fn etag(&self) -> Option<&str> {
        self.etag.as_deref()
    }

    pub fn is_stale(&self) -> bool {
        self.is_stale.load(Ordering::Relaxed)
    }

    /// Makes the next request for a member read the directory again.
    pub fn mark_stale(&self) {
        self.is_stale.store(true, Ordering::Relaxed);
    }

    fn seen_at(&self) -> MutexGuard<'_, Instant> {
        self.seen_at.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns true if a cached member is still valid, because its strong validator is that of the archive, which a server
    /// confirmed shortly before `now`.
    pub fn vouches_for(&self, cached: &Entry, now: Instant) -> bool {
        let strong = self.etag.as_ref().filter(|tag| !tag.starts_with("W/"));
        strong.is_some()
            && cached.etag.as_ref() == strong
            && now.saturating_duration_since(*self.seen_at()) < VALIDATOR_HOLDS_FOR
    }

    /// Requests a span of the archive.
    ///
    /// # Errors
    /// A transient error if the archive has changed; it is then stale.
    pub async fn read(&self, reader: &PartReader<'_>, span: Span) -> Result<Part, IoError> {
        let limits = reader.limits;
        let limits = Limits { max_file_bytes: limits.max_file_bytes.saturating_add(MAX_HEADER_BYTES), ..*limits };
        let mut part = match reader.read(&range_of(span), &limits).await {
            // The archive is shorter now, or the server no longer answers ranges, as it did before.
            Err(IoError::Status { status: 416, .. } | IoError::Unsupported { .. }) => {
                self.mark_stale();
                return Err(changed(reader.url));
            }
            other => other?,
        };
        if part.offset == 0 && part.bytes.len() as u64 == part.file_bytes {
            // A server without range requests has sent the whole archive.
            let end = span.offset.saturating_add(span.size);
            let bytes = part.bytes.get(span.offset as usize..end as usize).map(<[u8]>::to_vec);
            part = Part { bytes: bytes.unwrap_or_default(), offset: span.offset, ..part };
        }
        if let Err(error) = self.check(reader.url, &part, span) {
            self.mark_stale();
            return Err(error);
        }
        if self.etag.is_some() && part.etag() == self.etag {
            *self.seen_at() = part.requested_at;
        }
        Ok(part)
    }

    /// Checks that a part has the requested span and comes from this archive.
    pub fn check(&self, url: &str, part: &Part, span: Span) -> Result<(), IoError> {
        let etags_differ = matches!((part.etag(), &self.etag), (Some(a), Some(b)) if a != *b);
        if part.file_bytes != self.file_bytes || etags_differ {
            return Err(changed(url));
        }
        if part.offset != span.offset || part.bytes.len() as u64 != span.size {
            return Err(IoError::invalid(url, "another part of the archive than was asked for"));
        }
        Ok(())
    }
}

/// Returns a transient error: the next request reads the new directory.
fn changed(url: &str) -> IoError {
    IoError::Network { uri: url.to_owned(), reason: "the archive has changed".to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_archive_vouches_for_its_cached_members_for_a_while() {
        let now = Instant::now();
        let archive = |etag: &str| RemoteIdentity {
            file_bytes: 9,
            etag: Some(etag.to_owned()),
            seen_at: Mutex::new(now),
            is_stale: AtomicBool::new(false),
        };
        let cached = |etag: &str| Entry { etag: Some(etag.to_owned()), ..Entry::default() };
        let strong = archive("\"1\"");
        assert!(strong.vouches_for(&cached("\"1\""), now));
        assert!(strong.vouches_for(&cached("\"1\""), now + VALIDATOR_HOLDS_FOR / 2));
        // The archive may have changed since: its validator was seen long ago.
        assert!(!strong.vouches_for(&cached("\"1\""), now + VALIDATOR_HOLDS_FOR));
        *strong.seen_at() = now + VALIDATOR_HOLDS_FOR;
        assert!(strong.vouches_for(&cached("\"1\""), now + VALIDATOR_HOLDS_FOR));
        assert!(!strong.vouches_for(&cached("\"2\""), now) && !strong.vouches_for(&Entry::default(), now));
        assert!(!archive("W/\"1\"").vouches_for(&cached("W/\"1\""), now), "weak validators are not exact");
    }
}
