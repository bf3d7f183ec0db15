//! Looking ahead: where the cameras will be, and what they will want there. Main thread, in update.
//!
//! Cameras are culled from where they will be: along the path that the application or the manipulator has announced, as
//! closely as pictures differ ([`PathLooks`]), or else as they move and turn now, as closely for the next tenths of a
//! second ([`MotionLooks`]) and one camera every few frames farther. What is missing there is asked of the pager after all
//! that the pictures lack (see [`PageRequest::ahead`]). Cameras in the graph are not thought on.

use glam::DAffine3;

use super::paged_scene::PagedScene;
use super::view::View;
use crate::cull::{CullCamera, CullVisitor, PageRequest, RenderStage};
use crate::pager::{EyeMotion, MotionLooks, PathLooks, frames_until, turn_between};

/// Frames from one far look to the next.
const LOOK_EVERY: u32 = 8;
/// A camera's far looks: shares of the time that is looked ahead.
const SHARES: [f64; 3] = [1.0 / 3.0, 2.0 / 3.0, 1.0];
/// What far looks find takes the place of what was not wanted for so many times longer.
const GUESSED: u32 = 2;
/// Requests kept of a look, the most urgent.
const MOST_REQUESTS: usize = 128;
/// A path is another where its end is off by more than this share of the way or of the turn to it; a turn counts as this
/// many radians at least.
const MOST_OFF: f64 = 0.5;
const LEAST_TURN: f64 = 0.1;

/// From now the way goes elsewhere than it was to go.
fn is_off(now: &DAffine3, aimed: &DAffine3, then: &DAffine3) -> bool {
    let way = |to: &DAffine3| (to.translation - now.translation).length();
    let turn = |to: &DAffine3| turn_between(now, to).length();
    let off_m = (aimed.translation - then.translation).length();
    off_m > MOST_OFF * way(aimed).max(way(then))
        || turn_between(aimed, then).length() > MOST_OFF * turn(aimed).max(turn(then)).max(LEAST_TURN)
}

/// The clocks of the last frames, and how the master camera moves.
#[derive(Clone, Copy, Debug)]
struct Track {
    at_s: f64,
    simulation_s: f64,
    /// Seconds of the application's time a second, over the last frame.
    rate: f64,
    motion: EyeMotion,
}

impl Track {
    fn new(at_s: f64, simulation_s: f64) -> Self {
        Self { at_s, simulation_s, rate: 0.0, motion: EyeMotion::default() }
    }

    fn go_on(&mut self, at_s: f64, simulation_s: f64, world_from_eye: &DAffine3) {
        let rate = (simulation_s - self.simulation_s) / (at_s - self.at_s);
        self.rate = if rate.is_finite() { rate } else { 0.0 };
        (self.at_s, self.simulation_s) = (at_s, simulation_s);
        self.motion.observe(at_s, world_from_eye);
    }

    fn frame_s(&self) -> f64 {
        self.motion.frame_s()
    }
}

/// The looks ahead of a view's cameras.
#[derive(Debug, Default)]
pub(super) struct LookAhead {
    track: Option<Track>,
    /// Of each camera, on an announced path.
    on_path: Vec<PathLooks>,
    /// A moment ahead, and where the path was to be by then.
    aim: Option<(f64, DAffine3)>,
    /// Of each camera, as it moves.
    by_motion: Vec<MotionLooks>,
    /// Numbers the far looks.
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
        let track = self.track.get_or_insert_with(|| Track::new(from.reference_time_s, from.simulation_time_s));
        track.go_on(from.reference_time_s, from.simulation_time_s, &now);
        let track = *track;
        self.requests.clear();
        if looker.view.pose_after(from.simulation_time_s, track.rate, 0.0).is_some() {
            self.found.clear();
            self.by_motion.clear();
            self.look_along_path(&mut looker, from, track);
        } else {
            self.on_path.clear();
            self.aim = None;
            self.look_by_motion(&mut looker, from, track.motion);
            self.look_far(&mut looker, from, track.motion);
        }
    }

    fn look_along_path(&mut self, looker: &mut Looker, from: LookFrom, track: Track) {
        self.on_path.resize_with(looker.view.cameras().count(), PathLooks::default);
        self.aim = self.aim.filter(|(at_s, _)| *at_s > from.reference_time_s);
        let pose_at =
            |at_s: f64| looker.view.pose_after(from.simulation_time_s, track.rate, at_s - from.reference_time_s);
        let now = looker.view.camera.world_from_eye;
        if self.aim.is_some_and(|(at_s, aimed)| pose_at(at_s).is_some_and(|then| is_off(&now, &aimed, &then))) {
            // Another path, or its time stands still or goes on: what was looked at is not on the way.
            self.on_path.iter_mut().for_each(PathLooks::begin_anew);
            self.aim = None;
        }
        let aim_s = from.reference_time_s + from.ahead_s;
        self.aim = self.aim.or_else(|| Some((aim_s, pose_at(aim_s)?)));
        for (camera, looks) in looker.view.cameras().zip(&mut self.on_path) {
            looks.start_frame(from.reference_time_s);
            while let Some(at_s) = looks.next(from.ahead_s, track.frame_s()) {
                let seconds = at_s - from.reference_time_s;
                let then = looker.view.pose_after(from.simulation_time_s, track.rate, seconds);
                let frames = frames_until(seconds, track.frame_s());
                looks.found(then.map_or(&[], |then| looker.look(camera, then, from.frame, frames)));
            }
            self.requests.extend(looks.requests(track.frame_s()));
        }
    }

    fn look_by_motion(&mut self, looker: &mut Looker, from: LookFrom, motion: EyeMotion) {
        self.by_motion.resize_with(looker.view.cameras().count(), MotionLooks::default);
        for (camera, looks) in looker.view.cameras().zip(&mut self.by_motion) {
            looks.start_frame(from.reference_time_s, &looker.view.camera.world_from_eye, &motion);
            while let Some((then, frames)) = looks.next(from.ahead_s, &motion) {
                looks.found(looker.look(camera, then, from.frame, frames), &motion);
            }
            self.requests.extend(looks.requests(&motion));
        }
    }

    /// Beyond what motion says closely, in turns.
    fn look_far(&mut self, looker: &mut Looker, from: LookFrom, motion: EyeMotion) {
        if from.frame.is_multiple_of(LOOK_EVERY) {
            self.found.resize(SHARES.len() * looker.view.cameras().count().max(1), Vec::new());
            let turn = self.turn % self.found.len();
            self.turn = turn + 1;
            let seconds = from.ahead_s * SHARES[turn % SHARES.len()];
            let found = &mut self.found[turn];
            found.clear();
            let then = motion.after(seconds).filter(|_| seconds > MotionLooks::FARTHEST_S);
            if let Some((camera, then)) = looker.view.cameras().nth(turn / SHARES.len()).zip(then) {
                let frames = frames_until(seconds, motion.frame_s());
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
