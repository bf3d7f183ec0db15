//! [`MotionLooks`]: looking ahead where no path is announced, along the one that an eye's motion goes on to. Main thread.
//!
//! Velocity and turn of the last frames, and how they change, say where the eye will be in some tenths of a second; that
//! is looked along as a known path is ([`PathLooks`]). Each frame shows whether the guess was good: where the eye now goes
//! elsewhere than where was looked, looks begin anew and reach less far, and farther again while guesses hold.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::look_ahead::{PathLooks, frames_until};
use crate::cull::PageRequest;

/// Guesses reach so far at most, seconds.
const FARTHEST_S: f64 = 0.25;
/// And so many frames at least.
const LEAST_FRAMES: f64 = 3.0;
/// The reach of the next frame while guesses hold, and after one that did not.
const REACH: [f64; 2] = [1.1, 0.5];
/// A guess holds while it is off by no more than this share of the way to it, and this angle in radians.
const MOST_OFF: f64 = 0.05;
const MOST_OFF_TURN: f64 = 0.05;
/// And exact while it is off by no more than this share of that.
const EXACT: f64 = 0.2;
/// Where guesses are not exact, what comes in so many frames is looked at in each.
const NEAR_FRAMES: f64 = 1.0;
/// Frames whose rates say how an eye moves.
const FOLLOWED: usize = 4;
/// A turn is not followed farther than this, radians.
const MOST_TURN: f64 = 1.0;
/// Slower turns are none, radians per second: rounding of a standing camera.
const LEAST_TURN: f64 = 1e-6;

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

/// How a part of a pose goes on.
#[derive(Clone, Copy, Debug)]
struct GoingOn {
    /// Per second.
    rate: DVec3,
    /// Of the rate, per second.
    change: DVec3,
}

/// One frame's jump to another place is no motion.
fn slower(a: DVec3, b: DVec3) -> DVec3 {
    if a.length_squared() <= b.length_squared() { a } else { b }
}

/// They differ by less than half of the slower.
fn is_steady(a: DVec3, b: DVec3) -> bool {
    (a - b).length_squared() <= 0.25 * slower(a, b).length_squared()
}

/// Axis times radians.
pub(crate) fn turn_between(from: &DAffine3, to: &DAffine3) -> DVec3 {
    DQuat::from_mat3(&(to.matrix3 * from.matrix3.transpose())).normalize().to_scaled_axis()
}

/// Follows an eye, and says where it goes on to.
#[derive(Clone, Copy, Debug, Default)]
pub struct EyeMotion {
    /// Time in seconds, and world from eye.
    last: Option<(f64, DAffine3)>,
    /// Over the last frames, the last first.
    rates: [Rate; FOLLOWED],
    frame_s: f64,
}

impl EyeMotion {
    /// The eye's pose at a time of the wall's clock, once a frame.
    pub fn go_on(&mut self, at_s: f64, world_from_eye: &DAffine3) {
        if let Some((before_s, before)) = self.last {
            self.frame_s = at_s - before_s;
            let rate = Rate::between(&before, world_from_eye, self.frame_s);
            self.rates.rotate_right(1);
            self.rates[0] = rate;
        }
        self.last = Some((at_s, *world_from_eye));
    }

    /// Seconds that the last frame took.
    pub fn frame_s(&self) -> f64 {
        self.frame_s
    }

