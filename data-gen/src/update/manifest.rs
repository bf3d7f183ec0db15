//! The record of what a set was made of, in its journal: the options and the sources.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::OldSet;
use crate::color::Imagery;
use crate::fingerprint::{options_text, source_text};
use crate::opened::{Opened, OpenedTerrain};
use crate::output::Journal;
use crate::{Color, Extent, GenArgs, GenError};

/// The name of the manifest in the journal.
const MANIFEST: &str = "sources.json";

/// Records the options and sources that the blocks of a set were made of.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(crate) struct Manifest {
    /// The version, the options, and what is not a source of elevation.
    options: String,
    /// The grid, and what is taken from all sources together.
    grid: String,
    /// The largest pixel of the sources of elevation, east and north, in radians: how far beyond their rectangles heights
    /// depend on them.
    #[serde(default)]
    pixel: [f64; 2],
    pub(super) sources: Vec<Source>,
    #[serde(default)]
    pub(super) imagery: Vec<Source>,
    /// Only terrain for globes has it: its grid does not depend on the sources.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) terrain: Option<TerrainPlace>,
}

/// The properties of all sources together that terrain for globes depends on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct TerrainPlace {
    /// The rectangle of the sources: west, south, east and north in radians.
    pub bounds: [f64; 4],
    /// The same, exactly.
    pub bits: String,
    /// A checksum of the heights that wide gaps continue; `None` if no tile has such a gap.
    pub gaps: Option<String>,
}

/// A source of elevation or imagery.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Source {
    /// The name, the size and the time of the file, and of those beside it.
    file: String,
    /// West, south, east and north in radians.
    bounds: [f64; 4],
    /// The same, exactly.
    bits: String,
}

impl Manifest {
    /// Returns the manifest of a run.
    pub fn new(args: &GenArgs, opened: &Opened<'_>) -> Result<Self, GenError> {
        let grid = opened.grid;
        // Colours depend on the heights of the whole set.
        let range_m = if args.color == Color::None { [0.0; 2] } else { grid.coarse_range_m()? };
        let images = opened.imagery.map(Imagery::bounds).unwrap_or_default();
        Ok(Self {
            options: options_text(args)?,
            grid: format!("{:?} {} {} {range_m:?}", grid.extent, grid.levels, opened.is_fine),
            pixel: opened.pixel,
            sources: sources(args, &args.dem, &opened.places)?,
            imagery: sources(args, &args.imagery, &images)?,
            terrain: None,
        })
    }

    /// Returns the manifest of terrain for globes, as far as it is known before the tiles are.
    pub fn of_terrain(args: &GenArgs, opened: &OpenedTerrain<'_>) -> Result<Self, GenError> {
        let OpenedTerrain { set, places, pixel, .. } = opened;
        let Extent { west, south, east, north } = set.extent;
        let bounds = [west, south, east, north];
        Ok(Self {
            options: options_text(args)?,
            grid: format!("{} {}", set.levels, set.is_fine),
            pixel: *pixel,
            sources: sources(args, &args.dem, places)?,
            imagery: Vec::new(),
            terrain: Some(TerrainPlace { bounds, bits: bits(bounds), gaps: None }),
        })
    }

    /// Returns the manifest with a checksum of the heights that wide gaps continue.
    pub fn with_gaps(mut self, checksum: Option<u64>) -> Self {
        self.terrain.iter_mut().for_each(|terrain| terrain.gaps = checksum.map(|sum| format!("{sum:016x}")));
        self
    }

    /// Returns why nothing of an older set can be kept; `None` if something can.
    pub(super) fn difference_from(&self, old: &Self) -> Option<&'static str> {
        if old.options != self.options {
            return Some("the options are others");
        }
        (old.grid != self.grid).then_some("the bounds, the range of heights or the levels are others")
    }

    /// Returns the larger pixel of the sources of this set and of an older one.
    pub(super) fn pixel_with(&self, old: &Self) -> [f64; 2] {
        [0, 1].map(|axis| self.pixel[axis].max(old.pixel[axis]))
    }

    /// Stores the manifest in the journal of a set.
    pub fn save(&self, set: &Path) -> Result<(), GenError> {
        let json = serde_json::to_vec(self).map_err(|e| GenError::Encode(e.to_string()))?;
        Journal::new(set).save_file(MANIFEST, &json)
    }

    /// Reads the manifest of a set; `None` if there is none.
    pub(super) fn read(set: &dyn OldSet, journal: &Journal) -> Result<Option<Self>, GenError> {
        let parse = |bytes: Vec<u8>| {
            let invalid = |e| GenError::invalid(set.name(), format!("{MANIFEST} of the set: {e}"));
            serde_json::from_slice(&bytes).map_err(invalid)
        };
        journal.load_file(MANIFEST)?.map(parse).transpose()
    }
}

fn bits(bounds: [f64; 4]) -> String {
    format!("{:x?}", bounds.map(f64::to_bits))
}

fn sources(args: &GenArgs, paths: &[PathBuf], places: &[[f64; 4]]) -> Result<Vec<Source>, GenError> {
    let source = |(path, bounds): (&PathBuf, &[f64; 4])| {
        Ok(Source { file: source_text(path, args)?, bounds: *bounds, bits: bits(*bounds) })
    };
    paths.iter().zip(places).map(source).collect()
}

/// Returns the rectangles of sources that only one of two lists has, or that have another place in the order.
pub(super) fn changes(old: &[Source], new: &[Source]) -> Vec<[f64; 4]> {
    let mut changed = Vec::new();
    let mut next = 0;
    for source in old {
        match new[next..].iter().position(|other| other == source) {
            Some(skipped) => {
                changed.extend(new[next..next + skipped].iter().map(|source| source.bounds));
                next += skipped + 1;
            }
            None => changed.push(source.bounds),
        }
    }
    changed.extend(new[next..].iter().map(|source| source.bounds));
    changed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_that_change_or_move_in_the_order_are_changes() {
        let source =
            |name: char| Source { file: name.into(), bounds: [f64::from(name as u32); 4], bits: String::new() };
        let sources = |names: &str| names.chars().map(source).collect::<Vec<_>>();
        for (old, new, changed) in [
            ("abc", "abc", ""),
            ("abc", "ac", "b"),
            ("ac", "abc", "b"),
            ("ab", "cab", "c"),
            ("ab", "ba", "bb"),
            ("a", "", "a"),
        ] {
            let mut found: Vec<char> =
                changes(&sources(old), &sources(new)).iter().map(|b| char::from(b[0] as u8)).collect();
            found.sort_unstable();
            assert_eq!(found.into_iter().collect::<String>(), changed, "{old} {new}");
        }
    }
}
