//! [`PathError`]: why a camera path cannot be read, written or used.

/// A camera path that cannot be read, written or used.
#[derive(Debug, thiserror::Error)]
pub enum PathError {
    /// The file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// The system's error.
        source: std::io::Error,
    },
    /// A line is not a control point.
    #[error("line {line}: {reason}")]
    Line {
        /// The number of the line, counted from 1.
        line: usize,
        /// Why the line is invalid.
        reason: String,
    },
    /// A control point has a time that is not finite.
    #[error("a control point has the time {time_s} s, which is not finite")]
    NotFinite {
        /// The time, seconds.
        time_s: f64,
    },
    /// There is no control point.
    #[error("the path has no control point")]
    Empty,
}
