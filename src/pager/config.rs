//! What a pager is told, and what it needs of a graphics context.

use std::sync::Arc;
use std::time::Duration;

use crate::gpu::{CompileBudget, CompileOperation, Compiled};
use crate::io::{IoError, Limits};
use crate::scene::{DrawKind, DrawSlot, ShareModes};

/// One graphics context's compile queue, as the pager sees it from the main thread.
pub trait CompileContext {
    /// Number of the context; pages keep their draw slots by it.
    fn id(&self) -> u32;
    /// Told before [`Self::compile`]: what the drawables that come are, so that what draws them can be made before they
    /// are drawn.
    fn prewarm(&mut self, _kinds: &Arc<[DrawKind]>) {}
    /// Queues drawables for upload; done within the context's budget a frame.
    fn compile(&mut self, operation: CompileOperation);
    /// Nobody waits for these operations any more: those that have not begun may end with nothing made. All are answered.
    fn cancel(&mut self, _tickets: &[u64]) {}
    /// Uploads within a budget, now or on the context's own thread: for the time between two frames. What a frame
    /// uploads itself is not the pager's to say.
    fn run_compiles(&mut self, budget: &CompileBudget);
    /// What has been uploaded since the last call.
    fn take_compiled(&mut self) -> Vec<Compiled>;
    /// Gives slots back, after the last frame that may draw them was queued.
    fn release(&mut self, slots: Vec<DrawSlot>);
    /// False once whoever compiles has ended before its time, or where it can compile nothing now: what was queued is not
    /// waited for.
    fn is_alive(&self) -> bool {
        true
    }
}

/// Sizes and patience of a [`super::DatabasePager`].
#[derive(Clone, Debug)]
pub struct PagerConfig {
    /// Threads that read local files. Two keep a disk busy while one waits.
    pub file_threads: usize,
    /// Contents asked of one server at once (of all together four times as many), 4,096 at most; one with imagery of its own is
    /// two requests.
    pub http_in_flight: usize,
    /// A server that answers as quickly under more requests gets more, up to so many.
    pub http_in_flight_max: usize,
    /// Threads that decode, behind the frame's in priority; the default is one for each core.
    pub decode_threads: usize,
    /// Contents under way at once that are wanted only later (see [`PageRequest::ahead`](crate::cull::PageRequest::ahead)),
    /// and of a server as many more as leave a quarter of its places free; 0 loads none.
    pub ahead_in_flight: usize,
    /// CPU bytes of pages that are merged or have arrived, and of tile trees. Besides, each decode thread has the one that
    /// it decodes and up to twelve that the main thread has not taken up, and up to 8 MiB for each of them are what waits to
    /// be uploaded.
    pub max_bytes_cpu: u64,
    /// GPU bytes of pages that are merged or were uploaded. How much one takes is known once it was uploaded: meanwhile the
    /// mean of the last pages is reserved for it, and one that is larger than the room is given up at once.
    pub max_bytes_gpu: u64,
    /// Pages that are merged or have arrived.
    pub max_tiles: usize,
    /// A page may expire once it was not wanted for so many frames.
    pub expiry_frames: u32,
    /// And for so long, counted from when it was first found unused; in want of room it is not waited for.
    pub expiry_time: Duration,
    /// A request not renewed for so many frames is dropped before it costs I/O.
    pub stale_frames: u32,
    /// A running HTTP request not renewed for so many frames is aborted.
    pub abort_frames: u32,
    /// What has arrived is uploaded as frames leave time for it, before it is merged (OSG's pre-compile). Without it
    /// uploads wait for no frame: a page is uploaded whole in the update that finds it, however long that takes; for
    /// pictures that nobody waits for, or applications that load behind a curtain.
    pub pre_compile: bool,
    /// Time for merging per frame; one page always goes through.
    pub merge_time: Duration,
    /// Wait before a failure that may pass is tried again, while somebody looks; doubled each time, up to five minutes.
    pub retry_after: Duration,
    /// Tries of a URI in all; `None` for no end of them: a network that was away for long is found when it comes back. Of
    /// those that fail with what mostly stays ([`IoError::is_doubtful`](crate::io::IoError::is_doubtful)) there are five.
    pub max_tries: Option<u32>,
    /// How much is accepted from outside.
    pub limits: Limits,
    /// How servers are talked to.
    #[cfg(feature = "http")]
    pub http: crate::io::HttpConfig,
    /// Each update waits until everything that was asked for and finds room is merged or has failed: equal flights give
    /// equal tiles.
    pub blocking: bool,
    /// The decode workers build k-d trees, for intersections with what is paged; see
    /// [`ReadOptions::build_kd_trees`](crate::io::ReadOptions::build_kd_trees).
    pub build_kd_trees: bool,
    /// Attributes that meshes of glTFs keep, where a scene's own options name none; see
    /// [`ReadOptions::vertex_attributes`](crate::io::ReadOptions::vertex_attributes).
    pub vertex_attributes: Arc<[Arc<str>]>,
    /// What equal contents of different tiles share, see [`SharedStateManager`](crate::scene::SharedStateManager).
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
            max_bytes_gpu: 1 << 30,
            max_tiles: 6000,
            expiry_frames: 30,
            expiry_time: Duration::ZERO,
            stale_frames: 3,
            abort_frames: 30,
            pre_compile: true,
            merge_time: Duration::from_millis(1),
            retry_after: Duration::from_secs(5),
            max_tries: None,
            limits: Limits::default(),
            #[cfg(feature = "http")]
            http: crate::io::HttpConfig::default(),
            blocking: false,
            build_kd_trees: false,
            vertex_attributes: Arc::default(),
            sharing: ShareModes::default(),
        }
    }
}

/// Why a pager could not start.
#[derive(Debug, thiserror::Error)]
pub enum PagerError {
    /// A thread could not be started.
    #[error("cannot start thread {name}: {source}")]
    Thread {
        /// Name of the thread.
        name: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The HTTP client could not be set up.
    #[error("cannot set up HTTP: {0}")]
    Http(IoError),
}
