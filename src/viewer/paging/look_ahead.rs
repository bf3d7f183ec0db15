//! [`LookAheads`]: finds the pages that cameras will need soon, so that the pager can prefetch them. Main thread, in update.
//!
//! Each camera is culled from where it will be. On a path that the application or the manipulator has announced, culls are
//! spaced as closely as images differ ([`PathLooks`]). Otherwise the camera's motion is extrapolated: closely for the next
//! tenths of a second ([`MotionLooks`]), and every few frames one camera is culled farther ahead. The pages that are missing
//! there are requested after those that the last frame lacked (see [`PageRequest::ahead`]). Cameras in the scene graph are
//! not extrapolated.

use glam::DAffine3;

use super::paged_scene::PagedScene;
use crate::cull::{CullCamera, PageRequest};
use crate::pager::{EyeMotion, MotionLooks, PathLooks, frames_until, turn_between};
use crate::viewer::ids::ViewId;
use crate::viewer::view::{Probe, View};

/// Frames between two far looks.
const FAR_LOOK_INTERVAL: u32 = 8;
/// The far looks of a camera, as shares of the time to look ahead.
const FAR_SHARES: [f64; 3] = [1.0 / 3.0, 2.0 / 3.0, 1.0];
/// Far looks are guesses: their requests are ranked as if they were needed this many times later.
const FAR_DELAY_FACTOR: u32 = 2;
/// The number of requests that are kept of one far look, the most urgent first.
const MAX_FAR_REQUESTS: usize = 128;
/// A path counts as changed when its end is off by more than this share of the distance, or of the turn, to it.
const MAX_DEVIATION: f64 = 0.5;
/// Smaller turns count as this many radians when deviations are compared with them.
const MIN_TURN: f64 = 0.1;

/// Returns true when a path that was to end at `aimed` now ends too far from it, at `then`.
fn is_off_course(now: &DAffine3, aimed: &DAffine3, then: &DAffine3) -> bool {
    let distance_m = |to: &DAffine3| (to.translation - now.translation).length();
    let turn = |to: &DAffine3| turn_between(now, to).length();
    let off_m = (aimed.translation - then.translation).length();
    off_m > MAX_DEVIATION * distance_m(aimed).max(distance_m(then))
        || turn_between(aimed, then).length() > MAX_DEVIATION * turn(aimed).max(turn(then)).max(MIN_TURN)
}

/// The clocks of the last frames and the motion of the master camera.
#[derive(Clone, Copy, Debug)]
struct Track {
    reference_time_s: f64,
    simulation_time_s: f64,
    /// Simulation seconds per wall second, over the last frame.
    rate: f64,
    motion: EyeMotion,
}

impl Track {
    fn new(reference_time_s: f64, simulation_time_s: f64) -> Self {
        Self { reference_time_s, simulation_time_s, rate: 0.0, motion: EyeMotion::default() }
    }

    fn advance(&mut self, from: &LookFrom, world_from_eye: &DAffine3) {
        let seconds = from.reference_time_s - self.reference_time_s;
        let rate = (from.simulation_time_s - self.simulation_time_s) / seconds;
        self.rate = if rate.is_finite() { rate } else { 0.0 };
        (self.reference_time_s, self.simulation_time_s) = (from.reference_time_s, from.simulation_time_s);
        self.motion.observe(from.reference_time_s, world_from_eye);
    }

    fn frame_s(&self) -> f64 {
        self.motion.frame_s()
    }
}

/// The pose that the path had, when last looked at, at a time ahead.
#[derive(Clone, Copy, Debug)]
struct Aim {
    reference_time_s: f64,
    pose: DAffine3,
}

/// The look-ahead of one view's cameras.
#[derive(Debug, Default)]
struct LookAhead {
    track: Option<Track>,
    /// Looks along an announced path, one entry per camera.
    on_path: Vec<PathLooks>,
    aim: Option<Aim>,
    /// Looks along the present motion, one entry per camera.
    by_motion: Vec<MotionLooks>,
    /// Counts the far looks.
    far_looks: usize,
    /// The results of the last far looks, in a ring.
    far_requests: Vec<Vec<PageRequest>>,
    requests: Vec<PageRequest>,
}

/// The look-aheads of all views.
#[derive(Debug, Default)]
pub(in crate::viewer) struct LookAheads {
    by_view: Vec<(ViewId, LookAhead)>,
}

