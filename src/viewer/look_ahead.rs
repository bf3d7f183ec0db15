//! Looking ahead: where the cameras will be, and what they will want there. Main thread, in update.
//!
//! Cameras are culled from where they will be: along the path that the application or the manipulator has announced, as
//! closely as pictures differ ([`PathLooks`]), or else, one every few frames, as they move and turn now. What is missing
//! there is asked of the pager after all that the pictures lack (see [`PageRequest::ahead`]). Cameras in the graph are not
//! thought on.

use glam::{DAffine3, DQuat, DVec3};

use super::paged_scene::PagedScene;
use super::view::View;
use crate::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use crate::pager::{PathLooks, frames_until};

/// Frames from one look to the next.
const LOOK_EVERY: u32 = 4;
/// A camera's looks: shares of the time that is looked ahead.
const SHARES: [f64; 3] = [1.0 / 3.0, 2.0 / 3.0, 1.0];
/// Requests kept of a look, the most urgent.
const MOST_REQUESTS: usize = 128;
/// What is only guessed takes the place of what was not wanted for so many times longer than what is known.
const GUESSED: u32 = 2;
/// A turn is not followed farther than this, radians.
const MOST_TURN: f64 = 1.0;
/// Slower turns are none, radians per second: rounding of a standing camera.
const LEAST_TURN: f64 = 1e-6;

/// How an eye moves, in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Motion {
    /// Metres per second.
    velocity: DVec3,
    /// Axis times radians per second.
    turn: DVec3,
}

impl Motion {
    fn between(from: &DAffine3, to: &DAffine3, dt_s: f64) -> Self {
        let turn = DQuat::from_mat3(&(to.matrix3 * from.matrix3.transpose()));
        let motion = Self {
            velocity: (to.translation - from.translation) / dt_s,
            turn: turn.normalize().to_scaled_axis() / dt_s,
        };
        let is_finite = dt_s > 0.0 && motion.velocity.is_finite() && motion.turn.is_finite();
        if is_finite { motion } else { Self::default() }
    }

    /// The slower of two: one frame's jump to another place is no motion.
    fn slower(self, other: Self) -> Self {
        let slower = |a: DVec3, b: DVec3| if a.length_squared() <= b.length_squared() { a } else { b };
        Self { velocity: slower(self.velocity, other.velocity), turn: slower(self.turn, other.turn) }
    }

    fn is_rest(&self) -> bool {
        self.velocity == DVec3::ZERO && self.turn.length() <= LEAST_TURN
    }

    /// The pose after some seconds.
    fn moved(&self, world_from_eye: &DAffine3, seconds: f64) -> DAffine3 {
        let turn = DQuat::from_scaled_axis((self.turn * seconds).clamp_length_max(MOST_TURN));
        DAffine3 {
            matrix3: glam::DMat3::from_quat(turn) * world_from_eye.matrix3,
            translation: world_from_eye.translation + self.velocity * seconds,
        }
    }
}

/// An eye's last places.
#[derive(Clone, Copy, Debug)]
struct Track {
    at_s: f64,
    simulation_s: f64,
    world_from_eye: DAffine3,
    /// Over the last two frames.
    last: [Motion; 2],
    /// Seconds of the application's time a second, over the last frame.
    rate: f64,
    /// Seconds that the last frame took.
    frame_s: f64,
}

impl Track {
    fn new(at_s: f64, simulation_s: f64, world_from_eye: DAffine3) -> Self {
        Self { at_s, simulation_s, world_from_eye, last: [Motion::default(); 2], rate: 0.0, frame_s: 0.0 }
    }

    fn go_on(&mut self, at_s: f64, simulation_s: f64, world_from_eye: DAffine3) {
        let dt_s = at_s - self.at_s;
        let motion = Motion::between(&self.world_from_eye, &world_from_eye, dt_s);
        let rate = (simulation_s - self.simulation_s) / dt_s;
        let rate = if rate.is_finite() { rate } else { 0.0 };
        *self = Self { at_s, simulation_s, world_from_eye, last: [motion, self.last[0]], rate, frame_s: dt_s };
    }

    fn motion(&self) -> Motion {
        self.last[0].slower(self.last[1])
    }
}

/// The looks ahead of a view's cameras.
#[derive(Debug, Default)]
pub(super) struct LookAhead {
    track: Option<Track>,
    /// Of each camera, on an announced path.
    on_path: Vec<PathLooks>,
    /// Numbers the other looks.
    turn: usize,
    /// What the last ones found, in their turn.
    found: Vec<Vec<PageRequest>>,
    requests: Vec<PageRequest>,
}

/// The frame that looks ahead.
#[derive(Clone, Copy, Debug)]
pub(super) struct LookFrom {
    pub frame: u32,
    pub reference_time_s: f64,
    pub simulation_time_s: f64,
    /// How far to look, in seconds of the wall's clock.
    pub ahead_s: f64,
}

/// What looks are made with.
pub(super) struct Looker<'a> {
    pub view: &'a View,
    pub scene: &'a PagedScene,
    pub visitor: &'a mut CullVisitor,
    pub stage: &'a mut RenderStage,
}

