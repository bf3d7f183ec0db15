//! Reads any URI on the calling thread: for `terrane info` and for the roots of tile sets, never inside a frame.

use super::error::IoError;
use super::file::FileReader;
#[cfg(feature = "http")]
use super::http::{BlockingHttpClient, HttpConfig};
use super::limits::Limits;
use super::uri::is_remote;

/// Reads files, archives and servers. Keeps its connections open between reads.
#[derive(Debug)]
pub(crate) struct Source {
    files: FileReader,
    #[cfg(feature = "http")]
    limits: Limits,
    #[cfg(feature = "http")]
    config: HttpConfig,
    /// Created by the first read from a server.
    #[cfg(feature = "http")]
    http: std::cell::OnceCell<BlockingHttpClient>,
}

impl Source {
    pub fn new(limits: Limits) -> Self {
        Self {
            files: FileReader::new(limits),
            #[cfg(feature = "http")]
            limits,
            #[cfg(feature = "http")]
            config: HttpConfig::default(),
            #[cfg(feature = "http")]
            http: std::cell::OnceCell::new(),
        }
    }

    #[cfg(feature = "http")]
    pub fn with_http(limits: Limits, config: HttpConfig) -> Self {
        Self { config, ..Self::new(limits) }
    }

    /// Reads a URI; blocks until all bytes have arrived.
    pub fn read(&self, uri: &str) -> Result<Vec<u8>, IoError> {
        if !is_remote(uri) {
            return self.files.read(uri);
        }
        #[cfg(feature = "http")]
        {
            let http = match self.http.get() {
                Some(http) => http,
                None => {
                    let http = BlockingHttpClient::new(&self.config)?;
                    self.http.get_or_init(|| http)
                }
            };
            http.get(uri, &self.limits)
        }
        #[cfg(not(feature = "http"))]
        Err(IoError::unsupported(uri, "http (built without the feature)"))
    }

    /// Returns the size in bytes of a local file as stored.
    pub fn size(&self, uri: &str) -> Result<u64, IoError> {
        self.files.size(uri)
    }
}
