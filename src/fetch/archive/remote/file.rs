//! [`RemoteFiles`]: parts of any file on a server or in an object store, for threads that may block.

use std::sync::Arc;

use reqwest::header::LAST_MODIFIED;

use super::identity::RemoteIdentity;
use super::part::{Part, PartReader, range_of};
use crate::fetch::archive::span::Span;
use crate::fetch::http::runtime;
use crate::fetch::{HttpClient, HttpConfig, IoError, Limits};

/// The bytes that are read when a file is opened. They hold the header of most files.
const HEAD_BYTES: u64 = 16 << 10;

/// Opens files on servers (http, https) and in object stores. The user names their addresses, so that any host is reached;
/// redirects lead to public addresses only, unless [`HttpConfig::allowed_hosts`] has the host.
#[derive(Debug)]
pub struct RemoteFiles {
    /// Threads that wait for an answer take turns in driving it. `None` while it is dropped.
    runtime: Option<tokio::runtime::Runtime>,
    client: HttpClient,
}

/// A file on a server, whose parts are read by range requests. Several threads may read at the same time; each blocks until
/// its answer has arrived.
#[derive(Debug)]
pub struct RemoteFile {
    files: Arc<RemoteFiles>,
    uri: String,
    identity: RemoteIdentity,
    modified: Option<String>,
    bytes: u64,
    /// The first bytes, or all bytes of a small file on a server without range requests.
    head: Vec<u8>,
}

impl RemoteFiles {
    /// Creates a client.
    ///
    /// # Errors
    /// Fails if TLS cannot be initialized or a certificate file is invalid.
    pub fn new(config: &HttpConfig) -> Result<Self, IoError> {
        let failed = |e: std::io::Error| IoError::Network { uri: String::new(), reason: e.to_string() };
        Ok(Self { client: HttpClient::new(config)?, runtime: Some(runtime("files").map_err(failed)?) })
    }

    /// Opens a file and reads its first bytes.
    pub fn open(self: &Arc<Self>, uri: &str) -> Result<RemoteFile, IoError> {
        let first = self.block_on(uri, async {
            let limits = Limits::default();
            let reader = PartReader::new(self.client.transport(), uri, &limits);
            reader.read(&range_of(Span { offset: 0, size: HEAD_BYTES }), &limits).await
        })?;
        if first.offset != 0 || first.bytes.is_empty() {
            return Err(IoError::invalid(uri, "another part of the file than was asked for"));
        }
        let (identity, modified, bytes) = (RemoteIdentity::of(&first), modified(&first), first.file_bytes);
        Ok(RemoteFile { files: self.clone(), uri: uri.to_owned(), identity, modified, bytes, head: first.bytes })
    }

    /// Returns the decompressed content of a URI, as [`HttpClient::get`] does: also of a file inside an archive.
    pub fn get(&self, uri: &str) -> Result<Vec<u8>, IoError> {
        self.block_on(uri, async { Ok(self.client.get(uri, &Limits::default()).await?.bytes) })
    }

    fn block_on<T>(&self, uri: &str, answer: impl Future<Output = Result<T, IoError>>) -> Result<T, IoError> {
        match &self.runtime {
            Some(runtime) => runtime.block_on(answer),
            None => Err(IoError::Network { uri: uri.to_owned(), reason: "the client is being dropped".to_owned() }),
        }
    }
}

impl Drop for RemoteFiles {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

impl RemoteFile {
    /// Returns the length of the file in bytes.
    pub fn size(&self) -> u64 {
        self.bytes
    }

    /// Returns the first bytes, at most 16 KiB of a larger file.
    pub fn head(&self) -> &[u8] {
        &self.head
    }

    /// Returns what tells versions of the file apart: its length, and its entity tag and time as far as the server names them.
    pub fn version(&self) -> String {
        let parts = [self.identity.etag(), self.modified.as_deref()].map(Option::unwrap_or_default);
        format!("{} {} {}", self.bytes, parts[0], parts[1])
    }

    /// Reads a part of the file.
    ///
    /// # Errors
    /// [`IoError::Invalid`] if the part ends beyond the file, or if the file has changed since it was opened.
    pub fn read(&self, offset: u64, size: usize) -> Result<Vec<u8>, IoError> {
        let span = Span { offset, size: size as u64 };
        if span.end().is_none_or(|end| end > self.bytes) {
            let reason = format!("{size} bytes at {offset}, but the file has {}", self.bytes);
            return Err(IoError::invalid(&self.uri, reason));
        }
        if size == 0 {
            return Ok(Vec::new());
        }
        if let Some(bytes) = span.slice_of(&self.head, 0) {
            return Ok(bytes.to_vec());
        }
        let read = self.files.block_on(&self.uri, async {
            let limits = Limits { max_file_bytes: span.size, ..Limits::default() };
            let reader = PartReader::new(self.files.client.transport(), &self.uri, &limits);
            self.identity.read(&reader, span).await
        });
        match read {
            Ok(part) if modified(&part) == self.modified => Ok(part.bytes),
            Err(error) if !self.identity.is_stale() => Err(error),
            _ => Err(IoError::invalid(
                &self.uri,
                "the file was changed while it was read; run again when it is complete",
            )),
        }
    }
}

/// Returns the time of the last change as the server wrote it.
fn modified(part: &Part) -> Option<String> {
    part.headers.get(LAST_MODIFIED).and_then(|v| v.to_str().ok()).map(str::to_owned)
}
