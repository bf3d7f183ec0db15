//! [`Verified`]: what a survey finds.

use std::collections::BTreeMap;

use serde::Serialize;

use super::measure::{LevelMeasures, Problem, SurveyedTile};
use super::report::{InfoError, record};
use crate::fetch::IoError;
use crate::formats::options::Fetched;

/// The result of [`verify`](super::verify).
#[derive(Clone, Debug, Default, Serialize)]
pub struct Verified {
    /// Number of contents, decoded or failed.
    pub contents: u64,
    /// Bytes read: contents, their companions, and tilesets.
    pub bytes: u64,
    /// Number of failed contents, companions and tilesets.
    pub failed: u64,
    /// The first thousand failures.
    pub errors: Vec<InfoError>,
    /// The properties that contents have and their readers leave out, counted by kind.
    pub ignored: BTreeMap<String, u64>,
    /// Measures of the tiles by level, set at the end. Empty for a single content and for a map server.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub levels: Vec<LevelMeasures>,
    /// Problems of tiles that can be read, by kind, set at the end.
    pub problems: Vec<Problem>,
    /// Number of edges of tiles that were not compared, since too many others waited for a neighbour.
    #[serde(skip_serializing_if = "is_zero")]
    pub edges_left_out: u64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// A step of [`survey`](super::survey).
#[derive(Debug)]
pub enum SurveyEvent<'a> {
    /// A file was read.
    Read(&'a Verified),
    /// A tile and all tiles below it were read.
    Tile(&'a SurveyedTile),
}

impl Verified {
    pub(super) fn fail(&mut self, error: &IoError) {
        record(error, &mut self.failed, &mut self.errors);
    }

    /// Lists the files that a tileset refers to and that cannot be read. The tileset is read without them.
    pub(super) fn fail_each(&mut self, files: &[Fetched]) {
        files.iter().filter_map(|(_, read)| read.as_ref().err()).for_each(|error| self.fail(error));
    }
}
