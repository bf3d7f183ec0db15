//! [`Connections`]: the pools of connections of a client, and which of them a request may use. HTTP thread.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use hyper_util::client::proxy::matcher::Matcher;
use reqwest::Certificate;
use url::Url;

use super::address::{local_kind, written_address};
use super::dns::{DnsResolver, PoolResolver, Reach, RefusedAddress};
use crate::fetch::IoError;
use crate::fetch::http::config::{AllowedHost, HttpConfig, host_of};
use crate::fetch::http::cookies::Cookies;
use crate::fetch::http::error_chain::error_chain_without_url;
use crate::fetch::http::tls;

/// The pools of connections of a client. Their cookies and DNS queries are shared.
#[derive(Debug)]
pub(in crate::fetch) struct Connections {
    public: reqwest::Client,
    /// Created by the first request that may use it, as `any` is.
    local: OnceLock<reqwest::Client>,
    any: OnceLock<reqwest::Client>,
    parts: Parts,
    allowed: Vec<AllowedHost>,
    /// The proxies of the environment, which the pools use too.
    proxies: Matcher,
    /// The reach of each host of a root that is a name. The first DNS query decides it for good: a name that had public
    /// addresses must not lead into the local network later, nor the reverse. Locked briefly.
    roots: Mutex<HashMap<String, Reach>>,
}

/// The settings and objects that all pools share.
#[derive(Debug)]
struct Parts {
    connect_timeout: Duration,
    http2_only: bool,
    certificates: Vec<Certificate>,
    cookies: Arc<Cookies>,
    dns: Arc<DnsResolver>,
}

impl Parts {
    fn pool(&self, reach: Reach) -> Result<reqwest::Client, reqwest::Error> {
        let mut builder = reqwest::Client::builder()
            .connect_timeout(self.connect_timeout)
            .user_agent(concat!("terrane/", env!("CARGO_PKG_VERSION")))
            // `Exchange` follows redirects, since it knows which credential belongs to which server.
            .redirect(reqwest::redirect::Policy::none())
            .referer(false)
            .cookie_provider(self.cookies.clone())
            .dns_resolver(PoolResolver { dns: self.dns.clone(), reach })
            .http2_adaptive_window(true)
            .tls_certs_merge(self.certificates.clone());
        if self.http2_only {
            builder = builder.http2_prior_knowledge();
        }
        builder.build()
    }
}

impl Connections {
    /// Fails if a certificate file is invalid or TLS cannot be initialized.
    pub(in crate::fetch::http) fn new(config: &HttpConfig, dns: DnsResolver) -> Result<Self, IoError> {
        // A second installation is refused, which is harmless: the provider is the same.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let parts = Parts {
            connect_timeout: config.connect_timeout,
            http2_only: config.http2_only,
            certificates: tls::root_certificates(&config.root_certificates)?,
            cookies: Arc::default(),
            dns: Arc::new(dns),
        };
        Ok(Self {
            public: parts.pool(Reach::Public).map_err(|e| cannot_create("", e))?,
            local: OnceLock::new(),
            any: OnceLock::new(),
            parts,
            allowed: config.allowed_hosts.clone(),
            proxies: Matcher::from_system(),
            roots: Mutex::default(),
        })
    }

    /// Returns the pool that may connect to a URL. `root` is a URL of the server that the set came from, if it came from one;
    /// `uri` is named in errors.
    ///
    /// # Errors
    /// [`IoError::HostRefused`] if the host is written as an address that is not public, and neither allowed nor the root's.
    pub async fn for_url(&self, uri: &str, url: &Url, root: Option<&Url>) -> Result<&reqwest::Client, IoError> {
        if self.allowed.iter().any(|host| host.matches(url)) {
            return self.to_any(uri);
        }
        let is_root = root.is_some_and(|root| is_same_server(root, url));
        let written = written_address(url);
        let written_kind = written.and_then(local_kind);
        if let (Some(address), Some(kind), false) = (written, written_kind, is_root) {
            return Err(refused(uri, url, RefusedAddress { address, kind }));
        }
        // The proxy resolves names. The name of the proxy itself, which the user gave, may have any address.
        if url.as_str().parse().is_ok_and(|target| self.proxies.intercept(&target).is_some()) {
            return self.to_any(uri);
        }
        let reach = match written {
            Some(_) if written_kind.is_some() => Reach::Local,
            None if is_root => self.reach_of_root(uri, host_of(url)).await?,
            _ => Reach::Public,
        };
        match reach {
            Reach::Local => self.pool(&self.local, Reach::Local, uri),
            _ => Ok(&self.public),
        }
    }

    /// Returns the pool for hosts that the configuration names, such as those of an object store.
    pub fn to_any(&self, uri: &str) -> Result<&reqwest::Client, IoError> {
        self.pool(&self.any, Reach::Any, uri)
    }

    fn pool<'a>(
        &self,
        pool: &'a OnceLock<reqwest::Client>,
        reach: Reach,
        uri: &str,
    ) -> Result<&'a reqwest::Client, IoError> {
        if let Some(client) = pool.get() {
            return Ok(client);
        }
        let client = self.parts.pool(reach).map_err(|e| cannot_create(uri, e))?;
        Ok(pool.get_or_init(|| client))
    }

    /// Returns the reach of the host of a root, which is a name.
    async fn reach_of_root(&self, uri: &str, name: &str) -> Result<Reach, IoError> {
        if let Some(reach) = self.roots().get(name) {
            return Ok(*reach);
        }
        let failed = |reason: String| IoError::Network { uri: uri.to_owned(), reason: format!("dns error: {reason}") };
        let limit = self.parts.connect_timeout;
        let Ok(answer) = tokio::time::timeout(limit, self.parts.dns.query(name)).await else {
            return Err(IoError::Timeout { uri: uri.to_owned(), phase: "connecting", seconds: limit.as_secs_f64() });
        };
        let addresses = answer.map_err(|e| failed(e.to_string()))?.map_err(|e| failed(e.to_string()))?;
        let is_local = |at: &SocketAddr| local_kind(at.ip()).is_some();
        let reach = match !addresses.is_empty() && addresses.iter().all(is_local) {
            true => Reach::Local,
            false => Reach::Public,
        };
        Ok(*self.roots().entry(name.to_owned()).or_insert(reach))
    }

    fn roots(&self) -> MutexGuard<'_, HashMap<String, Reach>> {
        self.roots.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns true if a URL leads to the server of a root: the same host and port, or from the port of http to that of https.
fn is_same_server(root: &Url, url: &Url) -> bool {
    let ports = (root.port_or_known_default(), url.port_or_known_default());
    let is_upgrade = ports == (Some(80), Some(443)) && url.scheme() == "https";
    host_of(root) == host_of(url) && (ports.0 == ports.1 || is_upgrade)
}

/// Returns the error of a request that was not sent to a URL because of its address.
pub(in crate::fetch::http) fn refused(
    uri: &str,
    url: &Url,
    RefusedAddress { address, kind }: RefusedAddress,
) -> IoError {
    let host = match url.port() {
        Some(port) => format!("{}:{port}", host_of(url)),
        None => host_of(url).to_owned(),
    };
    IoError::HostRefused { uri: uri.to_owned(), host, address, kind }
}

fn cannot_create(uri: &str, error: reqwest::Error) -> IoError {
    IoError::Network { uri: uri.to_owned(), reason: error_chain_without_url(error) }
}
