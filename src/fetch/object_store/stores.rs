//! [`Stores`]: requests for objects, signed by the crate `object_store` and sent by the HTTP client. Runs on the runtime of the
//! HTTP client.
//!
//! The crate knows addresses, keys, signatures and tokens. It passes each signed request to [`SignedTransport`], which sends it
//! like any other request and hands the answer to the caller of [`Stores::get`]. So limits, timeouts, retries, ranges and the
//! cache are those of HTTP.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use async_trait::async_trait;
use lru::LruCache;
use object_store::client::{
    ClientConfigKey, HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpService,
};
use object_store::path::Path;
use object_store::{ClientOptions, Error, GetOptions, GetRange, ObjectStore, RetryConfig};
use reqwest::header::{ACCEPT_ENCODING, HeaderMap, IF_MODIFIED_SINCE, IF_NONE_MATCH, RANGE};
use url::Url;

use super::config;
use crate::fetch::http::{Answer, Connections, Exchange, Progress, error_chain};
use crate::fetch::percent_decode;
use crate::fetch::{HttpConfig, IoError, Limits, Permit, server};

/// The maximum number of buckets whose stores are cached.
const MAX_STORES: NonZeroUsize = NonZeroUsize::new(16).expect("not zero");
/// The maximum size of an answer of a token service.
const MAX_TOKEN_BYTES: u64 = 1 << 20;
/// Time limit for an answer of a metadata service, which is close to the machine.
const METADATA_TIMEOUT: Duration = Duration::from_secs(2);
/// After a timeout, a metadata service is not asked again for this time.
const METADATA_RETRY_AFTER: Duration = Duration::from_secs(30);
const NO_METADATA: &str = "the metadata service, which should provide keys for the store, does not answer";

/// The stores of a client by scheme and bucket, with their tokens. Locked briefly.
#[derive(Debug)]
pub(in crate::fetch) struct Stores(Mutex<LruCache<String, Arc<dyn ObjectStore>>>);

/// A request for an object while it passes through `object_store`, and its outcome.
struct ObjectRequest {
    uri: String,
    limits: Limits,
    permit: Permit,
    headers: HeaderMap,
    progress: Arc<Progress>,
    outcome: Mutex<Option<Result<Answer, IoError>>>,
}

impl Stores {
    pub fn new() -> Self {
        Self(Mutex::new(LruCache::new(MAX_STORES)))
    }

    /// Requests an object once, without retries.
    pub async fn get(&self, uri: &str, exchange: &Exchange<'_>) -> Result<Answer, IoError> {
        let bad = |reason: String| IoError::Uri { uri: uri.to_owned(), reason };
        let url = Url::parse(uri).map_err(|e| bad(e.to_string()))?;
        let key = percent_decode(url.path()).ok_or_else(|| bad("bad percent escape".to_owned()))?;
        let key = Path::parse(key).map_err(|e| bad(e.to_string()))?;
        let store = self.store(uri, exchange)?;
        let asked = Arc::new(ObjectRequest {
            uri: uri.to_owned(),
            limits: *exchange.limits,
            permit: exchange.permit.clone(),
            headers: exchange.headers.clone(),
            progress: exchange.progress.clone(),
            outcome: Mutex::new(None),
        });
        let mut options = conditions(exchange.headers);
        options.extensions.insert(asked.clone());
        let result = store.get_opts(&key, options).await;
        // The answer of the store counts, whatever the crate turned it into.
        if let Some(outcome) = asked.outcome.lock().unwrap_or_else(PoisonError::into_inner).take() {
            return outcome;
        }
        Err(match result {
            // Azure supports no ranges relative to the end.
            Err(Error::NotSupported { .. } | Error::NotImplemented { .. }) => {
                IoError::unsupported(uri, "this kind of request to the store")
            }
            // The request was not sent: missing keys, no token, or an unknown host.
            Err(error) => IoError::Network { uri: uri.to_owned(), reason: error_chain(&error) },
            Ok(_) => IoError::Network { uri: uri.to_owned(), reason: "the request was never sent".to_owned() },
        })
    }

    fn store(&self, uri: &str, exchange: &Exchange<'_>) -> Result<Arc<dyn ObjectStore>, IoError> {
        let bucket = server(uri);
        let mut stores = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(store) = stores.get(bucket) {
            return Ok(store.clone());
        }
        let transport = SignedTransport {
            connections: exchange.connections.clone(),
            config: exchange.config.clone(),
            allows_http: false,
            metadata_silent_until: Arc::default(),
        };
        // The HTTP client retries.
        let retry = RetryConfig { max_retries: 0, ..RetryConfig::default() };
        let options = &exchange.config.store_options;
        let bad = |e: Error| IoError::Uri { uri: uri.to_owned(), reason: error_chain(&e) };
        let store = config::store(bucket, options, retry, transport).map_err(bad)?;
        stores.put(bucket.to_owned(), store.clone());
        Ok(store)
    }
}

/// Returns the conditions that a signature may cover. Other headers are added when the request is sent.
fn conditions(headers: &HeaderMap) -> GetOptions {
    let text = |name| headers.get(name).and_then(|v| v.to_str().ok());
    GetOptions {
        range: text(RANGE).and_then(range),
        if_none_match: text(IF_NONE_MATCH).map(str::to_owned),
        if_modified_since: text(IF_MODIFIED_SINCE).and_then(|t| httpdate::parse_http_date(t).ok()).map(Into::into),
        ..GetOptions::default()
    }
}

