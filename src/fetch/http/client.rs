//! [`HttpClient`]: the content of URLs, of objects in stores, and of members of remote archives. Runs on the runtime of the
//! pager's HTTP thread, or of a blocking caller.

use std::sync::Arc;
use std::time::Duration;

use super::blocking::MAX_BLOCKING_THREADS;
#[cfg(feature = "testing")]
use super::body::parse_content_range;
use super::body::{HttpBody, accept_all_encodings, content_encodings, decode_body};
use super::cache_access::{CachePolicy, HttpCache};
use super::config::HttpConfig;
use super::flights::{FlightKey, Flights};
use super::hosts::DnsResolver;
#[cfg(feature = "testing")]
use super::retry_policy::retry_after;
use super::revalidation;
use super::transport::Transport;
use crate::fetch::archive::{MemberUri, RemoteArchives};
use crate::fetch::archive_names::split_url;
#[cfg(feature = "testing")]
use crate::fetch::cache::Freshness;
use crate::fetch::{CacheConfig, DiskCache, IoError, Limits, Permit, RootScope, run_within};

/// A client with its connections. Cheap to clone; used inside a tokio runtime.
///
/// It asks the servers that the application names, whatever their addresses are. Redirects, and what a tile set refers to
/// ([`Self::within`]), lead to public addresses only, unless [`HttpConfig::allowed_hosts`] has the host.
#[derive(Clone, Debug)]
pub struct HttpClient {
    inner: Arc<Inner>,
    transport: Transport,
    cache_policy: CachePolicy,
}

#[derive(Debug)]
struct Inner {
    archives: RemoteArchives,
    cache: Option<HttpCache>,
    flights: Flights,
}

impl HttpClient {
    /// Creates a client.
    ///
    /// # Errors
    /// Fails if TLS cannot be initialized, a certificate file is invalid, or the cache cannot be opened.
    pub fn new(config: &HttpConfig) -> Result<Self, IoError> {
        Self::with_dns(config, DnsResolver::default())
    }

    fn with_dns(config: &HttpConfig, dns: DnsResolver) -> Result<Self, IoError> {
        let transport = Transport::new(config, dns)?;
        let cache = config.cache.as_ref().map(open_cache).transpose()?;
        let cache = cache.map(|cache| cache.for_asker(config.asker()));
        let cache = cache.map(HttpCache::new);
        let inner = Inner { archives: RemoteArchives::new(), cache, flights: Flights::default() };
        Ok(Self { inner: Arc::new(inner), transport, cache_policy: CachePolicy::UseFresh })
    }

    /// Returns a client with the same connections and cache for the files of a tile set. The set reaches public addresses, the
    /// server of its root and the allowed hosts. URIs are not checked against the scope; [`resolve`](crate::fetch::resolve)
    /// does that.
    pub fn within(&self, scope: &RootScope) -> Self {
        Self { transport: self.transport.within(scope), ..self.clone() }
    }

    /// Returns a client with the same connections and cache that revalidates every cached answer.
    pub(crate) fn revalidating(&self) -> Self {
        Self { cache_policy: CachePolicy::AlwaysRevalidate, ..self.clone() }
    }

    /// Returns the transport that requests are sent by.
    pub(in crate::fetch) fn transport(&self) -> &Transport {
        &self.transport
    }

    /// Returns the configuration.
    pub fn config(&self) -> &HttpConfig {
        self.transport.config()
    }

    /// Returns the disk cache, if one is configured.
    pub fn cache(&self) -> Option<&Arc<DiskCache>> {
        self.inner.cache.as_ref().map(HttpCache::disk)
    }

    /// Discards what was received for a URI, because its bytes turned out to be invalid. The cache removes it, and the
    /// directory of an archive that contains it may be read again.
    pub(crate) fn forget(&self, uri: &str) {
        if let Some(cache) = &self.inner.cache {
            cache.forget_now(uri);
        }
        if let Some((url, _)) = split_url(uri) {
            self.inner.archives.suspect(&url);
        }
    }

