//! [`MotionLooks`]: prefetching along the extrapolated motion of an eye, where no path is announced. Main thread.
//!
//! The velocity and the rotation of the last frames, and how they change, predict where the eye will be in some tenths of a
//! second. Looks follow the prediction as they follow a known path ([`PathLooks`]). Each frame checks the prediction: if
//! the eye moves elsewhere, the looks restart and reach less far; while predictions hold, they reach farther again.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::path::{PathLooks, frames_until};
use crate::cull::PageRequest;

/// Predictions reach at most this far, seconds.
const FARTHEST_S: f64 = 0.25;
/// Predictions reach at least this many frames.
const MIN_FRAMES: f64 = 3.0;
/// The reach grows by this factor per frame while predictions hold.
const REACH_GROWTH: f64 = 1.1;
/// The reach shrinks by this factor after a prediction that did not hold.
const REACH_SHRINKAGE: f64 = 0.5;
/// A prediction holds while its position is off by no more than this share of the distance to it.
const MAX_OFF: f64 = 0.05;
/// A prediction holds while its orientation is off by no more than this angle, radians.
const MAX_OFF_TURN: f64 = 0.05;
/// A prediction is exact while it is off by no more than this share of what is allowed.
const EXACT: f64 = 0.2;
/// While predictions are not exact, each frame looks at the pose this many frames ahead.
const NEAR_FRAMES: f64 = 1.0;
/// The number of frames whose rates predict the motion.
const FOLLOWED: usize = 4;
/// A rotation is predicted up to this angle, radians.
const MAX_TURN: f64 = 1.0;
/// Slower rotations are rounding errors of a resting camera, radians per second.
const MIN_TURN: f64 = 1e-6;

/// A rate of change of a pose, in the world: metres and axis times radians, per second or per second squared.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Rate {
    shift: DVec3,
    turn: DVec3,
}

impl Rate {
    fn between(from: &DAffine3, to: &DAffine3, dt_s: f64) -> Self {
        let turn = turn_between(from, to);
        let rate = Self { shift: (to.translation - from.translation) / dt_s, turn: turn / dt_s };
        let is_finite = dt_s > 0.0 && rate.shift.is_finite() && rate.turn.is_finite();
        if is_finite { rate } else { Self::default() }
    }
}

/// The predicted motion of a part of a pose.
#[derive(Clone, Copy, Debug)]
struct Trend {
    /// Change of the part per second.
    rate: DVec3,
    /// Change of the rate per second.
    change: DVec3,
}

/// Returns the slower rate: a single frame's jump is no motion.
fn slower(a: DVec3, b: DVec3) -> DVec3 {
    if a.length_squared() <= b.length_squared() { a } else { b }
}

/// Returns true if two rates differ by less than half of the slower.
fn is_steady(a: DVec3, b: DVec3) -> bool {
    (a - b).length_squared() <= 0.25 * slower(a, b).length_squared()
}

/// Returns the rotation between two poses as axis times radians.
pub(crate) fn turn_between(from: &DAffine3, to: &DAffine3) -> DVec3 {
    DQuat::from_mat3(&(to.matrix3 * from.matrix3.transpose())).normalize().to_scaled_axis()
}

/// Follows an eye, and predicts where it will be.
#[derive(Clone, Copy, Debug, Default)]
pub struct EyeMotion {
    /// Time in seconds and pose (world from eye) of the last frame.
    last: Option<(f64, DAffine3)>,
    /// Rates of the last frames, the latest first.
    rates: [Rate; FOLLOWED],
    frame_s: f64,
}

impl EyeMotion {
    /// Records the eye's pose at a time of the wall clock, once a frame.
    pub fn observe(&mut self, at_s: f64, world_from_eye: &DAffine3) {
        if let Some((before_s, before)) = self.last {
            self.frame_s = at_s - before_s;
            let rate = Rate::between(&before, world_from_eye, self.frame_s);
            self.rates.rotate_right(1);
            self.rates[0] = rate;
        }
        self.last = Some((at_s, *world_from_eye));
    }

    /// Returns the duration of the last frame, seconds.
    pub fn frame_s(&self) -> f64 {
        self.frame_s
    }

