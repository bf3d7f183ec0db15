//! Reads any URI on the calling thread: for `terrane info` and for the roots of tile sets, never inside a frame.

use std::sync::Arc;

use super::error::IoError;
use super::file::FileReader;
#[cfg(feature = "http")]
use super::http::{BlockingHttpClient, HttpBody, HttpConfig};
use super::limits::Limits;
use super::scope::RootScope;
use super::time_limit::DiskThread;
use super::uri::is_remote;

/// A URI and its bytes, or the reason why they could not be read.
pub(crate) type Fetched = (Arc<str>, Result<Vec<u8>, IoError>);

/// The bytes of a URI, and what the server said about them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Loaded {
    pub bytes: Vec<u8>,
    /// The URL that redirects led to; `None` if there were none. References in the bytes are relative to it.
    pub location: Option<Arc<str>>,
    /// True if the server said that there is no content.
    pub is_no_content: bool,
    /// The companions that redirects led elsewhere, by their URI, with the URL that they led to.
    pub companion_locations: Vec<(Arc<str>, Arc<str>)>,
}

impl Loaded {
    /// Returns bytes that were found at a fallback. References are relative to it, unless redirects led further.
    pub fn found_at(self, fallback: Arc<str>) -> Self {
        Self { location: self.location.or(Some(fallback)), ..self }
    }
}

impl From<Vec<u8>> for Loaded {
    fn from(bytes: Vec<u8>) -> Self {
        Self { bytes, ..Self::default() }
    }
}

#[cfg(feature = "http")]
impl From<HttpBody> for Loaded {
    fn from(body: HttpBody) -> Self {
        let HttpBody { bytes, location, is_no_content, .. } = body;
        Self { bytes, location, is_no_content, ..Self::default() }
    }
}

/// Reads the files of one tile set from disk, archives and servers. Keeps its connections open between reads. A local file that
/// is not read within [`Limits::file_timeout`] is an error.
#[derive(Debug)]
pub(crate) struct Source {
    files: Arc<Files>,
    disk: DiskThread,
    #[cfg(feature = "http")]
    limits: Limits,
    #[cfg(feature = "http")]
    config: HttpConfig,
    /// Created by the first read from a server.
    #[cfg(feature = "http")]
    http: std::cell::OnceCell<BlockingHttpClient>,
}

impl Source {
    /// Creates a source for the set with this root.
    pub fn new(limits: Limits, root_uri: &str) -> Self {
        Self {
            files: Arc::new(Files {
                reader: FileReader::new(limits),
                root: root_uri.to_owned(),
                scope: RootScope::of_set(root_uri, &limits),
            }),
            disk: DiskThread::new(limits.file_timeout),
            #[cfg(feature = "http")]
            limits,
            #[cfg(feature = "http")]
            config: HttpConfig::default(),
            #[cfg(feature = "http")]
            http: std::cell::OnceCell::new(),
        }
    }

    #[cfg(feature = "http")]
    pub fn with_http(self, config: HttpConfig) -> Self {
        Self { config, ..self }
    }

    /// Reads a URI; blocks until all bytes have arrived.
    pub fn read(&self, uri: &str) -> Result<Vec<u8>, IoError> {
        self.load(uri).map(|loaded| loaded.bytes)
    }

    /// Reads a URI as [`Self::read`] does, and returns what is known about the bytes.
    pub fn load(&self, uri: &str) -> Result<Loaded, IoError> {
        if !is_remote(uri) {
            let (files, path) = (self.files.clone(), uri.to_owned());
            return self.disk.run(uri, move || files.read(&path)).map(Loaded::from);
        }
        #[cfg(feature = "http")]
        {
            let http = match self.http.get() {
                Some(http) => http,
                None => {
                    let http = BlockingHttpClient::new(&self.config, &self.files.scope)?;
                    self.http.get_or_init(|| http)
                }
            };
            http.get(uri, &self.limits).map(Loaded::from)
        }
        #[cfg(not(feature = "http"))]
        Err(IoError::unsupported(uri, "http (built without the feature)"))
    }

    /// Returns the size in bytes of a local file as stored.
    pub fn size(&self, uri: &str) -> Result<u64, IoError> {
        let (files, path) = (self.files.clone(), uri.to_owned());
        self.disk.run(uri, move || files.size(&path))
    }
}

/// Reads the files of a set on disk.
#[derive(Debug)]
struct Files {
    reader: FileReader,
    /// The root, which the user named. It may be a link.
    root: String,
    scope: RootScope,
}

impl Files {
    fn read(&self, uri: &str) -> Result<Vec<u8>, IoError> {
        if uri == self.root { self.reader.read(uri) } else { self.reader.read_within(uri, &self.scope) }
    }

    fn size(&self, uri: &str) -> Result<u64, IoError> {
        if uri != self.root {
            self.reader.check_links(uri, &self.scope)?;
        }
        self.reader.size(uri)
    }
}
