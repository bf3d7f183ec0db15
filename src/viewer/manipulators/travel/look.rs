//! [`Look`]: turns the direction of view with the pointer.

use std::f64::consts::PI;

use glam::{DAffine3, DVec3};

use crate::viewer::events::{EventKind, GuiEventAdapter, MouseButton, YOrientation};
use crate::viewer::manipulators::manipulator::ManipulatorView;
use crate::viewer::manipulators::pose::{heading_and_pitch, pose_from_angles, transport_heading};

/// The steepest direction of view up or down, radians.
pub(super) const MAX_PITCH: f64 = 89.0 * PI / 180.0;

/// The direction of view, turned by drags so that the point under the pointer stays there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Look {
    /// Radians clockwise from north.
    pub heading: f64,
    /// Radians above the horizon.
    pub pitch: f64,
    /// The last position of the pointer during a drag, pixels.
    last: Option<(f64, f64)>,
}

impl Look {
    /// Handles an event; returns true when it is a piece of a drag with the left or right button.
    pub fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        let position = event.state.position;
        let down = |button| event.state.buttons.contains(button);
        match event.kind {
            EventKind::Push(_) | EventKind::DoubleClick(_) => {
                self.last = Some((position.x, position.y));
                false
            }
            EventKind::Drag if down(MouseButton::Left) || down(MouseButton::Right) => {
                let Some((x, y)) = self.last.replace((position.x, position.y)) else { return false };
                let height = event.state.max.y - event.state.min.y;
                if height <= 0.0 {
                    return false;
                }
                let radians_per_px = view.camera.fovy(view.size_px) / height;
                let up = match event.state.y_orientation {
                    YOrientation::IncreasingUpwards => y - position.y,
                    YOrientation::IncreasingDownwards => position.y - y,
                };
                self.turn((x - position.x) * radians_per_px, up * radians_per_px);
                true
            }
            EventKind::Release(_) => {
                self.last = None;
                false
            }
            _ => false,
        }
    }

    /// Turns by radians clockwise and upwards.
    pub fn turn(&mut self, heading: f64, pitch: f64) {
        if heading.is_finite() && pitch.is_finite() {
            self.heading = (self.heading + heading).rem_euclid(2.0 * PI);
            self.pitch = (self.pitch + pitch).clamp(-MAX_PITCH, MAX_PITCH);
        }
    }

    /// Moves the eye to a position, and converts the heading to the frame there. A position that is not finite is ignored.
    pub fn move_eye(&mut self, position: &mut DVec3, moved: DVec3, view: &ManipulatorView<'_>) {
        if moved.is_finite() && moved != *position {
            self.heading = transport_heading(self.heading, &view.frame_at(*position), &view.frame_at(moved));
            *position = moved;
        }
    }

    /// Returns the pose of an eye at a position.
    pub fn pose(&self, position: DVec3, view: &ManipulatorView<'_>) -> DAffine3 {
        pose_from_angles(&view.frame_at(position).world_from_local.matrix3, position, self.heading, self.pitch)
    }

    /// Takes the direction of view from a pose.
    pub fn set_pose(&mut self, pose: &DAffine3, view: &ManipulatorView<'_>) {
        self.set(heading_and_pitch(&view.frame_at(pose.translation).world_from_local.matrix3, pose));
    }

    /// Sets heading and pitch, and ends a drag; values that are not finite are ignored.
    pub fn set(&mut self, (heading, pitch): (f64, f64)) {
        if heading.is_finite() && pitch.is_finite() {
            self.heading = heading.rem_euclid(2.0 * PI);
            self.pitch = pitch.clamp(-MAX_PITCH, MAX_PITCH);
        }
        self.last = None;
    }
}
