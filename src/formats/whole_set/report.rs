//! Failures as the jobs of this folder report them.

use serde::Serialize;

use crate::fetch::{IoError, shown};

/// The maximum number of failures that are listed. Further ones are only counted.
const MAX_LISTED: usize = 1000;

/// A failure of one URI.
#[derive(Clone, Debug, Serialize)]
pub struct InfoError {
    /// The URI, without secrets.
    pub uri: String,
    /// The reason.
    pub reason: String,
}

/// Counts a failure, and lists it unless the list is full.
pub(super) fn record(error: &IoError, failed: &mut u64, errors: &mut Vec<InfoError>) {
    *failed += 1;
    if errors.len() < MAX_LISTED {
        errors.push(InfoError { uri: shown(error.uri()).into_owned(), reason: error.reason() });
    }
}

/// Returns the error for a set with too many tiles. A few files that refer to each other often enough form a tree that would
/// take forever to walk.
pub(in crate::formats) fn too_many(root: &str, limit: u64) -> IoError {
    IoError::TooLarge { uri: root.to_owned(), what: "tiles and tilesets together", got: limit + 1, limit }
}
