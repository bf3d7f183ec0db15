//! Sequences and paths of files: which child is shown and where a part is at a time.
//!
//! Readers of all encodings fill the values, and [`build`](super::build) gives the nodes an update callback. Endless motion
//! depends on the simulation time alone, not on when its page arrived; motion that ends starts at its first update
//! (`docs/decisions/0072-what-moves-in-files-follows-the-simulation-time.md`).

use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec3};

use crate::scene::{NodeId, Scene, Traverse, UpdateCallback};

/// The members of a Sequence.
#[derive(Clone, Debug)]
pub(super) struct SequenceObject {
    /// The seconds of each child.
    pub times_s: Vec<f64>,
    /// Goes back and forth instead of around.
    pub swings: bool,
    /// The first and the last child; negative numbers are the last of all.
    pub interval: [i32; 2],
    /// A factor of the times. Negative ones play backwards; with 0 each child is shown for a frame.
    pub speed: f64,
    /// The number of times that an end of the interval is reached; negative for no end.
    pub repeats: i32,
    /// The seconds of the child that is shown last; 0 for its own.
    pub last_time_s: f64,
    /// False if it is stopped. OSG then shows no child.
    pub plays: bool,
    /// Shows nothing once it has ended.
    pub clears: bool,
}

impl Default for SequenceObject {
    /// Returns OSG's defaults.
    fn default() -> Self {
        Self {
            times_s: Vec::new(),
            swings: false,
            interval: [0, -1],
            speed: 0.0,
            repeats: -1,
            last_time_s: 0.0,
            plays: false,
            clears: false,
        }
    }
}

/// The order in which a Sequence shows its children.
#[derive(Debug, PartialEq)]
struct Play {
    /// The children of a round with the time at which each ends, in seconds or frames.
    round: Vec<(usize, f64)>,
    counts_frames: bool,
    /// The number of children that are shown before the last one, with the time at which that one is hidden.
    end: Option<(usize, f64)>,
}

/// The child that a Sequence shows at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Shown {
    child: Option<usize>,
    is_over: bool,
}

impl SequenceObject {
    /// Returns for each of a number of children whether it is shown first.
    pub fn first(&self, count: usize) -> Vec<bool> {
        let first = self.play().map(|play| play.at(0.0).child);
        (0..count).map(|child| first == Some(Some(child))).collect()
    }

    /// Returns the callback that shows the children in turn; `None` if it always shows the same.
    pub fn callback(&self) -> Option<UpdateCallback> {
        let play = self.play()?;
        if play.round.len() < 2 && play.end.is_none() {
            return None;
        }
        let mut start = None;
        Some(UpdateCallback::new(move |scene, node, info| {
            let now = if play.counts_frames { f64::from(info.frame) } else { info.simulation_time_s };
            let since = if play.end.is_some() { *start.get_or_insert(now) } else { 0.0 };
            let shown = play.at(now - since);
            show(scene, node, shown.child);
            if shown.is_over {
                // Its node remains as it is.
                drop(scene.set_update_callback(node, None));
            }
            Traverse::Below
        }))
    }

    /// Follows OSG's Sequence for a round; `None` if it shows nothing.
    fn play(&self) -> Option<Play> {
        let last = i32::try_from(self.times_s.len()).ok()?.checked_sub(1).filter(|last| *last >= 0)?;
        if !self.plays {
            return None;
        }
        let [begin, end] = self.interval.map(|at| if at < 0 { last } else { at.min(last) });
        let (low, high) = (begin.min(end), begin.max(end));
        let direction = if self.speed < 0.0 { -1 } else { 1 };
        let counts_frames = self.speed == 0.0 || !self.speed.is_finite();
        let seconds = |child: i32| {
            let own = self.times_s.get(child as usize).copied().unwrap_or(0.0) * self.speed.abs();
            if counts_frames { 1.0 } else { Some(own).filter(|own| own.is_finite()).unwrap_or(0.0).max(0.0) }
        };
        let (mut child, mut step) = (begin, if begin > end { -1 } else { 1 });
        let start = (child, step);
        let (mut round, mut time) = (Vec::new(), 0.0);
        // The times, in rounds, at which an end of the interval is reached.
        let mut ends = Vec::new();
        loop {
            time += seconds(child);
            round.push((child as usize, time));
            let next = child + step * direction;
            child = match next {
                _ if low == high => low,
                next if (low..=high).contains(&next) => next,
                next if !self.swings => low + (next - low).rem_euclid(high - low + 1),
                next if next > high => 2 * high - next,
                next => 2 * low - next,
            };
            if child == if step > 0 { high } else { low } {
                ends.push(round.len());
                step = if self.swings { -step } else { step };
            }
            // Each state has one before it, so that the first one comes again.
            if (child, step) == start || low == high || round.len() > 2 * self.times_s.len() {
                break;
            }
        }
        let counts_frames = counts_frames || time <= 0.0;
        if counts_frames {
            (1..).zip(&mut round).for_each(|(frame, (_, end))| *end = f64::from(frame));
        }
        let end = usize::try_from(self.repeats).ok().filter(|_| !ends.is_empty()).map(|repeats| {
            let before = match repeats.checked_sub(1) {
                None => 0,
                Some(more) => (more / ends.len()).saturating_mul(round.len()).saturating_add(ends[more % ends.len()]),
            };
            let play = Play { round: Vec::new(), counts_frames, end: None };
            let begins = play.begin_of(before, &round);
            let own = play.begin_of(before.saturating_add(1), &round) - begins;
            let is_longer = self.last_time_s > 0.0 && !counts_frames;
            let lasts = if is_longer { self.last_time_s * self.speed.abs() } else { own };
            (before, if self.clears { begins + lasts } else { f64::INFINITY })
        });
        Some(Play { round, counts_frames, end })
    }
}

