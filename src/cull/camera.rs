//! What cull needs to know of a camera.

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
    /// What is culled and how.
    pub settings: CullSettings,
    /// The body of the earth, where the world is earth-centred: tiles wholly behind its horizon are culled. It must
    /// lie below everything that is drawn as ground.
    pub horizon: Option<Ellipsoid>,
    /// Seconds in the application's time, by which levels of detail fade ([`CullSettings::lod_fade_s`]).
    pub simulation_time_s: f64,
    /// Stamped on tiles that are wanted; start at 1. 0 stamps nothing: for a look that keeps nothing from expiring.
    pub frame: u32,
    /// In so many frames there will be such a picture: tiles that no picture wants now are stamped with that frame,
    /// unless they are wanted sooner, and tiles do not fade. 0 for a picture of this frame.
    pub ahead_frames: u32,
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
            settings: CullSettings::default(),
            horizon: None,
            simulation_time_s: 0.0,
            frame: 1,
            ahead_frames: 0,
            context: 0,
        }
    }
}

impl CullCamera {
    /// Pixels that one metre covers at a distance of one metre: `viewport height / (2 tan(fovy / 2))`. Where rays are
    /// parallel, at any distance.
    pub fn px_per_radian(&self) -> f64 {
        px_per_radian(&self.clip_from_eye, self.viewport_px)
    }

    /// The eye for an [`IntersectionVisitor`](crate::scene::IntersectionVisitor) that is to meet what this camera draws.
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
