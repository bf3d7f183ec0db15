//! Bytes over HTTP: one client, many requests in flight, on the pager's HTTP thread (a tokio runtime of its own).

use std::time::Duration;

use super::{IoError, Limits, file};

/// How servers are talked to.
#[derive(Clone, Debug, PartialEq)]
pub struct HttpConfig {
    /// Until a connection stands.
    pub connect_timeout: Duration,
    /// Until the answer's head is there.
    pub first_byte_timeout: Duration,
    /// Between two pieces of the body.
    pub read_timeout: Duration,
    /// For the whole answer.
    pub total_timeout: Duration,
    /// Tries after the first, for failures that may pass.
    pub max_retries: u32,
    /// Wait before the first retry; doubled each time.
    pub retry_backoff: Duration,
}

impl Default for HttpConfig {
    fn default() -> Self {
        Self {
            connect_timeout: Duration::from_secs(10),
            first_byte_timeout: Duration::from_secs(15),
            read_timeout: Duration::from_secs(15),
            total_timeout: Duration::from_secs(120),
            max_retries: 2,
            retry_backoff: Duration::from_millis(250),
        }
    }
}

/// Memory taken for an answer before its bytes come.
const MOST_RESERVED_BYTES: u64 = 1 << 20;
/// Most redirects of one request.
const MAX_REDIRECTS: usize = 8;

/// Never from an encrypted connection to an open one; other schemes than http and https the client refuses itself.
fn follow(attempt: reqwest::redirect::Attempt<'_>) -> reqwest::redirect::Action {
    let was_encrypted = attempt.previous().iter().any(|url| url.scheme() == "https");
    if was_encrypted && attempt.url().scheme() != "https" {
        let to = format!("redirected from https to {}", attempt.url());
        attempt.error(to)
    } else if attempt.previous().len() > MAX_REDIRECTS {
        attempt.error(format!("more than {MAX_REDIRECTS} redirects"))
    } else {
        attempt.follow()
    }
}

/// A client with its connection pool. Cheap to clone; used inside a tokio runtime.
#[derive(Clone, Debug)]
pub struct HttpClient {
    client: reqwest::Client,
    config: HttpConfig,
}

impl HttpClient {
    /// A client; fails when the TLS back end cannot be set up.
    pub fn new(config: &HttpConfig) -> Result<Self, IoError> {
        // A second install is refused and harmless: the provider is the same.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let client = reqwest::Client::builder()
            .connect_timeout(config.connect_timeout)
            .read_timeout(config.read_timeout)
            .timeout(config.total_timeout)
            .user_agent(concat!("terrane/", env!("CARGO_PKG_VERSION")))
            .redirect(reqwest::redirect::Policy::custom(follow))
            // A query may hold a token.
            .referer(false)
            .build()
            .map_err(|e| IoError::Network { uri: String::new(), reason: chain(&e) })?;
        Ok(Self { client, config: config.clone() })
    }

    /// The body of a URL, gzip undone. Retries what may pass, with growing waits.
    pub async fn get(&self, uri: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        let mut wait = self.config.retry_backoff;
        for attempt in 0.. {
            match self.get_once(uri, limits).await {
                Err(e) if e.is_transient() && attempt < self.config.max_retries => {
                    tokio::time::sleep(wait).await;
                    wait *= 2;
                }
                other => return other,
            }
        }
        unreachable!("the loop ends by its last attempt")
    }

    async fn get_once(&self, uri: &str, limits: &Limits) -> Result<Vec<u8>, IoError> {
        let start = std::time::Instant::now();
        let failed = |e: reqwest::Error| {
            let (phase, seconds) = if e.is_connect() {
                ("connecting", self.config.connect_timeout)
            } else if start.elapsed() >= self.config.total_timeout {
                ("the whole answer", self.config.total_timeout)
            } else {
                ("reading the answer", self.config.read_timeout)
            };
            if e.is_timeout() {
                return IoError::Timeout { uri: uri.to_owned(), phase, seconds: seconds.as_secs_f64() };
            }
            IoError::Network { uri: uri.to_owned(), reason: chain(&e) }
        };
        let head = tokio::time::timeout(self.config.first_byte_timeout, self.client.get(uri).send()).await;
        let mut response = head
            .map_err(|_| IoError::Timeout {
                uri: uri.to_owned(),
                phase: "waiting for the answer",
                seconds: self.config.first_byte_timeout.as_secs_f64(),
            })?
            .map_err(failed)?;
        match response.status().as_u16() {
            200..=299 => {}
            404 | 410 => return Err(IoError::NotFound { uri: uri.to_owned() }),
            status => return Err(IoError::Status { uri: uri.to_owned(), status }),
        }
        let too_large =
            |got: u64| IoError::TooLarge { uri: uri.to_owned(), what: "answer", got, limit: limits.max_file_bytes };
        if let Some(length) = response.content_length().filter(|l| *l > limits.max_file_bytes) {
            return Err(too_large(length));
        }
        // What a server announces is not believed beyond this.
        let announced = response.content_length().unwrap_or(0).min(MOST_RESERVED_BYTES);
        let mut bytes = Vec::with_capacity(announced as usize);
        while let Some(piece) = response.chunk().await.map_err(failed)? {
            if (bytes.len() + piece.len()) as u64 > limits.max_file_bytes {
                return Err(too_large((bytes.len() + piece.len()) as u64));
            }
            bytes.extend_from_slice(&piece);
        }
        file::gunzip(uri, bytes, limits)
    }
}

/// One request on the calling thread.
pub(crate) fn get_here(uri: &str, limits: &Limits, config: &HttpConfig) -> Result<Vec<u8>, IoError> {
    let client = HttpClient::new(config)?;
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|e| IoError::Network { uri: uri.to_owned(), reason: e.to_string() })?
        .block_on(client.get(uri, limits))
}

/// An error with its causes, in one line.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(e) = source {
        text.push_str(": ");
        text.push_str(&e.to_string());
        source = e.source();
    }
    text
}
