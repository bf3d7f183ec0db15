//! Bytes over HTTP: one client, many requests in flight, on the pager's HTTP thread (a tokio runtime of its own).

mod archive;
mod cached;
mod config;
mod doubts;
mod exchange;
mod names;
mod once;
mod retry;
#[cfg(feature = "object-store")]
mod store;
#[cfg(feature = "object-store")]
mod store_config;
mod tiles;
mod tls;

use std::sync::Arc;
use std::time::{Duration, SystemTime};

use reqwest::header::{ACCEPT_ENCODING, CONTENT_ENCODING, HeaderMap, HeaderValue};

use archive::Archives;
pub use config::{Credential, HttpConfig, StoreOption};

/// Reads any text as each header that is read here: for tests.
#[doc(hidden)]
pub fn fuzz_headers(text: &str) {
    use reqwest::header::{AGE, CACHE_CONTROL, DATE, EXPIRES, HeaderMap, HeaderValue, RETRY_AFTER, VARY};
    let Ok(value) = HeaderValue::from_str(text) else { return };
    let now = std::time::SystemTime::now();
    for now in [now, std::time::UNIX_EPOCH] {
        let headers: HeaderMap = [RETRY_AFTER, CACHE_CONTROL, AGE, EXPIRES, DATE, VARY]
            .map(|name| (name, value.clone()))
            .into_iter()
            .collect();
        let _ = retry::retry_after(&headers, now);
        for one in [CACHE_CONTROL, AGE, EXPIRES, DATE, VARY] {
            let alone: HeaderMap = [(one, value.clone())].into_iter().collect();
            super::cache::Freshness::of(&alone, now);
        }
        super::cache::Freshness::of(&headers, now);
    }
    if let Some((first, last, length)) = archive::content_range(text) {
        let _ = (first, last, length);
    }
}
use exchange::Exchange;
use retry::{Backoff, Pause, Pauses};
use tokio::sync::Semaphore;

use super::archive::split_url;
use super::cache::Entry;
use super::{DiskCache, IoError, Limits, encoding, is_store, server};

/// Beyond this, undoing compression goes to a thread of its own, so that the HTTP thread keeps to its connections.
const DECODED_HERE_BYTES: usize = 4 << 10;
/// Bodies that may wait to be written to the cache; with more, the next one waits for its turn.
const WRITES: usize = 64;

/// What came for a URI.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HttpBody {
    /// The content, compression undone.
    pub bytes: Vec<u8>,
    /// Bytes of bodies that came over the network for it, before anything was undone.
    pub network_bytes: u64,
    /// A server answered for it; "not modified" too.
    pub asked: bool,
}

/// A client with its connection pool. Cheap to clone; used inside a tokio runtime.
#[derive(Clone, Debug)]
pub struct HttpClient {
    inner: Arc<Inner>,
    /// What the cache has is asked about, however fresh it is.
    asks: bool,
}

#[derive(Debug)]
struct Inner {
    client: reqwest::Client,
    config: HttpConfig,
    pauses: Pauses,
    archives: Archives,
    #[cfg(feature = "object-store")]
    stores: store::Stores,
    cache: Option<Arc<DiskCache>>,
    /// One permit for each body on its way to the cache.
    writes: Arc<Semaphore>,
}

impl HttpClient {
    /// A client; fails when the TLS back end cannot be set up or the cache cannot be opened.
    pub fn new(config: &HttpConfig) -> Result<Self, IoError> {
        // A second install is refused and harmless: the provider is the same.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let mut builder = reqwest::Client::builder()
            .connect_timeout(config.connect_timeout)
            .user_agent(concat!("terrane/", env!("CARGO_PKG_VERSION")))
            // Followed by `Exchange`, which knows what is whose.
            .redirect(reqwest::redirect::Policy::none())
            .referer(false)
            .dns_resolver(names::Names::default())
            .http2_adaptive_window(true);
        builder = builder.tls_certs_merge(tls::root_certificates(&config.root_certificates)?);
        if config.http2_only {
            builder = builder.http2_prior_knowledge();
        }
        let client =
            builder.build().map_err(|e| IoError::Network { uri: String::new(), reason: exchange::chain(e) })?;
        let cache = config.cache.as_ref().map(DiskCache::open).transpose()?;
        #[cfg(feature = "object-store")]
        let cache = cache.map(|cache| cache.with_places(store_config::places(&config.store_options)));
        let cache = cache.map(Arc::new);
        let inner = Inner {
            client,
            config: config.clone(),
            pauses: Pauses::default(),
            archives: Archives::new(),
            #[cfg(feature = "object-store")]
            stores: store::Stores::new(),
            cache,
            writes: Arc::new(Semaphore::new(WRITES)),
        };
        Ok(Self { inner: Arc::new(inner), asks: false })
    }

    /// The same one, for which nothing in the cache holds until the server has said so.
    pub(crate) fn asking(&self) -> Self {
        Self { asks: true, ..self.clone() }
    }

    /// An entry is taken without asking.
    fn takes(&self, cache: &DiskCache, entry: &Entry) -> bool {
        cache.is_offline() || (!self.asks && entry.is_fresh(SystemTime::now()))
    }

    /// How it talks to servers.
    pub fn config(&self) -> &HttpConfig {
        &self.inner.config
    }

    /// The cache on disk, where there is one.
    pub fn cache(&self) -> Option<&Arc<DiskCache>> {
        self.inner.cache.as_ref()
    }

    /// What came for a URI turned out to be no content: the cache does not keep it, and an archive that it is in may have
    /// been misread.
    pub(crate) fn forget(&self, uri: &str) {
        if let Some(cache) = self.cache() {
            cache.forget(uri);
        }
        if let Some((url, _)) = split_url(uri) {
            self.inner.archives.doubt_any(&url);
        }
    }

