//! [`OrbitState`]: an eye that orbits a point, with the vertical upright. The orbit, terrain and tracker manipulators use it.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DAffine3, DMat3, DVec3};

use crate::viewer::events::{EventKind, GuiEventAdapter};
use crate::viewer::manipulators::manipulator::ManipulatorView;
use crate::viewer::manipulators::motion::{Eased, Gesture, Pinch, Pointer, PointerMotion, Thrown};
use crate::viewer::manipulators::pose::{heading_and_pitch, heading_change, pose_from_angles};

/// The minimum distance from the eye to the point, metres.
pub(super) const MIN_DISTANCE_M: f64 = 0.05;
/// The maximum distance from the eye to the point, metres.
pub(super) const MAX_DISTANCE_M: f64 = 1e9;
/// The factor by which a notch of the wheel changes the distance.
pub(super) const FACTOR_PER_NOTCH: f64 = 0.8;

/// The position of an eye around a point, in a frame that the manipulator chooses, and the gestures that change it.
#[derive(Clone, Copy, Debug)]
pub(super) struct OrbitState {
    /// The direction of view, radians clockwise from the frame's y axis.
    pub heading: f64,
    /// The direction of view, radians above the frame's horizon; negative values look down.
    pub pitch: f64,
    /// The distance to the point, metres.
    pub distance_m: Eased,
    /// The minimum and maximum pitch, radians.
    pub pitch_limits: [f64; 2],
    pub pointer: Pointer,
}

impl Default for OrbitState {
    fn default() -> Self {
        Self {
            heading: 0.0,
            pitch: -0.6,
            distance_m: Eased::new(1.0, MIN_DISTANCE_M, MAX_DISTANCE_M),
            pitch_limits: [-FRAC_PI_2, FRAC_PI_2],
            pointer: Pointer::default(),
        }
    }
}

/// The part of a motion that the manipulator has to apply itself.
#[derive(Clone, Copy, Debug)]
pub(super) enum PointMotion {
    /// Nothing: rotation and zoom are applied.
    None,
    /// A pan, in image heights.
    Pan(DVec3),
    /// A gesture of several fingers.
    Pinch(Pinch),
}

impl OrbitState {
    /// Handles an event, and applies rotation and zoom; returns `None` when the event has no meaning here.
    pub fn handle(&mut self, event: &GuiEventAdapter) -> Option<PointMotion> {
        match self.pointer.handle(event) {
            Some(PointerMotion::Drag(drag)) => {
                self.pointer.moved(drag.gesture, drag.delta(), event.time_s);
                return Some(self.apply(drag.gesture, drag.delta()));
            }
            Some(PointerMotion::Pinch(pinch)) => return Some(PointMotion::Pinch(pinch)),
            None => {}
        }
        match event.kind {
            EventKind::Scroll(notches) => {
                self.distance_m.scale(FACTOR_PER_NOTCH.powf(notches.y.clamp(-50.0, 50.0)));
                Some(PointMotion::None)
            }
            _ => None,
        }
    }

    /// Advances by `dt_s` seconds, and applies thrown motions as [`Self::handle`] does.
    pub fn advance(&mut self, dt_s: f64) -> PointMotion {
        self.distance_m.advance(dt_s);
        match self.pointer.advance(dt_s) {
            Some(Thrown::Drag(gesture, motion)) => self.apply(gesture, motion),
            Some(Thrown::Pinch(pinch)) => PointMotion::Pinch(pinch),
            None => PointMotion::None,
        }
    }

    fn apply(&mut self, gesture: Gesture, motion: DVec3) -> PointMotion {
        match gesture {
            Gesture::Rotate => self.turn(PI * motion.x, PI * motion.y),
            Gesture::Zoom => self.distance_m.scale((-3.0 * motion.y).exp()),
            Gesture::Pan => return PointMotion::Pan(motion),
        }
        PointMotion::None
    }

    /// Applies the stretch and twist of a gesture about the point.
    pub fn stretch_and_twist(&mut self, pinch: &Pinch) {
        self.distance_m.shrink_now(pinch.stretch);
        self.turn(heading_change(pinch.twist, self.pitch), 0.0);
    }

    /// Turns the direction of view by radians clockwise and upwards.
    pub fn turn(&mut self, heading: f64, pitch: f64) {
        self.heading = (self.heading + heading).rem_euclid(2.0 * PI);
        self.set_pitch(self.pitch + pitch);
    }

    /// Sets the pitch within its limits; ignores NaN.
    pub fn set_pitch(&mut self, pitch: f64) {
        self.pitch = if pitch.is_nan() { self.pitch } else { pitch.clamp(self.pitch_limits[0], self.pitch_limits[1]) };
    }

    /// Returns the pose of the eye around `center`.
    pub fn pose(&self, frame: &DMat3, center: DVec3) -> DAffine3 {
        let turned = pose_from_angles(frame, center, self.heading, self.pitch);
        DAffine3 { translation: center + turned.matrix3.z_axis * self.distance_m.value, ..turned }
    }

    /// Takes the direction of view from a pose, and stops all motion.
    pub fn set_direction(&mut self, frame: &DMat3, pose: &DAffine3) {
        let (heading, pitch) = heading_and_pitch(frame, pose);
        if heading.is_finite() {
            self.heading = heading.rem_euclid(2.0 * PI);
        }
        self.set_pitch(pitch);
        self.pointer.stop();
    }

    /// Returns true while a motion continues without events.
    pub fn is_moving(&self) -> bool {
        self.pointer.is_moving() || self.distance_m.is_moving()
    }
}

/// Returns the distance from an eye to the point on its line of sight nearest to the centre of the bounds, metres. When the
/// centre is behind the eye, it returns the radius of the bounds.
pub(super) fn distance_to_center(pose: &DAffine3, view: &ManipulatorView<'_>) -> f64 {
    let along_m = (view.bounds.sphere.center - pose.translation).dot(-pose.matrix3.z_axis);
    if along_m > MIN_DISTANCE_M { along_m } else { view.bounds.sphere.radius_m.max(MIN_DISTANCE_M) }
}
