//! [`Slave`]: a camera that follows the master camera of its view, in another window or another part of one.

use glam::{DAffine3, DMat4};

use super::eyes::{EyeTargets, Eyes};
use super::viewport::ViewArea;
use crate::cull::CullCamera;
use crate::scene::{CullSettings, Inherit};
use crate::viewer::ids::{ContextId, SlaveId};

/// A camera that follows the master camera of its view: another eye, another window or another part of one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slave {
    /// The context in which the slave is drawn.
    pub context: ContextId,
    /// The part of the context that the slave covers.
    pub viewport: ViewArea,
    /// A transform of the master's clip space. A shift by 2 in x shows the area beside the master's image.
    pub projection_offset: DMat4,
    /// The transform from the master's eye space to the slave's.
    pub view_offset: DAffine3,
    /// The eyes that the slave draws for, where the view is drawn in stereo.
    pub eyes: Eyes,
    /// The slave's own cull settings.
    pub settings: CullSettings,
    /// The settings that are taken from the master instead.
    pub inherit: Inherit,
}

impl Slave {
    /// Returns a slave that sees the same as the master, in the whole of a context.
    pub fn new(context: ContextId) -> Self {
        Self {
            context,
            viewport: ViewArea::Whole,
            projection_offset: DMat4::IDENTITY,
            view_offset: DAffine3::IDENTITY,
            eyes: Eyes::Both,
            settings: CullSettings::default(),
            inherit: Inherit::ALL,
        }
    }

    /// Returns the projection offset, or the identity when it is not finite.
    pub(super) fn finite_projection_offset(&self) -> DMat4 {
        if self.projection_offset.is_finite() { self.projection_offset } else { DMat4::IDENTITY }
    }

    /// Moves the master's cull camera to the slave. `clip_from_eye` includes the projection offset.
    pub(super) fn cull_camera(&self, master: CullCamera, clip_from_eye: DMat4, size_px: [u32; 2]) -> CullCamera {
        let view_offset = if self.view_offset.is_finite() { self.view_offset } else { DAffine3::IDENTITY };
        CullCamera {
            eye_from_world: view_offset * master.eye_from_world,
            clip_from_eye,
            viewport_px: size_px,
            settings: self.settings.inheriting(&master.settings, self.inherit),
            ..master
        }
    }
}

/// The slot of a camera in a context: the part of the target in which it is drawn.
#[derive(Clone, Copy, Debug)]
pub(in crate::viewer) struct CameraSlot {
    /// Number of the camera.
    pub(in crate::viewer) camera: u32,
    pub(in crate::viewer) context: u32,
    /// Number of the context's device; draw slots of pages are kept per device.
    pub(in crate::viewer) device: u32,
    pub(in crate::viewer) viewport: ViewArea,
    /// Size of the context's target when the view was last prepared.
    pub(in crate::viewer) context_px: [u32; 2],
}

impl CameraSlot {
    /// Returns the part of the target as x, y, width and height in pixels; `None` is all of it.
    pub(in crate::viewer) fn part_px(&self) -> Option<[u32; 4]> {
        self.viewport.part_px(self.context_px)
    }
}

/// A slave with the state that follows from its context.
pub(super) struct SlaveCamera {
    pub(super) id: SlaveId,
    /// Number of its context's device.
    pub(super) device: u32,
    /// Size of its context's target.
    pub(super) context_px: [u32; 2],
    pub(super) slave: Slave,
    pub(super) eye_targets: EyeTargets,
}

impl SlaveCamera {
    pub(super) fn new(slot: CameraSlot, slave: Slave) -> Self {
        let CameraSlot { camera, device, context_px, .. } = slot;
        let eye_targets = EyeTargets::new(slave.viewport.image_px(context_px));
        Self { id: SlaveId(camera), device, context_px, slave, eye_targets }
    }
}