    /// Waits until everything received is written to the cache.
    pub async fn flush(&self) {
        if let Some(cache) = &self.inner.cache {
            cache.flush().await;
        }
    }

    /// Returns the decompressed content of a URL or of an object in a store, from the cache while it is valid. A URL that
    /// continues after the name of an archive (`.3tz`, `.zip`) means a file inside it. Retries transient failures with
    /// exponential back-off. Equal calls at the same time make one request; all get its answer or its error.
    pub async fn get(&self, uri: &str, limits: &Limits) -> Result<HttpBody, IoError> {
        let permit = Permit::unlimited();
        loop {
            match self.get_holding(uri, limits, &permit).await {
                // An equal request of a pager had no room.
                Err(IoError::NoRoom { .. }) => {}
                got => return got,
            }
        }
    }

    /// Does the same as [`Self::get`], and claims the bytes from a permit before they are read.
    ///
    /// # Errors
    /// Also [`IoError::NoRoom`], before the body is read or while it grows, if they have no room.
    pub(crate) async fn get_holding(&self, uri: &str, limits: &Limits, permit: &Permit) -> Result<HttpBody, IoError> {
        let (uri_of_key, scope, policy) = (uri.to_owned(), self.transport.scope().cloned(), self.cache_policy);
        let key = FlightKey { uri: uri_of_key, scope, policy, limits: *limits };
        let mut has_asked = false;
        let ask = async || {
            has_asked = true;
            self.get_alone(uri, limits, permit).await
        };
        let body = self.inner.flights.get(key, ask).await?;
        if !has_asked {
            // A copy of what another request has received.
            let size = body.bytes.len() as u64;
            permit.claim(size).map_err(|no_room| IoError::no_room(uri, no_room))?.keep(size);
        }
        Ok(body)
    }

    async fn get_alone(&self, uri: &str, limits: &Limits, permit: &Permit) -> Result<HttpBody, IoError> {
        let Inner { archives, cache, .. } = &*self.inner;
        let transport = &self.transport.holding(permit);
        if let Some((url, name)) = split_url(uri) {
            let member = MemberUri { uri, archive_url: &url, name: &name };
            return archives.get(transport, cache.as_ref(), self.cache_policy, member, limits).await;
        }
        match cache {
            Some(cache) => revalidation::get(transport, cache, self.cache_policy, uri, limits).await,
            None => {
                let answer = transport.exchange(uri, &accept_all_encodings(), None, limits).await?;
                if answer.is_no_content() {
                    return Ok(HttpBody::no_content());
                }
                if !answer.is_whole() {
                    return Err(answer.error(uri));
                }
                let network_bytes = answer.body.len() as u64;
                let location = answer.redirected_to.map(Arc::from);
                let bytes = decode_body(uri, answer.body, content_encodings(&answer.headers), limits, permit).await?;
                Ok(HttpBody { bytes, network_bytes, asked: true, location, is_no_content: false })
            }
        }
    }

    /// Returns the cached content of a URI, however old, without asking a server.
    pub(crate) async fn get_cached(&self, uri: &str, limits: &Limits) -> Option<HttpBody> {
        let (entry, bytes) = self.inner.cache.as_ref()?.load(uri, limits, &Permit::unlimited()).await.ok()??;
        Some(HttpBody { bytes, location: entry.redirected_to.map(Arc::from), ..HttpBody::default() })
    }

    /// Returns true if the cache has the content of a URI.
    pub(crate) async fn is_cached(&self, uri: &str) -> bool {
        match &self.inner.cache {
            Some(cache) => cache.contains(uri).await,
            None => false,
        }
    }
}