    /// Predicts a part of the pose from the frames since the last jump. A rate that oscillates continues at its mean.
    fn trend(&self, part: fn(&Rate) -> DVec3) -> Trend {
        let rates = self.rates.each_ref().map(part);
        let steady = 1 + rates.windows(2).take_while(|pair| is_steady(pair[0], pair[1])).count();
        if steady == 1 {
            return Trend { rate: slower(rates[0], rates[1]), change: DVec3::ZERO };
        }
        let rates = &rates[..steady];
        let changes = || rates.windows(2).map(|pair| pair[0] - pair[1]);
        let (least, most) = changes().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, m), c| (l.min(c), m.max(c)));
        let mean = rates.iter().sum::<DVec3>() / steady as f64;
        let mut trend = Trend { rate: rates[0], change: DVec3::ZERO };
        for axis in 0..3 {
            if least[axis] < 0.0 && most[axis] > 0.0 {
                trend.rate[axis] = mean[axis];
            } else if steady > 2 && self.frame_s > 0.0 {
                let change = if least[axis] >= 0.0 { least[axis] } else { most[axis] };
                trend.change[axis] = change / self.frame_s;
            }
        }
        trend
    }

    /// Returns the predicted pose after some seconds; `None` if the eye rests.
    pub fn after(&self, seconds: f64) -> Option<DAffine3> {
        let (_, now) = self.last?;
        let shift = self.trend(|rate| rate.shift);
        let turn = self.trend(|rate| rate.turn);
        if shift.rate == DVec3::ZERO && turn.rate.length() <= MIN_TURN {
            return None;
        }
        // A rate holds for the middle of its frame. Its change predicts only the near future, and adds at most half as much
        // as the rate.
        let near_s = seconds.min(FARTHEST_S);
        let moved = |trend: Trend| {
            let gone = trend.rate * seconds;
            let more = trend.change * (0.5 * near_s * (near_s + self.frame_s));
            gone + more.clamp_length_max(0.5 * gone.length())
        };
        let turn = DQuat::from_scaled_axis(moved(turn).clamp_length_max(MAX_TURN));
        Some(DAffine3 { matrix3: DMat3::from_quat(turn) * now.matrix3, translation: now.translation + moved(shift) })
    }
}

/// Decides when to look ahead along an eye's predicted motion, and keeps what the looks found.
#[derive(Debug)]
pub struct MotionLooks {
    looks: PathLooks,
    now_s: f64,
    /// How far looks reach, seconds.
    reach_s: f64,
    /// Time and pose of the farthest look.
    farthest: Option<(f64, DAffine3)>,
    /// The look at the next frames, made while predictions are not exact.
    near: Near,
}

/// The state of a frame's look at the next frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Near {
    /// Not needed in this frame, or done.
    No,
    /// Not made yet.
    Due,
    /// Made; what it found is not accepted yet.
    Made,
}

impl Default for MotionLooks {
    fn default() -> Self {
        let looks = PathLooks::default();
        Self { looks, now_s: 0.0, reach_s: FARTHEST_S, farthest: None, near: Near::No }
    }
}

impl MotionLooks {
    /// The farthest time that a look reaches, seconds; motion predicts little beyond.
    pub const FARTHEST_S: f64 = FARTHEST_S;

    /// Begins a frame and checks whether the looks are still on the predicted way. `world_from_eye` is the pose that
    /// `motion` observed last.
    pub fn start_frame(&mut self, now_s: f64, world_from_eye: &DAffine3, motion: &EyeMotion) {
        self.looks.start_frame(now_s);
        (self.now_s, self.near) = (now_s, Near::No);
        let Some((at_s, looked)) = self.farthest.filter(|(at_s, _)| *at_s > now_s) else {
            self.farthest = None;
            return;
        };
        // The error as a share of what is allowed.
        let off = motion.after(at_s - now_s).map_or(f64::INFINITY, |then| {
            let (off, way) = (looked.translation - then.translation, then.translation - world_from_eye.translation);
            let off = off.length() / way.length().max(f64::MIN_POSITIVE) / MAX_OFF;
            off.max(turn_between(&looked, &then).length() / MAX_OFF_TURN)
        });
        let holds = off <= 1.0;
        if off > EXACT {
            self.near = Near::Due;
        }
        if !holds {
            self.looks.look_anew();
            self.farthest = None;
        }
        let min_s = MIN_FRAMES * motion.frame_s();
        let factor = if holds { REACH_GROWTH } else { REACH_SHRINKAGE };
        self.reach_s = (self.reach_s * factor).max(min_s).min(FARTHEST_S);
    }

    /// Returns the pose to look from now, if any, and in how many frames the eye will be there: at most `ahead_s` from now.
    /// Call it again after [`Self::found`].
    pub fn next(&mut self, ahead_s: f64, motion: &EyeMotion) -> Option<(DAffine3, u32)> {
        motion.after(0.0)?;
        if self.near == Near::Due {
            self.near = Near::Made;
            return motion.after(NEAR_FRAMES * motion.frame_s()).map(|then| (then, NEAR_FRAMES as u32));
        }
        let at_s = self.looks.next(ahead_s.min(self.reach_s), motion.frame_s())?;
        let then = motion.after(at_s - self.now_s)?;
        self.farthest = Some((at_s, then));
        Some((then, frames_until(at_s - self.now_s, motion.frame_s())))
    }

    /// Accepts the requests of a cull from the pose that [`Self::next`] returned.
    pub fn found(&mut self, requests: &[PageRequest], motion: &EyeMotion) {
        if std::mem::replace(&mut self.near, Near::No) == Near::Made {
            self.looks.found_at(self.now_s + NEAR_FRAMES * motion.frame_s(), requests);
        } else {
            self.looks.found(requests);
        }
    }

