//! Craters of impacts.

use super::super::points::{Points, RADIUS_M};
use super::super::preset::Relief;
use super::noise::add_craters;
use super::{Ground, part_seed};

impl Relief {
    /// Adds craters of all sizes, small ones on top of large ones.
    pub(super) fn add_craters(&self, seed: u64, points: &Points, out: &mut Ground) {
        let craters = self.forms.craters;
        if craters <= 0.0 {
            return;
        }
        let (mut cell_m, mut share) = (900_000.0f64, 0.3f32);
        for octave in 0..14 {
            // Large craters are flatter.
            let flat = 1.0 / (1.0 + cell_m as f32 / 60_000.0);
            let depth = craters * cell_m as f32 * (0.03 + 0.55 * flat);
            add_craters(points, RADIUS_M / cell_m, part_seed(seed, 60 + octave), share, depth, &mut out.bed_m);
            cell_m *= 0.5;
            share = 0.8;
        }
    }
}
