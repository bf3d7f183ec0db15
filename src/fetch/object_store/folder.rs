//! [`ObjectFolder`]: writes, reads, lists and removes the objects below a prefix of a bucket. Called by programs that make
//! sets, on any of their threads, which block; never by the pager.

use std::io::{Read as _, Write as _};
use std::path::Path as FilePath;
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use object_store::client::{
    ClientConfigKey, HttpClient as StoreClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse,
    HttpService,
};
use object_store::path::Path;
use object_store::{
    Attribute, Attributes, BackoffConfig, ClientOptions, Error, MultipartUpload, ObjectStore, ObjectStoreExt as _,
    PutMultipartOptions, PutOptions, RetryConfig,
};
use tokio::task::JoinSet;

use super::config;
use crate::fetch::http::{Connections, error_chain, runtime};
use crate::fetch::percent_decode;
use crate::fetch::{HttpClient, HttpConfig, IoError, StoreOption, is_store, server};

/// Larger files are written in parts of at least this size.
const MIN_PART_BYTES: u64 = 16 << 20;
/// S3 allows 10,000 parts.
const MAX_PARTS: u64 = 9_000;
/// The parts of a file that are in flight.
const MAX_PARTS_IN_FLIGHT: usize = 4;
/// The maximum size of an answer: a list of 1000 objects, or an error.
const MAX_ANSWER_BYTES: usize = 16 << 20;
/// The number of retries after a failure that may pass.
const MAX_RETRIES: usize = 8;
/// No retry begins after this time. Keys and tokens may expire later.
const RETRY_TIMEOUT: Duration = Duration::from_secs(180);

/// Writes, reads, lists and removes the objects below a prefix of a bucket. Several threads may call it at the same time; each
/// blocks until its request is done. Requests that fail for a reason that may pass are sent again.
#[derive(Debug)]
pub struct ObjectFolder {
    /// Threads that wait for an answer take turns in driving it. `None` while it is dropped.
    runtime: Option<tokio::runtime::Runtime>,
    store: Arc<dyn ObjectStore>,
    /// Without a slash at the end.
    uri: String,
    prefix: Path,
}

/// The headers that a store sends with the content of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObjectHeaders {
    /// The media type.
    pub content_type: &'static str,
    /// True if the content is compressed with gzip, and clients shall decompress it.
    pub is_gzip: bool,
}

/// The objects and the folders directly in a folder, by their names in it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ObjectList {
    /// The names of the objects.
    pub objects: Vec<String>,
    /// The size of each object in bytes.
    pub sizes: Vec<u64>,
    /// The names of the folders.
    pub folders: Vec<String>,
}

impl ObjectFolder {
    /// Opens a folder, such as `s3://bucket/prefix`; sends no request. [`HttpConfig::store_options`] and the environment have
    /// the keys.
    ///
    /// # Errors
    /// Fails if the URI is not one of a bucket, or if the configuration is invalid.
    pub fn open(uri: &str, config: &HttpConfig) -> Result<Self, IoError> {
        let bad = |reason: &str| IoError::Uri { uri: uri.to_owned(), reason: reason.to_owned() };
        let uri = uri.trim_end_matches('/');
        let bucket = server(uri);
        let is_named = bucket.split_once("://").is_some_and(|(_, name)| !name.is_empty());
        if !is_store(uri) || !is_named || uri.contains(['?', '#']) {
            return Err(bad("expected the address of a bucket, such as s3://bucket/folder"));
        }
        let key = percent_decode(&uri[bucket.len()..]).ok_or_else(|| bad("bad percent escape"))?;
        let prefix = Path::parse(key).map_err(|e| bad(&e.to_string()))?;
        let client = HttpClient::new(config)?;
        let connector = Connector {
            connections: client.transport().connections().clone(),
            config: Arc::new(config.clone()),
            allows_http: false,
        };
        let retry = RetryConfig {
            max_retries: MAX_RETRIES,
            retry_timeout: RETRY_TIMEOUT,
            backoff: BackoffConfig { init_backoff: config.retry_backoff, max_backoff: config.max_wait, base: 2.0 },
        };
        // All stores know the request that removes one object.
        let mut options = vec![StoreOption::new("aws_disable_bulk_delete", "true")];
        options.extend(config.store_options.iter().cloned());
        let store = config::store(bucket, &options, retry, connector).map_err(|e| bad(&error_chain(&e)))?;
        let runtime = runtime("objects").map_err(|e| bad(&e.to_string()))?;
        Ok(Self { runtime: Some(runtime), store, uri: uri.to_owned(), prefix })
    }

