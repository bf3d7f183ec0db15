//! [`Availability`]: which tiles a layer has. Plain values; decode threads.

use serde::Deserialize;

use super::tiling::{Rectangle, Tiling};
use crate::formats::implicit::TileCoordinates;

/// A range of tiles in layer.json and in the metadata of tiles. Rows are counted from the south, whatever the scheme of the
/// URLs: CesiumJS and its servers agree on that.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct RangeJson {
    start_x: u64,
    start_y: u64,
    end_x: u64,
    end_y: u64,
}

/// Tiles of a level from a first to a last column and row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct TileRange {
    first: [u32; 2],
    last: [u32; 2],
}

impl TileRange {
    fn overlaps(&self, other: &Self) -> bool {
        (0..2).all(|axis| self.first[axis] <= other.last[axis] && other.first[axis] <= self.last[axis])
    }
}

/// The tiles that are known to exist, as ranges by level.
#[derive(Clone, Debug, Default)]
pub(super) struct Availability {
    levels: Vec<Vec<TileRange>>,
}

/// The faults of ranges that are used nevertheless.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct RangeFaults {
    /// Some ranges have tiles that their level lacks.
    pub is_outside: bool,
    /// Some tiles have no parent.
    pub is_orphaned: bool,
}

/// The maximum number of pairs of ranges that are compared to find tiles without a parent.
const MAX_COMPARED: usize = 1 << 22;
/// The largest level whose tiles are looked at: coordinates have 32 bits.
pub(super) const MAX_LEVEL: u32 = 30;

impl Availability {
    /// Reads ranges of the levels from `first_level` on.
    pub fn of_ranges(json: &[Vec<RangeJson>], first_level: u32, tiling: Tiling) -> Result<(Self, RangeFaults), String> {
        let mut availability = Self { levels: vec![Vec::new(); first_level as usize] };
        let mut faults = RangeFaults::default();
        for (level, ranges) in (first_level..).zip(json) {
            if level > MAX_LEVEL {
                faults.is_outside |= !ranges.is_empty();
                continue;
            }
            let size = tiling.size(level);
            let mut read = Vec::with_capacity(ranges.len());
            for range in ranges {
                let RangeJson { start_x, start_y, end_x, end_y } = *range;
                if start_x > end_x || start_y > end_y {
                    return Err(format!("level {level}: a range from {start_x}, {start_y} to {end_x}, {end_y}"));
                }
                let (first, last) = ([start_x, start_y], [end_x, end_y]);
                faults.is_outside |= (0..2).any(|axis| last[axis] >= size[axis]);
                if (0..2).all(|axis| first[axis] < size[axis]) {
                    let within = |at: [u64; 2]| [0, 1].map(|axis| at[axis].min(size[axis] - 1) as u32);
                    read.push(TileRange { first: within(first), last: within(last) });
                }
            }
            availability.levels.push(read);
        }
        faults.is_orphaned = availability.has_orphans(first_level);
        Ok((availability, faults))
    }

    /// Returns all tiles over a part of the earth in some levels.
    pub fn over(bounds: Option<&Rectangle>, levels: std::ops::RangeInclusive<u32>, tiling: Tiling) -> Self {
        let mut availability = Self::default();
        for level in 0..=(*levels.end()).min(MAX_LEVEL) {
            let size = tiling.size(level);
            let last = size.map(|count| (count - 1) as u32);
            let mut ranges = Vec::new();
            if levels.contains(&level) {
                let at = |longitude, latitude| {
                    let position = tiling.position(level, longitude, latitude);
                    [0, 1].map(|axis| position[axis].clamp(0.0, f64::from(last[axis])) as u32)
                };
                let (first, end) = bounds.map_or(([0; 2], last), |b| (at(b.west, b.south), at(b.east, b.north)));
                if bounds.is_some_and(|bounds| bounds.west > bounds.east) {
                    // Across the antimeridian.
                    ranges.push(TileRange { first: [0, first[1]], last: end });
                    ranges.push(TileRange { first, last: [last[0], end[1]] });
                } else {
                    ranges.push(TileRange { first, last: end });
                }
            }
            availability.levels.push(ranges);
        }
        availability
    }

    /// Returns all tiles of level 0.
    pub fn roots(tiling: Tiling) -> Self {
        Self::over(None, 0..=0, tiling)
    }

    /// Returns true if a tile exists.
    pub fn has(&self, tile: TileCoordinates) -> bool {
        let own = TileRange { first: [tile.x, tile.y], last: [tile.x, tile.y] };
        self.level(tile.level).iter().any(|range| range.overlaps(&own))
    }

    /// Returns true if a tile exists below a tile.
    pub fn has_below(&self, tile: TileCoordinates) -> bool {
        (tile.level + 1..self.levels.len() as u32)
            .any(|level| self.level(level).iter().any(|range| range.overlaps(&below(tile, level))))
    }

    /// Returns what is known about a tile and the tiles below it. Reading that is quicker than reading all.
    pub fn within(&self, tile: TileCoordinates) -> Self {
        let levels = (0..self.levels.len() as u32).map(|level| {
            let own = below(tile, level.max(tile.level));
            let ranges = if level < tile.level { &[] } else { self.level(level) };
            ranges.iter().copied().filter(|range| range.overlaps(&own)).collect()
        });
        Self { levels: levels.collect() }
    }

