//! Camera paths in OpenSceneGraph's `.path` text form.
//!
//! Each line is a control point: `t px py pz qx qy qz qw`. They are the time in seconds, the eye's position in world metres
//! and the rotation from eye axes (looking down -z, y up) to world axes. Unlike OSG's reader, this one accepts a last line
//! without a newline, skips empty lines and `#` comments, and names each invalid line.

use std::fmt::Write as _;
use std::path::Path;

use glam::{DQuat, DVec3};

use super::error::PathError;
use super::path::{AnimationPath, ControlPoint};

impl AnimationPath {
    /// Parses the text form.
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
    pub fn read(path: &Path) -> Result<Self, PathError> {
        let error = |source| PathError::Io { path: path.display().to_string(), source };
        Self::parse(&std::fs::read_to_string(path).map_err(error)?)
    }

    /// Returns the text form; every number parses back to the same bits.
    pub fn to_text(&self) -> String {
        let mut text = String::new();
        for ControlPoint { time_s, position: p, rotation: q } in self.points() {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{time_s} {} {} {} {} {} {} {}", p.x, p.y, p.z, q.x, q.y, q.z, q.w);
        }
        text
    }

    /// Writes a file in the text form; creates its folder if necessary.
    pub fn write(&self, path: &Path) -> Result<(), PathError> {
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
    // Normalizing a rotation of unit length would change its last bits.
    let rotation = if (length - 1.0).abs() < 1e-12 { rotation } else { rotation.normalize() };
    Ok(ControlPoint { time_s, position: DVec3::new(px, py, pz), rotation })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_point_is_a_constant_path() {
        let path = AnimationPath::parse("5 1 2 3 0 0 0 1").unwrap();
        for t in [-1.0, 5.0, f64::NAN, f64::INFINITY] {
            assert_eq!(path.world_from_eye(t).translation, DVec3::new(1.0, 2.0, 3.0));
        }
    }

    #[test]
    fn equal_times_keep_the_last_point() {
        let path = AnimationPath::parse("0 1 0 0 0 0 0 1\n0 2 0 0 0 0 0 1").unwrap();
        assert_eq!(path.points().len(), 1);
        assert_eq!(path.points()[0].position.x, 2.0);
    }
}
