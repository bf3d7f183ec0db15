//! [`Request`]: the properties of a job that the request list orders by. Update and loading threads.

use super::ticket::Ticket;
use crate::fetch::is_remote;

/// A job as the list sees it.
pub(crate) trait Request: Clone {
    /// Scenes get slots in turns.
    type Scene: Copy + Ord + Send;

    /// Returns the identity of this load attempt.
    fn ticket(&self) -> Ticket;
    /// Returns the address: a path, or the URL of a remote content.
    fn uri(&self) -> &str;
    /// Returns true if a server is asked for the content.
    fn is_remote(&self) -> bool {
        is_remote(self.uri())
    }
    /// Returns the scene that the content is for.
    fn scene(&self) -> Self::Scene;
    /// Returns true if the content is wanted in a later frame only, as of the last update.
    fn is_prefetch(&self) -> bool;
    /// Records whether the content is wanted in a later frame only.
    fn set_prefetch(&mut self, is_prefetch: bool);
    /// Returns the servers that the content and its companions are requested from: the content's first, each once.
    #[cfg(feature = "http")]
    fn servers(&self) -> &[String];
    /// Records that a thread has taken the job and reads it.
    fn mark_reading(&self) {}
}
