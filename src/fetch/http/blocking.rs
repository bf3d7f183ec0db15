//! Moves work that may block off the HTTP thread.

use crate::fetch::IoError;

/// Larger bodies are decompressed on a blocking thread, so that the HTTP thread keeps serving its connections.
pub(in crate::fetch) const MAX_INLINE_BYTES: usize = 4 << 10;

/// Runs work on one of the runtime's blocking threads.
pub(in crate::fetch) async fn run_blocking<T: Send + 'static>(
    uri: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, IoError> {
    let failed = |_| IoError::Network { uri: uri.to_owned(), reason: "its worker thread panicked".to_owned() };
    tokio::task::spawn_blocking(work).await.map_err(failed)
}
