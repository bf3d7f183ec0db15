//! How servers are talked to, and what is shown to them alone.

use std::fmt;
use std::path::PathBuf;
use std::time::Duration;

use reqwest::header::{HeaderName, HeaderValue};
use url::Url;

use crate::io::{CacheConfig, IoError};

/// How servers are talked to. Proxies come from the environment (`http_proxy`, `https_proxy`, `no_proxy`).
#[derive(Clone, Debug, PartialEq)]
pub struct HttpConfig {
    /// Until a connection stands.
    pub connect_timeout: Duration,
    /// Until the answer's head is there, connecting included.
    pub first_byte_timeout: Duration,
    /// Between two pieces of the body.
    pub read_timeout: Duration,
    /// For the whole answer, redirects included; longer by what its bytes take at [`Self::min_bytes_per_s`].
    pub total_timeout: Duration,
    /// A slow line is given the time for what is large: an answer may go on for as long as the bytes that came would
    /// take at this rate. 0: as long as [`Self::read_timeout`] holds.
    pub min_bytes_per_s: u32,
    /// Tries after the first, for failures that may pass.
    pub max_retries: u32,
    /// Wait before the first retry; doubled each time, and half of it by chance, so that many clients do not come back
    /// at once.
    pub retry_backoff: Duration,
    /// Longest wait before a retry. A server that asks for more (`Retry-After`) is not asked again here; the error says
    /// when it may be.
    pub max_wait: Duration,
    /// Chance in the waits is the same for the same seed and URI.
    pub seed: u64,
    /// Speak HTTP/2 without asking whether the server does, for open connections; encrypted ones agree on it.
    pub http2_only: bool,
    /// PEM files of authorities to trust besides the system's. Where the system's are, `SSL_CERT_FILE` and `SSL_CERT_DIR`
    /// say on Linux.
    pub root_certificates: Vec<PathBuf>,
    /// Shown to the servers that they are for.
    pub credentials: Vec<Credential>,
    /// For object stores, before what the environment says (`AWS_*`, `GOOGLE_*`, `AZURE_*`). Without keys in either,
    /// requests go unsigned. The metadata service of a cloud is asked for keys only where it is named
    /// (`AWS_METADATA_ENDPOINT`, `GCE_METADATA_HOST`, `AZURE_MSI_ENDPOINT`) or `*_skip_signature` is said to be false.
    pub store_options: Vec<StoreOption>,
    /// Keeps what came on disk.
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
            store_options: Vec::new(),
            cache: None,
        }
    }
}

/// A header or a query parameter that one server gets with every request, also after a redirect to it, and no other.
/// Its value is in no error, log, cache file or debug output.
#[derive(Clone, PartialEq)]
pub struct Credential {
    /// Scheme, name and port.
    origin: String,
    kind: Kind,
}

#[derive(Clone, PartialEq)]
enum Kind {
    Header(HeaderName, HeaderValue),
    Query(String, String),
}

impl Credential {
    /// A header, as `authorization` with `Bearer …`, for the server of `url`.
    pub fn header(url: &str, name: &str, value: &str) -> Result<Self, IoError> {
        let bad = |what: &str| IoError::Uri { uri: name.to_owned(), reason: format!("is no {what} of a header") };
        let name = HeaderName::from_bytes(name.as_bytes()).map_err(|_| bad("name"))?;
        let mut value = HeaderValue::from_str(value).map_err(|_| bad("value"))?;
        value.set_sensitive(true);
        Ok(Self { origin: origin(url)?, kind: Kind::Header(name, value) })
    }

    /// A query parameter, as `key` or `access_token`, for the server of `url`.
    pub fn query(url: &str, name: &str, value: &str) -> Result<Self, IoError> {
        Ok(Self { origin: origin(url)?, kind: Kind::Query(name.to_owned(), value.to_owned()) })
    }

    /// The header, where this is one for that server.
    pub(super) fn header_for(&self, origin: &str) -> Option<(&HeaderName, &HeaderValue)> {
        match &self.kind {
            Kind::Header(name, value) if self.origin == origin => Some((name, value)),
            _ => None,
        }
    }

    /// The query parameter, where this is one for that server.
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
        };
        f.debug_struct("Credential").field("origin", &self.origin).field("name", &name).finish_non_exhaustive()
    }
}

/// An option of object stores under the name that `object_store` gives it, as `aws_endpoint`, `aws_access_key_id`,
/// `google_service_account_path` or `azure_storage_account_name`. Its value is in no error, log or debug output.
#[derive(Clone, PartialEq)]
pub struct StoreOption {
    pub(super) name: String,
    pub(super) value: String,
}

impl StoreOption {
    /// For the stores that the name begins with: `aws_`, `google_` or `azure_`. A name that they do not know is an error of the
    /// first request.
    pub fn new(name: &str, value: &str) -> Self {
        Self { name: name.to_ascii_lowercase(), value: value.to_owned() }
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
