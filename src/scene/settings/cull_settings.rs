//! Which tests a camera culls with, and how: OSG's `CullSettings`. Plain values, read by culls.

use std::ops::{BitAnd, BitOr};

/// The default of [`CullSettings::small_feature_px`]: with [`CullingMode::SMALL_FEATURE`], bounds that project to fewer
/// pixels are culled.
pub const SMALL_FEATURE_PX: f64 = 2.0;

/// The set of culling tests that are made; OSG's `CullSettings::CullingMode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CullingMode(pub u32);

impl CullingMode {
    /// No tests: only what lies wholly behind the eye is culled.
    pub const NONE: Self = Self(0);
    /// Culls against the left, right, bottom and top planes.
    pub const VIEW_FRUSTUM_SIDES: Self = Self(1);
    /// Culls against the near plane.
    pub const NEAR_PLANE: Self = Self(2);
    /// Culls bounds that project to less than [`CullSettings::small_feature_px`]. Costs 10 to 14 % and disables the shortcut
    /// for subtrees wholly inside the frustum. Tiles are exempt: their error decides.
    pub const SMALL_FEATURE: Self = Self(4);
    /// Culls against the far plane, if the projection has one.
    pub const FAR_PLANE: Self = Self(8);
    /// Culls what OccluderNodes hide; free if there are none.
    pub const SHADOW_OCCLUSION: Self = Self(16);
    /// Culls drawables whose faces all look away ([`NormalCone`](crate::scene::NormalCone)); free if there are none.
    pub const CLUSTER: Self = Self(32);
    /// Culls meshes of at most 16 triangles that cover no pixel centre, so that the image does not change. The draw does
    /// this, except in multisampled targets and for programs.
    pub const SAMPLES: Self = Self(64);
    /// Sides, near and far plane.
    pub const VIEW_FRUSTUM: Self = Self(1 | 2 | 8);
    /// All tests except far plane and small features.
    pub const DEFAULT: Self = Self(1 | 2 | 16 | 32 | 64);
    /// The default of OpenSceneGraph: sides, small features, occluders and clusters. It culls what is smaller than two pixels,
    /// and costs 10 to 14 % more than [`Self::DEFAULT`].
    pub const REFERENCE: Self = Self(1 | 4 | 16 | 32);
    /// All tests.
    pub const ENABLE_ALL: Self = Self(127);

