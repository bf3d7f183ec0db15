//! Objects of S3, Google's and Azure's stores, over the same client as everything else.
//!
//! `object_store` knows the stores: addresses, keys, signatures, tokens. It hands each signed request to [`Transport`],
//! which sends it as any other and keeps the answer for whoever asked: limits, timeouts, retries, ranges and the cache
//! are those of HTTP. HTTP thread.

use std::num::NonZeroUsize;
use std::sync::atomic::AtomicU64;
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

use super::exchange::{Answer, Exchange, chain_of};
use super::{HttpConfig, store_config};
use crate::io::uri::percent_decode;
use crate::io::{IoError, Limits, server};

/// Buckets whose stores are kept.
const KEPT: NonZeroUsize = NonZeroUsize::new(16).expect("not zero");
/// Longest answer of a service that gives out tokens.
const MOST_TOKEN_BYTES: u64 = 1 << 20;
/// For a whole answer of a metadata service, which is next to the machine.
const LONGEST_TOKEN_WAIT: Duration = Duration::from_secs(2);
/// One that did not answer is not asked again for so long.
const SILENCE: Duration = Duration::from_secs(30);
const NO_METADATA: &str = "the metadata service, which is to give keys for the store, does not answer";

/// Stores by scheme and bucket, with the tokens they hold.
#[derive(Debug)]
pub(super) struct Stores(Mutex<LruCache<String, Arc<dyn ObjectStore>>>);

/// One request for an object on its way through `object_store`, and what came of it.
struct Asked {
    uri: String,
    limits: Limits,
    headers: HeaderMap,
    received: Arc<AtomicU64>,
    outcome: Mutex<Option<Result<Answer, IoError>>>,
}

impl Stores {
    pub fn new() -> Self {
        Self(Mutex::new(LruCache::new(KEPT)))
    }

    /// Asks once for an object.
    pub async fn get(&self, uri: &str, exchange: &Exchange<'_>) -> Result<Answer, IoError> {
        let bad = |reason: String| IoError::Uri { uri: uri.to_owned(), reason };
        let url = Url::parse(uri).map_err(|e| bad(e.to_string()))?;
        let key = percent_decode(url.path()).ok_or_else(|| bad("bad percent escape".to_owned()))?;
        let key = Path::parse(key).map_err(|e| bad(e.to_string()))?;
        let store = self.store(uri, exchange)?;
        let asked = Arc::new(Asked {
            uri: uri.to_owned(),
            limits: *exchange.limits,
            headers: exchange.headers.clone(),
            received: exchange.received.clone(),
            outcome: Mutex::new(None),
        });
        let mut options = conditions(exchange.headers);
        options.extensions.insert(asked.clone());
        let result = store.get_opts(&key, options).await;
        // What was answered for the object counts, whatever the crate makes of it.
        if let Some(outcome) = asked.outcome.lock().unwrap_or_else(PoisonError::into_inner).take() {
            return outcome;
        }
        Err(match result {
            // Azure's ranges from the end.
            Err(Error::NotSupported { .. } | Error::NotImplemented { .. }) => {
                IoError::unsupported(uri, "what this store was asked for")
            }
            // No answer of the store's own: no keys, no token, no such place.
            Err(error) => IoError::Network { uri: uri.to_owned(), reason: chain_of(&error) },
            Ok(_) => IoError::Network { uri: uri.to_owned(), reason: "the request was never sent".to_owned() },
        })
    }

    fn store(&self, uri: &str, exchange: &Exchange<'_>) -> Result<Arc<dyn ObjectStore>, IoError> {
        let bucket = server(uri);
        let mut stores = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(store) = stores.get(bucket) {
            return Ok(store.clone());
        }
        let transport = Transport {
            client: exchange.client.clone(),
            config: exchange.config.clone(),
            open: false,
            silent: Arc::default(),
        };
        // Retries are this client's own.
        let retry = RetryConfig { max_retries: 0, ..RetryConfig::default() };
        let options = &exchange.config.store_options;
        let bad = |e: Error| IoError::Uri { uri: uri.to_owned(), reason: chain_of(&e) };
        macro_rules! built {
            ($configured:path) => {{
                let builder = $configured(options).map_err(bad)?;
                let builder = builder.with_url(bucket).with_retry(retry).with_http_connector(transport);
                Arc::new(builder.build().map_err(bad)?) as Arc<dyn ObjectStore>
            }};
        }
        let store = match bucket.split_once(':').map(|(scheme, _)| scheme.to_ascii_lowercase()).as_deref() {
            Some("s3") => built!(store_config::s3),
            Some("gs") => built!(store_config::google),
            _ => built!(store_config::azure),
        };
        stores.put(bucket.to_owned(), store.clone());
        Ok(store)
    }
}

