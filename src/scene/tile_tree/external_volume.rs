//! Request volumes of external tilesets, as the tiles know them to which the tilesets are attached. Plain values.
//!
//! Children replace a tile's content only for eyes inside the request volumes of all of them. A child may be an external
//! tileset, whose root has the volume. The child keeps a copy from the merge of that tileset on (update thread); culls read
//! it. The copy survives the expiry of the tileset: from outside the volume the tileset is not requested, and without
//! the copy it would be loaded again only to learn that.

use glam::{DAffine3, DVec3};

use crate::math::BoundingVolume;

/// The request volume of the root of another tileset.
#[derive(Clone, Copy, Debug)]
pub(super) struct ExternalVolume {
    /// Maps the frame of the tile to which the tileset is attached to that of the root.
    root_from_tile: DAffine3,
    volume: BoundingVolume,
}

impl ExternalVolume {
    /// Creates a volume in the frame of the root itself.
    pub fn new(volume: BoundingVolume) -> Self {
        Self { root_from_tile: DAffine3::IDENTITY, volume }
    }

    /// Returns the same volume for the tile above, from whose frame `root_from_tile` maps.
    pub fn below(self, root_from_tile: &DAffine3) -> Self {
        Self { root_from_tile: self.root_from_tile * *root_from_tile, ..self }
    }

    /// Returns true if an eye, in the frame of the tile that holds the copy, is inside.
    pub fn contains(&self, eye: DVec3) -> bool {
        self.volume.contains(self.root_from_tile.transform_point3(eye))
    }
}
