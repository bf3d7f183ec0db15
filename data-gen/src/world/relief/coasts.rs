//! Reefs in warm seas: a wall some way off the coast with passes, and behind it a lagoon with heads of coral.

use super::super::points::Points;
use super::super::preset::Relief;
use super::{Ground, Scratch, add_noise, add_octaves, part_seed, reset, smooth};

/// The place of reefs and half their width, as values of the noise of continents.
const REEF: f32 = -0.026;
const HALF: f32 = 0.0035;
/// The height of reefs in metres: waves break on them.
const TOP_M: f32 = -0.7;

impl Relief {
    /// Adds reefs. They end where the sea is cool.
    pub(super) fn add_reefs(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) {
        let (n, lagoon_m) = (points.len(), self.forms.lagoon_m);
        let near = |inland: f32| (REEF - 3.0 * HALF - 0.01..0.01).contains(&inland);
        if lagoon_m <= 0.0 || !out.inland.iter().any(|inland| near(*inland)) {
            return;
        }
        for (buffer, wavelength_m, octaves, part) in [(&mut s.noise, 7_000.0, 4, 57), (&mut s.other, 420.0, 2, 59)] {
            reset(buffer, n);
            add_octaves(points, wavelength_m, octaves, 0.5, 1.0, part_seed(seed, part), buffer);
        }
        reset(&mut s.detail, n);
        add_noise(points, points.radius_m / 60_000.0, part_seed(seed, 54), 1.0, &mut s.detail);
        for k in 0..n {
            let inland = out.inland[k];
            if !near(inland) || out.bed_m[k] > 0.0 {
                continue;
            }
            let (bends, heads) = (s.noise[k], s.other[k]);
            let warm = smooth(0.55, 0.4, points.z[k].abs() as f32);
            // Half widths towards the shore.
            let t = (inland + 0.006 * bends - REEF) / HALF;
            let pass = smooth(0.34, 0.5, bends) + smooth(-0.1, -0.4, s.detail[k]);
            let head_m = (lagoon_m - 1.5) * smooth(0.3, 0.5, heads) * smooth(3.0, 4.0, t);
            let inside = smooth(0.9, 2.2, t);
            let top_m = TOP_M - 1.2 * heads.abs();
            let wall_m = if t < -1.0 { 45.0 * (t + 1.0) } else { 0.0 };
            let floor_m =
                top_m + (-lagoon_m + head_m - top_m) * inside + wall_m - (1.0 - inside) * 18.0 * pass.min(1.0);
            // A lagoon needs a reef.
            let there = warm * (1.0 - smooth(-0.1, -0.4, s.detail[k])) * smooth(0.0, -1.5, out.bed_m[k]);
            out.bed_m[k] += (floor_m - out.bed_m[k]).max(0.0) * there;
        }
    }
}
