//! What an intersection traversal visits: masks, levels of detail and the eye. Plain values.

use glam::{DAffine3, DVec3};

use crate::scene::settings::LodRanges;

/// Which level of detail is intersected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LodSelection {
    /// The finest that could be drawn: a tile's children as soon as all of them are loaded; of a Lod node what is
    /// shown nearest. OSG's `USE_HIGHEST_LEVEL_OF_DETAIL`.
    #[default]
    Highest,
    /// Tiles down to this depth (root 0) or to the finest loaded above it; of a Lod node what is shown nearest.
    Level(u32),
    /// What [`IntersectionVisitor::eye`] sees, by its error limit: what is drawn. Without an eye as `Highest`. OSG's
    /// `USE_EYE_POINT_FOR_LOD_LEVEL_SELECTION`.
    AsSeen,
}

/// The eye whose picture is intersected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyePoint {
    /// Eye space (looking down -z, y up) to world, without scale.
    pub world_from_eye: DAffine3,
    /// Pixels that one metre covers at a distance of one metre; at any distance where rays are parallel.
    pub px_per_radian: f64,
    /// The projection is no perspective one: errors are seen as large from anywhere.
    pub is_parallel: bool,
    /// A tile whose error projects to more pixels is refined.
    pub max_sse_px: f64,
    /// Distances are multiplied with it where levels are chosen.
    pub lod_scale: f64,
}

impl EyePoint {
    /// Place in the world.
    pub fn position(&self) -> DVec3 {
        self.world_from_eye.translation
    }

    /// Distances at which tiles are refined, as cull has them.
    pub(super) fn ranges(&self) -> LodRanges {
        LodRanges::new(self.px_per_radian, self.max_sse_px, self.lod_scale, self.is_parallel)
    }
}

/// What decides which nodes are visited.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    pub mask: u32,
    pub lods: LodSelection,
    pub eye: Option<EyePoint>,
}
