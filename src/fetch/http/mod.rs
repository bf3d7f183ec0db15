//! Bytes over HTTP: one client with many requests in flight, on the pager's HTTP thread (a tokio runtime of one thread).
//!
//! ```text
//! HttpClient      decides: a member of an archive, a cached URI, or a plain request
//!   Flights       equal requests at the same time are one
//!   revalidation  answers from the disk cache; asks the server whether stale entries still hold
//!   Transport     retries with back-off, pauses that servers asked for
//!     Exchange    one request: credentials, redirects, timeouts, size limits
//!       hosts     which servers it may reach
//! ```

mod blocking;
mod body;
mod cache_access;
mod client;
mod config;
mod cookies;
mod error_chain;
mod exchange;
mod flights;
mod hosts;
mod retry_policy;
mod revalidation;
mod shared_read;
mod tls;
mod transport;

pub(in crate::fetch) use blocking::{MAX_INLINE_BYTES, run_blocking};
pub use body::HttpBody;
pub(in crate::fetch) use body::parse_content_range;
pub(in crate::fetch) use cache_access::{CachePolicy, HttpCache, copy_validators};
pub use client::HttpClient;
#[cfg(feature = "testing")]
pub use client::fuzz_headers;
pub(crate) use client::{BlockingHttpClient, runtime};
pub(in crate::fetch) use config::ExpiringToken;
pub use config::{AllowedHost, Credential, HttpConfig, StoreOption};
#[cfg(feature = "object-store")]
pub(in crate::fetch) use error_chain::error_chain;
pub(in crate::fetch) use exchange::Answer;
#[cfg(feature = "object-store")]
pub(in crate::fetch) use exchange::{Exchange, Progress};
#[cfg(feature = "object-store")]
pub(in crate::fetch) use hosts::Connections;
pub(in crate::fetch) use shared_read::SharedRead;
pub(in crate::fetch) use transport::Transport;