/// Opens a cache, unless its disk hangs.
fn open_cache(config: &CacheConfig) -> Result<DiskCache, IoError> {
    let (limit, opened) = (config.disk_timeout, config.clone());
    let timed_out = || {
        let uri = config.folder.display().to_string();
        IoError::Timeout { uri, phase: "opening the cache", seconds: limit.as_secs_f64() }
    };
    run_within(limit, move || DiskCache::open(&opened)).unwrap_or_else(|| Err(timed_out()))
}

/// Creates the single-threaded runtime that a client is used in.
pub(crate) fn runtime(name: &str) -> std::io::Result<tokio::runtime::Runtime> {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .thread_name(format!("{name}-io"))
        .max_blocking_threads(MAX_BLOCKING_THREADS)
        .thread_keep_alive(Duration::from_secs(10))
        .build()
}

/// A client that blocks the calling thread and sends one request at a time.
#[derive(Debug)]
pub(crate) struct BlockingHttpClient {
    /// `None` while it is dropped.
    runtime: Option<tokio::runtime::Runtime>,
    client: HttpClient,
}

impl Drop for BlockingHttpClient {
    /// Does not wait for threads that hang on the cache. What was received has been flushed.
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

impl BlockingHttpClient {
    /// Creates a client for the files of a tile set.
    pub fn new(config: &HttpConfig, scope: &RootScope) -> Result<Self, IoError> {
        let failed = |e: std::io::Error| IoError::Network { uri: String::new(), reason: e.to_string() };
        let client = HttpClient::new(config)?.within(scope);
        Ok(Self { runtime: Some(runtime("http").map_err(failed)?), client })
    }

    /// Blocks until the content of a URI has arrived and is written to the cache.
    pub fn get(&self, uri: &str, limits: &Limits) -> Result<HttpBody, IoError> {
        let received = async {
            let body = self.client.get(uri, limits).await?;
            self.client.flush().await;
            Ok(body)
        };
        match &self.runtime {
            Some(runtime) => runtime.block_on(received),
            None => Err(IoError::Network { uri: uri.to_owned(), reason: "the client is being dropped".to_owned() }),
        }
    }
}

/// Parses any text as each header that the client reads. Entry point of the fuzz tests.
#[cfg(feature = "testing")]
pub fn fuzz_headers(text: &str) {
    use reqwest::header::{AGE, CACHE_CONTROL, DATE, EXPIRES, HeaderMap, HeaderValue, RETRY_AFTER, VARY};
    let Ok(value) = HeaderValue::from_str(text) else { return };
    for now in [std::time::SystemTime::now(), std::time::UNIX_EPOCH] {
        let headers: HeaderMap = [RETRY_AFTER, CACHE_CONTROL, AGE, EXPIRES, DATE, VARY]
            .map(|name| (name, value.clone()))
            .into_iter()
            .collect();
        let _ = retry_after(&headers, now);
        for name in [CACHE_CONTROL, AGE, EXPIRES, DATE, VARY] {
            let alone: HeaderMap = [(name, value.clone())].into_iter().collect();
            Freshness::of(&alone, now);
        }
        Freshness::of(&headers, now);
    }
    let _ = parse_content_range(text);
}

#[cfg(test)]
mod tests {
    use std::net::{IpAddr, SocketAddr};
    use std::sync::atomic::{AtomicUsize, Ordering};

    use kit::server::{Reply, Server};

    use super::*;

    const LOCAL: [u8; 4] = [127, 0, 0, 1];
    /// An address that no test connects to.
    const PUBLIC: [u8; 4] = [8, 8, 8, 8];

    static QUERIES: [AtomicUsize; 2] = [const { AtomicUsize::new(0) }; 2];

