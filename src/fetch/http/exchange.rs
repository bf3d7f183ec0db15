//! [`Exchange`]: one request and its answer, redirects followed. HTTP thread.
//!
//! Redirects are followed here and not by the HTTP library. Each step asks only a server that the tile set may reach, and
//! sends only the credentials of that server. No redirect may lead from an encrypted connection to an unencrypted one, or to
//! another scheme.

use std::future::Future;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use reqwest::Version;
use reqwest::header::{
    ACCEPT, CONTENT_RANGE, COOKIE, HeaderMap, HeaderValue, IF_MODIFIED_SINCE, IF_NONE_MATCH, LOCATION, RANGE, VARY,
};
use url::Url;

use super::body::parse_content_range;
use super::config::HttpConfig;
use super::error_chain::error_chain_without_url;
use super::hosts::{Connections, RefusedAddress, refused as host_refused};
use super::retry_policy::{Pause, Pauses, retry_after};
use crate::fetch::cache::Freshness;
use crate::fetch::{IoError, Limits, Permit, shown};

/// The maximum memory reserved for a body before its bytes arrive.
const MAX_RESERVED_BYTES: u64 = 1 << 20;
/// The maximum size of a whole file that is accepted as the answer to a range request.
const MAX_INSTEAD_OF_RANGE_BYTES: u64 = 4 << 20;
/// The maximum size of a body of a failure or redirect that is read to its end, so that the connection can be reused.
const MAX_DRAINED_BYTES: u64 = 16 << 10;
/// The time limit for reading such a body.
const MAX_DRAIN_TIME: Duration = Duration::from_millis(200);
/// The maximum number of redirects of one request.
const MAX_REDIRECTS: usize = 8;

/// The end of the paths of terrain tiles.
const TERRAIN_SUFFIX: &str = ".terrain";
/// The types that terrain tiles are asked for. Servers leave out the extensions that are not named.
const TERRAIN_ACCEPT: &str = "application/vnd.quantized-mesh;extensions=octvertexnormals-watermask-metadata,\
    application/octet-stream;q=0.9,*/*;q=0.01";

/// The parameters of a request besides its URI.
pub(in crate::fetch) struct Exchange<'a> {
    pub connections: &'a Arc<Connections>,
    /// A URL of the server that the tile set came from; `None` if it came from elsewhere.
    pub root: Option<Url>,
    pub config: &'a HttpConfig,
    pub limits: &'a Limits,
    /// Holds the bytes of the body.
    pub permit: &'a Permit,
    pub headers: &'a HeaderMap,
    /// The URL after redirects that the validators in `headers` belong to. `None` means the requested URL.
    pub validated_at: Option<&'a str>,
    pub progress: Arc<Progress>,
}

/// The progress of one answer.
#[derive(Debug, Default)]
pub(in crate::fetch) struct Progress {
    /// Bytes of the body received so far. They extend the total timeout.
    received: AtomicU64,
    /// Set when the answer was lost because its HTTP/2 connection ended, with all other answers of that connection.
    connection_lost: AtomicBool,
}

impl Progress {
    /// Returns true if the answer was lost with its HTTP/2 connection.
    pub(super) fn is_connection_lost(&self) -> bool {
        self.connection_lost.load(Ordering::Relaxed)
    }
}

/// The answer of a server after all redirects.
pub(in crate::fetch) struct Answer {
    pub status: u16,
    pub headers: HeaderMap,
    /// The body as received; empty for a failure.
    pub body: Vec<u8>,
    /// Whether and for how long it may be cached, redirects included.
    pub freshness: Freshness,
    /// The final URL without its query; `None` without redirects.
    pub redirected_to: Option<String>,
    /// The server that answered; `None` means the server that was asked.
    pub origin: Option<String>,
}

impl Answer {
    /// Returns true for a whole content, a part, or "not modified".
    pub fn is_success(&self) -> bool {
        self.is_whole() || self.is_no_content() || matches!(self.status, 206 | 304)
    }

    /// Returns true if the server said that there is no content.
    pub fn is_no_content(&self) -> bool {
        self.status == 204
    }

    /// Returns true if the body is the whole content.
    pub fn is_whole(&self) -> bool {
        matches!(self.status, 200 | 201 | 203)
    }

    /// Returns the error that the status stands for.
    pub fn error(&self, uri: &str) -> IoError {
        match self.status {
            404 | 410 => IoError::NotFound { uri: uri.to_owned() },
            status => {
                let retry_after = retry_after(&self.headers, SystemTime::now());
                IoError::Status { uri: uri.to_owned(), status, retry_after }
            }
        }
    }
}