impl Play {
    /// Returns the time at which the child of a number is shown, counted over all rounds.
    fn begin_of(&self, number: usize, round: &[(usize, f64)]) -> f64 {
        let rounds = (number / round.len()) as f64 * round.last().map_or(0.0, |(_, end)| *end);
        rounds + (number % round.len()).checked_sub(1).map_or(0.0, |before| round[before].1)
    }

    /// Returns what is shown at a time since the start.
    fn at(&self, time: f64) -> Shown {
        if let Some((last, hidden)) = self.end
            && time >= self.begin_of(last, &self.round)
        {
            let child = self.round[last % self.round.len()].0;
            return Shown {
                child: (time < hidden).then_some(child),
                is_over: time >= hidden || hidden == f64::INFINITY,
            };
        }
        let length = self.round.last().map_or(1.0, |(_, end)| *end);
        let at = time.rem_euclid(length);
        let number = self.round.partition_point(|(_, end)| *end <= at).min(self.round.len() - 1);
        Shown { child: Some(self.round[number].0), is_over: false }
    }
}

/// Shows one child of a Switch, and touches the scene only if another one was shown.
fn show(scene: &mut Scene, node: NodeId, child: Option<usize>) {
    let wrong = |scene: &Scene| {
        let shown = scene.page(node.page)?.switch(node.index)?;
        shown.iter().enumerate().position(|(at, is_shown)| *is_shown != (Some(at) == child))
    };
    while let Some(at) = wrong(scene) {
        if scene.set_switch(node, at, Some(at) == child).is_err() {
            return;
        }
    }
}

/// An AnimationPath.
#[derive(Debug)]
pub(super) struct PathObject {
    /// In the order of their times.
    points: Vec<PathPoint>,
    looping: Looping,
}

/// A pose on a path, with its time.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathPoint {
    pub time_s: f64,
    pub position: DVec3,
    pub rotation: DQuat,
    pub scale: DVec3,
}

/// The behaviour at the end of a path, in the order of the numbers in binary files.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Looping {
    Swing,
    #[default]
    Loop,
    No,
}

impl Looping {
    /// Returns the mode of a number.
    pub fn of_number(number: u32) -> Self {
        match number {
            0 => Self::Swing,
            2 => Self::No,
            _ => Self::Loop,
        }
    }

    /// Returns the mode of a name.
    pub fn of_name(name: &str) -> Self {
        match name {
            "SWING" => Self::Swing,
            "NO_LOOPING" => Self::No,
            _ => Self::Loop,
        }
    }
}

impl PathObject {
    /// Takes points in any order; `None` if none is left. Of those with one time the last counts.
    pub fn new(points: impl IntoIterator<Item = PathPoint>, looping: Looping) -> Option<Self> {
        let is_valid = |point: &PathPoint| {
            point.time_s.is_finite()
                && point.position.is_finite()
                && point.rotation.is_finite()
                && point.scale.is_finite()
        };
        let mut points: Vec<PathPoint> = points.into_iter().filter(is_valid).collect();
        points.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        points.reverse();
        points.dedup_by_key(|point| point.time_s.to_bits());
        points.reverse();
        (!points.is_empty()).then_some(Self { points, looping })
    }

    /// Returns the bytes of its points.
    pub fn size_bytes(&self) -> u64 {
        size_of_val(self.points.as_slice()) as u64
    }

    fn times(&self) -> [f64; 2] {
        [self.points.first(), self.points.last()].map(|point| point.map_or(0.0, |point| point.time_s))
    }

