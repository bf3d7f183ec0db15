//! [`CornerErrors`]: geometric errors at the corners of height tiles, from which tiles are chosen and morphed.
//!
//! The error at a corner is the largest of the four tiles of the level around it, so that tiles that share an edge have the
//! same errors along it. Between the corners the error is interpolated. A tile is refined by the largest of its four.
//! Decision 0077 shows why no cracks open.

use crate::scene::MORPH_LEVELS;

/// Geometric errors in metres at the corners of a tile: south-west, south-east, north-west, north-east.
pub(in crate::formats) type CornerErrors = [f64; 4];

/// The errors at the corners of a tile: those of its level, then those of the coarser levels, nearest first. Those of
/// coarser levels are interpolated from the corners of the tile above on that level.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(in crate::formats) struct LevelErrors {
    corners: [CornerErrors; MORPH_LEVELS + 1],
    count: usize,
}

impl LevelErrors {
    /// Returns the errors of some levels, nearest first. Levels that no tile morphs to are left out.
    pub fn new(levels: &[CornerErrors]) -> Self {
        let mut errors = Self::default();
        errors.count = levels.len().min(errors.corners.len());
        errors.corners[..errors.count].copy_from_slice(&levels[..errors.count]);
        errors
    }

    /// Returns the errors with a finer level before them: that of the tile itself.
    pub fn with_own(&self, own: CornerErrors) -> Self {
        let mut levels = vec![own];
        levels.extend(self.levels());
        Self::new(&levels)
    }

    /// Returns the errors at the corners of a part of the tile: from `first` to `last`, east and north, each from 0 to 1.
    pub fn of_part(&self, first: [f64; 2], last: [f64; 2]) -> Self {
        let mut part = *self;
        for own in &mut part.corners[..part.count] {
            let whole = *own;
            let at = |x, y| interpolated(whole, x, y);
            *own = [at(first[0], first[1]), at(last[0], first[1]), at(first[0], last[1]), at(last[0], last[1])];
        }
        part
    }

    /// Returns the errors by level, nearest first.
    pub fn levels(&self) -> &[CornerErrors] {
        &self.corners[..self.count]
    }
}

/// Returns the error at a point of a tile, x east and y north, each from 0 to 1.
fn interpolated([south_west, south_east, north_west, north_east]: CornerErrors, x: f64, y: f64) -> f64 {
    let between = |a: f64, b: f64, share: f64| a * (1.0 - share) + b * share;
    between(between(south_west, south_east, x), between(north_west, north_east, x), y)
}

/// Returns the largest of some errors in metres.
pub(in crate::formats) fn largest(errors_m: &CornerErrors) -> f64 {
    errors_m.iter().copied().fold(0.0, f64::max)
}

/// Returns true if the errors are finite and not negative.
pub(in crate::formats) fn are_valid(errors_m: &CornerErrors) -> bool {
    errors_m.iter().all(|error_m| error_m.is_finite() && *error_m >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_the_errors_of_the_whole_at_their_corners() {
        let whole = LevelErrors::new(&[[8.0, 16.0, 24.0, 64.0]]).with_own([1.0, 2.0, 3.0, 4.0]);
        let east_half = whole.of_part([0.5, 0.0], [1.0, 0.5]);
        assert_eq!(east_half.levels(), [[1.5, 2.0, 2.5, 3.0], [12.0, 16.0, 28.0, 40.0]]);
        // Neighbours agree on the common edge, whichever way it was divided.
        let west_half = whole.of_part([0.0, 0.0], [0.5, 0.5]);
        let (east, west) = (east_half.levels()[1], west_half.levels()[1]);
        assert_eq!([west[1], west[3]], [east[0], east[2]]);
        let twice = whole.of_part([0.5, 0.5], [1.0, 1.0]).of_part([0.0, 0.0], [0.5, 0.5]);
        assert_eq!(twice, whole.of_part([0.5, 0.5], [0.75, 0.75]));
    }

    #[test]
    fn levels_beyond_the_coarsest_that_is_morphed_to_are_left_out() {
        let mut errors = LevelErrors::default();
        for level in 0..20 {
            errors = errors.with_own([f64::from(level); 4]);
        }
        assert_eq!(errors.levels().len(), MORPH_LEVELS + 1);
        assert_eq!((errors.levels()[0], errors.levels()[1]), ([19.0; 4], [18.0; 4]));
    }
}