/// Returns true if the header `Content-Range` says that a body of `size` bytes is the whole file.
fn is_whole_range(text: &str, size: u64) -> bool {
    parse_content_range(text)
        .is_some_and(|(first, last, length)| first == 0 && length == size && last.checked_add(1) == Some(length))
}

impl Exchange<'_> {
    /// Awaits an answer within the total timeout, which grows with the number of bytes received.
    pub async fn in_time<T>(&self, uri: &str, answer: impl Future<Output = Result<T, IoError>>) -> Result<T, IoError> {
        let HttpConfig { total_timeout, min_bytes_per_s, .. } = *self.config;
        let (begun, mut allowed, mut answer) = (tokio::time::Instant::now(), total_timeout, pin!(answer));
        while let Some(until) = begun.checked_add(allowed) {
            if let Ok(answer) = tokio::time::timeout_at(until, &mut answer).await {
                return answer;
            }
            let extra_s = self.progress.received.load(Ordering::Relaxed) as f64 / f64::from(min_bytes_per_s);
            // 0 bytes at rate 0 is not a number, and a time beyond the range of `Duration` is unlimited.
            let extra = Duration::try_from_secs_f64(extra_s.max(0.0)).unwrap_or(Duration::MAX);
            let grown = total_timeout.saturating_add(extra);
            if grown <= begun.elapsed() {
                return Err(timed_out(uri, "the whole answer", allowed));
            }
            allowed = grown;
        }
        answer.await
    }

    /// Sends the request and follows redirects, except to servers that asked for a pause.
    pub(super) async fn run(&self, uri: &str, pauses: &Pauses) -> Result<Answer, IoError> {
        let first = parse(uri)?;
        let mut url = first.clone();
        let mut hops: Vec<(u16, HeaderMap)> = Vec::new();
        let mut is_keyed = true;
        for _ in 0..=MAX_REDIRECTS {
            let with_validators = match self.validated_at {
                Some(validated) => validated == without_secrets(&url),
                None => hops.is_empty(),
            };
            // The caller has checked the first server.
            if !hops.is_empty()
                && let Some(Pause { status, left }) = pauses.of(&url.origin().ascii_serialization())
            {
                return Err(IoError::Status { uri: uri.to_owned(), status, retry_after: Some(left) });
            }
            let response = self.send(uri, &url, with_validators).await?;
            let status = response.status().as_u16();
            is_keyed &= self.is_keyed(&first, &url, response.headers());
            let location = response.headers().get(LOCATION).filter(|_| matches!(status, 301 | 302 | 303 | 307 | 308));
            let Some(location) = location else {
                let mut answer = self.read(uri, response).await?;
                answer.freshness.store &= is_keyed;
                let now = SystemTime::now();
                let behind =
                    |own: Freshness, (status, headers): &(u16, HeaderMap)| own.behind_redirect(*status, headers, now);
                answer.freshness = hops.iter().fold(answer.freshness, behind);
                answer.redirected_to = (!hops.is_empty()).then(|| without_secrets(&url));
                answer.origin = Some(url.origin().ascii_serialization());
                return Ok(answer);
            };
            let location = location.to_str().map_err(|_| refused(uri, "redirected to an invalid URL".to_owned()))?;
            let next = url.join(location).map_err(|e| refused(uri, format!("redirected to an invalid URL: {e}")))?;
            if !matches!(next.scheme(), "http" | "https") {
                return Err(refused(uri, format!("redirected to scheme {}", next.scheme())));
            }
            if url.scheme() == "https" && next.scheme() != "https" {
                return Err(refused(uri, format!("redirected from https to {}", shown(next.as_str()))));
            }
            url = next;
            hops.push((status, response.headers().clone()));
            self.drain(response).await;
        }
        Err(refused(uri, format!("more than {MAX_REDIRECTS} redirects")))
    }

    /// Returns false if an answer, or a redirect on the way to it, depends on something that is not in the cache key of the
    /// request. This is so for cookies, which the server names in `Vary`. It is also so for credentials of another server, which
    /// are in the keys of that server only. All other headers have the same value in each request with the same key.
    fn is_keyed(&self, first: &Url, url: &Url, headers: &HeaderMap) -> bool {
        let texts = headers.get_all(VARY).into_iter().filter_map(|v| v.to_str().ok());
        let varies_by_cookie =
            texts.flat_map(|text| text.split(',')).any(|name| name.trim().eq_ignore_ascii_case(COOKIE.as_str()));
        let has_user = !url.username().is_empty() || url.password().is_some();
        let has_credentials = || has_user || self.config.has_credentials_for(&url.origin().ascii_serialization());
        let gets_others = url.origin() != first.origin() && has_credentials();
        !(varies_by_cookie || gets_others)
    }

    /// Sends one request. Validators are sent only to the URL that issued them, since another server may use the same
    /// validator for another content.
    async fn send(&self, uri: &str, url: &Url, with_validators: bool) -> Result<reqwest::Response, IoError> {
        let client = self.connections.for_url(uri, url, self.root.as_ref()).await?;
        let origin = url.origin().ascii_serialization();
        let mut url = url.clone();
        let mut headers = self.headers.clone();
        if !with_validators {
            headers.remove(IF_NONE_MATCH);
            headers.remove(IF_MODIFIED_SINCE);
        }
        for credential in &self.config.credentials {
            if let Some((name, value)) = credential.header_for(&origin) {
                headers.insert(name, value);
            }
            if let Some((name, value)) = credential.query_for(&origin)
                && !url.query_pairs().any(|(n, _)| n == name)
            {
                url.query_pairs_mut().append_pair(name, value);
            }
        }
        if url.path().ends_with(TERRAIN_SUFFIX) {
            headers.insert(ACCEPT, HeaderValue::from_static(TERRAIN_ACCEPT));
        }
        self.first_byte(uri, client.get(url).headers(headers)).await
    }

    /// Sends a request and waits for the status and headers of its answer.
    pub async fn first_byte(&self, uri: &str, request: reqwest::RequestBuilder) -> Result<reqwest::Response, IoError> {
        match tokio::time::timeout(self.config.first_byte_timeout, request.send()).await {
            Ok(Ok(response)) => Ok(response),
            Ok(Err(e)) if e.is_timeout() && e.is_connect() => {
                Err(timed_out(uri, "connecting", self.config.connect_timeout))
            }
            Ok(Err(e)) => {
                self.note_lost_connection(&e, None);
                Err(not_answered(uri, e))
            }
            Err(_) => Err(timed_out(uri, "waiting for the answer", self.config.first_byte_timeout)),
        }
    }

    /// Reads the body of a successful answer. A part that was not asked for counts as the whole content if it plainly is.
    pub async fn read(&self, uri: &str, response: reqwest::Response) -> Result<Answer, IoError> {
        let mut answer = self.read_any(uri, response).await?;
        if answer.status == 206 && !self.headers.contains_key(RANGE) {
            let range = answer.headers.get(CONTENT_RANGE).map(|value| String::from_utf8_lossy(value.as_bytes()));
            let size = answer.body.len() as u64;
            match range {
                Some(range) if !is_whole_range(&range, size) => {
                    let reason = format!("the server sent a part of the file that was not asked for ({range:.60})");
                    return Err(IoError::invalid(uri, reason));
                }
                _ => answer.status = 200,
            }
        }
        Ok(answer)
    }

    async fn read_any(&self, uri: &str, mut response: reqwest::Response) -> Result<Answer, IoError> {
        let (status, version) = (response.status().as_u16(), response.version());
        let headers = std::mem::take(response.headers_mut());
        let freshness = Freshness::of(&headers, SystemTime::now());
        if !matches!(status, 200 | 201 | 203 | 206) {
            self.drain(response).await;
            return Ok(Answer { status, headers, body: Vec::new(), freshness, redirected_to: None, origin: None });
        }
        let mut limit = self.limits.max_file_bytes;
        let length = response.content_length();
        // An answer without a length may still be short, such as an error page.
        let is_instead = status != 206 && self.headers.contains_key(RANGE);
        if is_instead {
            limit = limit.min(MAX_INSTEAD_OF_RANGE_BYTES);
        }
        let too_large = |got: u64| match is_instead {
            true => IoError::unsupported(uri, "a large file on a server without range requests"),
            false => IoError::TooLarge { uri: uri.to_owned(), what: "answer", got, limit },
        };
        if let Some(length) = length.filter(|l| *l > limit) {
            return Err(too_large(length));
        }
        // If the announced bytes have no room, the answer is dropped here. An answer that waited would hold its connection, and
        // its part of the window that all answers of an HTTP/2 connection share.
        let no_room = |no_room| IoError::no_room(uri, no_room);
        let mut claim = self.permit.claim(length.unwrap_or(0)).map_err(no_room)?;
        // A larger announced length is not trusted until its bytes arrive.
        let mut body = Vec::with_capacity(length.unwrap_or(0).min(MAX_RESERVED_BYTES) as usize);
        loop {
            let piece = match tokio::time::timeout(self.config.read_timeout, response.chunk()).await {
                Ok(Ok(Some(piece))) => piece,
                Ok(Ok(None)) => {
                    claim.keep(body.len() as u64);
                    return Ok(Answer { status, headers, body, freshness, redirected_to: None, origin: None });
                }
                Ok(Err(e)) => {
                    self.note_lost_connection(&e, Some(version));
                    return Err(IoError::Network { uri: uri.to_owned(), reason: error_chain_without_url(e) });
                }
                Err(_) => return Err(timed_out(uri, "reading the answer", self.config.read_timeout)),
            };
            if (body.len() + piece.len()) as u64 > limit {
                return Err(too_large((body.len() + piece.len()) as u64));
            }
            let received = (body.len() + piece.len()) as u64;
            if received > claim.bytes() {
                // A body without a length grows as its buffer does.
                claim.grow_to(2 * received).map_err(no_room)?;
            }
            body.extend_from_slice(&piece);
            self.progress.received.fetch_add(piece.len() as u64, Ordering::Relaxed);
        }
    }

    /// Notes an error that has ended an HTTP/2 connection. All answers of the connection get it: as an I/O error without the
    /// number that an error of the system has. `version` is `None` before the status has arrived.
    fn note_lost_connection(&self, error: &reqwest::Error, version: Option<Version>) {
        use std::io::ErrorKind::{BrokenPipe, ConnectionAborted, ConnectionReset, UnexpectedEof};
        if error.is_connect() || version.is_some_and(|version| version != Version::HTTP_2) {
            return;
        }
        let is_end = |kind| match kind {
            BrokenPipe | ConnectionAborted | ConnectionReset => true,
            // With HTTP/1.1 too, if the connection is encrypted.
            UnexpectedEof => version.is_some(),
            _ => false,
        };
        let io: Option<&std::io::Error> = cause(error);
        let is_lost = io.is_some_and(|e| e.raw_os_error().is_none() && is_end(e.kind()))
            || cause::<h2::Error>(error).is_some_and(h2::Error::is_go_away);
        if is_lost {
            self.progress.connection_lost.store(true, Ordering::Relaxed);
        }
    }

    /// Discards a short body, so that the connection can be reused. A long one closes the connection.
    async fn drain(&self, mut response: reqwest::Response) {
        if response.content_length().is_none_or(|length| length > MAX_DRAINED_BYTES) {
            return;
        }
        let all = async { while let Ok(Some(_)) = response.chunk().await {} };
        let _ = tokio::time::timeout(MAX_DRAIN_TIME, all).await;
    }
}

