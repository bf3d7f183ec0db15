//! The HTTP client and what it keeps on disk: retries, TLS, the cache, object stores.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[cfg(feature = "http")]
mod cache;
#[cfg(feature = "http")]
mod cache_answers;
#[cfg(all(feature = "http", unix))]
mod cache_bad_disk;
#[cfg(all(feature = "http", unix))]
mod cache_hung_disk;
#[cfg(feature = "http")]
mod client;
#[cfg(feature = "http")]
mod fill;
#[cfg(feature = "http")]
mod fuzz_parsers;
#[cfg(feature = "http")]
mod hosts;
#[cfg(feature = "http")]
mod loading_budget;
#[cfg(feature = "object-store")]
mod object_stores;
#[cfg(feature = "http")]
mod services;
#[cfg(feature = "http")]
mod tls;
