//! The program `terrane`, without windows.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod benches;
mod cache;
mod cli;
mod convert;
mod hosts;
mod info;
mod object_stores;
mod procedural;
mod samples;
mod serve;
mod services;
mod stress;
