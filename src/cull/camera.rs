//! [`CullCamera`]: the input of one cull.

use glam::{DAffine3, DMat4};

use crate::math::Ellipsoid;
use crate::scene::{CullSettings, EyePoint, has_parallel_rays, px_per_radian};

/// A camera for one cull.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CullCamera {
    /// World to eye space (right-handed, looking down -z), metres.
    pub eye_from_world: DAffine3,
    /// Reversed-Z projection, infinitely far.
    pub clip_from_eye: DMat4,
    /// Width and height of the viewport.
    pub viewport_px: [u32; 2],
    /// Culling modes, error limits and levels of detail.
    pub settings: CullSettings,
    /// The body in a body-centred world: tiles wholly behind its horizon are culled. It must lie below all
    /// ground that is drawn.
    pub horizon: Option<Ellipsoid>,
    /// Time of the application in seconds, by which levels of detail fade ([`CullSettings::lod_fade_s`]).
    pub simulation_time_s: f64,
    /// Frame number that wanted tiles are stamped with, from 1. 0 stamps nothing, so that the cull keeps no page from
    /// expiring.
    pub frame: u32,
    /// Number of frames until the view is drawn, for a prefetch; 0 for the current frame. Tiles are then stamped with that
    /// later frame unless they are in use or wanted sooner, and do not fade.
    pub ahead_frames: u32,
    /// The graphics context whose draw slots the leaves refer to.
    pub context: u32,
    /// Tests the contents of tiles against the frustum. Without it, all drawables of a tile whose bounding volume is in view
    /// become leaves: the selection of tiles as 3D Tiles defines it.
    pub culls_contents: bool,
}

impl Default for CullCamera {
    /// Returns a camera at the world's origin, looking down -z, 60 degrees, 1024 x 1024, 16 pixels of error.
    fn default() -> Self {
        Self {
            eye_from_world: DAffine3::IDENTITY,
            clip_from_eye: glam::dcamera::rh::proj::directx::perspective_infinite_reverse(
                std::f64::consts::FRAC_PI_3,
                1.0,
                0.1,
            ),
            viewport_px: [1024, 1024],
            settings: CullSettings::default(),
            horizon: None,
            simulation_time_s: 0.0,
            frame: 1,
            ahead_frames: 0,
            context: 0,
            culls_contents: true,
        }
    }
}

impl CullCamera {
    /// Returns the pixels that one metre covers at a distance of one metre: `viewport height / (2 tan(fovy / 2))`. Under
    /// parallel rays it holds at any distance.
    pub fn px_per_radian(&self) -> f64 {
        px_per_radian(&self.clip_from_eye, self.viewport_px)
    }

    /// Returns the eye for an [`IntersectionVisitor`](crate::scene::IntersectionVisitor) that hits what this camera draws.
    pub fn eye_point(&self) -> EyePoint {
        EyePoint {
            world_from_eye: self.eye_from_world.inverse(),
            px_per_radian: self.px_per_radian(),
            is_parallel: has_parallel_rays(&self.clip_from_eye),
            max_sse_px: self.settings.max_sse_px,
            lod_scale: self.settings.lod_scale,
        }
    }
}
