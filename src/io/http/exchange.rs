//! One request and its answer, redirects followed.
//!
//! Redirects are followed here and not by the client below: credentials go to the server that they are for, at each
//! step anew, and nothing ever goes from an encrypted connection to an open one or to another scheme.

use std::future::Future;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime};

use reqwest::header::{HeaderMap, IF_MODIFIED_SINCE, IF_NONE_MATCH, LOCATION, RANGE, VARY};
use url::Url;

use super::HttpConfig;
use super::retry::{Pause, Pauses, retry_after};
use crate::io::cache::Freshness;
use crate::io::{IoError, Limits, shown};

/// Memory taken for an answer before its bytes come.
const MOST_RESERVED_BYTES: u64 = 1 << 20;
/// The whole is taken instead of a range up to this.
const MOST_INSTEAD_OF_RANGE_BYTES: u64 = 4 << 20;
/// Bodies of failures and redirects are read up to this, and for so long.
const MOST_DRAINED_BYTES: u64 = 16 << 10;
const DRAIN_TIME: Duration = Duration::from_millis(200);
/// Most redirects of one request.
const MAX_REDIRECTS: usize = 8;

/// Everything that a request needs besides its URI.
pub(super) struct Exchange<'a> {
    pub client: &'a reqwest::Client,
    pub config: &'a HttpConfig,
    pub limits: &'a Limits,
    pub headers: &'a HeaderMap,
    /// Where a redirect led to what the validators among them are of; `None`: no redirect.
    pub validated_at: Option<&'a str>,
    /// Bytes of the body so far: what goes on may take longer.
    pub received: Arc<AtomicU64>,
}

/// What a server answered at the end of all redirects.
pub(super) struct Answer {
    pub status: u16,
    pub headers: HeaderMap,
    /// As it came; empty for a failure.
    pub body: Vec<u8>,
    /// Whether and for how long it may be kept, all redirects counted.
    pub freshness: Freshness,
    /// Where redirects led to, without the query; `None` where there were none.
    pub redirected_to: Option<String>,
    /// Who answered; `None`: who was asked.
    pub origin: Option<String>,
}

impl Answer {
    /// The whole, a part, or "not modified".
    pub fn is_success(&self) -> bool {
        self.is_whole() || matches!(self.status, 206 | 304)
    }

    /// The body is the content.
    pub fn is_whole(&self) -> bool {
        matches!(self.status, 200 | 203)
    }

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

impl Exchange<'_> {
    /// What an answer comes to within its time, which grows with the bytes that come.
    pub async fn in_time<T>(&self, uri: &str, answer: impl Future<Output = Result<T, IoError>>) -> Result<T, IoError> {
        let HttpConfig { total_timeout, min_bytes_per_s, .. } = *self.config;
        let (begun, mut allowed, mut answer) = (tokio::time::Instant::now(), total_timeout, pin!(answer));
        while let Some(until) = begun.checked_add(allowed) {
            if let Ok(answer) = tokio::time::timeout_at(until, &mut answer).await {
                return answer;
            }
            let longer_s = self.received.load(Ordering::Relaxed) as f64 / f64::from(min_bytes_per_s);
            // No bytes at no rate is no number, and more than a duration holds is for ever.
            let longer = Duration::try_from_secs_f64(longer_s.max(0.0)).unwrap_or(Duration::MAX);
            let grown = total_timeout.saturating_add(longer);
            if grown <= begun.elapsed() {
                return Err(timed_out(uri, "the whole answer", allowed));
            }
            allowed = grown;
        }
        answer.await
    }

