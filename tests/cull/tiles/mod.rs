//! Cull of tile trees: volumes of contents, coverage, rules of selection, priorities of requests and request volumes.

mod content_volumes;
mod coverage;
mod model;
mod priorities;
mod request_volumes;
mod rules;

pub use model::slots_below;
