//! Turns a panic of a decoder into an error of the URI that it was decoding. Any thread.

use super::IoError;

/// The reason in the error of a file whose decoder panicked.
pub const DECODER_PANICKED: &str = "the decoder panicked";

/// Runs a decoder of outside data. If a crate behind it panics, only this URI fails and the thread continues.
pub(crate) fn guarded<T>(uri: &str, read: impl FnOnce() -> Result<T, IoError>) -> Result<T, IoError> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(read))
        .unwrap_or_else(|_| Err(IoError::invalid(uri, DECODER_PANICKED)))
}
