//! [`Transport`]: sends requests with retries and respects the pauses that servers ask for. HTTP thread.

use std::sync::Arc;

use reqwest::header::HeaderMap;
use url::Url;

use super::config::HttpConfig;
use super::exchange::{Answer, Exchange, origin};
use super::hosts::{Connections, DnsResolver};
use super::retry_policy::{Backoff, Pause, Pauses};
#[cfg(feature = "object-store")]
use crate::fetch::object_store::Stores;
use crate::fetch::{IoError, Limits, Permit, RootScope, is_store, server};

/// The number of answers of one request that may be lost with an HTTP/2 connection. They do not count as retries: whatever ends
/// the connection ends all answers on it, and most of them did not cause it.
const MAX_LOST_CONNECTIONS: u32 = 16;

/// The number of times that one request has an expired token renewed.
const MAX_RENEWALS: u32 = 2;
/// The maximum size of the answer with a new token.
const MAX_TOKEN_BYTES: u64 = 1 << 20;

/// Sends the requests of a tile set, or of an application that names each URI itself. Cheap to clone.
#[derive(Clone, Debug)]
pub(in crate::fetch) struct Transport {
    shared: Arc<Shared>,
    /// The tile set; `None` if the application names each URI. Its host then counts as that of a root.
    scope: Option<RootScope>,
    /// Holds the bytes of the answers.
    permit: Permit,
}

/// The connections and the state per server that all requests of a client share.
#[derive(Debug)]
struct Shared {
    connections: Arc<Connections>,
    config: HttpConfig,
    pauses: Pauses,
    #[cfg(feature = "object-store")]
    stores: Stores,
}

impl Transport {
    /// Fails if a certificate file is invalid or TLS cannot be initialized.
    pub(super) fn new(config: &HttpConfig, dns: DnsResolver) -> Result<Self, IoError> {
        let shared = Shared {
            connections: Arc::new(Connections::new(config, dns)?),
            config: config.clone(),
            pauses: Pauses::default(),
            #[cfg(feature = "object-store")]
            stores: Stores::new(),
        };
        Ok(Self { shared: Arc::new(shared), scope: None, permit: Permit::unlimited() })
    }

    /// Returns a transport over the same connections for the requests of a tile set.
    pub fn within(&self, scope: &RootScope) -> Self {
        Self { scope: Some(scope.clone()), ..self.clone() }
    }

    /// Returns a transport over the same connections whose answers claim their bytes from a permit.
    pub(super) fn holding(&self, permit: &Permit) -> Self {
        Self { permit: permit.clone(), ..self.clone() }
    }

    /// Returns the permit that holds the bytes of the answers.
    pub fn permit(&self) -> &Permit {
        &self.permit
    }

    /// Returns the tile set; `None` if the application names each URI.
    pub(super) fn scope(&self) -> Option<&RootScope> {
        self.scope.as_ref()
    }

    /// Returns a URL of the server of the root, for a request for `uri`.
    fn root(&self, uri: &str) -> Option<Url> {
        match &self.scope {
            None => Url::parse(uri).ok(),
            Some(RootScope::Server(origin)) => Url::parse(origin).ok(),
            Some(_) => None,
        }
    }

    pub fn config(&self) -> &HttpConfig {
        &self.shared.config
    }

    /// Returns the connections.
    #[cfg(feature = "object-store")]
    pub fn connections(&self) -> &Arc<Connections> {
        &self.shared.connections
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
        let Shared { connections, config, pauses, .. } = &*self.shared;
        let mut backoff = Backoff::new(config.retry_backoff, config.max_wait, config.seed, uri);
        let server = match is_store(uri) {
            true => server(uri).to_owned(),
            false => origin(uri)?,
        };
        let (mut retries_left, mut lost_left) = (config.max_retries, MAX_LOST_CONNECTIONS);
        // Its own endpoint may be on the same server. A refusal there ends the renewal that waits for it.
        let token = config.credentials.iter().find_map(|credential| credential.token_for(&server));
        let token = token.filter(|token| token.endpoint() != uri);
        let mut renewals_left = MAX_RENEWALS;
        loop {
            // An answer to another request may have asked for a pause, also while this one waited.
            while let Some(Pause { status, left }) = pauses.of(&server) {
                if left > config.max_wait {
                    return Err(IoError::Status { uri: uri.to_owned(), status, retry_after: Some(left) });
                }
                tokio::time::sleep(left + backoff.stagger()).await;
            }
            let token_number = token.map(|token| token.number());
            let (root, progress, permit) = (self.root(uri), Arc::default(), &self.permit);
            let exchange = Exchange { connections, root, config, limits, permit, headers, validated_at, progress };
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
            if let (Some(token), Some(refused), IoError::Status { status: 401, .. }) = (token, token_number, &error)
                && renewals_left > 0
            {
                renewals_left -= 1;
                // The application names the address that issues tokens, whatever the set may reach.
                let any = Self { scope: None, permit: Permit::unlimited(), ..self.clone() };
                let renewed = token.renew(refused, async |endpoint| any.renewed(endpoint).await).await;
                match renewed {
                    Ok(()) => continue,
                    Err(error) => return Err(error),
                }
            }
            if config.max_retries > 0 && lost_left > 0 && exchange.progress.is_connection_lost() {
                lost_left -= 1;
                tokio::time::sleep(backoff.stagger()).await;
                continue;
            }
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

    /// Requests a new token from the address that issues it.
    async fn renewed(&self, endpoint: &str) -> Result<Vec<u8>, IoError> {
        let limits = Limits { max_file_bytes: MAX_TOKEN_BYTES, ..Limits::default() };
        let answer = Box::pin(self.exchange(endpoint, &HeaderMap::new(), None, &limits)).await?;
        Ok(answer.body)
    }

    async fn send_once(&self, uri: &str, exchange: &Exchange<'_>) -> Result<Answer, IoError> {
        if !is_store(uri) {
            return exchange.run(uri, &self.shared.pauses).await;
        }
        #[cfg(feature = "object-store")]
        return self.shared.stores.get(uri, exchange).await;
        #[cfg(not(feature = "object-store"))]
        Err(IoError::unsupported(uri, "an object store (built without the feature)"))
    }
}
