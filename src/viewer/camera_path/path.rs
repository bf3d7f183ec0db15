//! [`AnimationPath`]: control points over time, and the pose between them. Plain values.

use glam::{DAffine3, DQuat, DVec3};

use super::error::PathError;

/// A pose of the eye at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlPoint {
    /// The time, seconds from the path's own zero.
    pub time_s: f64,
    /// The eye's position in the world, metres.
    pub position: DVec3,
    /// The rotation from eye axes to world axes, of unit length.
    pub rotation: DQuat,
}

impl ControlPoint {
    /// Creates a control point from a pose (world from eye).
    pub fn from_pose(time_s: f64, world_from_eye: &DAffine3) -> Self {
        Self {
            time_s,
            position: world_from_eye.translation,
            rotation: DQuat::from_mat3(&world_from_eye.matrix3).normalize(),
        }
    }

    /// Returns the pose of the eye.
    pub fn world_from_eye(&self) -> DAffine3 {
        DAffine3::from_rotation_translation(self.rotation, self.position)
    }
}

/// The behaviour after the last control point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LoopMode {
    /// The eye stays at the end.
    #[default]
    NoLooping,
    /// The path starts again.
    Loop,
    /// The eye returns along the path, and so on.
    Swing,
}

/// Control points in the order of their times.
///
/// Between them, positions are interpolated linearly and rotations along the shorter arc.
#[derive(Clone, Debug, PartialEq)]
pub struct AnimationPath {
    points: Vec<ControlPoint>,
    /// The behaviour after the last point.
    pub loop_mode: LoopMode,
}

impl AnimationPath {
    /// Creates a path from control points in any order. Of points at equal times the last one is kept, as in OSG.
    ///
    /// Fails when there is no point or a time is not finite.
    pub fn new(mut points: Vec<ControlPoint>) -> Result<Self, PathError> {
        if let Some(ControlPoint { time_s, .. }) = points.iter().find(|p| !p.time_s.is_finite()) {
            return Err(PathError::NotFinite { time_s: *time_s });
        }
        points.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        points.reverse();
        points.dedup_by(|later, kept| later.time_s == kept.time_s);
        points.reverse();
        if points.is_empty() { Err(PathError::Empty) } else { Ok(Self { points, loop_mode: LoopMode::NoLooping }) }
    }

    /// Returns the control points in the order of their times; at least one.
    pub fn points(&self) -> &[ControlPoint] {
        &self.points
    }

    /// Returns the time of the first point, seconds.
    pub fn first_s(&self) -> f64 {
        self.points.first().map_or(0.0, |p| p.time_s)
    }

    /// Returns the time of the last point, seconds.
    pub fn last_s(&self) -> f64 {
        self.points.last().map_or(0.0, |p| p.time_s)
    }

    /// Returns the seconds from the first to the last point.
    pub fn duration_s(&self) -> f64 {
        self.last_s() - self.first_s()
    }

    /// Returns the eye's pose at a time; a time that is not finite gives the first pose.
    pub fn world_from_eye(&self, time_s: f64) -> DAffine3 {
        let time_s = self.wrapped(time_s);
        let after = self.points.partition_point(|p| p.time_s <= time_s);
        match (after.checked_sub(1).and_then(|i| self.points.get(i)), self.points.get(after)) {
            (Some(a), Some(b)) => {
                let share = (time_s - a.time_s) / (b.time_s - a.time_s);
                // `slerp` takes the shorter arc.
                let rotation = a.rotation.slerp(b.rotation, share).normalize();
                DAffine3::from_rotation_translation(rotation, a.position.lerp(b.position, share))
            }
            (Some(end), None) | (None, Some(end)) => end.world_from_eye(),
            (None, None) => DAffine3::IDENTITY,
        }
    }

    fn wrapped(&self, time_s: f64) -> f64 {
        let (first, duration) = (self.first_s(), self.duration_s());
        if !time_s.is_finite() || duration <= 0.0 {
            return first;
        }
        match self.loop_mode {
            LoopMode::NoLooping => time_s.clamp(first, first + duration),
            LoopMode::Loop => first + (time_s - first).rem_euclid(duration),
            LoopMode::Swing => {
                let phase = (time_s - first).rem_euclid(2.0 * duration);
                first + if phase > duration { 2.0 * duration - phase } else { phase }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path() -> AnimationPath {
        let point = |time_s: f64, x: f64, angle: f64| ControlPoint {
            time_s,
            position: DVec3::new(x, 1.0 / 3.0, -6_378_137.123_456_789),
            rotation: DQuat::from_rotation_z(angle),
        };
        AnimationPath::new(vec![point(3.0, 30.0, 1.0), point(1.0, 10.0, 0.0), point(2.0, 20.0, 0.5)]).unwrap()
    }

    #[test]
    fn interpolates_and_stays_at_the_ends() {
        let path = path();
        assert_eq!(path.world_from_eye(0.0).translation.x, 10.0);
        assert_eq!(path.world_from_eye(1.5).translation.x, 15.0);
        assert_eq!(path.world_from_eye(9.0).translation.x, 30.0);
        let turned = path.world_from_eye(2.5).matrix3.x_axis;
        assert!((turned.y.atan2(turned.x) - 0.75).abs() < 1e-12);
    }

    #[test]
    fn loops_and_swings() {
        let mut path = path();
        path.loop_mode = LoopMode::Loop;
        assert!((path.world_from_eye(3.5).translation.x - 15.0).abs() < 1e-12);
        path.loop_mode = LoopMode::Swing;
        assert!((path.world_from_eye(3.5).translation.x - 25.0).abs() < 1e-12);
    }
}
