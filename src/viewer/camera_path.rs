//! Recorded camera paths in OpenSceneGraph's `.path` text form; read before a flight, sampled in update.
//!
//! One control point a line: `t px py pz qx qy qz qw`, the time in seconds, the eye's position in world metres
//! and the rotation that turns eye axes (looking down -z, y up) into world axes. Unlike OSG's reader, a last line
//! without a newline counts, empty lines and `#` comments are skipped, and each bad line is named.

use std::fmt::Write as _;

use glam::{DAffine3, DQuat, DVec3};

/// One place and time on a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlPoint {
    /// Seconds since the path's own zero.
    pub time_s: f64,
    /// Eye position in the world, metres.
    pub position: DVec3,
    /// World-from-eye rotation, unit length.
    pub rotation: DQuat,
}

impl ControlPoint {
    /// A control point from a pose.
    pub fn from_pose(time_s: f64, world_from_eye: &DAffine3) -> Self {
        Self {
            time_s,
            position: world_from_eye.translation,
            rotation: DQuat::from_mat3(&world_from_eye.matrix3).normalize(),
        }
    }

    /// The pose of the eye.
    pub fn world_from_eye(&self) -> DAffine3 {
        DAffine3::from_rotation_translation(self.rotation, self.position)
    }
}

/// Why a path cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PathError {
    /// The file cannot be read or written.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line is not a control point.
    #[error("line {line}: {reason}")]
    Line {
        /// Counted from 1.
        line: usize,
        /// What is wrong with it.
        reason: String,
    },
    /// A control point is at no time.
    #[error("a control point at {time_s} s, which is not finite")]
    NotFinite {
        /// Its time.
        time_s: f64,
    },
    /// There is no control point at all.
    #[error("no control point")]
    Empty,
}

/// What happens after the last control point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LoopMode {
    /// Stay at the end.
    #[default]
    NoLooping,
    /// Start again.
    Loop,
    /// Go back the same way.
    Swing,
}

/// Control points in the order of their times; between them positions are interpolated linearly and rotations
/// along the shorter arc.
#[derive(Clone, Debug, PartialEq)]
pub struct AnimationPath {
    points: Vec<ControlPoint>,
    /// What happens after the last point.
    pub loop_mode: LoopMode,
}

impl AnimationPath {
    /// A path from control points in any order, at times that are finite; points at equal times keep the last one, as
    /// OSG's map does.
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

    /// The control points in the order of their times; at least one.
    pub fn points(&self) -> &[ControlPoint] {
        &self.points
    }

    /// Time of the first point, seconds.
    pub fn first_s(&self) -> f64 {
        self.points.first().map_or(0.0, |p| p.time_s)
    }

    /// Time of the last point, seconds.
    pub fn last_s(&self) -> f64 {
        self.points.last().map_or(0.0, |p| p.time_s)
    }

    /// Seconds from the first to the last point.
    pub fn duration_s(&self) -> f64 {
        self.last_s() - self.first_s()
    }

    /// The eye's pose at a time.
    pub fn world_from_eye(&self, time_s: f64) -> DAffine3 {
        let time_s = self.wrapped(time_s);
        let after = self.points.partition_point(|p| p.time_s <= time_s);
        match (after.checked_sub(1).and_then(|i| self.points.get(i)), self.points.get(after)) {
            (Some(a), Some(b)) => {
                let share = (time_s - a.time_s) / (b.time_s - a.time_s);
                // slerp takes the shorter arc.
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

    /// Reads the text form.
    pub fn parse(text: &str) -> Result<Self, PathError> {
        let mut points = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let line = line.trim().trim_start_matches('\u{feff}');
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            points.push(parse_line(line).map_err(|reason| PathError::Line { line: index + 1, reason })?);
        }
        Self::new(points)
    }

    /// Reads a file in the text form.
    pub fn read(path: &std::path::Path) -> Result<Self, PathError> {
        let error = |source| PathError::Io { path: path.display().to_string(), source };
        Self::parse(&std::fs::read_to_string(path).map_err(error)?)
    }

    /// Writes the text form; every number reads back to the same bits.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for ControlPoint { time_s, position: p, rotation: q } in &self.points {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{time_s} {} {} {} {} {} {} {}", p.x, p.y, p.z, q.x, q.y, q.z, q.w);
        }
        text
    }

    /// Writes a file in the text form, and makes the folder that it is in.
    pub fn write(&self, path: &std::path::Path) -> Result<(), PathError> {
        let error = |source| PathError::Io { path: path.display().to_string(), source };
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(error)?;
        }
        std::fs::write(path, self.to_text()).map_err(error)
    }
}

fn parse_line(line: &str) -> Result<ControlPoint, String> {
    let mut numbers = [0f64; 8];
    let mut count = 0;
    for word in line.split_whitespace() {
        let value: f64 = word.parse().map_err(|_| format!("`{}` is not a number", word.escape_debug()))?;
        if !value.is_finite() {
            return Err(format!("`{word}` is not finite"));
        }
        if let Some(number) = numbers.get_mut(count) {
            *number = value;
        }
        count += 1;
    }
    if count != 8 {
        return Err(format!("{count} numbers instead of 8: t px py pz qx qy qz qw"));
    }
    let [time_s, px, py, pz, qx, qy, qz, qw] = numbers;
    let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
    let length = rotation.length();
    if !(1e-3..1e3).contains(&length) {
        return Err(format!("the quaternion's length is {length}, not 1"));
    }
    // Written rotations are unit length already; leave those bits alone.
    let rotation = if (length - 1.0).abs() < 1e-12 { rotation } else { rotation.normalize() };
    Ok(ControlPoint { time_s, position: DVec3::new(px, py, pz), rotation })
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

    #[test]
    fn one_point_is_a_path() {
        let path = AnimationPath::parse("5 1 2 3 0 0 0 1").unwrap();
        for t in [-1.0, 5.0, f64::NAN, f64::INFINITY] {
            assert_eq!(path.world_from_eye(t).translation, DVec3::new(1.0, 2.0, 3.0));
        }
    }

    #[test]
    fn equal_times_keep_the_last() {
        let path = AnimationPath::parse("0 1 0 0 0 0 0 1\n0 2 0 0 0 0 0 1").unwrap();
        assert_eq!(path.points().len(), 1);
        assert_eq!(path.points()[0].position.x, 2.0);
    }
}
