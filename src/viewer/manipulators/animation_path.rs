//! [`AnimationPathManipulator`]: plays a camera path.

use glam::DAffine3;

use super::manipulator::{CameraManipulator, ManipulatorView};
use crate::viewer::camera_path::{AnimationPath, LoopMode};
use crate::viewer::events::{GuiEventAdapter, Key, Usage};

/// Moves the camera along a path; OSG's `AnimationPathManipulator`.
#[derive(Clone, Debug)]
pub struct AnimationPathManipulator {
    path: AnimationPath,
    /// Seconds since the start of the path.
    at_s: f64,
    /// Seconds of the path per second of real time.
    pub time_scale: f64,
    /// True while the camera stands still.
    pub is_paused: bool,
}

impl AnimationPathManipulator {
    /// Creates a manipulator that plays a path from its start.
    pub fn new(path: AnimationPath) -> Self {
        Self { path, at_s: 0.0, time_scale: 1.0, is_paused: false }
    }

    /// Returns the path.
    pub fn path(&self) -> &AnimationPath {
        &self.path
    }

    fn rescale(&mut self, factor: f64) {
        self.time_scale = (self.time_scale * factor).clamp(1.0 / 64.0, 64.0);
    }
}

impl CameraManipulator for AnimationPathManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, _: &ManipulatorView<'_>) -> bool {
        match event.key_pressed() {
            Some(Key::Char('p')) => self.is_paused = !self.is_paused,
            Some(Key::Char('(')) => self.rescale(0.5),
            Some(Key::Char(')')) => self.rescale(2.0),
            _ => return false,
        }
        true
    }

    fn advance(&mut self, dt_s: f64, _: &ManipulatorView<'_>) -> DAffine3 {
        let step_s = dt_s * self.time_scale;
        if !self.is_paused && step_s.is_finite() && step_s > 0.0 {
            self.at_s += step_s;
        }
        self.path.world_from_eye(self.path.first_s() + self.at_s)
    }

    /// Does nothing, because the pose depends on the path alone.
    fn set_pose(&mut self, _: &DAffine3, _: &ManipulatorView<'_>) {}

    fn home(&mut self, _: &ManipulatorView<'_>) {
        self.at_s = 0.0;
    }

    /// Returns true at the end of a path that does not loop.
    fn is_finished(&self) -> bool {
        self.path.loop_mode == LoopMode::NoLooping && self.at_s >= self.path.duration_s()
    }

    fn is_moving(&self) -> bool {
        !self.is_paused && !self.is_finished()
    }

    fn pose_after(&self, seconds: f64) -> Option<DAffine3> {
        let step_s = if self.is_paused { 0.0 } else { seconds * self.time_scale };
        Some(self.path.world_from_eye(self.path.first_s() + self.at_s + step_s))
    }

    fn usage(&self) -> Vec<Usage> {
        vec![Usage::new("P", "pause the path"), Usage::new("( )", "play it at half or double speed")]
    }
}