    /// Returns true if every flag of the other is set.
    pub const fn contains(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

impl Default for CullingMode {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl BitOr for CullingMode {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitAnd for CullingMode {
    type Output = Self;
    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

/// How the depth range of the projection is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ComputeNearFar {
    /// The projection is used as given.
    #[default]
    Off,
    /// Near (and far, if the projection has one) are fitted to the bounds of everything drawn.
    BoundingVolumes,
    /// Near and far are fitted to the visible primitives of drawables that have a [`KdTree`](crate::scene::KdTree), and to
    /// the bounds of others. Vertices moved by programs, and the turning of billboards, are ignored. Disables the shortcut
    /// for subtrees wholly inside the frustum and costs some microseconds for each drawable near the depth limits.
    Primitives,
}

/// The culling settings of a camera, which cameras below it may inherit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CullSettings {
    /// The tests that are made.
    pub culling: CullingMode,
    /// The smallest size on the screen for [`CullingMode::SMALL_FEATURE`].
    pub small_feature_px: f64,
    /// A factor on distances in the choice of levels of detail: 2 is coarser, 0.5 finer.
    pub lod_scale: f64,
    /// A tile is refined if its error projects to more pixels.
    pub max_sse_px: f64,
    /// Level skipping, like CesiumJS' `skipScreenSpaceErrorFactor`. While tiles refine, only levels whose error is smaller
    /// by this factor are requested; the levels between are never read. 16 skips up to four levels of a quadtree; 1 (or
    /// NaN) skips none, as OSG does. Tiles still stay until everything that replaces them is loaded.
    ///
    /// Skipping loads less for a frame, but detail arrives in larger steps. If a budget is too small or a server is slow,
    /// parts stay coarse for longer. A skipped tile is requested if something below it failed.
    pub skip_sse_factor: f64,
    /// The duration of the dithered cross-fade between levels of detail, in seconds of the application's time: between
    /// tiles and their children, and between children of Lods. 0 switches at once.
    ///
    /// A frame at the same time as the one before, or later by more than this duration, switches at once too, so that
    /// screenshots do not depend on timing. Objects that enter the view do not fade in.
    pub lod_fade_s: f64,
    /// Nodes whose mask has no bit in common are skipped.
    pub cull_mask: u32,
    /// The cull mask of the left eye in stereo.
    pub cull_mask_left: u32,
    /// The cull mask of the right eye in stereo.
    pub cull_mask_right: u32,
    /// How the depth range is found.
    pub compute_near_far: ComputeNearFar,
    /// The maximum number of OccluderNodes used in a view: those of the largest solid angle. Each costs some nanoseconds for
    /// each bound that is tested.
    pub max_occluders: u32,
    /// The smallest near distance, as a fraction of the far distance.
    pub near_far_ratio: f64,
    /// The maximum number of cameras in the graph with separate shadows ([`CameraNode::shadows`]) in one cull of a view's
    /// camera: each of their cascades is another cull and draw. Cameras met later have none and are counted in
    /// [`CullCounters::shadows_refused`]. Ignored in the settings of cameras in the graph.
    ///
    /// [`CameraNode::shadows`]: crate::scene::CameraNode::shadows
    /// [`CullCounters::shadows_refused`]: crate::cull::CullCounters::shadows_refused
    pub shadowed_cameras: u32,
}

impl Default for CullSettings {
    fn default() -> Self {
        Self {
            culling: CullingMode::DEFAULT,
            small_feature_px: SMALL_FEATURE_PX,
            lod_scale: 1.0,
            max_sse_px: 16.0,
            skip_sse_factor: 1.0,
            lod_fade_s: 0.25,
            cull_mask: u32::MAX,
            cull_mask_left: u32::MAX,
            cull_mask_right: u32::MAX,
            compute_near_far: ComputeNearFar::Off,
            max_occluders: 16,
            near_far_ratio: 0.0005,
            shadowed_cameras: 4,
        }
    }
}

/// The settings that a camera in the graph takes from the camera above; OSG's inheritance mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Inherit(pub u32);

impl Inherit {
    /// Nothing is inherited.
    pub const NONE: Self = Self(0);
    /// Culling mode, small feature size and number of occluders.
    pub const CULLING: Self = Self(1);
    /// LOD scale, maximum error, level skipping and duration of fades.
    pub const LOD_SCALE: Self = Self(2);
    /// Cull masks.
    pub const CULL_MASK: Self = Self(4);
    /// Depth range.
    pub const NEAR_FAR: Self = Self(8);
    /// The function that changes near and far, for a camera without its own
    /// ([`CameraNode::clamp_projection`](crate::scene::CameraNode::clamp_projection)).
    pub const CLAMP_PROJECTION: Self = Self(16);
    /// Everything is inherited.
    pub const ALL: Self = Self(31);

    pub(crate) const fn has(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }
}

impl BitOr for Inherit {
    type Output = Self;
    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl CullSettings {
    /// Returns these settings, with those of the mask taken from `above`.
    pub fn inheriting(mut self, above: &Self, mask: Inherit) -> Self {
        if mask.has(Inherit::CULLING) {
            (self.culling, self.small_feature_px) = (above.culling, above.small_feature_px);
            self.max_occluders = above.max_occluders;
        }
        if mask.has(Inherit::LOD_SCALE) {
            (self.lod_scale, self.max_sse_px) = (above.lod_scale, above.max_sse_px);
            (self.lod_fade_s, self.skip_sse_factor) = (above.lod_fade_s, above.skip_sse_factor);
        }
        if mask.has(Inherit::CULL_MASK) {
            self.cull_mask = above.cull_mask;
            (self.cull_mask_left, self.cull_mask_right) = (above.cull_mask_left, above.cull_mask_right);
        }
        if mask.has(Inherit::NEAR_FAR) {
            (self.compute_near_far, self.near_far_ratio) = (above.compute_near_far, above.near_far_ratio);
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_masked_settings_are_inherited() {
        let above = CullSettings { lod_scale: 3.0, cull_mask: 5, near_far_ratio: 0.1, ..CullSettings::default() };
        let own = CullSettings { culling: CullingMode::NONE, cull_mask: 2, ..CullSettings::default() };
        assert_eq!(own.inheriting(&above, Inherit::NONE), own);
        assert_eq!(own.inheriting(&above, Inherit::ALL), above);
        let masks = own.inheriting(&above, Inherit::CULL_MASK | Inherit::LOD_SCALE);
        assert_eq!((masks.cull_mask, masks.lod_scale, masks.culling), (5, 3.0, CullingMode::NONE));
    }
}
