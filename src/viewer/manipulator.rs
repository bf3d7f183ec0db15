//! Camera manipulators: events in, the eye's pose out. Called in the event phase, on the main thread.

use glam::{DAffine3, DVec3};

use super::camera::world_from_eye;
use super::home::{LocalFrame, SetBounds};

/// Something that happened between two frames, free of any window library.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A movement key went down or up.
    Key {
        /// Which way it moves.
        key: MoveKey,
        /// True while held.
        pressed: bool,
    },
    /// The pointer was dragged, in pixels to the right and down.
    Drag([f64; 2]),
    /// The wheel turned, in notches away from the user.
    Wheel(f64),
    /// Input went elsewhere: all keys count as up.
    FocusLost,
}

/// A direction of movement; W, S, A, D or the arrows, Q and E.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MoveKey {
    /// W, arrow up.
    Forward,
    /// S, arrow down.
    Backward,
    /// A, arrow left.
    Left,
    /// D, arrow right.
    Right,
    /// E, page up.
    Up,
    /// Q, page down.
    Down,
}

/// Moves a camera.
pub trait CameraManipulator: Send {
    /// Takes one event; called before `advance` of the same frame.
    fn handle(&mut self, event: &Event);
    /// The pose after `dt_s` more seconds.
    fn advance(&mut self, dt_s: f64) -> DAffine3;
    /// Starts again from a pose.
    fn set_pose(&mut self, world_from_eye: &DAffine3);
}

/// Flies like a free camera: keys move along the view, dragging looks around, the wheel changes the speed.
///
/// The speed is proportional to the height above the set's top (and to the distance, outside), so that one key
/// works from orbit to the ground; motion is integrated in small fixed steps, so the frame rate does not matter.
#[derive(Clone, Debug)]
pub struct FlyManipulator {
    bounds: SetBounds,
    position: DVec3,
    /// Radians clockwise from north (+y of the local frame).
    heading: f64,
    /// Radians above the horizon.
    pitch: f64,
    held: [bool; 6],
    /// Factor set by the wheel.
    pub speed_factor: f64,
    /// Radians turned per dragged pixel.
    pub radians_per_px: f64,
}

/// Longest step of the integration; at 1 % growth a step the path differs by less than that between frame rates.
const MAX_STEP_S: f64 = 1.0 / 240.0;
const MAX_PITCH: f64 = 89.0 * std::f64::consts::PI / 180.0;

impl FlyManipulator {
    /// A manipulator that starts at a pose, with speeds fit to a set's bounds.
    pub fn new(bounds: SetBounds, pose: &DAffine3) -> Self {
        let mut new = Self {
            bounds,
            position: DVec3::ZERO,
            heading: 0.0,
            pitch: 0.0,
            held: [false; 6],
            speed_factor: 1.0,
            radians_per_px: 0.003,
        };
        new.set_pose(pose);
        new
    }

    /// Metres per second at the present place.
    pub fn speed_m_per_s(&self) -> f64 {
        let radius_m = self.bounds.sphere.radius_m.max(1e-3);
        let outside_m = self.position.distance(self.bounds.sphere.center) - radius_m;
        let height_m = self.bounds.height_above_top_m(self.position);
        // Half a height a second; never so slow that crossing the set takes more than five minutes.
        self.speed_factor * (0.5 * height_m.max(outside_m)).max(radius_m / 150.0)
    }

    fn direction_of_keys(&self) -> DVec3 {
        let held = |key: MoveKey| f64::from(u8::from(self.held.get(key as usize).copied().unwrap_or(false)));
        DVec3::new(
            held(MoveKey::Right) - held(MoveKey::Left),
            held(MoveKey::Up) - held(MoveKey::Down),
            held(MoveKey::Backward) - held(MoveKey::Forward),
        )
        .normalize_or_zero()
    }

    fn pose(&self) -> DAffine3 {
        let frame = LocalFrame::at(self.position, self.bounds.frame.georeferenced);
        let direction = frame.direction(self.heading, self.pitch);
        world_from_eye(self.position, direction, frame.up())
    }
}

