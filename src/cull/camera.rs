//! What cull needs to know of a camera.

use std::ops::{BitAnd, BitOr};

use glam::{DAffine3, DMat4};

use crate::math::Ellipsoid;

/// Bounds that project to fewer pixels are dropped where [`CullingMode::SMALL_FEATURE`] is on.
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
    /// Drops what projects to less than [`SMALL_FEATURE_PX`]; costs 10 to 14 % and the shortcut for subtrees that
    /// are wholly inside. Tiles are exempt: their error decides.
    pub const SMALL_FEATURE: Self = Self(4);
    /// Sides and near plane.
    pub const DEFAULT: Self = Self(1 | 2);

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

/// A camera for one cull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CullCamera {
    /// World to eye space (right-handed, looking down -z), metres.
    pub eye_from_world: DAffine3,
    /// Reversed-Z projection, infinitely far.
    pub clip_from_eye: DMat4,
    /// Width and height of the viewport.
    pub viewport_px: [u32; 2],
    /// Distances are multiplied by it: 2 is coarser, 0.5 finer.
    pub lod_scale: f64,
    /// A tile is refined where its error projects to more pixels.
    pub max_sse_px: f64,
    /// Nodes whose mask shares no bit with it are skipped.
    pub cull_mask: u32,
    /// Which culls are made.
    pub culling: CullingMode,
    /// The body of the earth, where the world is earth-centred: tiles wholly behind its horizon are culled. It must
    /// lie below everything that is drawn as ground.
    pub horizon: Option<Ellipsoid>,
    /// Stamped on tiles that are wanted; start at 1.
    pub frame: u32,
    /// Whose draw slots the leaves get.
    pub context: u32,
}

impl Default for CullCamera {
    /// At the world's origin, looking down -z, 60 degrees, 1024 x 1024, 16 pixels of error.
    fn default() -> Self {
        Self {
            eye_from_world: DAffine3::IDENTITY,
            clip_from_eye: glam::dcamera::rh::proj::directx::perspective_infinite_reverse(
                std::f64::consts::FRAC_PI_3,
                1.0,
                0.1,
            ),
            viewport_px: [1024, 1024],
            lod_scale: 1.0,
            max_sse_px: 16.0,
            cull_mask: u32::MAX,
            culling: CullingMode::DEFAULT,
            horizon: None,
            frame: 1,
            context: 0,
        }
    }
}

impl CullCamera {
    /// Pixels that one metre covers at a distance of one metre: `viewport height / (2 tan(fovy / 2))`.
    pub fn px_per_radian(&self) -> f64 {
        0.5 * f64::from(self.viewport_px[1]) * self.clip_from_eye.y_axis.y.abs()
    }
}