    /// Returns the number of tiles by level. Tiles in several ranges count for each.
    pub fn counts(&self) -> Vec<u64> {
        let count = |range: &TileRange| {
            let side = |axis: usize| u64::from(range.last[axis] - range.first[axis]) + 1;
            side(0) * side(1)
        };
        self.levels.iter().map(|ranges| ranges.iter().map(count).sum()).collect()
    }

    /// Returns the bytes of memory of the ranges.
    pub fn size_bytes(&self) -> u64 {
        self.levels.iter().map(|ranges| (ranges.len() * size_of::<TileRange>()) as u64 + 24).sum()
    }

    fn level(&self, level: u32) -> &[TileRange] {
        self.levels.get(level as usize).map_or(&[], Vec::as_slice)
    }

    /// Returns true if a corner of a range has no parent in the level above. The first level is known to have its own. Levels
    /// with very many ranges are not checked.
    fn has_orphans(&self, first_level: u32) -> bool {
        let is_orphan = |level: u32, x: u32, y: u32| {
            let parent = TileCoordinates { level: level - 1, x: x / 2, y: y / 2, z: 0 };
            !self.has(parent)
        };
        (first_level + 1..self.levels.len() as u32).any(|level| {
            if self.level(level).len().saturating_mul(self.level(level - 1).len()) > MAX_COMPARED {
                return false;
            }
            self.level(level).iter().any(|TileRange { first, last }| {
                let corners = [[first[0], first[1]], [last[0], first[1]], [first[0], last[1]], [last[0], last[1]]];
                corners.iter().any(|[x, y]| is_orphan(level, *x, *y))
            })
        })
    }
}

/// Returns the tiles of a level that lie in a tile of the same or a coarser level.
fn below(tile: TileCoordinates, level: u32) -> TileRange {
    let levels = level - tile.level;
    let first = [tile.x, tile.y].map(|at| at << levels);
    TileRange { first, last: first.map(|at| at + ((1 << levels) - 1)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tile(level: u32, x: u32, y: u32) -> TileCoordinates {
        TileCoordinates { level, x, y, z: 0 }
    }

    fn ranges(text: &str) -> Vec<Vec<RangeJson>> {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn ranges_tell_which_tiles_exist() {
        let json = r#"[[{"startX":0,"startY":0,"endX":1,"endY":0}],[{"startX":2,"startY":0,"endX":2,"endY":1}],[],
            [{"startX":8,"startY":3,"endX":9,"endY":3}]]"#;
        let (known, faults) = Availability::of_ranges(&ranges(json), 0, Tiling::Geographic).unwrap();
        assert_eq!(faults, RangeFaults { is_outside: false, is_orphaned: true });
        assert!(known.has(tile(1, 2, 1)) && !known.has(tile(1, 1, 1)) && !known.has(tile(9, 0, 0)));
        assert!(known.has_below(tile(0, 1, 0)) && !known.has_below(tile(0, 0, 0)));
        assert!(known.has_below(tile(1, 2, 0)) && !known.has_below(tile(1, 2, 1)));
        assert_eq!(known.counts(), [2, 2, 0, 2]);
        let part = known.within(tile(1, 2, 0));
        assert!(part.has(tile(3, 9, 3)) && part.has(tile(1, 2, 0)) && !part.has(tile(0, 1, 0)));
        assert_eq!(known.within(tile(2, 0, 0)).counts(), [0; 4]);
    }

    #[test]
    fn contradictory_ranges_are_told() {
        let of = |json: &str, first| Availability::of_ranges(&ranges(json), first, Tiling::Geographic);
        let error = of(r#"[[{"startX":1,"startY":0,"endX":0,"endY":0}]]"#, 2).unwrap_err();
        assert_eq!(error, "level 2: a range from 1, 0 to 0, 0");
        let (known, faults) = of(r#"[[{"startX":1,"startY":0,"endX":9,"endY":18446744073709551615}]]"#, 0).unwrap();
        assert_eq!(faults, RangeFaults { is_outside: true, is_orphaned: false });
        assert!(known.has(tile(0, 1, 0)) && !known.has(tile(0, 2, 0)) && known.counts() == [1]);
        let beyond = format!("[{}[{{\"startX\":0,\"startY\":0,\"endX\":0,\"endY\":0}}]]", "[],".repeat(40));
        let (known, faults) = of(&beyond, 0).unwrap();
        assert!(faults.is_outside && known.counts().len() == MAX_LEVEL as usize + 1);
    }

    #[test]
    fn bounds_choose_tiles() {
        let bounds = Rectangle { west: 0.1, south: -0.2, east: 0.3, north: 0.2 };
        let known = Availability::over(Some(&bounds), 1..=4, Tiling::Geographic);
        assert_eq!(known.counts(), [0, 2, 2, 2, 8]);
        assert!(known.has(tile(4, 16, 7)) && known.has(tile(4, 17, 8)) && !known.has(tile(0, 1, 0)));
        assert!(known.has_below(tile(0, 1, 0)) && !known.has_below(tile(0, 0, 0)));
        let across = Rectangle { west: 3.1, east: -3.1, ..bounds };
        let known = Availability::over(Some(&across), 3..=3, Tiling::Geographic);
        assert!(known.has(tile(3, 0, 3)) && known.has(tile(3, 15, 4)) && known.counts() == [0, 0, 0, 4]);
        let mercator = Availability::over(None, 0..=2, Tiling::Mercator);
        assert_eq!(mercator.counts(), [1, 4, 16]);
    }
}
