//! Configuration of the HTTP client: timeouts, retries, credentials, options of object stores. Plain values.

mod allowed;
mod token;

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use reqwest::header::{AUTHORIZATION, HeaderName, HeaderValue};
use url::Url;

pub use self::allowed::AllowedHost;
pub(super) use self::allowed::host_of;
pub(in crate::fetch) use self::token::ExpiringToken;

use crate::fetch::cache::Asker;
use crate::fetch::{CacheConfig, IoError};

/// Configuration of an [`HttpClient`](super::HttpClient). Proxies are taken from the environment variables `http_proxy`,
/// `https_proxy` and `no_proxy`; a proxy resolves the names of the hosts that it is asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct HttpConfig {
    /// Time limit for establishing a connection.
    pub connect_timeout: Duration,
    /// Time limit for receiving status and headers, connecting included.
    pub first_byte_timeout: Duration,
    /// Time limit between two pieces of the body.
    pub read_timeout: Duration,
    /// Time limit for the whole answer, redirects included. The received bytes extend it by the time that they take at
    /// [`Self::min_bytes_per_s`].
    pub total_timeout: Duration,
    /// The slowest transfer rate of a large answer that is accepted. 0 accepts any rate, as long as no pause exceeds
    /// [`Self::read_timeout`].
    pub min_bytes_per_s: u32,
    /// Number of retries after a transient failure.
    pub max_retries: u32,
    /// Delay before the first retry. It doubles with each retry, and half of it is random, so that clients do not retry at the
    /// same time.
    pub retry_backoff: Duration,
    /// Longest delay before a retry. If a server asks for a longer one (`Retry-After`), the request fails with an error that
    /// contains the delay.
    pub max_wait: Duration,
    /// Seed of the random part of delays. Equal seeds and URIs give equal delays.
    pub seed: u64,
    /// Uses HTTP/2 on unencrypted connections without negotiation. Encrypted connections always negotiate it.
    pub http2_only: bool,
    /// PEM files of certificate authorities to trust besides the system's. On Linux, `SSL_CERT_FILE` and `SSL_CERT_DIR` name
    /// the system's.
    pub root_certificates: Vec<PathBuf>,
    /// Credentials; each is sent to its own server only.
    pub credentials: Vec<Credential>,
    /// Hosts that tile sets may reach although their addresses are not public: private, loopback, link-local and so on. Without
    /// them a set reaches public addresses and the server that its root came from. Buckets of object stores and proxies, whose
    /// addresses the user configures, are always reached.
    pub allowed_hosts: Vec<AllowedHost>,
    /// Options of object stores. They override the environment (`AWS_*`, `GOOGLE_*`, `AZURE_*`). Without keys in either,
    /// requests are not signed. The metadata service of a cloud is asked for keys only if it is named
    /// (`AWS_METADATA_ENDPOINT`, `GCE_METADATA_HOST`, `AZURE_MSI_ENDPOINT`) or `*_skip_signature` is set to false.
    pub store_options: Vec<StoreOption>,
    /// The disk cache; `None` disables caching.
    pub cache: Option<CacheConfig>,
}

impl Default for HttpConfig {
    fn default() -> Self {
        Self {
            connect_timeout: Duration::from_secs(10),
            first_byte_timeout: Duration::from_secs(15),
            read_timeout: Duration::from_secs(15),
            total_timeout: Duration::from_secs(120),
            min_bytes_per_s: 4 << 10,
            max_retries: 2,
            retry_backoff: Duration::from_millis(250),
            max_wait: Duration::from_secs(10),
            seed: 1,
            http2_only: false,
            root_certificates: Vec::new(),
            credentials: Vec::new(),
            allowed_hosts: Vec::new(),
            store_options: Vec::new(),
            cache: None,
        }
    }
}

impl HttpConfig {
    /// Returns the credentials that requests carry, for the keys of the cache.
    pub(super) fn asker(&self) -> Asker {
        let mut origins: Vec<(String, Vec<u8>)> = Vec::new();
        for credential in &self.credentials {
            let known = origins.iter().position(|(origin, _)| *origin == credential.origin);
            let at = known.unwrap_or_else(|| {
                origins.push((credential.origin.clone(), Vec::new()));
                origins.len() - 1
            });
            credential.write_to(&mut origins[at].1);
        }
        Asker {
            origins,
            #[cfg(feature = "object-store")]
            stores: crate::fetch::object_store::askers(&self.store_options),
            #[cfg(not(feature = "object-store"))]
            stores: Vec::new(),
        }
    }

    /// Returns true if there are credentials for a server: scheme, host and port.
    pub(super) fn has_credentials_for(&self, origin: &str) -> bool {
        self.credentials.iter().any(|credential| credential.origin == origin)
    }
}

/// A header or query parameter that is sent to one server with every request, also after a redirect to it, and to no other
/// server. Its value never appears in errors, logs, cache files or debug output.
#[derive(Clone, PartialEq)]
pub struct Credential {
    /// Scheme, host and port.
    origin: String,
    kind: Kind,
}

#[derive(Clone, PartialEq)]
enum Kind {
    Header(HeaderName, HeaderValue),
    /// A token that is renewed when its server refuses it.
    Token(Arc<ExpiringToken>),
    Query(String, String),
}

