//! Loading: the threads that read and decode contents, and what they share with the update thread.
//!
//! ```text
//! update thread   RequestList (one mutex; jobs by urgency, limits, tickets to abort)
//!                      |                    |
//! file n x        read local files     HTTP 1 x: one async runtime, per-server limits
//!                      |                    |
//! decode n x      bounded channels of LoadedBytes -> LoadJob::decode -> bounded channel of answers
//! reaper          drops pages off the update thread
//! ```
//! Everything but [`reaper`] and [`page_job`] is generic over the job ([`job::LoadJob`]): the
//! [`DatabasePager`](super::DatabasePager) loads pages with it, the [`ImagePager`](super::ImagePager) images.

pub(super) mod budgets;
pub(super) mod config;
mod file_threads;
#[cfg(feature = "http")]
pub(super) mod http;
pub(super) mod job;
pub(super) mod page_job;
pub(super) mod reaper;
pub(super) mod request;
pub(super) mod request_list;
#[cfg(feature = "http")]
mod server_limits;
mod thread_set;
pub(super) mod threads;
pub(super) mod ticket;
pub(super) mod waiting_jobs;
