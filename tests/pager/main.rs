//! The database pager without a GPU: requests, budgets, failures, servers and several scenes.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

#[cfg(feature = "http")]
mod addresses;
mod ahead;
#[cfg(feature = "http")]
mod bad_input;
mod budgets;
mod externals;
#[cfg(feature = "http")]
mod http;
mod implicit;
#[cfg(feature = "http")]
mod metadata;
mod models;
mod proxies;
mod scenes;
#[cfg(feature = "http")]
mod states;
mod stream;
mod terrain;