    /// Returns the pose at a time.
    fn at(&self, time_s: f64) -> DAffine3 {
        let [first, last] = self.times();
        let period = last - first;
        let time_s = match self.looping {
            Looping::No => time_s,
            _ if period <= 0.0 => first,
            Looping::Loop => first + (time_s - first).rem_euclid(period),
            Looping::Swing => {
                let within = (time_s - first).rem_euclid(2.0 * period);
                first + if within > period { 2.0 * period - within } else { within }
            }
        };
        let next = self.points.partition_point(|point| point.time_s < time_s);
        let before = &self.points[next.saturating_sub(1)];
        let next = self.points.get(next).unwrap_or(before);
        let length = next.time_s - before.time_s;
        let share = if length > 0.0 { ((time_s - before.time_s) / length).clamp(0.0, 1.0) } else { 0.0 };
        let (scale, position) = (before.scale.lerp(next.scale, share), before.position.lerp(next.position, share));
        DAffine3::from_scale_rotation_translation(scale, before.rotation.slerp(next.rotation, share), position)
    }
}

/// An AnimationPathCallback.
#[derive(Debug)]
pub(super) struct AnimationObject {
    pub path: Arc<PathObject>,
    pub pivot: DVec3,
    pub is_inverse: bool,
    pub offset_s: f64,
    pub multiplier: f64,
    /// A paused one leaves the transform as it is.
    pub is_paused: bool,
}

impl AnimationObject {
    /// Returns the map of the transform at a time since the start; `None` if it is not finite.
    fn at(&self, time_s: f64) -> Option<DAffine3> {
        let place = self.path.at((time_s - self.offset_s) * self.multiplier);
        let place = if self.is_inverse { place.inverse() } else { place };
        Some(place * DAffine3::from_translation(-self.pivot)).filter(DAffine3::is_finite)
    }

    /// Returns the map at the start; `None` if the transform keeps its own.
    pub fn first(&self) -> Option<DAffine3> {
        if self.is_paused { None } else { self.at(0.0) }
    }

