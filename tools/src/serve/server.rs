//! The state of a server, and its time limits.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::args::ServeArgs;
use super::faults::RequestCounts;
use super::procedural::Procedural;

/// The time after which a connection without requests is closed.
pub(super) const IDLE_TIMEOUT: Duration = Duration::from_secs(60);
/// The time between the first half of an answer and a reset, so that the client receives that half.
pub(super) const RESET_DELAY: Duration = Duration::from_millis(20);

/// The state that all connections share.
pub(super) struct Server {
    pub(super) args: ServeArgs,
    /// The canonical path of the folder; empty with a planet.
    pub(super) folder: PathBuf,
    /// The planet that is served instead of the folder.
    pub(super) procedural: Option<Procedural>,
    pub(super) counts: RequestCounts,
    /// Faults are on. Set through [`Background::set_faulty`](super::Background::set_faulty), read by the connections.
    pub(super) is_faulty: AtomicBool,
    /// Set when the server is dropped, read by the thread that accepts connections.
    pub(super) is_stopped: AtomicBool,
}
