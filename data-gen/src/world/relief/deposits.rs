//! The traces of wind and impacts: dunes and craters.

use super::super::points::{Points, RADIUS_M};
use super::super::preset::Relief;
use super::noise::add_craters;
use super::{Ground, Scratch, add_octaves, part_seed, reset, smooth};

impl Relief {
    /// Adds dunes across the wind: long crests with a gentle and a steep side.
    pub(super) fn add_dunes(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) {
        let n = points.len();
        if self.dune_m <= 0.0 {
            return;
        }
        reset(&mut s.other, n);
        add_octaves(points, 60_000.0, 3, 0.5, 1.0, part_seed(seed, 50), &mut s.other);
        for k in 0..n {
            out.cover[k] = smooth(-0.35, 0.1, s.other[k]) * (1.0 - smooth(0.1, 0.5, out.mountain[k]));
        }
        if out.cover.iter().all(|c| *c == 0.0) {
            return;
        }
        // Crests are long across the wind: the lattice is stretched along one axis.
        let mut stretched = points.clone();
        for k in 0..n {
            let along = 0.6 * points.x[k] - 0.5 * points.y[k] + 0.62 * points.z[k];
            stretched.x[k] -= 0.65 * along * 0.6;
            stretched.y[k] += 0.65 * along * 0.5;
            stretched.z[k] -= 0.65 * along * 0.62;
        }
        let (mut wavelength_m, mut amplitude) = (1_700.0, 1.0f32);
        for octave in 0..3 {
            reset(&mut s.noise, n);
            add_octaves(&stretched, wavelength_m, 2, 0.3, 1.0, part_seed(seed, 51 + octave), &mut s.noise);
            for k in 0..n {
                let crest = 1.0 - s.noise[k].abs().min(1.0);
                let sharp = crest * crest;
                out.bed_m[k] += self.dune_m * amplitude * out.cover[k] * (sharp - 0.4);
            }
            wavelength_m *= 0.23;
            amplitude *= 0.16;
        }
    }

    /// Adds craters of all sizes, small ones on top of large ones.
    pub(super) fn add_craters(&self, seed: u64, points: &Points, out: &mut Ground) {
        if self.craters <= 0.0 {
            return;
        }
        let (mut cell_m, mut share) = (900_000.0f64, 0.3f32);
        for octave in 0..14 {
            // Large craters are flatter.
            let flat = 1.0 / (1.0 + cell_m as f32 / 60_000.0);
            let depth = self.craters * cell_m as f32 * (0.03 + 0.55 * flat);
            add_craters(points, RADIUS_M / cell_m, part_seed(seed, 60 + octave), share, depth, &mut out.bed_m);
            cell_m *= 0.5;
            share = 0.8;
        }
    }
}