    /// Returns the address of the folder, or of an object in it.
    pub fn uri(&self, name: &str) -> String {
        if name.is_empty() { self.uri.clone() } else { format!("{}/{name}", self.uri) }
    }

    /// Writes an object, and replaces the one of that name.
    pub fn write(&self, name: &str, bytes: Vec<u8>, headers: ObjectHeaders) -> Result<(), IoError> {
        let key = self.key(name)?;
        let options = PutOptions { attributes: headers.attributes(), ..PutOptions::default() };
        self.block_on(name, async { self.store.put_opts(&key, bytes.into(), options).await.map(|_| ()) })
    }

    /// Writes a file as an object, in parts if it is large: at most four are in memory. Returns its size in bytes.
    pub fn write_file(&self, name: &str, file: &FilePath, headers: ObjectHeaders) -> Result<u64, IoError> {
        let path = file.to_string_lossy();
        let of_file = |e: std::io::Error| IoError::of_file(&path, &e);
        let mut input = std::fs::File::open(file).map_err(of_file)?;
        let size = input.metadata().map_err(of_file)?.len();
        let part_bytes = MIN_PART_BYTES.max(size.div_ceil(MAX_PARTS));
        if size <= part_bytes {
            let mut bytes = Vec::new();
            input.read_to_end(&mut bytes).map_err(of_file)?;
            self.write(name, bytes, headers)?;
            return Ok(size);
        }
        let key = self.key(name)?;
        let options = PutMultipartOptions { attributes: headers.attributes(), ..PutMultipartOptions::default() };
        let mut upload = self.block_on(name, self.store.put_multipart_opts(&key, options))?;
        let mut parts = JoinSet::new();
        let mut sent = || -> Result<(), IoError> {
            loop {
                let mut bytes = Vec::new();
                (&mut input).take(part_bytes).read_to_end(&mut bytes).map_err(of_file)?;
                let is_last = bytes.is_empty();
                if !is_last {
                    let part = upload.put_part(bytes.into());
                    self.block_on(name, async {
                        parts.spawn(part);
                        Ok(())
                    })?;
                }
                while parts.len() >= if is_last { 1 } else { MAX_PARTS_IN_FLIGHT } {
                    self.block_on(name, async {
                        match parts.join_next().await {
                            Some(part) => part?,
                            None => Ok(()),
                        }
                    })?;
                }
                if is_last {
                    return self.block_on(name, upload.complete()).map(|_| ());
                }
            }
        };
        let sent = sent();
        if sent.is_err() {
            // The store removes the parts. If it does not answer either, its rules for unfinished uploads do. Parts in
            // flight end first: a store may keep a part that arrives after the request to remove them.
            let _ = self.block_on(name, async {
                while parts.join_next().await.is_some() {}
                MultipartUpload::abort(&mut *upload).await
            });
        }
        sent.map(|()| size)
    }

    /// Returns the bytes of an object.
    pub fn read(&self, name: &str) -> Result<Vec<u8>, IoError> {
        let key = self.key(name)?;
        self.block_on(name, async { Ok(self.store.get(&key).await?.bytes().await?.to_vec()) })
    }