    /// From the last frames up to a jump. What changes to and fro is no change: its mean goes on.
    fn going_on(&self, part: fn(&Rate) -> DVec3) -> GoingOn {
        let rates = self.rates.each_ref().map(part);
        let steady = 1 + rates.windows(2).take_while(|pair| is_steady(pair[0], pair[1])).count();
        if steady == 1 {
            return GoingOn { rate: slower(rates[0], rates[1]), change: DVec3::ZERO };
        }
        let rates = &rates[..steady];
        let changes = || rates.windows(2).map(|pair| pair[0] - pair[1]);
        let (least, most) = changes().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, m), c| (l.min(c), m.max(c)));
        let mean = rates.iter().sum::<DVec3>() / steady as f64;
        let mut going_on = GoingOn { rate: rates[0], change: DVec3::ZERO };
        for axis in 0..3 {
            if least[axis] < 0.0 && most[axis] > 0.0 {
                going_on.rate[axis] = mean[axis];
            } else if steady > 2 && self.frame_s > 0.0 {
                let change = if least[axis] >= 0.0 { least[axis] } else { most[axis] };
                going_on.change[axis] = change / self.frame_s;
            }
        }
        going_on
    }

    /// The pose after some seconds; `None` where the eye rests.
    pub fn after(&self, seconds: f64) -> Option<DAffine3> {
        let (_, now) = self.last?;
        let shift = self.going_on(|rate| rate.shift);
        let turn = self.going_on(|rate| rate.turn);
        if shift.rate == DVec3::ZERO && turn.rate.length() <= LEAST_TURN {
            return None;
        }
        // A rate is that of its frame's middle. How it changes says nothing of what is far, and never much: at most half
        // as much as the rate.
        let near_s = seconds.min(FARTHEST_S);
        let moved = |of: GoingOn| {
            let gone = of.rate * seconds;
            let more = of.change * (0.5 * near_s * (near_s + self.frame_s));
            gone + more.clamp_length_max(0.5 * gone.length())
        };
        let turn = DQuat::from_scaled_axis(moved(turn).clamp_length_max(MOST_TURN));
        Some(DAffine3 { matrix3: DMat3::from_quat(turn) * now.matrix3, translation: now.translation + moved(shift) })
    }
}

/// Looks ahead along the way that an eye goes on.
#[derive(Debug)]
pub struct MotionLooks {
    looks: PathLooks,
    now_s: f64,
    /// How far looks reach.
    reach_s: f64,
    /// Where the farthest look was from, and its time.
    farthest: Option<(f64, DAffine3)>,
    /// Guesses are not exact: what the next frames show is looked at again.
    near: Near,
}

/// A look at what comes at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Near {
    /// Not in this frame, or made.
    No,
    Due,
    /// Made, and not yet told what it found.
    Made,
}

impl Default for MotionLooks {
    fn default() -> Self {
        let looks = PathLooks::default();
        Self { looks, now_s: 0.0, reach_s: FARTHEST_S, farthest: None, near: Near::No }
    }
}

impl MotionLooks {
    /// The farthest that any look reaches, seconds: beyond, motion says little.
    pub const FARTHEST_S: f64 = FARTHEST_S;

    /// Goes on to a frame, and sees whether what was looked at is still on the way. `world_from_eye` is the pose that
    /// `motion` was told last.
    pub fn start_frame(&mut self, now_s: f64, world_from_eye: &DAffine3, motion: &EyeMotion) {
        self.looks.start_frame(now_s);
        (self.now_s, self.near) = (now_s, Near::No);
        let Some((at_s, looked)) = self.farthest.filter(|(at_s, _)| *at_s > now_s) else {
            self.farthest = None;
            return;
        };
        // As a share of what is allowed.
        let off = motion.after(at_s - now_s).map_or(f64::INFINITY, |then| {
            let (off, way) = (looked.translation - then.translation, then.translation - world_from_eye.translation);
            let off = off.length() / way.length().max(f64::MIN_POSITIVE) / MOST_OFF;
            off.max(turn_between(&looked, &then).length() / MOST_OFF_TURN)
        });
        let holds = off <= 1.0;
        if off > EXACT {
            self.near = Near::Due;
        }
        if !holds {
            self.looks.look_anew();
            self.farthest = None;
        }
        let least_s = LEAST_FRAMES * motion.frame_s();
        self.reach_s = (self.reach_s * REACH[usize::from(!holds)]).max(least_s).min(FARTHEST_S);
    }

    /// Where to look from now, if anywhere, and in how many frames the eye will be there: not farther than `ahead_s` from
    /// now. To be asked again after [`Self::found`].
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

    /// Takes what a picture would lack in the place that [`Self::next`] gave.
    pub fn found(&mut self, requests: &[PageRequest], motion: &EyeMotion) {
        if std::mem::replace(&mut self.near, Near::No) == Near::Made {
            self.looks.found_at(self.now_s + NEAR_FRAMES * motion.frame_s(), requests);
        } else {
            self.looks.found(requests);
        }
    }