impl Looker<'_> {
    /// What one of the cameras would lack in so many frames, with the master camera in a place; nothing where it is no
    /// other place than now.
    fn look(&mut self, camera: u32, then: DAffine3, frame: u32, frames: u32) -> &[PageRequest] {
        self.stage.requests.clear();
        let now = self.view.camera.world_from_eye;
        let is_elsewhere = then != now && then.is_finite();
        let task = self.view.task(camera, self.scene, frame, Vec::new());
        let Some(task) = task.filter(|_| is_elsewhere) else { return &[] };
        let mut camera = CullCamera { ahead_frames: frames, ..task.camera };
        // Slaves keep their place beside the master.
        camera.eye_from_world = camera.eye_from_world * now * then.inverse();
        // Nothing is drawn of it: no fades, no shadows, no order of leaves.
        camera.settings.lod_fade_s = 0.0;
        self.visitor.traverse(&task.scene, &camera, self.stage);
        &self.stage.requests
    }
}

impl LookAhead {
    /// Follows the master camera, and looks where it is time to.
    pub fn look(&mut self, mut looker: Looker, from: LookFrom) {
        let now = looker.view.camera.world_from_eye;
        let track = self.track.get_or_insert_with(|| Track::new(from.reference_time_s, from.simulation_time_s, now));
        track.go_on(from.reference_time_s, from.simulation_time_s, now);
        let track = *track;
        self.requests.clear();
        if looker.view.pose_after(from.simulation_time_s, track.rate, 0.0).is_some() {
            self.found.clear();
            self.look_along_path(&mut looker, from, track);
        } else {
            self.on_path.clear();
            self.look_by_motion(&mut looker, from, track);
        }
    }

    fn look_along_path(&mut self, looker: &mut Looker, from: LookFrom, track: Track) {
        self.on_path.resize_with(looker.view.cameras().count(), PathLooks::default);
        for (camera, looks) in looker.view.cameras().zip(&mut self.on_path) {
            looks.start_frame(from.reference_time_s);
            while let Some(at_s) = looks.next(from.ahead_s, track.frame_s) {
                let seconds = at_s - from.reference_time_s;
                let then = looker.view.pose_after(from.simulation_time_s, track.rate, seconds);
                let frames = frames_until(seconds, track.frame_s);
                looks.found(then.map_or(&[], |then| looker.look(camera, then, from.frame, frames)));
            }
            self.requests.extend(looks.requests(track.frame_s));
        }
    }

    fn look_by_motion(&mut self, looker: &mut Looker, from: LookFrom, track: Track) {
        if from.frame.is_multiple_of(LOOK_EVERY) {
            self.found.resize(SHARES.len() * looker.view.cameras().count().max(1), Vec::new());
            let turn = self.turn % self.found.len();
            self.turn = turn + 1;
            let seconds = from.ahead_s * SHARES[turn % SHARES.len()];
            let found = &mut self.found[turn];
            found.clear();
            let motion = track.motion();
            if let Some(camera) = looker.view.cameras().nth(turn / SHARES.len()).filter(|_| !motion.is_rest()) {
                let frames = frames_until(seconds, track.frame_s);
                let then = motion.moved(&looker.view.camera.world_from_eye, seconds);
                let lacks = looker.look(camera, then, from.frame, frames);
                found.extend(lacks.iter().map(|request| request.ahead(GUESSED * frames)));
                found.sort_unstable_by(|a, b| b.priority.total_cmp(&a.priority));
                found.truncate(MOST_REQUESTS);
            }
        }
        self.requests.extend(self.found.iter().flatten());
    }

    /// What is wanted later, of all looks that count.
    pub fn requests(&self) -> &[PageRequest] {
        &self.requests
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64, heading: f64) -> DAffine3 {
        DAffine3::from_rotation_translation(DQuat::from_rotation_z(heading), DVec3::new(x, 0.0, 100.0))
    }

    #[test]
    fn a_steady_motion_goes_on() {
        let mut track = Track::new(0.0, 0.0, pose(0.0, 0.0));
        for i in 1..4 {
            track.go_on(0.1 * f64::from(i), 0.0, pose(f64::from(i), 0.05 * f64::from(i)));
        }
        let then = track.motion().moved(&track.world_from_eye, 2.0);
        assert!(then.abs_diff_eq(pose(23.0, 1.15), 1e-9), "{then}");
    }

    #[test]
    fn a_jump_is_no_motion() {
        let mut track = Track::new(0.0, 0.0, pose(0.0, 0.0));
        track.go_on(0.1, 0.0, pose(0.0, 0.0));
        track.go_on(0.2, 0.0, pose(1e6, 3.0));
        assert!(track.motion().is_rest());
        track.go_on(0.3, 0.0, pose(1e6 + 1.0, 3.0));
        let velocity = track.motion().velocity;
        assert!((velocity.x - 10.0).abs() < 1e-6, "{velocity}");
    }

    #[test]
    fn a_turn_is_followed_to_a_limit_and_nonsense_is_rest() {
        let spin = Motion { turn: DVec3::Z * 100.0, ..Motion::default() };
        assert!(spin.moved(&pose(0.0, 0.0), 5.0).abs_diff_eq(pose(0.0, MOST_TURN), 1e-12));
        assert!(Motion::between(&pose(0.0, 0.0), &pose(1.0, 0.0), 0.0).is_rest());
        let odd = DAffine3::from_translation(DVec3::NAN);
        assert!(Motion::between(&pose(0.0, 0.0), &odd, 0.1).is_rest());
    }
}
