//! Bodies of answers and their content encodings.

use std::sync::Arc;

use reqwest::header::{ACCEPT_ENCODING, CONTENT_ENCODING, HeaderMap, HeaderValue};

use super::blocking::{MAX_INLINE_BYTES, run_blocking};
use crate::fetch::{IoError, Limits, Permit, encoding};

/// Bodies are expected to become this many times larger by decompression.
const EXPECTED_RATIO: u64 = 4;

/// The content of a URI, and its cost on the network.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HttpBody {
    /// The decompressed content.
    pub bytes: Vec<u8>,
    /// Bytes of bodies received over the network, before decompression.
    pub network_bytes: u64,
    /// True if a server answered, be it with "not modified".
    pub asked: bool,
    /// The URL, without its query, that redirects led to; `None` without redirects. References in the content are relative
    /// to it.
    pub location: Option<Arc<str>>,
    /// True if the server said that there is no content (status 204); `bytes` are empty then.
    pub is_no_content: bool,
}

impl HttpBody {
    /// Returns the body of an answer without content.
    pub(super) fn no_content() -> Self {
        Self { asked: true, is_no_content: true, ..Self::default() }
    }
}

/// Returns the headers of a request that accepts every supported encoding.
pub(super) fn accept_all_encodings() -> HeaderMap {
    HeaderMap::from_iter([(ACCEPT_ENCODING, HeaderValue::from_static(encoding::ACCEPT))])
}

/// Returns the content encodings of an answer, separated by commas.
pub(super) fn content_encodings(headers: &HeaderMap) -> String {
    let values: Vec<&str> = headers.get_all(CONTENT_ENCODING).iter().filter_map(|v| v.to_str().ok()).collect();
    values.join(",")
}

/// Decompresses a body, on a blocking thread if it is large. What it becomes is claimed from the permit beforehand.
pub(super) async fn decode_body(
    uri: &str,
    body: Vec<u8>,
    encodings: String,
    limits: &Limits,
    permit: &Permit,
) -> Result<Vec<u8>, IoError> {
    if !encoding::is_encoded(&body, &encodings) {
        return encoding::decode(uri, body, &encodings, limits);
    }
    if body.len() < MAX_INLINE_BYTES {
        return decode_claimed(uri, body, &encodings, limits, permit);
    }
    let (uri, limits, permit) = (uri.to_owned(), *limits, permit.clone());
    run_blocking(&uri.clone(), move || decode_claimed(&uri, body, &encodings, &limits, &permit)).await?
}

/// Decompresses a body; claims what it becomes from the permit beforehand.
pub(super) fn decode_claimed(
    uri: &str,
    body: Vec<u8>,
    encodings: &str,
    limits: &Limits,
    permit: &Permit,
) -> Result<Vec<u8>, IoError> {
    if !encoding::is_encoded(&body, encodings) {
        return encoding::decode(uri, body, encodings, limits);
    }
    let no_room = |no_room| IoError::no_room(uri, no_room);
    let mut claim = permit.claim(0).map_err(no_room)?;
    let mut max_bytes = EXPECTED_RATIO.saturating_mul(body.len() as u64);
    // A body that becomes larger is decompressed again, with room for more.
    while max_bytes < limits.max_file_bytes {
        claim.grow_to(max_bytes).map_err(no_room)?;
        match encoding::decode(uri, body.clone(), encodings, &Limits { max_file_bytes: max_bytes, ..*limits }) {
            Err(IoError::TooLarge { .. }) => max_bytes = EXPECTED_RATIO.saturating_mul(max_bytes),
            Err(error) => return Err(error),
            Ok(decoded) => {
                claim.keep(decoded.len() as u64);
                return Ok(decoded);
            }
        }
    }
    claim.grow_to(limits.max_file_bytes).map_err(no_room)?;
    let decoded = encoding::decode(uri, body, encodings, limits)?;
    claim.keep(decoded.len() as u64);
    Ok(decoded)
}

/// Parses the header `Content-Range` into the first and the last offset and the size of the whole.
pub(in crate::fetch) fn parse_content_range(text: &str) -> Option<(u64, u64, u64)> {
    let (span, length) = text.trim().strip_prefix("bytes ")?.split_once('/')?;
    let (first, last) = span.split_once('-')?;
    Some((first.trim().parse().ok()?, last.trim().parse().ok()?, length.trim().parse().ok()?))
}