    /// Answers for names that lead into the local network, always or by turns.
    fn resolve(name: &str) -> std::io::Result<Vec<SocketAddr>> {
        let is_first = |of: usize| QUERIES[of].fetch_add(1, Ordering::SeqCst) == 0;
        let addresses: Vec<IpAddr> = match name {
            "local.example" | "other.example" => vec![LOCAL.into()],
            "mapped.example" => vec!["::ffff:127.0.0.1".parse().map_err(std::io::Error::other)?],
            "becomes-local.example" => vec![if is_first(0) { PUBLIC } else { LOCAL }.into()],
            "becomes-public.example" => vec![if is_first(1) { LOCAL } else { PUBLIC }.into()],
            _ => return Err(std::io::Error::other("no such name")),
        };
        Ok(addresses.into_iter().map(|address| (address, 0).into()).collect())
    }

    fn client(allowed: &[&str]) -> HttpClient {
        let allowed_hosts = allowed.iter().map(|host| host.parse().unwrap()).collect();
        let config = HttpConfig { allowed_hosts, max_retries: 0, ..HttpConfig::default() };
        HttpClient::with_dns(&config, DnsResolver::new(resolve)).unwrap()
    }

    fn get(client: &HttpClient, url: &str) -> Result<Vec<u8>, IoError> {
        let runtime = runtime("test").unwrap();
        runtime.block_on(client.get(url, &Limits::default())).map(|body| body.bytes)
    }

    #[test]
    fn names_are_checked_by_the_addresses_that_they_resolve_to() {
        let server = Server::start(|request| match request.path() {
            "/moved" => Reply::new(302, "").with(
                "Location",
                format!("http://other.example:{}/a", request.header("host").unwrap().rsplit(':').next().unwrap()),
            ),
            _ => Reply::ok("body"),
        });
        let at = |name: &str| format!("http://{name}:{}", server.port());
        let root = |name: &str| RootScope::Server(at(name));
        let refused = |result: Result<Vec<u8>, IoError>, expected: &str, kind: &str| {
            let error = result.unwrap_err();
            let IoError::HostRefused { host, kind: got, .. } = &error else { panic!("{expected}: {error:?}") };
            assert_eq!((host.as_str(), *got), (format!("{expected}:{}", server.port()).as_str(), kind));
        };
        for name in ["local.example", "mapped.example"] {
            refused(get(&client(&[]).within(&root("8.8.8.8")), &at(name)), name, "loopback");
            refused(
                get(&client(&["other.example", "127.0.0.1"]).within(&root("8.8.8.8")), &at(name)),
                name,
                "loopback",
            );
        }
        refused(get(&client(&[]).within(&root("local.example")), &at("other.example")), "other.example", "loopback");
        assert_eq!(server.count(), 0, "nothing was sent");
        let ok = |client: &HttpClient, url: &str| assert_eq!(get(client, url).unwrap(), b"body");
        ok(&client(&["local.example"]).within(&root("8.8.8.8")), &at("local.example"));
        ok(&client(&[]).within(&root("local.example")), &at("local.example"));
        ok(&client(&[]), &at("local.example"));
        assert_eq!(server.count(), 3);
        refused(get(&client(&[]), &format!("{}/moved", at("local.example"))), "other.example", "loopback");
        assert_eq!(server.count(), 4);
        let error = get(&client(&[]).within(&root("none.example")), &at("none.example")).unwrap_err();
        assert!(matches!(&error, IoError::Network { reason, .. } if reason.contains("no such name")), "{error:?}");
    }

    /// The owner of a name may change its addresses between two requests (DNS rebinding).
    #[test]
    fn name_of_the_root_stays_in_the_network_of_its_first_answer() {
        let server = Server::start(|_| Reply::ok("body"));
        for (name, kind) in [("becomes-local.example", "loopback"), ("becomes-public.example", "public")] {
            let url = format!("http://{name}:{}/", server.port());
            let set = client(&[]).within(&RootScope::of(&url));
            for _ in 0..2 {
                let error = get(&set, &url).unwrap_err();
                assert!(matches!(error, IoError::HostRefused { kind: got, .. } if got == kind), "{error:?}");
            }
        }
        assert_eq!(server.count(), 0);
    }
}
