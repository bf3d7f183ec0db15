//! The job of loading a page, and how far the threads are with it.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};

use super::job::LoadJob;
use super::request::Request;
use super::ticket::Ticket;
#[cfg(feature = "http")]
use crate::fetch;
use crate::fetch::{IoError, Loaded, RootScope, is_remote};
use crate::formats::{self, Content, Fetched, ReadAhead, ReadOptions, TileVolume};
use crate::pager::scenes::read_scope::{ReadScope, TilesetAncestors};
#[cfg(feature = "http")]
use crate::pager::scenes::shared_files::SharedFiles;
use crate::scene::{Node, NodeId, Page, ReaderData, SceneNumber};
use crate::trace::{self, Span};

/// One page to load.
#[derive(Clone, Debug)]
pub(in crate::pager) struct PageJob {
    /// An answer with another ticket than the slot's current request is late.
    pub ticket: Ticket,
    /// The content slot that the page is for.
    pub slot: NodeId,
    pub uri: Arc<str>,
    /// The reader's data from the slot, such as a height tile's region.
    pub reader_data: Option<ReaderData>,
    /// The tilesets above the content.
    pub ancestors: TilesetAncestors,
    /// The read scope of the slot's scene.
    pub scope: Arc<ReadScope>,
    /// The volume of the slot's tile, if its scene has overlays.
    pub tile: Option<TileVolume>,
    /// True if the content was wanted in a later frame only, as of the last update before a thread took the job.
    pub is_prefetch: bool,
    /// Shared by all clones of the job.
    pub progress: Arc<LoadProgress>,
}

/// How far the threads are with a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(in crate::pager) enum LoadStage {
    /// In the list.
    Waiting,
    /// A thread reads the content.
    Reading,
    /// The bytes were read; the content is decoded or waits for a decode thread.
    Decoding,
}

/// The load stage of a job: written by the thread that has the job, read by the update thread.
#[derive(Debug, Default)]
pub(in crate::pager) struct LoadProgress {
    /// A [`LoadStage`]. Relaxed: it is only shown, no other memory depends on it.
    stage: AtomicU8,
    /// Objects that a loading thread has parsed, for the decode thread.
    read_ahead: ReadAhead,
    /// Used by the HTTP thread alone, which computes it once.
    #[cfg(feature = "http")]
    servers: std::sync::OnceLock<Vec<String>>,
}

impl LoadProgress {
    /// Records the stage.
    pub fn set(&self, stage: LoadStage) {
        self.stage.store(stage as u8, Ordering::Relaxed);
    }

    /// Returns the stage.
    pub fn stage(&self) -> LoadStage {
        match self.stage.load(Ordering::Relaxed) {
            stage if stage == LoadStage::Waiting as u8 => LoadStage::Waiting,
            stage if stage == LoadStage::Reading as u8 => LoadStage::Reading,
            _ => LoadStage::Decoding,
        }
    }

    /// Returns true if the HTTP thread has computed the servers.
    #[cfg(all(test, feature = "http"))]
    pub fn has_servers(&self) -> bool {
        self.servers.get().is_some()
    }
}

impl PageJob {
    /// Returns the options for a content that redirects have led to `location`, and its companions to theirs.
    fn options(&self, location: Option<Arc<str>>, companion_locations: &[(Arc<str>, Arc<str>)]) -> ReadOptions {
        let TilesetAncestors { chain, set_from_page, ellipsoid } = self.ancestors.clone();
        let block_formats = self.scope.block_formats.get();
        ReadOptions {
            chain,
            set_from_content: set_from_page,
            ellipsoid,
            base: location,
            companion_bases: companion_locations.into(),
            block_formats,
            tile: self.tile,
            read_ahead: self.progress.read_ahead.clone(),
            ..self.scope.options.clone()
        }
    }
}

impl PageJob {
    fn has_remote_content(&self) -> bool {
        is_remote(&self.uri) && !self.is_in_memory()
    }

    /// Returns true if a content on disk or in memory is covered by images on servers, or may refer to servers.
    fn may_need_servers(&self) -> bool {
        #[cfg(feature = "http")]
        let (has_server, is_free) =
            (self.scope.overlay_server().is_some(), self.scope.options.root == RootScope::Anywhere);
        #[cfg(not(feature = "http"))]
        let (has_server, is_free) = (false, false);
        let continues_tileset = self.reader_data.as_ref().is_some_and(ReaderData::continues_tileset);
        is_free || has_server && self.tile.is_some() && !continues_tileset
    }
}

impl Request for PageJob {
    type Scene = SceneNumber;

    fn ticket(&self) -> Ticket {
        self.ticket
    }

    fn uri(&self) -> &str {
        &self.uri
    }

    fn is_remote(&self) -> bool {
        self.has_remote_content() || self.may_need_servers()
    }

    fn scene(&self) -> SceneNumber {
        self.slot.page.scene
    }

    fn is_prefetch(&self) -> bool {
        self.is_prefetch
    }

    fn set_prefetch(&mut self, is_prefetch: bool) {
        self.is_prefetch = is_prefetch;
    }

