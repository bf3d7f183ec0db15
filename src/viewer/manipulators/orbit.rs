//! Around a point with the vertical upright; what terrain and tracker manipulators are made of.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DAffine3, DMat3, DVec3};

use super::inertia::{Eased, Gesture, Moved, Pointer, Thrown};
use super::touch::Pinch;
use super::{CameraManipulator, ManipulatorView, heading_and_pitch, looking, usage};
use crate::viewer::events::{EventKind, GuiEventAdapter, Usage};

/// Nearest and farthest, metres.
pub(super) const NEAREST_M: f64 = 0.05;
pub(super) const FARTHEST_M: f64 = 1e9;
/// Each notch of the wheel leaves this share of the distance.
pub(super) const NOTCH: f64 = 0.8;

/// Where the eye is around a point, in a frame that the manipulator has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Around {
    /// Radians clockwise from the frame's y.
    pub heading: f64,
    /// Radians above the frame's horizon; negative looks down.
    pub pitch: f64,
    /// Metres to the point.
    pub distance_m: Eased,
    /// Least and greatest pitch.
    pub pitches: [f64; 2],
    pub pointer: Pointer,
}

impl Default for Around {
    fn default() -> Self {
        Self {
            heading: 0.0,
            pitch: -0.6,
            distance_m: Eased::new(1.0, NEAREST_M, FARTHEST_M),
            pitches: [-FRAC_PI_2, FRAC_PI_2],
            pointer: Pointer::default(),
        }
    }
}

/// What a manipulator around a point does itself.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shift {
    /// Nothing is left to do.
    None,
    /// Picture heights.
    Pan(DVec3),
    /// What several fingers do.
    Pinch(Pinch),
}

impl Around {
    /// Rotation and zoom of the pointer are done here; `None` for what means nothing.
    pub fn handle(&mut self, event: &GuiEventAdapter) -> Option<Shift> {
        match self.pointer.handle(event) {
            Some(Moved::Drag(drag)) => {
                self.pointer.moved(drag.gesture, drag.delta(), event.time_s);
                return Some(self.apply(drag.gesture, drag.delta()));
            }
            Some(Moved::Pinch(pinch)) => return Some(Shift::Pinch(pinch)),
            None => {}
        }
        match event.kind {
            EventKind::Scroll(notches) => {
                self.distance_m.scale(NOTCH.powf(notches.y.clamp(-50.0, 50.0)));
                Some(Shift::None)
            }
            _ => None,
        }
    }

    /// As [`Self::handle`], with what is thrown.
    pub fn advance(&mut self, dt_s: f64) -> Shift {
        self.distance_m.advance(dt_s);
        match self.pointer.advance(dt_s) {
            Some(Thrown::Drag(gesture, motion)) => self.apply(gesture, motion),
            Some(Thrown::Pinch(pinch)) => Shift::Pinch(pinch),
            None => Shift::None,
        }
    }

    fn apply(&mut self, gesture: Gesture, motion: DVec3) -> Shift {
        match gesture {
            Gesture::Rotate => self.turn(PI * motion.x, PI * motion.y),
            Gesture::Zoom => self.distance_m.scale((-3.0 * motion.y).exp()),
            Gesture::Pan => return Shift::Pan(motion),
        }
        Shift::None
    }

    /// Stretches and turns as fingers do, about the point looked at.
    pub fn stretch_and_twist(&mut self, pinch: &Pinch) {
        self.distance_m.shrink_now(pinch.stretch);
        self.turn(turned_by(pinch.twist, self.pitch), 0.0);
    }

    /// Turns, radians clockwise and up.
    pub fn turn(&mut self, heading: f64, pitch: f64) {
        self.heading = (self.heading + heading).rem_euclid(2.0 * PI);
        self.set_pitch(self.pitch + pitch);
    }

    pub fn set_pitch(&mut self, pitch: f64) {
        self.pitch = if pitch.is_nan() { self.pitch } else { pitch.clamp(self.pitches[0], self.pitches[1]) };
    }

    /// The pose around a point.
    pub fn pose(&self, frame: &DMat3, center: DVec3) -> DAffine3 {
        let turned = looking(frame, center, self.heading, self.pitch);
        DAffine3 { translation: center + turned.matrix3.z_axis * self.distance_m.value, ..turned }
    }