impl CameraManipulator for FlyManipulator {
    fn handle(&mut self, event: &Event) {
        match *event {
            Event::Key { key, pressed } => {
                if let Some(held) = self.held.get_mut(key as usize) {
                    *held = pressed;
                }
            }
            Event::Drag([right_px, down_px]) => {
                self.heading += right_px * self.radians_per_px;
                self.pitch = (self.pitch - down_px * self.radians_per_px).clamp(-MAX_PITCH, MAX_PITCH);
            }
            Event::Wheel(notches) => {
                self.speed_factor = (self.speed_factor * 1.25f64.powf(notches.clamp(-20.0, 20.0))).clamp(0.01, 100.0);
            }
            Event::FocusLost => self.held = [false; 6],
        }
    }

    fn advance(&mut self, dt_s: f64) -> DAffine3 {
        let direction_in_eye = self.direction_of_keys();
        if direction_in_eye != DVec3::ZERO && dt_s > 0.0 {
            // A frame that took seconds (a debugger, a suspended machine) must not fling the camera away.
            let dt_s = dt_s.min(0.5);
            let steps = (dt_s / MAX_STEP_S).ceil();
            for _ in 0..steps as u32 {
                let in_world = self.pose().matrix3 * direction_in_eye;
                self.position += in_world * (self.speed_m_per_s() * dt_s / steps);
            }
        }
        self.pose()
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3) {
        self.position = world_from_eye.translation;
        let frame = LocalFrame::at(self.position, self.bounds.frame.georeferenced);
        let direction = frame.world_from_local.matrix3.transpose() * -world_from_eye.matrix3.z_axis;
        let upward = frame.world_from_local.matrix3.transpose() * world_from_eye.matrix3.y_axis;
        // Looking straight down, the heading is where the picture's top points.
        let flat = if direction.truncate().length() > 1e-6 { direction } else { upward };
        self.heading = flat.x.atan2(flat.y);
        self.pitch = direction.z.clamp(-1.0, 1.0).asin().clamp(-MAX_PITCH, MAX_PITCH);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::BoundingSphere;

    fn fly(frames: u32, keys: &[MoveKey]) -> DVec3 {
        let bounds = SetBounds::from_sphere(BoundingSphere::new(DVec3::ZERO, 1000.0));
        let pose = world_from_eye(DVec3::new(0.0, -3000.0, 2000.0), DVec3::new(0.0, 1.0, -0.3), DVec3::Z);
        let mut manipulator = FlyManipulator::new(bounds, &pose);
        for key in keys {
            manipulator.handle(&Event::Key { key: *key, pressed: true });
        }
        (0..frames).fold(DVec3::ZERO, |_, _| manipulator.advance(1.0 / f64::from(frames)).translation)
    }

    #[test]
    fn the_frame_rate_does_not_matter() {
        for keys in [&[MoveKey::Forward][..], &[MoveKey::Up, MoveKey::Right], &[MoveKey::Backward, MoveKey::Down]] {
            let (slow, quick) = (fly(7, keys), fly(144, keys));
            let moved = quick.distance(DVec3::new(0.0, -3000.0, 2000.0));
            assert!(moved > 100.0 && slow.distance(quick) < 0.01 * moved, "{slow} {quick}");
        }
    }

    #[test]
    fn a_pose_survives() {
        let bounds = SetBounds::from_sphere(BoundingSphere::new(DVec3::new(4.2e6, 1.0e6, 4.6e6), 5000.0));
        let frame = bounds.frame;
        let eye = frame.world_from_local.transform_point3(DVec3::new(10.0, 20.0, 3000.0));
        let pose = world_from_eye(eye, frame.direction(1.2, -0.7), LocalFrame::at(eye, true).up());
        let mut manipulator = FlyManipulator::new(bounds, &pose);
        let back = manipulator.advance(0.016);
        assert!(back.translation == eye && (back.matrix3.z_axis - pose.matrix3.z_axis).length() < 1e-3);
    }

    #[test]
    fn the_wheel_changes_the_speed() {
        let bounds = SetBounds::from_sphere(BoundingSphere::new(DVec3::ZERO, 1000.0));
        let mut manipulator = FlyManipulator::new(bounds, &DAffine3::IDENTITY);
        let before = manipulator.speed_m_per_s();
        manipulator.handle(&Event::Wheel(1.0));
        assert!((manipulator.speed_m_per_s() / before - 1.25).abs() < 1e-12);
    }
}