fn parse(uri: &str) -> Result<Url, IoError> {
    Url::parse(uri).map_err(|e| IoError::Uri { uri: uri.to_owned(), reason: e.to_string() })
}

/// Returns a URL without user name, password, query and fragment. A query may contain a token or change with each request.
fn without_secrets(url: &Url) -> String {
    let mut url = url.clone();
    url.set_query(None);
    url.set_fragment(None);
    // Fails only for URLs without a host, which have neither.
    let _ = url.set_username("");
    let _ = url.set_password(None);
    url.into()
}

/// Returns scheme, host and port of a URL.
pub(super) fn origin(uri: &str) -> Result<String, IoError> {
    Ok(parse(uri)?.origin().ascii_serialization())
}

fn refused(uri: &str, reason: String) -> IoError {
    IoError::Uri { uri: uri.to_owned(), reason }
}

fn timed_out(uri: &str, phase: &'static str, limit: Duration) -> IoError {
    IoError::Timeout { uri: uri.to_owned(), phase, seconds: limit.as_secs_f64() }
}

/// Converts the error of a request that got no answer.
fn not_answered(uri: &str, error: reqwest::Error) -> IoError {
    if let (Some(address), Some(url)) = (cause::<RefusedAddress>(&error), error.url()) {
        return host_refused(uri, url, *address);
    }
    // A failure of an established connection is transient.
    let is_tls = error.is_connect() && cause::<rustls::Error>(&error).is_some();
    let (uri, reason) = (uri.to_owned(), error_chain_without_url(error));
    if is_tls { IoError::Tls { uri, reason } } else { IoError::Network { uri, reason } }
}

/// Returns the cause of an error that has the type `E`.
fn cause<E: std::error::Error + 'static>(error: &reqwest::Error) -> Option<&E> {
    let mut next: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(e) = next {
        // `source` of an I/O error skips the error that it wraps.
        let wrapped = e.downcast_ref::<std::io::Error>().and_then(|e| e.get_ref());
        if let Some(found) = e.downcast_ref().or_else(|| wrapped?.downcast_ref()) {
            return Some(found);
        }
        next = match wrapped {
            Some(wrapped) => Some(wrapped),
            None => e.source(),
        };
    }
    None
}
