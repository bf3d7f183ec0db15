//! Table mountains: a flat top, a cliff of hard rock, and below it talus at the angle of repose, which ends in the plain.

use super::super::points::Points;
use super::super::preset::Relief;
use super::noise::noise_gradient;
use super::{Ground, REPOSE, Scratch, add_octaves, part_seed, reset, smooth};

/// The wavelength of the pattern of mesas.
const PATTERN_M: f64 = 13_000.0;
/// The distance from dry rivers to the cliffs beside them.
const VALLEY_M: f32 = 420.0;
/// The width of a cliff in metres. Narrower ones are toothed where cells are as wide.
const CLIFF_M: f32 = 40.0;
/// Tiers: the value of the pattern at the edge, and the height as a share.
const TIERS: [(f32, f32); 2] = [(0.16, 0.6), (0.36, 0.4)];

/// Returns the height of a tier of height 1 at a distance in heights inside of its edge: the talus is half as high as the
/// cliff above it and ends as a parabola.
fn tier(inside: f32, cliff: f32) -> f32 {
    const TALUS: f32 = 0.55;
    let t = (1.0 + (inside + cliff) * REPOSE / (2.0 * TALUS)).clamp(0.0, 1.0);
    TALUS * t * t + (1.0 - TALUS) * smooth(-cliff, 0.0, inside)
}

impl Relief {
    /// Adds mesas to plains, after rivers have cut these.
    pub(super) fn add_mesas(&self, seed: u64, points: &Points, s: &mut Scratch, out: &mut Ground) {
        let (n, mesa_m) = (points.len(), self.forms.mesa_m);
        if mesa_m <= 0.0 {
            return;
        }
        // Around seas of sand, as far as the sand was carried from them.
        reset(&mut s.other, n);
        for (region, (mountain, sand)) in s.other.iter_mut().zip(out.mountain.iter().zip(&s.sand)) {
            *region = smooth(-1.5, -1.0, *sand) * smooth(0.0, -0.12, *sand) * (1.0 - smooth(0.25, 0.6, *mountain));
        }
        if s.other.iter().all(|region| *region == 0.0) {
            return;
        }
        reset(&mut s.strength, n);
        for v in [&mut s.gradient, &mut s.total] {
            v.reset(n);
        }
        // The pattern, and its slope for each metre.
        let (mut wavelength_m, mut amplitude) = (PATTERN_M, 1.0f32);
        for octave in 0..2 {
            let part = part_seed(seed, 56 + octave);
            noise_gradient(points, points.radius_m / wavelength_m, part, &mut s.noise, &mut s.gradient);
            let per_m = amplitude / wavelength_m as f32;
            for k in 0..n {
                s.strength[k] += amplitude * s.noise[k];
                s.total.x[k] += per_m * s.gradient.x[k];
                s.total.y[k] += per_m * s.gradient.y[k];
                s.total.z[k] += per_m * s.gradient.z[k];
            }
            wavelength_m *= 0.4;
            amplitude *= 0.35;
        }
        // Alcoves and buttresses.
        reset(&mut s.noise, n);
        add_octaves(points, 900.0, 3, 0.45, 1.0, part_seed(seed, 58), &mut s.noise);
        for k in 0..n {
            if s.other[k] == 0.0 {
                continue;
            }
            let [x, y, z] = s.total.at(k);
            let slope = (x * x + y * y + z * z).sqrt().max(0.5 / PATTERN_M as f32);
            for (edge, share) in TIERS {
                let height_m = mesa_m * share * s.other[k];
                // Valleys end at cliffs.
                let inside_m = ((s.strength[k] - edge) / slope).min(out.stream_m[k] - VALLEY_M);
                let inside_m = inside_m + 130.0 * (0.3 - s.noise[k].abs());
                let rise_m = height_m * tier(inside_m / (mesa_m * share), CLIFF_M / (mesa_m * share));
                let rise_m = rise_m * smooth(-3.0, -28.0, out.depth_m[k]);
                out.bed_m[k] += rise_m;
                out.surface_m[k] += rise_m;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn talus_lies_below_a_cliff_at_the_angle_of_repose() {
        let cliff = 0.2;
        assert_eq!((tier(0.0, cliff), tier(-10.0, cliff)), (1.0, 0.0));
        let heights: Vec<f32> = (0..400).map(|k| tier(0.01 * k as f32 - 3.0, cliff)).collect();
        assert!(heights.windows(2).all(|pair| pair[0] <= pair[1]));
        let steepest = |range: std::ops::Range<usize>| {
            heights[range].windows(2).map(|pair| (pair[1] - pair[0]) / 0.01).fold(0.0, f32::max)
        };
        let (talus, face) = (steepest(0..280), steepest(279..301));
        assert!((talus - REPOSE).abs() < 0.02 && face > 2.0, "talus {talus}, cliff {face}");
    }
}
