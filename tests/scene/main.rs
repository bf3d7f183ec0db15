//! The scene graph without a GPU: pages, bounds, callbacks, intersections and height queries.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod bounds;
mod callbacks;
mod height_query;
mod intersections;
mod pages;
mod window_picking;