    /// Looks as a pose does.
    pub fn set_direction(&mut self, frame: &DMat3, pose: &DAffine3) {
        let (heading, pitch) = heading_and_pitch(frame, pose);
        if heading.is_finite() {
            self.heading = heading.rem_euclid(2.0 * PI);
        }
        self.set_pitch(pitch);
        self.pointer.stop();
    }

    pub fn is_moving(&self) -> bool {
        self.pointer.is_moving() || self.distance_m.is_moving()
    }
}

/// Radians clockwise that turn the picture counterclockwise by so many, about the vertical: from below it looks the
/// other way round.
pub(super) fn turned_by(twist: f64, pitch: f64) -> f64 {
    if pitch > 0.0 { -twist } else { twist }
}

/// The metres from an eye to what it looks at: where it is nearest to the middle of the bounds.
pub(super) fn distance_to_middle(pose: &DAffine3, view: &ManipulatorView<'_>) -> f64 {
    let along_m = (view.bounds.sphere.center - pose.translation).dot(-pose.matrix3.z_axis);
    if along_m > NEAREST_M { along_m } else { view.bounds.sphere.radius_m.max(NEAREST_M) }
}

/// Looks at a point from around it, the vertical upright: drags rotate, pan and zoom; OSG's `OrbitManipulator`.
#[derive(Clone, Copy, Debug, Default)]
pub struct OrbitManipulator {
    center: DVec3,
    around: Around,
}

impl OrbitManipulator {
    /// The point looked at, world.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// Metres from the eye to the point.
    pub fn distance_m(&self) -> f64 {
        self.around.distance_m.value
    }

    fn pan(&mut self, motion: DVec3, view: &ManipulatorView<'_>) {
        let pose = self.around.pose(&view.frame_at(self.center).world_from_local.matrix3, self.center);
        let moved_m = pose.matrix3 * (-motion * view.picture_height() * self.distance_m());
        if moved_m.is_finite() {
            self.center += moved_m;
        }
    }
}

impl OrbitManipulator {
    /// What is under the middle of the fingers, in the plane of the point looked at, stays under it.
    fn pinch(&mut self, pinch: &Pinch, view: &ManipulatorView<'_>) {
        let eye_axes = |orbit: &Self, center: DVec3| {
            orbit.around.pose(&view.frame_at(center).world_from_local.matrix3, center).matrix3
        };
        let scale_m = view.picture_height() * self.distance_m();
        let under = self.center + eye_axes(self, self.center) * (pinch.from * scale_m).extend(0.0);
        self.around.stretch_and_twist(pinch);
        let scale_m = view.picture_height() * self.distance_m();
        let mut center = self.center;
        // The vertical is another elsewhere.
        for _ in 0..3 {
            center = under - eye_axes(self, center) * (pinch.to * scale_m).extend(0.0);
        }
        if center.is_finite() {
            self.center = center;
        }
    }

    fn shift(&mut self, shift: Shift, view: &ManipulatorView<'_>) {
        match shift {
            Shift::None => {}
            Shift::Pan(motion) => self.pan(motion, view),
            Shift::Pinch(pinch) => self.pinch(&pinch, view),
        }
    }
}

impl CameraManipulator for OrbitManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, view: &ManipulatorView<'_>) -> bool {
        let shift = self.around.handle(event);
        shift.into_iter().for_each(|shift| self.shift(shift, view));
        shift.is_some()
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        let shift = self.around.advance(dt_s);
        self.shift(shift, view);
        self.around.pose(&view.frame_at(self.center).world_from_local.matrix3, self.center)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if !world_from_eye.is_finite() {
            return;
        }
        self.around.distance_m.set(distance_to_middle(world_from_eye, view));
        self.center = world_from_eye.translation - world_from_eye.matrix3.z_axis * self.distance_m();
        self.around.set_direction(&view.frame_at(self.center).world_from_local.matrix3, world_from_eye);
    }

    fn is_moving(&self) -> bool {
        self.around.is_moving()
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            usage("Left drag", "orbit"),
            usage("Middle drag, Shift+left drag", "pan"),
            usage("Right drag, wheel", "zoom"),
            usage("Two fingers", "pan, zoom and turn"),
        ]
    }
}
