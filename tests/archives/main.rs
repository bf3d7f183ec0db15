//! Tile sets inside archives: 3TZ files, their index, and PMTiles.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod archive_index;
mod archives;
mod pmtiles;
