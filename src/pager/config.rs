//! [`PagerConfig`]: the threads, budgets, limits and time spans of a pager; and [`PagerError`], why it cannot start.

use std::sync::Arc;
use std::time::Duration;

use crate::fetch::{IoError, Limits};
use crate::formats::{ContentReader, OverlaySet, Style};
use crate::math::{Ellipsoid, WGS84};
use crate::scene::ShareModes;

/// Half of it are 32 requests of six megabytes, and the whole leaves room for the rest of a process of one gigabyte.
const DEFAULT_BYTES_LOADING: u64 = 384 << 20;

/// Configuration of a [`DatabasePager`](super::DatabasePager): threads, budgets and timeouts. It has many fields because
/// each is an independent setting.
#[derive(Clone, Debug)]
pub struct PagerConfig {
    /// Threads that read local files. With two, one keeps the disk busy while the other waits.
    pub file_threads: usize,
    /// Contents requested from one server at once, at most 4,096; all servers together get four times as many. A content
    /// with separate imagery is two requests.
    pub http_in_flight: usize,
    /// The maximum of contents requested at once from a server that answers as quickly under more requests.
    pub http_in_flight_max: usize,
    /// Threads that decode, with a lower priority than the frame's; one per core by default.
    pub decode_threads: usize,
    /// Prefetches in flight at once beside other requests (see [`PageRequest::ahead`](crate::cull::PageRequest::ahead)). A
    /// server gets more of them as long as a quarter of its slots stays free. 0 disables prefetching.
    pub ahead_in_flight: usize,
    /// Maximum CPU bytes of pages that are merged or have arrived, and of tile trees, without what is yet to be uploaded.
    /// The trees of roots cannot expire; they count up to half of it.
    pub max_bytes_cpu: u64,
    /// Maximum CPU bytes of what is on its way: half of it for files and answers of servers until they are decoded, half for
    /// pages until they are merged. Loads wait for room before they begin. A content that is larger than that is loaded
    /// alone. While it is decoded, a page counts twice, for what its decoder needs. Not counted: files that a local content
    /// refers to, and the file of a root.
    pub max_bytes_loading: u64,
    /// Maximum GPU bytes of pages that are merged or uploaded. A page's size is known after its upload; until then the mean
    /// of recent pages is reserved. A page that turns out larger than the free room is declined at once.
    ///
    /// Textures of a page's state sets count from its arrival on, each once. Free slots of the contexts' blocks and textures of
    /// the application's state sets count too: uploads that need further memory go one after the other, and pages that are not
    /// shown expire until blocks are freed. Near the budget blocks grow by single slots.
    pub max_bytes_gpu: u64,
    /// Maximum number of pages that are merged or have arrived.
    pub max_tiles: usize,
    /// A page may expire once it was not wanted for this long, by the reference time of frame stamps; the viewer's blocking
    /// mode counts their simulation time. When room is short for
    /// what a frame lacks, the pages that the last frames did not show leave, the least recently used first.
    pub expiry_time: Duration,
    /// A page may expire once it was also not wanted for this many frames, however long these take; ignored when room is
    /// short.
    pub expiry_frames: u32,
    /// A request that was not renewed for this long is dropped before it costs I/O. Two frames may always pass.
    pub stale_time: Duration,
    /// A running HTTP request that was not renewed for this long is aborted. Two frames may always pass.
    pub abort_time: Duration,
    /// Uploads arrived pages as frames leave time for it, before they are merged (OSG's pre-compile). Without it a page is
    /// uploaded whole in the update that finds it, however long that takes: for offscreen images, or applications that
    /// load behind a loading screen.
    pub pre_compile: bool,
    /// The time of [`Self::update_time`] that merging may take at most; one page is always merged.
    pub merge_time: Duration,
    /// Time per update for all that has arrived: accepting loaded contents and finished uploads, beginning uploads, merging and
    /// expiring pages. Each step has a share of it and what the steps before it leave. One of each is always done, and the
    /// others wait for the next update or for the time before it. In frames longer than 1/60 s it grows with them, up to
    /// eight times. The blocking mode has no such budget.
    pub update_time: Duration,
    /// Back-off before a failed load is retried while it is wanted; doubled each time, up to five minutes.
    pub retry_after: Duration,
    /// Maximum attempts to load a URI; `None` for no limit, so that loads resume after a long network outage. Errors that
    /// rarely pass ([`IoError::is_doubtful`](crate::fetch::IoError::is_doubtful)) are tried five times.
    pub max_tries: Option<u32>,
    /// Bounds on data from outside. A tile whose file is not read within [`Limits::file_timeout`] has failed, and is requested a
    /// few times more; other tiles go on loading.
    pub limits: Limits,
    /// Timeouts, certificates, credentials and cache of the HTTP client.
    #[cfg(feature = "http")]
    pub http: crate::fetch::HttpConfig,
    /// Each update waits until all requests that have room are merged or have failed, so that equal flights give equal
    /// tiles.
    pub blocking: bool,
    /// The decode threads build k-d trees for intersections with paged geometry; see
    /// [`ReadOptions::build_kd_trees`](crate::formats::ReadOptions::build_kd_trees).
    pub build_kd_trees: bool,
    /// Attributes that meshes of glTFs keep if a scene's own options name none; see
    /// [`ReadOptions::vertex_attributes`](crate::formats::ReadOptions::vertex_attributes).
    pub vertex_attributes: Arc<[Arc<str>]>,
    /// Keeps feature ids and their properties, and the metadata of tiles; see
    /// [`ReadOptions::keep_features`](crate::formats::ReadOptions::keep_features).
    pub keep_features: bool,
    /// The style of scenes whose own options have none; see [`ReadOptions::style`](crate::formats::ReadOptions::style).
    pub style: Option<Arc<Style>>,
    /// Readers of an application's own formats, for all scenes.
    pub content_readers: Arc<[Arc<dyn ContentReader>]>,
    /// Attributions of scenes whose own options have none; see [`ReadOptions::credits`](crate::formats::ReadOptions::credits).
    pub credits: Arc<[Arc<str>]>,
    /// Overlays that are draped over scenes whose own options have none; see
    /// [`ReadOptions::overlays`](crate::formats::ReadOptions::overlays).
    pub overlays: Option<Arc<OverlaySet>>,
    /// The ellipsoid of roots that a viewer reads and that name none, such as terrain services; see
    /// [`ReadOptions::ellipsoid`](crate::formats::ReadOptions::ellipsoid).
    pub ellipsoid: Ellipsoid,
    /// Which equal contents of different tiles are shared; see [`SharedStateManager`](crate::scene::SharedStateManager).
    pub sharing: ShareModes,
}