/// Parses `bytes=10-14` or `bytes=-5`.
fn range(text: &str) -> Option<GetRange> {
    let (first, last) = text.strip_prefix("bytes=")?.split_once('-')?;
    if first.is_empty() {
        return last.parse().ok().map(GetRange::Suffix);
    }
    Some(GetRange::Bounded(first.parse().ok()?..last.parse::<u64>().ok()?.checked_add(1)?))
}

/// Sends the requests that `object_store` has signed.
#[derive(Clone, Debug)]
struct SignedTransport {
    connections: Arc<Connections>,
    config: HttpConfig,
    /// Permits unencrypted connections (`AWS_ALLOW_HTTP`, or a token service on this machine).
    allows_http: bool,
    /// The time until which the metadata service is not asked again, because it timed out. Read and written by the HTTP
    /// thread; locked briefly.
    metadata_silent_until: Arc<Mutex<Option<Instant>>>,
}

impl SignedTransport {
    /// Returns true if the metadata service timed out recently. Requests for keys then fail at once, so that tiles do not wait
    /// for it one by one.
    fn is_metadata_silent(&self) -> bool {
        let until = *self.metadata_silent_until.lock().unwrap_or_else(PoisonError::into_inner);
        until.is_some_and(|until| Instant::now() < until)
    }
}

impl HttpConnector for SignedTransport {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        let allowed = options.get_config_value(&ClientConfigKey::AllowHttp);
        let allows_http = allowed.is_some_and(|text| text.eq_ignore_ascii_case("true"));
        Ok(HttpClient::new(Self { allows_http, ..self.clone() }))
    }
}

#[async_trait]
impl HttpService for SignedTransport {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let (parts, body) = request.into_parts();
        let is_unencrypted = parts.uri.scheme_str() != Some("https");
        let object = parts.extensions.get::<Arc<ObjectRequest>>().cloned();
        let (uri, limits, permit) = match &object {
            Some(object) => (object.uri.clone(), object.limits, object.permit.clone()),
            None => {
                let limits = Limits { max_file_bytes: MAX_TOKEN_BYTES, ..Limits::default() };
                (parts.uri.to_string(), limits, Permit::unlimited())
            }
        };
        let headers = object.as_ref().map(|object| object.headers.clone()).unwrap_or_default();
        let progress = object.as_ref().map(|object| object.progress.clone()).unwrap_or_default();
        let (connections, config) = (&self.connections, &self.config);
        let (limits, permit, headers) = (&limits, &permit, &headers);
        let exchange =
            Exchange { connections, root: None, config, limits, permit, headers, validated_at: None, progress };
        let outcome = async {
            if !self.allows_http && is_unencrypted {
                let reason =
                    "an unencrypted connection to an object store, which is not allowed (ALLOW_HTTP)".to_owned();
                return Err(IoError::Uri { uri: uri.clone(), reason });
            }
            // The user names the stores and token services. The tile set cannot: its scope is one bucket.
            let client = connections.to_any(&uri)?;
            let mut request = client.request(parts.method, parts.uri.to_string()).headers(parts.headers);
            if let Some(encoding) = headers.get(ACCEPT_ENCODING) {
                request = request.header(ACCEPT_ENCODING, encoding);
            }
            if let Some(bytes) = body.as_bytes().filter(|bytes| !bytes.is_empty()) {
                request = request.body(bytes.clone());
            }
            let response = exchange.first_byte(&uri, request).await?;
            exchange.read(&uri, response).await
        };
        // An unencrypted request that is not for an object goes to the metadata service of a cloud.
        let outcome = if object.is_none() && is_unencrypted {
            let no_answer = || IoError::Network { uri: uri.clone(), reason: NO_METADATA.to_owned() };
            if self.is_metadata_silent() {
                Err(no_answer())
            } else {
                let outcome =
                    tokio::time::timeout(METADATA_TIMEOUT, outcome).await.unwrap_or_else(|_| Err(no_answer()));
                if matches!(outcome, Err(IoError::Network { .. } | IoError::Timeout { .. })) {
                    let until = Instant::now() + METADATA_RETRY_AFTER;
                    *self.metadata_silent_until.lock().unwrap_or_else(PoisonError::into_inner) = Some(until);
                }
                outcome
            }
        } else {
            outcome.await
        };
        let mut response = HttpResponse::new(Vec::new().into());
        let sent = match &outcome {
            Ok(answer) => {
                *response.status_mut() = answer.status.try_into().unwrap_or_default();
                *response.headers_mut() = answer.headers.clone();
                if object.is_none() {
                    *response.body_mut() = answer.body.clone().into();
                }
                Ok(response)
            }
            Err(error) => Err(HttpError::new(HttpErrorKind::Unknown, error.clone())),
        };
        if let Some(object) = object {
            *object.outcome.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
        }
        sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_conditions() {
        assert!(matches!(range("bytes=10-14"), Some(GetRange::Bounded(r)) if r == (10..15)));
        assert!(matches!(range("bytes=-5"), Some(GetRange::Suffix(5))));
        for odd in ["", "bytes=", "bytes=-", "bytes=1-", "items=1-2", "bytes=1-18446744073709551615"] {
            assert!(range(odd).is_none(), "{odd}");
        }
    }
}