    /// Returns the callback that moves the transform; `None` if it stays.
    pub fn callback(self: &Arc<Self>) -> Option<UpdateCallback> {
        let [first_s, last_s] = self.path.times();
        let time_is_finite = self.offset_s.is_finite() && self.multiplier.is_finite() && self.multiplier != 0.0;
        if self.is_paused || first_s == last_s || !time_is_finite {
            return None;
        }
        let animation = self.clone();
        let ends = animation.path.looping == Looping::No;
        let mut start = None;
        Some(UpdateCallback::new(move |scene, node, info| {
            let now = info.simulation_time_s;
            let since = if ends { *start.get_or_insert(now) } else { 0.0 };
            let time_s = now - since;
            if let Some(map) = animation.at(time_s) {
                // The node is a transform and the map finite.
                drop(scene.set_transform(node, map));
            }
            let along = (time_s - animation.offset_s) * animation.multiplier;
            let is_over = if animation.multiplier > 0.0 { along >= last_s } else { along <= first_s };
            if ends && is_over {
                drop(scene.set_update_callback(node, None));
            }
            Traverse::Below
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn children(sequence: &SequenceObject, times: &[f64]) -> Vec<Option<usize>> {
        let play = sequence.play().expect("it plays");
        times.iter().map(|time| play.at(*time).child).collect()
    }

    #[test]
    fn sequences_loop_swing_and_end() {
        let endless = SequenceObject { times_s: vec![1.0, 2.0, 3.0], speed: 1.0, plays: true, ..Default::default() };
        let times = [0.0, 0.9, 1.0, 2.9, 3.0, 5.9, 6.0, 7.0, 600.5, -0.5];
        assert_eq!(children(&endless, &times), [0, 0, 1, 1, 2, 2, 0, 1, 0, 2].map(Some));
        let slow = SequenceObject { speed: 2.0, ..endless.clone() };
        assert_eq!(children(&slow, &[1.9, 2.0, 6.0]), [0, 1, 2].map(Some));
        // Back and forth takes 1 + 2 + 3 + 2 s.
        let swings = SequenceObject { swings: true, ..endless.clone() };
        assert_eq!(children(&swings, &[2.9, 3.0, 6.0, 7.9, 8.0, 9.0]), [1, 2, 1, 1, 0, 1].map(Some));
        let backwards = SequenceObject { interval: [-1, 0], ..endless.clone() };
        assert_eq!(children(&backwards, &[0.0, 3.0, 5.0, 6.0]), [2, 1, 0, 2].map(Some));
        let negative = SequenceObject { speed: -1.0, ..endless.clone() };
        assert_eq!(children(&negative, &[0.0, 1.0, 4.0, 6.0]), [0, 2, 1, 0].map(Some));
        let part = SequenceObject { interval: [1, 2], ..endless.clone() };
        assert_eq!(children(&part, &[0.0, 2.0, 5.0]), [1, 2, 1].map(Some));
        // Twice around: the last one stays, or lasts its own time.
        let twice = SequenceObject { repeats: 2, ..endless.clone() };
        assert_eq!(children(&twice, &[8.9, 9.0, 1e9]), [1, 2, 2].map(Some));
        let clears = SequenceObject { clears: true, ..twice.clone() };
        assert_eq!(children(&clears, &[9.0, 11.9, 12.0, 1e9]), [Some(2), Some(2), None, None]);
        let longer = SequenceObject { last_time_s: 10.0, ..clears };
        assert_eq!(children(&longer, &[18.9, 19.0]), [Some(2), None]);
        let there = SequenceObject { swings: true, repeats: 1, ..endless.clone() };
        assert_eq!(children(&there, &[2.9, 3.0, 1e9]), [1, 2, 2].map(Some));
        let and_back = SequenceObject { repeats: 2, ..there };
        assert_eq!(children(&and_back, &[7.9, 8.0, 1e9]), [1, 0, 0].map(Some));
        let never = SequenceObject { repeats: 0, ..endless.clone() };
        assert_eq!(children(&never, &[0.0, 1e9]), [0, 0].map(Some));
        // Without a speed, or without times, each frame shows the next one.
        for frames in [
            SequenceObject { speed: 0.0, ..endless.clone() },
            SequenceObject { times_s: vec![0.0; 3], ..endless.clone() },
        ] {
            assert!(frames.play().unwrap().counts_frames);
            assert_eq!(children(&frames, &[0.0, 1.0, 2.0, 3.0]), [0, 1, 2, 0].map(Some));
        }
        assert_eq!(SequenceObject { plays: false, ..endless.clone() }.play(), None);
        assert_eq!(SequenceObject { times_s: Vec::new(), ..endless.clone() }.play(), None);
        let odd = SequenceObject { interval: [7, 9], times_s: vec![f64::NAN, -4.0, 1.0], ..endless };
        assert_eq!(children(&odd, &[0.0, 5.0]), [2, 2].map(Some));
    }

    #[test]
    fn paths_interpolate_and_repeat() {
        let point = |time_s: f64, x: f64, turn: f64, scale: f64| PathPoint {
            time_s,
            position: DVec3::new(x, 0.0, 0.0),
            rotation: DQuat::from_rotation_z(turn),
            scale: DVec3::splat(scale),
        };
        let path = |looping| PathObject::new([point(3.0, 10.0, 1.0, 3.0), point(1.0, 0.0, 0.0, 1.0)], looping).unwrap();
        let x = |looping, times: &[f64]| times.iter().map(|t| path(looping).at(*t).translation.x).collect::<Vec<_>>();
        assert_eq!(x(Looping::No, &[0.0, 1.5, 2.0, 3.0, 9.0]), [0.0, 2.5, 5.0, 10.0, 10.0]);
        assert_eq!(x(Looping::Loop, &[1.5, 3.5, 0.5]), [2.5, 2.5, 7.5]);
        assert_eq!(x(Looping::Swing, &[1.5, 3.5, 5.0, 0.5]), [2.5, 7.5, 0.0, 2.5]);
        let half = path(Looping::No).at(2.0);
        let expected = DAffine3::from_scale_rotation_translation(
            DVec3::splat(2.0),
            DQuat::from_rotation_z(0.5),
            DVec3::new(5.0, 0.0, 0.0),
        );
        assert!(half.abs_diff_eq(expected, 1e-12), "{half:?}");
        let animation = AnimationObject {
            path: Arc::new(path(Looping::No)),
            pivot: DVec3::X,
            is_inverse: false,
            offset_s: 1.0,
            multiplier: 2.0,
            is_paused: false,
        };
        // (2 - 1) * 2 is 2 s on the path.
        assert!(animation.at(2.0).unwrap().transform_point3(DVec3::X).abs_diff_eq(DVec3::new(5.0, 0.0, 0.0), 1e-12));
        let inverse = AnimationObject { is_inverse: true, pivot: DVec3::ZERO, ..animation };
        assert!(inverse.at(2.0).unwrap().abs_diff_eq(expected.inverse(), 1e-12));
        assert!(PathObject::new([point(f64::NAN, 0.0, 0.0, 1.0)], Looping::Loop).is_none());
        let twice = PathObject::new([point(1.0, 0.0, 0.0, 1.0), point(1.0, 4.0, 0.0, 1.0)], Looping::Loop).unwrap();
        assert_eq!((twice.at(7.0).translation.x, twice.points.len()), (4.0, 1));
    }
}
