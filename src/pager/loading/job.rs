//! [`LoadJob`]: the interface of a job for the loading threads, and the messages between them.

use std::sync::Arc;

use super::request::Request;
use crate::fetch::{ContentMemory, IoError, Loaded, Permit, RootScope};
use crate::formats::Fetched;
#[cfg(feature = "http")]
use crate::pager::scenes::shared_files::SharedFiles;
use crate::trace::Span;

/// One content to load. The threads read its bytes and call [`Self::decode`]; each job gets exactly one [`Answer`].
pub(in crate::pager) trait LoadJob: Request + Send + Sync + 'static {
    /// The decoded content.
    type Content: Send + 'static;
    /// Prefix of the names of the threads that load such jobs.
    const THREAD_PREFIX: &'static str;

    /// Returns the address: a path, or the URL of a remote content.
    fn address(&self) -> &Arc<str>;
    /// Returns the scope that symbolic links must not lead out of; `None` if the application names the file.
    fn root_scope(&self) -> Option<&RootScope> {
        None
    }
    /// Returns the addresses of what is loaded together with the content, such as a height tile's imagery.
    fn companions(&self) -> Vec<Arc<str>> {
        Vec::new()
    }
    /// Returns true if the job has its content in memory, so that nothing is read.
    fn is_in_memory(&self) -> bool {
        false
    }
    /// Returns the address at which the content is looked for if its own has none.
    #[cfg(feature = "http")]
    fn fallback(&self) -> Option<Arc<str>> {
        None
    }
    /// Returns the address at which a companion is looked for if its own has none.
    #[cfg(feature = "http")]
    fn companion_fallback(&self, _companion: &str) -> Option<Arc<str>> {
        None
    }
    /// Returns the addresses of what the content's bytes refer to and that is not in `known`. The threads load it and ask again
    /// until there is nothing more.
    fn dependencies(&self, _loaded: &Loaded, _known: &[Fetched]) -> Vec<Arc<str>> {
        Vec::new()
    }
    /// Returns the bytes of what [`Self::dependencies`] keeps for [`Self::decode`].
    fn bytes_ahead(&self) -> u64 {
        0
    }
    /// Drops it, since the content is requested again later.
    #[cfg(feature = "http")]
    fn forget_ahead(&self) {}
    /// Returns the client that asks servers for the content.
    #[cfg(feature = "http")]
    fn client(&self) -> &crate::fetch::HttpClient;
    /// Returns the client that asks servers for a dependency.
    #[cfg(feature = "http")]
    fn client_of(&self, _dependency: &str) -> &crate::fetch::HttpClient {
        self.client()
    }
    /// Returns true if the content is whole without a dependency, so that it does not wait long for it.
    #[cfg(feature = "http")]
    fn may_be_missing(&self, _dependency: &str) -> bool {
        false
    }
    /// Returns the files that several contents share.
    #[cfg(feature = "http")]
    fn shared_files(&self) -> SharedFiles {
        SharedFiles::default()
    }
    /// Opens the timeline span of reading a local file.
    fn read_span(&self) -> Span;
    /// Opens the timeline span of an HTTP request.
    #[cfg(feature = "http")]
    fn request_span(&self) -> Span;
    /// Opens the timeline span of decoding.
    fn decode_span(&self) -> Span;
    /// Records that the bytes were read: the job waits for a decode thread or one has it.
    fn mark_decoding(&self) {}
    /// Returns the bytes of memory that a content takes.
    fn content_bytes(content: &Self::Content) -> u64;
    /// Decodes the bytes; decode threads. If they turn out to be no content, removes them from the HTTP cache.
    fn decode(&self, loaded: Loaded, companions: Vec<Fetched>) -> Result<Self::Content, IoError>;
}

/// The bytes of a job on their way to a decode thread.
pub(in crate::pager) struct LoadedBytes<J> {
    pub job: J,
    pub loaded: Result<Loaded, IoError>,
    pub companions: Vec<Fetched>,
    /// Bytes of the content and its companions.
    pub bytes_read: u64,
    /// Bytes of them that were transferred over the network.
    pub bytes_http: u64,
    /// Holds the bytes in the budget of bodies; `None` if there are none.
    pub permit: Option<Permit>,
}

impl<J> LoadedBytes<J> {
    /// Creates the result of a job that could not be read.
    pub fn failed(job: J, error: IoError) -> Self {
        Self { job, loaded: Err(error), companions: Vec::new(), bytes_read: 0, bytes_http: 0, permit: None }
    }
}

/// The answer to a job.
pub(in crate::pager) struct Answer<J: LoadJob> {
    pub job: J,
    /// The content or the error; `None` if the job was aborted.
    pub content: Option<Result<J::Content, IoError>>,
    /// Bytes of the content and its companions.
    pub bytes_read: u64,
    /// Bytes of them that were transferred over the network.
    pub bytes_http: u64,
    /// The memory of the content in the budget of contents; `None` if there is none.
    pub memory: Option<ContentMemory>,
}

/// Returns the number of bytes of a content and its companions.
pub(super) fn total_bytes(loaded: &Result<Loaded, IoError>, companions: &[Fetched]) -> u64 {
    let size = |r: &Result<Vec<u8>, IoError>| r.as_ref().map_or(0, |b| b.len() as u64);
    let own = loaded.as_ref().map_or(0, |loaded| loaded.bytes.len() as u64);
    own + companions.iter().map(|(_, r)| size(r)).sum::<u64>()
}
