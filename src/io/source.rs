//! Bytes of any URI on the calling thread, for what is no frame: `terrane info`, roots.

use super::{FileReader, IoError, Limits, is_remote};
#[cfg(feature = "http")]
use super::{HttpConfig, HttpHere};

/// Reads files and archives, and asks servers over connections that it keeps.
#[derive(Debug)]
pub(crate) struct Source {
    files: FileReader,
    #[cfg(feature = "http")]
    limits: Limits,
    #[cfg(feature = "http")]
    config: HttpConfig,
    /// Made when it is first needed.
    #[cfg(feature = "http")]
    http: std::cell::OnceCell<HttpHere>,
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

    /// Waits for the bytes.
    pub fn read(&self, uri: &str) -> Result<Vec<u8>, IoError> {
        if !is_remote(uri) {
            return self.files.read(uri);
        }
        #[cfg(feature = "http")]
        {
            let http = match self.http.get() {
                Some(http) => http,
                None => {
                    let http = HttpHere::new(&self.config)?;
                    self.http.get_or_init(|| http)
                }
            };
            http.get(uri, &self.limits)
        }
        #[cfg(not(feature = "http"))]
        Err(IoError::unsupported(uri, "http (built without the feature)"))
    }

    /// Bytes of a file as it lies there.
    pub fn size(&self, uri: &str) -> Result<u64, IoError> {
        self.files.size(uri)
    }
}