    /// Returns what coming frames will lack, with the number of frames until then.
    pub fn requests(&self, motion: &EyeMotion) -> impl Iterator<Item = PageRequest> {
        self.looks.requests(motion.frame_s())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f64, heading: f64) -> DAffine3 {
        DAffine3::from_rotation_translation(DQuat::from_rotation_z(heading), DVec3::new(x, 0.0, 100.0))
    }

    fn follow(poses: impl IntoIterator<Item = (f64, DAffine3)>) -> EyeMotion {
        let mut motion = EyeMotion::default();
        poses.into_iter().for_each(|(at_s, pose)| motion.observe(at_s, &pose));
        motion
    }

    #[test]
    fn steady_motion_is_continued() {
        let motion = follow((0..4).map(|i| (0.1 * f64::from(i), pose(f64::from(i), 0.05 * f64::from(i)))));
        let then = motion.after(2.0).unwrap();
        assert!(then.abs_diff_eq(pose(23.0, 1.15), 1e-9), "{then}");
    }

    #[test]
    fn change_of_speed_is_continued() {
        // A fall, and a rotation that accelerates.
        let at = |t: f64| pose(40.0 * t + 5.0 * t * t, 0.3 * t + 0.2 * t * t);
        let motion = follow((10..14).map(|i| (0.1 * f64::from(i), at(0.1 * f64::from(i)))));
        let then = motion.after(0.2).unwrap();
        let ideal = at(1.5);
        assert!((then.translation.x - ideal.translation.x).abs() < 0.01, "{then} {ideal}");
        assert!(turn_between(&then, &ideal).length() < 0.01, "{then} {ideal}");
    }

    #[test]
    fn jump_is_no_motion() {
        let mut motion = follow([(0.0, pose(0.0, 0.0)), (0.1, pose(0.0, 0.0)), (0.2, pose(1e6, 3.0))]);
        assert_eq!(motion.after(1.0), None);
        motion.observe(0.3, &pose(1e6 + 1.0, 3.0));
        let then = motion.after(1.0).unwrap();
        assert!((then.translation.x - (1e6 + 11.0)).abs() < 1e-6, "{then}");
    }

    #[test]
    fn rotation_is_predicted_up_to_a_limit_and_invalid_poses_are_rest() {
        let spin = follow((0..4).map(|i| (0.1 * f64::from(i), pose(0.0, 2.0 * f64::from(i)))));
        assert!(turn_between(&spin.after(5.0).unwrap(), &pose(0.0, 6.0)).length() < MAX_TURN + 1e-9);
        assert_eq!(follow([(0.0, pose(0.0, 0.0)), (0.0, pose(1.0, 0.0)), (0.0, pose(2.0, 0.0))]).after(1.0), None);
        let odd = DAffine3::from_translation(DVec3::NAN);
        assert_eq!(follow([(0.0, odd), (0.1, pose(0.0, 0.0)), (0.2, odd)]).after(1.0), None);
        assert_eq!(EyeMotion::default().after(1.0), None);
    }

    /// Flies along a path in frames of a hundredth of a second. Returns the looks of each frame: their times ahead, and the
    /// distances of their positions from where the eye will be.
    fn fly(frames: u32, at: impl Fn(f64) -> DAffine3) -> Vec<Vec<(f64, f64)>> {
        let (mut motion, mut looks) = (EyeMotion::default(), MotionLooks::default());
        let mut all = Vec::new();
        for i in 0..frames {
            let now_s = 0.01 * f64::from(i);
            motion.observe(now_s, &at(now_s));
            looks.start_frame(now_s, &at(now_s), &motion);
            let mut of_frame = Vec::new();
            while let Some((then, frames)) = looks.next(1.0, &motion) {
                let ahead_s = 0.01 * f64::from(frames);
                of_frame.push((ahead_s, then.translation.distance(at(now_s + ahead_s).translation)));
                looks.found(&[], &motion);
            }
            all.push(of_frame);
        }
        all
    }

    #[test]
    fn looks_follow_the_eye_and_restart_where_it_turns_back() {
        let straight = |t: f64| pose(100.0 * t, 0.0);
        let looks = fly(100, straight);
        let (count, far) = looks[50..].iter().flatten().fold((0, 0.0), |(n, far), (s, _)| (n + 1, f64::max(far, *s)));
        assert!(count < 20 && far > 0.2, "without anything new looks are rare and far: {count} {far}");
        assert!(looks.iter().flatten().all(|(ahead_s, off_m)| *ahead_s <= FARTHEST_S + 0.011 && *off_m < 1.1));
        // The eye turns back at once.
        let back = |t: f64| pose(100.0 * (0.5 - (t - 0.5).abs()), 0.0);
        let looks = fly(100, back);
        let after: Vec<f64> = looks[51..56].iter().flatten().map(|(s, _)| *s).collect();
        assert!(!after.is_empty() && after[0] < 0.15, "{after:?}");
        let standing = fly(50, |_| pose(1.0, 0.0));
        assert!(standing.iter().all(Vec::is_empty));
    }
}