impl LookAheads {
    /// Looks ahead for a view and returns the pages that it will need.
    pub(in crate::viewer) fn look(
        &mut self,
        id: ViewId,
        view: &View,
        scene: &PagedScene,
        probe: &mut Probe,
        from: LookFrom,
    ) -> &[PageRequest] {
        let known = self.by_view.iter().position(|(of, _)| *of == id);
        let index = known.unwrap_or_else(|| {
            self.by_view.push((id, LookAhead::default()));
            self.by_view.len() - 1
        });
        let look_ahead = &mut self.by_view[index].1;
        look_ahead.look(Looker { view, scene, probe }, from);
        &look_ahead.requests
    }

    /// Forgets a view that was removed.
    pub(in crate::viewer) fn forget(&mut self, view: ViewId) {
        self.by_view.retain(|(of, _)| *of != view);
    }
}

/// The frame from which to look ahead.
#[derive(Clone, Copy, Debug)]
pub(in crate::viewer) struct LookFrom {
    pub(in crate::viewer) frame: u32,
    pub(in crate::viewer) reference_time_s: f64,
    pub(in crate::viewer) simulation_time_s: f64,
    /// The time to look ahead, in wall seconds.
    pub(in crate::viewer) ahead_s: f64,
}

/// Culls cameras of a view from poses ahead.
struct Looker<'a> {
    view: &'a View,
    scene: &'a PagedScene,
    probe: &'a mut Probe,
}

impl Looker<'_> {
    /// Returns the pages that a camera would lack `ahead_frames` later with the master camera at `then`; none when that is
    /// the present pose.
    fn look(&mut self, camera: u32, then: DAffine3, frame: u32, ahead_frames: u32) -> &[PageRequest] {
        self.probe.clear_requests();
        let now = self.view.camera.world_from_eye;
        let is_elsewhere = then != now && then.is_finite();
        let task = self.view.task(camera, self.scene, frame, Vec::new());
        let Some(task) = task.filter(|_| is_elsewhere) else { return &[] };
        let mut camera = CullCamera { ahead_frames, ..task.camera };
        // Slaves keep their offset from the master.
        camera.eye_from_world = camera.eye_from_world * now * then.inverse();
        self.probe.requests_of(&task.scene, &camera)
    }
}

impl LookAhead {
    /// Follows the master camera, and looks where a look is due.
    fn look(&mut self, mut looker: Looker, from: LookFrom) {
        let now = looker.view.camera.world_from_eye;
        let track = self.track.get_or_insert_with(|| Track::new(from.reference_time_s, from.simulation_time_s));
        track.advance(&from, &now);
        let track = *track;
        self.requests.clear();
        if looker.view.pose_after(from.simulation_time_s, track.rate, 0.0).is_some() {
            self.far_requests.clear();
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
        self.aim = self.aim.filter(|aim| aim.reference_time_s > from.reference_time_s);
        let pose_at =
            |at_s: f64| looker.view.pose_after(from.simulation_time_s, track.rate, at_s - from.reference_time_s);
        let now = looker.view.camera.world_from_eye;
        let is_off = |aim: Aim| pose_at(aim.reference_time_s).is_some_and(|then| is_off_course(&now, &aim.pose, &then));
        if self.aim.is_some_and(is_off) {
            // The path was replaced, or its time was stopped or resumed: the earlier looks are not on the way.
            self.on_path.iter_mut().for_each(PathLooks::begin_anew);
            self.aim = None;
        }
        let aim_s = from.reference_time_s + from.ahead_s;
        self.aim = self.aim.or_else(|| Some(Aim { reference_time_s: aim_s, pose: pose_at(aim_s)? }));
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

    /// Looks beyond the time that [`Self::look_by_motion`] covers, one camera and distance at a time.
    fn look_far(&mut self, looker: &mut Looker, from: LookFrom, motion: EyeMotion) {
        if from.frame.is_multiple_of(FAR_LOOK_INTERVAL) {
            self.far_requests.resize(FAR_SHARES.len() * looker.view.cameras().count().max(1), Vec::new());
            let index = self.far_looks % self.far_requests.len();
            self.far_looks = index + 1;
            let seconds = from.ahead_s * FAR_SHARES[index % FAR_SHARES.len()];
            let found = &mut self.far_requests[index];
            found.clear();
            let then = motion.after(seconds).filter(|_| seconds > MotionLooks::FARTHEST_S);
            if let Some((camera, then)) = looker.view.cameras().nth(index / FAR_SHARES.len()).zip(then) {
                let frames = frames_until(seconds, motion.frame_s());
                let missing = looker.look(camera, then, from.frame, frames);
                found.extend(missing.iter().map(|request| request.ahead(FAR_DELAY_FACTOR * frames)));
                found.sort_unstable_by(|a, b| b.priority.total_cmp(&a.priority));
                found.truncate(MAX_FAR_REQUESTS);
            }
        }
        self.requests.extend(self.far_requests.iter().flatten());
    }
}
