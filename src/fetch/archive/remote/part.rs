//! [`PartReader`]: requests ranges of bytes of an archive. Also the types that its users share.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use reqwest::header::{ACCEPT_ENCODING, CONTENT_RANGE, ETAG, HeaderMap, HeaderValue, RANGE};

use crate::fetch::archive::span::Span;
use crate::fetch::cache::Freshness;
use crate::fetch::http::{Answer, Transport, parse_content_range};
use crate::fetch::markup::refuse_markup;
use crate::fetch::{Claim, IoError, Limits};

/// A part of an archive as received.
pub(super) struct Part {
    pub bytes: Vec<u8>,
    /// Offset of the first byte in the archive.
    pub offset: u64,
    /// Size of the whole archive in bytes.
    pub file_bytes: u64,
    /// The time before the request was sent.
    pub requested_at: Instant,
    pub headers: HeaderMap,
    pub freshness: Freshness,
}

impl Part {
    pub fn etag(&self) -> Option<String> {
        self.headers.get(ETAG).and_then(|v| v.to_str().ok()).map(str::to_owned)
    }
}

/// A member to read: the URI for errors, and the name inside the archive.
#[derive(Clone, Copy)]
pub(super) struct MemberName<'a> {
    pub uri: &'a str,
    pub name: &'a str,
}

/// Requests parts of one archive and counts the bytes received.
pub(super) struct PartReader<'a> {
    pub transport: &'a Transport,
    /// URL of the archive.
    pub url: &'a str,
    pub limits: &'a Limits,
    network_bytes: AtomicU64,
}

impl<'a> PartReader<'a> {
    pub fn new(transport: &'a Transport, url: &'a str, limits: &'a Limits) -> Self {
        Self { transport, url, limits, network_bytes: AtomicU64::new(0) }
    }

    /// Returns the bytes of bodies received so far.
    pub fn network_bytes(&self) -> u64 {
        self.network_bytes.load(Ordering::Relaxed)
    }

    /// Claims bytes for what a part is decompressed to.
    pub fn claim(&self, uri: &str, bytes: u64) -> Result<Claim<'_>, IoError> {
        self.transport.permit().claim(bytes).map_err(|no_room| IoError::no_room(uri, no_room))
    }

    /// Requests a range, written as in the header `Range`. Returns the whole archive if the server ignores ranges and the
    /// archive is small.
    pub async fn read(&self, range: &str, limits: &Limits) -> Result<Part, IoError> {
        let url = self.url;
        let mut headers = HeaderMap::new();
        let value = HeaderValue::from_str(range).map_err(|_| IoError::invalid(url, "a range of the archive"))?;
        headers.insert(RANGE, value);
        // Offsets are those of the archive, not of a compressed transfer of it.
        headers.insert(ACCEPT_ENCODING, HeaderValue::from_static("identity"));
        let requested_at = Instant::now();
        let answer = self.transport.exchange(url, &headers, None, limits).await?;
        self.network_bytes.fetch_add(answer.body.len() as u64, Ordering::Relaxed);
        let (offset, file_bytes) = match answer.status {
            206 => {
                let text = answer.headers.get(CONTENT_RANGE).and_then(|v| v.to_str().ok());
                let received = text.and_then(parse_content_range).filter(|(first, last, length)| {
                    last < length && last.checked_sub(*first) == Some((answer.body.len() as u64).wrapping_sub(1))
                });
                let broken = || IoError::invalid(url, "an answer to a range request without its range");
                let (first, _, length) = received.ok_or_else(broken)?;
                (first, length)
            }
            _ if answer.is_whole() => {
                // An error page instead of the archive is a transient error.
                refuse_markup(url, &answer.body)?;
                (0, answer.body.len() as u64)
            }
            _ => return Err(answer.error(url)),
        };
        let Answer { body: bytes, headers, freshness, .. } = answer;
        Ok(Part { bytes, offset, file_bytes, requested_at, headers, freshness })
    }
}

/// Formats a span as the value of the header `Range`.
pub(super) fn range_of(Span { offset, size }: Span) -> String {
    format!("bytes={offset}-{}", offset.saturating_add(size).saturating_sub(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges() {
        assert_eq!(range_of(Span { offset: 10, size: 5 }), "bytes=10-14");
        assert_eq!(parse_content_range("bytes 10-14/100"), Some((10, 14, 100)));
        for odd in ["", "bytes */100", "bytes 10-14/*", "items 1-2/3", "bytes -5/10"] {
            assert_eq!(parse_content_range(odd), None, "{odd}");
        }
    }
}
