//! A timeline: what every thread did when, for Chrome's and Perfetto's viewers.
//!
//! Any thread. Code marks what it does with [`span`]; nothing is kept unless a [`Recording`] is under way. While none is,
//! a mark costs one relaxed load. While one is, it costs two readings of the clock and a push into a buffer of the
//! thread's own, whose lock nobody else takes before the end.
//!
//! ```text
//! main            |frame |event|update |merge|  |wait for stage|cull|      |
//! draw 0                 |compile|draw      |present|
//! pager-file-0    |fetch|     |fetch   |
//! pager-decode-0         |decode|
//! gpu 0                     |frame |shadows|picture| |
//! requests        [ asked for ............................. merged ]
//! ```

//! A context's `gpu` line has its passes as the adapter timed them, where it can: see `src/gpu/timer.rs` for how its clock
//! is laid over ours.

mod buffers;
mod json;

pub use buffers::{Recording, Span, request_begins, request_ends, request_span, span, span_of, ticket_source};
pub(crate) use buffers::{Track, is_recording};
pub use json::TimelineSummary;

/// Why there is no timeline.
#[derive(Debug, thiserror::Error)]
pub enum TimelineError {
    /// Another recording is under way in the process.
    #[error("a timeline is being recorded already")]
    AlreadyRecording,
    /// The file could not be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
}