impl Default for PagerConfig {
    fn default() -> Self {
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        Self {
            file_threads: 2,
            http_in_flight: 32,
            http_in_flight_max: 128,
            decode_threads: cores.clamp(1, 16),
            ahead_in_flight: 8,
            max_bytes_cpu: 512 << 20,
            max_bytes_loading: DEFAULT_BYTES_LOADING,
            max_bytes_gpu: 1 << 30,
            max_tiles: 6000,
            expiry_time: Duration::from_millis(500),
            expiry_frames: 2,
            stale_time: Duration::from_millis(50),
            abort_time: Duration::from_millis(500),
            pre_compile: true,
            merge_time: Duration::from_millis(1),
            update_time: Duration::from_micros(500),
            retry_after: Duration::from_secs(5),
            max_tries: None,
            limits: Limits::default(),
            #[cfg(feature = "http")]
            http: crate::fetch::HttpConfig::default(),
            blocking: false,
            build_kd_trees: false,
            vertex_attributes: Arc::default(),
            keep_features: false,
            style: None,
            content_readers: Arc::new([]),
            credits: Arc::new([]),
            overlays: None,
            ellipsoid: WGS84,
            sharing: ShareModes::default(),
        }
    }
}

/// An error that prevents a pager from starting or from serving a scene.
#[derive(Debug, thiserror::Error)]
pub enum PagerError {
    /// A thread could not be started.
    #[error("cannot start thread {name}: {source}")]
    Thread {
        /// Name of the thread.
        name: String,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The HTTP client could not be set up.
    #[error("cannot set up HTTP: {0}")]
    Http(IoError),
}