/// What signatures may cover goes through the crate; the rest is added when the request is sent.
fn conditions(headers: &HeaderMap) -> GetOptions {
    let text = |name| headers.get(name).and_then(|v| v.to_str().ok());
    GetOptions {
        range: text(RANGE).and_then(range),
        if_none_match: text(IF_NONE_MATCH).map(str::to_owned),
        if_modified_since: text(IF_MODIFIED_SINCE).and_then(|t| httpdate::parse_http_date(t).ok()).map(Into::into),
        ..GetOptions::default()
    }
}

/// `bytes=10-14` or `bytes=-5`.
fn range(text: &str) -> Option<GetRange> {
    let (first, last) = text.strip_prefix("bytes=")?.split_once('-')?;
    if first.is_empty() {
        return last.parse().ok().map(GetRange::Suffix);
    }
    Some(GetRange::Bounded(first.parse().ok()?..last.parse::<u64>().ok()?.checked_add(1)?))
}

/// Sends what `object_store` has signed.
#[derive(Clone, Debug)]
struct Transport {
    client: reqwest::Client,
    config: HttpConfig,
    /// Connections may be open ones (`AWS_ALLOW_HTTP`, or a service on this machine that gives out tokens).
    open: bool,
    /// Until when the service that gives out tokens is not asked again, as it did not answer. Read and written by the
    /// HTTP thread; taken for moments.
    silent: Arc<Mutex<Option<Instant>>>,
}

impl Transport {
    /// Fails at once while a service of the machine's own cloud was silent a moment ago: each tile would wait for it.
    fn is_silent(&self) -> bool {
        let until = *self.silent.lock().unwrap_or_else(PoisonError::into_inner);
        until.is_some_and(|until| Instant::now() < until)
    }
}

impl HttpConnector for Transport {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<HttpClient> {
        let allowed = options.get_config_value(&ClientConfigKey::AllowHttp);
        let open = allowed.is_some_and(|text| text.eq_ignore_ascii_case("true"));
        Ok(HttpClient::new(Self { open, ..self.clone() }))
    }
}

#[async_trait]
impl HttpService for Transport {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let (parts, body) = request.into_parts();
        let parts_are_open = parts.uri.scheme_str() != Some("https");
        let asked = parts.extensions.get::<Arc<Asked>>().cloned();
        let (uri, limits) = match &asked {
            Some(asked) => (asked.uri.clone(), asked.limits),
            None => (parts.uri.to_string(), Limits { max_file_bytes: MOST_TOKEN_BYTES, ..Limits::default() }),
        };
        let headers = asked.as_ref().map(|asked| asked.headers.clone()).unwrap_or_default();
        let received = asked.as_ref().map(|asked| asked.received.clone()).unwrap_or_default();
        let (client, config) = (&self.client, &self.config);
        let (limits, headers) = (&limits, &headers);
        let exchange = Exchange { client, config, limits, headers, validated_at: None, received };
        let outcome = async {
            if !self.open && parts_are_open {
                let reason = "an open connection to an object store, which is not allowed (ALLOW_HTTP)".to_owned();
                return Err(IoError::Uri { uri: uri.clone(), reason });
            }
            let mut request = self.client.request(parts.method, parts.uri.to_string()).headers(parts.headers);
            if let Some(encoding) = headers.get(ACCEPT_ENCODING) {
                request = request.header(ACCEPT_ENCODING, encoding);
            }
            if let Some(bytes) = body.as_bytes().filter(|bytes| !bytes.is_empty()) {
                request = request.body(bytes.clone());
            }
            let response = exchange.first_byte(&uri, request).await?;
            exchange.read(&uri, response).await
        };
        // Not encrypted: a service of the cloud that this machine is in, or is said to be in.
        let outcome = if asked.is_none() && parts_are_open {
            let no_answer = || IoError::Network { uri: uri.clone(), reason: NO_METADATA.to_owned() };
            if self.is_silent() {
                Err(no_answer())
            } else {
                let outcome =
                    tokio::time::timeout(LONGEST_TOKEN_WAIT, outcome).await.unwrap_or_else(|_| Err(no_answer()));
                if matches!(outcome, Err(IoError::Network { .. } | IoError::Timeout { .. })) {
                    let until = Instant::now() + SILENCE;
                    *self.silent.lock().unwrap_or_else(PoisonError::into_inner) = Some(until);
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
                if asked.is_none() {
                    *response.body_mut() = answer.body.clone().into();
                }
                Ok(response)
            }
            Err(error) => Err(HttpError::new(HttpErrorKind::Unknown, error.clone())),
        };
        if let Some(asked) = asked {
            *asked.outcome.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
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
