//! [`LevelMeasures`] and [`Problem`]: the result of measuring a set. Plain values.

use std::collections::BTreeMap;

use serde::Serialize;

/// The smallest, the middle and the largest of some counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Spread {
    /// The smallest.
    pub min: u64,
    /// The one in the middle when they are sorted.
    pub median: u64,
    /// The largest.
    pub max: u64,
}

/// Measures of the tiles of one level; what cannot be measured is `None`. Errors are measured at the vertices, so the true ones
/// may be larger: by vertical distances where a place has one height, else by distances.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LevelMeasures {
    /// The level; see [`LevelInfo::level`](crate::formats::LevelInfo::level).
    pub level: u32,
    /// Number of tiles whose content was read.
    pub tiles: u64,
    /// Bytes of a tile as they are stored: contents and imagery.
    pub bytes: Spread,
    /// Triangles of a tile; for height tiles those of the grid. Skirts do not count.
    pub triangles: Option<Spread>,
    /// The lowest and the highest vertex or sample without skirts, metres above the ellipsoid, or along z in a local frame.
    pub heights_m: Option<[f64; 2]>,
    /// The smallest and the largest declared geometric error, metres.
    pub geometric_error_m: Option<[f64; 2]>,
    /// The largest measured distance from the tiles of the next level, metres.
    pub error_to_next_m: Option<f64>,
    /// The largest measured distance from the finest tiles below, metres.
    pub error_to_finest_m: Option<f64>,
    /// Number of pairs of neighbours of the level whose common edge was compared.
    pub edges: u64,
    /// The largest difference of height on an edge of two tiles of the level, metres.
    pub edge_m: Option<f64>,
    /// The largest difference of height on an edge of a tile and of the coarser one above it, metres.
    pub edge_to_coarser_m: Option<f64>,
    /// The smallest and the largest depth of skirts, metres.
    pub skirt_m: Option<[f64; 2]>,
    /// Number of textures by file format and size in pixels.
    pub textures: BTreeMap<String, u64>,
}

/// A kind of error of a set, with the tiles that have it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// The name of the problem.
    pub kind: String,
    /// Number of tiles.
    pub count: u64,
    /// The URI of the first tile, without secrets.
    pub uri: String,
    /// The measurement there.
    pub detail: String,
}

/// The measures of a level while tiles are added.
#[derive(Default)]
pub(super) struct LevelSums {
    pub measures: LevelMeasures,
    /// The bytes of each tile; an entry takes four, as in the next list.
    bytes: Vec<u32>,
    triangles: Vec<u32>,
}

impl LevelSums {
    pub fn add(&mut self, bytes: u64, triangles: Option<usize>) {
        self.measures.tiles += 1;
        self.bytes.push(u32::try_from(bytes).unwrap_or(u32::MAX));
        self.triangles.extend(triangles.map(|count| u32::try_from(count).unwrap_or(u32::MAX)));
    }

    /// Returns the measures of all tiles.
    pub fn finish(mut self) -> LevelMeasures {
        self.measures.bytes = spread(&mut self.bytes).unwrap_or_default();
        self.measures.triangles = spread(&mut self.triangles);
        self.measures
    }
}

fn spread(counts: &mut [u32]) -> Option<Spread> {
    counts.sort_unstable();
    let at = |index: usize| counts.get(index).map(|count| u64::from(*count));
    Some(Spread { min: at(0)?, median: at(counts.len() / 2)?, max: at(counts.len() - 1)? })
}

/// Extends a range, which begins with the first value.
pub(super) fn extend(range: &mut Option<[f64; 2]>, [low, high]: [f64; 2]) {
    let [a, b] = range.unwrap_or([low, high]);
    *range = Some([a.min(low), b.max(high)]);
}

/// Raises the largest value.
pub(super) fn raise(largest: &mut Option<f64>, value: f64) {
    *largest = Some(largest.map_or(value, |known| known.max(value)));
}
