//! A recording of what every thread does when, for Chrome's and Perfetto's viewers, and for subscribers of the crate `tracing`.
//!
//! Code marks its work with [`span`] on any thread. Spans are kept only while a [`Recording`] runs. Without one, a span costs
//! one relaxed load; during one, two readings of the clock and a push into the thread's own buffer, whose lock is not
//! contended before the end.
//!
//! With the feature `tracing`, each span and request is also a span of the crate `tracing`, so that the application's own
//! subscriber (Tracy, OpenTelemetry, fmt) sees them, with or without a recording. Without a subscriber this costs another
//! relaxed load. The `gpu` lines are an exception: their times are known too late for a subscriber.
//!
//! ```text
//! main            |frame |event|update |merge|  |wait for stage|cull|      |
//! draw 0                 |compile|draw      |present|
//! pager-file-0    |fetch|     |fetch   |
//! pager-decode-0         |decode|
//! gpu 0                     |frame |shadows|picture| |
//! requests        [ asked for ............................. merged ]
//! ```
//!
//! The `gpu` line of a context has its passes as the adapter timed them, if it can: `src/gpu/context/adapter_clock.rs`
//! describes how its clock is mapped to ours.

mod buffers;
mod chrome;
mod error;
mod recording;
mod redact;
mod request;
mod span;
#[cfg_attr(not(feature = "tracing"), path = "no_subscriber.rs")]
mod subscriber;
mod summary;
mod track;

pub use error::TraceError;
pub use recording::Recording;
pub(crate) use recording::is_recording;
pub use request::{request_begins, request_ends, ticket_source};
pub use span::{Span, request_span, span, span_of};
pub use summary::TraceSummary;
pub(crate) use track::Track;