    /// What will be wanted.
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
        poses.into_iter().for_each(|(at_s, pose)| motion.go_on(at_s, &pose));
        motion
    }

    #[test]
    fn a_steady_motion_goes_on() {
        let motion = follow((0..4).map(|i| (0.1 * f64::from(i), pose(f64::from(i), 0.05 * f64::from(i)))));
        let then = motion.after(2.0).unwrap();
        assert!(then.abs_diff_eq(pose(23.0, 1.15), 1e-9), "{then}");
    }

    #[test]
    fn a_change_of_speed_goes_on_as_it_was() {
        // A fall, and a turn that quickens.
        let at = |t: f64| pose(40.0 * t + 5.0 * t * t, 0.3 * t + 0.2 * t * t);
        let motion = follow((10..14).map(|i| (0.1 * f64::from(i), at(0.1 * f64::from(i)))));
        let then = motion.after(0.2).unwrap();
        let ideal = at(1.5);
        assert!((then.translation.x - ideal.translation.x).abs() < 0.01, "{then} {ideal}");
        assert!(turn_between(&then, &ideal).length() < 0.01, "{then} {ideal}");
    }

    #[test]
    fn a_jump_is_no_motion() {
        let mut motion = follow([(0.0, pose(0.0, 0.0)), (0.1, pose(0.0, 0.0)), (0.2, pose(1e6, 3.0))]);
        assert_eq!(motion.after(1.0), None);
        motion.go_on(0.3, &pose(1e6 + 1.0, 3.0));
        let then = motion.after(1.0).unwrap();
        assert!((then.translation.x - (1e6 + 11.0)).abs() < 1e-6, "{then}");
    }

    #[test]
    fn a_turn_is_followed_to_a_limit_and_nonsense_is_rest() {
        let spin = follow((0..4).map(|i| (0.1 * f64::from(i), pose(0.0, 2.0 * f64::from(i)))));
        assert!(turn_between(&spin.after(5.0).unwrap(), &pose(0.0, 6.0)).length() < MOST_TURN + 1e-9);
        assert_eq!(follow([(0.0, pose(0.0, 0.0)), (0.0, pose(1.0, 0.0)), (0.0, pose(2.0, 0.0))]).after(1.0), None);
        let odd = DAffine3::from_translation(DVec3::NAN);
        assert_eq!(follow([(0.0, odd), (0.1, pose(0.0, 0.0)), (0.2, odd)]).after(1.0), None);
        assert_eq!(EyeMotion::default().after(1.0), None);
    }

    /// Frames of a hundredth of a second along a path: the times ahead that were looked at, by frame, and how far their
    /// places were from where the eye came to be.
    fn fly(frames: u32, at: impl Fn(f64) -> DAffine3) -> Vec<Vec<(f64, f64)>> {
        let (mut motion, mut looks) = (EyeMotion::default(), MotionLooks::default());
        let mut all = Vec::new();
        for i in 0..frames {
            let now_s = 0.01 * f64::from(i);
            motion.go_on(now_s, &at(now_s));
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
    fn looks_follow_the_eye_and_begin_anew_where_it_goes_elsewhere() {
        let straight = |t: f64| pose(100.0 * t, 0.0);
        let looks = fly(100, straight);
        let (count, far) = looks[50..].iter().flatten().fold((0, 0.0), |(n, far), (s, _)| (n + 1, f64::max(far, *s)));
        assert!(count < 20 && far > 0.2, "nothing is new: looks are rare and far: {count} {far}");
        assert!(looks.iter().flatten().all(|(ahead_s, off_m)| *ahead_s <= FARTHEST_S + 0.011 && *off_m < 1.1));
        // Back at once.
        let back = |t: f64| pose(100.0 * (0.5 - (t - 0.5).abs()), 0.0);
        let looks = fly(100, back);
        let after: Vec<f64> = looks[51..56].iter().flatten().map(|(s, _)| *s).collect();
        assert!(!after.is_empty() && after[0] < 0.15, "{after:?}");
        let standing = fly(50, |_| pose(1.0, 0.0));
        assert!(standing.iter().all(Vec::is_empty));
    }
}