    /// Asks, and asks on where it is sent to; but nobody who asked for a pause.
    pub async fn run(&self, uri: &str, pauses: &Pauses) -> Result<Answer, IoError> {
        let mut url = parse(uri)?;
        let mut hops: Vec<(u16, HeaderMap)> = Vec::new();
        let mut is_for_all = true;
        for _ in 0..=MAX_REDIRECTS {
            let are_its_own = match self.validated_at {
                Some(place) => place == place_of(&url),
                None => hops.is_empty(),
            };
            // Whoever is asked first is looked at before.
            if !hops.is_empty()
                && let Some(Pause { status, left }) = pauses.of(&url.origin().ascii_serialization())
            {
                return Err(IoError::Status { uri: uri.to_owned(), status, retry_after: Some(left) });
            }
            let response = self.send(uri, &url, are_its_own).await?;
            let status = response.status().as_u16();
            is_for_all &= !self.depends_on_credentials(&url, response.headers());
            let location = response.headers().get(LOCATION).filter(|_| matches!(status, 301 | 302 | 303 | 307 | 308));
            let Some(location) = location else {
                let mut answer = self.read(uri, response).await?;
                answer.freshness.store &= is_for_all;
                let now = SystemTime::now();
                let behind = |own: Freshness, (status, headers): &(u16, HeaderMap)| own.behind(*status, headers, now);
                answer.freshness = hops.iter().fold(answer.freshness, behind);
                answer.redirected_to = (!hops.is_empty()).then(|| place_of(&url));
                answer.origin = Some(url.origin().ascii_serialization());
                return Ok(answer);
            };
            let location = location.to_str().map_err(|_| refused(uri, "redirected to no URL".to_owned()))?;
            let next = url.join(location).map_err(|e| refused(uri, format!("redirected to no URL: {e}")))?;
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

    /// The answer is one for who has a credential (`Vary`): the cache, which knows no credentials, is not to keep it.
    fn depends_on_credentials(&self, url: &Url, headers: &HeaderMap) -> bool {
        let origin = url.origin().ascii_serialization();
        let texts = headers.get_all(VARY).into_iter().filter_map(|v| v.to_str().ok());
        let mut names = texts.flat_map(|text| text.split(',')).map(str::trim);
        let is_sent = |name: &str| {
            let mut sent = self.config.credentials.iter().filter_map(|c| c.header_for(&origin));
            sent.any(|(header, _)| header.as_str().eq_ignore_ascii_case(name))
        };
        names.any(is_sent)
    }

    /// Validators go to what they are of: others may use the same ones for something else.
    async fn send(&self, uri: &str, url: &Url, with_validators: bool) -> Result<reqwest::Response, IoError> {
        let origin = url.origin().ascii_serialization();
        let mut url = url.clone();
        let mut headers = self.headers.clone();
        if !with_validators {
            headers.remove(IF_NONE_MATCH);
            headers.remove(IF_MODIFIED_SINCE);
        }
        for credential in &self.config.credentials {
            if let Some((name, value)) = credential.header_for(&origin) {
                headers.insert(name.clone(), value.clone());
            }
            if let Some((name, value)) = credential.query_for(&origin)
                && !url.query_pairs().any(|(n, _)| n == name)
            {
                url.query_pairs_mut().append_pair(name, value);
            }
        }
        self.first_byte(uri, self.client.get(url).headers(headers)).await
    }

    /// Sends a request and waits for the head of its answer.
    pub async fn first_byte(&self, uri: &str, request: reqwest::RequestBuilder) -> Result<reqwest::Response, IoError> {
        match tokio::time::timeout(self.config.first_byte_timeout, request.send()).await {
            Ok(Ok(response)) => Ok(response),
            Ok(Err(e)) if e.is_timeout() && e.is_connect() => {
                Err(timed_out(uri, "connecting", self.config.connect_timeout))
            }
            Ok(Err(e)) if is_tls(&e) => Err(IoError::Tls { uri: uri.to_owned(), reason: chain(e) }),
            Ok(Err(e)) => Err(IoError::Network { uri: uri.to_owned(), reason: chain(e) }),
            Err(_) => Err(timed_out(uri, "waiting for the answer", self.config.first_byte_timeout)),
        }
    }

    /// The body, where it is one to be read.
    pub async fn read(&self, uri: &str, mut response: reqwest::Response) -> Result<Answer, IoError> {
        let status = response.status().as_u16();
        let headers = std::mem::take(response.headers_mut());
        let freshness = Freshness::of(&headers, SystemTime::now());
        if !matches!(status, 200 | 203 | 206) {
            self.drain(response).await;
            return Ok(Answer { status, headers, body: Vec::new(), freshness, redirected_to: None, origin: None });
        }
        let mut limit = self.limits.max_file_bytes;
        let length = response.content_length();
        // Where no length is told, it may be a short page for people.
        let is_instead = status != 206 && self.headers.contains_key(RANGE);
        if is_instead {
            limit = limit.min(MOST_INSTEAD_OF_RANGE_BYTES);
        }
        let too_large = |got: u64| match is_instead {
            true => IoError::unsupported(uri, "an archive on a server without range requests"),
            false => IoError::TooLarge { uri: uri.to_owned(), what: "answer", got, limit },
        };
        if let Some(length) = length.filter(|l| *l > limit) {
            return Err(too_large(length));
        }
        // What a server announces is not believed beyond this.
        let mut body = Vec::with_capacity(length.unwrap_or(0).min(MOST_RESERVED_BYTES) as usize);
        loop {
            let piece = match tokio::time::timeout(self.config.read_timeout, response.chunk()).await {
                Ok(Ok(Some(piece))) => piece,
                Ok(Ok(None)) => {
                    return Ok(Answer { status, headers, body, freshness, redirected_to: None, origin: None });
                }
                Ok(Err(e)) => return Err(IoError::Network { uri: uri.to_owned(), reason: chain(e) }),
                Err(_) => return Err(timed_out(uri, "reading the answer", self.config.read_timeout)),
            };
            if (body.len() + piece.len()) as u64 > limit {
                return Err(too_large((body.len() + piece.len()) as u64));
            }
            body.extend_from_slice(&piece);
            self.received.fetch_add(piece.len() as u64, Ordering::Relaxed);
        }
    }
}

impl Exchange<'_> {
    /// Reads a short body that nobody needs, so that the connection can be used again; a long one ends it.
    async fn drain(&self, mut response: reqwest::Response) {
        if response.content_length().is_none_or(|length| length > MOST_DRAINED_BYTES) {
            return;
        }
        let all = async { while let Ok(Some(_)) = response.chunk().await {} };
        let _ = tokio::time::timeout(DRAIN_TIME, all).await;
    }
}

fn parse(uri: &str) -> Result<Url, IoError> {
    Url::parse(uri).map_err(|e| IoError::Uri { uri: uri.to_owned(), reason: e.to_string() })
}

/// A URL without its query, which may hold a token, or change each time.
fn place_of(url: &Url) -> String {
    let mut place = url.clone();
    place.set_query(None);
    place.set_fragment(None);
    // Fails only for URLs without a server, which have neither.
    let _ = place.set_username("");
    let _ = place.set_password(None);
    place.into()
}

/// Scheme, name and port.
pub(super) fn origin(uri: &str) -> Result<String, IoError> {
    Ok(parse(uri)?.origin().ascii_serialization())
}

fn refused(uri: &str, reason: String) -> IoError {
    IoError::Uri { uri: uri.to_owned(), reason }
}

pub(super) fn timed_out(uri: &str, phase: &'static str, limit: Duration) -> IoError {
    IoError::Timeout { uri: uri.to_owned(), phase, seconds: limit.as_secs_f64() }
}

/// The encrypted connection did not come to stand. What breaks one that stood may pass.
fn is_tls(error: &reqwest::Error) -> bool {
    let mut next: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(e) = next {
        // An I/O error's source is not what it wraps, but the source of that.
        let wrapped = e.downcast_ref::<std::io::Error>().and_then(|e| e.get_ref());
        if e.is::<rustls::Error>() || wrapped.is_some_and(|w| w.is::<rustls::Error>()) {
            return error.is_connect();
        }
        next = match wrapped {
            Some(wrapped) => Some(wrapped),
            None => e.source(),
        };
    }
    false
}

/// An error with its causes, in one line, and without the URL: that may hold a token.
pub(super) fn chain(error: reqwest::Error) -> String {
    chain_of(&error.without_url())
}

/// An error with its causes, in one line.
pub(super) fn chain_of(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(e) = source {
        text.push_str(": ");
        text.push_str(&e.to_string());
        source = e.source();
    }
    text
}
