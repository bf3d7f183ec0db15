//! Positions of tiles in an implicit quadtree or octree, and their order in the bitstreams of a subtree. Plain values.

/// How each tile of an implicit tree is divided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::formats) enum Subdivision {
    /// Four children: halves along x and y.
    Quadtree,
    /// Eight children: halves along x, y and z.
    Octree,
}

impl Subdivision {
    /// Returns the number of bits that tell the children of a tile apart.
    pub const fn bits(self) -> u32 {
        match self {
            Self::Quadtree => 2,
            Self::Octree => 3,
        }
    }

    /// Returns the number of children of a tile.
    pub const fn child_count(self) -> u32 {
        1 << self.bits()
    }

    /// Returns the largest number of levels of a subtree whose bits a 64-bit index can count.
    pub const fn max_subtree_levels(self) -> u32 {
        match self {
            Self::Quadtree => 30,
            Self::Octree => 20,
        }
    }

    /// Returns the number of tiles in the levels above `level` of a full tree.
    pub const fn tiles_above(self, level: u32) -> u64 {
        (self.tiles_in(level) - 1) / (self.child_count() as u64 - 1)
    }

    /// Returns the number of tiles in a level of a full tree.
    pub const fn tiles_in(self, level: u32) -> u64 {
        1 << (self.bits() * level)
    }
}

/// The position of a tile in the whole implicit tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::formats) struct TileCoordinates {
    /// The level: 0 for the root of the implicit tree.
    pub level: u32,
    /// Tiles to the west of it in its level.
    pub x: u32,
    /// Tiles to the south of it.
    pub y: u32,
    /// Tiles below it; 0 in a quadtree.
    pub z: u32,
}

/// The largest level whose coordinates fit.
pub(super) const MAX_LEVEL: u32 = 31;

impl TileCoordinates {
    /// Returns a child. Bits 0, 1 and 2 of `child` choose the upper half along x, y and z.
    pub fn child(self, child: u32) -> Self {
        let Self { level, x, y, z } = self;
        Self { level: level + 1, x: 2 * x + (child & 1), y: 2 * y + (child >> 1 & 1), z: 2 * z + (child >> 2 & 1) }
    }
}

/// A tile inside a subtree.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalTile {
    /// The level in the subtree: 0 for its root.
    pub level: u32,
    /// The Morton index in the level: the bits of x, y (and z) interleaved, x lowest.
    pub morton: u64,
    pub coordinates: TileCoordinates,
}

impl LocalTile {
    /// Returns the root of a subtree.
    pub fn root(coordinates: TileCoordinates) -> Self {
        Self { level: 0, morton: 0, coordinates }
    }

    pub fn child(self, subdivision: Subdivision, child: u32) -> Self {
        let morton = self.morton << subdivision.bits() | u64::from(child);
        Self { level: self.level + 1, morton, coordinates: self.coordinates.child(child) }
    }

    /// Returns the index of the tile in the bitstreams of the subtree.
    pub fn index(self, subdivision: Subdivision) -> u64 {
        subdivision.tiles_above(self.level) + self.morton
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_follow_levels_and_morton_order() {
        for (subdivision, levels) in [(Subdivision::Quadtree, 5), (Subdivision::Octree, 4)] {
            let mut tiles = vec![LocalTile::root(TileCoordinates::default())];
            let mut expected = 0;
            for level in 0..levels {
                assert_eq!(tiles.len() as u64, subdivision.tiles_in(level));
                assert_eq!(subdivision.tiles_above(level), expected);
                for tile in &tiles {
                    assert_eq!(tile.index(subdivision), expected);
                    expected += 1;
                    let TileCoordinates { level: global, x, y, z } = tile.coordinates;
                    let morton: u64 = (0..level)
                        .map(|bit| {
                            let part = |value: u32, shift: u32| u64::from(value >> bit & 1) << shift;
                            (part(x, 0) | part(y, 1) | part(z, 2)) << (bit * subdivision.bits())
                        })
                        .sum();
                    assert_eq!((global, morton), (level, tile.morton));
                }
                let children = |tile: &LocalTile| {
                    let tile = *tile;
                    (0..subdivision.child_count()).map(move |child| tile.child(subdivision, child))
                };
                tiles = tiles.iter().flat_map(children).collect();
            }
        }
        let [quadtree, octree] = [Subdivision::Quadtree, Subdivision::Octree];
        assert!(quadtree.tiles_in(quadtree.max_subtree_levels()) > 1 << 59);
        assert!(octree.tiles_in(octree.max_subtree_levels()) > 1 << 59);
    }
}
