//! What a camera culls and how: OSG's `CullSettings`. Plain values; read by cull.

use std::ops::{BitAnd, BitOr};

/// Bounds that project to fewer pixels are dropped where [`CullingMode::SMALL_FEATURE`] is on, unless
/// [`CullSettings::small_feature_px`] says otherwise.
pub const SMALL_FEATURE_PX: f64 = 2.0;

/// Which culls are made; OSG's `CullSettings::CullingMode`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CullingMode(pub u32);

impl CullingMode {
    /// Nothing is culled but what lies wholly behind the eye.
    pub const NONE: Self = Self(0);
    /// Against the left, right, bottom and top planes.
    pub const VIEW_FRUSTUM_SIDES: Self = Self(1);
    /// Against the near plane.
    pub const NEAR_PLANE: Self = Self(2);
    /// Drops what projects to less than [`CullSettings::small_feature_px`]; costs 10 to 14 % and the shortcut for
    /// subtrees that are wholly inside. Tiles are exempt: their error decides.
    pub const SMALL_FEATURE: Self = Self(4);
    /// Against the far plane, where the projection has one.
    pub const FAR_PLANE: Self = Self(8);
    /// Against the shadows of OccluderNodes; free where there is none.
    pub const SHADOW_OCCLUSION: Self = Self(16);
    /// Drawables whose faces all look away ([`NormalCone`](crate::scene::NormalCone)); free where there is none.
    pub const CLUSTER: Self = Self(32);
    /// Meshes of at most 16 triangles that lie wholly between the centres of pixels, which no pixel shows: the picture
    /// is the same without them. Done where it is drawn; not in targets of several samples, and not for programs.
    pub const SAMPLES: Self = Self(64);
    /// Sides, near and far plane.
    pub const VIEW_FRUSTUM: Self = Self(1 | 2 | 8);
    /// All but far plane and small features.
    pub const DEFAULT: Self = Self(1 | 2 | 16 | 32 | 64);
    /// Everything.
    pub const ENABLE_ALL: Self = Self(127);

    /// True when every flag of the other is set.
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

/// Whether the projection's depth range follows what cull kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ComputeNearFar {
    /// The projection stays as it is given.
    #[default]
    Off,
    /// Near (and far, where the projection has one) fit the bounds of what is drawn.
    BoundingVolumes,
    /// They fit what is seen of its triangles, lines and points: of the drawables that have a
    /// [`KdTree`](crate::scene::KdTree); of others the bounds. Programs that move vertices are not heeded, nor is that
    /// billboards turn. Costs the shortcut for subtrees that are wholly inside, and some microseconds for each drawable
    /// around the nearest and the farthest depth.
    Primitives,
}

/// Settings of a camera that those below it may inherit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CullSettings {
    /// Which culls are made.
    pub culling: CullingMode,
    /// Smallest size on the screen for [`CullingMode::SMALL_FEATURE`].
    pub small_feature_px: f64,
    /// Distances are multiplied by it: 2 is coarser, 0.5 finer.
    pub lod_scale: f64,
    /// A tile is refined where its error projects to more pixels.
    pub max_sse_px: f64,
    /// Of tiles that their children will replace, those are asked for alone that show what is there so many times finer;
    /// the levels between are skipped, and never read. 16 is four levels of a quadtree; at 1 (or no number) none is
    /// skipped, as with OSG. Nothing else changes: no tile gives way before all that takes its place is there. With
    /// levels skipped less is loaded for a picture, but its parts come in larger steps, and where a budget is too small
    /// for all of it, or a server slow, they stay coarse for longer. What is skipped is asked for where something below
    /// it failed. CesiumJS' `skipScreenSpaceErrorFactor`.
    pub skip_sse_factor: f64,
    /// Seconds of the application's time in which a level of detail gives way to another, both dithered, so that
    /// neither pops: tiles with their children, and children of Lods. 0 changes them at once. So does a frame that
    /// comes later after the one before than this, and one at the same time: pictures that are meant to be
    /// the same whenever they are made are. What comes into the view is there at once.
    pub lod_fade_s: f64,
    /// Nodes whose mask shares no bit with it are skipped.
    pub cull_mask: u32,
    /// As `cull_mask`, for the left eye where stereo is drawn.
    pub cull_mask_left: u32,
    /// As `cull_mask`, for the right eye.
    pub cull_mask_right: u32,
    /// How the depth range is found.
    pub compute_near_far: ComputeNearFar,
    /// Least near distance as a share of the far one.
    pub near_far_ratio: f64,
    /// Cameras in the graph that may have shadows of their own ([`CameraNode::shadows`]) in one cull of a view's camera:
    /// each is culled and drawn once more for each of its cascades. Those met later have none, and are counted
    /// ([`CullCounters::shadows_refused`]). Of cameras in the graph themselves it is not heeded.
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
            near_far_ratio: 0.0005,
            shadowed_cameras: 4,
        }
    }
}

/// Which settings a camera in the graph takes from the one above; OSG's inheritance mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Inherit(pub u32);

impl Inherit {
    /// Everything is the camera's own.
    pub const NONE: Self = Self(0);
    /// Culling mode and small feature size.
    pub const CULLING: Self = Self(1);
    /// LOD scale, largest error, skipping of levels and length of fades.
    pub const LOD_SCALE: Self = Self(2);
    /// Cull masks.
    pub const CULL_MASK: Self = Self(4);
    /// Depth range.
    pub const NEAR_FAR: Self = Self(8);
    /// Everything is that of the camera above.
    pub const ALL: Self = Self(15);

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
    /// These settings, with those of the mask taken from above.
    pub fn inheriting(mut self, above: &Self, mask: Inherit) -> Self {
        if mask.has(Inherit::CULLING) {
            (self.culling, self.small_feature_px) = (above.culling, above.small_feature_px);
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
    fn only_what_the_mask_names_comes_from_above() {
        let above = CullSettings { lod_scale: 3.0, cull_mask: 5, near_far_ratio: 0.1, ..CullSettings::default() };
        let own = CullSettings { culling: CullingMode::NONE, cull_mask: 2, ..CullSettings::default() };
        assert_eq!(own.inheriting(&above, Inherit::NONE), own);
        assert_eq!(own.inheriting(&above, Inherit::ALL), above);
        let masks = own.inheriting(&above, Inherit::CULL_MASK | Inherit::LOD_SCALE);
        assert_eq!((masks.cull_mask, masks.lod_scale, masks.culling), (5, 3.0, CullingMode::NONE));
    }
}
