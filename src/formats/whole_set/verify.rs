//! Reads and decodes a whole tile set as the pager would, for `terrane info --verify`. One content at a time; blocking.

use std::collections::BTreeMap;

use serde::Serialize;

use super::measure::{LevelMeasures, Problem, SurveyedTile};
use super::report::{InfoError, record};
use super::survey::{SurveyOptions, survey};
#[cfg(feature = "http")]
use crate::fetch::HttpConfig;
use crate::fetch::{IoError, Limits};
use crate::formats::options::Fetched;

/// The result of [`verify`].
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
    /// What is wrong with tiles that can be read, by kind, set at the end.
    pub problems: Vec<Problem>,
    /// Number of edges of tiles that were not compared, since too many others waited for a neighbour.
    #[serde(skip_serializing_if = "is_zero")]
    pub edges_left_out: u64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// A step of [`survey`].
#[derive(Debug)]
pub enum SurveyEvent<'a> {
    /// A file was read.
    Read(&'a Verified),
    /// A tile and all tiles below it were read.
    Tile(&'a SurveyedTile),
}

/// Reads, decodes and measures every content of a tile set, and calls `progress` after each. Fails only if the root cannot be
/// read.
pub fn verify(source: &str, limits: &Limits, progress: &mut dyn FnMut(&Verified)) -> Result<Verified, IoError> {
    verify_by(source, &SurveyOptions { limits: *limits, ..SurveyOptions::default() }, progress)
}

/// Like [`verify`], with a configuration for servers.
#[cfg(feature = "http")]
pub fn verify_with(
    source: &str,
    limits: &Limits,
    http: HttpConfig,
    progress: &mut dyn FnMut(&Verified),
) -> Result<Verified, IoError> {
    verify_by(source, &SurveyOptions { limits: *limits, http, ..SurveyOptions::default() }, progress)
}

fn verify_by(source: &str, options: &SurveyOptions, progress: &mut dyn FnMut(&Verified)) -> Result<Verified, IoError> {
    survey(source, options, &mut |event| {
        if let SurveyEvent::Read(verified) = event {
            progress(verified);
        }
    })
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