    /// Writes an object to a file, in parts if it is large: one is in memory. The file has its name only when it is complete.
    pub fn read_file(&self, name: &str, file: &FilePath) -> Result<(), IoError> {
        let path = file.to_string_lossy();
        let of_file = |e: std::io::Error| IoError::of_file(&path, &e);
        let key = self.key(name)?;
        let (size, whole) = self.block_on(name, async {
            let found = self.store.get(&key).await?;
            let size = found.meta.size;
            let whole = if size <= MIN_PART_BYTES { Some(found.bytes().await?) } else { None };
            Ok((size, whole))
        })?;
        let mut unfinished = file.as_os_str().to_owned();
        unfinished.push(".unfinished");
        let mut output = std::fs::File::create(&unfinished).map_err(of_file)?;
        let mut at = 0;
        if let Some(whole) = &whole {
            output.write_all(whole).map_err(of_file)?;
            at = size;
        }
        while at < size {
            let end = size.min(at + MIN_PART_BYTES);
            let part = self.block_on(name, self.store.get_range(&key, at..end))?;
            output.write_all(&part).map_err(of_file)?;
            at = end;
        }
        std::fs::rename(&unfinished, file).map_err(of_file)
    }

    /// Returns true if there is an object of that name.
    pub fn has(&self, name: &str) -> Result<bool, IoError> {
        let key = self.key(name)?;
        match self.block_on(name, self.store.head(&key)) {
            Ok(_) => Ok(true),
            Err(IoError::NotFound { .. }) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Removes an object. It need not exist.
    pub fn remove(&self, name: &str) -> Result<(), IoError> {
        let key = self.key(name)?;
        match self.block_on(name, self.store.delete(&key)) {
            Err(IoError::NotFound { .. }) => Ok(()),
            done => done,
        }
    }

    /// Returns the objects and the folders directly in a folder, `""` for this one, in order.
    pub fn list(&self, folder: &str) -> Result<ObjectList, IoError> {
        let key = self.key(folder)?;
        let at = (!key.as_ref().is_empty()).then_some(&key);
        let found = self.block_on(folder, self.store.list_with_delimiter(at))?;
        let name = |path: &Path| path.filename().map(str::to_owned);
        let mut objects: Vec<(String, u64)> =
            found.objects.iter().filter_map(|object| Some((name(&object.location)?, object.size))).collect();
        objects.sort();
        let (objects, sizes) = objects.into_iter().unzip();
        let mut folders: Vec<String> = found.common_prefixes.iter().filter_map(name).collect();
        folders.sort();
        Ok(ObjectList { objects, sizes, folders })
    }

    fn key(&self, name: &str) -> Result<Path, IoError> {
        let below = Path::parse(name).map_err(|e| IoError::Uri { uri: self.uri(name), reason: e.to_string() })?;
        Ok(self.prefix.parts().chain(below.parts()).collect())
    }

    fn block_on<T>(&self, name: &str, answer: impl Future<Output = Result<T, Error>>) -> Result<T, IoError> {
        let uri = self.uri(name);
        match &self.runtime {
            Some(runtime) => runtime.block_on(answer).map_err(|e| io_error(uri, &e)),
            None => Err(IoError::Network { uri, reason: "the client is being dropped".to_owned() }),
        }
    }
}

impl Drop for ObjectFolder {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

impl ObjectHeaders {
    fn attributes(self) -> Attributes {
        let mut attributes = Attributes::from_iter([(Attribute::ContentType, self.content_type)]);
        if self.is_gzip {
            attributes.insert(Attribute::ContentEncoding, "gzip".into());
        }
        attributes
    }
}

/// Returns the error of a request. The code and the message of the store say more than its status.
fn io_error(uri: String, error: &Error) -> IoError {
    let chain = error_chain(error);
    let inside = |tag: &str| {
        let (_, rest) = chain.split_once(&format!("<{tag}>"))?;
        rest.split_once(&format!("</{tag}>")).map(|(text, _)| text.trim())
    };
    let said = match (inside("Code"), inside("Message")) {
        (Some(code), Some(message)) => format!(" ({code}: {message})"),
        (Some(code), None) => format!(" ({code})"),
        _ => String::new(),
    };
    match error {
        Error::NotFound { .. } if said.is_empty() || inside("Code") == Some("NoSuchKey") => IoError::NotFound { uri },
        Error::NotFound { .. } => IoError::Refused { uri, reason: format!("the store answers 404{said}") },
        Error::PermissionDenied { .. } => IoError::Refused { uri, reason: format!("the store refuses access{said}") },
        Error::Unauthenticated { .. } => {
            IoError::Refused { uri, reason: format!("the store does not accept the keys{said}") }
        }
        Error::NotSupported { .. } | Error::NotImplemented { .. } => {
            IoError::unsupported(&uri, "this kind of request to the store")
        }
        // The store or the network does not answer as it should: a retry may succeed.
        _ => IoError::Network { uri, reason: chain.split_whitespace().collect::<Vec<_>>().join(" ") },
    }
}

/// Sends the requests that `object_store` has signed, and hands it the whole answers. It retries them.
#[derive(Clone, Debug)]
struct Connector {
    connections: Arc<Connections>,
    config: Arc<HttpConfig>,
    /// Permits unencrypted connections (`AWS_ALLOW_HTTP`, or a token service on this machine).
    allows_http: bool,
}

impl HttpConnector for Connector {
    fn connect(&self, options: &ClientOptions) -> object_store::Result<StoreClient> {
        let allowed = options.get_config_value(&ClientConfigKey::AllowHttp);
        let allows_http = allowed.is_some_and(|text| text.eq_ignore_ascii_case("true"));
        Ok(StoreClient::new(Self { allows_http, ..self.clone() }))
    }
}

#[async_trait]
impl HttpService for Connector {
    async fn call(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let (parts, body) = request.into_parts();
        let uri = parts.uri.to_string();
        if !self.allows_http && parts.uri.scheme_str() != Some("https") {
            let reason = "an unencrypted connection to an object store, which is not allowed (ALLOW_HTTP)".to_owned();
            return Err(HttpError::new(HttpErrorKind::Unknown, IoError::Uri { uri: server(&uri).to_owned(), reason }));
        }
        let client = self.connections.to_any(&uri).map_err(|e| HttpError::new(HttpErrorKind::Unknown, e))?;
        let bytes = body.content_length() as u64;
        let request = client.request(parts.method, uri.as_str()).headers(parts.headers);
        let request = if bytes > 0 { request.body(reqwest::Body::wrap(body)) } else { request };
        let answer = async {
            let mut response = request.send().await.map_err(failed)?;
            let mut answer = HttpResponse::new(Vec::new().into());
            (*answer.status_mut(), *answer.headers_mut()) = (response.status(), response.headers().clone());
            let mut content = Vec::new();
            while let Some(chunk) = response.chunk().await.map_err(failed)? {
                if content.len() + chunk.len() > MAX_ANSWER_BYTES {
                    let error = std::io::Error::other("the answer of the store is too large");
                    return Err(HttpError::new(HttpErrorKind::Decode, error));
                }
                content.extend_from_slice(&chunk);
            }
            *answer.body_mut() = content.into();
            Ok(answer)
        };
        let limit = self.config.total_timeout
            + Duration::from_secs(bytes.checked_div(self.config.min_bytes_per_s.into()).unwrap_or_default());
        match tokio::time::timeout(limit, answer).await {
            Ok(answer) => answer,
            Err(elapsed) => Err(HttpError::new(HttpErrorKind::Timeout, elapsed)),
        }
    }
}

/// Returns the error of a request that was not answered, of a kind that is retried.
fn failed(error: reqwest::Error) -> HttpError {
    let kind = match error.is_connect() {
        true => HttpErrorKind::Connect,
        false => HttpErrorKind::Interrupted,
    };
    HttpError::new(kind, error.without_url())
}
