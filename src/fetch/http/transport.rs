//! [`Transport`]: sends requests with retries and respects the pauses that servers ask for. HTTP thread.

use std::sync::Arc;

use reqwest::header::HeaderMap;

use super::config::HttpConfig;
use super::cookies::Cookies;
use super::dns::DnsResolver;
use super::exchange::{Answer, Exchange, error_chain_without_url, origin};
use super::retry_policy::{Backoff, Pause, Pauses};
use super::tls;
#[cfg(feature = "object-store")]
use crate::fetch::object_store::Stores;
use crate::fetch::{IoError, Limits, is_store, server};

/// The connection pool and the state per server that all requests of a client share.
#[derive(Debug)]
pub(in crate::fetch) struct Transport {
    client: reqwest::Client,
    config: HttpConfig,
    pauses: Pauses,
    #[cfg(feature = "object-store")]
    stores: Stores,
}

impl Transport {
    /// Fails if a certificate file is invalid or TLS cannot be initialized.
    pub fn new(config: &HttpConfig) -> Result<Self, IoError> {
        // A second installation is refused, which is harmless: the provider is the same.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let mut builder = reqwest::Client::builder()
            .connect_timeout(config.connect_timeout)
            .user_agent(concat!("terrane/", env!("CARGO_PKG_VERSION")))
            // `Exchange` follows redirects, since it knows which credential belongs to which server.
            .redirect(reqwest::redirect::Policy::none())
            .referer(false)
            .cookie_provider(Arc::new(Cookies::default()))
            .dns_resolver(DnsResolver::default())
            .http2_adaptive_window(true);
        builder = builder.tls_certs_merge(tls::root_certificates(&config.root_certificates)?);
        if config.http2_only {
            builder = builder.http2_prior_knowledge();
        }
        let failed = |e| IoError::Network { uri: String::new(), reason: error_chain_without_url(e) };
        Ok(Self {
            client: builder.build().map_err(failed)?,
            config: config.clone(),
            pauses: Pauses::default(),
            #[cfg(feature = "object-store")]
            stores: Stores::new(),
        })
    }

    pub fn config(&self) -> &HttpConfig {
        &self.config
    }

    /// Requests a URI until it succeeds, fails permanently, or the retries are used up. `validated_at` is the URL, after
    /// redirects, that validators in `headers` belong to; `None` means `uri` itself.
    pub async fn exchange(
        &self,
        uri: &str,
        headers: &HeaderMap,
        validated_at: Option<&str>,
        limits: &Limits,
    ) -> Result<Answer, IoError> {
        let Self { client, config, pauses, .. } = self;
        let mut backoff = Backoff::new(config.retry_backoff, config.max_wait, config.seed, uri);
        let server = match is_store(uri) {
            true => server(uri).to_owned(),
            false => origin(uri)?,
        };
        let mut retries_left = config.max_retries;
        loop {
            // An answer to another request may have asked for a pause, also while this one waited.
            while let Some(Pause { status, left }) = pauses.of(&server) {
                if left > config.max_wait {
                    return Err(IoError::Status { uri: uri.to_owned(), status, retry_after: Some(left) });
                }
                tokio::time::sleep(left + backoff.stagger()).await;
            }
            let exchange = Exchange { client, config, limits, headers, validated_at, received: Arc::default() };
            let error = match exchange.in_time(uri, self.send_once(uri, &exchange)).await {
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
            if !error.is_transient() || retries_left == 0 {
                return Err(error);
            }
            retries_left -= 1;
            match backoff.wait(error.retry_after()) {
                Some(wait) => tokio::time::sleep(wait).await,
                None => return Err(error),
            }
        }
    }

    async fn send_once(&self, uri: &str, exchange: &Exchange<'_>) -> Result<Answer, IoError> {
        if !is_store(uri) {
            return exchange.run(uri, &self.pauses).await;
        }
        #[cfg(feature = "object-store")]
        return self.stores.get(uri, exchange).await;
        #[cfg(not(feature = "object-store"))]
        Err(IoError::unsupported(uri, "an object store (built without the feature)"))
    }
}