impl Credential {
    /// Creates a header for the server of `url`, such as `authorization` with `Bearer …`.
    pub fn header(url: &str, name: &str, value: &str) -> Result<Self, IoError> {
        let bad =
            |what: &str| IoError::Uri { uri: name.to_owned(), reason: format!("is not a valid {what} of a header") };
        let name = HeaderName::from_bytes(name.as_bytes()).map_err(|_| bad("name"))?;
        let mut value = HeaderValue::from_str(value).map_err(|_| bad("value"))?;
        value.set_sensitive(true);
        Ok(Self { origin: origin(url)?, kind: Kind::Header(name, value) })
    }

    /// Creates a query parameter for the server of `url`, such as `key` or `access_token`.
    pub fn query(url: &str, name: &str, value: &str) -> Result<Self, IoError> {
        Ok(Self { origin: origin(url)?, kind: Kind::Query(name.to_owned(), value.to_owned()) })
    }

    /// Creates the header `Authorization` for the server of `url` with a token that is renewed when that server refuses it.
    pub(in crate::fetch) fn expiring(url: &str, token: Arc<ExpiringToken>) -> Result<Self, IoError> {
        Ok(Self { origin: origin(url)?, kind: Kind::Token(token) })
    }

    /// Appends kind, name and value, so that different credentials give different bytes.
    fn write_to(&self, bytes: &mut Vec<u8>) {
        let (kind, name, value) = match &self.kind {
            Kind::Header(name, value) => (b'h', name.as_str(), value.as_bytes()),
            Kind::Query(name, value) => (b'q', name.as_str(), value.as_bytes()),
            // The user stays the same when the token is renewed.
            Kind::Token(token) => (b't', AUTHORIZATION.as_str(), token.endpoint().as_bytes()),
        };
        bytes.push(kind);
        for part in [name.as_bytes(), value] {
            bytes.extend_from_slice(&(part.len() as u64).to_le_bytes());
            bytes.extend_from_slice(part);
        }
    }

    /// Returns the header if this is one for that server.
    pub(super) fn header_for(&self, origin: &str) -> Option<(HeaderName, HeaderValue)> {
        match &self.kind {
            Kind::Header(name, value) if self.origin == origin => Some((name.clone(), value.clone())),
            Kind::Token(token) if self.origin == origin => Some((AUTHORIZATION, token.header())),
            _ => None,
        }
    }

    /// Returns the token if this is one for that server.
    pub(super) fn token_for(&self, origin: &str) -> Option<&Arc<ExpiringToken>> {
        match &self.kind {
            Kind::Token(token) if self.origin == origin => Some(token),
            _ => None,
        }
    }

    /// Returns the query parameter if this is one for that server.
    pub(super) fn query_for(&self, origin: &str) -> Option<(&str, &str)> {
        match &self.kind {
            Kind::Query(name, value) if self.origin == origin => Some((name, value)),
            _ => None,
        }
    }
}

impl fmt::Debug for Credential {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = match &self.kind {
            Kind::Header(name, _) => name.as_str(),
            Kind::Query(name, _) => name,
            Kind::Token(_) => AUTHORIZATION.as_str(),
        };
        f.debug_struct("Credential").field("origin", &self.origin).field("name", &name).finish_non_exhaustive()
    }
}

/// An option of object stores under the name that the crate `object_store` gives it: `aws_endpoint`, `aws_access_key_id`,
/// `google_service_account_path`, `azure_storage_account_name` and so on. Its value never appears in errors, logs or debug
/// output.
#[derive(Clone, PartialEq)]
pub struct StoreOption {
    name: String,
    value: String,
}

impl StoreOption {
    /// Creates an option for the stores that the name begins with: `aws_`, `google_` or `azure_`. An unknown name makes the
    /// first request fail.
    pub fn new(name: &str, value: &str) -> Self {
        Self { name: name.to_ascii_lowercase(), value: value.to_owned() }
    }

    /// Returns the name in lower case.
    #[cfg(feature = "object-store")]
    pub(in crate::fetch) fn name(&self) -> &str {
        &self.name
    }

    #[cfg(feature = "object-store")]
    pub(in crate::fetch) fn value(&self) -> &str {
        &self.value
    }
}

impl fmt::Debug for StoreOption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("StoreOption").field("name", &self.name).finish_non_exhaustive()
    }
}

fn origin(url: &str) -> Result<String, IoError> {
    let bad = |reason: String| IoError::Uri { uri: url.to_owned(), reason };
    let parsed = Url::parse(url).map_err(|e| bad(e.to_string()))?;
    if !matches!(parsed.scheme(), "http" | "https") {
        return Err(bad("credentials are for http and https".to_owned()));
    }
    Ok(parsed.origin().ascii_serialization())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_never_printed() {
        let config = HttpConfig {
            credentials: vec![
                Credential::header("https://h/a", "authorization", "Bearer hidden1").unwrap(),
                Credential::query("https://h/a", "key", "hidden2").unwrap(),
            ],
            store_options: vec![StoreOption::new("aws_secret_access_key", "hidden4")],
            ..HttpConfig::default()
        };
        let text = format!("{config:?}");
        assert!(text.contains("authorization") && !text.contains("hidden"), "{text}");
        let error = Credential::header("https://h/", "x-key", "hidden\n3").unwrap_err();
        assert!(!error.to_string().contains("hidden"), "{error}");
        assert!(Credential::query("file:///a", "key", "x").is_err());
    }
}
