//! Raster overlays, by the pixels that they give tiles. Servers of the tests draw their own images: the colour of each is its
//! number, so that a wrong image is seen. Needs a GPU; a software adapter suffices.
#![cfg(feature = "http")]
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod bodies;
mod changes;
mod documents;
mod earth;
mod fuzz_parsers;
mod kinds;
mod missing;
mod tiles;
