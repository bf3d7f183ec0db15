//! [`CameraMotion`]: the manipulator of a view and the time that it moves in a frame.

use crate::viewer::manipulators::{CameraManipulator, GroundHeight};

/// Seconds that a manipulator at rest advances in a frame without events, enough to look for the ground below it.
const REST_STEP_S: f64 = 1.0 / 240.0;

/// The manipulator, the ground it may ask for, and how long it moves in the current frame.
pub(super) struct CameraMotion {
    manipulator: Option<Box<dyn CameraManipulator>>,
    ground: Option<Box<dyn GroundHeight>>,
    /// True when the manipulator was moving at the end of the last frame.
    was_moving: bool,
    /// The most seconds that the manipulator advances in this frame.
    max_step_s: f64,
}

impl Default for CameraMotion {
    fn default() -> Self {
        Self { manipulator: None, ground: None, was_moving: false, max_step_s: f64::INFINITY }
    }
}

impl CameraMotion {
    pub fn manipulator(&self) -> Option<&(dyn CameraManipulator + 'static)> {
        self.manipulator.as_deref()
    }

    pub fn set_manipulator(&mut self, manipulator: Option<Box<dyn CameraManipulator>>) {
        self.manipulator = manipulator;
    }

    pub fn take_manipulator(&mut self) -> Option<Box<dyn CameraManipulator>> {
        self.manipulator.take()
    }

    pub fn ground(&self) -> Option<&(dyn GroundHeight + 'static)> {
        self.ground.as_deref()
    }

    pub fn set_ground(&mut self, ground: Option<Box<dyn GroundHeight>>) {
        self.ground = ground;
    }

    /// Returns true when the manipulator would move the camera without further events.
    pub fn is_moving(&self) -> bool {
        self.manipulator().is_some_and(|manipulator| manipulator.is_moving())
    }

    /// Decides how long the manipulator moves in this frame. `first_event_age_s` is the age of the first event of the
    /// frame; `None` without events.
    ///
    /// A manipulator at rest starts to move with the first event, not with the start of the frame.
    pub fn begin_frame(&mut self, first_event_age_s: Option<f64>) {
        self.max_step_s = match first_event_age_s {
            _ if self.was_moving && self.is_moving() => f64::INFINITY,
            Some(age_s) => age_s.max(0.0),
            None => REST_STEP_S,
        };
    }

    /// Returns the seconds that the manipulator advances in a frame of `dt_s` seconds.
    pub fn step_s(&self, dt_s: f64) -> f64 {
        dt_s.min(self.max_step_s)
    }

    /// Remembers whether the manipulator moves into the next frame.
    pub fn end_frame(&mut self) {
        self.was_moving = self.is_moving();
    }
}
