//! [`TraceError`].

/// The reason why a recording could not be started or written.
#[derive(Debug, thiserror::Error)]
pub enum TraceError {
    /// Another recording of the process is running.
    #[error("a timeline is being recorded already")]
    AlreadyRecording,
    /// The file could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// Path of the file.
        path: String,
        /// The error of the operating system.
        source: std::io::Error,
    },
}