    /// Waits until everything that came is in the cache.
    pub async fn flush(&self) {
        // Fails only for a semaphore that was closed, which this one never is.
        let _ = self.inner.writes.acquire_many(WRITES as u32).await;
    }

    /// The body of a URL or of an object in a store, compression undone, from the cache where it holds. A URL that goes on behind the name of an
    /// archive (`.3tz`, `.zip`) is a file inside it. Retries what may pass, with growing waits.
    pub async fn get(&self, uri: &str, limits: &Limits) -> Result<HttpBody, IoError> {
        if let Some((url, name)) = split_url(uri) {
            return self.get_member(uri, (&url, name), limits).await;
        }
        match &self.inner.cache {
            Some(cache) => self.get_cached(cache, uri, limits).await,
            None => {
                let answer = self.exchange(uri, &accept_any(), None, limits).await?;
                if !answer.is_whole() {
                    return Err(answer.error(uri));
                }
                let network_bytes = answer.body.len() as u64;
                let bytes = undo(uri, answer.body, encodings(&answer.headers), limits).await?;
                Ok(HttpBody { bytes, network_bytes, asked: true })
            }
        }
    }

    /// An answer that is no failure, with as many tries as that takes and the configuration allows.
    async fn exchange(
        &self,
        uri: &str,
        headers: &HeaderMap,
        validated_at: Option<&str>,
        limits: &Limits,
    ) -> Result<exchange::Answer, IoError> {
        let Inner { client, config, pauses, .. } = &*self.inner;
        let mut backoff = Backoff::new(config.retry_backoff, config.max_wait, config.seed, uri);
        let server = match is_store(uri) {
            true => server(uri).to_owned(),
            false => exchange::origin(uri)?,
        };
        let mut tries_left = config.max_retries;
        loop {
            // Another request's answer may have asked for a pause, and another one's while this waited.
            while let Some(Pause { status, left }) = pauses.of(&server) {
                if left > config.max_wait {
                    return Err(IoError::Status { uri: uri.to_owned(), status, retry_after: Some(left) });
                }
                tokio::time::sleep(left + backoff.spread()).await;
            }
            let exchange = Exchange { client, config, limits, headers, validated_at, received: Arc::default() };
            let error = match exchange.in_time(uri, self.once(uri, &exchange)).await {
                Ok(answer) if answer.is_success() => return Ok(answer),
                Ok(answer) => {
                    let error = answer.error(uri);
                    if let IoError::Status { status: status @ (429 | 503), retry_after: Some(left), .. } = error {
                        pauses.pause(answer.origin.as_ref().unwrap_or(&server), Pause { status, left });
                    }
                    error
                }
                Err(error) => error,
            };
            if !error.is_transient() || tries_left == 0 {
                return Err(error);
            }
            tries_left -= 1;
            match backoff.wait(error.retry_after()) {
                Some(wait) => tokio::time::sleep(wait).await,
                None => return Err(error),
            }
        }
    }

    async fn once(&self, uri: &str, exchange: &Exchange<'_>) -> Result<exchange::Answer, IoError> {
        if !is_store(uri) {
            return exchange.run(uri, &self.inner.pauses).await;
        }
        #[cfg(feature = "object-store")]
        return self.inner.stores.get(uri, exchange).await;
        #[cfg(not(feature = "object-store"))]
        Err(IoError::unsupported(uri, "an object store (built without the feature)"))
    }
}

/// What every request says, ranges excepted.
fn accept_any() -> HeaderMap {
    HeaderMap::from_iter([(ACCEPT_ENCODING, HeaderValue::from_static(encoding::ACCEPT))])
}

fn encodings(headers: &HeaderMap) -> String {
    let values: Vec<&str> = headers.get_all(CONTENT_ENCODING).iter().filter_map(|v| v.to_str().ok()).collect();
    values.join(",")
}

async fn undo(uri: &str, body: Vec<u8>, names: String, limits: &Limits) -> Result<Vec<u8>, IoError> {
    let plain = names.is_empty() && !body.starts_with(&[0x1f, 0x8b]);
    if plain || body.len() < DECODED_HERE_BYTES {
        return encoding::decode(uri, body, &names, limits);
    }
    let (uri, limits) = (uri.to_owned(), *limits);
    blocking(&uri.clone(), move || encoding::decode(&uri, body, &names, &limits)).await?
}

/// Work for a thread that may wait, from the HTTP thread.
async fn blocking<T: Send + 'static>(uri: &str, work: impl FnOnce() -> T + Send + 'static) -> Result<T, IoError> {
    let failed = |_| IoError::Network { uri: uri.to_owned(), reason: "a thread for it stopped".to_owned() };
    tokio::task::spawn_blocking(work).await.map_err(failed)
}

/// The runtime that a client is used in.
pub(crate) fn runtime(name: &str) -> std::io::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .thread_name(format!("{name}-io"))
        .max_blocking_threads(4)
        .thread_keep_alive(Duration::from_secs(10))
        .build()
}

/// One request after the other, on the calling thread.
#[derive(Debug)]
pub(crate) struct HttpHere {
    runtime: tokio::runtime::Runtime,
    client: HttpClient,
}

impl HttpHere {
    pub fn new(config: &HttpConfig) -> Result<Self, IoError> {
        let failed = |e: std::io::Error| IoError::Network { uri: String::new(), reason: e.to_string() };
        Ok(Self { runtime: runtime("http").map_err(failed)?, client: HttpClient::new(config)? })
    }

    pub fn get(&self, uri: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        self.runtime.block_on(async {
            let body = self.client.get(uri, limits).await?;
            self.client.flush().await;
            Ok(body.bytes)
        })
    }
}
