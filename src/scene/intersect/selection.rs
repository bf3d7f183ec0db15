//! The rules of an intersection traversal: masks, levels of detail and the eye. Plain values.

use glam::{DAffine3, DVec3};

use crate::scene::settings::LodRanges;

/// The level of detail that is intersected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LodSelection {
    /// The finest level that could be drawn: the children of a tile if all of them are loaded, the nearest range of a Lod node.
    /// OSG's `USE_HIGHEST_LEVEL_OF_DETAIL`.
    #[default]
    Highest,
    /// Tiles down to this depth (root 0), or to the finest loaded level above it; the nearest range of a Lod node.
    Level(u32),
    /// The level that is drawn for [`IntersectionVisitor::eye`](super::IntersectionVisitor::eye); without an eye as `Highest`.
    /// OSG's `USE_EYE_POINT_FOR_LOD_LEVEL_SELECTION`.
    AsSeen,
}

/// The eye whose view is intersected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyePoint {
    /// Eye space (looking down -z, y up) to world, without scale.
    pub world_from_eye: DAffine3,
    /// The number of pixels that one metre covers at a distance of one metre, or at any distance if rays are parallel.
    pub px_per_radian: f64,
    /// True if the projection is not a perspective one: errors look equally large from anywhere.
    pub is_parallel: bool,
    /// A tile is refined if its error projects to more pixels.
    pub max_sse_px: f64,
    /// A factor on distances in the choice of levels of detail.
    pub lod_scale: f64,
}

impl EyePoint {
    /// Returns the eye's position in the world.
    pub fn position(&self) -> DVec3 {
        self.world_from_eye.translation
    }

    /// Returns the distances at which tiles are refined, as culls use them.
    pub(super) fn ranges(&self) -> LodRanges {
        LodRanges::new(self.px_per_radian, self.max_sse_px, self.lod_scale, self.is_parallel)
    }
}

/// The rules that decide which nodes are visited.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    pub mask: u32,
    pub lods: LodSelection,
    pub eye: Option<EyePoint>,
}
