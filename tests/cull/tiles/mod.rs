//! Cull of tile trees: coverage, rules of selection, priorities of requests and request volumes.

mod coverage;
mod model;
mod priorities;
mod request_volumes;
mod rules;
