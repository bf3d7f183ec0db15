//! Bodies of answers and their content encodings.

use std::sync::Arc;

use reqwest::header::{ACCEPT_ENCODING, CONTENT_ENCODING, HeaderMap, HeaderValue};

use super::blocking::{MAX_INLINE_BYTES, run_blocking};
use crate::fetch::{IoError, Limits, encoding};

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

/// Decompresses a body, on a blocking thread if it is large.
pub(super) async fn decode_body(
    uri: &str,
    body: Vec<u8>,
    encodings: String,
    limits: &Limits,
) -> Result<Vec<u8>, IoError> {
    let is_plain = encodings.is_empty() && !body.starts_with(&[0x1f, 0x8b]);
    if is_plain || body.len() < MAX_INLINE_BYTES {
        return encoding::decode(uri, body, &encodings, limits);
    }
    let (uri, limits) = (uri.to_owned(), *limits);
    run_blocking(&uri.clone(), move || encoding::decode(&uri, body, &encodings, &limits)).await?
}
