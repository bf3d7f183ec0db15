//! Tiles of the quadtree: their keys and what is known of each.

use crate::Extent;

/// The number of cells along a tile's side.
pub const CELLS: usize = 64;

/// The position of a tile in the quadtree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct TileKey {
    /// The level; the root has level 0.
    pub level: u32,
    /// The column, counted from the west.
    pub x: u32,
    /// The row, counted from the south.
    pub y: u32,
}

impl TileKey {
    /// The tile of the coarsest level.
    pub const ROOT: Self = Self { level: 0, x: 0, y: 0 };

    /// Returns the four children: south-west, south-east, north-west, north-east.
    pub fn children(self) -> [Self; 4] {
        [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| Self {
            level: self.level + 1,
            x: 2 * self.x + dx,
            y: 2 * self.y + dy,
        })
    }

    /// Returns the place of the tile on the Morton curve of its level: the bits of column and row in turns, the column's first.
    pub(crate) fn morton(self) -> u64 {
        let spread = |c: u32| (0..self.level).fold(0u64, |bits, k| bits | u64::from(c >> k & 1) << (2 * k));
        spread(self.x) | spread(self.y) << 1
    }

    /// Returns the rectangle of the tile in a set with a rectangle.
    pub fn extent(self, e: &Extent) -> Extent {
        let n = f64::from(1u32 << self.level);
        let lon = |t: f64| e.west + (e.east - e.west) * (t / n);
        let lat = |t: f64| e.south + (e.north - e.south) * (t / n);
        let (x, y) = (f64::from(self.x), f64::from(self.y));
        Extent { west: lon(x), south: lat(y), east: lon(x + 1.0), north: lat(y + 1.0) }
    }

    /// Returns the depth of the lattice of the tile's vertices in a set with a number of levels.
    pub(crate) fn depth(self, levels: u32) -> u32 {
        levels - 1 - self.level
    }
}

/// The measured error and height range of a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileFacts {
    /// The measured error in metres, at least that of each child.
    pub error_m: f64,
    /// The lowest height of the tile's vertices and of the finest samples inside the tile.
    pub min_height_m: f32,
    /// The highest height of those.
    pub max_height_m: f32,
    /// The part of the tile that has data.
    pub coverage: Coverage,
}

impl TileFacts {
    /// The facts of a tile without data.
    pub const NONE: Self =
        Self { error_m: 0.0, min_height_m: f32::INFINITY, max_height_m: f32::NEG_INFINITY, coverage: Coverage::None };

    /// Widens the range of heights, by many at a time.
    pub(super) fn add_row(&mut self, heights: &[f32]) {
        let (mut low, mut high) = ([f32::INFINITY; 8], [f32::NEG_INFINITY; 8]);
        let (eights, rest) = heights.as_chunks::<8>();
        for eight in eights {
            for (k, h) in eight.iter().enumerate() {
                // Comparisons with NaN are false.
                low[k] = if *h < low[k] { *h } else { low[k] };
                high[k] = if *h > high[k] { *h } else { high[k] };
            }
        }
        self.add_heights(low.into_iter().chain(high).filter(|h| h.is_finite()));
        self.add_heights(rest.iter().copied());
    }

    /// Widens the range of heights.
    pub(super) fn add_heights(&mut self, heights: impl IntoIterator<Item = f32>) {
        for h in heights {
            // Comparisons with NaN are false.
            if h < self.min_height_m {
                self.min_height_m = h;
            }
            if h > self.max_height_m {
                self.max_height_m = h;
            }
        }
    }
}

/// The part of a tile that has data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coverage {
    /// No triangle has data.
    None,
    /// Some triangles have data.
    Part,
    /// All samples have data.
    Whole,
}

impl Coverage {
    /// Returns the coverage of a tile with these children.
    pub fn of_children(children: [Self; 4]) -> Self {
        if children == [Self::None; 4] {
            return Self::None;
        }
        if children == [Self::Whole; 4] { Self::Whole } else { Self::Part }
    }
}