    #[cfg(feature = "http")]
    fn servers(&self) -> &[String] {
        self.progress.servers.get_or_init(|| {
            let own = match self.has_remote_content() {
                true => fetch::server(&self.uri),
                // Only files that it refers to are requested.
                false => self.scope.overlay_server().unwrap_or_default(),
            };
            let mut servers = vec![own.to_owned()];
            for companion in self.companions() {
                let server = fetch::server(&companion);
                if !servers.iter().any(|known| known == server) {
                    servers.push(server.to_owned());
                }
            }
            servers
        })
    }

    fn mark_reading(&self) {
        self.progress.set(LoadStage::Reading);
    }
}

impl LoadJob for PageJob {
    type Content = Page;
    const THREAD_PREFIX: &'static str = "pager";

    fn address(&self) -> &Arc<str> {
        &self.uri
    }

    fn root_scope(&self) -> Option<&RootScope> {
        Some(&self.scope.options.root)
    }

    fn companions(&self) -> Vec<Arc<str>> {
        formats::companions(&self.uri, self.reader_data.as_ref())
    }

    fn is_in_memory(&self) -> bool {
        self.reader_data.as_ref().is_some_and(ReaderData::is_whole_content)
    }

    #[cfg(feature = "http")]
    fn fallback(&self) -> Option<Arc<str>> {
        self.reader_data.as_ref()?.fallback_uri()
    }

    #[cfg(feature = "http")]
    fn companion_fallback(&self, companion: &str) -> Option<Arc<str>> {
        formats::companion_fallback(companion, self.reader_data.as_ref())
    }

    fn dependencies(&self, loaded: &Loaded, known: &[Fetched]) -> Vec<Arc<str>> {
        let options = self.options(loaded.location.clone(), &loaded.companion_locations);
        formats::dependencies(&self.uri, &loaded.bytes, self.reader_data.as_ref(), known, &options)
    }

    fn bytes_ahead(&self) -> u64 {
        self.progress.read_ahead.size_bytes()
    }

    #[cfg(feature = "http")]
    fn forget_ahead(&self) {
        self.progress.read_ahead.forget();
    }

    #[cfg(feature = "http")]
    fn client(&self) -> &fetch::HttpClient {
        &self.scope.client
    }

    #[cfg(feature = "http")]
    fn client_of(&self, dependency: &str) -> &fetch::HttpClient {
        self.scope.client_of(dependency)
    }

    #[cfg(feature = "http")]
    fn may_be_missing(&self, dependency: &str) -> bool {
        self.scope.is_of_overlay(dependency)
    }

    #[cfg(feature = "http")]
    fn shared_files(&self) -> SharedFiles {
        self.scope.shared_files.clone()
    }

    fn read_span(&self) -> Span {
        trace::span_of("fetch", || self.uri.clone())
    }

    #[cfg(feature = "http")]
    fn request_span(&self) -> Span {
        trace::request_span("fetch", self.ticket.trace_id())
    }

    fn decode_span(&self) -> Span {
        trace::span_of("decode", || self.uri.clone())
    }

    fn mark_decoding(&self) {
        self.progress.set(LoadStage::Decoding);
    }

    fn content_bytes(page: &Page) -> u64 {
        page.size_bytes()
    }

    fn decode(&self, loaded: Loaded, companions: Vec<Fetched>) -> Result<Page, IoError> {
        let Loaded { bytes, location, is_no_content, companion_locations } = loaded;
        // Other contents of the same tile are drawn without it.
        let is_joined = !companions.is_empty() && self.reader_data.as_ref().and_then(ReaderData::text).is_none();
        let is_error = self.reader_data.as_ref().is_some_and(ReaderData::needs_content);
        if is_no_content && !is_joined && !is_error {
            let empty = Page::from_node(Node::group(Vec::new()));
            return empty.map_err(|error| IoError::invalid(&self.uri, error.to_string()));
        }
        let options = self.options(location, &companion_locations);
        let content = Content { uri: self.uri.clone(), bytes, reader_data: self.reader_data.clone(), companions };
        formats::decode(content, &options).inspect_err(|error| self.scope.forget_no_content(error))
    }
}

#[cfg(test)]
pub(in crate::pager) mod tests {
    use std::sync::LazyLock;

    use super::*;
    use crate::scene::{PageId, Scene};

    static PAGE: LazyLock<PageId> =
        LazyLock::new(|| Scene::new().add_root(Page::from_node(Node::group(Vec::new())).unwrap()));
    static SCOPE: LazyLock<Arc<ReadScope>> = LazyLock::new(|| {
        Arc::new(ReadScope::new(
            ReadOptions::for_root("/set/tileset.json", fetch::Limits::default()),
            Arc::default(),
            #[cfg(feature = "http")]
            &fetch::HttpClient::new(&fetch::HttpConfig::default()).unwrap(),
        ))
    });

    /// Returns a job whose slot has the ticket's number as index.
    pub(in crate::pager) fn job(number: u64, uri: &str) -> PageJob {
        PageJob {
            ticket: Ticket::for_test(number),
            slot: NodeId { page: *PAGE, index: number as u32 },
            scope: SCOPE.clone(),
            uri: uri.into(),
            reader_data: None,
            ancestors: TilesetAncestors::none(),
            tile: None,
            is_prefetch: false,
            progress: Arc::default(),
        }
    }
}
